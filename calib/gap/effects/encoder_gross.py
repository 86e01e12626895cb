"""A gross fault of the encoders: a factor, swapped sides, a sign."""

from __future__ import annotations

from typing import ClassVar, Final

import numpy as np

from calib.arrays import BoolArray, FloatArray
from calib.gap.data.observations import Observations
from calib.gap.effects.effect import Effect, Form, Parameter
from calib.gap.predict.path import Path, Push, predict

__all__ = ["EncoderGross"]


#: by how much the counts are too many
FACTORS: Final = {"2": 2.0, "4": 4.0, "pi": np.pi, "1/2": 0.5, "1/4": 0.25, "1/pi": 1.0 / np.pi}
#: a fault is offered where it leaves no more than this share of the contradictions
_LEFT_OPEN: Final = 0.2


class EncoderGross(Effect):
    """Factors of 2, 4, pi on one wheel or both, swapped wheels, a sign; only where the gap itself is gross.

    Such gaps are far from linear. So each fault is tried in full, and those that settle the contradictions are offered
    as a share of the full fault; ``settings["start"]`` is where a fit has to begin.
    """

    id: ClassVar[str] = "encoder_gross"
    title: ClassVar[str] = "a gross fault of the encoders"
    implausible: ClassVar[str] = "a reference that was read in other units or axes"

    def forms(self, s: Observations) -> list[Form]:
        """Return the faults that settle it, on the runs that contradict the model; none where no run does so grossly.

        Where none does, a free factor of the left wheel, the right wheel and both.
        """
        struck = _struck(s, predict(s))
        if not struck.any():
            return []
        acts = struck.astype(np.float64)
        faults = _faults(s, acts)
        share = Parameter("share", "1", typical=1.0, largest=1.5, sign=1)

        def left_open(push: Push) -> float:
            still = _struck(s, predict(s, [push]))
            return float(np.count_nonzero(still)) / float(np.count_nonzero(struck))

        settled = {label: push for label, push in faults.items() if left_open(push) <= _LEFT_OPEN}
        if settled:
            return [
                Form(self.id, label, (share,), lambda _, push=push: [push], {"start": 1.0}, tries=len(settled))  # type: ignore[misc]
                for label, push in settled.items()
            ]
        change = Parameter("travel_factor_less_1", "1", typical=1.0, largest=4.0)
        free = {
            "a factor of the left wheel": Push(left=acts),
            "a factor of the right wheel": Push(right=acts),
            "a factor of both wheels": Push(left=acts, right=acts),
        }
        return [
            Form(self.id, label, (change,), lambda _, push=push: [push], tries=len(free))  # type: ignore[misc]
            for label, push in free.items()
        ]


def _faults(s: Observations, acts: FloatArray) -> dict[str, Push]:
    """Return what each fault in full does to the runs that `acts`, shape (n_units,), is 1 for."""
    made: dict[str, Push] = {}
    for name, factor in FACTORS.items():
        change = (1.0 / factor - 1.0) * acts
        made[f"left counts times {name}"] = Push(left=change)
        made[f"right counts times {name}"] = Push(right=change)
        made[f"all counts times {name}"] = Push(left=change, right=change)
    turned = -2.0 * acts
    made["sign of the left counts"] = Push(left=turned)
    made["sign of the right counts"] = Push(right=turned)
    made["sign of all counts"] = Push(left=turned, right=turned)
    # each wheel really travelled what the other one's counts say
    on = acts[s.unit]
    with np.errstate(divide="ignore", invalid="ignore"):
        left = np.where(s.travel_left_m != 0.0, s.travel_right_m / s.travel_left_m - 1.0, 0.0)
        right = np.where(s.travel_right_m != 0.0, s.travel_left_m / s.travel_right_m - 1.0, 0.0)
    made["swapped wheels"] = Push(left=left * on, right=right * on)
    return made


def _struck(s: Observations, path: Path) -> BoolArray:
    """Say which units contradict a path by more than a fifth in distance or heading, or its side, shape (n_units,)."""
    length = np.maximum(s.total(np.abs(path.ds_m)), 1e-3)
    # along the bent line, so that a straying heading does not pass for a wrong distance
    line = np.abs(s.total(path.ds_m * path.weave_cos))
    with np.errstate(invalid="ignore"):
        by_distance = np.abs(s.measured[:, 0] - line) > 0.2 * np.maximum(line, 0.2 * length)
        turned = np.abs(s.measured[:, 3] - path.end[:, 2])
        # wheels that differ by 5 % are beyond any unequal radii; a radian beyond any straying on a straight run
        by_heading = (
            (turned > 0.2 * np.abs(path.end[:, 2])) & (turned > 0.5) & (turned * s.model.track_m > 0.05 * length)
        )
    measured, predicted = s.measured[:, 1:3], path.end[:, :2]
    far = np.minimum(np.hypot(measured[:, 0], measured[:, 1]), np.hypot(predicted[:, 0], predicted[:, 1]))
    with np.errstate(invalid="ignore"):
        # driven to the opposite side, and well away from the start
        opposite = (np.sum(measured * predicted, axis=1) < -0.5 * far**2) & (far > 0.3 * length)
    struck: BoolArray = (by_distance & s.usable[:, 0]) | (by_heading & s.usable[:, 3]) | (opposite & s.usable[:, 1])
    return struck
