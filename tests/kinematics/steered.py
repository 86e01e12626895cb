"""Tricycles and cars on free routes in numpy, written as campaign folders: no code of calib."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
#: step of the log and of the integration, s; what the campaign states
STEP_S: Final = 0.05
RADIUS_M, WHEELBASE_M, PER_REV = 0.1, 1.0, 4096.0
#: noise of the reference
SIGMA_M, SIGMA_RAD = 0.002, 0.001
#: fastest change of a steering angle
SLEW_RADPS: Final = 0.6


def free_angle(rng: np.random.Generator, targets: int = 8) -> Array:
    """Return a steering angle that goes to one target after another, no two runs alike; they end in a turn."""
    wanted = [np.full(int(rng.uniform(2.0, 5.0) / STEP_S), rng.uniform(-0.45, 0.45)) for _ in range(targets)]
    angle, out = 0.0, []
    for target in np.concatenate(wanted):
        angle += float(np.clip(target - angle, -SLEW_RADPS * STEP_S, SLEW_RADPS * STEP_S))
        out.append(angle)
    return np.array(out)


def late(angle: Array, lag_s: float) -> Array:
    """Return the angle of wheels that follow with a time constant."""
    wheel, out = 0.0, []
    for sensor in angle:
        wheel += (sensor - wheel) * STEP_S / (lag_s + STEP_S)
        out.append(wheel)
    return np.array(out)


def write(
    folder: Path,
    wheel: Callable[[Array, int], Array],
    *,
    runs: int = 24,
    radius_m: float = RADIUS_M,
    days: Sequence[float] = (1.0, 1.0, 1.0, 1.0),
    turned_rad: Sequence[float] = (0.0, 0.0, 0.0, 0.0),
    drive: str = "tricycle",
    along: bool = False,
) -> Path:
    """Write a campaign of end poses in sessions, or of poses along the path, of twice the noise.

    `wheel`: angle of the wheels by that of the sensor, in a session; `days`: factors on the radius, by session;
    `turned_rad`: by how much the reference's frame is turned, by session.
    """
    rng = np.random.default_rng(1)
    (folder / "logs").mkdir(parents=True)
    rows = ["run_id,log"] if along else ["run_id,session,ref_x_m,ref_y_m,ref_theta_rad,log"]
    column = "counts_front" if drive == "tricycle" else "counts_rear"
    for number in range(runs):
        session, sensor = number * len(days) // runs, free_angle(rng)
        rolled = np.full(len(sensor), rng.choice([0.4, 0.6, 0.8]) * STEP_S / RADIUS_M)
        angle = wheel(sensor, session)
        way = radius_m * days[session] * rolled
        ahead, turn = (way * np.cos(angle), way * np.sin(angle)) if drive == "tricycle" else (way, way * np.tan(angle))
        turn = turn / WHEELBASE_M + 3e-4 * np.sqrt(way) * rng.standard_normal(len(way))
        heading = np.cumsum(turn)
        middle = heading - 0.5 * turn
        end = np.array([np.sum(ahead * np.cos(middle)), np.sum(ahead * np.sin(middle)), heading[-1]])
        c, s = np.cos(turned_rad[session]), np.sin(turned_rad[session])
        end = np.array([c * end[0] - s * end[1], s * end[0] + c * end[1], end[2] + turned_rad[session]])
        x, y, theta = end + rng.normal(0.0, (SIGMA_M, SIGMA_M, SIGMA_RAD))
        counts = np.floor(np.append(0.0, np.cumsum(rolled)) * PER_REV / (2.0 * np.pi))
        logged = np.interp(np.arange(len(counts)), np.arange(len(sensor)) + 0.5, sensor)
        log = np.column_stack([np.arange(len(counts)) * STEP_S, counts, logged])
        head = f"t_s,{column},steer_rad"
        if along:
            path = np.stack([np.cumsum(ahead * np.cos(middle)), np.cumsum(ahead * np.sin(middle)), heading], axis=1)
            noise = 2.0 * rng.normal(0.0, (SIGMA_M, SIGMA_M, SIGMA_RAD), (len(log), 3))
            log = np.column_stack([log, np.vstack([np.zeros(3), path]) + noise])
            head += ",ref_x_m,ref_y_m,ref_theta_rad"
        np.savetxt(folder / f"logs/r{number}.csv", log, "%.6g", ",", header=head, comments="")
        end_pose = "" if along else f"d{session},{x:.5f},{y:.5f},{theta:.5f},"
        rows.append(f"r{number},{end_pose}logs/r{number}.csv")
    (folder / "runs.csv").write_text("\n".join(rows) + "\n")
    odometry = '[odometry]\nfrom = "front"\n' if drive == "tricycle" else ""
    (folder / "campaign.toml").write_text(
        f'format = "calib-campaign/1"\nsimulated = true\n[vehicle]\ndrive = "{drive}"\ntrack_m = 0.7\n'
        f"wheelbase_m = {WHEELBASE_M}\nwheel_radius_m = {RADIUS_M}\n[encoder]\ncounts_per_rev = {PER_REV:g}\n{odometry}"
        f"[reference]\nsigma_xy_m = {SIGMA_M}\nsigma_theta_rad = {SIGMA_RAD}\n"
    )
    return folder
