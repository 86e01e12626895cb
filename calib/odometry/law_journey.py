"""Journeys under a fitted law: with the radius of one load, and with that of the load carried.

The law's uncertainty is carried to the end pose by linear propagation and by Monte Carlo.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from calib.errors import SWEEP_VALUES, BadInputError
from calib.odometry.poses import COMPONENTS, jacobian, pose_errors, rows_of, steps
from calib.odometry.routes import LONGEST_M, SHORTEST_M, Axle, Route, end_of_route, wheel_travel
from calib.radius.law import RadiusLaw, half_width
from calib.types import FloatArray, floats
from calib.vehicle import Vehicle, check_wheel_loads, wheel_loads_N

BANDS: Final = ("mean", "prediction")


@dataclass(frozen=True, slots=True)
class TableRow:
    """Radii at one load (Table 1), with 95 % half-widths of mean and single run (Fig. 15).

    `extrapolated_left`, `extrapolated_right`: beyond the wheel's law.
    """

    load_N: float
    radius_left_m: float
    radius_right_m: float
    mean_left_m: float
    mean_right_m: float
    prediction_left_m: float
    prediction_right_m: float
    extrapolated_left: bool
    extrapolated_right: bool


def law_table(law: RadiusLaw, loads_N: FloatArray) -> tuple[TableRow, ...]:
    """Return Table 1 for wheel loads (n,)."""
    loads = floats(loads_N)
    columns = []
    for wheel in (law.left, law.right):
        beyond = (loads < wheel.load_min_N) | (loads > wheel.load_max_N)
        bands = (wheel.half_width_m(loads, single_run=band == "prediction") for band in BANDS)
        columns.append([part.tolist() for part in (wheel.radius_m(loads), *bands, beyond)])
    pairs = [column for pair in zip(*columns, strict=True) for column in pair]
    return tuple(TableRow(*row) for row in zip(loads.tolist(), *pairs, strict=True))


@dataclass(frozen=True, slots=True)
class Interval:
    """95 % interval of one component of the end error."""

    value: float  #: with the law's mean radii
    linear: tuple[float, float]  #: by linear propagation with Student's t
    monte_carlo: tuple[float, float]  #: 2.5 and 97.5 % quantiles of the draws

    @staticmethod
    def of(value: float, half_width: float, drawn: FloatArray) -> Interval:
        """Return the intervals of a value by its half width and by draws (n,)."""
        low, high = np.quantile(drawn, [0.025, 0.975])
        return Interval(value, (value - half_width, value + half_width), (float(low), float(high)))


@dataclass(frozen=True, slots=True, eq=False)
class Journey:
    """End errors of one journey without and with the correction."""

    #: wheel loads carried
    load_left_N: float
    load_right_N: float
    #: wheel loads whose radii the uncorrected odometry uses
    reference_left_N: float
    reference_right_N: float
    band: str  #: ``mean`` or ``prediction``
    #: error along, lateral, of heading, and global x and y
    without: dict[str, Interval]
    corrected: dict[str, Interval]
    radius_ratio: float  #: e_r that the uncorrected odometry overlooks: real over believed, right over left
    #: rms distance to the intended end, to first order
    without_rms_m: float
    corrected_rms_m: float
    #: distance that 95 % of the draws stay below
    without_95_m: float
    corrected_95_m: float
    #: of the two root mean squares, with an interval by the fit's degrees of freedom
    ratio: float
    ratio_ci95: tuple[float, float]
    journeys_ratio: tuple[float, float, float]  #: of the distances draw by draw: 2.5, 50 and 97.5 % quantiles
    draws: int


def law_journey(
    law: RadiusLaw,
    route: Route,
    *,
    loads_N: tuple[float, float],
    reference_N: tuple[float, float],
    track_m: float,
    band: str,
    draws: int,
    rng: np.random.Generator,
) -> Journey:
    """Simulate a journey under a law, without and with the correction; see `Journey`.

    Wheels fitted apart err independently; radii and track fitted together, as their joint covariance says.

    `loads_N`, `reference_N`: loads (left, right) carried, and those that the uncorrected odometry stands on; `band`:
    uncertainty of the real radii, of the regression mean or of a single run. Raises BadInputError where `band` is not
    known or `draws` below 100.
    """
    if band not in BANDS or draws < 100:
        raise BadInputError(f"band {band!r}, {draws} draws: expected one of {', '.join(BANDS)} and 100 draws or more")
    wheels = (law.left, law.right)
    mean, reference = ([float(w.radius_m(n)) for w, n in zip(wheels, at, strict=True)] for at in (loads_N, reference_N))
    root, scale, dof, off = _scatter(law, loads_N, single=band == "prediction", draws=draws, rng=rng)
    # few degrees of freedom draw lengths that no wheel has, beyond the quantiles reported
    drawn_m = np.clip(np.array([*mean, track_m])[:, None] + off, SHORTEST_M, LONGEST_M)
    scattered = Axle(*drawn_m)
    end = route.poses()[-1]
    distance, square, intervals = dict[str, FloatArray](), dict[str, FloatArray](), dict[str, dict[str, Interval]]()
    for name, believed in (("without", reference), ("corrected", mean)):
        axle, real = Axle(believed[0], believed[1], track_m), Axle(mean[0], mean[1], track_m)
        errors = pose_errors(end_of_route(route, axle, scattered), end)
        centre = pose_errors(end_of_route(route, axle, real), end)
        # shape (5, 2), of each wheel; (5, 1) of what was fitted together
        slopes = _end_jacobian(route, axle, real, float(end.theta_rad)) @ root
        if law.joint is not None:
            slopes = np.linalg.norm(slopes, axis=1, keepdims=True)
        distance[name] = errors.distance_m
        # squared distance expected at the fit's scatter, and at each draw's
        by_wheel = (slopes[3:] ** 2).sum(axis=0)
        square[name] = float(centre.distance_m[0]) ** 2 + by_wheel @ np.column_stack([np.ones(len(dof)), scale]) ** 2
        intervals[name] = {}
        for component, scales in zip(COMPONENTS, np.abs(slopes), strict=True):
            value, drawn = float(getattr(centre, component)[0]), getattr(errors, component)
            intervals[name][component] = Interval.of(value, half_width(scales, dof), drawn)
    ratios = np.sqrt(square["without"] / square["corrected"])
    low, high = np.quantile(ratios[1:], [0.025, 0.975]).tolist()
    each = np.quantile(distance["without"] / np.maximum(distance["corrected"], 1e-15), [0.025, 0.5, 0.975]).tolist()
    return Journey(
        load_left_N=loads_N[0],
        load_right_N=loads_N[1],
        reference_left_N=reference_N[0],
        reference_right_N=reference_N[1],
        band=band,
        without=intervals["without"],
        corrected=intervals["corrected"],
        radius_ratio=mean[1] / reference[1] / (mean[0] / reference[0]),
        without_rms_m=float(np.sqrt(square["without"][0])),
        corrected_rms_m=float(np.sqrt(square["corrected"][0])),
        without_95_m=float(np.quantile(distance["without"], 0.95)),
        corrected_95_m=float(np.quantile(distance["corrected"], 0.95)),
        ratio=float(ratios[0]),
        ratio_ci95=(low, high),
        journeys_ratio=(each[0], each[1], each[2]),
        draws=draws,
    )


def _scatter(
    law: RadiusLaw, loads_N: tuple[float, float], *, single: bool, draws: int, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, list[float], FloatArray]:
    """Return a root (3, k) of the covariance of radii and track, drawn scales (1 or 2, draws), dof, errors (3, draws).

    Wheels fitted apart have a scale each.
    """
    dof = [
        float(w.dof_of(w.contrast(load), single_run=single))
        for w, load in zip((law.left, law.right), loads_N, strict=True)
    ]
    spread = law.covariance_at(loads_N, single_run=single)
    root = np.diag(np.sqrt(np.diag(spread)))[:, :2]
    if law.joint is not None:
        # one fit, one scale of its covariance
        dof, (sizes, axes) = [min(dof)], np.linalg.eigh(spread)
        root = axes * np.sqrt(np.maximum(sizes, 0.0))
    scale = np.stack([np.sqrt(d / rng.chisquare(d, draws)) for d in dof])
    off = root @ (scale * rng.standard_normal((root.shape[1], draws)))
    return root, scale, dof, off


def _end_jacobian(route: Route, believed: Axle, real: Axle, heading_rad: float) -> FloatArray:
    left, right, track = wheel_travel(route, believed, real)
    radii = {"radius_left_m": real.radius_left_m, "radius_right_m": real.radius_right_m}
    by_radius = jacobian(steps(left[0], right[0], track[0], **radii))[-1][:, [0, 2, 4]]
    cosine, sine = np.cos(heading_rad), np.sin(heading_rad)
    turned = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]]) @ by_radius
    return np.vstack([turned, by_radius[:2]])


def vehicle_of(source: Path | None, **changes: float | None) -> Vehicle:
    """Return the vehicle of a campaign, fit or coefficient file (None: the nominal one), with changes."""
    vehicle = Vehicle()
    if source is not None:
        if (source / "campaign.toml").is_file():
            from calib.campaign.read import read_campaign

            vehicle = read_campaign(source, logs=False).vehicle
        else:
            from calib.coefficients.build import coefficients_of

            vehicle = coefficients_of(source).file.loaded
    given: dict[str, Any] = {name: value for name, value in changes.items() if value is not None}
    for name, value in given.items():
        if not math.isfinite(value) or (not name.startswith("cog") and value <= 0.0):
            raise BadInputError(f"{name}: found {value!r}; expected a finite number above 0; correct it")
    return replace(vehicle, **given)


#: what can be swept -> unit
SWEPT: Final = {"payload_kg": "kg", "payload_x_m": "m", "payload_y_m": "m"}


@dataclass(frozen=True, slots=True, eq=False)
class LoadSweep:
    """Wheel loads over a sweep."""

    swept: str  #: what varies, of `SWEPT`; empty for a single payload
    #: shape (n,): payloads
    payload_kg: FloatArray
    payload_x_m: FloatArray
    payload_y_m: FloatArray
    #: shape (n,): wheel loads
    front_N: FloatArray
    left_N: FloatArray
    right_N: FloatArray

    def rows(self) -> list[dict[str, float]]:
        """Return one row a payload, with the sum of the loads."""
        columns = {part.name: getattr(self, part.name) for part in fields(self) if part.name != "swept"}
        columns["total_N"] = self.front_N + self.left_N + self.right_N
        return rows_of(columns)


def sweep_loads(
    vehicle: Vehicle,
    payload_kg: float,
    payload_x_m: float,
    payload_y_m: float,
    *,
    swept: str = "",
    span: tuple[float, float] = (0.0, 0.0),
    steps: int = 21,
) -> LoadSweep:
    """Return the wheel loads of a payload, or of a sweep of its mass or place; see `LoadSweep`.

    `span`, `steps`: both ends, and how many values. Raises RefusedError for the first payload that cannot be carried.
    """
    values = {"payload_kg": payload_kg, "payload_x_m": payload_x_m, "payload_y_m": payload_y_m}
    if swept and (swept not in SWEPT or not 2 <= steps <= SWEEP_VALUES):
        expected = f"{', '.join(SWEPT)} in 2 to {SWEEP_VALUES} steps"
        raise BadInputError(f"sweep: found {swept!r} in {steps} steps; expected {expected}")
    count = steps if swept else 1
    columns = {name: np.full(count, value) for name, value in values.items()}
    if swept:
        columns[swept] = np.linspace(span[0], span[1], steps)
    mass, x, y = columns.values()
    if not np.isfinite([mass, x, y]).all() or (mass < 0.0).any():
        raise BadInputError("payload: found a value below 0 or not finite; expected a mass from 0 kg and a place in m")
    loads = np.stack(wheel_loads_N(vehicle, mass, x, y))
    bad = (loads.min(axis=0) <= 0.0) | (loads.max(axis=0) > vehicle.max_wheel_load_N)
    if bad.any():
        k = int(np.argmax(bad))
        check_wheel_loads(vehicle, *loads[:, k], what=f"payload {mass[k]:g} kg at x {x[k]:g} m, y {y[k]:g} m")
    return LoadSweep(swept, mass, x, y, *loads)
