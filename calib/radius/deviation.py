"""What a path beside the straight line does to an effective radius (Figs 8 and 9), in closed form.

The rangefinder sees S_O along the corridor; the wheels roll along the path. A path longer by the share e makes a radius
computed as S_O / (2 pi n) too small: its relative error is 1 / (1 + e) - 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from calib.arrays import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PathExcess:
    """Relative excess of the paths over S_O, S / S_O - 1; arrays of one shape."""

    #: middle of the rear axle and both wheels
    centre: FloatArray
    left: FloatArray
    right: FloatArray
    #: heading at the end minus heading at the start
    yaw_rad: FloatArray


def whole_period_excess(amplitude_m: npt.ArrayLike, wavelength_m: npt.ArrayLike) -> FloatArray:
    """Return the relative excess of ``y = A sin(2 pi x / lambda)`` over whole periods, equal for centre and wheels.

    ``(2 / pi) sqrt(1 + u) E(m) - 1`` with ``u = (2 pi A / lambda)^2``, E the complete elliptic integral of the second
    kind and ``m = u / (1 + u)`` (Fig. 9).

    `amplitude_m`, `wavelength_m`: A and lambda. Of the broadcast shape.
    """
    from scipy.special import ellipe

    u = (2 * np.pi * np.asarray(amplitude_m, dtype=np.float64) / np.asarray(wavelength_m, dtype=np.float64)) ** 2
    exact = 2 / np.pi * np.sqrt(1 + u) * ellipe(u / (1 + u)) - 1
    # below this the subtraction loses digits that the series has: relative truncation 5 u^2 / 64
    return np.asarray(np.where(u < 1e-6, u / 4 - 3 * u**2 / 64, exact))


def small_amplitude_excess(amplitude_m: npt.ArrayLike, wavelength_m: npt.ArrayLike) -> FloatArray:
    """Return the small-amplitude form ``(pi A / lambda)^2`` of `whole_period_excess`."""
    ratio = np.asarray(amplitude_m, dtype=np.float64) / np.asarray(wavelength_m, dtype=np.float64)
    return np.asarray((np.pi * ratio) ** 2)


def weave_excess(
    amplitude_m: npt.ArrayLike,
    wavelength_m: npt.ArrayLike,
    distance_m: npt.ArrayLike,
    track_m: float,
    *,
    phase_rad: npt.ArrayLike = 0.0,
) -> PathExcess:
    """Return the relative excess of a weave over any distance, whole periods or not (Fig. 8b).

    The path is ``y = A sin(2 pi x / lambda + phase)`` for x from 0 to S_O; the wheels keep half a track from it, so
    that ``S_R,L = S +- (track / 2) (theta_end - theta_start)``.

    Parameters
    ----------
    amplitude_m, wavelength_m, distance_m, phase_rad : array_like of float, shapes that broadcast
        A, lambda, S_O and the phase at the start; at phase 0 the run starts with a heading of atan(2 pi A / lambda).
    track_m : float
        Distance between the wheels' contact points.

    Returns
    -------
    PathExcess
        Of the broadcast shape.
    """
    from scipy.special import ellipeinc

    amplitude, wavelength, distance, phase = np.broadcast_arrays(
        *(np.asarray(values, dtype=np.float64) for values in (amplitude_m, wavelength_m, distance_m, phase_rad))
    )
    k = 2 * np.pi / wavelength
    slope = k * amplitude
    u = slope**2
    end = k * distance + phase
    # the integral of sqrt(1 + u cos^2) in terms of Legendre's incomplete integral of the second kind
    length = np.sqrt(1 + u) * (ellipeinc(end, u / (1 + u)) - ellipeinc(phase, u / (1 + u))) / k
    centre = length / distance - 1
    yaw = np.arctan(slope * np.cos(end)) - np.arctan(slope * np.cos(phase))
    half = 0.5 * track_m * yaw / distance
    return PathExcess(centre=centre, left=centre - half, right=centre + half, yaw_rad=yaw)


def arc_excess(yaw_rad: npt.ArrayLike, distance_m: npt.ArrayLike, track_m: float) -> PathExcess:
    """Return the relative excess of a steady arc over its chord (Fig. 8a).

    `yaw_rad`: turn over the run, left positive; `distance_m`: S_O along the chord; `track_m`: distance between the
    wheels' contact points. Of the broadcast shape.
    """
    yaw, distance = np.broadcast_arrays(np.asarray(yaw_rad, dtype=np.float64), np.asarray(distance_m, dtype=np.float64))
    half_turn = 0.5 * yaw
    # np.sinc is sin(pi x) / (pi x) and takes 0 in its stride
    centre = 1.0 / np.sinc(half_turn / np.pi) - 1.0
    half = 0.5 * track_m * yaw / distance
    return PathExcess(centre=centre, left=centre - half, right=centre + half, yaw_rad=np.asarray(yaw))


def arc_of_radii_rad(
    distance_m: npt.ArrayLike, radius_left_m: npt.ArrayLike, radius_right_m: npt.ArrayLike, track_m: float
) -> FloatArray:
    """Return the turn of a vehicle that holds equal wheel rates on wheels of unequal radii (Fig. 8a).

    `distance_m`: path of the middle of the axle; `radius_left_m`, `radius_right_m`: true radii of wheels that the
    vehicle takes for equal; `track_m`: distance between the wheels' contact points. In rad, left positive.
    """
    left, right = np.asarray(radius_left_m, dtype=np.float64), np.asarray(radius_right_m, dtype=np.float64)
    return np.asarray(np.asarray(distance_m, dtype=np.float64) * 2 * (right - left) / ((right + left) * track_m))


def radius_error(excess: npt.ArrayLike) -> FloatArray:
    """Return the relative error of an uncorrected radius whose wheel rolled ``1 + excess`` times S_O."""
    e = np.asarray(excess, dtype=np.float64)
    return np.asarray(-e / (1 + e))


def excess_of_radius_error(error: npt.ArrayLike) -> FloatArray:
    """Return the excess that makes a radius wrong by ``-error`` (relative, positive); inverse of `radius_error`."""
    e = np.asarray(error, dtype=np.float64)
    return np.asarray(e / (1 - e))


def allowed_amplitude_on_run_m(
    tolerance: npt.ArrayLike,
    wavelength_m: npt.ArrayLike,
    distance_m: npt.ArrayLike,
    track_m: float,
    *,
    phase_rad: npt.ArrayLike = 0.0,
) -> FloatArray:
    """Return the largest amplitude that keeps the radii of *both* wheels within a tolerance on one run.

    Unlike `allowed_amplitude_m` it counts the turn that is left where the run is no whole number of periods. The worse
    wheel's error grows with the amplitude, so that bisection finds it.

    Parameters
    ----------
    tolerance : array_like of float
        Largest relative error of a radius, between 0 and 1.
    wavelength_m, distance_m, phase_rad : array_like of float
        Weave and length of the run, and the phase at its start.
    track_m : float
        Distance between the wheels' contact points.

    Returns
    -------
    array of float
        In m, of the broadcast shape.
    """
    high = np.broadcast_arrays(
        allowed_amplitude_m(tolerance, wavelength_m), np.asarray(distance_m, dtype=np.float64), np.asarray(phase_rad)
    )[0].copy()
    # a part of a period may be flatter than the whole: a wide bracket, and halvings to a relative 1e-14
    high, low = 8 * high, np.zeros_like(high)
    for _ in range(50):
        middle = 0.5 * (low + high)
        excess = weave_excess(middle, wavelength_m, distance_m, track_m, phase_rad=phase_rad)
        worse = np.maximum(np.abs(radius_error(excess.left)), np.abs(radius_error(excess.right)))
        fits = worse <= np.asarray(tolerance, dtype=np.float64)
        low, high = np.where(fits, middle, low), np.where(fits, high, middle)
    return np.asarray(low)


def allowed_amplitude_m(tolerance: npt.ArrayLike, wavelength_m: npt.ArrayLike) -> FloatArray:
    """Return the largest amplitude whose weave keeps a radius within a tolerance.

    Over whole periods, by the exact form; Newton's method on ``u = (2 pi A / lambda)^2``, whose excess is concave and
    increasing, so that starting from the small-amplitude value it converges from one side.

    `tolerance`: largest relative error of the radius, between 0 and 1; `wavelength_m`: wavelength of the weave. In m,
    of the broadcast shape.
    """
    from scipy.special import ellipe, ellipk

    wavelength = np.asarray(wavelength_m, dtype=np.float64)
    target = excess_of_radius_error(tolerance)
    u = 4 * target
    for _ in range(20):
        m = u / (1 + u)
        value = 2 / np.pi * np.sqrt(1 + u) * ellipe(m) - 1
        # d/du of (2/pi) int sqrt(1 + u cos^2) = (1/pi) int cos^2 / sqrt(1 + u cos^2), in complete integrals
        with np.errstate(invalid="ignore", divide="ignore"):
            derivative = np.where(
                u > 1e-4, (np.sqrt(1 + u) * ellipe(m) - ellipk(m) / np.sqrt(1 + u)) / (np.pi * u), 0.25 - 3 * u / 32
            )
        value = np.where(u < 1e-6, u / 4 - 3 * u**2 / 64, value)
        u = np.maximum(u - (value - target) / derivative, 0.0)
    return np.asarray(wavelength * np.sqrt(u) / (2 * np.pi))
