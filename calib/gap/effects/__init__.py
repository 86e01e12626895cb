"""What an effect is: a named cause, its parameters, and what it does to wheels, track, path or readings."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from math import inf
from typing import ClassVar

import numpy as np

from calib.gap import Perturbation
from calib.gap.observations import Observations
from calib.gap.predict import Path
from calib.types import FloatArray


class Family(StrEnum):
    """Effects that act through the same thing, so that one represents another where the runs vary too little."""

    words: str  #: what is sure where only the family is, as a clause

    def __new__(cls, value: str, words: str) -> "Family":
        """Make a member of its name in files and its clause."""
        member = str.__new__(cls, value)
        member._value_, member.words = value, words
        return member

    CALIBRATION = "calibration", "radii or track are other than believed"
    LOAD = "load", "the radii follow the load"
    TURNING = "turning", "turns come out other than the wheels say"
    SPEED = "speed", "the distance changes with the speed or with stops"
    # temperature, too: it rises with the day as wear and sessions do
    DRIFT = "drift", "the radii drift over the campaign"
    DIRECTION = "direction", "one direction of travel differs from the other"
    COUNTS = "counts", "the encoders count wrongly"
    STEERING = "steering", "the front wheel disagrees with the rear wheels"
    INSTRUMENT = "instrument", "the distance instrument reads wrongly"
    REFERENCE = "reference", "the pose reference reads another place or time"
    FLOOR = "floor", "the gap opens at places of the floor"
    PATH = "path", "the path between the ends is other than computed"
    COVARIATE = "covariate", "the gap correlates with a further column of the run table"
    OWN = "own", "an effect of the user's own is at work"
    SIMULATOR = "simulator", "a parameter of the simulator is off"


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter of an effect."""

    #: name, unit: as printed; ``1`` for a plain number
    name: str
    unit: str
    typical: float  #: order of magnitude; the scale of its prior
    largest: float  #: larger is physically implausible
    sign: int = 0  #: 1 or -1 where only that sign has a meaning, 0 where either does
    #: whether it only shifts where the others have their zero
    shift: bool = False


@dataclass(frozen=True, slots=True)
class Centre:
    """Where a covariate's effect is zero, and by what its deviation from there is divided."""

    mean: float  #: in the covariate's unit
    spread: float = 1.0  #: what counts as one unit of the deviation: 1, or a standard deviation

    @classmethod
    def of(cls, values: FloatArray) -> "Centre":
        """Return the centre at the mean of the known values (n_obs,), 0 where none is known."""
        return cls(float(np.nanmean(values)) if np.isfinite(values).any() else 0.0)

    def deviations(self, values: FloatArray) -> FloatArray:
        """Return how far values lie from the centre, NaN as 0, same shape."""
        return np.nan_to_num((values - self.mean) / self.spread)


Perturbations = Callable[[Path], Sequence[Perturbation]]


def always(*perturbations: Perturbation) -> Perturbations:
    """Return perturbations that are the same on every path."""
    return lambda _: perturbations


def on_both(share: FloatArray) -> Perturbation:
    """Return a relative change of both wheels' travel, shape (n_obs,) or (n_steps,)."""
    return Perturbation(left=share, right=share)


@dataclass(frozen=True, slots=True, eq=False)
class Form:
    """One form of an effect on one campaign: its parameters and what each of them perturbs."""

    effect: str
    label: str  #: which form, for example ``exponent 0.7``; empty where there is one only
    parameters: tuple[Parameter, ...]
    #: path -> one `Perturbation` a parameter, per unit of the parameter
    perturbations: Perturbations
    #: not fitted linearly: an exponent, a time constant, a place
    settings: dict[str, float] = field(default_factory=dict)
    tries: int = 1  #: how many forms were searched over; the evidence pays for the search
    #: where the effect is zero, for a form that takes a covariate's deviation from its mean
    centre: Centre | None = None
    #: centre -> `perturbations` with the effect zero there; each form with a centre has it
    about: Callable[[Centre], Perturbations] | None = None
    #: lowest and highest value, of what its parameter multiplies, at which it may truly be zero
    zero_within: tuple[float, float] = (-inf, inf)
    #: settings -> `perturbations` with these, for a form whose settings come from the runs
    at: Callable[[Mapping[str, float]], Perturbations] | None = None
    #: whether `perturbations` takes everything per step from its path, maybe of some observations; else arrays are held
    #: for all
    by_parts: bool = False
    #: effects without one of which it does nothing, by id
    acts_through: tuple[str, ...] = ()
    end: Centre | None = None  #: where a file writes it zero, for what counts on through the campaign

    def centred_at(self, centre: Centre | None) -> "Form":
        """Return the form with the effect zero at a centre, itself where it has none."""
        if self.about is None or centre is None or centre == self.centre:
            return self
        return replace(self, perturbations=self.about(centre), centre=centre)

    def with_settings(self, settings: Mapping[str, float]) -> "Form":
        """Return the form with settings of other runs, if any."""
        return self if self.at is None else replace(self, perturbations=self.at(settings), settings=dict(settings))

    @property
    def typical(self) -> FloatArray:
        """Typical size of each parameter in its unit, shape (n_parameters,)."""
        return np.array([p.typical for p in self.parameters])


Offer = tuple[str, tuple[Parameter, ...], Perturbations]


class Effect(ABC):
    """A candidate cause. A new effect is a subclass in a file of its own and one line in the registry."""

    #: the library, a column, ``campaign.toml``, or an installed package
    origin: ClassVar[str] = "the library"
    id: ClassVar[str]  #: name in verdicts
    title: ClassVar[str]  #: a few words that fit into "the gap is explained by ..."
    #: what to suspect where the fitted size is beyond what is plausible; a clause
    implausible: ClassVar[str] = "another cause that looks alike"
    #: calibration effects that another zero point of this one looks like; a shift no larger than the effect is part of
    #: it
    shifts: ClassVar[tuple[str, ...]] = ()
    #: whether it looks like another effect only where radii and track are off with it
    needs_calibration: ClassVar[bool] = False
    #: whether it is nothing at a known point (reference load, no payload, a straight): then no shift is
    zero_known: ClassVar[bool] = False
    family: ClassVar[Family] = Family.OWN
    needs: ClassVar[str] = ""  #: what a campaign has to hold for the effect to show; a phrase
    separates: ClassVar[str] = ""  #: the runs that tell it from what looks alike; a phrase
    #: what a plain recalibration would change in its place; empty for all but the calibration's own
    hides_in: ClassVar[str] = ""
    #: for the calibration's own: the change of (left, right, track, front radius) per unit
    calibration_direction: ClassVar[tuple[float, ...] | None] = None
    #: further columns of the run table that it acts through: no candidates of their own beside it
    columns: ClassVar[tuple[str, ...]] = ()
    #: whether it makes the radii a function of the load, as the paper's correction does
    is_load_law: ClassVar[bool] = False
    #: whether its parameters ``slope_left`` and ``slope_right`` are the slopes of the radius law
    carries_law_slope: ClassVar[bool] = False
    #: why its correction is none for journeys to come, as the end of a sentence; empty where it is one
    not_transferable: ClassVar[str] = ""
    #: whether it has parameters for each session, so that it says nothing of a session omitted
    per_session: ClassVar[bool] = False
    #: whether it is sought at every place of the floor, and so follows what other forms leave
    by_place: ClassVar[bool] = False
    #: relative size beyond which it is a wrong unit, count or setting of no vehicle
    wrong_beyond: ClassVar[float] = inf
    #: whether it is about two wheels on one axle: not where a front wheel alone drives the odometry
    of_rear_wheels: ClassVar[bool] = False
    #: whether it is found by trial before the search; it offers no forms
    found_before_search: ClassVar[bool] = False

    @property
    def own_shifts(self) -> tuple[str, ...]:
        """Shifts of the calibration that count as part of it."""
        return () if self.zero_known else self.shifts

    @property
    def calibration(self) -> bool:
        """Whether a plain recalibration absorbs it."""
        return self.calibration_direction is not None

    @abstractmethod
    def forms(self, observations: Observations) -> list[Form]:
        """Return the effect's forms on this campaign; empty where the campaign cannot show it at all."""

    def assumption(self, observations: Observations) -> str:  # noqa: ARG002
        """Return what it rests on that these runs do not tell: then it has to predict routes that are held out."""
        return ""

    def elsewhere(self, observations: Observations) -> tuple[float, str]:  # noqa: ARG002
        """Return how many times what these runs show it does on others, and which to drive."""
        return 1.0, ""

    def offer(self, offers: Sequence[Offer], *, by_parts: bool = False) -> list[Form]:
        """Return a form for each label, its parameters and perturbations; the search over them counts."""
        return [Form(self.id, *each, tries=len(offers), by_parts=by_parts) for each in offers]


def forms_on(observations: Observations, effects: Mapping[str, Effect], wanted: Sequence[Form]) -> list[Form | None]:
    """Return forms as other observations offer them, about the same centre; None for what they lack."""
    matches: list[Form | None] = []
    for form in wanted:
        offered = effects[form.effect].forms(observations) if form.effect in effects else []
        alike = [each for each in offered if len(each.parameters) == len(form.parameters)]
        nearest = matching_form(alike, form.label, form.settings)
        matches.append(nearest and nearest.centred_at(form.centre))
    return matches


def matching_form(forms: Sequence[Form], label: str, settings: Mapping[str, float]) -> Form | None:
    """Return the form of a label, of several that with the nearest settings; else None."""

    def off(form: Form) -> float:
        return sum(abs(form.settings[key] - settings[key]) for key in form.settings.keys() & settings.keys())

    alike = [form for form in forms if form.label == label]
    alike = alike or [form for form in forms if form.label.partition(" above")[0] == label.partition(" above")[0]]
    parts = tuple(label.split(" and "))
    alike = alike or [form for form in forms if len(parts) > 1 and form.label.startswith(parts)]
    return min(alike, key=off, default=None)


def varies(values: FloatArray, by: float, observations: Observations) -> bool:
    """Return whether a covariate is known everywhere and takes more than one value (further apart than `by`).

    What the model has already acts at a single value, too.
    """
    return bool(np.isfinite(values).all() and (observations.applied or np.ptp(values) > by))


def acting_on(path: Path, target: str, values: FloatArray) -> Perturbation:
    """Return what a quantity (n_obs,) of all observations does on a path, per unit, to the radii, track, yaw or laser.

    `target`: ``left``, ``right``, ``both``, ``difference`` (half on each, left negative) and ``track`` are relative
    changes, ``yaw`` is in rad per metre, ``distance`` in m of the laser's distance.
    """
    on_path = path.s.here(values)
    if target == "distance":
        return Perturbation.on_readings(path.s, distance=on_path)
    if target == "yaw":
        return Perturbation(heading_rad=on_path[path.s.unit] * path.s.path_m)
    if target == "track":
        return Perturbation(track=on_path)
    if target == "difference":
        return Perturbation(left=-0.5 * on_path, right=0.5 * on_path)
    return Perturbation(left=None if target == "right" else on_path, right=None if target == "left" else on_path)


class Proportional(Effect):
    """An effect that grows with a quantity of each observation, counted from its mean on the campaign."""

    parameter: ClassVar[Parameter]
    acts_on: ClassVar[str] = "both"
    varies_by: ClassVar[float] = 0.0  #: what varies by no more than this is one value

    @abstractmethod
    def quantity(self, observations: Observations) -> FloatArray:
        """Return the quantity, shape (n_obs,); NaN where it is not known."""

    def same_within(self, values: FloatArray) -> float:  # noqa: ARG002
        """Return by how much values (n_obs,) of the quantity may differ and be one: no form where all are."""
        return self.varies_by

    def centre(self, values: FloatArray) -> Centre:
        """Return where the effect is zero, for the values (n_obs,) of its quantity."""
        return Centre.of(values)

    def forms(self, observations: Observations) -> list[Form]:
        """Return the single form; none where the quantity is unknown or does not vary."""
        values = self.quantity(observations)
        return [self.form(values, self.acts_on)] if varies(values, self.same_within(values), observations) else []

    def form(self, values: FloatArray, acts_on: str, parameter: Parameter | None = None, label: str = "") -> Form:
        """Return a form by which the values (n_obs,) act on something, about their centre."""

        def about(centre: Centre) -> Perturbations:
            over = centre.deviations(values)
            return lambda path: [acting_on(path, acts_on, over)]

        centre = self.centre(values)
        parameters = (parameter or self.parameter,)
        return Form(self.id, label, parameters, about(centre), centre=centre, about=about, by_parts=acts_on == "yaw")
