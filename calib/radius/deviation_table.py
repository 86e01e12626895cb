"""What weaves and arcs of given size do to a radius, as tables (Figs 8 and 9)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from calib.campaign.model import Campaign
from calib.errors import BadInputError
from calib.radius.deviation import (
    allowed_amplitude_m,
    arc_excess,
    arc_of_radii_rad,
    radius_error,
    small_amplitude_excess,
    weave_excess,
    whole_period_excess,
)
from calib.vehicle import Vehicle


def deviation_rows(
    amplitudes_m: npt.ArrayLike, wavelengths_m: npt.ArrayLike, distance_m: float, track_m: float, tolerance: float
) -> list[dict[str, float]]:
    """Return the table of Fig. 9: one mapping for each pair of amplitude and wavelength.

    Parameters
    ----------
    amplitudes_m, wavelengths_m : array_like of float, shapes (n,) and (m,)
        A and lambda.
    distance_m, track_m : float
        S_O, and distance between the wheels' contact points; the path starts on the line, at phase 0.
    tolerance : float
        Largest relative error of a radius, for the amplitude that is allowed.

    Returns
    -------
    list of mapping
        Relative excess over whole periods, exact and by the small-amplitude form; over `distance_m` for centre and both
        wheels; relative errors of radii computed without correction; amplitude allowed.

    Raises
    ------
    BadInputError
        Where a length is not positive.
    """
    lengths = (amplitudes_m, wavelengths_m)
    amplitude, wavelength = (np.atleast_1d(np.asarray(values, dtype=np.float64)) for values in lengths)
    for name, values, least in (
        ("amplitude", amplitude, "zero or more"),
        ("wavelength", wavelength, "more than zero"),
        ("distance", np.array([distance_m]), "more than zero"),
        ("track", np.array([track_m]), "more than zero"),
    ):
        bad = ~np.isfinite(values) | ((values < 0) if least == "zero or more" else (values <= 0))
        if bad.any():
            raise BadInputError(f"{name}: found {values[bad][0]:g} m; expected {least}; give a length in metres")
    if not 0 < tolerance < 1:
        raise BadInputError(f"tolerance: found {tolerance:g}; expected a share between 0 and 1; 0.0005 is 0.05 %")
    a, w = (grid.ravel() for grid in np.meshgrid(amplitude, wavelength, indexing="ij"))
    path = weave_excess(a, w, distance_m, track_m)
    whole = whole_period_excess(a, w)
    columns = {
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
    return [dict(zip(columns, map(float, row), strict=True)) for row in zip(*columns.values(), strict=True)]


def table_setting(
    campaign: Campaign | None, distance_m: float | None, track_m: float | None, *, default_distance_m: float
) -> tuple[float, float]:
    """Return distance and track of the table: as given, else the campaign's, else the paper's.

    `campaign`: its median distance and its track are taken where nothing is given; `default_distance_m`: distance where
    there is no campaign. `distance_m`, `track_m`.
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

    Raises BadInputError where the ratio is not positive.
    """
    if not 0 < radius_ratio < np.inf:
        raise BadInputError(f"radius_ratio: found {radius_ratio:g}; expected r_R / r_L above 0; 1 is equal wheels")
    turn = float(arc_of_radii_rad(distance_m, 1.0, radius_ratio, track_m))
    path = arc_excess(turn, distance_m, track_m)
    return {
        "radius_ratio": radius_ratio,
        "distance_m": distance_m,
        "turn_rad": turn,
        "offset_m": float(0.5 * turn * distance_m),
        "excess_centre": float(path.centre),
        "excess_left": float(path.left),
        "excess_right": float(path.right),
    }
