"""Radii and campaigns in memory for the tests of this folder."""

from __future__ import annotations

import numpy as np

from calib.campaign.model import Campaign, Logs, RunTable
from calib.campaign.settings import Encoder, OdometryModel, Rangefinder, Reference
from calib.vehicle import Vehicle

COUNTS_PER_REV = 4096.0


def woven_counts(
    amplitude: float,
    wavelength: float,
    distance: float,
    phase: float,
    radius_left: float,
    radius_right: float,
    n: int = 800,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the counters, whole counts, of a run along y = A sin(2 pi x / lambda + phase), by fine trapezoids."""
    x = np.linspace(0.0, distance, 100_001)
    k = 2 * np.pi / wavelength
    slope = amplitude * k * np.cos(k * x + phase)
    length = np.hypot(1.0, slope)
    rolled = np.concatenate(([0.0], np.cumsum(0.5 * (length[1:] + length[:-1]) * np.diff(x))))
    turned = np.arctan(slope) - np.arctan(slope[0])
    pick = np.linspace(0, len(x) - 1, n).astype(int)
    left = (rolled - 0.35 * turned) / (2 * np.pi * radius_left) * COUNTS_PER_REV
    right = (rolled + 0.35 * turned) / (2 * np.pi * radius_right) * COUNTS_PER_REV
    return np.floor(left[pick]), np.floor(right[pick])


def campaign_of(
    numbers: dict[str, np.ndarray],
    *,
    logs: list[tuple[np.ndarray, np.ndarray]] | None = None,
    labels: dict[str, np.ndarray] | None = None,
    excluded: np.ndarray | None = None,
) -> Campaign:
    """Return a campaign of the given columns."""
    n = len(next(iter(numbers.values())))
    if logs is None:
        tables = Logs.empty(n)
    else:
        lengths = [len(left) for left, _ in logs]
        tables = Logs(
            offsets=np.concatenate(([0], np.cumsum(lengths))).astype(np.int64),
            columns={
                "t_s": np.concatenate([0.1 * np.arange(length) for length in lengths]),
                "counts_left": np.concatenate([left for left, _ in logs]),
                "counts_right": np.concatenate([right for _, right in logs]),
            },
        )
    names = {"run_id": np.array([f"r{run}" for run in range(n)]), "session": np.full(n, "s")}
    return Campaign(
        root=None,
        name="test",
        simulated=True,
        vehicle=Vehicle(),
        encoder=Encoder(),
        model=OdometryModel(0.1, 0.1, 0.7, 300.0),
        rangefinder=Rangefinder(),
        reference=Reference(),
        runs=RunTable(
            labels={**names, **(labels or {})},
            numbers={name: np.asarray(column, dtype=float) for name, column in numbers.items()},
            excluded=np.zeros(n, dtype=bool) if excluded is None else excluded,
            line=np.arange(2, n + 2),
        ),
        logs=tables,
    )


def straight(radius_left: np.ndarray, radius_right: np.ndarray, load: np.ndarray, distance: float = 40.0) -> Campaign:
    """Return a campaign of exactly straight runs with fractional counts, so that only the formula acts."""
    return campaign_of(
        {
            "distance_m": np.full(len(load), distance),
            "counts_left": distance / (2 * np.pi * radius_left) * COUNTS_PER_REV,
            "counts_right": distance / (2 * np.pi * radius_right) * COUNTS_PER_REV,
            "load_left_N": load,
            "load_right_N": load,
        }
    )
