"""Trends that are no noise: what the surroundings may do to the radii, whatever effect is behind it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.arrays import FloatArray
from calib.campaign.model import NUMERIC_COLUMNS
from calib.gap.predict.path import Path

Column = tuple[FloatArray, tuple[int, ...]]


def surroundings(path: Path) -> FloatArray:
    """Return what both radii may do with the surroundings, shape (n_units, 6, k)."""
    observations = path.s
    waited = observations.number("minutes_under_load")
    load = observations.number("load_left_N") + observations.number("load_right_N")
    values = [
        observations.number("temperature_C"),
        waited,
        np.log1p(np.maximum(np.nan_to_num(waited), 0.0) / 5.0) * load,
    ]
    values += [column for name, column in observations.numbers.items() if name not in NUMERIC_COLUMNS]
    columns = [(column, (0, 1)) for value in values for column in _standardised(value)]
    return np.concatenate([_on_radii(path, columns), session_steps(path)], axis=2)


def session_steps(path: Path) -> FloatArray:
    """Return what each radius may step by from session to session, shape (n_units, 6, k)."""
    sessions = path.s.labels["session"]
    steps = [(sessions == name).astype(np.float64) for name in np.unique(sessions)[1:]]
    return _on_radii(path, [(column, (0, 1)) for step in steps for column in _standardised(step)])


def interactions(path: Path) -> list[FloatArray]:
    """Return what the surroundings may do differently under another load or at another speed.

    One array (n_units, 6, 2) for each of temperature and dwell with each of total load, own load, speed and turning,
    where they vary.
    """
    observations = path.s
    left, right = observations.number("load_left_N"), observations.number("load_right_N")
    speed, turned = observations.number("speed_mps"), observations.total(np.abs(observations.turn_rad))
    total = left + right
    others = ((total, total), (left, right), (speed, speed), (turned, turned))
    trends = []
    for value in (observations.number("temperature_C"), observations.number("minutes_under_load")):
        for first in _standardised(value):
            for pair in others:
                columns = [(first * second, (k,)) for k in (0, 1) for second in _standardised(pair[k])]
                if columns:
                    trends.append(_on_radii(path, columns))
    return trends


def driven(path: Path) -> FloatArray:
    """Return what each radius may do with its own load (straight and curved) and with the speed, shape (n_units, 6, k).

    For runs of one route of which none was driven twice.
    """
    observations = path.s
    columns: list[Column] = []
    for wheel, side in enumerate(("left", "right")):
        for load in _standardised(observations.number(f"load_{side}_N")):
            columns += [(load, (wheel,)), *((curved, (wheel,)) for curved in _standardised(load**2))]
    columns += [(speed, (0, 1)) for speed in _standardised(observations.number("speed_mps"))]
    return _on_radii(path, columns)


def _on_radii(path: Path, columns: Sequence[Column]) -> FloatArray:
    """Return a hundredth of each column acting on the radius of the wheels named, shape (n_units, 6, k)."""
    pushed = [path.calibration[:, :, k] * column[:, None] * 1e-2 for column, wheels in columns for k in wheels]
    stacked = np.stack(pushed, axis=2) if pushed else np.zeros((len(path.s), 6, 0))
    return np.where(path.s.usable[:, :, None], stacked, 0.0)


def _standardised(values: FloatArray) -> list[FloatArray]:
    """Return the values less their mean over their spread; nothing where they do not vary."""
    if not np.isfinite(values).any():
        return []
    filled = np.nan_to_num(values - np.nanmean(values))
    spread = float(filled.std())
    return [filled / spread] if spread > 1e-9 else []
