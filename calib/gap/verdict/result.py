"""The answer: a small dataclass that the report and the command line show."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

__all__ = ["SURE", "Cause", "Quantity", "Verdict"]

#: every cause of a recommended fix is at least so probable
SURE: Final = 0.6


@dataclass(frozen=True, slots=True)
class Quantity:
    """A fitted parameter with its 95 % interval."""

    value: float
    ci95: tuple[float, float]
    unit: str

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        return {"value": _number(self.value), "ci95": [_number(v) for v in self.ci95], "unit": self.unit}


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
    """

    effect: str
    title: str
    form: str
    probability: float
    share: float
    signal: float
    parameters: dict[str, Quantity]
    plausible: bool = True
    remark: str = ""
    settings: dict[str, float] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        return {
            "effect": self.effect,
            "title": self.title,
            "form": self.form,
            "settings": {k: _number(v) for k, v in self.settings.items()},
            "probability": _number(self.probability),
            "share": _number(self.share),
            "signal": _number(self.signal),
            "parameters": {name: quantity.to_dict() for name, quantity in self.parameters.items()},
            "plausible": self.plausible,
            "remark": self.remark,
        }


@dataclass(frozen=True, slots=True)
class Verdict:
    """The verdict on a campaign's gap; the fields are those of the contract, in `to_dict`'s order."""

    verdict: str
    sentence: str
    causes: tuple[Cause, ...]
    credible_sets: tuple[tuple[str, ...], ...]
    indistinguishable: tuple[tuple[str, ...], ...]
    undetectable: dict[str, str]
    where: dict[str, Any]
    closure: dict[str, Any]
    recommended: bool
    next_runs: tuple[dict[str, Any], ...]
    notes: tuple[str, ...]
    noise: dict[str, Any]
    probabilities: dict[str, float]
    campaign: str
    simulated: bool

    def to_dict(self) -> dict[str, Any]:
        """Return the verdict as plain JSON values, in the shape of the contract and more."""
        return {
            "format": "calib-diagnosis/1",
            "campaign": self.campaign,
            "simulated": self.simulated,
            "verdict": self.verdict,
            "sentence": self.sentence,
            "causes": [cause.to_dict() for cause in self.causes],
            "credible_sets": [list(group) for group in self.credible_sets],
            "indistinguishable": [list(group) for group in self.indistinguishable],
            "undetectable": dict(self.undetectable),
            "where": self.where,
            "closure": self.closure,
            "recommended": self.recommended,
            "next_runs": [dict(run) for run in self.next_runs],
            "probabilities": {name: _number(value) for name, value in self.probabilities.items()},
            "noise": self.noise,
            "notes": list(self.notes),
        }


def _number(value: float) -> float | None:
    """Return a float that JSON can say, None where it is not finite."""
    return float(value) if np.isfinite(value) else None
