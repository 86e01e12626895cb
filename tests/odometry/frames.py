"""Poses seen from another frame."""

from __future__ import annotations

import numpy as np

from calib.odometry.poses import Poses


def moved(poses: Poses, by: Poses) -> Poses:
    """Return poses relative to `by` in the frame of `by` (``by`` o poses)."""
    cosine, sine = np.cos(by.theta_rad), np.sin(by.theta_rad)
    x_m, y_m = cosine * poses.x_m - sine * poses.y_m, sine * poses.x_m + cosine * poses.y_m
    return Poses(by.x_m + x_m, by.y_m + y_m, by.theta_rad + poses.theta_rad)
