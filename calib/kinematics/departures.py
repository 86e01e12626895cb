"""Departures of a recording from its model that no residual need show: tested one by one against the fit.

Each is one more parameter, a change of the recording of unknown size. It is fitted beside the parameters of the vehicle
in the linearised problem. It is named where its size is beyond noise, by the scatter between groups of segments, and
where it explains more of the residual than is left without it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Final

import numpy as np

from calib.kinematics.blunders import Fault
from calib.kinematics.drives import moved_between
from calib.kinematics.joint_fit import Fitted
from calib.kinematics.model import Model, Segments
from calib.kinematics.recording import Recording
from calib.kinematics.uncertainty import whitened

#: standard deviations by which a size must stand out: a few departures are tried, with the scatter of few groups
CLEAR: Final = 6.0
#: share of the weighted squares, noise included, that a departure must explain
EXPLAINED: Final = 0.5
#: plays of a steering that are tried, rad: its size is found from the nearest
PLAYS_RAD: Final = (0.005, 0.01, 0.02, 0.04, 0.08)
#: scale of one axis of a tracking system, tried from this size on
AXIS_SCALE: Final = 0.01

Change = Callable[[Recording, float], Recording]


@dataclass(frozen=True, slots=True)
class Departure:
    """A change of the recording of a size that a fit tells, and its name."""

    change: Change
    #: size at which the residuals are differentiated
    step: float
    named: Callable[[float], Fault]


def find_departure(fitted: Fitted) -> tuple[Recording, Fault] | None:
    """Return the recording corrected for the departure that explains most, and its name; None where none is clear."""
    best, chosen = (0.0, 0.0), None
    for departure in _departures(fitted.model):
        score = _score(fitted, departure)
        if score is not None and score[0] > best[0]:
            best, chosen = score, departure
    if chosen is None:
        return None
    # the residuals are not linear in the size: it is found again from where it was found
    size = (_score(fitted, replace(chosen, step=best[1])) or best)[1]
    return chosen.change(fitted.model.recording, size), chosen.named(size)


def _score(fitted: Fitted, departure: Departure) -> tuple[float, float] | None:
    """Return the share of the squares that a departure explains, and its size; None where it does not stand out."""
    model, solution = fitted.model, fitted.solution
    recording = departure.change(model.recording, departure.step)
    changed = Model(model.drive, recording, _remeasured(model.segments, recording)).predict(solution.values)
    jacobian, residuals = whitened(solution, fitted.parameters.free)
    shift = np.einsum("nij,nj->ni", solution.whitener, solution.prediction.residuals - changed.residuals)
    shift *= np.sqrt(solution.weights)[:, None]
    flat, rest = jacobian.reshape(-1, jacobian.shape[2]), residuals.ravel()
    both = np.column_stack([shift.ravel(), rest])
    # what the parameters of the vehicle explain of either is taken out
    column, rest = (both - flat @ np.linalg.lstsq(flat, both, rcond=None)[0]).T
    information = float(column @ column)
    if information <= 0.0:
        return None
    steps = float(column @ rest) / information
    runs = model.segments.run
    group = np.repeat(runs if len(np.unique(runs)) >= FEWEST_GROUPS else model.segments.block, 3)
    pulls = np.bincount(group, column * (rest - steps * column))
    std = float(np.sqrt(np.square(pulls).sum())) / information
    share = 1.0 - float(np.square(rest - steps * column).sum() / max(float(rest @ rest), 1e-300))
    size = steps * departure.step
    if share < EXPLAINED or abs(steps) < CLEAR * std or size <= LEAST_SIZE * departure.step:
        return None
    return share, size


#: runs from which on they are the groups, not blocks of them
FEWEST_GROUPS: Final = 8
#: a size below this part of the one that was tried is another one's, or of the wrong sign
LEAST_SIZE: Final = 0.5


def _remeasured(segments: Segments, recording: Recording) -> Segments:
    """Return the segments with what the reference of a changed recording says of them."""
    if segments.are_runs_of(recording):
        return segments
    measured = moved_between(np.nan_to_num(recording.reference), segments.first, segments.last)
    return replace(segments, measured=np.where(segments.seen, measured, segments.measured))


def _departures(model: Model) -> Iterator[Departure]:
    """Yield the departures that a recording can show."""
    if model.recording.steps.steer_rad is not None:
        yield from (Departure(_without_play, play_rad, _play) for play_rad in PLAYS_RAD)
    if model.segments.are_runs_of(model.recording):
        # all begin at the same heading: an axis of the reference is then one of the vehicle, which may slide along it
        return
    for axis, name in enumerate(("ref_x_m", "ref_y_m")):
        for sign in (1.0, -1.0):
            yield Departure(partial(_stretched, axis=axis, sign=sign), AXIS_SCALE, partial(_axis, name=name, sign=sign))


def _without_play(recording: Recording, play_rad: float) -> Recording:
    """Return the recording with the angle of wheels that follow the sensor with a play."""
    sensor = np.asarray(recording.steps.steer_rad)
    wheel = sensor.copy()
    half = 0.5 * play_rad
    for first, last in pairwise(recording.offsets.tolist()):
        angle = float(sensor[first])
        for at in range(first, last):
            angle = min(max(angle, sensor[at] - half), sensor[at] + half)
            wheel[at] = angle
    return replace(recording, steps=replace(recording.steps, steer_rad=wheel))


def _play(play_rad: float) -> Fault:
    text = (
        f"steer_rad: the wheels follow it with a play of {1e3 * play_rad:.3g} mrad, by the direction of the last turn; "
        "take the play out of the steering, or log the angle of the wheels"
    )
    return Fault("steering_play", text)


def _stretched(recording: Recording, share: float, axis: int, sign: float) -> Recording:
    """Return the recording with one axis of the reference's positions longer by a share."""
    factors = np.ones(3)
    factors[axis] += sign * share
    return replace(recording, reference=(recording.reference.T * factors).T, end_pose=recording.end_pose * factors)


def _axis(share: float, name: str, sign: float) -> Fault:
    text = (
        f"{name}: distances along this axis are {100 * share:.3g} % too {'short' if sign > 0 else 'long'} beside the "
        "other; calibrate the tracking system or the camera"
    )
    return Fault("axis_scale", text)
