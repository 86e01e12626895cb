"""Effect of a path off the straight line on an effective radius (Figs 8 and 9): closed forms, and tables of them.

The rangefinder sees S_O along the corridor. A path longer by the share e makes a radius S_O / (2 pi n) too small: its
relative error is 1 / (1 + e) - 1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from calib.campaign.model import Campaign
from calib.errors import BadInputError
from calib.types import FloatArray, floats
from calib.vehicle import Vehicle

#: u = (2 pi A / lambda)^2 below which a series keeps digits that subtractions lose: relative truncation 5 u^2 / 64
SERIES_BELOW: Final = 1e-6
#: halvings, to rounding
BISECTIONS: Final = 60


@dataclass(frozen=True, slots=True, eq=False)
class PathExcess:
    """Relative excess of the paths over S_O, S / S_O - 1; arrays of one shape."""

    #: middle of the rear axle and both wheels
    centre: FloatArray
    left: FloatArray
    right: FloatArray
    #: heading at the end minus heading at the start
    yaw_rad: FloatArray

    @staticmethod
    def of(centre: FloatArray, yaw_rad: FloatArray, distance_m: FloatArray, track_m: float) -> PathExcess:
        """Return the excess of paths by that of their middle; the wheels keep half a track from it."""
        half = 0.5 * track_m * yaw_rad / distance_m
        return PathExcess(centre, centre - half, centre + half, np.asarray(yaw_rad))


def whole_period_excess(amplitude_m: ArrayLike, wavelength_m: ArrayLike) -> FloatArray:
    """Return the relative excess of ``y = A sin(2 pi x / lambda)`` over whole periods, equal for centre and wheels.

    ``(2 / pi) sqrt(1 + u) E(m) - 1`` with ``u = (2 pi A / lambda)^2``, E the complete elliptic integral of the second
    kind and ``m = u / (1 + u)`` (Fig. 9).

    `amplitude_m`, `wavelength_m`: A and lambda, of shapes that broadcast.
    """
    from scipy.special import ellipe

    u = (2 * np.pi * floats(amplitude_m) / floats(wavelength_m)) ** 2
    exact = 2 / np.pi * np.sqrt(1 + u) * ellipe(u / (1 + u)) - 1
    return np.asarray(np.where(u < SERIES_BELOW, u / 4 - 3 * u**2 / 64, exact))


def small_amplitude_excess(amplitude_m: ArrayLike, wavelength_m: ArrayLike) -> FloatArray:
    """Return the small-amplitude form ``(pi A / lambda)^2`` of `whole_period_excess`."""
    return np.asarray((np.pi * (floats(amplitude_m) / floats(wavelength_m))) ** 2)


def weave_excess(
    amplitude_m: ArrayLike,
    wavelength_m: ArrayLike,
    distance_m: ArrayLike,
    track_m: float,
    *,
    phase_rad: ArrayLike = 0.0,
) -> PathExcess:
    """Return the relative excess of a weave over any distance, whole periods or not (Fig. 8b).

    The path is ``y = A sin(2 pi x / lambda + phase)`` for x from 0 to S_O;
    ``S_R,L = S +- (track / 2) (theta_end - theta_start)``. A and lambda, see `whole_period_excess`, S_O and the phase
    broadcast; at phase 0 the run starts with a heading of atan(2 pi A / lambda).
    """
    from scipy.special import ellipeinc

    given = map(floats, (amplitude_m, wavelength_m, distance_m, phase_rad))
    amplitude, wavelength, distance, phase = np.broadcast_arrays(*given)
    k = 2 * np.pi / wavelength
    slope = k * amplitude
    u = slope**2
    end = k * distance + phase
    # by Legendre's incomplete integral of the second kind
    length = np.sqrt(1 + u) * (ellipeinc(end, u / (1 + u)) - ellipeinc(phase, u / (1 + u))) / k
    yaw = np.arctan(slope * np.cos(end)) - np.arctan(slope * np.cos(phase))
    return PathExcess.of(length / distance - 1, yaw, distance, track_m)


def arc_excess(yaw_rad: ArrayLike, distance_m: ArrayLike, track_m: float) -> PathExcess:
    """Return the relative excess of a steady arc over its chord (Fig. 8a).

    `yaw_rad`: turn over the run, left positive; `distance_m`: S_O along the chord; `track_m`: distance between the
    wheels' contact points. The arguments broadcast.
    """
    yaw, distance = np.broadcast_arrays(floats(yaw_rad), floats(distance_m))
    # np.sinc is sin(pi x) / (pi x)
    return PathExcess.of(1.0 / np.sinc(0.5 * yaw / np.pi) - 1.0, yaw, distance, track_m)


def arc_of_radii_rad(
    distance_m: ArrayLike, radius_left_m: ArrayLike, radius_right_m: ArrayLike, track_m: float
) -> FloatArray:
    """Return the turn of a vehicle that holds equal wheel rates on wheels of unequal radii (Fig. 8a).

    `distance_m`: path of the middle of the axle; `radius_left_m`, `radius_right_m`: true radii of wheels that the
    vehicle takes for equal. Left turns are positive.
    """
    left, right = floats(radius_left_m), floats(radius_right_m)
    return np.asarray(floats(distance_m) * 2 * (right - left) / ((right + left) * track_m))


def radius_error(excess: ArrayLike) -> FloatArray:
    """Return the relative error of an uncorrected radius whose wheel rolled ``1 + excess`` times S_O."""
    e = floats(excess)
    return np.asarray(-e / (1 + e))


def excess_of_radius_error(error: ArrayLike) -> FloatArray:
    """Return the excess that makes a radius wrong by ``-error`` (relative, positive); inverse of `radius_error`."""
    e = floats(error)
    return np.asarray(e / (1 - e))


def allowed_amplitude_on_run_m(
    tolerance: ArrayLike, wavelength_m: ArrayLike, distance_m: ArrayLike, track_m: float, *, phase_rad: ArrayLike = 0.0
) -> FloatArray:
    """Return the largest amplitude that keeps the radii of *both* wheels within a tolerance on one run.

    Unlike `allowed_amplitude_m` it counts the net turn where the run is no whole number of periods.

    Parameters
    ----------
    tolerance : array_like of float
        Largest relative error of a radius, between 0 and 1.
    wavelength_m, distance_m, phase_rad : array_like of float
        Weave and length of the run, and the phase at its start.
    track_m
        Distance between the wheels' contact points.
    """

    def worse(amplitude_m: FloatArray) -> FloatArray:
        excess = weave_excess(amplitude_m, wavelength_m, distance_m, track_m, phase_rad=phase_rad)
        return np.maximum(np.abs(radius_error(excess.left)), np.abs(radius_error(excess.right)))

    over_periods, *_ = np.broadcast_arrays(allowed_amplitude_m(tolerance, wavelength_m), distance_m, phase_rad)
    # part of a period may be flatter: a wide bracket
    return _largest(worse, tolerance, 8 * over_periods)


def allowed_amplitude_m(tolerance: ArrayLike, wavelength_m: ArrayLike) -> FloatArray:
    """Return the largest amplitude whose weave over whole periods keeps a radius within a tolerance, in m.

    `tolerance`: largest relative error of the radius, between 0 and 1.
    """
    wavelength, target = np.broadcast_arrays(wavelength_m, excess_of_radius_error(tolerance))
    # the excess is at least that of the straight lines between the turning points, and of small amplitudes near 0
    bracket = wavelength / (2 * np.pi) * (4 * np.sqrt(target) + np.pi * target)
    return _largest(lambda amplitude_m: whole_period_excess(amplitude_m, wavelength), target, bracket)


def _largest(error: Callable[[FloatArray], FloatArray], most: ArrayLike, bracket: FloatArray) -> FloatArray:
    """Return the largest amplitude up to `bracket` whose growing error is `most` at most."""
    low, high = np.zeros_like(bracket), bracket
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        fits = error(middle) <= np.asarray(most)
        low, high = np.where(fits, middle, low), np.where(fits, high, middle)
    return np.asarray(low)


def deviation_rows(
    amplitudes_m: ArrayLike, wavelengths_m: ArrayLike, distance_m: float, track_m: float, tolerance: float
) -> list[dict[str, float]]:
    """Return the table of Fig. 9: one mapping for each pair of amplitude and wavelength.

    Raises BadInputError where a length is not positive.

    Parameters
    ----------
    amplitudes_m, wavelengths_m : array_like of float, shapes (n,) and (m,)
        A and lambda.
    distance_m, track_m
        S_O, and distance between the wheels' contact points; the path starts on the line, at phase 0.
    tolerance
        Largest relative error of a radius, for the amplitude that is allowed.

    Returns
    -------
    list of mapping
        Relative excess over whole periods, exact and by the small-amplitude form; over `distance_m` for centre and both
        wheels; relative errors of radii computed without correction; amplitude allowed.
    """
    lengths = {"amplitude": amplitudes_m, "wavelength": wavelengths_m, "distance": distance_m, "track": track_m}
    for name, given in lengths.items():
        values = np.atleast_1d(floats(given))
        expected = "zero or more" if name == "amplitude" else "more than zero"
        bad = ~np.isfinite(values) | (values < 0) | ((values == 0) & (name != "amplitude"))
        if bad.any():
            raise BadInputError(f"{name}: found {values[bad][0]:g} m; expected {expected}; give a length in metres")
    if not 0 < tolerance < 1:
        raise BadInputError(f"tolerance: found {tolerance:g}; expected a share between 0 and 1; 0.0005 is 0.05 %")
    a, w = (grid.ravel() for grid in np.meshgrid(amplitudes_m, wavelengths_m, indexing="ij"))
    path = weave_excess(a, w, distance_m, track_m)
    whole = whole_period_excess(a, w)
    table = {
        "amplitude_m": a,
        "wavelength_m": w,
        "distance_m": np.full_like(a, distance_m),
        "excess_whole_periods": whole,
        "excess_small_amplitude": small_amplitude_excess(a, w),
        "radius_error_whole_periods": radius_error(whole),
        "excess_centre": path.centre,
        "excess_left": path.left,
        "excess_right": path.right,
        "wheel_difference_m": (path.right - path.left) * distance_m,
        "radius_error_left": radius_error(path.left),
        "radius_error_right": radius_error(path.right),
        "yaw_rad": path.yaw_rad,
        "allowed_amplitude_m": allowed_amplitude_m(tolerance, w),
    }
    return [dict(zip(table, map(float, row), strict=True)) for row in zip(*table.values(), strict=True)]


def table_setting(
    campaign: Campaign | None, distance_m: float | None, track_m: float | None, *, default_distance_m: float
) -> tuple[float, float]:
    """Return distance and track of the table: as given, else the campaign's (median distance), else the paper's.

    `default_distance_m`: without a campaign.
    """
    if distance_m is None:
        known = np.array([]) if campaign is None else campaign.runs.number("distance_m")
        known = np.abs(known[np.isfinite(known)])
        distance_m = float(np.median(known)) if len(known) else default_distance_m
    if track_m is None:
        track_m = (Vehicle() if campaign is None else campaign.vehicle).track_m
    return distance_m, track_m


def arc_row(radius_ratio: float, distance_m: float, track_m: float) -> dict[str, float]:
    """Return the steady arc of a vehicle that takes wheels of ratio ``r_R / r_L`` (Eq. 15) for equal (Fig. 8a).

    `distance_m`: S_O, the chord from start to end; the offset is that of the end from the line of the first heading.
    Raises BadInputError where the ratio is not positive, or the arc never gets so far away.
    """
    if not 0 < radius_ratio < np.inf:
        raise BadInputError(f"radius_ratio: found {radius_ratio:g}; expected r_R / r_L above 0; 1 is equal wheels")
    # chord over diameter
    sine = 0.5 * float(arc_of_radii_rad(distance_m, 1.0, radius_ratio, track_m))
    if abs(sine) > 1.0:
        raise BadInputError(
            f"distance: found {distance_m:g} m; expected at most {distance_m / abs(sine):.4g} m, the diameter of the "
            f"circle on which wheels of ratio {radius_ratio:g} and track {track_m:g} m drive; give a shorter distance"
        )
    turn = 2.0 * float(np.arcsin(sine))
    path = arc_excess(turn, distance_m, track_m)
    return {
        "radius_ratio": radius_ratio,
        "distance_m": distance_m,
        "turn_rad": turn,
        "offset_m": sine * distance_m,
        "excess_centre": float(path.centre),
        "excess_left": float(path.left),
        "excess_right": float(path.right),
    }
