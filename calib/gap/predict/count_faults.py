"""Gross encoder faults: a factor, swapped sides or a reversed sign, found before anything finer is asked."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from calib.arrays import FloatArray
from calib.gap.data.observations import Observations
from calib.gap.predict.path import Path, predict
from calib.gap.predict.residuals import residuals
from calib.gap.verdict.result import Cause, Quantity

__all__ = ["GrossFault", "corrected", "find_gross", "gross_cause"]

FACTORS: Final = {"2": 2.0, "4": 4.0, "pi": np.pi, "1/2": 0.5, "1/4": 0.25, "1/pi": 1 / np.pi, "10": 10.0, "1/10": 0.1}
#: a fault is gross where runs are off by more than this share of their length (or of a radian) on average
GROSS: Final = 0.08
#: and a correction is believed where it leaves less than this share of that
CLOSES: Final = 0.2


@dataclass(frozen=True, slots=True)
class GrossFault:
    """What the counts have to be multiplied by to be right; sides swapped first where `swapped`."""

    label: str
    left: float
    right: float
    swapped: bool = False


def _candidates() -> list[GrossFault]:
    made = [GrossFault("swapped wheels", 1.0, 1.0, swapped=True)]
    for label, factor in FACTORS.items():
        made.append(GrossFault(f"both wheels' counts are to be multiplied by {label}", factor, factor))
        made.append(GrossFault(f"the left wheel's counts are to be multiplied by {label}", factor, 1.0))
        made.append(GrossFault(f"the right wheel's counts are to be multiplied by {label}", 1.0, factor))
    made.append(GrossFault("the left wheel counts backwards", -1.0, 1.0))
    made.append(GrossFault("the right wheel counts backwards", 1.0, -1.0))
    made.append(GrossFault("both wheels count backwards", -1.0, -1.0))
    made.append(GrossFault("swapped wheels, both counting backwards", -1.0, -1.0, swapped=True))
    return made


def corrected(s: Observations, fault: GrossFault) -> Observations:
    """Return the situation with the counts put right."""
    left, right = (s.roll_right_rad, s.roll_left_rad) if fault.swapped else (s.roll_left_rad, s.roll_right_rad)
    phase = (s.phase_right_rad, s.phase_left_rad) if fault.swapped else (s.phase_left_rad, s.phase_right_rad)
    return replace(
        s,
        roll_left_rad=left * fault.left,
        roll_right_rad=right * fault.right,
        phase_left_rad=phase[0] * fault.left,
        phase_right_rad=phase[1] * fault.right,
    )


def misfit(path: Path) -> FloatArray:
    """Return how far each unit is off, as a share of its length and per radian, 1 at most, shape (n_units,)."""
    s = path.s
    gap = np.abs(residuals(path, path))
    length = np.maximum(np.hypot(s.measured[:, 1], s.measured[:, 2]), np.nan_to_num(s.measured[:, 0]))
    length = np.where(np.isfinite(length) & (length > 0.5), length, np.maximum(s.length_m, 0.5))
    ways = np.where(s.usable[:, :3], gap[:, :3], 0.0).max(axis=1) / length
    made: FloatArray = np.minimum(np.maximum(ways, np.where(s.usable[:, 3], gap[:, 3], 0.0)), 1.0)
    return made


def find_gross(s: Observations, nominal: Path) -> GrossFault | None:
    """Return the gross fault that puts the counts right, None where the counts are roughly right or nothing helps.

    Parameters
    ----------
    s : Observations
        What was driven.
    nominal : Path
        The model alone.
    """
    if np.isfinite(s.simulated).any():
        return None
    now = float(np.mean(misfit(nominal)))
    if now < GROSS:
        return None
    tried = [
        (float(np.mean(misfit(predict(corrected(s, fault))))), number) for number, fault in enumerate(_candidates())
    ]
    best, number = min(tried)
    return _candidates()[number] if best < CLOSES * now and best < GROSS else None


def gross_cause(fault: GrossFault) -> Cause:
    """Return a gross fault as the cause that a verdict names: its factors on the counts are plain numbers."""
    quantities = {
        "factor_left": Quantity(fault.left, (fault.left, fault.left), "1"),
        "factor_right": Quantity(fault.right, (fault.right, fault.right), "1"),
    }
    return Cause(
        effect="encoder_gross",
        title="a gross fault of the encoders",
        form=fault.label,
        probability=1.0,
        share=1.0,
        signal=float("inf"),
        parameters=quantities,
        remark="put the counts right, then diagnose again",
    )
