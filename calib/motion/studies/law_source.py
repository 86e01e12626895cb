"""The law that a journey is driven under, with the vehicle that it belongs to, and the loads that payloads make."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from calib.arrays import FloatArray
from calib.errors import BadInputError
from calib.motion.pose_covariance import RandomWalk
from calib.radius.law import RadiusLaw
from calib.vehicle import Vehicle, check_wheel_loads, wheel_loads_N

if TYPE_CHECKING:
    from calib.coefficients.file import CoefficientFile


@dataclass(frozen=True, slots=True, eq=False)
class Loading:
    """Wheel loads along a route: each pair holds from its distance on until the next one."""

    from_m: FloatArray  #: shape (n,): distances along the route, rising from 0
    #: left_N, right_N: shape (n,): wheel loads
    left_N: FloatArray
    right_N: FloatArray

    @staticmethod
    def from_rows(rows: Sequence[tuple[float, float, float]]) -> Loading:
        """Return a loading of rows (distance in m, left load in N, right load in N) in any order, one at 0 m."""
        ordered = np.array(sorted(rows), dtype=np.float64).reshape(-1, 3)
        if not len(ordered) or ordered[0, 0] != 0.0 or (np.diff(ordered[:, 0]) <= 0.0).any():
            raise BadInputError(
                f"loads along the path: found changes at {', '.join(f'{at:g}' for at in ordered[:, 0])} m; expected "
                "the first at 0 m and each at a place of its own; give each place once"
            )
        if not np.isfinite(ordered).all() or (ordered[:, 1:] <= 0.0).any():
            raise BadInputError(
                "loads along the path: found one of 0 N or below, or no number; expected loads above 0 N"
            )
        return Loading(ordered[:, 0], ordered[:, 1], ordered[:, 2])

    @property
    def pairs(self) -> tuple[tuple[float, float], ...]:
        """Pairs of loads (left, right), each once."""
        return tuple(dict.fromkeys(zip(self.left_N.tolist(), self.right_N.tolist(), strict=True)))

    def at(self, distance_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the loads (left, right) of pieces that begin at these distances, shape of `distance_m`."""
        index = np.maximum(np.searchsorted(self.from_m, distance_m + 1e-9, side="right") - 1, 0)
        return self.left_N[index], self.right_N[index]


@dataclass(frozen=True, slots=True, eq=False)
class AxleLaw:
    """The law of both wheels and the track between them, with what their odometry scatters by."""

    radii: RadiusLaw  #: radii by load
    #: track_m, track_std_m: track, believed and real, and its standard uncertainty
    track_m: float
    track_std_m: float = 0.0
    walk: RandomWalk | None = None  #: random part of the error; None: none


@dataclass(frozen=True, slots=True, eq=False)
class LawSource:
    """A law and what comes with it."""

    law: RadiusLaw  #: radii by load
    vehicle: Vehicle  #: geometry
    track_std_m: float  #: standard uncertainty of the track
    walk: RandomWalk  #: random part of the pose's error
    notes: tuple[str, ...]  #: what the user should know of where it comes from

    def axle(self, track_m: float | None) -> AxleLaw:
        """Return law and track; `track_m` in place of the vehicle's where it is given."""
        return AxleLaw(self.law, self.vehicle.track_m if track_m is None else track_m, self.track_std_m, self.walk)


def law_source(path: Path) -> LawSource:
    """Return the law of a campaign, a result folder or a coefficient file."""
    from calib.coefficients.source import coefficients_of, effects_left_out

    source = coefficients_of(path)
    return LawSource(
        law=source.file.law,
        vehicle=source.file.geometry,
        track_std_m=source.file.vehicle.track_std.value,
        walk=_walk(source.file),
        notes=(*source.notes, *effects_left_out(source.file, "not simulated")),
    )


def carried_loads_N(vehicle: Vehicle, payload_kg: float, x_m: float, y_m: float) -> tuple[float, float]:
    """Return the wheel loads (left, right) under a payload; refused where the vehicle cannot carry it."""
    if payload_kg < 0.0:
        raise BadInputError(f"payload: found {payload_kg:g} kg; expected a mass from 0 kg; correct it")
    front, left_N, right_N = wheel_loads_N(vehicle, payload_kg, x_m, y_m)
    check_wheel_loads(vehicle, front, left_N, right_N, what=f"payload {payload_kg:g} kg at x {x_m:g} m, y {y_m:g} m")
    return float(left_N), float(right_N)


def loading_on_the_way(vehicle: Vehicle, rows: Sequence[tuple[float, ...]]) -> Loading:
    """Return the loads of payloads that are put on and taken off on the way; unladen before the first.

    Each row is the distance from which on in m, and the payload's mass in kg and place x and y in m.
    """
    if any(row[0] < 0.0 for row in rows):
        raise BadInputError("payload_at: found a distance below 0 m; expected one along the route; correct it")
    if min(row[0] for row in rows) > 0.0:
        rows = [*rows, (0.0, 0.0, 0.0, 0.0)]
    return Loading.from_rows([(row[0], *carried_loads_N(vehicle, *row[1:4])) for row in rows])


def _walk(file: CoefficientFile) -> RandomWalk:
    """Return the random part of the pose's error as a coefficient file states it."""
    return RandomWalk(
        sigma_along_m_per_sqrt_m=file.noise.along.value,
        sigma_heading_rad_per_sqrt_m=file.noise.heading.value,
        count_std=file.noise.count_std.value,
        counts_per_rev_left=file.encoder.counts_per_rev_left.value,
        counts_per_rev_right=file.encoder.counts_per_rev_right.value,
    )
