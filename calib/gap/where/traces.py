"""The gap along each run: reference minus odometry, accumulated on the way."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.arrays import FloatArray
from calib.campaign.model import Campaign
from calib.campaign.wheels import on_one_axle
from calib.gap.data.observations import Observations
from calib.gap.effects.shapes import MOVING_MPS

FEWEST_SAMPLES: Final = 10
COUNTED: Final = ("t_s", "counts_left", "counts_right")
POSED: Final = ("ref_x_m", "ref_y_m", "ref_theta_rad")
RANGED: Final = ("range_m",)


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """Gap along one run: reference minus odometry, accumulated piece by piece in the vehicle's own frame."""

    #: run_id, kind: of the run
    run_id: str
    kind: str
    back: bool  #: whether it was driven back along a corridor
    #: way_m, turn_rad: shape (n,): way driven and heading, by odometry
    way_m: FloatArray
    turn_rad: FloatArray
    #: x_m, y_m: shape (n,): place, by odometry, in the run's own frame
    x_m: FloatArray
    y_m: FloatArray
    #: along_m, heading_rad: shape (n,): the accumulated gap; the second is NaN where only a rangefinder was logged
    along_m: FloatArray
    heading_rad: FloatArray
    stops: FloatArray  #: shape (n,): stops on the way so far


@dataclass(frozen=True, slots=True, eq=False)
class _Driven:
    """A run by odometry: way of each step and its chord (n_steps,), heading and place at each sample (n_steps + 1,)."""

    step_m: FloatArray
    chord_m: FloatArray
    heading_rad: FloatArray
    x_m: FloatArray
    y_m: FloatArray


def traces_of(campaign: Campaign, observations: Observations) -> list[Trace]:
    """Return the gap along every run that has a continuous reference or a logged range."""
    if observations.aside_m is not None:
        # two wheels on one axle cannot follow a vehicle that goes sideways
        return []
    campaign = on_one_axle(campaign, observations.model)
    first = {str(name): unit for unit, name in reversed(list(enumerate(observations.labels["run_id"])))}
    encoder, runs = campaign.encoder, campaign.runs
    kinds, directions = runs.label("kind"), runs.label("direction")
    traces = []
    for run, name in enumerate(runs.run_id):
        unit = first.get(str(name))
        log = _complete(campaign.logs.of(run))
        if unit is None or log is None:
            continue
        left = log["counts_left"] * (2 * np.pi / encoder.counts_per_rev_left) * observations.radius_left_m[unit]
        right = log["counts_right"] * (2 * np.pi / encoder.counts_per_rev_right) * observations.radius_right_m[unit]
        driven = _driven(left, right, observations.model.track_m)
        along, heading = _gap_by_pose(log, driven) if POSED[0] in log else _gap_by_range(log, driven)
        with np.errstate(divide="ignore", invalid="ignore"):
            speed = np.abs(driven.step_m) / np.diff(log["t_s"])
        traces.append(
            Trace(
                run_id=str(name),
                kind=str(kinds[run]),
                back=str(kinds[run]).startswith("corridor") and str(directions[run]) == "back",
                way_m=np.concatenate(([0.0], np.cumsum(np.abs(driven.step_m)))),
                turn_rad=driven.heading_rad,
                x_m=driven.x_m,
                y_m=driven.y_m,
                along_m=np.concatenate(([0.0], along)),
                heading_rad=heading,
                stops=_stops(np.nan_to_num(speed)),
            )
        )
    return traces


def _complete(log: Mapping[str, FloatArray]) -> dict[str, FloatArray] | None:
    """Return counts and reference (poses before ranges) where all of them are known; None where that is too little."""
    reference = POSED if set(POSED) <= log.keys() else RANGED
    needed = (*COUNTED, *reference)
    if not set(needed) <= log.keys():
        return None
    known = np.all([np.isfinite(log[column]) for column in needed], axis=0)
    return {column: log[column][known] for column in needed} if known.sum() >= FEWEST_SAMPLES else None


def _driven(left_m: FloatArray, right_m: FloatArray, track_m: float) -> _Driven:
    """Return a run by odometry from the travel of its wheels, each shape (n_steps + 1,)."""
    step = 0.5 * (np.diff(left_m) + np.diff(right_m))
    turn = (np.diff(right_m) - np.diff(left_m)) / track_m
    heading = np.concatenate(([0.0], np.cumsum(turn)))
    middle = heading[:-1] + 0.5 * turn
    chord = step * np.sinc(0.5 * turn / np.pi)
    x = np.concatenate(([0.0], np.cumsum(chord * np.cos(middle))))
    y = np.concatenate(([0.0], np.cumsum(chord * np.sin(middle))))
    return _Driven(step, chord, heading, x, y)


def _gap_by_pose(log: Mapping[str, FloatArray], driven: _Driven) -> tuple[FloatArray, FloatArray]:
    """Return the gap along (n_steps,) and in heading (n_steps + 1,) against logged poses."""
    heading = np.unwrap(log["ref_theta_rad"])
    middle = 0.5 * (heading[1:] + heading[:-1])
    step = np.diff(log["ref_x_m"]) * np.cos(middle) + np.diff(log["ref_y_m"]) * np.sin(middle)
    return np.cumsum(step - driven.chord_m), (heading - heading[0]) - driven.heading_rad


def _gap_by_range(log: Mapping[str, FloatArray], driven: _Driven) -> tuple[FloatArray, FloatArray]:
    """Return the gap along (n_steps,) against a logged range, and none in heading: NaN, shape (n_steps + 1,)."""
    ranges = log["range_m"]
    return np.abs(ranges - ranges[0])[1:] - np.abs(driven.x_m[1:]), np.full(len(driven.x_m), np.nan)


def _stops(speed_mps: FloatArray) -> FloatArray:
    """Return how many stops there were on the way at each sample, shape (n_steps + 1,); the ends do not count."""
    moving = speed_mps > MOVING_MPS
    if not moving.any():
        return np.zeros(len(speed_mps) + 1)
    first, last = int(np.argmax(moving)), len(moving) - int(np.argmax(moving[::-1]))
    begins = np.zeros(len(speed_mps) + 1)
    stopped = ~moving
    stopped[:first] = stopped[last:] = False
    begins[1:] = stopped & np.concatenate(([False], ~stopped[:-1]))
    return np.cumsum(begins)
