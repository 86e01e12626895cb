"""The published calibration of a Khepera III with a laser, rebuilt: an oracle that shares no code with the estimate.

Censi, Franchi, Marchionni, Oriolo, IEEE T-RO 29(2), 2013: the heading follows linearly from the wheels' turning, which
gives r_L/b and r_R/b; with these, b and the laser's pose solve a linear problem with one quadratic constraint.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

#: rounds of dropping, and the quantile beyond which a tuple is dropped
ROUNDS, KEPT = 4, 0.99


def published(turned: np.ndarray, moved: np.ndarray) -> dict[str, float]:
    """Return diameters, axle and laser pose.

    Parameters
    ----------
    turned : array, shape (n, 2)
        Angle that the left and right wheel turned in each tuple.
    moved : array, shape (n, 3)
        Displacement by scan matching: x, y, heading.
    """
    kept = np.ones(len(turned), dtype=bool)
    for _ in range(ROUNDS):
        values = _solved(turned[kept], moved[kept])
        rest = moved - predicted(values, turned)
        heading, place = np.abs(rest[:, 2]), np.hypot(rest[:, 0], rest[:, 1])
        limits = [_limit(error[kept]) for error in (heading, place)]
        kept &= (heading <= limits[0]) & (place <= limits[1])
    left, right, axle, x, y, yaw = _solved(turned[kept], moved[kept])
    return {"l_diam": 2 * left, "r_diam": 2 * right, "axle": axle, "l_x": x, "l_y": y, "l_theta": yaw}


def _limit(errors: np.ndarray) -> float:
    """Return the error at the 99 % place of the sorted ones."""
    return float(np.sort(errors)[round(KEPT * len(errors))])


def _solved(turned: np.ndarray, moved: np.ndarray) -> np.ndarray:
    rates = np.linalg.lstsq(turned, moved[:, 2], rcond=None)[0]
    turn = turned @ rates
    way = 0.5 * (-rates[0] * turned[:, 0] + rates[1] * turned[:, 1])
    small = np.abs(turn) < 1e-12
    safe = np.where(small, 1.0, turn)
    cx = way * np.where(small, 1.0, np.sin(turn) / safe)
    cy = way * np.where(small, 0.0, (1.0 - np.cos(turn)) / safe)
    sx, sy = moved[:, 0], moved[:, 1]
    rows = np.concatenate(
        [
            np.stack([-cx, 1.0 - np.cos(turn), np.sin(turn), sx, -sy], axis=1),
            np.stack([-cy, -np.sin(turn), 1.0 - np.cos(turn), sy, sx], axis=1),
        ]
    )
    matrix = rows.T @ rows
    # eliminate axle and lever arm; the yaw's cosine and sine are the weaker direction of what remains
    inner = matrix[3:, 3:] - matrix[3:, :3] @ np.linalg.solve(matrix[:3, :3], matrix[:3, 3:])
    direction = np.linalg.eigh(inner)[1][:, 0]
    solution = -np.linalg.solve(matrix[:3, :3], matrix[:3, 3:] @ direction)
    if solution[0] < 0.0:
        direction, solution = -direction, -solution
    axle, x, y = solution
    return np.array([-rates[0] * axle, rates[1] * axle, axle, x, y, np.arctan2(direction[1], direction[0])])


def predicted(values: np.ndarray, turned: np.ndarray) -> np.ndarray:
    """Return the displacement (n, 3) that wheels of these radii, axle and laser pose give for each tuple."""
    left, right, axle, x, y, yaw = values
    turn = (right * turned[:, 1] - left * turned[:, 0]) / axle
    way = 0.5 * (right * turned[:, 1] + left * turned[:, 0])
    ratio = np.sinc(turn / (2 * np.pi))
    dx, dy = way * ratio * np.cos(turn / 2), way * ratio * np.sin(turn / 2)
    ax = dx + np.cos(turn) * x - np.sin(turn) * y - x
    ay = dy + np.sin(turn) * x + np.cos(turn) * y - y
    c, s = np.cos(yaw), np.sin(yaw)
    return np.stack([c * ax + s * ay, c * ay - s * ax, turn], axis=1)


def tuples_of(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return what the wheels turned, shape (n, 2), and how the scan matcher moved, shape (n, 3), of a recording."""
    decoder, text, at, tuples = json.JSONDecoder(), path.read_text(encoding="utf-8").strip(), 0, []
    while at < len(text):
        value, at = decoder.raw_decode(text, at)
        at += len(text[at:]) - len(text[at:].lstrip())
        tuples.append(value)
    duration = np.array([one["T"] for one in tuples])
    turned = np.array([[one["phi_l"], one["phi_r"]] for one in tuples]) * duration[:, None]
    return turned, np.array([one["sm"] for one in tuples])
