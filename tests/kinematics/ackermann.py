"""An Ackermann vehicle and its logs.

The vehicle is a plain numpy integration that shares no code with calib: fine steps, its own slip, noise on the
reference, whole counts.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

#: fine steps of the vehicle, and samples of its log
STEP_S, EVERY = 0.002, 10
#: nominal lengths
WHEELBASE_M, RADIUS_M, TRACK_M, PER_REV = 0.30, 0.05, 0.20, 2048.0
#: noise of the reference
SIGMA_M, SIGMA_RAD = 1e-3, 1e-3


@dataclass(frozen=True)
class Truth:
    """How the vehicle is beside its nominal lengths."""

    radius: float = 0.99
    wheelbase: float = 1.01
    zero_rad: float = 0.012
    sensor: tuple[float, float, float] = (0.115, -0.010, 0.008)
    understeer: float = 0.0
    side_slip: float = 0.0
    fastest_mps: float = 0.9


def drive(truth: Truth, seed: int, columns: str, seconds: float) -> dict[str, np.ndarray]:
    """Return the log of one run: a steering angle that swings about a mean, a speed that rises and falls."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds + STEP_S, STEP_S)
    swing = rng.uniform(0.1, 0.3) * np.sin(2.0 * np.pi * t / rng.uniform(4.0, 9.0))
    steer = swing + rng.uniform(-0.2, 0.2)
    speed = rng.uniform(0.4, 1.0) * truth.fastest_mps * np.sin(np.pi * t / seconds) ** 2
    curvature = np.tan(steer + truth.zero_rad) / (truth.wheelbase * WHEELBASE_M * (1.0 + truth.understeer * speed**2))
    theta = np.concatenate(([0.0], np.cumsum(STEP_S * 0.5 * ((speed * curvature)[1:] + (speed * curvature)[:-1]))))
    course = theta - truth.side_slip * speed**2 * curvature
    x, y = (
        np.concatenate(([0.0], np.cumsum(STEP_S * 0.5 * (part[1:] + part[:-1]))))
        for part in (speed * np.cos(course), speed * np.sin(course))
    )
    way = np.concatenate(([0.0], np.cumsum(STEP_S * 0.5 * (speed[1:] + speed[:-1]))))
    ahead, left, yaw = truth.sensor
    n = len(t[::EVERY])
    log = {
        "t_s": t[::EVERY],
        "steer_rad": steer[::EVERY],
        "ref_x_m": (x + ahead * np.cos(theta) - left * np.sin(theta))[::EVERY] + rng.normal(0.0, SIGMA_M, n),
        "ref_y_m": (y + ahead * np.sin(theta) + left * np.cos(theta))[::EVERY] + rng.normal(0.0, SIGMA_M, n),
        "ref_theta_rad": theta[::EVERY] + yaw + rng.normal(0.0, SIGMA_RAD, n),
    }
    if columns == "counts":
        log["counts_rear"] = np.floor(way[::EVERY] / (truth.radius * RADIUS_M) * PER_REV / (2.0 * np.pi))
    elif columns == "speed":
        log["speed_rear_mps"] = speed[::EVERY] / truth.radius
    elif columns == "v and omega":
        del log["steer_rad"]
        log |= {"v_mps": speed[::EVERY] / truth.radius, "omega_radps": (speed * curvature)[::EVERY] / truth.radius}
    else:
        del log["steer_rad"]
        half = 0.5 * TRACK_M * (speed * curvature)[::EVERY]
        forward = speed[::EVERY]
        log |= {
            "speed_left_mps": (forward - half) / truth.radius,
            "speed_right_mps": (forward + half) / truth.radius,
        }
    return log


def campaign(
    folder: Path,
    truth: Truth,
    columns: str = "counts",
    kind: str = "ackermann",
    runs: int = 12,
    seconds: float = 12.0,
) -> Path:
    """Write a campaign; return its folder."""
    (folder / "logs").mkdir(parents=True)
    rows = ["run_id,session,kind,log"]
    for number in range(runs):
        name = f"r{number:02d}"
        log = drive(truth, 100 + number, columns, seconds)
        lines = [",".join(f"{value:.9g}" for value in row) for row in zip(*log.values(), strict=True)]
        (folder / "logs" / f"{name}.csv").write_text("\n".join([",".join(log), *lines]) + "\n")
        rows.append(f"{name},day 1,winding,logs/{name}.csv")
    (folder / "runs.csv").write_text("\n".join(rows) + "\n")
    encoder = f"counts_per_rev = {PER_REV:g}" if columns == "counts" else 'kind = "speed"'
    (folder / "campaign.toml").write_text(
        f"""format = "calib-campaign/1"
simulated = true
[vehicle]
drive = "{kind}"
track_m = {TRACK_M}
wheelbase_m = {WHEELBASE_M}
wheel_radius_m = {RADIUS_M}
mass_kg = 10
cog_x_m = 0.15
[encoder]
{encoder}
[reference]
sigma_xy_m = {SIGMA_M}
sigma_theta_rad = {SIGMA_RAD}
frame = "map"
"""
    )
    return folder


def spoilt(folder: Path, column: str, change: Callable[[np.ndarray], np.ndarray]) -> Path:
    """Change one column of every log of a campaign."""
    for path in sorted((folder / "logs").glob("*.csv")):
        table = pd.read_csv(path)
        table[column] = change(table[column].to_numpy())
        table.to_csv(path, index=False)
    return folder
