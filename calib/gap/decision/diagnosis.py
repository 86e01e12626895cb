"""The results: a diagnosis with its causes, its confounded effects and what its fix is worth; and the runs to drive."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from calib.campaign.model import Campaign
from calib.documents import Result, plain, plain_fields
from calib.gap.decision.evidence import Evidence
from calib.gap.decision.held_out import Closure, HeldOut, Improvement
from calib.gap.decision.trials import Trial
from calib.gap.effects.effect import Effect
from calib.gap.inference.fit import Fitted
from calib.gap.inference.noise import Noise
from calib.gap.localise.result import GapLocation
from calib.gap.observations.arrays import Channel, Observations
from calib.gap.plan.identifiability import DetectionLimit
from calib.gap.plan.planned_runs import PlannedRun
from calib.gap.predict import Path

if TYPE_CHECKING:
    from pandas import DataFrame

FORMAT: Final = "calib-diagnosis/1"
#: on which runs corrections are compared
DRIVEN: Final = "runs driven"
JOURNEYS: Final = "journeys"
#: what the gap is judged against where no file is given: the campaign's own model, or an outside simulator
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


@dataclass(frozen=True, slots=True)
class Cause:
    """A named cause."""

    effect: str  #: id of the effect
    title: str  #: what it is, for people
    form: str  #: best-fitting form of the effect; empty where there is one only
    probability: float  #: that the effect is at work
    share: float  #: of the gap above the noise level (whitened squares)
    #: whitened norm of the effect beside a free recalibration (of the calibration's own parameters: without it)
    signal: float
    parameters: Mapping[str, Quantity]
    plausible: bool = True  #: whether its size is physically plausible
    remark: str = ""  #: a sentence on its size where one is needed
    settings: Mapping[str, float] = field(default_factory=dict)  #: quantities of the form that are not fitted linearly
    share_ci95: tuple[float, float] | None = None  #: interval of the share; None where it is not determined
    family: str = ""  #: family of the effect (``load``, ``drift``, ``instrument``, ...); empty where unknown
    forms_open: tuple[str, ...] = ()  #: effects of its family that fit equally well
    undetermined: tuple[str, ...] = ()  #: parameters that these runs do not determine: not in the JSON

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        determined = {name: value for name, value in self.parameters.items() if name not in self.undetermined}
        return plain_fields(self, parameters=determined)


@dataclass(frozen=True, slots=True)
class Group:
    """Confounded effects, the named one first."""

    effects: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Unexplained:
    """The unexplained residual: its share of the gap, its signal, and where it lies, in words."""

    share: float
    signal: float
    where: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Fix:
    """What the correction is worth."""

    recommended: bool = False  #: whether to apply it
    #: largest difference between the corrections of confounded effects at the end; None where none are confounded
    agreement_m: float | None = None
    agreement_on: str = DRIVEN  #: on which runs: ``runs driven`` or ``journeys``
    nothing_else: float = 1.0  #: probability that no further effect of the library is at work
    transfer: tuple[Trial, ...] = ()  #: what it does on runs that it was not fitted on
    held_out: Improvement | None = None  #: what it does on held-out runs; None without a cause
    why: tuple[str, ...] = ()  #: what keeps it from being recommended, with figures and what settles it
    parameters: Mapping[str, float] = field(default_factory=dict)  #: what to set in the user's simulator
    corrects: tuple[str, ...] | None = None  #: the causes that it corrects, blunders apart; None: all that are named
    leaves: tuple[str, ...] = ()  #: why it leaves the other named causes as they are
    #: what it corrects by; None where that is the fit of all causes
    fitted: Fitted | None = field(default=None, metadata={"json": False})


@dataclass(frozen=True, slots=True)
class NoiseSummary:
    """The noise level, and what supports it."""

    dof: float = 0.0  #: degrees of freedom that replicates give it
    scales: Mapping[str, float] = field(default_factory=dict)  #: scale of each component
    supported: bool = True  #: whether the runs support a noise level at all
    support: str = ""  #: what supports it, in words; where nothing does, why
    excess: Mapping[str, float] = field(default_factory=dict)  #: channel -> noise level over that of the stated sigmas
    #: a sentence where the noise level is far above the stated sigmas
    finding: str = field(default="", metadata={"json": False})

    @classmethod
    def about(cls, noise: Noise) -> NoiseSummary:
        """Return the summary of a noise model."""
        excess = {
            channel.label: float(noise.excess[channel]) for channel in Channel if np.isfinite(noise.excess[channel])
        }
        return cls(noise.dof, noise.scales, noise.supported, noise.support, excess, noise.finding)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Diagnosis(Result):
    """What a campaign's gap is, which effects cause it, and whether their correction is recommended."""

    kind: VerdictKind = field(metadata={"json": "verdict"})
    sentence: str  #: the verdict in words
    causes: tuple[Cause, ...] = ()  #: named causes, most probable first
    #: the sets of causes that together hold 95 %, most probable first, and the alternatives to the first
    credible_sets: tuple[tuple[str, ...], ...] = ()
    groups: tuple[Group, ...] = field(default=(), metadata={"json": "indistinguishable"})  #: confounded effects
    undetectable: tuple[DetectionLimit, ...] = ()  #: effects that these runs would not show at typical size
    where: GapLocation = field(default_factory=GapLocation)  #: channels, covariates, runs and places of the gap
    closure: Closure = field(default_factory=Closure)  #: how far the gap shrinks on held-out runs
    unexplained: Unexplained | None = field(default=None, metadata={"json": "rest"})
    fix: Fix = field(default_factory=Fix)  #: what the correction is worth
    next_runs: tuple[PlannedRun, ...] = ()  #: runs to drive next, best first
    notes: tuple[str, ...] = ()  #: what was excluded or assumed
    noise_level: NoiseSummary = field(default_factory=NoiseSummary, metadata={"json": "noise"})
    probabilities: Mapping[str, float] = field(
        default_factory=dict
    )  #: of each effect and of ``unknown``, largest first
    judged_against: str = BY_MODEL  #: ``model``, ``sim columns of runs.csv``, or the name of a coefficient file
    campaign: str = ""  #: name of the campaign
    simulated: bool = False  #: whether a program made its data
    gap_probability: float | None = None  #: that there is a gap at all; None where it is not known
    #: what it was decided on: the arrays for figures, corrections and planning; None in a diagnosis written by hand
    evidence: Evidence | None = field(default=None, metadata={"json": False})

    @property
    def against(self) -> str:
        """What the gap was judged against, in words."""
        return "the campaign's own model" if self.judged_against == BY_MODEL else self.judged_against

    @property
    def recommended(self) -> bool:
        """Whether the fix is recommended."""
        return self.fix.recommended

    @property
    def _arrays(self) -> Evidence:
        if self.evidence is None:
            raise ValueError("this diagnosis has no arrays: it does not come from a campaign")
        return self.evidence

    @property
    def observations(self) -> Observations:
        """Observations and steps; the counts are corrected where they had a blunder."""
        return self._arrays.observations

    @property
    def noise(self) -> Noise:
        """Covariance of each observation."""
        return self._arrays.noise

    @property
    def nominal(self) -> Path:
        """The model alone."""
        return self._arrays.nominal

    @property
    def fitted(self) -> Fitted:
        """The most probable hypothesis, the recalibration free."""
        return self._arrays.fitted

    @property
    def correction(self) -> Fitted:
        """The fit that the fix corrects by: of all named causes, or of the sure ones alone."""
        return self.fix.fitted or self.fitted

    @property
    def corrected_causes(self) -> tuple[Cause, ...]:
        """The named causes that the fix corrects."""
        wanted = self.fix.corrects
        blunders = {fault.effect.id for fault in self._arrays.situation.faults}
        return tuple(c for c in self.causes if wanted is None or c.effect in wanted or c.effect in blunders)

    @property
    def held_out(self) -> HeldOut:
        """Residuals before and after on held-out runs."""
        return self._arrays.held_out

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The library that was searched."""
        return tuple(self._arrays.effects.values())

    @property
    def table(self) -> DataFrame:
        """The causes as a table, a row per parameter; SI units, 95 % intervals."""
        from pandas import DataFrame

        rows = [
            {
                **{key: cause[key] for key in ("effect", "form", "probability", "share")},
                "parameter": name,
                "value": quantity["value"],
                "low_95": quantity["ci95"][0],
                "high_95": quantity["ci95"][1],
                "unit": quantity["unit"],
            }
            for cause in self.to_dict()["causes"]
            for name, quantity in cause["parameters"].items()
        ]
        return DataFrame(rows)

    def to_dict(self) -> dict[str, Any]:
        """Return the diagnosis as plain JSON values, in the shape of ``calib diagnose --json``."""
        document = plain_fields(
            self,
            indistinguishable=[group.effects for group in self.groups],
            undetectable={limit.effect: limit.sentence for limit in self.undetectable},
            recommended=self.recommended,
        )
        return {"format": FORMAT, **document}


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Plan(Result):
    """The runs to drive next."""

    campaign: Campaign  #: what was driven
    diagnosis: Diagnosis  #: what it shows so far
    runs: tuple[PlannedRun, ...]  #: best first

    @property
    def table(self) -> DataFrame:
        """The runs as a table, best first."""
        from pandas import DataFrame

        return DataFrame([run.to_dict() for run in self.runs])

    def to_dict(self) -> dict[str, Any]:
        """Return the plan as plain values: what ``calib plan --json`` prints."""
        document = self.diagnosis.to_dict()
        kept = {key: document[key] for key in ("verdict", "indistinguishable")}
        return {**kept, "next_runs": plain(self.runs)}
