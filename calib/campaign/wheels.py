"""Which wheels drive a vehicle's odometry, and the two wheels on one axle that they amount to.

Everything downstream that integrates two wheels on one axle (diagnosis, replay, the runtime's check) reads a vehicle
whose odometry comes from its front wheel alone, or from four mecanum wheels, through `on_one_axle`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from calib.campaign.settings import FrontModel, MecanumModel, Odometry, OdometryModel, OdometrySource
from calib.errors import BadInputError
from calib.types import FloatArray

if TYPE_CHECKING:
    from collections.abc import Mapping

    from calib.campaign.model import Campaign, Logs

#: what drives the odometry -> columns of the log with the counts of its wheels
WHEEL_COLUMNS: Final[dict[str, tuple[str, ...]]] = {
    "rear": ("counts_left", "counts_right"),
    "front": ("counts_front",),
    "wheels": ("counts_front_left", "counts_front_right", "counts_rear_left", "counts_rear_right"),
}
#: column of a log in memory: way to the left that mecanum wheels rolled since the run's start, in m
ASIDE: Final = "aside_m"


def odometry_source(campaign: Campaign) -> OdometrySource:
    """Return what drives the odometry: ``rear``, ``front`` or ``wheels``; the settings' word, else what was logged."""
    stated = campaign.odometry.source
    if stated is not None:
        return stated
    if campaign.vehicle.drive == "mecanum":
        return "wheels"
    return "front" if _lacks_rear(campaign) and _logged(campaign.logs, "front") else "rear"


def without_rear_wheels(campaign: Campaign) -> bool:
    """Return whether the odometry runs on the front wheel, or on four wheels, and no rear wheel was counted."""
    return odometry_source(campaign) != "rear" and _lacks_rear(campaign)


def _logged(logs: Logs, source: str) -> bool:
    return all(name in logs.columns and not np.isnan(logs.columns[name]).all() for name in WHEEL_COLUMNS[source])


def _lacks_rear(campaign: Campaign) -> bool:
    return not _logged(campaign.logs, "rear") and bool(np.isnan(campaign.runs.number("counts_left")).all())


def on_one_axle(campaign: Campaign, model: OdometryModel | None = None) -> Campaign:
    """Return the campaign with the counts that two wheels on one axle would have had.

    A campaign that has rear wheels is returned as it is. Else the front wheel's way and angle, or the four wheels'
    turning, are the motion of the axle's middle, and that is written as the counts of a left and a right wheel of the
    model's radii and track; what mecanum wheels roll to the side stands in the column `ASIDE`.

    `model`: what the simulator believes; the campaign's own by default. Its `front` or `mecanum` part, where it has
    one, takes the place of the vehicle's nominal lengths. Raises BadInputError where a mecanum vehicle does not say its
    l + w.
    """
    if not without_rear_wheels(campaign):
        return campaign
    source, model = odometry_source(campaign), model or campaign.model
    encoder, logs = campaign.encoder, campaign.logs
    n = int(logs.offsets[-1])
    counts = {name: np.full(n, np.nan) for name in WHEEL_COLUMNS["rear"]}
    aside = np.full(n, np.nan)
    if source == "front":
        front = model.front or FrontModel.of(campaign.vehicle)
        # a count of the wheels that are confounded with it is as fine as one of the front wheel
        per_m = encoder.front / (2 * np.pi * front.radius_m)
        encoder = replace(
            encoder,
            counts_per_rev_left=2 * np.pi * model.radius_left_m * per_m,
            counts_per_rev_right=2 * np.pi * model.radius_right_m * per_m,
        )
    per_m_left = encoder.counts_per_rev_left / (2 * np.pi * model.radius_left_m)
    per_m_right = encoder.counts_per_rev_right / (2 * np.pi * model.radius_right_m)
    for run in np.flatnonzero(logs.present):
        motion = _motion(campaign, model, source, logs.of(int(run)))
        if motion is None:
            continue
        ahead, left, turn = motion
        part = slice(int(logs.offsets[run]), int(logs.offsets[run + 1]))
        half = 0.5 * model.track_m * turn
        counts["counts_left"][part] = np.cumsum(ahead - half) * per_m_left
        counts["counts_right"][part] = np.cumsum(ahead + half) * per_m_right
        aside[part] = np.cumsum(left)
    columns = {**logs.columns, **counts, **({ASIDE: aside} if source == "wheels" else {})}
    last = np.maximum(logs.offsets[1:] - 1, 0)
    ends = {name: np.where(logs.present, column[last], np.nan) for name, column in counts.items()} if n else {}
    return replace(
        campaign,
        encoder=encoder,
        odometry=Odometry(source),
        runs=replace(campaign.runs, numbers={**campaign.runs.numbers, **ends}),
        logs=replace(logs, columns=columns),
    )


def _motion(
    campaign: Campaign, model: OdometryModel, source: str, log: Mapping[str, FloatArray]
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Return motion ahead and to the left (m) and turn (rad) since the sample before; None where it is not logged."""
    if not set(WHEEL_COLUMNS[source]) <= log.keys():
        return None
    encoder = campaign.encoder
    if source == "front":
        if "steer_rad" not in log:
            return None
        front = model.front or FrontModel.of(campaign.vehicle)
        rolled = np.diff(log["counts_front"], prepend=log["counts_front"][:1]) * (2 * np.pi / encoder.front)
        ahead, turn = front_motion(front, rolled, log["steer_rad"])
        return ahead, np.zeros_like(ahead), turn
    wheels = model.mecanum or mecanum_model(campaign)
    per_rev = (encoder.counts_per_rev_left, encoder.counts_per_rev_right) * 2
    front_left, front_right, rear_left, rear_right = (
        np.diff(log[name], prepend=log[name][:1]) * (2 * np.pi / scale)
        for name, scale in zip(WHEEL_COLUMNS["wheels"], per_rev, strict=True)
    )
    quarter = 0.25 * wheels.radius_m
    return (
        quarter * (front_left + front_right + rear_left + rear_right),
        quarter * (-front_left + front_right + rear_left - rear_right),
        quarter * (-front_left + front_right - rear_left + rear_right) / wheels.arm_m,
    )


def mecanum_model(campaign: Campaign) -> MecanumModel:
    """Return what the campaign's model, else its vehicle, says of four mecanum wheels.

    Raises BadInputError where neither says l + w.
    """
    if campaign.model.mecanum is not None:
        return campaign.model.mecanum
    arm = campaign.vehicle.half_length_plus_half_width_m
    if arm is None:
        raise BadInputError(
            "campaign.toml, vehicle.half_length_plus_half_width_m: found nothing; expected half the wheelbase plus "
            "half the track of the mecanum vehicle; give it"
        )
    return MecanumModel(campaign.vehicle.wheel_radius_m, arm)


def front_motion(front: FrontModel, rolled_rad: FloatArray, steer_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what the axle's middle moves ahead (m) and turns (rad) in each step of the front wheel (Eqs 12 to 14).

    `front`: radius, wheelbase, zero and scale of the steering angle; `rolled_rad` (shape (n,)): angle that the wheel
    rolled since the sample before; `steer_rad` (shape (n,)): steering angle at the samples, as the sensor says it.
    """
    angle = front.scale * steer_rad + front.zero_rad
    before = np.concatenate((angle[:1], angle[:-1]))
    # means over the ends of a step: over a whole turn their errors cancel, wherever the angle begins to change
    cosine = 2.0 / (1.0 / np.cos(before) + 1.0 / np.cos(angle))
    travel = front.radius_m * rolled_rad
    ahead = travel * cosine
    return ahead, 0.5 * ahead * (np.tan(before) + np.tan(angle)) / front.wheelbase_m
