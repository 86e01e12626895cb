"""A campaign whose reality is the AGV in MuJoCo with hidden changes.

python make_campaign.py FOLDER wheel_radius_left=0.0994 [NAME=VALUE ...]

Hidden may be what SIM.toml lists, and `friction` (0.8) and `reference_delay` (0 s), which it does not.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import numpy as np
from agv import NOMINAL, end_of

TRACK_M, WHEELBASE_M, RADIUS_M, COUNTS = 0.7, 1.0, 0.1, 65536
PERIOD_S, ACCELERATE_MPS2, BRAKE_MPS2 = 0.04, 0.8, 3.0
SIGMA_M, SIGMA_RAD = 0.002, 0.0008
#: kind -> pieces of length in m and curvature in 1/m; the curvature is reached over BLEND_M
ROUTES = {
    "corridor": [(5.0, 0.0)],
    "square_ccw": [(1.0, 0.0), (1.6, 1.0)] * 2,
    "square_cw": [(1.0, 0.0), (1.6, -1.0)] * 2,
    "turn_left": [(1.5, 0.0), (1.6, 0.7), (1.5, 0.0)],
}
BLEND_M = 0.4
SETTINGS = f"""format = "calib-campaign/1"
name = "mujoco_agv"
simulated = true

[vehicle]
track_m = {TRACK_M}
wheelbase_m = {WHEELBASE_M}
wheel_radius_m = {RADIUS_M}
mass_kg = 100.0
cog_x_m = 0.388

[encoder]
counts_per_rev = {COUNTS}

[reference]
sigma_xy_m = {SIGMA_M}
sigma_theta_rad = {SIGMA_RAD}
"""


def log_of(pieces: list[tuple[float, float]], speed_mps: float, stops: bool) -> np.ndarray:
    """Return a log, columns t_s, counts_left, counts_right, steer_rad: what a vehicle without a fault would record."""
    length = sum(piece for piece, _ in pieces)
    t, s, v = [0.0], [0.0], 0.0
    while s[-1] < length - 1e-6:
        # as fast as it can still stop, where it stops
        brake = np.sqrt(2.0 * BRAKE_MPS2 * max(length - s[-1], 0.0)) if stops else speed_mps
        v = min(v + ACCELERATE_MPS2 * PERIOD_S, speed_mps, brake)
        s.append(min(s[-1] + max(v, 0.02) * PERIOD_S, length))
        t.append(t[-1] + PERIOD_S)
    if stops:
        t.append(t[-1] + 1.0)
        s.append(s[-1])
    way, fine = np.array(s), np.linspace(0.0, length, 4001)
    ends = np.cumsum([piece for piece, _ in pieces])
    curved = np.array([kappa for _, kappa in pieces])[np.minimum(np.searchsorted(ends, fine), len(pieces) - 1)]
    n = round(BLEND_M / (fine[1] - fine[0]))
    curvature = np.convolve(np.pad(curved, n // 2, mode="edge"), np.ones(n) / n, mode="same")[n // 2 :][: len(fine)]
    turned = np.concatenate([[0.0], np.cumsum(0.5 * (curvature[1:] + curvature[:-1]) * np.diff(fine))])
    turn = np.interp(way, fine, turned)
    counts = (way[:, None] + 0.5 * TRACK_M * turn[:, None] * [-1.0, 1.0]) / RADIUS_M * COUNTS / (2 * np.pi)
    steer = np.arctan(WHEELBASE_M * np.interp(way, fine, curvature))
    return np.column_stack([t, np.round(counts), steer])


def main(
    folder: Path,
    hidden: dict[str, float],
    payloads_kg: tuple[float, ...] = (0.0, 300.0),
    kinds: tuple[str, ...] = tuple(ROUTES),
) -> None:
    """Write the campaign: each kind under each payload, with a stop and passing the end, in two sessions."""
    (folder / "logs").mkdir(parents=True)
    (folder / "campaign.toml").write_text(SETTINGS)
    rng, rows = np.random.default_rng(0), []
    for session in ("s1", "s2"):
        for payload_kg in payloads_kg:
            for kind, pieces in ((kind, ROUTES[kind]) for kind in kinds):
                for speed_mps, stops in ((0.6, True), (1.0, False)):
                    run = {
                        "run_id": f"r{len(rows):03d}",
                        "session": session,
                        "kind": kind if stops else f"{kind}_passing",
                        "direction": "out",
                        "payload_kg": payload_kg,
                        "payload_x_m": 0.4,
                        "payload_y_m": 0.0,
                        "speed_mps": speed_mps,
                        "log": f"logs/r{len(rows):03d}.csv",
                    }
                    log = log_of(pieces, speed_mps, stops)
                    with (folder / str(run["log"])).open("w", newline="") as file:
                        csv.writer(file).writerows([["t_s", "counts_left", "counts_right", "steer_rad"], *log.tolist()])
                    texts = {name: str(value) for name, value in run.items()}
                    end = end_of(folder, texts, 2 * np.pi / COUNTS, NOMINAL | hidden)
                    read = np.array(end) + rng.normal(0.0, [SIGMA_M, SIGMA_M, SIGMA_RAD])
                    counts = dict(zip(("counts_left", "counts_right"), log[-1, 1:3], strict=True))
                    ends = dict(zip(("ref_x_m", "ref_y_m", "ref_theta_rad"), read, strict=True))
                    rows.append(run | counts | ends)
    with (folder / "runs.csv").open("w", newline="") as file:
        table = csv.DictWriter(file, list(rows[0]))
        table.writeheader()
        table.writerows(rows)


if __name__ == "__main__":
    main(Path(sys.argv[1]), {name: float(value) for name, value in (part.split("=") for part in sys.argv[2:])})
