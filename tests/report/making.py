"""A made-up diagnosis in the shape of the contract, with arrays that fit it."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from calib.report.gap_findings import GapFindings

CHANNELS = (("distance", "m"), ("along", "m"), ("lateral", "m"), ("heading", "rad"))
NOISE = np.array([0.0015, 0.004, 0.008, 0.001])


def findings(seed: int = 0, n: int = 48) -> GapFindings:
    """Return findings on runs of four routes whose lateral and heading gap follows the turn."""
    rng = np.random.default_rng(seed)
    kinds = np.array(["square_ccw", "square_cw", "route_left", "corridor"])[np.arange(n) % 4]
    turn = np.array([2 * np.pi, -2 * np.pi, np.pi / 2, 0.0])[np.arange(n) % 4]
    paths = []
    for kind in kinds:
        t = np.linspace(0, 1, 60)
        if kind == "corridor":
            paths.append(np.column_stack((12 * t, 0 * t)))
        elif kind == "route_left":
            paths.append(np.column_stack((8 * np.sin(t * np.pi / 2), 8 * (1 - np.cos(t * np.pi / 2)))))
        else:
            side = 1 if kind.endswith("ccw") else -1
            corners = np.array([[0, 0], [4, 0], [4, 4 * side], [0, 4 * side], [0, 0.2 * side]], dtype=float)
            paths.append(np.concatenate([np.linspace(a, b, 15) for a, b in pairwise(corners)]))
    before = rng.normal(size=(n, 4)) * NOISE
    before[:, 2] += 0.01 * turn
    before[:, 3] += 0.003 * turn
    before[kinds != "corridor", 0] = np.nan
    after = np.where(np.isnan(before), np.nan, rng.normal(size=(n, 4)) * NOISE)
    verdict = {
        "verdict": "ambiguous",
        "sentence": "",
        "causes": [
            {
                "effect": "track_width",
                "title": "Track differs from the model's",
                "probability": 0.61,
                "share": 0.93,
                "parameters": {"relative": {"value": 3.02e-3, "ci95": [2.93e-3, 3.11e-3], "unit": "1"}},
                "remark": "",
            },
            {
                "effect": "curve_scrub",
                "probability": 0.37,
                "share": 0.93,
                "parameters": {},
                "remark": "suspect latency",
            },
        ],
        "credible_sets": [["track_width"], ["curve_scrub"]],
        "indistinguishable": [["track_width", "curve_scrub"]],
        "undetectable": {"side_slip": "2 mrad per m/s^2"},
        "where": {
            "channels": {name: {"rms": 0.02, "floor": float(NOISE[k])} for k, (name, _) in enumerate(CHANNELS)},
            "covariates": [{"name": "turn", "share": 0.9, "p_value": 1e-9}],
            "runs": [{"run_id": "r_004", "z": 4.2}],
            "places": [],
        },
        "closure": {
            "before_rms_m": 0.061,
            "after_rms_m": 0.0041,
            "floor_rms_m": 0.004,
            "fraction": 0.99,
            "ci95": [0.97, 1.0],
            "held_out": "session",
        },
        "recommended": False,
        "next_runs": [{"kind": "square_ccw", "payload_kg": 200, "speed_mps": 0.3, "why": "tells the two apart"}],
    }
    return GapFindings(
        verdict=verdict,
        channels=CHANNELS,
        before=before,
        after=after,
        floor=np.broadcast_to(NOISE, before.shape).copy(),
        group=kinds,
        covariates={"turn_rad": turn, "speed_mps": rng.uniform(0.2, 0.8, n), "payload_kg": rng.choice([0.0, 200.0], n)},
        paths_m=tuple(paths),
        offset_m=rng.normal(0, 0.01, (n, 2)) + 0.03,
    )
