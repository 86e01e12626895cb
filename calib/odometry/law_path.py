"""Journeys under a law with loads that change on the way: errors and covariance at each point."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations_with_replacement
from pathlib import Path
from typing import Any, Final

import numpy as np

from calib.errors import BadInputError
from calib.odometry import poses as posing
from calib.odometry.poses import COMPONENTS, POSE, PoseErrors, Poses, RandomWalk, rows_of
from calib.odometry.routes import SPACING_M, Route, radii_under_load
from calib.radius.law import RadiusLaw, half_width
from calib.types import FloatArray
from calib.vehicle import Vehicle, check_wheel_loads, wheel_loads_N

NORMAL_95: Final = 1.959963984540054  #: quantile of the normal distribution, 97.5 %


@dataclass(frozen=True, slots=True, eq=False)
class Loading:
    """Wheel loads along a route, each from its distance on."""

    from_m: FloatArray  #: shape (n,): distances along the route, rising from 0
    #: shape (n,): wheel loads
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
            text = "found one of 0 N or below, or no number; expected loads above 0 N"
            raise BadInputError(f"loads along the path: {text}")
        return Loading(*ordered.T)

    @property
    def rows(self) -> list[tuple[float, float, float]]:
        """Distance in m, and left and right load in N from there on."""
        return list(zip(self.from_m.tolist(), self.left_N.tolist(), self.right_N.tolist(), strict=True))

    def at(self, distance_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the loads (left, right) of pieces that begin at these distances, of their shape."""
        index = np.maximum(np.searchsorted(self.from_m, distance_m + 1e-9, side="right") - 1, 0)
        return self.left_N[index], self.right_N[index]


@dataclass(frozen=True, slots=True, eq=False)
class AxleLaw:
    """The law of both wheels and the track between them, with the scatter of their odometry."""

    radii: RadiusLaw
    #: track, believed and real, and its standard uncertainty
    track_m: float
    track_std_m: float = 0.0
    walk: RandomWalk | None = None  #: random part of the error; None: none
    vehicle: Vehicle = field(default_factory=Vehicle)
    notes: tuple[str, ...] = ()  #: what the user should know about the source


def law_source(path: Path, track_m: float | None = None) -> AxleLaw:
    """Return the law of a campaign, a result folder or a coefficient file; `track_m` replaces the vehicle's track."""
    from calib.coefficients.build import coefficients_of
    from calib.coefficients.file import effects_left_out

    source = coefficients_of(path)
    file = source.file
    noise, encoder = file.noise, file.encoder
    per_rev = encoder.counts_per_rev_left.value, encoder.counts_per_rev_right.value
    walk = RandomWalk(noise.along.value, noise.heading.value, noise.count_std.value, *per_rev)
    notes = (*source.notes, *effects_left_out(file, "not simulated"))
    track_m = file.geometry.track_m if track_m is None else track_m
    return AxleLaw(file.law, track_m, file.vehicle.track_std.value, walk, file.loaded, notes)


def carried_loads_N(vehicle: Vehicle, payload_kg: float, x_m: float, y_m: float) -> tuple[float, float]:
    """Return the wheel loads (left, right) under a payload; refused where the vehicle cannot carry it."""
    if payload_kg < 0.0:
        raise BadInputError(f"payload: found {payload_kg:g} kg; expected a mass from 0 kg; correct it")
    front, left_N, right_N = wheel_loads_N(vehicle, payload_kg, x_m, y_m)
    check_wheel_loads(vehicle, front, left_N, right_N, what=f"payload {payload_kg:g} kg at x {x_m:g} m, y {y_m:g} m")
    return float(left_N), float(right_N)


def loading_on_the_way(vehicle: Vehicle, rows: Sequence[tuple[float, ...]]) -> Loading:
    """Return the loads of payloads that change on the way; unladen before the first.

    `rows`: distance from which on in m, mass in kg, place x and y in m.
    """
    if any(row[0] < 0.0 for row in rows):
        raise BadInputError("payload_at: found a distance below 0 m; expected one along the route; correct it")
    if min(row[0] for row in rows) > 0.0:
        rows = [*rows, (0.0, 0.0, 0.0, 0.0)]
    return Loading.from_rows([(row[0], *carried_loads_N(vehicle, *row[1:4])) for row in rows])


@dataclass(frozen=True, slots=True, eq=False)
class Driven:
    """What one odometry makes of the journey, at the start and after each piece of the route."""

    poses: Poses  #: real, by the law's mean radii, shape (n,)
    errors: PoseErrors  #: real minus route, shape (n,)
    #: shape (n, 3, 3): covariance of the real pose by law, scatter of single runs and track
    systematic: FloatArray
    random: FloatArray  #: shape (n, 3, 3): the same by floor and encoder readings
    std: dict[str, FloatArray]  #: shape (n,): standard uncertainty of each of `COMPONENTS`
    half: dict[str, float]  #: half width of their 95 % interval at the end
    #: shape (2,), or (1,) of a joint fit: each wheel's part in the mean square distance at the end, and its dof
    by_wheel_m2: FloatArray
    dof: FloatArray

    @property
    def rms_m(self) -> FloatArray:
        """Rms distance to the route's pose, to first order, shape (n,)."""
        spread = self.std["global_x_m"] ** 2 + self.std["global_y_m"] ** 2
        return np.asarray(np.sqrt(self.errors.distance_m**2 + spread))

    def end(self) -> dict[str, float]:
        """Return the errors at the end, with their uncertainties and the rms distance."""
        values = {f"error_{name}": float(getattr(self.errors, name)[-1]) for name in COMPONENTS}
        values |= {f"std_{name}": float(self.std[name][-1]) for name in COMPONENTS}
        values |= {f"half_width95_{name}": half for name, half in self.half.items()}
        return values | {"rms_m": float(self.rms_m[-1])}


@dataclass(frozen=True, slots=True, eq=False)
class LawPath:
    """A journey under a law, with and without the correction."""

    loading: Loading
    reference_N: tuple[float, float]  #: loads of the uncorrected odometry
    distance_m: FloatArray  #: shape (n,): distance along the route
    reference: Poses  #: the route, shape (n,)
    #: with the radii of the reference loads, and with radii that follow the load
    without: Driven
    corrected: Driven
    ratio_ci95: tuple[float, float] | None = None  #: of `ratio`; None where nothing was drawn

    @property
    def ratio(self) -> float:
        """How many times smaller the correction makes the rms distance at the end."""
        return float(self.without.rms_m[-1] / self.corrected.rms_m[-1])

    @property
    def loading_text(self) -> str:
        """Loads for people: left and right wheel, and from where on."""
        return ", ".join(
            f"{left:.0f} / {right:.0f} N" + (f" from {s:g} m" if s else "") for s, left, right in self.loading.rows
        )

    def to_dict(self) -> dict[str, Any]:
        """Return loads and end errors as plain values."""
        names = ("from_m", "load_left_N", "load_right_N")
        return {
            "loading": [dict(zip(names, row, strict=True)) for row in self.loading.rows],
            "reference_load_N": list(self.reference_N),
            "without": self.without.end(),
            "corrected": self.corrected.end(),
            "ratio": self.ratio,
            "ratio_ci95": self.ratio_ci95,
        }

    def error_rows(self) -> list[dict[str, float]]:
        """Return poses, errors and standard uncertainties along the path, one row a point."""
        columns = {"distance_m": self.distance_m} | self._loads()
        for name, driven in (("without", self.without), ("corrected", self.corrected)):
            columns |= {f"{name}_{key}": getattr(driven.poses, key) for key in POSE}
            columns |= {f"{name}_error_{key}": getattr(driven.errors, key) for key in COMPONENTS}
            columns |= {f"{name}_std_{key}": driven.std[key] for key in COMPONENTS}
        return rows_of(columns)

    def covariance_rows(self) -> list[dict[str, float]]:
        """Return pose and covariance along the path with the correction on, one row a point."""
        poses, axes, units = self.corrected.poses, ("x", "y", "theta"), ("m", "m", "rad")
        columns = {"distance_m": self.distance_m} | self._loads()
        columns |= {"x_m": poses.x_m, "y_m": poses.y_m, "theta_rad": poses.theta_rad}
        for part in ("systematic", "random"):
            for i, j in combinations_with_replacement(range(3), 2):
                unit = f"{units[i]}2" if units[i] == units[j] else f"{units[i]}_{units[j]}"
                columns[f"{part}_{axes[i]}_{axes[j]}_{unit}"] = getattr(self.corrected, part)[:, i, j]
        regions = posing.ellipses(self.corrected.systematic + self.corrected.random)
        columns |= {"ellipse95_major_m": regions.major_m, "ellipse95_minor_m": regions.minor_m}
        return rows_of(columns | {"ellipse95_angle_rad": regions.angle_rad})

    def _loads(self) -> dict[str, FloatArray]:
        left, right = self.loading.at(self.distance_m)
        return {"load_left_N": left, "load_right_N": right}


def law_path(
    axle: AxleLaw,
    route: Route,
    *,
    loading: Loading,
    reference_N: tuple[float, float],
    draws: int = 20_000,
    rng: np.random.Generator | None = None,
) -> LawPath:
    """Drive a route under a law, closed on the odometry, with and without the correction.

    `loading`, `reference_N`: see `LawPath`. Raises BadInputError where the load changes beyond the end of the route.
    """
    if loading.from_m[-1] >= route.total_m:
        raise BadInputError(
            f"loads along the path: found a change at {loading.from_m[-1]:g} m; expected one before the end of "
            f"{route.name} at {route.total_m:g} m; correct the distance"
        )
    fine = route.cut(loading.from_m).divided(SPACING_M)
    distance, reference = fine.distance_m(), fine.poses()
    loads = loading.at(distance[:-1])
    law = axle.radii
    real = radii_under_load(law, *loads)
    kept = radii_under_load(law, *reference_N)
    spread = law.covariance(axle.track_std_m, single_run=True)
    half, frame = 0.5 * axle.track_m * fine.turn_rad, _frame(reference.theta_rad)
    driven = []
    for believed in (kept, real):
        left, right = real[0] / believed[0] * (fine.length_m - half), real[1] / believed[1] * (fine.length_m + half)
        path = posing.steps(left, right, axle.track_m, radius_left_m=real[0], radius_right_m=real[1])
        above = [load - wheel.reference_load_N for load, wheel in zip(loads, (law.left, law.right), strict=True)]
        slopes = posing.jacobian(path, load_offset_left_N=above[0], load_offset_right_N=above[1])
        systematic = _from_start(slopes @ spread @ np.swapaxes(slopes, -1, -2))
        random = np.zeros_like(systematic) if axle.walk is None else _from_start(axle.walk.covariance(path))
        poses = path.poses.from_origin()
        squares = np.einsum("nci,nij,ncj->cn", frame, systematic + random, frame)
        std = dict(zip(COMPONENTS, np.sqrt(np.maximum(squares, 0.0)), strict=True))
        by_wheel = _by_wheel(law, frame[-1] @ slopes[-1], spread)
        widths = _half_widths(by_wheel, {name: float(part[-1]) for name, part in std.items()})
        variance, dof = by_wheel[0][3:], by_wheel[1][3:]
        # of the larger of x and y
        dofs = dof[np.argmax(variance, axis=0), range(variance.shape[1])]
        errors = posing.pose_errors(poses, reference)
        driven.append(Driven(poses, errors, systematic, random, std, widths, variance.sum(axis=0), dofs))
    interval = None if rng is None else _ratio_interval(driven[0], driven[1], draws, rng)
    return LawPath(loading, reference_N, distance, reference, driven[0], driven[1], interval)


def _by_wheel(law: RadiusLaw, slopes: FloatArray, spread: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return each wheel's part of the variance of `COMPONENTS`, (5, 2), and its degrees of freedom.

    Fitted together they are one part, (5, 1). `slopes` (5, 5): change of these by parameters of covariance `spread`.
    """
    variance, dof = [], []
    for wheel, part in ((law.left, slice(0, 2)), (law.right, slice(2, 4))):
        contrast = slopes[:, part]
        variance.append(np.einsum("ni,ij,nj->n", contrast, spread[part, part], contrast))
        dof.append(wheel.dof_of(contrast, single_run=True))
    if law.joint is not None:
        variance, dof = [np.einsum("ni,ij,nj->n", slopes, spread, slopes)], [np.minimum(*dof)]
    return np.column_stack(variance), np.column_stack(dof)


def _half_widths(by_wheel: tuple[FloatArray, FloatArray], std: dict[str, float]) -> dict[str, float]:
    halves = {}
    for (name, size), variance, dof in zip(std.items(), *by_wheel, strict=True):
        given = NORMAL_95**2 * (size**2 - variance.sum())
        halves[name] = math.sqrt(max(half_width(np.sqrt(variance), dof.tolist()) ** 2 + given, 0.0))
    return halves


def _ratio_interval(without: Driven, corrected: Driven, draws: int, rng: np.random.Generator) -> tuple[float, float]:
    more = np.stack([d / rng.chisquare(d, draws) for d in corrected.dof]) - 1.0
    square = [float(drive.rms_m[-1]) ** 2 + drive.by_wheel_m2 @ more for drive in (without, corrected)]
    low, high = np.quantile(np.sqrt(square[0] / square[1]), [0.025, 0.975])
    return float(low), float(high)


def _frame(heading_rad: FloatArray) -> FloatArray:
    """Return the derivatives of `COMPONENTS` by x, y and theta, (n, 5, 3)."""
    rows = np.zeros((len(heading_rad), len(COMPONENTS), 3))
    rows[:, 0, 0] = rows[:, 1, 1] = np.cos(heading_rad)
    rows[:, 0, 1] = np.sin(heading_rad)
    rows[:, 1, 0] = -rows[:, 0, 1]
    rows[:, [2, 3, 4], [2, 0, 1]] = 1.0
    return rows


def _from_start(values: FloatArray) -> FloatArray:
    return np.concatenate((np.zeros_like(values[:1]), values))
