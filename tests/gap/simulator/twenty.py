"""A simulator in numpy with twenty parameters: ``python twenty.py CAMPAIGN PARAMETERS OUT``."""

from __future__ import annotations

import csv
import json
import sys
import tomllib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

#: name -> nominal value, step of the finite difference, largest plausible deviation, unit
PARAMETERS = {
    "wheel_radius_left": (0.1, 5e-4, 5e-3, "m"),
    "wheel_radius_right": (0.1, 5e-4, 5e-3, "m"),
    "track": (0.7, 5e-3, 5e-2, "m"),
    "load_slope_left": (0.0, 1e-7, 5e-6, "m/N"),
    "load_slope_right": (0.0, 1e-7, 5e-6, "m/N"),
    "track_per_load": (0.0, 1e-6, 5e-5, "m/N"),
    "temperature_slope": (0.0, 1e-5, 1e-3, "1/K"),
    "speed_slope": (0.0, 1e-3, 5e-2, "s/m"),
    "scrub": (0.0, 1e-3, 5e-2, ""),
    "side_slip": (0.0, 1e-3, 5e-2, "m"),
    "left_turn": (0.0, 1e-3, 5e-2, ""),
    "drift": (0.0, 1e-4, 1e-2, "rad/m"),
    "start_x": (0.0, 1e-3, 5e-2, "m"),
    "start_y": (0.0, 1e-3, 5e-2, "m"),
    "start_yaw": (0.0, 1e-3, 1e-1, "rad"),
    "floor_east": (0.0, 1e-4, 1e-2, ""),
    "floor_north": (0.0, 1e-4, 1e-2, ""),
    "first_metre": (0.0, 1e-3, 5e-2, "m"),
    "wave_cos": (0.0, 1e-4, 1e-2, "rad/m"),
    "wave_sin": (0.0, 1e-4, 1e-2, "rad/m"),
}
NOMINAL = {name: nominal for name, (nominal, *_) in PARAMETERS.items()}
#: of a wave of the floor
WAVE_M = 3.0


def simulate(
    angles_rad: np.ndarray, dt_s: np.ndarray, loads_N: np.ndarray, warmer_K: float, p: Mapping[str, float]
) -> tuple[float, float, float]:
    """Return the end pose for angles (n, 2) of the left and right wheel under loads (2,), steps of dt_s (n - 1,)."""
    over_N = loads_N - 300.0
    radii = np.array([p["wheel_radius_left"], p["wheel_radius_right"]])
    radii = (radii + over_N * [p["load_slope_left"], p["load_slope_right"]]) * (1.0 + p["temperature_slope"] * warmer_K)
    travel = np.diff(angles_rad, axis=0) * radii
    way = travel.mean(axis=1)
    way = way * (1.0 - p["speed_slope"] * np.abs(way) / dt_s)
    turn = (travel[:, 1] - travel[:, 0]) / (p["track"] + p["track_per_load"] * over_N.mean())
    curvature = turn / np.where(way == 0.0, np.inf, way)
    turn = turn * (1.0 - p["scrub"] * np.abs(curvature) + p["left_turn"] * (turn > 0.0))
    gone = np.cumsum(way) - 0.5 * way
    wave = 2.0 * np.pi * gone / WAVE_M
    turn = turn + way * (p["drift"] + p["wave_cos"] * np.cos(wave) + p["wave_sin"] * np.sin(wave))
    heading = np.cumsum(turn) - 0.5 * turn + p["start_yaw"]
    chord = way * np.sinc(0.5 * turn / np.pi) * (1.0 - p["first_metre"] * (gone < 1.0))
    aside = -p["side_slip"] * curvature * np.abs(way)
    length = np.abs(way).sum()
    x = chord @ np.cos(heading) - aside @ np.sin(heading) + p["start_x"] + p["floor_east"] * length
    y = chord @ np.sin(heading) + aside @ np.cos(heading) + p["start_y"] + p["floor_north"] * length
    return float(x), float(y), float(turn.sum())


def ends(campaign: Path, given: Mapping[str, float]) -> dict[str, tuple[float, float, float]]:
    """Return the end pose of every run of a campaign's folder, by its name."""
    settings = tomllib.loads((campaign / "campaign.toml").read_text())
    rad_per_count = 2 * np.pi / settings["encoder"]["counts_per_rev"]
    found = {}
    with (campaign / "runs.csv").open(newline="") as runs:
        for run in csv.DictReader(runs):
            header, *rows = (campaign / run["log"]).read_text().splitlines()
            columns = [header.split(",").index(name) for name in ("t_s", "counts_left", "counts_right")]
            log = np.array([row.split(",") for row in rows])[:, columns].astype(float)
            loads_N = np.array([float(run[f"load_{wheel}_N"]) for wheel in ("left", "right")])
            warmer_K = float(run["temperature_C"]) - 20.0
            found[run["run_id"]] = simulate(
                log[:, 1:] * rad_per_count, np.diff(log[:, 0]), loads_N, warmer_K, NOMINAL | dict(given)
            )
    return found


def main(campaign: Path, parameters: Path, out: Path) -> None:
    """Write where every run ends."""
    rows = [
        f"{run_id},{x},{x},{y},{theta}"
        for run_id, (x, y, theta) in ends(campaign, json.loads(parameters.read_text())).items()
    ]
    out.write_text("\n".join(["run_id,sim_distance_m,sim_x_m,sim_y_m,sim_theta_rad", *rows]))


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
