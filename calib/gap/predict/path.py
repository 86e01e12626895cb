"""The path that the counts and a hypothesis give, and what small changes along it do to what is measured at its end.

Campaigns of many samples are worked through in parts of some units each: what is kept is of units, not of steps.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from calib.arrays import BoolArray, FloatArray
from calib.gap.data.channels import N_CHANNELS, POSE, Channel
from calib.gap.data.observations import Observations
from calib.gap.predict.push import Push, total_push
from calib.gap.predict.steps import LINE, TURN, WAY, Steps, X, Y, steps_of

#: a run whose wheels turn by less than this in all, to and fro, was led straight
LED_STRAIGHT_RAD: Final = 1.0


@dataclass(frozen=True, eq=False)
class Path:
    """Path of every unit under a hypothesis, each in the frame of its own start."""

    s: Observations  #: what was driven
    push: Push  #: the hypothesis
    end: FloatArray  #: shape (n_units, 3): end pose
    #: shape (n_units, n_channels): predicted reading of each channel: distance, x, y, heading, front, steering
    reading: FloatArray
    line_m: FloatArray  #: shape (n_units,): length of the line that the unit was led along, signed
    kept: Steps | None = None  #: the steps, where they are few enough to be kept

    @property
    def steps(self) -> Steps:
        """The steps of all units; integrated anew each time where they are too many to be kept: see `parts`."""
        return steps_of(self.s, self.push) if self.kept is None else self.kept

    def parts(self) -> Iterator[tuple[slice, Path]]:
        """Yield units some at a time, each time with the path of these alone; itself where steps are few."""
        for units, part in self._integrated():
            if part is not self:
                # whether the track can be asked for is a matter of all units
                vars(part)["calibration"] = self.calibration[units]
            yield units, part

    def _integrated(self) -> Iterator[tuple[slice, Path]]:
        if self.kept is not None:
            yield slice(0, len(self.s)), self
            return
        for units in self.s.spans:
            part, push = self.s.part(units), self.push.part(units, self.s)
            yield (
                units,
                Path(part, push, self.end[units], self.reading[units], self.line_m[units], steps_of(part, push)),
            )

    @property
    def mid_rad(self) -> FloatArray:
        """Heading at the middle of each step, shape (n_steps,)."""
        return self.steps.mid_rad

    @property
    def x_m(self) -> FloatArray:
        """Position at the middle of each step, shape (n_steps,)."""
        return self.steps.x_m

    @property
    def y_m(self) -> FloatArray:
        """Position at the middle of each step, shape (n_steps,)."""
        return self.steps.y_m

    @property
    def ds_m(self) -> FloatArray:
        """Motion of the axle's middle along, shape (n_steps,)."""
        return self.steps.ds_m

    @property
    def turn_rad(self) -> FloatArray:
        """Turn of each step, shape (n_steps,)."""
        return self.steps.turn_rad

    @cached_property
    def way_m(self) -> FloatArray:
        """Way along of each unit, signed, shape (n_units,)."""
        return self.of_parts(lambda part: part.s.total(part.ds_m))

    @cached_property
    def rolling_radii_m(self) -> FloatArray:
        """Travel of the left and right wheel over their rotation, shape (n_units, 2); NaN where a wheel stood."""

        def radii(part: Path) -> FloatArray:
            s, steps = part.s, part.steps
            wheels = ((steps.ds_left_m, s.roll_left_rad), (steps.ds_right_m, s.roll_right_rad))
            with np.errstate(divide="ignore", invalid="ignore"):
                ratios = [s.total(travel * np.sign(roll)) / s.total(np.abs(roll)) for travel, roll in wheels]
            return np.stack(ratios, axis=1)

        return self.of_parts(radii)

    def of_parts(self, what: Callable[[Path], FloatArray]) -> FloatArray:
        """Return a quantity of each unit (n_units, ...) that is worked out from steps, part by part."""
        return np.concatenate([what(part) for _, part in self._integrated()])

    @cached_property
    def frame(self) -> FloatArray:
        """Heading in which along and lateral are read: the measured one, else the wheels', shape (n_units,)."""
        measured = self.s.measured[:, Channel.HEADING]
        return np.where(np.isfinite(measured), measured, self.end[:, 2])

    @cached_property
    def frame_turned(self) -> tuple[FloatArray, FloatArray]:
        """Cosine and sine of `frame`, each shape (n_units,)."""
        return np.cos(self.frame), np.sin(self.frame)

    @cached_property
    def way_sign(self) -> FloatArray:
        """Sign of the way along: -1 for a unit driven backwards, shape (n_units,)."""
        return np.asarray(np.sign(self.way_m))

    @cached_property
    def calibration(self) -> FloatArray:
        """Derivative of the readings by (left, right radius, track, front radius), shape (n_units, n_channels, 4).

        The first three are relative changes, as is the fourth, which only the front channels feel.
        """
        return self.beside_straights(self.of_parts(_calibration))

    def beside_straights(self, calibration: FloatArray) -> FloatArray:
        """Return the derivative (n_units, n_channels, 4) without the track, where all units were led straight."""
        if self.led_straight.all():
            calibration[:, :, 2] = 0.0
        return calibration

    @cached_property
    def led_straight(self) -> BoolArray:
        """Which units were led straight, shape (n_units,).

        There the turn by the wheels is their noise, which is the gap itself: taken as a turn, it would pass for a track
        that is off. Where all runs are straight the track cannot be asked for.
        """
        s = self.s
        with np.errstate(invalid="ignore"):
            bent = np.abs(s.measured[:, Channel.HEADING]) > LED_STRAIGHT_RAD
        straight: BoolArray = (s.total(np.abs(s.turn_rad)) < LED_STRAIGHT_RAD) & ~bent
        return straight | s.led_straight


def _calibration(path: Path) -> FloatArray:
    """Return the derivative by (left, right radius, track, front radius), shape (n_units, n_channels, 4)."""
    s = path.s
    ones = np.ones(len(s))
    if s.by_front:
        # one wheel: it has a radius, which both that stand in for it share; wheelbase and zero are the steering's
        both = 0.5 * _along_path(path, Push(left=ones, right=ones))
        return np.stack([both, both, np.zeros_like(both), np.zeros_like(both)], axis=2)
    by_front = np.zeros((len(s), N_CHANNELS))
    front = np.nan_to_num(s.front_roll_rad) * s.vehicle.front_radius_m
    by_front[:, Channel.FRONT] = -s.total(front * s.steer_cos)
    by_front[:, Channel.STEERING] = -s.total(front * s.steer_sin) / s.vehicle.wheelbase_m
    wheels = (_along_path(path, push) for push in (Push(left=ones), Push(right=ones), Push(track=ones)))
    return np.stack([*wheels, by_front], axis=2)


def predict(s: Observations, pushes: list[Push] | None = None) -> Path:
    """Integrate the counts (exact arcs) under a hypothesis: pushes already scaled; none is the model alone."""
    push = total_push(s, pushes or [])
    if len(s.spans) == 1:
        return _predicted(s, push)
    path = Path(s, push, np.zeros((len(s), 3)), np.zeros((len(s), N_CHANNELS)), np.zeros(len(s)))
    derivatives, ways, radii = [], [], []
    for units in s.spans:
        part = _predicted(s.part(units), push.part(units, s))
        path.end[units], path.reading[units], path.line_m[units] = part.end, part.reading, part.line_m
        # asked of every path, and the steps are at hand
        derivatives.append(_calibration(part))
        ways.append(part.way_m)
        radii.append(part.rolling_radii_m)
    vars(path).update(way_m=np.concatenate(ways), rolling_radii_m=np.concatenate(radii))
    vars(path)["calibration"] = path.beside_straights(np.concatenate(derivatives))
    return path


def _predicted(s: Observations, push: Push) -> Path:
    """Return the path with all its steps."""
    steps = steps_of(s, push)
    end = steps.end
    line_m = s.total(steps.ds_m * steps.weave_cos)
    reading = np.zeros((len(s), N_CHANNELS))
    path = Path(s, push, end, reading, line_m, steps)
    reading[:, [*POSE, Channel.HEADING]] = end
    reading[:, Channel.DISTANCE] = np.where(
        s.axis == 1, end[:, 0], np.where(s.axis == 2, np.hypot(end[:, 0], end[:, 1]), np.abs(line_m))
    )
    if s.usable[:, Channel.FRONT :].any():
        wheelbase = s.vehicle.wheelbase_m
        front = np.nan_to_num(s.front_roll_rad) * s.vehicle.front_radius_m
        # what the rear wheels say, less what the front wheel and its steering say of the same (Eqs 12 to 14)
        reading[:, Channel.FRONT] = s.total(steps.ds_m - front * s.steer_cos)
        reading[:, Channel.STEERING] = s.total(steps.turn_rad - front * s.steer_sin / wheelbase)
    if push.reading is not None:
        reading += _in_start_frame(path, push.reading)
    return path


def _in_start_frame(path: Path, reading: FloatArray) -> FloatArray:
    """Turn the along and lateral columns (n_units, n_channels) from the end frame into the start frame."""
    turned = reading.copy()
    c, s = np.cos(path.frame), np.sin(path.frame)
    turned[:, Channel.ALONG] = c * reading[:, Channel.ALONG] - s * reading[:, Channel.LATERAL]
    turned[:, Channel.LATERAL] = s * reading[:, Channel.ALONG] + c * reading[:, Channel.LATERAL]
    return turned


def signature(path: Path, push: Push) -> FloatArray:
    """Return what a push does to the readings, to first order about a path, shape (n_units, n_channels).

    The change of (distance, along, lateral, heading, front, steering) per unit of the parameter; along and lateral in
    the frame of the end heading.
    """
    s = path.s
    n_units, n_steps = len(s), len(s.unit)
    change = np.zeros((n_units, N_CHANNELS))
    wheels: dict[str, FloatArray] = {}
    for number, (name, part) in enumerate((("left", push.left), ("right", push.right), ("track", push.track))):
        if part is None:
            continue
        if len(part) == n_units and n_units != n_steps:
            change += path.calibration[:, :, number] * part[:, None]
        else:
            wheels[name] = part
    if wheels or not push.of_units_only:
        stepwise = Push(**wheels, heading_rad=push.heading_rad, along_m=push.along_m, lateral_m=push.lateral_m)
        for units, of_units in path.parts():
            change[units] += _along_path(of_units, stepwise if path.kept is not None else stepwise.part(units, s))
    if push.reading is not None:
        change += push.reading
    return change


def _along_path(path: Path, push: Push) -> FloatArray:
    """Integrate what varies along the path: shape (n_units, n_channels)."""
    s = path.s
    sums = path.steps.sums(push)
    x, y = sums[X], sums[Y]
    change = np.zeros((len(s), N_CHANNELS))
    c, sn = path.frame_turned
    change[:, Channel.ALONG], change[:, Channel.LATERAL] = c * x + sn * y, c * y - sn * x
    change[:, Channel.HEADING] = sums[TURN]
    change[:, Channel.DISTANCE] = np.where(s.axis == 1, x, sums[LINE] * path.way_sign)
    chords = np.flatnonzero(s.axis == 2)
    if len(chords):
        end_x, end_y = path.end[chords, 0], path.end[chords, 1]
        with np.errstate(invalid="ignore", divide="ignore"):
            chord = (end_x * x[chords] + end_y * y[chords]) / np.hypot(end_x, end_y)
        change[chords, Channel.DISTANCE] = np.nan_to_num(chord)
    if s.usable[:, Channel.FRONT :].any():
        change[:, Channel.FRONT] = sums[WAY]
        change[:, Channel.STEERING] = sums[TURN]
    return change
