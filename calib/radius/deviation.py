"""Effect of a path off the straight line on an effective radius (Figs 8 and 9): closed forms, tables, runs, checks."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from numpy.typing import ArrayLike
from scipy.special import ellipeinc

from calib.campaign.checks import partial_slope
from calib.campaign.model import Campaign
from calib.campaign.wheels import steered_itself_m
from calib.documents import plain
from calib.errors import BadInputError
from calib.radius.effective import EffectiveRadii, UnusedRun, usable_runs
from calib.radius.path_length import PathExcess, arc_excess, correct_paths, small_amplitude_excess, whole_period_excess
from calib.radius.regression import FAILED, MIN_SLOPE_DOF, NOTE, NOTE_BELOW, UM, Check, WheelFit, t_check
from calib.types import BoolArray, FloatArray, Row, StrArray, floats, rows_of
from calib.vehicle import Vehicle

#: halvings of an interval, down to rounding
BISECTIONS: Final = 60
PAPER_DISTANCE_M: Final = 40.0


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
    ``S_R,L = S +- (track / 2) (theta_end - theta_start)``. A and lambda, see `whole_period_excess`, S_O and phase
    broadcast.
    """
    arrays = map(floats, (amplitude_m, wavelength_m, distance_m, phase_rad))
    amplitude, wavelength, distance, phase = np.broadcast_arrays(*arrays)
    k = 2 * np.pi / wavelength
    slope = k * amplitude
    u = slope**2
    end = k * distance + phase
    length = np.sqrt(1 + u) * (ellipeinc(end, u / (1 + u)) - ellipeinc(phase, u / (1 + u))) / k
    yaw = np.arctan(slope * np.cos(end)) - np.arctan(slope * np.cos(phase))
    return PathExcess.of(length / distance - 1, yaw, distance, track_m)


def arc_of_ratio_rad(distance_m: ArrayLike, radius_ratio: ArrayLike, track_m: float) -> FloatArray:
    """Return the turn, left positive, of a vehicle with equal rates of wheels of true ratio r_R / r_L (Fig. 8a).

    `distance_m`: path of the axle's middle.
    """
    ratio = floats(radius_ratio)
    return np.asarray(floats(distance_m) * 2 * (ratio - 1.0) / ((ratio + 1.0) * track_m))


def radius_error(excess: ArrayLike) -> FloatArray:
    """Return the relative error of an uncorrected radius whose wheel rolled ``1 + excess`` times S_O."""
    e = floats(excess)
    return np.asarray(-e / (1 + e))


def allowed_amplitude_on_run_m(
    tolerance: ArrayLike, wavelength_m: ArrayLike, distance_m: ArrayLike, track_m: float, *, phase_rad: ArrayLike = 0.0
) -> FloatArray:
    """Return the largest amplitude that keeps both radii within a tolerance on one run; see `weave_excess`."""

    def worse(amplitude_m: FloatArray) -> FloatArray:
        excess = weave_excess(amplitude_m, wavelength_m, distance_m, track_m, phase_rad=phase_rad)
        return floats(np.abs(radius_error([excess.left, excess.right])).max(axis=0))

    over_periods, *_ = np.broadcast_arrays(allowed_amplitude_m(tolerance, wavelength_m), distance_m, phase_rad)
    # part of a period may allow more: a wide bracket
    return _largest(worse, tolerance, 8 * over_periods)


def allowed_amplitude_m(tolerance: ArrayLike, wavelength_m: ArrayLike) -> FloatArray:
    """Return the largest amplitude whose weave over whole periods keeps a radius within a tolerance, in m.

    `tolerance`: largest relative error of the radius, between 0 and 1.
    """
    error = floats(tolerance)
    wavelength, target = np.broadcast_arrays(wavelength_m, error / (1 - error))
    # the excess is at least that of straight lines between the turning points
    bracket = wavelength / (2 * np.pi) * (4 * np.sqrt(target) + np.pi * target)
    return _largest(lambda amplitude_m: whole_period_excess(amplitude_m, wavelength), target, bracket)


def _largest(error: Callable[[FloatArray], FloatArray], tolerance: ArrayLike, bracket: FloatArray) -> FloatArray:
    low, high = np.zeros_like(bracket), bracket
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        within = error(middle) <= np.asarray(tolerance)
        low, high = np.where(within, middle, low), np.where(within, high, middle)
    return np.asarray(low)


def deviation_rows(
    amplitudes_m: ArrayLike, wavelengths_m: ArrayLike, distance_m: float, track_m: float, tolerance: float
) -> list[dict[str, float]]:
    """Return the table of Fig. 9: a row a pair of amplitude (n,) and wavelength (m,), from phase 0; see `weave_excess`.

    `tolerance`: relative, of a radius. Raises BadInputError where a length is not positive.
    """
    lengths = {"amplitude": amplitudes_m, "wavelength": wavelengths_m, "distance": distance_m, "track": track_m}
    for name, length_m in lengths.items():
        values = np.atleast_1d(floats(length_m))
        expected = "zero or more" if name == "amplitude" else "more than zero"
        bad = ~np.isfinite(values) | (values < 0) | ((values == 0) & (name != "amplitude"))
        if bad.any():
            raise BadInputError(f"{name}: found {values[bad][0]:g} m; expected {expected}; give a length in metres")
    if not 0 < tolerance < 1:
        raise BadInputError(f"tolerance: found {tolerance:g}; expected a share between 0 and 1; 0.0005 is 0.05 %")
    a, w = (grid.ravel() for grid in np.meshgrid(amplitudes_m, wavelengths_m, indexing="ij"))
    path, whole = weave_excess(a, w, distance_m, track_m), whole_period_excess(a, w)
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
    return rows_of(table)


def table_setting(campaign: Campaign | None, distance_m: float | None, track_m: float | None) -> tuple[float, float]:
    """Return distance and track of the table: as given, else the campaign's (median distance) or the paper's."""
    if distance_m is None:
        known = np.array([]) if campaign is None else campaign.runs.number("distance_m")
        known = np.abs(known[np.isfinite(known)])
        distance_m = float(np.median(known)) if len(known) else PAPER_DISTANCE_M
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
    sine = 0.5 * float(arc_of_ratio_rad(distance_m, radius_ratio, track_m))
    if abs(sine) > 1.0:
        raise BadInputError(
            f"distance: found {distance_m:g} m; expected at most {distance_m / abs(sine):.4g} m, the diameter of the "
            "circle that these wheels drive; give a shorter distance"
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


#: largest error of a stated amplitude, a factor: peak to peak is 2; 20 % pass
AMPLITUDE_FACTOR: Final = 1.5


def weave_checks(radii: EffectiveRadii, wheels: list[WheelFit]) -> Iterator[Check]:
    """Yield the check of the residuals against measured weaves; it is of both wheels."""
    known = np.char.startswith(radii.path_source, "columns")
    if not known.any():
        return
    # the mean of both wheels: the net turn of a weave of unknown phase cancels
    residual = np.mean([wheel.residual_m / wheel.radius_m.mean() for wheel in wheels], axis=0)[known]
    excess = 0.5 * (radii.path_left + radii.path_right)[known]
    laws = np.column_stack([wheel.design_basis(radii.session)[known] for wheel in wheels])
    share, sd, dof = partial_slope(residual, excess, laws, NOTE_BELOW * float(excess.max()))
    if dof < MIN_SLOPE_DOF or sd <= 0.0:
        return
    # the excess goes by the square of the amplitude
    times = max(1.0 - share, 0.0) ** 0.5
    moved = UM * share * float(excess.mean()) * wheels[0].law.radius_ref_m
    sentences = (
        "The residuals do not follow the weave.",
        f"The residuals follow the weave as if its amplitude were {times:.2g} times the one stated, which moves the "
        f"radii by {moved:+.2g} um: amplitude_m is half of peak to peak; check it.",
    )
    yield t_check("weave", share, sd, dof, sentences, fails=not 1.0 / AMPLITUDE_FACTOR < times < AMPLITUDE_FACTOR)


def with_path_check(fit: WheelFit, radius_per_bow: float, apart_m: float) -> WheelFit:
    """Return `fit` with the check of paths that count as straight.

    `radius_per_bow`: change of the radius by a bow of all runs, m/m; `apart_m`: see `steered_itself_m`.
    """
    moved, level = f"{UM * 0.01 * radius_per_bow:.2g} um", NOTE
    sentence = (
        f"No end heading was measured: paths are taken for straight. A bow of 1 cm in all runs moves the radius by "
        f"{moved}, the other wheel's the other way, which no interval holds; measure ref_theta_rad, or declare "
        "path.apart_m under [uncertainty]."
    )
    if apart_m >= 0.0:
        level = FAILED
        sentence = (
            f"The wheels of all runs rolled alike to within {1e3 * apart_m:.2g} mm: the vehicle seems to have steered "
            "by its own counts. Then only the mean of both radii is known; measure ref_theta_rad at the end, or guide "
            "the vehicle by a line."
        )
    return replace(fit, checks=(*fit.checks, Check("path", level, sentence)))


#: quantile of the normal distribution, 97.5 %
NORMAL_95: Final = 1.96
PASSED: Final = "within"
BEYOND: Final = "beyond"
UNKNOWN: Final = "unknown"


@dataclass(frozen=True, slots=True, eq=False)
class RunDeviations:
    """Effect of each run's path on its radii."""

    #: relative error of a radius
    tolerance: float
    #: what is known of each run, by its name; see `judge_runs`; shape (n_runs,), NaN where unknown
    columns: Mapping[str, npt.NDArray[Any]]
    left_out: tuple[UnusedRun, ...]
    notes: tuple[str, ...]

    @property
    def verdict(self) -> StrArray:
        """``within``, ``beyond`` or ``unknown``, shape (n_runs,)."""
        return self.columns["verdict"]

    @property
    def passed(self) -> bool:
        """Whether no run is beyond the tolerance."""
        return not bool((self.verdict == BEYOND).any())

    @property
    def summary(self) -> str:
        """How many runs keep the tolerance, and what to do about the others."""
        n, share = len(self.verdict), f"{100 * self.tolerance:g} %"
        beyond, unknown = int((self.verdict == BEYOND).sum()), int((self.verdict == UNKNOWN).sum())
        text = f"{n - beyond - unknown} of {n} runs keep both radii within {share} of what a straight path would give"
        if beyond:
            text += f"; {beyond} do not: 'calib fit' corrects what logs tell, but repeat them nearer to the line"
        if unknown:
            open_, remedy = self.verdict == UNKNOWN, "add logs, or amplitude_m and wavelength_m"
            if np.isfinite(self.columns["error_left"][open_]).any():
                remedy = "where on the weave they began and ended decides; add logs, or ref_theta_rad at the end"
            elif (self.columns["source"][open_] != "none").any():
                remedy = "the wheels rolled as alike as steered by their own counts; measure ref_theta_rad at the end"
            text += f"; of {unknown} the path is not known well enough: {remedy}"
        curved, longer = (float(np.max(np.abs(self.columns[name]))) for name in ("arc_turn_rad", "arc_excess"))
        return (
            f"{text}. Steered by its own odometry with the model's radii the vehicle would have turned by up to "
            f"{curved:.3f} rad, a path up to {100 * longer:.3f} % longer."
        )

    def rows(self) -> list[Row]:
        """Return one mapping of plain values a run."""
        rows = zip(*map(plain, self.columns.values()), strict=True)
        return [dict(zip(self.columns, row, strict=True)) for row in rows]


def judge_runs(campaign: Campaign, tolerance: float) -> RunDeviations:
    """Judge the path of every straight run against a tolerance, the largest relative error of a radius.

    ``unknown`` are runs of unknown path, and those whose error is within the tolerance but its 95 % interval is not.
    Raises RefusedError where there is no straight run; BadInputError where the tolerance is not between 0 and 1.
    """
    if not 0 < tolerance < 1:
        expected = "a share between 0 and 1; 0.0005 is 0.05 % of the radius"
        raise BadInputError(f"tolerance: found {tolerance:g}; expected {expected}")
    campaign, left_out, _ = usable_runs(campaign, need_load=False)
    runs, vehicle, model = campaign.runs, campaign.vehicle, campaign.model
    path = correct_paths(campaign)
    distance = np.abs(runs.number("distance_m"))
    blind = np.isnan(runs.number("ref_theta_rad"))
    known = (path.source != "none") & ~(blind & (steered_itself_m(campaign) >= 0.0))
    left, right = radius_error([path.left, path.right])
    error, columns = np.maximum(np.abs(left), np.abs(right)), path.source == "columns"
    # the turn of a weave of unknown phase is at most sqrt(2) of its standard deviations
    std = np.hypot(0.5 * vehicle.track_m * path.yaw_std_rad / distance, path.centre_std)
    within = error + np.where(columns, np.sqrt(2.0), NORMAL_95) * std <= tolerance
    weaving = np.isfinite(path.wavelength_m) & (path.wavelength_m > 0)
    # an unknown phase is taken as that of the largest turn
    phases = np.where(columns, np.pi * (0.5 - distance / path.wavelength_m), path.phase_rad)
    phased = weaving & np.isfinite(phases)
    allowed, small = np.full((2, len(runs)), np.nan)
    allowed[weaving] = allowed_amplitude_m(tolerance, path.wavelength_m[weaving])
    if phased.any():
        length, phase, far = (part[phased] for part in (path.wavelength_m, phases, distance))
        allowed[phased] = allowed_amplitude_on_run_m(tolerance, length, far, vehicle.track_m, phase_rad=phase)
    small[weaving] = small_amplitude_excess(path.amplitude_m[weaving], path.wavelength_m[weaving])
    # r_R / r_L of each run; the distance cancels
    ratio = (np.abs(runs.number("counts_left")) / campaign.encoder.counts_per_rev_left * (1 + path.right)) / (
        np.abs(runs.number("counts_right")) / campaign.encoder.counts_per_rev_right * (1 + path.left)
    )
    turn = arc_of_ratio_rad(distance, ratio / (model.radius_right_m / model.radius_left_m), vehicle.track_m)
    unknown_nan = np.where(known, 0.0, np.nan)
    columns = {
        "run_id": runs.run_id,
        "source": path.source,
        "verdict": np.select([known & within, known & (error > tolerance)], [PASSED, BEYOND], UNKNOWN),
        "distance_m": distance,
        "amplitude_m": path.amplitude_m,
        "wavelength_m": path.wavelength_m,
        # relative excess of each path over S_O, and that of the weave alone by the small-amplitude form
        "excess_centre": path.centre + unknown_nan,
        "excess_left": path.left + unknown_nan,
        "excess_right": path.right + unknown_nan,
        "small_amplitude": small,
        # of the radii if the path were not corrected, relative and in m
        "error_left": left + unknown_nan,
        "error_right": right + unknown_nan,
        "error_left_m": left * vehicle.wheel_radius_m + unknown_nan,
        "error_right_m": right * vehicle.wheel_radius_m + unknown_nan,
        # largest amplitude that keeps both radii within tolerance on that run
        "allowed_amplitude_m": allowed,
        # if the vehicle were steered by its own odometry with the model's radii
        "arc_turn_rad": turn,
        "arc_excess": arc_excess(turn, distance, vehicle.track_m).centre,
    }
    notes = (*path.notes, *_bow_note(known & blind, distance, tolerance, vehicle))
    return RunDeviations(tolerance, columns, left_out, notes)


def _bow_note(blind: BoolArray, distance_m: FloatArray, tolerance: float, vehicle: Vehicle) -> Iterator[str]:
    if blind.any():
        # a bow turns the vehicle by 8 bows over the distance
        bow_m = tolerance * float(np.median(distance_m[blind])) ** 2 / (4.0 * vehicle.track_m)
        yield (
            f"A steady bow of {blind.sum()} of {len(blind)} runs is not seen: nothing tells it from unequal radii. One "
            f"of {1e3 * bow_m:.3g} mm moves a radius by {100 * tolerance:g} %; measure ref_theta_rad at the end."
        )
