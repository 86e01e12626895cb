"""Quantities that effects share, and effects of columns, declarations and entry points."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from importlib.metadata import EntryPoint, entry_points
from typing import Annotated, Final, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from calib.campaign.model import NUMERIC_COLUMNS
from calib.coefficients.sections import first_fault
from calib.errors import BadFileError, BadInputError
from calib.gap.effects import Centre, Effect, Family, Form, Parameter, Proportional, varies
from calib.gap.observations import Observations
from calib.gap.observations.routes import row_numbers
from calib.gap.predict import Path
from calib.types import BoolArray, FloatArray, IntArray, StrArray

PAPER_LOAD_N: Final = 300.0
PAPER_LENGTH_M: Final = 1.0
PAPER_RADIUS_M: Final = 0.1


def softness(observations: Observations) -> float:
    """Return by how much softer the wheels may be per newton, 1 or more."""
    own_N = observations.vehicle.unladen_load_N
    return max(1.0, PAPER_LOAD_N / own_N) if own_N > 0.0 else 1.0


def reach(observations: Observations) -> float:
    """Return how far things can be off on the vehicle, 1 or less: in proportion to its longer side."""
    return min(1.0, max(observations.vehicle.wheelbase_m, observations.model.track_m) / PAPER_LENGTH_M)


def mean_radius_m(observations: Observations) -> float:
    """Return the mean of both radii of the model."""
    return 0.5 * (observations.model.radius_left_m + observations.model.radius_right_m)


def loads_vary(observations: Observations) -> bool:
    """Return whether the load of either wheel is known and differs between observations."""
    return any(varies(load, same_load_N(observations), observations) for load in observations.wheel_loads_N)


def same_load_N(observations: Observations) -> float:
    """Return the difference within which loads of a wheel are one; at most 5 N."""
    return SAME_LOAD_N / softness(observations)


def same_speed_mps(speed_mps: FloatArray) -> float:
    """Return the difference within which speeds (n_obs,) are one speed."""
    return SAME_SPEED_SHARE * float(np.mean(speed_mps))


#: slower than this counts as standing still
MOVING_MPS = 0.05
#: share of the mean within which speeds are one: a drive keeps a set speed to some per cent
SAME_SPEED_SHARE = 0.05
#: loads under `PAPER_LOAD_N` that differ by less are one load
SAME_LOAD_N = 5.0
#: fewer runs under one load are no stretch of their own
MIN_RUNS_PER_LOAD = 3
#: the motion at the end is judged over twice this time
END_STRETCH_S = 0.3
#: an end speed below this is a halt, seen through the counter's steps
STANDSTILL_MPS = 0.05
#: or below this share of the driven speed, for vehicles that creep
STANDSTILL_SHARE = 0.2


def sessions(observations: Observations) -> StrArray:
    """Return the session of each observation, shape (n_obs,).

    Where none are written down, a stretch of runs under one load is one: anything may have changed with the load. Loads
    that change more often leave a single session, as do recordings of loads that come back.
    """
    session = observations.labels["session"]
    if np.any(session != session[:1]):
        return session
    steps = np.abs(np.diff(observations.wheel_loads_N, axis=1)).max(axis=0, initial=0.0)
    changes = np.flatnonzero(steps > same_load_N(observations)) + 1
    lengths = np.diff(np.concatenate(([0], changes, [len(observations)])))
    if not len(changes) or lengths.min() < MIN_RUNS_PER_LOAD:
        return session
    runs = [len(np.unique(of)) for of in np.split(observations.run, changes)]
    at = observations.wheel_loads_N[:, np.concatenate(([0], changes))]
    apart = np.abs(at[:, :, None] - at[:, None, :]).max(axis=0) > same_load_N(observations)
    if min(runs) < MIN_RUNS_PER_LOAD and not apart[np.triu_indices(len(runs), 1)].all():
        return session
    return np.array([f"stretch_{k}" for k in np.repeat(np.arange(1, len(lengths) + 1), lengths)])


def numbered_sessions(observations: Observations) -> tuple[IntArray, int]:
    """Return the number of the session of each observation, in the order driven, shape (n_obs,), and how many."""
    number = row_numbers([sessions(observations)])
    return number, int(number.max()) + 1


def session_steps(observations: Observations) -> list[tuple[str, FloatArray]]:
    """Return name and step (n_obs,) of each session but the first, counted from the campaign's mean."""
    number, count = numbered_sessions(observations)
    inside = [number == later for later in range(1, count)]
    return [(str(sessions(observations)[mine][0]), mine - mine.mean()) for mine in inside]


def driven_speed_mps(observations: Observations) -> FloatArray:
    """Return each observation's speed as a mean over its path, not time, (n_obs,); NaN where unknown."""

    def mean(part: Observations) -> FloatArray:
        way = np.abs(part.path_m)
        with np.errstate(divide="ignore", invalid="ignore"):
            return part.total(way * np.abs(part.speed_mps)) / part.total(way)

    logged = observations.of_parts(mean)
    logged = np.where(logged > 0.0, logged, np.nan)
    return np.where(observations.from_log & np.isfinite(logged), logged, np.abs(observations.number("speed_mps")))


def curvature_per_m(observations: Observations) -> FloatArray:
    """Return the curvature of each step, no tighter than a turn about one rear wheel, shape (n_steps,)."""
    tightest = 2.0 / observations.model.track_m
    return np.clip(observations.curvature_per_m, -tightest, tightest)


def path_curvature_per_m(path: Path) -> FloatArray:
    """Return `curvature_per_m` of a path, under the hypothesis."""
    tightest = 2.0 / path.s.model.track_m
    return np.clip(path.s.curvature_of(path.steps.turn_rad, path.steps.ds_m), -tightest, tightest)


def shows_curves(observations: Observations) -> bool:
    """Return whether any observation turns by more than a tenth of a radian in all."""
    return any((s.total(np.abs(curvature_per_m(s) * s.path_m)) > 0.1).any() for s in observations.parts())


def on_the_spot(s: Observations, turn_rad: FloatArray, path_m: FloatArray) -> FloatArray:
    """Return 2 / track, in 1/m, where the rear wheels roll against each other, else 0, shape (n_steps,).

    `turn_rad`, `path_m` (shape (n_steps,)): turn and signed way of each step.
    """
    tightest = 2.0 / s.model.track_m
    return np.where(np.abs(turn_rad) > np.abs(path_m) * tightest, tightest, 0.0)


def turns_on_the_spot_too(observations: Observations) -> bool:
    """Return whether some observation turns on the spot, and some while it rolls, by a tenth of a radian."""
    turned = np.zeros(2)
    for s in observations.parts():
        spot, turn = on_the_spot(s, s.turn_rad, s.path_m) > 0.0, np.abs(s.turn_rad)
        turned = np.maximum(turned, [s.total(turn * on).max() for on in (spot, ~spot)])
    return bool((turned > 0.1).all())


def end_motion(observations: Observations, *, at_start: bool = False) -> tuple[FloatArray, FloatArray]:
    """Return signed speed (m/s) and turn rate (rad/s) at the end (or start) of each observation, each shape (n_obs,).

    By the log's last two stretches of three tenths of a second, carried on to the very end; without a log at its
    set speed, else 0.
    """

    def motion(part: Observations) -> FloatArray:
        duration = np.nan_to_num(part.duration_s)
        edge = part.starts[:-1] if at_start else part.starts[1:] - 1
        at = (part.time_s - duration if at_start else part.time_s)[edge][part.unit]
        away = part.time_s - 0.5 * duration - at
        return np.stack(_motion_at(part, away if at_start else -away, edge), axis=1)

    speed, rate = observations.of_parts(motion).T
    return speed, rate


def _motion_at(observations: Observations, age: FloatArray, edge: IntArray) -> tuple[FloatArray, FloatArray]:
    with np.errstate(invalid="ignore"):
        late, early = age < END_STRETCH_S, (age >= END_STRETCH_S) & (age < 2 * END_STRETCH_S)
    late[edge] = True
    early[edge] = False
    way, turn = (
        _carried_on(observations, part, age, late, early) for part in (observations.path_m, observations.turn_rad)
    )
    stands = np.abs(way) < standstill_mps(observations)
    known = observations.from_log & np.isfinite(way)
    set_speed = np.nan_to_num(observations.number("speed_mps")) * np.sign(observations.total(observations.path_m))
    speed = np.where(known, np.where(stands, 0.0, way), set_speed)
    return speed, np.where(known, np.where(stands, 0.0, turn), np.abs(set_speed) * curvature_per_m(observations)[edge])


def standstill_mps(observations: Observations) -> FloatArray:
    """Return the speed below which an observation stands at its edge, shape (n_obs,): less where all of it is slow."""
    driven = driven_speed_mps(observations)
    return np.minimum(STANDSTILL_MPS, np.where(np.isfinite(driven), STANDSTILL_SHARE * driven, STANDSTILL_MPS))


def _carried_on(
    observations: Observations, steps: FloatArray, back: FloatArray, late: BoolArray, early: BoolArray
) -> FloatArray:
    rate, age = [], []
    for part in (late, early):
        time = np.where(part, np.nan_to_num(observations.duration_s), 0.0)
        seconds = observations.total(time)
        with np.errstate(divide="ignore", invalid="ignore"):
            rate.append(observations.total(np.where(part, steps, 0.0)) / seconds)
            age.append(observations.total(np.where(part, np.nan_to_num(back) * time, 0.0)) / seconds)
    with np.errstate(divide="ignore", invalid="ignore"):
        carried = rate[0] + (rate[0] - rate[1]) * age[0] / (age[1] - age[0])
    last = np.where(np.isfinite(rate[0]), rate[0], np.nan)
    carried = np.where(np.isfinite(carried), carried, last)
    return np.where(np.isnan(last) | (np.sign(carried) == np.sign(last)), carried, 0.0)


COVARIATE_PREFIX: Final = "covariate:"
#: form of a covariate -> what it acts on, and the parameter's name and unit
COVARIATE_FORMS: Final = {
    "both radii": ("both", "relative_per_sd", "1"),
    "left radius": ("left", "relative_per_sd", "1"),
    "right radius": ("right", "relative_per_sd", "1"),
    "yaw per metre": ("yaw", "yaw_per_sd", "rad/m"),
}


class _OfColumn(Proportional):
    id: str  # type: ignore[misc]
    title: str  # type: ignore[misc]
    implausible = "something else that changed with this column"
    family = Family.COVARIATE
    separates = "runs that vary this column alone"

    def __init__(self, name: str, title: str, column: str, origin: str) -> None:
        self.id, self.column, self.origin = name, column, origin  # type: ignore[misc]
        self.title = title or f"an influence of the column {column}"

    def quantity(self, observations: Observations) -> FloatArray:
        return observations.number(self.column)


class Covariate(_OfColumn):
    """A column acts on both radii, on one radius, or turns the vehicle by so much a metre.

    The column enters standardised, (value - mean) / standard deviation, so sizes are per standard deviation.
    """

    needs = "a column of numbers in the run table that varies"
    shifts = ("radius_scale", "unequal_radii")

    def __init__(self, column: str) -> None:
        super().__init__(COVARIATE_PREFIX + column, "", column, f"the column {column} of runs.csv")

    def centre(self, values: FloatArray) -> Centre:
        """See `Proportional`."""
        return Centre(float(np.mean(values)), float(np.std(values)) or 1.0)

    def forms(self, observations: Observations) -> list[Form]:
        """See `Effect`."""
        values = self.quantity(observations)
        if not varies(values, 0.0, observations) or self.centre(values).spread <= 1e-12 * float(np.max(np.abs(values))):
            return []
        centre = self.centre(values)
        settings = {"mean": centre.mean, "standard_deviation": centre.spread}
        forms = [
            self.form(values, acts_on, Parameter(name, unit, typical=1e-3, largest=2e-2), label)
            for label, (acts_on, name, unit) in COVARIATE_FORMS.items()
        ]
        return [replace(form, settings=settings, tries=len(forms)) for form in forms]


def covariate_columns(observations: Observations) -> tuple[str, ...]:
    """Return the further numeric columns of a campaign, in its own order."""
    return tuple(name for name in observations.numbers if name not in NUMERIC_COLUMNS)


#: group of entry points under which packages offer classes of effects
ENTRY_POINT_GROUP: Final = "calib.effects"

#: what a declared effect acts on -> unit of its size per unit of the column, and what a shift of its zero looks like
ACTS_ON: Final[dict[str, tuple[str, tuple[str, ...]]]] = {
    "left": ("1", ("radius_scale", "unequal_radii")),
    "right": ("1", ("radius_scale", "unequal_radii")),
    "both": ("1", ("radius_scale",)),
    "track": ("1", ("track_width",)),
    "yaw": ("rad/m", ("unequal_radii",)),
    "distance": ("m", ()),
}
_Text = Annotated[str, Field(min_length=1)]


class _Entry(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", str_strip_whitespace=True)

    id: _Text
    title: _Text | None = None
    column: _Text
    #: see `acting_on`
    acts_on: Literal["left", "right", "both", "track", "yaw", "distance"]
    #: typical, largest: sizes per unit of the column
    typical: Annotated[FiniteFloat, Field(gt=0.0)]
    largest: Annotated[FiniteFloat, Field(gt=0.0)]


class Declared(_OfColumn):
    """A linear effect: size times (column - its mean) on one radius, both, the track, yaw per metre or the laser."""

    needs = "its column to vary"

    def __init__(self, entry: _Entry) -> None:
        super().__init__(entry.id, entry.title or "", entry.column, "[[effects]] of campaign.toml")
        self.acts_on = entry.acts_on  # type: ignore[misc]
        self.columns = (entry.column,)  # type: ignore[misc]
        unit, self.shifts = ACTS_ON[entry.acts_on]  # type: ignore[misc]
        unit = f"{unit} per {entry.column}"
        self.parameter = Parameter("size", unit, entry.typical, entry.largest)  # type: ignore[misc]

    def form(self, values: FloatArray, acts_on: str, parameter: Parameter | None = None, label: str = "") -> Form:
        """See `Proportional`."""
        return replace(super().form(values, acts_on, parameter, label), settings={"mean": self.centre(values).mean})


def declared_effects(declared: object, columns: Collection[str], taken: Collection[str]) -> list[Effect]:
    """Return the effects of the ``[[effects]]`` tables, which act through numeric `columns` of the run table.

    No id is `taken` twice. Nothing in a declaration is ever evaluated; an error names the key that cannot be used.
    """
    if declared is None:
        return []
    if isinstance(declared, str | bytes | Mapping) or not isinstance(declared, Sequence):
        raise _wrong("effects", declared, "a list of tables", "write each effect as its own [[effects]] table")
    effects: list[Effect] = []
    used = set(taken)
    for number, table in enumerate(declared):
        where = f"effects[{number}]"
        entry = _validated(table, where)
        if entry.id in used:
            raise _wrong(f"{where}.id", entry.id, "an id that no other effect has", "choose another id")
        if entry.column not in columns:
            remedy = f"add the column to runs.csv or name one of: {', '.join(sorted(columns))}"
            raise _wrong(f"{where}.column", entry.column, "a numeric column of the run table", remedy)
        if entry.largest < entry.typical:
            expected = f"no less than typical ({entry.typical:g})"
            raise _wrong(f"{where}.largest", entry.largest, expected, "raise largest or lower typical")
        effects.append(Declared(entry))
        used.add(entry.id)
    return effects


def _validated(table: object, where: str) -> _Entry:
    try:
        return _Entry.model_validate(table)
    except ValidationError as error:
        key, actual, expected = first_fault(error)
        remedy = f"its keys are {', '.join(_Entry.model_fields)}; sizes are per unit"
        raise BadFileError("campaign.toml", actual[:60], expected, remedy, column=f"{where}.{key}") from error


def _wrong(key: str, actual: object, expected: str, remedy: str) -> BadFileError:
    return BadFileError("campaign.toml", column=key, found=repr(actual)[:60], expected=expected, remedy=remedy)


def entry_point_effects(taken: Collection[str], points: Sequence[EntryPoint] | None = None) -> list[Effect]:
    """Return the effects that installed packages offer (or these entry points); no id is `taken` twice."""
    effects: list[Effect] = []
    used = set(taken)
    for point in entry_points(group=ENTRY_POINT_GROUP) if points is None else points:
        where = f"entry point {point.name} = {point.value} of group {ENTRY_POINT_GROUP}"
        remedy = "mend or uninstall the package that offers it"
        try:
            kind = point.load()
        except Exception as error:
            raise BadInputError(f"{where}: found {error}; expected a class that can be loaded; {remedy}") from error
        if not (isinstance(kind, type) and issubclass(kind, Effect)):
            raise BadInputError(f"{where}: found {kind!r}; expected a subclass of calib's Effect; {remedy}")
        try:
            effect = kind()
        except TypeError as error:
            raise BadInputError(f"{where}: found {error}; expected a class made without arguments; {remedy}") from error
        name = getattr(effect, "id", None)
        if not isinstance(name, str) or not name or name in used:
            raise BadInputError(f"{where}: found the id {name!r}; expected one that no other effect has; {remedy}")
        package = f"the package {point.dist.name} {point.dist.version}" if point.dist else "an installed package"
        effect.origin = f"{package} ({point.name} = {point.value})"  # type: ignore[misc]
        effects.append(effect)
        used.add(name)
    return effects
