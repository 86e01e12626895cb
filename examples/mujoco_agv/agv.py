"""The AGV in MuJoCo: the logged wheel angles and steering drive it, and where it ends is written.

Called as `python agv.py CAMPAIGN PARAMETERS OUT`.
"""

from __future__ import annotations

import csv
import json
import sys
import tomllib
from collections.abc import Mapping
from pathlib import Path

import mujoco
import numpy as np

MODEL = Path(__file__).with_name("agv.xml")
SETTLE_S = 0.4  # the contacts come to rest under the load before a run

TO_ANGLE_PER_S = 10.0
#: what is set where the parameters do not say
NOMINAL = {
    "wheel_radius_left": 0.1,
    "wheel_radius_right": 0.1,
    "track": 0.7,
    "payload_dx": 0.0,
    "payload_dy": 0.0,
    "steering_zero": 0.0,
    "friction": 0.8,
    "reference_delay": 0.0,
}


def build(p: Mapping[str, float], payload_kg: float, payload_x_m: float, payload_y_m: float) -> mujoco.MjModel:
    """Return the vehicle of `agv.xml` with the parameters set and a payload put on."""
    spec = mujoco.MjSpec.from_file(str(MODEL))
    for side, sign in (("left", 1.0), ("right", -1.0)):
        spec.geom(f"wheel_{side}").size[0] = p[f"wheel_radius_{side}"]
        spec.body(f"wheel_{side}").pos[1] = sign * 0.5 * p["track"]
    for wheel in ("left", "right", "front"):
        spec.geom(f"wheel_{wheel}").friction[0] = p["friction"]
    payload = spec.body("payload")
    payload.pos[:2] = payload_x_m + p["payload_dx"], payload_y_m + p["payload_dy"]
    payload.mass = max(payload_kg, 1e-3)
    return spec.compile()


def drive(model: mujoco.MjModel, t_s: np.ndarray, angles: np.ndarray, end_s: float) -> tuple[float, float, float]:
    """Return the pose at `end_s` from the pose at the start, for angles (n, 3) of left and right wheel and steering."""
    data, dt = mujoco.MjData(model), model.opt.timestep
    wheels = [model.joint(name).qposadr[0] for name in ("left", "right")]
    settling = round(SETTLE_S / dt)
    now = np.maximum(np.arange(-settling, round(end_s / dt)), 0) * dt
    angle = np.column_stack([np.interp(now, t_s, column) for column in angles.T])
    rate = np.column_stack([np.interp(now, t_s, column) for column in np.gradient(angles[:, :2], t_s, axis=0).T])
    rate[:settling] = 0.0
    poses = np.empty((len(now), 7))
    for step in range(len(now)):
        # the wheels' servos of speed: the logged rate, and what takes them to the logged angle
        data.ctrl[:2] = rate[step] + TO_ANGLE_PER_S * (angle[step, :2] - data.qpos[wheels])
        data.ctrl[2] = angle[step, 2]
        mujoco.mj_step(model, data)
        poses[step] = data.qpos[:7]
    w, x, y, z = poses[settling - 1 :, 3:].T
    heading = np.unwrap(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
    (dx, dy), c, s = poses[-1, :2] - poses[settling - 1, :2], np.cos(heading[0]), np.sin(heading[0])
    return float(c * dx + s * dy), float(c * dy - s * dx), float(heading[-1] - heading[0])


def end_of(folder: Path, run: Mapping[str, str], rad_per_count: float, p: Mapping[str, float]) -> list[float]:
    """Return the end pose (x, y, heading) of a row of runs.csv."""
    columns = ("t_s", "counts_left", "counts_right", "steer_rad")
    with (folder / run["log"]).open(newline="") as file:
        log = np.array([[float(row[name]) for name in columns] for row in csv.DictReader(file)])
    angles = log[:, 1:] * [rad_per_count, rad_per_count, 1.0] + [0.0, 0.0, p["steering_zero"]]
    model = build(p, *(float(run[name] or 0.0) for name in ("payload_kg", "payload_x_m", "payload_y_m")))
    # a reference that reads late shows where the vehicle was
    return list(drive(model, log[:, 0], angles, log[-1, 0] - p["reference_delay"]))


def main(campaign: Path, parameters: Path, out: Path) -> None:
    """Simulate every run of a campaign."""
    settings = tomllib.loads((campaign / "campaign.toml").read_text())
    rad_per_count = 2 * np.pi / settings["encoder"]["counts_per_rev"]
    p = NOMINAL | json.loads(parameters.read_text())
    with out.open("w", newline="") as file, (campaign / "runs.csv").open(newline="") as runs:
        table = csv.writer(file)
        table.writerow(["run_id", "sim_x_m", "sim_y_m", "sim_theta_rad"])
        for run in csv.DictReader(runs):
            table.writerow([run["run_id"], *end_of(campaign, run, rad_per_count, p)])


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
