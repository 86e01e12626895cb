"""A unit of the diagnosis: a run or a window of a recording, its wheel angles, and what was measured at its end."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Final

import numpy as np

from calib.campaign.model import Campaign, RunTable
from calib.campaign.settings import Encoder, OdometryModel
from calib.campaign.wheels import ASIDE, WHEEL_COLUMNS
from calib.types import FloatArray, IntArray

#: a log is thinned to so many steps; the arcs between are exact for what the wheels really rolled
MAX_STEPS: Final = 400
#: steps of a run whose totals alone are known
STEPS_WITHOUT_LOG: Final = 40


@dataclass(frozen=True, slots=True)
class CountsPerRadian:
    """Counts of each encoder for a radian of its wheel."""

    left: float
    right: float
    front: float

    @staticmethod
    def from_encoder(encoder: Encoder) -> CountsPerRadian:
        """Return the scales of an encoder section."""
        turn = 2 * np.pi
        return CountsPerRadian(
            encoder.counts_per_rev_left / turn, encoder.counts_per_rev_right / turn, encoder.front / turn
        )


@dataclass(frozen=True, slots=True, eq=False)
class Setup:
    """What all runs of a campaign are read with."""

    campaign: Campaign
    model: OdometryModel  #: what the simulator believes
    per_rad: CountsPerRadian
    in_map: bool  #: whether the reference's poses stand in one frame for all runs
    stands_in: bool  #: whether the two wheels represent a front wheel, or for four wheels


def _nan(*shape: int) -> FloatArray:
    return np.full(shape, np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """A run, or a window of a recording."""

    run: int  #: row of the run table
    window: int  #: number of the window within its run, 0 for a whole run
    #: time_s, left_rad, right_rad: shape (n_steps + 1,): time since the run's start and angles of the wheels by their
    #: counters
    time_s: FloatArray
    left_rad: FloatArray
    right_rad: FloatArray
    #: front_rad, steer_rad: shape (n_steps + 1,): angle of the front wheel and its steering angle
    front_rad: FloatArray | None = None
    steer_rad: FloatArray | None = None
    aside_m: FloatArray | None = None  #: shape (n_steps + 1,): what mecanum wheels rolled to the left
    from_log: bool = True  #: false where the steps were made up from the totals
    #: measured, simulated: shape (4,): distance, x, y and heading at the end, in the frame of its start; NaN
    #: where not measured
    measured: FloatArray = field(default_factory=lambda: _nan(4))
    simulated: FloatArray = field(default_factory=lambda: _nan(4))
    #: sigma_xy_m, sigma_theta_rad: standard uncertainty of the measured position and heading; NaN where the settings'
    #: holds
    sigma_xy_m: float = float("nan")
    sigma_theta_rad: float = float("nan")
    #: standard uncertainty of the heading of the observation's start frame, where that was read too
    sigma_start_rad: float = 0.0
    #: shape (3,): where the observation starts in the frame common to all runs; NaN where there is none
    start_pose: FloatArray = field(default_factory=lambda: _nan(3))
    by_gyro: bool = False  #: whether a gyro measured its turn

    @property
    def n_steps(self) -> int:
        """Number of steps."""
        return len(self.left_rad) - 1


def log_rows(log: Mapping[str, FloatArray]) -> IntArray:
    """Return the samples of a log that have a time and both counts, shape (n_samples,); none if a column is missing."""
    if not {"t_s", "counts_left", "counts_right"} <= log.keys():
        return np.zeros(0, dtype=np.int64)
    good = np.isfinite(log["t_s"]) & np.isfinite(log["counts_left"]) & np.isfinite(log["counts_right"])
    return np.flatnonzero(good)


def thinned(rows: IntArray) -> IntArray:
    """Return at most `MAX_STEPS` + 1 of the samples, evenly spread, first and last kept."""
    return rows if len(rows) <= MAX_STEPS + 1 else rows[_evenly(len(rows))]


@lru_cache(maxsize=16)
def _evenly(n_rows: int) -> IntArray:
    return np.unique(np.linspace(0, n_rows - 1, MAX_STEPS + 1).astype(np.int64))


def observation_from_log(
    run: int, log: Mapping[str, FloatArray], rows: IntArray, per_rad: CountsPerRadian
) -> Observation:
    """Make a unit of two or more samples of a log, thinned here; nothing is measured yet.

    The front wheel, or the shaft, counts where all of its samples are there.
    """
    index = thinned(rows)
    counted = "counts_front" if "counts_front" in log else WHEEL_COLUMNS["shaft"][0]
    front, steer, aside = (log[name][index] if name in log else None for name in (counted, "steer_rad", ASIDE))
    return Observation(
        run=run,
        window=0,
        time_s=log["t_s"][index],
        left_rad=log["counts_left"][index] / per_rad.left,
        right_rad=log["counts_right"][index] / per_rad.right,
        front_rad=None if front is None or np.isnan(front).any() else front / per_rad.front,
        steer_rad=None if steer is None or np.isnan(steer).any() else steer,
        aside_m=aside,
    )


def observation_from_row(run: int, runs: RunTable, per_rad: CountsPerRadian) -> Observation | None:
    """Make a unit of a row's totals, as one arc; None where the row has no counts."""
    left, right = float(runs.number("counts_left")[run]), float(runs.number("counts_right")[run])
    if not (np.isfinite(left) and np.isfinite(right)):
        return None
    share = np.linspace(0.0, 1.0, STEPS_WITHOUT_LOG + 1)
    return Observation(
        run=run,
        window=0,
        time_s=_nan(STEPS_WITHOUT_LOG + 1),
        left_rad=share * left / per_rad.left,
        right_rad=share * right / per_rad.right,
        from_log=False,
    )
