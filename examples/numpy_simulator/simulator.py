"""A simulator in numpy: the wheel angles of each run drive two wheels. python simulator.py CAMPAIGN PARAMETERS OUT."""

import csv
import json
import sys
import tomllib
from pathlib import Path

import numpy as np

WHEELS = ("left", "right")


def simulate(angles_rad: np.ndarray, loads_N: list[float], p: dict[str, float]) -> tuple[float, float, float]:
    """Return the end pose for angles (n, 2) of the left and right wheel under their loads."""
    radii = [p[f"wheel_radius_{w}"] + p["load_slope"] * (N - 300.0) for w, N in zip(WHEELS, loads_N, strict=True)]
    travel = np.diff(angles_rad, axis=0) * radii
    turn = (travel[:, 1] - travel[:, 0]) / p["track"]
    heading = np.cumsum(turn) - 0.5 * turn + p["start_yaw"]
    chord = travel.mean(axis=1) * np.sinc(0.5 * turn / np.pi)  # of the arc
    return float(chord @ np.cos(heading)), float(chord @ np.sin(heading)), float(turn.sum())


def main(campaign: Path, parameters: Path, out: Path) -> None:
    """Simulate every run of a campaign."""
    settings = tomllib.loads((campaign / "campaign.toml").read_text())
    rad_per_count = 2 * np.pi / settings["encoder"]["counts_per_rev"]
    p = json.loads(parameters.read_text())
    rows = ["run_id,sim_distance_m,sim_x_m,sim_y_m,sim_theta_rad"]
    for run in csv.DictReader((campaign / "runs.csv").read_text().splitlines()):
        log = list(csv.DictReader((campaign / run["log"]).read_text().splitlines()))
        counts = np.array([[float(row["counts_left"]), float(row["counts_right"])] for row in log])
        loads_N = [float(run[f"load_{wheel}_N"]) for wheel in WHEELS]
        x, y, theta = simulate(counts * rad_per_count, loads_N, p)
        rows.append(f"{run['run_id']},{x},{x},{y},{theta}")
    out.write_text("\n".join(rows))


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
