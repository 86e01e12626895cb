"""What a run's ends say: distances and poses while the vehicle stands, and poses in the run's own start frame."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib.arrays import FloatArray
from calib.campaign.ingest.cut import moving

_REFERENCE = ("ref_x_m", "ref_y_m", "ref_theta_rad")


def from_start(columns: Mapping[str, FloatArray], *, poses: bool, distance: bool) -> dict[str, FloatArray]:
    """Return a run's columns with poses in its start frame and the range as distance from the start.

    The start is the median over the samples before the wheels turn, so that one noisy sample does not turn the path.

    `columns` (shape (n_samples,)): of one run; `poses`, `distance`: which of the two to change.
    """
    out = dict(columns)
    rest = _rest(columns, first=True)
    if poses and all(name in out for name in _REFERENCE):
        x, y, theta = (out[name] for name in _REFERENCE)
        x0, y0, theta0 = (_start(values, rest) for values in (x, y, theta))
        cos, sin = np.cos(theta0), np.sin(theta0)
        out["ref_x_m"] = cos * (x - x0) + sin * (y - y0)
        out["ref_y_m"] = -sin * (x - x0) + cos * (y - y0)
        out["ref_theta_rad"] = theta - theta0
    if distance and "range_m" in out:
        out["range_m"] = np.abs(out["range_m"] - _start(out["range_m"], rest))
    return out


def end_values(columns: Mapping[str, FloatArray]) -> dict[str, float]:
    """Return distance and end pose of a run: medians over the samples after the wheels have stopped.

    `columns` (shape (n_samples,)): of one run, its poses and range from the start.
    """
    rest = _rest(columns, first=False)
    pairs = {"distance_m": "range_m", **{name: name for name in _REFERENCE}}
    ends = {name: _median(columns[source][rest]) for name, source in pairs.items() if source in columns}
    return {name: value for name, value in ends.items() if np.isfinite(value)}


def _start(values: FloatArray, rest: slice) -> float:
    """Return the value at rest, or the first one known where the sensor starts later than the wheels."""
    value = _median(values[rest])
    known = values[np.isfinite(values)]
    return float(known[0]) if np.isnan(value) and len(known) else value


def _median(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else float("nan")


def _rest(columns: Mapping[str, FloatArray], *, first: bool) -> slice:
    """Return the samples before the wheels turn, or after; at least one."""
    time = columns["t_s"]
    wheels = [values for name, values in columns.items() if name.startswith("counts_")]
    driving = np.flatnonzero(moving(time, wheels))
    if not len(driving):
        return slice(0, 1) if first else slice(len(time) - 1, None)
    if first:
        return slice(0, max(1, int(driving[0])))
    # flags look half a second ahead: the last of them stands before the stop
    still = [np.flatnonzero(np.abs(values - values[-1]) > 1.5) for values in wheels]
    last = max((int(one[-1]) + 1 for one in still if len(one)), default=0)
    return slice(min(last, len(time) - 1), None)
