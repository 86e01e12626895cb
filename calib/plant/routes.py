"""The routes that the plant drives, as tables of pose and curvature by arc length."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.errors import BadInputError
from calib.types import FloatArray

PITCH_M: Final = 0.01
#: length of ``corridor_short`` over that of ``corridor``
SHORT: Final = 0.6
_EASE_M: Final = 0.6  # curvature changes over this length, as a steered wheel cannot jump
_TAIL_M: Final = 3.0  # straight run-out behind the end, for runs read while still rolling

Segment = tuple[float, float]  # length in m, curvature in 1/m

_QUARTER: Final = np.pi / 2


def segments_of(kind: str, *, length_m: float, side_m: float, radius_m: float) -> list[Segment]:
    """Return a route as straights and arcs: (length in m, curvature per m), left turns positive.

    ``corridor`` (``corridor_b`` is its second lane, ``corridor_short`` a part of it), ``square_cw``, ``square_ccw``,
    ``figure8``, ``route_left``, ``route_right`` or ``slalom``. The squares have straight sides of `side_m` and corners
    of `radius_m`; the circles of the eight have 1.6 times that radius.
    """
    stem = re.sub(r"_b$", "", kind)
    if stem == "corridor":
        return [(length_m, 0.0)]
    if stem == "corridor_short":
        return [(SHORT * length_m, 0.0)]
    if stem in {"square_cw", "square_ccw"}:
        sign = 1.0 if stem == "square_ccw" else -1.0
        return [(side_m, 0.0), (_QUARTER * radius_m, sign / radius_m)] * 4
    if stem == "figure8":
        big = 1.6 * radius_m
        return [(1.0, 0.0), (2 * np.pi * big, 1 / big), (2 * np.pi * big, -1 / big), (1.0, 0.0)]
    if stem in {"route_left", "route_right"}:
        sign = 1.0 if stem == "route_left" else -1.0
        return [(5.0, 0.0), (_QUARTER * 3.0, sign / 3.0), (5.0, 0.0)]
    if stem == "slalom":
        bend = 3.0
        return [
            (2.0, 0.0),
            *([(0.6 * bend, 1 / bend), (1.2 * bend, -1 / bend), (0.6 * bend, 1 / bend)] * 3),
            (2.0, 0.0),
        ]
    raise BadInputError(
        f"route {kind!r} found; expected corridor, square_cw, square_ccw, figure8, route_left, route_right or slalom; "
        "name one of these"
    )


@dataclass(frozen=True, slots=True, eq=False)
class RouteTables:
    """All routes of a design laid end to end on a grid of `PITCH_M`."""

    first: np.ndarray  #: shape (n_runs,): grid index at which the route of a run starts
    last: np.ndarray  #: shape (n_runs,): grid index of its last point, run-out included
    end_m: FloatArray  #: shape (n_runs,): length of the route
    #: x_m, y_m, cos, sin, theta_rad, curvature_per_m: shape (n_grid,): planned pose and curvature
    x_m: FloatArray
    y_m: FloatArray
    cos: FloatArray
    sin: FloatArray
    theta_rad: FloatArray
    curvature_per_m: FloatArray


def _grid(segments: Sequence[Segment], weave: tuple[float, float]) -> tuple[FloatArray, float]:
    """Return the eased curvature on the grid (run-out included) and the length of the route."""
    end_m = float(sum(length for length, _ in segments))
    s = np.arange(0.0, end_m + _TAIL_M, PITCH_M)
    edges = np.cumsum([0.0, *[length for length, _ in segments]])
    turn = np.concatenate(([0.0], np.cumsum([length * kappa for length, kappa in segments])))
    # the mean of the curvature over +-half the easing length, by differences of the turned angle: keeps the total turn
    half = 0.5 * _EASE_M
    ahead, behind = (np.interp(s + shift, edges, turn) for shift in (half, -half))
    kappa: FloatArray = (ahead - behind) / _EASE_M
    amplitude_m, wavelength_m = weave
    if amplitude_m > 0.0:
        wave = 2 * np.pi / wavelength_m
        kappa = kappa - amplitude_m * wave**2 * np.sin(wave * s)
    return kappa, end_m


def tabulate(
    kinds: Sequence[str], *, length_m: float, side_m: float, radius_m: float, weaves: Sequence[tuple[float, float]]
) -> RouteTables:
    """Tabulate the routes of all runs; equal routes share a table.

    Parameters
    ----------
    kinds : sequence of str, length n_runs
        Route of each run.
    length_m, side_m, radius_m : float
        See `segments_of`.
    weaves : sequence of (amplitude_m, wavelength_m), length n_runs
        Weave about the line; amplitude 0 is none.
    """
    start: dict[tuple[str, tuple[float, float]], tuple[int, int, float]] = {}
    parts: list[tuple[FloatArray, ...]] = []
    filled = 0
    for key in zip(kinds, weaves, strict=True):
        if key in start:
            continue
        kind, weave = key
        segments = segments_of(kind, length_m=length_m, side_m=side_m, radius_m=radius_m)
        kappa, end_m = _grid(segments, weave)
        lead = weave[0] * 2 * np.pi / weave[1] if weave[0] > 0.0 else 0.0
        theta = np.arctan(lead) + np.concatenate(([0.0], np.cumsum(0.5 * (kappa[1:] + kappa[:-1]) * PITCH_M)))
        middle = 0.5 * (theta[1:] + theta[:-1])
        x = np.concatenate(([0.0], np.cumsum(np.cos(middle) * PITCH_M)))
        y = np.concatenate(([0.0], np.cumsum(np.sin(middle) * PITCH_M)))
        parts.append((x, y, np.cos(theta), np.sin(theta), theta, kappa))
        start[key] = (filled, filled + len(kappa) - 1, end_m)
        filled += len(kappa)
    starts = [start[key] for key in zip(kinds, weaves, strict=True)]
    x, y, cos, sin, theta, kappa = (np.concatenate([part[j] for part in parts]) for j in range(6))
    return RouteTables(
        first=np.array([item[0] for item in starts]),
        last=np.array([item[1] for item in starts]),
        end_m=np.array([item[2] for item in starts]),
        x_m=x,
        y_m=y,
        cos=cos,
        sin=sin,
        theta_rad=theta,
        curvature_per_m=kappa,
    )
