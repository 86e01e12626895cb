"""Wheels that steer later than the log are told from side slip, which moves the ends of straight-ending runs alike."""

from pathlib import Path

import numpy as np
import pandas as pd

from calib.campaign.read import read_campaign
from calib.gap.diagnose import diagnose_in_full

STEP_S, LATE_S, WHEELBASE_M, PER_M = 0.002, 0.08, 1.0, 6519.0
SIGMA_M, SIGMA_RAD = 0.002, 0.0008


def drive(rng: np.random.Generator, curvature: float, speed_mps: float) -> tuple[pd.DataFrame, list[float]]:
    """The log and the end pose of an arc of a radian and a half between two straights, at one speed."""
    turning_s = 1.5 / abs(curvature) / speed_mps
    t = np.arange(0.0, turning_s + 4.0 / speed_mps, STEP_S)
    begin = 2.0 / speed_mps

    def steered(at_s: np.ndarray) -> np.ndarray:
        return np.interp(at_s, [begin, begin + 0.3, begin + turning_s, begin + turning_s + 0.3], [0.0, 1.0, 1.0, 0.0])

    angle = float(np.arctan(curvature * WHEELBASE_M))
    turn = np.cumsum(np.tan(angle * steered(t - LATE_S)) / WHEELBASE_M) * speed_mps * STEP_S
    x, y = (np.cumsum(part) * speed_mps * STEP_S for part in (np.cos(turn), np.sin(turn)))
    every = slice(None, None, 20)
    counts = np.floor(PER_M * speed_mps * t)[every]
    log = pd.DataFrame({"t_s": t[every], "counts_rear": counts, "steer_rad": angle * steered(t)[every]})
    last = 20 * (len(log) - 1)
    noise = rng.normal(size=3) * [SIGMA_M, SIGMA_M, SIGMA_RAD]
    return log, (np.array([x[last], y[last], turn[last]]) + noise).tolist()


def test_a_wheel_that_steers_later_is_no_side_slip(tmp_path: Path) -> None:
    """To first order both move the ends by the same; a path of the right delay leaves less than one of slip."""
    rng, rows = np.random.default_rng(4), ["run_id,session,kind,log,ref_x_m,ref_y_m,ref_theta_rad"]
    (tmp_path / "logs").mkdir()
    arcs = [(side / radius, speed) for side in (1, -1) for radius in (2.0, 3.0) for speed in (0.5, 0.9)]
    for number, (curvature, speed) in enumerate(arcs * 3):
        log, end = drive(rng, curvature, speed)
        log.to_csv(tmp_path / "logs" / f"r{number}.csv", index=False)
        kind = f"arc {curvature:.2f} at {speed}"
        rows.append(f"r{number},s1,{kind},logs/r{number}.csv,{','.join(f'{value:.6f}' for value in end)}")
    (tmp_path / "runs.csv").write_text("\n".join(rows) + "\n")
    (tmp_path / "campaign.toml").write_text(
        f"""format = "calib-campaign/1"
simulated = true
[vehicle]
drive = "ackermann"
track_m = 0.7
wheelbase_m = {WHEELBASE_M}
wheel_radius_m = 0.1
[encoder]
counts_per_rev = {PER_M * 2.0 * np.pi * 0.1:.6f}
[reference]
sigma_xy_m = {SIGMA_M}
sigma_theta_rad = {SIGMA_RAD}
"""
    )
    found = diagnose_in_full(read_campaign(tmp_path), plan=False)
    (first, *_) = found.causes
    assert first.effect == "steering_delay"
    low, high = first.parameters["delay"].ci95
    assert low < -LATE_S < high
