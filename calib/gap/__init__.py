"""Motion step by step under a hypothesis, and what a perturbation changes at the end of each observation."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Final

import numpy as np

from calib.gap.observations import N_CHANNELS, Channel, Observations
from calib.gap.observations.observation import let_go, step_array
from calib.types import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Perturbation:
    """What one parameter of an effect does, per unit of the parameter, to first order."""

    #: left, right: shape (n_obs,) or (n_steps,): relative change of the wheels' true travel for their counts
    left: FloatArray | None = None
    right: FloatArray | None = None
    track: FloatArray | None = None  #: shape (n_obs,) or (n_steps,): relative change of the track
    #: heading_rad, along_m, lateral_m: shape (n_steps,): motion of each step beyond what the wheels say
    heading_rad: FloatArray | None = None
    along_m: FloatArray | None = None
    lateral_m: FloatArray | None = None
    #: shape (n_obs, 6): what is added to the reading of each channel (distance, along, lateral, heading, front,
    #: steering)
    reading: FloatArray | None = None
    #: shape (n_obs,): angle in rad by which the axes turn that along and lateral are read in, about the start
    turned_rad: FloatArray | None = None
    #: end_arc, start_arc: shape (n_obs, 2): way and turn of the arc from end and start to the pose read in its place
    end_arc: FloatArray | None = None
    start_arc: FloatArray | None = None
    delay_s: FloatArray | None = None  #: shape (n_obs,): time before the end at which the pose was read
    #: shape (n_obs, 2): slope in m/N that it gives the left and right radius; a payload that is misreported acts by it
    law_slopes: FloatArray | None = None

    @classmethod
    def on_readings(cls, observations: Observations, **by_channel: FloatArray | float) -> "Perturbation":
        """Return a perturbation of the readings of named channels (``distance=``), each shape (n_obs,) or a number."""
        reading = np.zeros((len(observations), N_CHANNELS))
        for label, values in by_channel.items():
            reading[:, Channel[label.upper()]] = values
        return cls(reading=reading)

    def scaled(self, factor: float) -> "Perturbation":
        """Return the perturbation times `factor`."""
        return Perturbation(*(None if part is None else part * factor for part in self.parts()))

    def parts(self) -> tuple[FloatArray | None, ...]:
        """Return the fields in order."""
        return tuple(getattr(self, field.name) for field in fields(self))

    def is_of_observations(self, s: Observations) -> bool:
        """Return whether it is the same in all steps of each observation, so that its signature needs no steps."""
        along = (self.heading_rad, self.along_m, self.lateral_m, self.delay_s)
        wheels = (part for part in (self.left, self.right, self.track) if part is not None)
        return all(part is None for part in along) and all(len(part) == len(s) != len(s.unit) for part in wheels)

    def part(self, units: slice, s: Observations) -> "Perturbation":
        """Return the perturbation of some observations alone, from one of all observations of `s`."""
        n_steps = len(s.unit)
        steps = slice(int(s.starts[units.start]), int(s.starts[units.stop]))

        def of(part: FloatArray | None) -> FloatArray | None:
            return None if part is None else part[steps if len(part) == n_steps else units]

        parts = [of(part) for part in self.parts()]
        if self.right is self.left:
            parts[1] = parts[0]
        return Perturbation(*parts)


#: fields that change the readings at the ends alone
AT_ENDS: Final = ("reading", "turned_rad", "end_arc", "start_arc", "delay_s")


def total_perturbation(s: Observations, perturbations: list[Perturbation]) -> Perturbation:
    """Add perturbations up; arrays per observation are spread over the steps where another varies with the step."""
    n_steps = len(s.unit)

    def added(have: FloatArray | None, part: FloatArray | None) -> FloatArray | None:
        if have is None or part is None or len(have) == len(part):
            return part if have is None else have if part is None else have + part
        wide_have, wide_part = (each if len(each) == n_steps else each[s.unit] for each in (have, part))
        return wide_have + wide_part

    summed = Perturbation().parts()
    for perturbation in perturbations:
        summed = tuple(added(*pair) for pair in zip(summed, perturbation.parts(), strict=True))
    return Perturbation(*summed)


def joined_perturbation(s: Observations, parts: Iterable[tuple[slice, Perturbation]]) -> Perturbation:
    """Join the perturbations of some observations each, or that of all; what one of them lacks is zero there.

    One by one, for half the memory.
    """
    n_steps, wholes = len(s.unit), list(Perturbation().parts())
    for units, part in parts:
        if units == slice(0, len(s)):
            return part
        let_go(*wholes)
        steps = slice(int(s.starts[units.start]), int(s.starts[units.stop]))
        for number, piece in enumerate(part.parts()):
            if piece is None:
                continue
            whole, by_step = wholes[number], len(piece) > units.stop - units.start
            if whole is None:
                whole = step_array(n_steps) if by_step else np.zeros((len(s), *piece.shape[1:]))
            elif by_step and len(whole) < n_steps:
                whole = whole[s.unit]
            wholes[number] = whole
            wide = len(whole) == n_steps
            whole[steps if wide else units] = piece if by_step or not wide else piece[s.unit[steps] - units.start]
    return Perturbation(*wholes)


#: what is summed over an observation: displacement of the end point, turn, distance along the guide line, distance
X, Y, TURN, LINE, WAY = range(5)
N_SUMS: Final = 5
#: a pose read ahead of the counts lies on the motion of their last tenth of a second
EXTRAPOLATED_S: Final = 0.1
#: where fewer than one step in so many has a part, the others are passed over
SPARSE_SHARE: Final = 4


#: which of X, Y, TURN, LINE and WAY a change of 1 at each step adds to, and how much, (n_sums, n_steps)
Lever = tuple[tuple[int, ...], FloatArray]


class Steps:
    """Steps of every observation under a hypothesis that is already scaled, each in the frame of its own start.

    Counts are integrated in exact arcs.
    """

    def __init__(self, s: Observations, perturbation: Perturbation) -> None:
        unit, self.s = s.unit, s

        def wide(part: FloatArray) -> FloatArray:
            return part if len(part) == len(unit) else part[unit]

        # most hypotheses leave most of this alone
        left = s.travel_left_m if perturbation.left is None else s.travel_left_m * (1.0 + wide(perturbation.left))
        right = s.travel_right_m if perturbation.right is None else s.travel_right_m * (1.0 + wide(perturbation.right))
        track = s.model.track_m * (np.ones(1) if perturbation.track is None else 1.0 + wide(perturbation.track))
        ds, turn = 0.5 * (left + right), (right - left) / track
        off = (part for part in (perturbation.left, perturbation.right) if s.by_front and part is not None)
        grown = 1.0 + 0.5 * sum(wide(part) for part in off)
        if perturbation.along_m is not None:
            ds += grown * wide(perturbation.along_m)
        if perturbation.heading_rad is not None:
            turn += grown * wide(perturbation.heading_rad)
        slip = None if perturbation.lateral_m is None else wide(perturbation.lateral_m)
        if s.aside_m is not None:
            sides = (perturbation.left, perturbation.right)
            by_left, by_right = (0.0 if part is None else wide(part) for part in sides)
            aside = s.aside_m * (1.0 + 0.5 * (by_left + by_right))
            slip = aside if slip is None else slip + aside
        heading = s.cumulative(turn)
        #: shape (n_steps,): heading at the middle of each step, its cosine and its sine
        self.mid_rad = heading - 0.5 * turn + _bend(s, turn)
        self.cos, self.sin = np.cos(self.mid_rad), np.sin(self.mid_rad)
        half = 0.5 * turn
        chord = ds * (1.0 - half * half / 6.0)
        dx, dy = chord * self.cos, chord * self.sin
        if slip is not None:
            dx -= slip * self.sin
            dy += slip * self.cos
        x, y = s.cumulative(dx), s.cumulative(dy)
        last = s.starts[1:] - 1
        #: shape (n_steps,): travel of the wheels; motion of the axle's middle along, and its turn
        self.ds_left_m, self.ds_right_m, self.ds_m, self.turn_rad = left, right, ds, turn
        self.track_m = track  #: shape (n_steps,) or (1,)
        #: shape (n_steps,): position at the middle of each step
        self.x_m, self.y_m = x - 0.5 * dx, y - 0.5 * dy
        self.end = np.stack([x[last], y[last], heading[last]], axis=1)  #: shape (n_obs, 3): end pose

    @cached_property
    def lever_x(self) -> FloatArray:
        """What a turn at a step moves the end point in x, per radian, shape (n_steps,)."""
        return np.asarray(self.y_m - self.end[self.s.unit, 1])

    @cached_property
    def lever_y(self) -> FloatArray:
        """What a turn at a step moves the end point in y, per radian, shape (n_steps,)."""
        return np.asarray(self.end[self.s.unit, 0] - self.x_m)

    @cached_property
    def weave_cos(self) -> FloatArray:
        """Cosine of the heading about its own straight trend in each observation, shape (n_steps,)."""
        s = self.s
        weight = np.abs(self.ds_m)
        along = s.cumulative(weight) - 0.5 * weight
        total = np.maximum(s.total(weight), 1e-9)
        mean_a = s.total(weight * along) / total
        mean_h = s.total(weight * self.mid_rad) / total
        da, dh = along - mean_a[s.unit], self.mid_rad - mean_h[s.unit]
        slope = s.total(weight * da * dh) / np.maximum(s.total(weight * da * da), 1e-12)
        return np.cos(dh - slope[s.unit] * da)

    def lever(self, name: str) -> Lever:
        """Return the lever of a field of a perturbation, or of ``both`` wheels' travel; each is worked out once."""
        known: dict[str, Lever] = vars(self).setdefault("known_levers", {})
        if name not in known:
            known[name] = _LEVERS[name](self)
        return known[name]

    def _by_wheel(self, travel_m: FloatArray, sense: float) -> Lever:
        by_step = np.empty((N_SUMS, len(travel_m)))
        x, y, turn, line, ds = by_step
        np.multiply(0.5, travel_m, out=ds)
        np.divide(sense * travel_m, self.track_m, out=turn)
        np.add(ds * self.cos, turn * self.lever_x, out=x)
        np.add(ds * self.sin, turn * self.lever_y, out=y)
        np.multiply(ds, self.weave_cos, out=line)
        if self.s.aside_m is not None:
            x -= 0.5 * self.s.aside_m * self.sin
            y += 0.5 * self.s.aside_m * self.cos
        return (X, Y, TURN, LINE, WAY), by_step

    def _by_both(self) -> Lever:
        sums, left = self.lever("left")
        return sums, left + self.lever("right")[1]

    def _by_track(self) -> Lever:
        turn = -(self.ds_right_m - self.ds_left_m) / self.track_m
        return (X, Y, TURN), np.stack([turn * self.lever_x, turn * self.lever_y, turn])

    def motion_before_end(self, delay_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return way along and turn in the last `delay_s` (n_obs,) of each observation, each shape (n_obs,).

        Below zero, what would follow the end if the motion of its last `EXTRAPOLATED_S` went on, with a minus sign.
        """
        s = self.s
        duration = np.nan_to_num(s.duration_s)
        age_s = s.time_s[s.starts[1:] - 1][s.unit] - s.time_s
        within = np.where(delay_s < 0.0, EXTRAPOLATED_S, delay_s)
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.nan_to_num(np.clip(within[s.unit] - age_s, 0.0, duration) / duration)
            factor = np.where(delay_s < 0.0, delay_s / EXTRAPOLATED_S, 1.0)
        # of the faster wheel: in a straight run the turn is noise, in one on the spot the way
        at_end = _speed_at_end(s, np.maximum(abs(self.ds_left_m), abs(self.ds_right_m)), duration)
        share *= at_end + share * (1.0 - at_end)
        return factor * s.total(share * self.ds_m), factor * s.total(share * self.turn_rad)

    def sums(self, perturbation: Perturbation) -> FloatArray:
        """Return what a perturbation adds to the sums of each observation, to first order, shape (5, n_obs)."""
        s, summed = self.s, np.zeros((N_SUMS, len(self.s)))
        for part, (sums, by_step) in self._levers(perturbation):
            if len(part) == len(s):
                summed[list(sums)] += np.add.reduceat(by_step, s.starts[:-1], axis=1) * part
                continue
            takes_part = part != 0.0
            if np.count_nonzero(takes_part) * SPARSE_SHARE < len(part):
                # a place, a stop: most steps have no part in it
                index = np.flatnonzero(takes_part)
                weighted, unit = by_step.take(index, axis=1) * part[index], s.unit[index]
                for number, values in zip(sums, weighted, strict=True):
                    summed[number] += np.bincount(unit, values, len(s))
            else:
                summed[list(sums)] += np.add.reduceat(by_step * part, s.starts[:-1], axis=1)
        return summed

    def _levers(self, perturbation: Perturbation) -> Iterator[tuple[FloatArray, Lever]]:
        both = perturbation.left is perturbation.right
        parts = {name: getattr(perturbation, name) for name in _LEVERS if name != "both"}
        parts |= {"both": parts["left"], "left": None, "right": None} if both else {}
        yield from ((part, self.lever(name)) for name, part in parts.items() if part is not None)


#: field of a perturbation -> its lever: of travel and track relative, of heading, way along and way to the left
_LEVERS: Final[dict[str, Callable[[Steps], Lever]]] = {
    "both": Steps._by_both,
    "left": lambda s: s._by_wheel(s.ds_left_m, -1.0),
    "right": lambda s: s._by_wheel(s.ds_right_m, 1.0),
    "track": Steps._by_track,
    "heading_rad": lambda s: ((X, Y, TURN), np.stack([s.lever_x, s.lever_y, np.ones_like(s.lever_x)])),
    "along_m": lambda s: ((X, Y, LINE, WAY), np.stack([s.cos, s.sin, s.weave_cos, np.ones_like(s.cos)])),
    "lateral_m": lambda s: ((X, Y), np.stack([-s.sin, s.cos])),
}


def _speed_at_end(s: Observations, way_m: FloatArray, duration_s: FloatArray) -> FloatArray:
    """Return each step's speed at its end over its mean, shape (n_steps,), 0 to 2: it changes evenly between steps."""
    with np.errstate(divide="ignore", invalid="ignore"):
        speed = way_m / duration_s
        slope = 2.0 * np.diff(speed) / (duration_s[1:] + duration_s[:-1])
        last = s.starts[1:] - 1
        after = np.append(slope, np.nan)
        after[last] = np.where(np.diff(s.starts) > 1, after[last - 1], np.nan)
        return np.asarray(np.clip(np.nan_to_num(1.0 + 0.5 * duration_s * after / speed, nan=1.0), 0.0, 2.0))


def _bend(s: Observations, turn: FloatArray) -> FloatArray:
    """Return by how much the mean heading of each step differs from the mean of its ends, shape (n_steps,)."""
    bend = np.zeros(len(turn))
    bend[1:-1] = (turn[:-2] - turn[2:]) / 24.0
    bend[s.starts[:-1]] = 0.0
    bend[s.starts[1:] - 1] = 0.0
    return bend
