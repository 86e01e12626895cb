"""The path deviation of a campaign's runs: how far each path moved its radii, and whether that is within tolerance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from calib.arrays import FloatArray, StrArray
from calib.campaign.model import Campaign
from calib.errors import BadInputError
from calib.radius.deviation import (
    allowed_amplitude_m,
    allowed_amplitude_on_run_m,
    arc_excess,
    arc_of_radii_rad,
    radius_error,
    small_amplitude_excess,
    weave_excess,
    whole_period_excess,
)
from calib.radius.path_length import correct_paths
from calib.radius.usable import LeftOut, usable_runs
from calib.vehicle import Vehicle

__all__ = ["RunDeviations", "arc_row", "deviation_rows", "judge_runs", "table_setting"]

PASSED: Final = "within"
BEYOND: Final = "beyond"
UNKNOWN: Final = "unknown"


@dataclass(frozen=True, slots=True, eq=False)
class RunDeviations:
    """What each run's path did to its radii; arrays of shape (n_runs,), NaN where unknown.

    Parameters
    ----------
    tolerance : float
        Largest relative error of a radius that is accepted.
    run_id, source, verdict : array of str
        Run; where its path is known from (`calib.radius.path_length.RunPaths`); ``within``, ``beyond`` or ``unknown``.
    distance_m, amplitude_m, wavelength_m : array of float
        Length and weave.
    excess_centre, excess_left, excess_right : array of float
        Relative excess of each path over S_O.
    small_amplitude : array of float
        Excess of the weave alone by the small-amplitude form.
    error_left, error_right : array of float
        Relative error of the radii if the path were not corrected.
    error_left_m, error_right_m : array of float
        The same in m on the nominal radius.
    allowed_amplitude_m : array of float
        Largest amplitude of that wavelength on that run that keeps both radii within tolerance.
    arc_turn_rad, arc_excess : array of float
        Turn, and relative excess of the path, if the vehicle were steered by its own odometry with the model's radii.
    left_out : tuple of LeftOut
        Runs that are not judged.
    notes : tuple of str
        What was done.
    """

    tolerance: float
    run_id: StrArray
    source: StrArray
    verdict: StrArray
    distance_m: FloatArray
    amplitude_m: FloatArray
    wavelength_m: FloatArray
    excess_centre: FloatArray
    excess_left: FloatArray
    excess_right: FloatArray
    small_amplitude: FloatArray
    error_left: FloatArray
    error_right: FloatArray
    error_left_m: FloatArray
    error_right_m: FloatArray
    allowed_amplitude_m: FloatArray
    arc_turn_rad: FloatArray
    arc_excess: FloatArray
    left_out: tuple[LeftOut, ...]
    notes: tuple[str, ...]

    @property
    def passed(self) -> bool:
        """Whether no run is beyond the tolerance."""
        return not bool((self.verdict == BEYOND).any())

    @property
    def summary(self) -> str:
        """The verdict in sentences: how many runs keep the tolerance, and what to do about the others."""
        n, share = len(self.run_id), f"{100 * self.tolerance:g} %"
        beyond, unknown = int((self.verdict == BEYOND).sum()), int((self.verdict == UNKNOWN).sum())
        text = f"{n - beyond - unknown} of {n} runs keep both radii within {share} of what a straight path would give"
        if beyond:
            text += (
                f"; {beyond} do not: 'calib fit' corrects them as far as logs tell, but repeat them nearer to the line"
            )
        if unknown:
            text += f"; of {unknown} the path is not known: add logs, or amplitude_m and wavelength_m"
        curved = float(np.max(np.abs(self.arc_turn_rad)))
        return (
            f"{text}. Steered by its own odometry with the model's radii the vehicle would have turned by up to "
            f"{curved:.3f} rad, a path up to {100 * float(np.max(self.arc_excess)):.3f} % longer."
        )

    def rows(self) -> list[dict[str, Any]]:
        """Return one mapping of plain values a run."""
        texts = {name: [str(value) for value in getattr(self, name)] for name in ("run_id", "source", "verdict")}
        numbers = {
            name: [float(value) if np.isfinite(value) else None for value in getattr(self, name)]
            for name in self.__dataclass_fields__
            if name not in {*texts, "tolerance", "left_out", "notes"}
        }
        columns: dict[str, list[Any]] = {**texts, **numbers}
        return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def judge_runs(campaign: Campaign, tolerance: float) -> RunDeviations:
    """Judge the path of every straight run against a tolerance.

    Parameters
    ----------
    campaign : Campaign
        Runs with logs, or with measured amplitude and wavelength; others are ``unknown``.
    tolerance : float
        Largest relative error of a radius, between 0 and 1.

    Returns
    -------
    RunDeviations
        In the order driven.

    Raises
    ------
    RefusedError
        Where there is no straight run.
    BadInputError
        Where the tolerance is not between 0 and 1.
    """
    if not 0 < tolerance < 1:
        raise BadInputError(
            f"--tolerance: found {tolerance:g}; expected a share between 0 and 1; 0.0005 is 0.05 % of the radius"
        )
    campaign, left_out, _ = usable_runs(campaign, need_load=False)
    runs, vehicle, model = campaign.runs, campaign.vehicle, campaign.model
    path = correct_paths(campaign)
    distance = np.abs(runs.number("distance_m"))
    known = path.source != "none"
    error = {"left": radius_error(path.left), "right": radius_error(path.right)}
    worse = np.maximum(np.abs(error["left"]), np.abs(error["right"]))
    woven = np.isfinite(path.wavelength_m) & (path.wavelength_m > 0)
    phased = woven & np.isfinite(path.phase_rad)
    allowed = np.full(len(runs), np.nan)
    allowed[woven] = allowed_amplitude_m(tolerance, path.wavelength_m[woven])
    if phased.any():
        allowed[phased] = allowed_amplitude_on_run_m(
            tolerance,
            path.wavelength_m[phased],
            distance[phased],
            vehicle.track_m,
            phase_rad=path.phase_rad[phased],
        )
    small = np.full(len(runs), np.nan)
    small[woven] = small_amplitude_excess(path.amplitude_m[woven], path.wavelength_m[woven])
    # r_R / r_L as each run shows it; the distance cancels
    ratio = (np.abs(runs.number("counts_left")) / campaign.encoder.counts_per_rev_left * (1 + path.right)) / (
        np.abs(runs.number("counts_right")) / campaign.encoder.counts_per_rev_right * (1 + path.left)
    )
    believed = model.radius_right_m / model.radius_left_m
    turn = arc_of_radii_rad(distance, 1.0, ratio / believed, vehicle.track_m)
    blank = np.where(known, 0.0, np.nan)
    return RunDeviations(
        tolerance=tolerance,
        run_id=runs.run_id,
        source=path.source,
        verdict=np.where(~known, UNKNOWN, np.where(worse <= tolerance, PASSED, BEYOND)),
        distance_m=distance,
        amplitude_m=path.amplitude_m,
        wavelength_m=path.wavelength_m,
        excess_centre=path.centre + blank,
        excess_left=path.left + blank,
        excess_right=path.right + blank,
        small_amplitude=small,
        error_left=error["left"] + blank,
        error_right=error["right"] + blank,
        error_left_m=error["left"] * vehicle.wheel_radius_m + blank,
        error_right_m=error["right"] * vehicle.wheel_radius_m + blank,
        allowed_amplitude_m=allowed,
        arc_turn_rad=turn,
        arc_excess=arc_excess(turn, distance, vehicle.track_m).centre,
        left_out=left_out,
        notes=path.notes,
    )


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
        ("--amplitude", amplitude, "zero or more"),
        ("--wavelength", wavelength, "more than zero"),
        ("--distance", np.array([distance_m]), "more than zero"),
        ("--track", np.array([track_m]), "more than zero"),
    ):
        bad = ~np.isfinite(values) | ((values < 0) if least == "zero or more" else (values <= 0))
        if bad.any():
            raise BadInputError(f"{name}: found {values[bad][0]:g} m; expected {least}; give a length in metres")
    if not 0 < tolerance < 1:
        raise BadInputError(f"--tolerance: found {tolerance:g}; expected a share between 0 and 1; 0.0005 is 0.05 %")
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

    Parameters
    ----------
    campaign : Campaign or None
        Its median distance and its track are taken where nothing is given.
    distance_m, track_m : float or None
        As given.
    default_distance_m : float
        Distance where there is no campaign.

    Returns
    -------
    distance_m, track_m : float
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

    Raises
    ------
    BadInputError
        Where the ratio is not positive.
    """
    if not 0 < radius_ratio < np.inf:
        raise BadInputError(f"--radius-ratio: found {radius_ratio:g}; expected r_R / r_L above 0; 1 is equal wheels")
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
