"""The log of a run that has not been driven: when the vehicle is where, and what the wheels it counts turn."""

from __future__ import annotations

from itertools import pairwise
from typing import Final

import numpy as np

from calib.arrays import FloatArray
from calib.campaign.model import Campaign
from calib.campaign.settings import FrontModel
from calib.campaign.wheels import WHEEL_COLUMNS, mecanum_model, odometry_source, without_rear_wheels
from calib.errors import BadInputError
from calib.limits import PLANNED_SAMPLES

ACCELERATION_MPS2: Final = 0.5
LOG_PERIOD_S: Final = 0.1


def wheel_counts(
    campaign: Campaign, way_m: FloatArray, heading_rad: FloatArray, loads_N: tuple[float, float], *, front: bool
) -> dict[str, FloatArray]:
    """Return the columns of the log, each shape (n,), that the vehicle's counted wheels would write.

    Parameters
    ----------
    campaign : Campaign
        Its model says radii and lengths; its odometry, which wheels are counted.
    way_m, heading_rad : array of float, shape (n,)
        Way of the rear axle's middle and heading at the samples.
    loads_N : tuple of float
        Of the left and the right wheel.
    front : bool
        The front wheel is counted beside the rear ones.
    """
    if not without_rear_wheels(campaign):
        counts = _rear(campaign, way_m, heading_rad, loads_N)
        return counts | _front(campaign, way_m, heading_rad, FrontModel.of(campaign.vehicle)) if front else counts
    if odometry_source(campaign) == "front":
        model = campaign.model.front or FrontModel.of(campaign.vehicle)
        return _front(campaign, way_m, heading_rad, model)
    return _mecanum(campaign, way_m, heading_rad)


def _rear(
    campaign: Campaign, way_m: FloatArray, heading_rad: FloatArray, loads_N: tuple[float, float]
) -> dict[str, FloatArray]:
    model, encoder = campaign.model, campaign.encoder
    radius_left = model.radius_left_m + model.slope_left_m_per_N * (loads_N[0] - model.reference_load_N)
    radius_right = model.radius_right_m + model.slope_right_m_per_N * (loads_N[1] - model.reference_load_N)
    half = 0.5 * model.track_m * heading_rad
    return {
        "counts_left": (way_m - half) / radius_left * encoder.counts_per_rev_left / (2 * np.pi),
        "counts_right": (way_m + half) / radius_right * encoder.counts_per_rev_right / (2 * np.pi),
    }


def _front(campaign: Campaign, way_m: FloatArray, heading_rad: FloatArray, model: FrontModel) -> dict[str, FloatArray]:
    ahead, turn = np.diff(way_m), np.diff(heading_rad)
    roll = np.hypot(ahead, model.wheelbase_m * turn) / model.radius_m
    counts = np.concatenate(([0.0], np.cumsum(roll))) * campaign.encoder.front / (2 * np.pi)
    # abs: no minus of a rounded nought turns the wheel about
    angle = np.where(roll > 0.0, np.arctan2(model.wheelbase_m * turn, np.abs(ahead)), 0.0)
    steer = (np.concatenate((angle[:1], angle)) - model.zero_rad) / model.scale
    return {"counts_front": counts, "steer_rad": steer}


def _mecanum(campaign: Campaign, way_m: FloatArray, heading_rad: FloatArray) -> dict[str, FloatArray]:
    model, encoder = mecanum_model(campaign), campaign.encoder
    aside = model.arm_m * heading_rad
    rolled = {"left": (way_m - aside) / model.radius_m, "right": (way_m + aside) / model.radius_m}
    per_rad = {"left": encoder.counts_per_rev_left / (2 * np.pi), "right": encoder.counts_per_rev_right / (2 * np.pi)}
    sides = {name: name.rsplit("_", 1)[1] for name in WHEEL_COLUMNS["wheels"]}
    return {name: rolled[side] * per_rad[side] for name, side in sides.items()}


def stop_and_go(stops_m: FloatArray, speed: float, *, read_rolling: bool) -> tuple[FloatArray, FloatArray]:
    """Return times (s) and way driven (m) from stop to stop (n_stops,), start and end included.

    With ramps, half a second at each stop; where `read_rolling`, the log ends while the vehicle still rolls.
    A sample each `LOG_PERIOD_S`, at wider steps where these would be more than `calib.limits.PLANNED_SAMPLES`.
    """
    if not speed > 0.0:
        raise BadInputError(f"speed_mps: found {speed!r}; expected a speed above 0; correct the planned run")
    total = float(np.ptp(stops_m)) / speed + len(stops_m) * speed / ACCELERATION_MPS2
    period = max(LOG_PERIOD_S, total / PLANNED_SAMPLES)
    time: list[FloatArray] = [np.zeros(1)]
    way: list[FloatArray] = [np.zeros(1)]
    start = 0.0
    for number, (begin, end) in enumerate(pairwise(stops_m)):
        length = float(end - begin)
        top = min(speed, float(np.sqrt(ACCELERATION_MPS2 * length)))
        ramp = top / ACCELERATION_MPS2
        rolling_end = read_rolling and number == len(stops_m) - 2
        cruise = (length - (0.5 if rolling_end else 1.0) * top * ramp) / top
        last = ramp + cruise + (0.0 if rolling_end else ramp)
        t = np.append(np.arange(period, last, period), last)
        u = np.minimum(t, ramp)
        d = 0.5 * ACCELERATION_MPS2 * u**2 + top * np.clip(t - ramp, 0.0, cruise)
        slowing = np.clip(t - ramp - cruise, 0.0, None)
        d = d + top * slowing - 0.5 * ACCELERATION_MPS2 * slowing**2
        time.append(np.asarray(start + t, dtype=np.float64))
        way.append(np.asarray(begin + d, dtype=np.float64))
        start += last
        if not rolling_end:
            pause: FloatArray = LOG_PERIOD_S * np.arange(1.0, 6.0)
            time.append(np.asarray(start + pause, dtype=np.float64))
            way.append(np.full(5, float(end)))
            start += float(pause[-1])
    return np.concatenate(time), np.concatenate(way)
