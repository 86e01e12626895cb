"""The same journeys under a fitted law: with the radius of one load, and with the radius of the load carried.

The law's own uncertainty is carried to the end pose twice: by linear propagation (Jacobians by the radii) and by Monte
Carlo. Without correction the odometry computes with the radii at the reference loads; with it, with those of the loads
carried. The real radii are those of the loads carried, uncertain by the law's mean or by the scatter of single runs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.errors import BadInputError
from calib.motion.follow import Axle, end_of_route, wheel_travel
from calib.motion.pose_covariance import jacobian, steps
from calib.motion.poses import FloatArray, Poses, pose_errors
from calib.motion.routes import Route
from calib.radius.law import RadiusLaw, WheelLaw

__all__ = ["BANDS", "Interval", "Journey", "TableRow", "band_along", "law_journey", "law_table"]

BANDS: Final = ("mean", "prediction")
COMPONENTS: Final = ("along_m", "lateral_m", "heading_rad", "global_x_m", "global_y_m")


@dataclass(frozen=True, slots=True)
class TableRow:
    """Radii at one load (Table 1), with the 95 % half-widths of the mean and of a single run (Fig. 15).

    `extrapolated_left`, `extrapolated_right`: the load lies outside those that the wheel was measured under.
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
    """Return the effective radii for preset loads (Table 1), with their 95 % bands.

    Parameters
    ----------
    law : RadiusLaw
        Both wheels.
    loads_N : array of float, shape (n,)
        Wheel loads.
    """
    rows = []
    for load in np.asarray(loads_N, dtype=np.float64).tolist():
        parts = [
            (
                float(wheel.radius_m(load)),
                _student(wheel.dof) * float(wheel.mean_std_m(load)),
                _student(wheel.dof) * float(wheel.prediction_std_m(load)),
                not wheel.load_min_N <= load <= wheel.load_max_N,
            )
            for wheel in (law.left, law.right)
        ]
        left, right = parts
        rows.append(TableRow(load, left[0], right[0], left[1], right[1], left[2], right[2], left[3], right[3]))
    return tuple(rows)


@dataclass(frozen=True, slots=True)
class Interval:
    """95 % interval of one component of the end error.

    Parameters
    ----------
    value : float
        With the law's mean radii.
    linear : tuple of float
        By linear propagation with Student's t.
    monte_carlo : tuple of float
        The 2.5 and 97.5 % quantiles of the draws.
    """

    value: float
    linear: tuple[float, float]
    monte_carlo: tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Journey:
    """End errors of one journey without and with the correction.

    Parameters
    ----------
    load_left_N, load_right_N : float
        Wheel loads carried.
    reference_left_N, reference_right_N : float
        Wheel loads whose radii the uncorrected odometry uses.
    band : str
        ``mean`` or ``prediction``.
    without, corrected : dict of str to Interval
        Error along, lateral, of heading, and global x and y.
    without_rms_m, corrected_rms_m : float
        Root mean square of the distance to the intended end over the draws.
    without_95_m, corrected_95_m : float
        Distance that 95 % of the draws stay below.
    ratio, ratio_ci95 : float, tuple of float
        Ratio of the two root mean squares; its interval from how well the fit's degrees of freedom know the scatter.
    journeys_ratio : tuple of float
        Ratio of the distances draw by draw: 2.5, 50 and 97.5 % quantiles.
    draws : int
        Draws.
    """

    load_left_N: float
    load_right_N: float
    reference_left_N: float
    reference_right_N: float
    band: str
    without: dict[str, Interval]
    corrected: dict[str, Interval]
    without_rms_m: float
    corrected_rms_m: float
    without_95_m: float
    corrected_95_m: float
    ratio: float
    ratio_ci95: tuple[float, float]
    journeys_ratio: tuple[float, float, float]
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
    """Simulate a journey under a law without and with the correction.

    Parameters
    ----------
    law : RadiusLaw
        Both wheels, fitted separately and taken as independent.
    route : Route
        What the believed pose follows.
    loads_N, reference_N : (float, float)
        Loads (left, right) carried, and those that the uncorrected odometry stands on.
    track_m : float
        Track, believed and real.
    band : {"mean", "prediction"}
        Uncertainty of the real radii: of the regression mean, or of a single run.
    draws : int
        Draws of the Monte Carlo.
    rng : numpy.random.Generator
        Source of chance.

    Raises
    ------
    BadInputError
        Where `band` is not known or `draws` below 100.
    """
    from scipy.stats import chi2

    if band not in BANDS or draws < 100:
        raise BadInputError(f"band {band!r}, {draws} draws: expected one of {', '.join(BANDS)} and 100 draws or more")
    wheels = (law.left, law.right)
    mean = [float(wheel.radius_m(load)) for wheel, load in zip(wheels, loads_N, strict=True)]
    std = [_std(wheel, load, band) for wheel, load in zip(wheels, loads_N, strict=True)]
    radii = [m + s * _student_draws(w.dof, draws, rng) for m, s, w in zip(mean, std, wheels, strict=True)]
    reference = [float(wheel.radius_m(load)) for wheel, load in zip(wheels, reference_N, strict=True)]
    end = route.poses()[-1]
    drawn: dict[str, FloatArray] = {}
    intervals: dict[str, dict[str, Interval]] = {}
    for name, believed in (("without", reference), ("corrected", mean)):
        axle = Axle(believed[0], believed[1], track_m)
        errors = pose_errors(end_of_route(route, axle, Axle(radii[0], radii[1], track_m)), end)
        drawn[name] = errors.distance_m
        centre = pose_errors(end_of_route(route, axle, Axle(mean[0], mean[1], track_m)), end)
        slopes = _end_jacobian(route, axle, Axle(mean[0], mean[1], track_m), float(end.theta_rad))
        dof = [wheel.dof for wheel in wheels]
        intervals[name] = {}
        for row, component in enumerate(COMPONENTS):
            parts = (slopes[row] * np.array(std)) ** 2
            half = _welch(parts, dof) * float(np.sqrt(parts.sum()))
            value = float(getattr(centre, component)[0])
            low, high = np.quantile(getattr(errors, component), [0.025, 0.975])
            intervals[name][component] = Interval(value, (value - half, value + half), (float(low), float(high)))
    before, after = drawn["without"], drawn["corrected"]
    rms = {name: float(np.sqrt(np.mean(np.square(distance)))) for name, distance in drawn.items()}
    ratio = rms["without"] / rms["corrected"]
    least = min(wheel.dof for wheel in wheels)
    scale = np.sqrt(chi2.ppf([0.025, 0.975], least) / least)
    each = np.quantile(before / np.maximum(after, 1e-15), [0.025, 0.5, 0.975])
    return Journey(
        load_left_N=loads_N[0],
        load_right_N=loads_N[1],
        reference_left_N=reference_N[0],
        reference_right_N=reference_N[1],
        band=band,
        without=intervals["without"],
        corrected=intervals["corrected"],
        without_rms_m=rms["without"],
        corrected_rms_m=rms["corrected"],
        without_95_m=float(np.quantile(before, 0.95)),
        corrected_95_m=float(np.quantile(after, 0.95)),
        ratio=ratio,
        ratio_ci95=(float(ratio * scale[0]), float(ratio * scale[1])),
        journeys_ratio=(float(each[0]), float(each[1]), float(each[2])),
        draws=draws,
    )


def _end_jacobian(route: Route, believed: Axle, real: Axle, heading_rad: float) -> FloatArray:
    """Return the derivatives of the components of the end error by the real radii, shape (5, 2)."""
    left, right, track = wheel_travel(route, believed, real)
    real_left, real_right, _ = real.arrays()
    path = steps(left[0], right[0], track[0], radius_left_m=real_left, radius_right_m=real_right)
    by_radius = jacobian(path)[-1][:, [0, 2]]
    c, s = np.cos(heading_rad), np.sin(heading_rad)
    turned = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ by_radius
    return np.vstack([turned, by_radius[:2]])


def _std(wheel: WheelLaw, load_N: float, band: str) -> float:
    return float(wheel.mean_std_m(load_N) if band == "mean" else wheel.prediction_std_m(load_N))


def _student(dof: float) -> float:
    from scipy.stats import t

    return float(t.ppf(0.975, dof))


def _student_draws(dof: float, n: int, rng: np.random.Generator) -> FloatArray:
    """Draw from Student's t: a radius whose standard uncertainty was itself estimated."""
    return rng.standard_t(dof, n)


def _welch(variances: FloatArray, dof: list[float]) -> float:
    """Return Student's factor for a sum of variances of different degrees of freedom (Welch-Satterthwaite)."""
    total = float(variances.sum())
    if total <= 0.0:
        return 0.0
    return _student(total**2 / sum(float(v) ** 2 / d for v, d in zip(variances, dof, strict=True)))


def band_along(
    law: RadiusLaw, route: Route, *, loads_N: tuple[float, float], track_m: float, band: str
) -> tuple[Poses, FloatArray]:
    """Return the route and the covariance of the real pose about it with the correction on.

    Returns
    -------
    poses : Poses
        Shape (n_segments,): at the end of each segment.
    covariance : array of float, shape (n_segments, 3, 3)
        Of x, y, theta, from the law alone.
    """
    radii = [float(w.radius_m(load)) for w, load in zip((law.left, law.right), loads_N, strict=True)]
    axle = Axle(radii[0], radii[1], track_m)
    left, right, track = wheel_travel(route, axle, axle)
    path = steps(left[0], right[0], track[0], radius_left_m=radii[0], radius_right_m=radii[1])
    slopes = jacobian(path)[..., [0, 2]]
    variance = np.array([_std(w, load, band) ** 2 for w, load in zip((law.left, law.right), loads_N, strict=True)])
    return path.poses, np.einsum("nip,p,njp->nij", slopes, variance, slopes)
