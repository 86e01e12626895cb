"""Journeys under a fitted law, with the radius of one load and with that of the load carried."""

import math
from dataclasses import dataclass, field, replace
from itertools import combinations_with_replacement
from pathlib import Path
from typing import Any, Final

import numpy as np

from calib.errors import BadInputError
from calib.odometry import poses as posing
from calib.odometry import routes
from calib.odometry.poses import COMPONENTS, POSE, PoseErrors, Poses, RandomWalk
from calib.odometry.routes import Axle, Loading, Route, end_of_route, radii_under_load, wheel_travel
from calib.radius.law import RadiusLaw, half_width, shared_dof
from calib.types import FloatArray, IntArray, floats, rows_of
from calib.vehicle import Vehicle

BANDS: Final = ("mean", "prediction")
NORMAL_95: Final = 1.959963984540054  #: quantile of the normal distribution, 97.5 %
STATED_DOF: Final = 1e9  #: of what was not estimated


@dataclass(frozen=True, slots=True, eq=False)
class AxleLaw:
    """The law of both wheels and the track between them, with the scatter of their odometry."""

    radii: RadiusLaw
    #: track, believed and real, and its standard uncertainty
    track_m: float
    track_std_m: float = 0.0
    walk: RandomWalk | None = None  #: random part of the error; None: none
    vehicle: Vehicle = field(default_factory=Vehicle)
    notes: tuple[str, ...] = ()
    simulated: bool = False  #: whether a program made the data of the law


def law_source(path: Path, track_m: float | None = None) -> AxleLaw:
    """Return the law of a campaign, result folder or coefficient file; `track_m` replaces the track."""
    from calib.coefficients.build import coefficients_of
    from calib.coefficients.file import effects_left_out

    source = coefficients_of(path)
    file = source.file
    noise, encoder = file.noise, file.encoder
    per_rev = encoder.counts_per_rev_left.value, encoder.counts_per_rev_right.value
    walk = RandomWalk(noise.along.value, noise.heading.value, noise.count_std.value, *per_rev)
    notes = (*source.notes, *effects_left_out(file, "not simulated"))
    track_m = file.geometry.track_m if track_m is None else track_m
    return AxleLaw(file.law, track_m, file.vehicle.track_std.value, walk, file.loaded, notes, file.simulated)


def vehicle_of(source: Path | None, **changes: float | None) -> Vehicle:
    """Return the vehicle of a campaign, fit or coefficient file (None: nominal), with changes."""
    vehicle = Vehicle()
    if source is not None:
        if (source / "campaign.toml").is_file():
            from calib.campaign.read import read_campaign

            vehicle = read_campaign(source, logs=False).vehicle
        else:
            from calib.coefficients.build import coefficients_of

            vehicle = coefficients_of(source).file.loaded
    stated: dict[str, Any] = {name: value for name, value in changes.items() if value is not None}
    for name, value in stated.items():
        if not math.isfinite(value) or (not name.startswith("cog") and value <= 0.0):
            raise BadInputError(f"{name}: found {value!r}; expected a finite number above 0; correct it")
    return replace(vehicle, **stated)


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
        columns = self._columns()
        for name, driven in (("without", self.without), ("corrected", self.corrected)):
            columns |= {f"{name}_{key}": getattr(driven.poses, key) for key in POSE}
            columns |= {f"{name}_error_{key}": getattr(driven.errors, key) for key in COMPONENTS}
            columns |= {f"{name}_std_{key}": driven.std[key] for key in COMPONENTS}
        return rows_of(columns)

    def covariance_rows(self) -> list[dict[str, float]]:
        """Return pose and covariance along the path with the correction on, one row a point."""
        poses, axes, units = self.corrected.poses, ("x", "y", "theta"), ("m", "m", "rad")
        columns = self._columns() | {name: getattr(poses, name) for name in POSE}
        for part in ("systematic", "random"):
            for i, j in combinations_with_replacement(range(3), 2):
                unit = f"{units[i]}2" if units[i] == units[j] else f"{units[i]}_{units[j]}"
                columns[f"{part}_{axes[i]}_{axes[j]}_{unit}"] = getattr(self.corrected, part)[:, i, j]
        regions = posing.ellipses(self.corrected.systematic + self.corrected.random)
        names = ("ellipse95_major_m", "ellipse95_minor_m", "ellipse95_angle_rad")
        return rows_of(columns | dict(zip(names, regions, strict=True)))

    def _columns(self) -> dict[str, FloatArray]:
        left, right = self.loading.at(self.distance_m)
        return {"distance_m": self.distance_m, "load_left_N": left, "load_right_N": right}


def law_path(
    axle: AxleLaw,
    route: Route,
    *,
    loading: Loading,
    reference_N: tuple[float, float],
    draws: int = 20_000,
    rng: np.random.Generator | None = None,
) -> LawPath:
    """Drive a route under a law, closed on the odometry, with and without the correction; see `LawPath`.

    Raises BadInputError where the load changes beyond the end of the route.
    """
    if loading.from_m[-1] >= route.total_m:
        raise BadInputError(
            f"loads along the path: found a change at {loading.from_m[-1]:g} m; expected one before the end of "
            f"{route.name} at {route.total_m:g} m; correct the distance"
        )
    fine = route.cut(loading.from_m).divided(routes.SPACING_M)
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
        widths = {}
        for (name, part), one, its_dof in zip(std.items(), *by_wheel, strict=True):
            excess = NORMAL_95**2 * (float(part[-1]) ** 2 - one.sum())
            widths[name] = math.sqrt(max(half_width(np.sqrt(one), its_dof.tolist()) ** 2 + excess, 0.0))
        variance, dof = by_wheel[0][3:], by_wheel[1][3:]
        dofs = dof[np.argmax(variance, axis=0), range(variance.shape[1])]
        errors = posing.pose_errors(poses, reference)
        driven.append(Driven(poses, errors, systematic, random, std, widths, variance.sum(axis=0), dofs))
    interval = None
    if rng is not None:
        excess = np.stack([d / rng.chisquare(d, draws) for d in driven[1].dof]) - 1.0
        square = [float(drive.rms_m[-1]) ** 2 + drive.by_wheel_m2 @ excess for drive in driven]
        low, high = np.quantile(np.sqrt(square[0] / square[1]), [0.025, 0.975]).tolist()
        interval = low, high
    return LawPath(loading, reference_N, distance, reference, driven[0], driven[1], interval)


def _by_wheel(law: RadiusLaw, slopes: FloatArray, spread: FloatArray) -> tuple[FloatArray, FloatArray]:
    # each wheel's part of the variance of `COMPONENTS`, (5, 2), and its degrees of freedom; fitted together one part,
    # (5, 1); slopes (5, 5): their change by parameters of covariance `spread`
    variance, dof = [], []
    for wheel, part in ((law.left, slice(0, 2)), (law.right, slice(2, 4))):
        contrast = slopes[:, part]
        variance.append(np.einsum("ni,ij,nj->n", contrast, spread[part, part], contrast))
        dof.append(wheel.dof_of(contrast, single_run=True))
    if law.joint is not None:
        dof = [shared_dof(np.stack(variance, axis=-1), np.stack(dof, axis=-1))]
        variance = [np.einsum("ni,ij,nj->n", slopes, spread, slopes)]
    return np.column_stack(variance), np.column_stack(dof)


def _frame(heading_rad: FloatArray) -> FloatArray:
    rows = np.zeros((len(heading_rad), len(COMPONENTS), 3))
    rows[:, 0, 0] = rows[:, 1, 1] = np.cos(heading_rad)
    rows[:, 0, 1] = np.sin(heading_rad)
    rows[:, 1, 0] = -rows[:, 0, 1]
    rows[:, [2, 3, 4], [2, 0, 1]] = 1.0
    return rows


def _from_start(values: FloatArray) -> FloatArray:
    return np.concatenate((np.zeros_like(values[:1]), values))


@dataclass(frozen=True, slots=True)
class Interval:
    """95 % interval of one component of the end error."""

    value: float
    linear: tuple[float, float]  #: by linear propagation with Student's t
    monte_carlo: tuple[float, float]  #: 2.5 and 97.5 % quantiles of the draws

    @staticmethod
    def of(value: float, half_width: float, drawn: FloatArray) -> "Interval":
        """Return the intervals of a value by its half width and by draws (n,)."""
        low, high = np.quantile(drawn, [0.025, 0.975])
        return Interval(value, (value - half_width, value + half_width), (float(low), float(high)))


@dataclass(frozen=True, slots=True, eq=False)
class Journey:
    """End errors of one journey without and with the correction."""

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

    `loads_N`, `reference_N`: loads (left, right) carried, and of the uncorrected odometry; `band`: uncertainty of the
    real radii, one of `BANDS`. Raises BadInputError where that is not known, or of single runs whose scatter is not, or
    `draws` below 100.
    """
    if band not in (bands := BANDS[: 1 + law.scatters]) or draws < 100:
        raise BadInputError(f"band {band!r}, {draws} draws: expected one of {', '.join(bands)} and 100 draws or more")
    wheels = (law.left, law.right)
    mean, reference = ([float(w.radius_m(n)) for w, n in zip(wheels, at, strict=True)] for at in (loads_N, reference_N))
    root, of_scale, scale, dof, off = _scatter(law, loads_N, single=band == "prediction", draws=draws, rng=rng)
    # few degrees of freedom draw lengths beyond the quantiles reported
    drawn_m = np.clip(np.array([*mean, track_m])[:, None] + off, routes.SHORTEST_M, routes.LONGEST_M)
    scattered = Axle(*drawn_m)
    end = route.poses()[-1]
    distance, square, intervals = dict[str, FloatArray](), dict[str, FloatArray](), dict[str, dict[str, Interval]]()
    for name, believed in (("without", reference), ("corrected", mean)):
        axle, real = Axle(believed[0], believed[1], track_m), Axle(mean[0], mean[1], track_m)
        errors = posing.pose_errors(end_of_route(route, axle, scattered), end)
        centre = posing.pose_errors(end_of_route(route, axle, real), end)
        slopes = _end_jacobian(route, axle, real, float(end.theta_rad)) @ root
        slopes = np.stack([np.linalg.norm(slopes[:, of_scale == n], axis=1) for n in range(len(dof))], axis=1)
        distance[name] = errors.distance_m
        # squared distance expected at the fit's scatter, and at each draw's
        by_wheel = (slopes[3:] ** 2).sum(axis=0)
        square[name] = float(centre.distance_m[0]) ** 2 + by_wheel @ np.column_stack([np.ones(len(dof)), scale]) ** 2
        intervals[name] = {}
        for component, scales in zip(COMPONENTS, slopes, strict=True):
            value, drawn = float(getattr(centre, component)[0]), getattr(errors, component)
            intervals[name][component] = Interval.of(value, half_width(scales, dof), drawn)
    ratios = np.sqrt(square["without"] / square["corrected"])
    low, high = np.quantile(ratios[1:], [0.025, 0.975]).tolist()
    each = np.quantile(distance["without"] / np.maximum(distance["corrected"], 1e-15), [0.025, 0.5, 0.975]).tolist()
    return Journey(
        *loads_N,
        *reference_N,
        band,
        intervals["without"],
        intervals["corrected"],
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
) -> tuple[FloatArray, IntArray, FloatArray, list[float], FloatArray]:
    # root (3, k) of the covariance of radii and track, each column's scale (one a wheel, or one fitted together), drawn
    # scales, dof, errors
    wheels = zip((law.left, law.right), loads_N, strict=True)
    dof = [float(wheel.dof_of(wheel.contrast(load), single_run=single)) for wheel, load in wheels]
    spread = law.covariance_at(loads_N, single_run=single)
    root, of_scale = np.diag(np.sqrt(np.diag(spread))), np.arange(2)
    if law.joint is not None:
        n = 3 if spread[2, :2].any() else 2
        sizes, axes = np.linalg.eigh(spread[:n, :n])
        root[:n, :n] = axes * np.sqrt(np.maximum(sizes, 0.0))
        together = float(shared_dof(np.diag(spread)[:2], floats(dof)))
        dof, of_scale = [together, STATED_DOF][: 4 - n], np.arange(3) // n
    root = root[:, : len(of_scale)]
    scale = np.stack([np.sqrt(d / rng.chisquare(d, draws)) for d in dof])
    off = root @ (scale[of_scale] * rng.standard_normal((root.shape[1], draws)))
    return root, of_scale, scale, dof, off


def _end_jacobian(route: Route, believed: Axle, real: Axle, heading_rad: float) -> FloatArray:
    travel = (part[0] for part in wheel_travel(route, believed, real))
    path = posing.steps(*travel, radius_left_m=real.radius_left_m, radius_right_m=real.radius_right_m)
    return np.asarray(_frame(np.array([heading_rad]))[0] @ posing.jacobian(path)[-1][:, [0, 2, 4]])
