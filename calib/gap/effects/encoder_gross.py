"""Gross encoder faults: a factor, swapped sides or a reversed sign, found before anything finer is asked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from calib.arrays import BoolArray, FloatArray
from calib.gap.effects.effect import Effect, Family, Form, Observations, Path
from calib.gap.predict.path import predict
from calib.gap.predict.residuals import residuals

FACTORS: Final = {"2": 2.0, "4": 4.0, "pi": np.pi, "1/2": 0.5, "1/4": 0.25, "1/pi": 1 / np.pi, "10": 10.0, "1/10": 0.1}
_SWAPPED: Final = "swapped wheels"
#: a fault is gross where runs are off by more than this share of their length (or of a radian) on average
GROSS: Final = 0.08
#: and a correction is believed where it leaves less than this share of that
CLOSES: Final = 0.2
#: rise over run, and radians, within which a run is straight: no route turns by so little
_ASIDE: Final = 0.2


class EncoderGross(Effect):
    """Factors of 2, 4, 10, pi on one wheel or both, swapped wheels, a sign.

    Such gaps are far from linear, so each fault is tried in full by `find_gross` before the search; there are no forms.
    """

    id = "encoder_gross"
    title = "a gross fault of the encoders"
    implausible = "a reference that was read in other units or axes"
    family = Family.COUNTS
    needs = "distances or end poses"
    separates = "any run: nothing else is so large"
    found_before_search = True

    def forms(self, observations: Observations) -> list[Form]:  # noqa: ARG002
        """Return none: the fault is found before the search."""
        return []


@dataclass(frozen=True, slots=True)
class GrossFault:
    """What the counts have to be multiplied by to be right; sides swapped first where `swapped`."""

    effect = EncoderGross

    label: str
    left: float
    right: float
    swapped: bool = False

    @property
    def remark(self) -> str:
        """What to do about it."""
        axes = "or the reference's axes (y to the left, angles counter-clockwise), " if self.swapped else ""
        return f"put the counts right, {axes}then diagnose again"

    @property
    def sizes(self) -> Mapping[str, tuple[float, tuple[float, float], str]]:
        """Value, 95 % interval and unit of each factor: plain numbers that are sure."""
        return {name: (factor, (factor, factor), "1") for name, factor in self.factors.items()}

    @property
    def factors(self) -> dict[str, float]:
        """What the counts are multiplied by, as the parameters that a verdict and a coefficient file show."""
        return {"factor_left": self.left, "factor_right": self.right}

    @classmethod
    def from_factors(cls, label: str, factors: Mapping[str, float]) -> GrossFault | None:
        """Return the fault of a label and its `factors`, None where one is missing or 0."""
        left, right = factors.get("factor_left"), factors.get("factor_right")
        return cls(label, left, right, swapped=label.startswith(_SWAPPED)) if left and right else None


def _candidates() -> list[GrossFault]:
    faults = [GrossFault(_SWAPPED, 1.0, 1.0, swapped=True)]
    for label, factor in FACTORS.items():
        faults.append(GrossFault(f"both wheels' counts are to be multiplied by {label}", factor, factor))
        faults.append(GrossFault(f"the left wheel's counts are to be multiplied by {label}", factor, 1.0))
        faults.append(GrossFault(f"the right wheel's counts are to be multiplied by {label}", 1.0, factor))
    faults.append(GrossFault("the left wheel counts backwards", -1.0, 1.0))
    faults.append(GrossFault("the right wheel counts backwards", 1.0, -1.0))
    faults.append(GrossFault("both wheels count backwards", -1.0, -1.0))
    faults.append(GrossFault(f"{_SWAPPED}, both counting backwards", -1.0, -1.0, swapped=True))
    return faults


def corrected(observations: Observations, fault: GrossFault) -> Observations:
    """Return the situation with the counts put right."""
    roll = [observations.roll_left_rad, observations.roll_right_rad]
    phase = [observations.phase_left_rad, observations.phase_right_rad]
    left, right = (1, 0) if fault.swapped else (0, 1)
    return replace(
        observations,
        roll_left_rad=roll[left] * fault.left,
        roll_right_rad=roll[right] * fault.right,
        phase_left_rad=phase[left] * fault.left,
        phase_right_rad=phase[right] * fault.right,
    )


def misfit(path: Path) -> FloatArray:
    """Return how far each unit is off, as a share of its length and per radian, 1 at most, shape (n_units,).

    A straight run is judged by its length and by how far its wheels differ: over a long one a radius that is half a
    per cent off, as one under load is, turns the vehicle by a quarter radian and leads it far aside.
    """
    observations = path.s
    gap = np.where(observations.usable, np.abs(residuals(path, path)), 0.0)
    length = np.maximum(
        np.hypot(observations.measured[:, 1], observations.measured[:, 2]), np.nan_to_num(observations.measured[:, 0])
    )
    length = np.where(np.isfinite(length) & (length > 0.5), length, np.maximum(observations.length_m, 0.5))
    straight = _straight(observations)
    ways = np.where(straight, gap[:, :2].max(axis=1), gap[:, :3].max(axis=1)) / length
    per_turn = np.where(straight, observations.model.track_m / length, 1.0)
    return np.asarray(np.minimum(np.maximum(ways, per_turn * gap[:, 3]), 1.0))


def _straight(observations: Observations) -> BoolArray:
    """Return which units were measured to end ahead, headed as at their beginning, shape (n_units,)."""
    measured, usable = observations.measured, observations.usable
    aside = usable[:, 2] & ~(np.abs(measured[:, 2]) < _ASIDE * np.abs(measured[:, 1]))
    turned = usable[:, 3] & ~(np.abs(measured[:, 3]) < _ASIDE)
    return np.asarray(~aside & ~turned)


def find_gross(observations: Observations, nominal: Path) -> GrossFault | None:
    """Return the gross fault that puts the counts right, None where the counts are roughly right or nothing helps."""
    if np.isfinite(observations.simulated).any():
        return None
    now = float(np.mean(misfit(nominal)))
    if now < GROSS:
        return None
    # a front wheel that drives the odometry has no other side
    candidates = [c for c in _candidates() if not observations.by_front or (c.left == c.right and not c.swapped)]
    tried = [
        (float(np.mean(misfit(predict(corrected(observations, fault))))), number)
        for number, fault in enumerate(candidates)
    ]
    best, number = min(tried)
    return candidates[number] if best < CLOSES * now and best < GROSS else None
