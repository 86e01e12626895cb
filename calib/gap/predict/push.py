"""What a parameter of an effect does to wheels, track, path and readings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.arrays import FloatArray
from calib.gap.data.channels import N_CHANNELS, Channel
from calib.gap.data.observations import Observations


@dataclass(frozen=True, slots=True, eq=False)
class Push:
    """What one parameter of an effect does, per unit of the parameter, to first order."""

    #: left, right: shape (n_units,) or (n_steps,): relative change of what the left and right wheel really travel for
    #: their counts
    left: FloatArray | None = None
    right: FloatArray | None = None
    track: FloatArray | None = None  #: shape (n_units,) or (n_steps,): relative change of the track
    #: heading_rad, along_m, lateral_m: shape (n_steps,): what the vehicle turns, and moves along and to its left, in
    #: each step beyond what its wheels say
    heading_rad: FloatArray | None = None
    along_m: FloatArray | None = None
    lateral_m: FloatArray | None = None
    #: shape (n_units, 6): what is added to the reading of each channel (distance, along, lateral, heading, front,
    #: steering)
    reading: FloatArray | None = None

    @classmethod
    def on_readings(cls, observations: Observations, **by_channel: FloatArray | float) -> Push:
        """Return a push on readings alone, of the channels named (``distance=``), each shape (n_units,) or a number."""
        reading = np.zeros((len(observations), N_CHANNELS))
        for label, values in by_channel.items():
            reading[:, Channel[label.upper()]] = values
        return cls(reading=reading)

    def scaled(self, factor: float) -> Push:
        """Return the push times `factor`."""
        return Push(*(None if part is None else part * factor for part in self.parts()))

    def parts(self) -> tuple[FloatArray | None, ...]:
        """Return the seven fields in order."""
        return (self.left, self.right, self.track, self.heading_rad, self.along_m, self.lateral_m, self.reading)

    def part(self, units: slice, s: Observations) -> Push:
        """Return what is pushed of some units alone, of a push on all units of `s`."""
        n_steps = len(s.unit)
        steps = slice(int(s.starts[units.start]), int(s.starts[units.stop]))

        def of(part: FloatArray | None) -> FloatArray | None:
            return None if part is None else part[steps if len(part) == n_steps else units]

        parts = [of(part) for part in self.parts()]
        if self.right is self.left:
            parts[1] = parts[0]
        return Push(*parts)

    @property
    def of_units_only(self) -> bool:
        """Whether no field varies within a unit; decided by the caller's shapes in `signature`."""
        return self.heading_rad is None and self.along_m is None and self.lateral_m is None


def total_push(s: Observations, pushes: list[Push]) -> Push:
    """Add pushes up, per-unit arrays spread over the steps where another push varies within the unit."""
    summed: list[FloatArray | None] = [None] * 7
    n_steps = len(s.unit)
    for push in pushes:
        for number, part in enumerate(push.parts()):
            if part is None:
                continue
            have = summed[number]
            if have is None:
                summed[number] = part
            elif len(have) == len(part):
                summed[number] = have + part
            else:
                wide_have = have if len(have) == n_steps else have[s.unit]
                wide_part = part if len(part) == n_steps else part[s.unit]
                summed[number] = wide_have + wide_part
    return Push(*summed)
