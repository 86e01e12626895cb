"""The answer: a verdict with its causes, what cannot be told apart, and what the fix is worth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Final

from calib.gap.verdict.outcome import (
    Closure,
    Detectable,
    Fix,
    Group,
    NoiseSummary,
    PlannedRunAdvice,
    Rest,
    json_number,
)
from calib.gap.where.result import Where

FORMAT: Final = "calib-diagnosis/1"
#: all causes of a recommended fix together are at least so probable
SURE: Final = 0.6
#: corrections nearer than this many floors are alike
ALIKE: Final = 1.0
#: what the gap was judged against, where no file was given: the campaign's own model, or an outside simulator
BY_MODEL: Final = "model"
BY_SIMULATOR: Final = "sim columns of runs.csv"


class VerdictKind(StrEnum):
    """Which verdict it is."""

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

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        return {"value": json_number(self.value), "ci95": [json_number(end) for end in self.ci95], "unit": self.unit}


@dataclass(frozen=True, slots=True)
class Cause:
    """A named cause.

    Parameters
    ----------
    effect : str
        Id of the effect.
    title : str
        What it is, for people.
    form : str
        Which form of the effect fits best; empty where there is one only.
    probability : float
        Probability that it is at work.
    share : float
        Share of the gap beyond the floor that it carries (whitened squares).
    signal : float
        Whitened norm of what it does once a recalibration took its share (for the calibration's own: as it is).
    parameters : mapping of str to Quantity
        Its parameters.
    plausible : bool
        Whether its size is physically plausible.
    remark : str
        A sentence on its size where that is called for.
    settings : mapping of str to float
        Quantities of the form that are not fitted linearly.
    share_ci95 : tuple of float or None
        Interval of the share; None where it was not determined.
    family : str
        Which family of effects it belongs to (``load``, ``drift``, ``instrument``, ...); empty where unknown.
    forms_open : tuple of str
        Effects of its family, itself aside, whose form would do as well.
    undetermined : tuple of str
        Parameters that these runs do not determine: their values are in `parameters`, and are not given out.
    """

    effect: str
    title: str
    form: str
    probability: float
    share: float
    signal: float
    parameters: Mapping[str, Quantity]
    plausible: bool = True
    remark: str = ""
    settings: Mapping[str, float] = field(default_factory=dict)
    share_ci95: tuple[float, float] | None = None
    family: str = ""
    forms_open: tuple[str, ...] = ()
    undetermined: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        return {
            "effect": self.effect,
            "title": self.title,
            "form": self.form,
            "settings": {name: json_number(value) for name, value in self.settings.items()},
            "probability": json_number(self.probability),
            "share": json_number(self.share),
            "share_ci95": None if self.share_ci95 is None else [json_number(end) for end in self.share_ci95],
            "signal": json_number(self.signal),
            "parameters": {
                name: quantity.to_dict() for name, quantity in self.parameters.items() if name not in self.undetermined
            },
            "undetermined": list(self.undetermined),
            "plausible": self.plausible,
            "remark": self.remark,
            "family": self.family,
            "forms_open": list(self.forms_open),
        }


@dataclass(frozen=True, slots=True)
class Verdict:
    """The verdict on a campaign's gap.

    Parameters
    ----------
    kind : VerdictKind
        Which verdict.
    sentence : str
        The verdict in words.
    causes : tuple of Cause
        What it names, most probable first.
    credible_sets : tuple of tuple of str
        The sets of causes that together hold 95 %, most probable first, and what could stand in for the first.
    groups : tuple of Group
        Effects that these runs cannot tell apart.
    undetectable : tuple of Detectable
        Effects that these runs could not have shown at their typical size.
    where : Where
        Channels, covariates, runs and places.
    closure : Closure
        How far the gap shrinks on runs left out.
    rest : Rest or None
        What no named cause explains; None where nothing is left.
    fix : Fix
        Whether the correction is recommended, and what it did where it was tried.
    next_runs : tuple of PlannedRunAdvice
        Runs to drive next, best first.
    notes : tuple of str
        What had to be left out or assumed.
    noise : NoiseSummary
        The floor.
    probabilities : mapping of str to float
        Of each effect, and of ``unknown``, being at work, largest first.
    judged_against : str
        ``model``, ``sim columns of runs.csv``, or the name of a coefficient file.
    campaign : str
        Its name.
    simulated : bool
        Whether its data were made by a program.
    gap_probability : float or None
        That anything is off at all; None where nothing says.
    """

    kind: VerdictKind
    sentence: str
    causes: tuple[Cause, ...] = ()
    credible_sets: tuple[tuple[str, ...], ...] = ()
    groups: tuple[Group, ...] = ()
    undetectable: tuple[Detectable, ...] = ()
    where: Where = field(default_factory=Where)
    closure: Closure = field(default_factory=Closure)
    rest: Rest | None = None
    fix: Fix = field(default_factory=Fix)
    next_runs: tuple[PlannedRunAdvice, ...] = ()
    notes: tuple[str, ...] = ()
    noise: NoiseSummary = field(default_factory=NoiseSummary)
    probabilities: Mapping[str, float] = field(default_factory=dict)
    judged_against: str = BY_MODEL
    campaign: str = ""
    simulated: bool = False
    gap_probability: float | None = None

    @property
    def against(self) -> str:
        """What the gap was judged against, in words."""
        return "the campaign's own model" if self.judged_against == BY_MODEL else self.judged_against

    @property
    def recommended(self) -> bool:
        """Whether the fix is recommended."""
        return self.fix.recommended

    def to_dict(self) -> dict[str, Any]:
        """Return the verdict as plain JSON values, in the shape of ``calib diagnose --json``."""
        return {
            "format": FORMAT,
            "campaign": self.campaign,
            "simulated": self.simulated,
            "verdict": self.kind.value,
            "gap_probability": None if self.gap_probability is None else json_number(self.gap_probability),
            "sentence": self.sentence,
            "judged_against": self.judged_against,
            "causes": [cause.to_dict() for cause in self.causes],
            "credible_sets": [list(names) for names in self.credible_sets],
            "indistinguishable": [list(group.effects) for group in self.groups],
            "undetectable": {limit.effect: limit.sentence for limit in self.undetectable},
            "where": self.where.to_dict(),
            "closure": self.closure.to_dict(),
            "rest": None if self.rest is None else self.rest.to_dict(),
            "fix": self.fix.to_dict(),
            "recommended": self.recommended,
            "next_runs": [run.to_dict() for run in self.next_runs],
            "probabilities": {name: json_number(value) for name, value in self.probabilities.items()},
            "noise": self.noise.to_dict(),
            "notes": list(self.notes),
        }
