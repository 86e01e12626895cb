"""The path that the counts and a hypothesis give, and what small changes along it do to what is measured at its end."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from calib.arrays import BoolArray, FloatArray
from calib.gap.data.channels import N_CHANNELS, POSE, Channel
from calib.gap.data.observations import Observations
from calib.gap.predict.push import Push, total_push

__all__ = ["Path", "predict", "signature"]

#: a run whose wheels turn by less than this in all, to and fro, was led straight
LED_STRAIGHT_RAD: Final = 1.0


@dataclass(frozen=True, eq=False)
class Path:
    """Path of every unit under a hypothesis, each in the frame of its own start.

    Parameters
    ----------
    s : Observations
        What was driven.
    ds_left_m, ds_right_m : array of float, shape (n_steps,)
        Travel of the wheels.
    ds_m, turn_rad : array of float, shape (n_steps,)
        Motion of the axle's middle along, around and to its left.
    track_m : array of float, shape (n_steps,) or float
        Track.
    mid_rad, x_m, y_m : array of float, shape (n_steps,)
        Heading at the middle of each step, position at its middle.
    end : array of float, shape (n_units, 3)
        End pose.
    reading : array of float, shape (n_units, n_channels)
        Predicted reading of each channel: distance, x, y, heading, front, steering.
    """

    s: Observations
    ds_left_m: FloatArray
    ds_right_m: FloatArray
    ds_m: FloatArray
    turn_rad: FloatArray
    track_m: FloatArray
    mid_rad: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    end: FloatArray
    reading: FloatArray

    @cached_property
    def cos(self) -> FloatArray:
        """Cosine of the heading at the middle of each step, shape (n_steps,)."""
        made: FloatArray = np.cos(self.mid_rad)
        return made

    @cached_property
    def sin(self) -> FloatArray:
        """Sine of the heading at the middle of each step, shape (n_steps,)."""
        made: FloatArray = np.sin(self.mid_rad)
        return made

    @cached_property
    def lever_x(self) -> FloatArray:
        """What a turn at a step moves the end point in x, per radian, shape (n_steps,)."""
        made: FloatArray = self.y_m - self.end[self.s.unit, 1]
        return made

    @cached_property
    def lever_y(self) -> FloatArray:
        """What a turn at a step moves the end point in y, per radian, shape (n_steps,)."""
        made: FloatArray = self.end[self.s.unit, 0] - self.x_m
        return made

    @cached_property
    def frame(self) -> FloatArray:
        """Heading in which along and lateral are read: the measured one, else the wheels', shape (n_units,)."""
        measured = self.s.measured[:, Channel.HEADING]
        return np.where(np.isfinite(measured), measured, self.end[:, 2])

    @cached_property
    def way_sign(self) -> FloatArray:
        """Sign of the way along: -1 for a unit driven backwards, shape (n_units,)."""
        return np.asarray(np.sign(self.s.total(self.ds_m)))

    @cached_property
    def weave_cos(self) -> FloatArray:
        """Cosine of the heading about its own straight trend in each unit, shape (n_steps,)."""
        s = self.s
        along = s.cumulative(np.abs(self.ds_m)) - 0.5 * np.abs(self.ds_m)
        total = np.maximum(s.total(np.abs(self.ds_m)), 1e-9)
        weight = np.abs(self.ds_m)
        mean_a = s.total(weight * along) / total
        mean_h = s.total(weight * self.mid_rad) / total
        da, dh = along - mean_a[s.unit], self.mid_rad - mean_h[s.unit]
        slope = s.total(weight * da * dh) / np.maximum(s.total(weight * da * da), 1e-12)
        return np.cos(dh - slope[s.unit] * da)

    @cached_property
    def calibration(self) -> FloatArray:
        """Derivative of the readings by (left, right radius, track, front radius), shape (n_units, n_channels, 4).

        The first three are relative changes, as is the fourth, which only the front channels feel.
        """
        s = self.s
        ones = np.ones(len(s))
        if s.by_front:
            # one wheel: it has a radius, which both that stand in for it share; wheelbase and zero are the steering's
            both = 0.5 * signature(self, Push(left=ones, right=ones), by_steps=True)
            return np.stack([both, both, np.zeros_like(both), np.zeros_like(both)], axis=2)
        columns = [
            signature(self, Push(left=ones), by_steps=True),
            signature(self, Push(right=ones), by_steps=True),
            signature(self, Push(track=ones), by_steps=True) * (0.0 if self.led_straight.all() else 1.0),
            self._front_radius(),
        ]
        return np.stack(columns, axis=2)

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

    def _front_radius(self) -> FloatArray:
        made = np.zeros((len(self.s), N_CHANNELS))
        front = np.nan_to_num(self.s.front_roll_rad) * self.s.vehicle.front_radius_m
        made[:, Channel.FRONT] = -self.s.total(front * self.s.steer_cos)
        made[:, Channel.STEERING] = -self.s.total(front * self.s.steer_sin) / self.s.vehicle.wheelbase_m
        return made


def predict(s: Observations, pushes: list[Push] | None = None) -> Path:
    """Integrate the counts under a hypothesis (exact arcs).

    Parameters
    ----------
    s : Observations
        What was driven; its model gives radii and track.
    pushes : list of Push, optional
        The hypothesis, already scaled by its parameters; none is the model alone.

    Returns
    -------
    Path
        Path and predicted readings.
    """
    push = total_push(s, pushes or [])
    unit = s.unit

    def wide(part: FloatArray | None) -> FloatArray | float:
        if part is None:
            return 0.0
        return part if len(part) == len(unit) else part[unit]

    left = s.travel_left_m * (1.0 + wide(push.left))
    right = s.travel_right_m * (1.0 + wide(push.right))
    track = s.model.track_m * (1.0 + wide(push.track)) * np.ones(1)
    ds = 0.5 * (left + right) + wide(push.along_m)
    turn = (right - left) / track + wide(push.heading_rad)
    slip = np.broadcast_to(np.asarray(wide(push.lateral_m), dtype=np.float64), ds.shape)
    if s.aside_m is not None:
        slip = slip + s.aside_m * (1.0 + 0.5 * (wide(push.left) + wide(push.right)))
    heading = s.cumulative(turn)
    mid = heading - 0.5 * turn + _bend(s, turn)
    half = 0.5 * turn
    chord = ds * (1.0 - half * half / 6.0)
    c, sn = np.cos(mid), np.sin(mid)
    dx, dy = chord * c - slip * sn, chord * sn + slip * c
    x, y = s.cumulative(dx), s.cumulative(dy)
    last = s.starts[1:] - 1
    end = np.stack([x[last], y[last], heading[last]], axis=1)
    path = Path(
        s=s,
        ds_left_m=left,
        ds_right_m=right,
        ds_m=ds,
        turn_rad=turn,
        track_m=track,
        mid_rad=mid,
        x_m=x - 0.5 * dx,
        y_m=y - 0.5 * dy,
        end=end,
        reading=np.zeros((len(s), N_CHANNELS)),
    )
    reading = path.reading
    reading[:, [*POSE, Channel.HEADING]] = end
    line = np.abs(s.total(ds * path.weave_cos))
    reading[:, Channel.DISTANCE] = np.where(
        s.axis == 1, end[:, 0], np.where(s.axis == 2, np.hypot(end[:, 0], end[:, 1]), line)
    )
    if s.usable[:, Channel.FRONT :].any():
        wheelbase = s.vehicle.wheelbase_m
        front = np.nan_to_num(s.front_roll_rad) * s.vehicle.front_radius_m
        # what the rear wheels say, less what the front wheel and its steering say of the same (Eqs 12 to 14)
        reading[:, Channel.FRONT] = s.total(ds - front * s.steer_cos)
        reading[:, Channel.STEERING] = s.total(turn - front * s.steer_sin / wheelbase)
    if push.reading is not None:
        reading += _in_start_frame(path, push.reading)
    return path


def _bend(s: Observations, turn: FloatArray) -> FloatArray:
    """Return by how much the mean heading of each step differs from the mean of its ends, shape (n_steps,).

    The arc of a step is bent further where the curvature changes on the way: with the heading as a parabola the mean
    differs by a twelfth of its second difference. Matters for logs of a few hertz on winding routes.
    """
    made = np.zeros(len(turn))
    made[1:-1] = (turn[:-2] - turn[2:]) / 24.0
    made[s.starts[:-1]] = 0.0
    made[s.starts[1:] - 1] = 0.0
    return made


def _in_start_frame(path: Path, reading: FloatArray) -> FloatArray:
    """Turn the along and lateral columns (n_units, n_channels) from the end frame into the start frame."""
    made = reading.copy()
    c, s = np.cos(path.frame), np.sin(path.frame)
    made[:, Channel.ALONG] = c * reading[:, Channel.ALONG] - s * reading[:, Channel.LATERAL]
    made[:, Channel.LATERAL] = s * reading[:, Channel.ALONG] + c * reading[:, Channel.LATERAL]
    return made


def signature(path: Path, push: Push, *, by_steps: bool = False) -> FloatArray:
    """Return what a push does to the readings, to first order about a path.

    Parameters
    ----------
    path : Path
        Where to linearise.
    push : Push
        What one parameter does.
    by_steps : bool
        Integrate over the steps even where the push is constant in each unit.

    Returns
    -------
    array of float, shape (n_units, n_channels)
        Change of (distance, along, lateral, heading, front, steering) per unit of the parameter; along and lateral
        in the frame of the end heading.
    """
    s = path.s
    n_units, n_steps = len(s), len(s.unit)
    made = np.zeros((n_units, N_CHANNELS))
    stepwise: dict[str, FloatArray] = {}
    for number, part in enumerate((push.left, push.right, push.track)):
        if part is None:
            continue
        if len(part) == n_units and not by_steps and n_units != n_steps:
            made += path.calibration[:, :, number] * part[:, None]
        else:
            wide = part if len(part) == n_steps and n_units != n_steps else part[s.unit]
            stepwise[("left", "right", "track")[number]] = wide
    if stepwise or not push.of_units_only:
        made += _along_path(path, stepwise, push)
    if push.reading is not None:
        made += push.reading
    return made


def _added(first: FloatArray | None, second: FloatArray) -> FloatArray:
    """Return the sum of two step arrays of which neither is needed any more."""
    if first is None:
        return second
    first += second
    return first


def _along_path(path: Path, wide: dict[str, FloatArray], push: Push) -> FloatArray:
    """Integrate what varies along the path: shape (n_units, n_channels)."""
    s = path.s
    # most pushes turn the vehicle or move it, not both: what is nought everywhere is not multiplied out
    ds: FloatArray | None = None
    turn: FloatArray | None = None
    if "left" in wide:
        change = path.ds_left_m * wide["left"]
        ds, turn = 0.5 * change, -(change / path.track_m)
    if "right" in wide:
        change = path.ds_right_m * wide["right"]
        ds, turn = _added(ds, 0.5 * change), _added(turn, change / path.track_m)
    if "track" in wide:
        turn = _added(turn, -((path.ds_right_m - path.ds_left_m) / path.track_m * wide["track"]))
    if push.heading_rad is not None:
        turn = push.heading_rad if turn is None else turn + push.heading_rad
    if push.along_m is not None:
        ds = push.along_m if ds is None else ds + push.along_m
    moved = None if ds is None else (ds * path.cos, ds * path.sin)
    turned = None if turn is None else (turn * path.lever_x, turn * path.lever_y)
    if moved is None or turned is None:
        dx, dy = moved or turned or (np.zeros(len(s.unit)), np.zeros(len(s.unit)))
    else:
        dx, dy = _added(moved[0], turned[0]), _added(moved[1], turned[1])
    aside = push.lateral_m
    if s.aside_m is not None:
        mean = 0.5 * (wide.get("left", np.zeros(1)) + wide.get("right", np.zeros(1)))
        aside = s.aside_m * mean + (0.0 if aside is None else aside)
    if aside is not None:
        dx -= aside * path.sin
        dy += aside * path.cos
    x, y = s.total(dx), s.total(dy)
    made = np.zeros((len(s), N_CHANNELS))
    c, sn = np.cos(path.frame), np.sin(path.frame)
    made[:, Channel.ALONG], made[:, Channel.LATERAL] = c * x + sn * y, c * y - sn * x
    if turn is not None:
        made[:, Channel.HEADING] = s.total(turn)
    with np.errstate(invalid="ignore", divide="ignore"):
        chord = np.nan_to_num((path.end[:, 0] * x + path.end[:, 1] * y) / np.hypot(path.end[:, 0], path.end[:, 1]))
    line = np.zeros(len(s)) if ds is None else s.total(ds * path.weave_cos) * path.way_sign
    made[:, Channel.DISTANCE] = np.where(s.axis == 1, x, np.where(s.axis == 2, chord, line))
    if s.usable[:, Channel.FRONT :].any():
        if ds is not None:
            made[:, Channel.FRONT] = s.total(ds)
        made[:, Channel.STEERING] = made[:, Channel.HEADING]
    return made
