"""Odometry from a front wheel or from four wheels, replayed as the two wheels on one axle that stand in for them."""

from __future__ import annotations

import numpy as np

from calib.arrays import FloatArray
from calib.campaign.model import Campaign
from calib.campaign.settings import OdometryModel
from calib.campaign.wheels import ASIDE, on_one_axle
from calib.coefficients.file import CoefficientFile
from calib.motion.odometry.integrate import integrate
from calib.motion.odometry.loaded import travel_from_counts
from calib.motion.poses import Poses


def stood_in(campaign: Campaign, model: OdometryModel, *, scheme: str = "exact") -> tuple[Poses, FloatArray]:
    """Return the poses at all samples (n_samples,), each run from (0, 0, 0), and what was rolled in each step.

    That is the way of the axle's middle, to the side included, since the sample before; 0 at the first of a run. The
    campaign has no rear wheels, and each run a log; the model says what is believed of the front wheel or the four
    wheels.
    """
    axle = on_one_axle(campaign, model)
    columns, offsets = axle.logs.columns, axle.logs.offsets
    n = int(offsets[-1])
    radii = np.full(n, model.radius_left_m), np.full(n, model.radius_right_m)
    left, right = travel_from_counts(
        columns["counts_left"], columns["counts_right"], axle.encoder, *radii, offsets=offsets
    )
    poses = integrate(left, right, model.track_m, offsets=offsets, scheme=scheme)
    ahead = 0.5 * (left + right)
    if ASIDE not in columns:
        return poses, np.abs(ahead)
    aside = np.diff(columns[ASIDE], prepend=0.0)
    aside[offsets[:-1]] = 0.0
    half = 0.5 * (right - left) / model.track_m
    chord = aside * np.sinc(half / np.pi)
    x, y = (
        _running(part, offsets)
        for part in (-chord * np.sin(poses.theta_rad - half), chord * np.cos(poses.theta_rad - half))
    )
    return Poses(poses.x_m + x, poses.y_m + y, poses.theta_rad), np.hypot(ahead, aside)


def of_vehicle(ends: Poses, coefficients: CoefficientFile) -> Poses:
    """Return end poses of the reference's sensor, since its own start, as the vehicle's: V = X S X^-1.

    The geometry of the coefficient file says where on the vehicle the sensor sits, X.
    """
    together = coefficients.joint_geometry
    values = {} if together is None else {name: part.value for name, part in together.parameters.items()}
    x, y, yaw = (values.get(name, 0.0) for name in ("sensor_x_m", "sensor_y_m", "sensor_yaw_rad"))
    place = Poses(np.array(x), np.array(y), np.array(yaw))
    cosine, sine = np.cos(yaw), np.sin(yaw)
    back = Poses(np.array(-cosine * x - sine * y), np.array(sine * x - cosine * y), np.array(-yaw))
    return back.moved(ends.moved(place))


def _running(steps: FloatArray, offsets: np.ndarray) -> FloatArray:
    """Return the running sum within each run; the first step of a run is 0."""
    total = np.cumsum(steps)
    return np.asarray(total - np.repeat(total[offsets[:-1]], np.diff(offsets)))
