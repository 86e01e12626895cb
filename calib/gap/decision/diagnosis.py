"""The results: diagnosis, causes, confounded effects, fix, what was weighed, and runs to drive."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from calib.campaign.model import Campaign
from calib.documents import SENTENCES, Result, in_words, plain, plain_fields
from calib.gap.decision import Trial
from calib.gap.decision.held_out import Closure, HeldOut, Improvement
from calib.gap.effects import Effect, Form
from calib.gap.effects.encoder import Blunder
from calib.gap.effects.mounting import Mounting
from calib.gap.effects.radii import AnySpeed
from calib.gap.effects.reference import ReferenceScale
from calib.gap.inference import EVEN_PROBABILITY
from calib.gap.inference.fit import CALIBRATION_SD, Fitted, whitened_rows
from calib.gap.inference.least_squares import HeldOutFit, WhitenedSystem
from calib.gap.inference.local_search import SearchResult
from calib.gap.inference.noise import Noise, estimate_noise
from calib.gap.inference.recalibration import Recalibration
from calib.gap.localise.locate import GapLocation
from calib.gap.observations import Channel, Observations
from calib.gap.plan import DetectionLimit
from calib.gap.plan.planned_runs import PlannedRun
from calib.gap.predict import Path, predict, residuals
from calib.types import FloatArray

if TYPE_CHECKING:
    from pandas import DataFrame

    from calib.kinematics.assemble import Promise


@dataclass(frozen=True, eq=False)
class Situation:
    """What was driven, blunders corrected."""

    campaign: Campaign
    observations: Observations
    notes: tuple[str, ...] = ()  #: what was assumed
    faults: tuple[Blunder | Mounting, ...] = ()  #: blunders of encoders and reference mounting, corrected
    as_counted: FloatArray | None = None  #: shape (n_units, n_channels): the gap as counted, before
    #: share of each run omitted, by id, see `bad_runs`
    omitted: Mapping[str, float] = field(default_factory=dict)

    @cached_property
    def nominal(self) -> Path:
        """What the model alone predicts."""
        return predict(self.observations)

    @cached_property
    def noise(self) -> Noise:
        """Noise about the model alone."""
        return estimate_noise(self.nominal, residuals(self.nominal, self.nominal))


@dataclass(frozen=True, eq=False)
class Evidence:
    """What the stages before the decision measured."""

    situation: Situation
    judged_against: str  #: model, simulator or file of the simulated motion
    nominal: Path  #: the model alone
    noise: Noise
    effects: Mapping[str, Effect]
    search: SearchResult
    recalibration: Recalibration  #: calibration parameters off beside the most probable set
    held_out: HeldOut
    trials: tuple[Trial, ...]  #: on routes, speeds, loads, directions and sessions held out in turn
    where: GapLocation
    #: runs driven, then to come, on which corrections of confounded effects are compared
    journeys: Observations | None = None

    @property
    def observations(self) -> Observations:
        """Observations and steps."""
        return self.nominal.s

    @property
    def fitted(self) -> Fitted:
        """The most probable hypothesis, a recalibration free beside it."""
        return self.search.fitted

    @cached_property
    def left_out(self) -> HeldOutFit:
        """It, to be fitted without some runs."""
        return HeldOutFit(self.fitted, self.nominal, self.noise, self.search.weighting)

    @cached_property
    def calibration(self) -> tuple[str, ...]:
        """Calibration parameters that are off, of those in the library."""
        return tuple(name for name in self._recalibrated if name in self.effects)

    @property
    def _recalibrated(self) -> tuple[str, ...]:
        likeliest = self.recalibration.likeliest
        return likeliest if likeliest or self.search.effects else self.recalibration.needed

    @property
    def denied(self) -> bool:
        """Whether a calibration parameter excluded from the library is off: a cause outside it."""
        return len(self.calibration) < len(self._recalibrated)

    @property
    def named(self) -> tuple[str, ...]:
        """Effects of the most probable hypothesis, and parameters that are off."""
        return (*self.search.effects, *self.calibration)

    @cached_property
    def unaided_scale(self) -> dict[str, list[Form]]:
        """The scale of a reference that alone measures lengths, which no search can weigh; else empty."""
        name, scale = ReferenceScale.id, ReferenceScale()
        alone = self.observations.usable[:, Channel.ALONG].any() and not scale.aided(self.observations)
        return {name: scale.unaided(self.observations)[:1]} if name in self.effects and alone else {}

    @property
    def variance_factor(self) -> float:
        """What an unexplained residual widens intervals by, squared; one that was weighed is in them."""
        free = max(len(self.system.gap) - len(self.fitted.parameters) - 4, 1)
        return 1.0 if self.search.weighting.name else max(1.0, self.fitted.chi_square / free)

    @cached_property
    def system(self) -> WhitenedSystem:
        """The whitened system about the most probable hypothesis."""
        offered = [form for forms in (self.search.forms | self.unaided_scale).values() for form in forms]
        return WhitenedSystem(self.fitted.path, self.nominal, self.noise, offered)

    @cached_property
    def per_unit(self) -> FloatArray:
        """Calibration parameters' whitened effect per relative change, (n_rows, 4)."""
        return np.asarray(self.system.calibration / CALIBRATION_SD)

    @cached_property
    def own_forms(self) -> dict[str, list[Form]]:
        """Forms of the calibration's parameters, and of radii by any law of the speed."""
        own = (*(effect for effect in self.effects.values() if effect.calibration), AnySpeed())
        return {effect.id: effect.forms(self.observations) for effect in own}

    @cached_property
    def explained_share(self) -> tuple[float, float]:
        """Share of the gap above the noise level that is explained, and its uncertainty."""
        before = whitened_rows(self.nominal, self.noise, residuals(self.nominal, self.nominal)[:, :, None])[:, 0]
        excess = max(float(before @ before) - len(before), 1.0)
        share = float(np.clip(1.0 - max(self.fitted.chi_square - len(before), 0.0) / excess, 0.0, 1.0))
        return share, float(np.sqrt(2.0 * len(before)) / excess)


FORMAT: Final = "calib-diagnosis/1"
#: on which runs corrections are compared
DRIVEN: Final = "runs driven"
JOURNEYS: Final = "journeys"
#: what the gap is judged against without a file: the campaign's model, or an outside simulator
BY_MODEL: Final = "model"
BY_SIMULATOR: Final = "sim columns of runs.csv"


class VerdictKind(StrEnum):
    """The verdict in one word."""

    NO_GAP = "no_gap"
    EXPLAINED = "explained"
    PARTLY_EXPLAINED = "partly_explained"
    AMBIGUOUS = "ambiguous"
    UNKNOWN = "unknown"
    UNDECIDED = "undecided"


@dataclass(frozen=True, slots=True)
class Quantity:
    """A fitted parameter with its 95 % interval."""

    value: float
    ci95: tuple[float, float]
    unit: str
    #: whether it only shifts the others' zero
    shift: bool = field(default=False, metadata={"json": False})


@dataclass(frozen=True, slots=True)
class Cause:
    """A named cause."""

    effect: str
    title: str  #: for people
    form: str  #: best-fitting form; empty where there is one only
    probability: float
    share: float  #: of the gap above the noise level (whitened squares)
    #: whitened norm beside a free recalibration (of the calibration's own parameters: without it)
    signal: float
    parameters: Mapping[str, Quantity]
    plausible: bool = True
    remark: str = ""
    times: float = field(default=1.0, metadata={"json": False})  #: its size over the largest plausible, at least
    settings: Mapping[str, float] = field(default_factory=dict)  #: quantities of the form not fitted linearly
    share_ci95: tuple[float, float] | None = None  #: of the share; None if not determined
    family: str = ""  #: (``load``, ``drift``, ``instrument``, ...); empty where unknown
    forms_open: tuple[str, ...] = ()  #: effects of the family that fit as well
    undetermined: tuple[str, ...] = ()  #: parameters that the runs do not determine: not in the JSON

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        determined = {name: value for name, value in self.parameters.items() if name not in self.undetermined}
        return plain_fields(self, parameters=determined)


@dataclass(frozen=True, slots=True)
class Unexplained:
    """The unexplained residual: share of the gap, signal, and place in words."""

    share: float
    signal: float
    where: tuple[str, ...] = ()
    #: certain, by what repeats differ by
    beyond_noise: bool = field(default=False, metadata={"json": False})


@dataclass(frozen=True, slots=True)
class Fix:
    """What the correction is worth."""

    recommended: bool = False
    #: largest difference of confounded effects' corrections at the end
    agreement_m: float | None = None
    agreement_on: str = DRIVEN  #: ``runs driven`` or ``journeys``
    nothing_else: float = 1.0  #: probability of no further effect of the library
    transfer: tuple[Trial, ...] = ()  #: on runs that it was not fitted on
    held_out: Improvement | None = None  #: on held-out runs; None without a cause
    why: tuple[str, ...] = ()  #: why not recommended, with figures and what settles it
    parameters: Mapping[str, float] = field(default_factory=dict)  #: what to set in the user's simulator
    corrects: tuple[str, ...] | None = None  #: causes that it corrects, blunders apart; None: all named
    leaves: tuple[str, ...] = ()  #: why it leaves the other named causes
    #: relative changes of the calibration beside its causes
    moves: Mapping[str, Quantity] = field(default_factory=dict)
    #: what it corrects by; None: the fit of all causes
    fitted: Fitted | None = field(default=None, metadata={"json": False})
    #: what it closes where it is not all that is fitted; None: what that closes
    closure: Closure | None = field(default=None, metadata={"json": False})


@dataclass(frozen=True, slots=True)
class NoiseSummary:
    """The noise level, and what supports it."""

    dof: float = 0.0  #: from replicates
    scales: Mapping[str, float] = field(default_factory=dict)
    supported: bool = True
    support: str = ""  #: by what, in words; else why not
    excess: Mapping[str, float] = field(default_factory=dict)  #: channel -> noise level over the stated sigmas'
    #: a sentence where it is far above the stated sigmas
    finding: str = field(default="", metadata={"json": False})

    @classmethod
    def about(cls, noise: Noise) -> "NoiseSummary":
        """Return the summary of a noise model."""
        excess = {channel.label: float(x) for channel in Channel if np.isfinite(x := noise.excess[channel])}
        return cls(noise.dof, noise.scales, noise.supported, noise.support, excess, noise.finding)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Diagnosis(Result):
    """What a campaign's gap is, its causes, and whether their correction is recommended."""

    kind: VerdictKind = field(metadata={"json": "verdict"})
    sentence: str
    causes: tuple[Cause, ...] = ()  #: named, most probable first
    #: sets of causes that hold 95 %, most probable first, and alternatives to the first
    credible_sets: tuple[tuple[str, ...], ...] = ()
    #: confounded effects, the named one first
    groups: tuple[tuple[str, ...], ...] = field(default=(), metadata={"json": "indistinguishable"})
    undetectable: tuple[DetectionLimit, ...] = ()
    where: GapLocation = field(default_factory=GapLocation)
    closure: Closure = field(default_factory=Closure)
    unexplained: Unexplained | None = field(default=None, metadata={"json": "rest"})
    #: of a gap explained in part, on held-out runs
    left: Unexplained | None = field(default=None, metadata={"json": False})
    fix: Fix = field(default_factory=Fix)
    next_runs: tuple[PlannedRun, ...] = ()
    notes: tuple[str, ...] = ()  #: what was excluded or assumed
    correct_first: tuple[str, ...] = ()  #: by the check, on data that name no cause
    noise_level: NoiseSummary = field(default_factory=NoiseSummary, metadata={"json": "noise"})
    #: of effects and ``unknown``, largest first
    probabilities: Mapping[str, float] = field(default_factory=dict)
    judged_against: str = BY_MODEL  #: ``model``, ``sim columns of runs.csv``, or a coefficient file
    campaign: str = ""
    simulated: bool = False
    gap_probability: float | None = None  #: of any gap; None if unknown
    #: arrays for figures, corrections and planning; None in one written by hand
    evidence: Evidence | None = field(default=None, metadata={"json": False})

    @property
    def against(self) -> str:
        """What the gap was judged against."""
        return "the campaign's own model" if self.judged_against == BY_MODEL else self.judged_against

    @property
    def is_improbable(self) -> bool:
        """Whether a gap that is reported is less probable than none."""
        none_shown = self.kind in {VerdictKind.NO_GAP, VerdictKind.UNDECIDED} or self.gap_probability is None
        return not none_shown and (self.gap_probability or 0.0) < EVEN_PROBABILITY

    @property
    def recommended(self) -> bool:
        """Whether the fix is recommended."""
        return self.fix.recommended

    @property
    def arrays(self) -> Evidence:
        """What was weighed."""
        if self.evidence is not None:
            return self.evidence
        raise ValueError("this diagnosis has no arrays: it does not come from a campaign")

    @property
    def observations(self) -> Observations:
        """Observations and steps, blunders of counts corrected."""
        return self.arrays.observations

    @property
    def noise(self) -> Noise:
        """Covariance of each observation."""
        return self.arrays.noise

    @property
    def nominal(self) -> Path:
        """The model alone."""
        return self.arrays.nominal

    @property
    def fitted(self) -> Fitted:
        """The most probable hypothesis, the recalibration free."""
        return self.arrays.fitted

    @property
    def correction(self) -> Fitted:
        """The fit that the fix corrects by: of all named causes, or the sure ones."""
        return self.fix.fitted or self.fitted

    @property
    def corrected_causes(self) -> tuple[Cause, ...]:
        """The named causes that the fix corrects."""
        wanted = self.fix.corrects
        blunders = {fault.effect.id for fault in self.arrays.situation.faults}
        return tuple(c for c in self.causes if wanted is None or c.effect in wanted or c.effect in blunders)

    @property
    def table(self) -> "DataFrame":
        """The causes as a table, a row per parameter; SI units, 95 % intervals."""
        from pandas import DataFrame

        rows = [
            {
                **{key: cause[key] for key in ("effect", "form", "probability", "share")},
                "parameter": name,
                **dict(zip(("value", "low_95", "high_95"), (quantity["value"], *quantity["ci95"]), strict=True)),
                "unit": quantity["unit"],
            }
            for cause in self.to_dict()["causes"]
            for name, quantity in cause["parameters"].items()
        ]
        return DataFrame(rows)

    def to_dict(self) -> dict[str, Any]:
        """Return what ``calib diagnose --json`` writes, with the paper's headline where load is the cause."""
        document = plain_fields(
            self,
            rest=self.unexplained or self.left,
            undetectable={limit.effect: limit.sentence for limit in self.undetectable},
            recommended=self.recommended,
        )
        return {"format": FORMAT, **document, "headline": plain(in_words(SENTENCES).headline(self))}


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Plan(Result):
    """The runs to drive next."""

    campaign: Campaign
    diagnosis: Diagnosis  #: so far
    runs: tuple[PlannedRun, ...]  #: best first
    now: "Promise | None" = None  #: intervals of radii, track and the like by the runs driven; None: they tell nothing
    then: "Promise | None" = None  #: with those to drive next

    @property
    def table(self) -> "DataFrame":
        """The runs as a table."""
        from pandas import DataFrame

        return DataFrame([run.to_dict() for run in self.runs])

    def to_dict(self) -> dict[str, Any]:
        """Return the plan as plain values: what ``calib plan --json`` prints."""
        document = self.diagnosis.to_dict()
        geometry = {"now": self.now and self.now.to_dict(), "then": self.then and self.then.to_dict()}
        kept = {key: document[key] for key in ("verdict", "simulated", "indistinguishable")}
        return {**kept, "next_runs": plain(self.runs), "geometry": geometry}
