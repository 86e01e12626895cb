"""The path deviation of a campaign's runs: how far each path moved its radii, and whether that is within tolerance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.campaign.model import Campaign
from calib.documents import plain
from calib.errors import BadInputError
from calib.radius import deviation
from calib.radius.deviation import allowed_amplitude_m, arc_excess, radius_error, small_amplitude_excess
from calib.radius.effective import UnusedRun, usable_runs
from calib.radius.path_length import correct_paths
from calib.types import FloatArray, Row, StrArray

PASSED: Final = "within"
BEYOND: Final = "beyond"
UNKNOWN: Final = "unknown"


@dataclass(frozen=True, slots=True, eq=False)
class RunDeviations:
    """Effect of each run's path on its radii; arrays of shape (n_runs,), NaN where unknown."""

    #: largest relative error of a radius that is accepted
    tolerance: float
    #: run; where its path is known from (`calib.radius.path_length.RunPaths`); ``within``, ``beyond`` or ``unknown``
    run_id: StrArray
    source: StrArray
    verdict: StrArray
    #: length and weave
    distance_m: FloatArray
    amplitude_m: FloatArray
    wavelength_m: FloatArray
    #: relative excess of each path over S_O
    excess_centre: FloatArray
    excess_left: FloatArray
    excess_right: FloatArray
    #: excess of the weave alone by the small-amplitude form
    small_amplitude: FloatArray
    #: relative error of the radii if the path were not corrected
    error_left: FloatArray
    error_right: FloatArray
    #: the same in m on the nominal radius
    error_left_m: FloatArray
    error_right_m: FloatArray
    #: largest amplitude of that wavelength on that run that keeps both radii within tolerance
    allowed_amplitude_m: FloatArray
    #: turn, and relative excess of the path, if the vehicle were steered by its own odometry with the model's radii
    arc_turn_rad: FloatArray
    arc_excess: FloatArray
    #: runs that are not judged
    left_out: tuple[UnusedRun, ...]
    #: which corrections were made
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
            text += f"; {beyond} do not: 'calib fit' corrects what logs tell, but repeat them nearer to the line"
        if unknown:
            text += f"; of {unknown} the path is not known: add logs, or amplitude_m and wavelength_m"
        curved = float(np.max(np.abs(self.arc_turn_rad)))
        return (
            f"{text}. Steered by its own odometry with the model's radii the vehicle would have turned by up to "
            f"{curved:.3f} rad, a path up to {100 * float(np.max(self.arc_excess)):.3f} % longer."
        )

    def rows(self) -> list[Row]:
        """Return one mapping of plain values a run."""
        names = [name for name in self.__dataclass_fields__ if name not in {"tolerance", "left_out", "notes"}]
        columns = [plain(getattr(self, name)) for name in names]
        return [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True)]


def judge_runs(campaign: Campaign, tolerance: float) -> RunDeviations:
    """Judge the path of every straight run against a tolerance.

    `campaign`: runs with logs, or with measured amplitude and wavelength; others are ``unknown``; `tolerance`: largest
    relative error of a radius, between 0 and 1. Raises RefusedError where there is no straight
    run; BadInputError where the tolerance is not between 0 and 1.
    """
    if not 0 < tolerance < 1:
        expected = "a share between 0 and 1; 0.0005 is 0.05 % of the radius"
        raise BadInputError(f"tolerance: found {tolerance:g}; expected {expected}")
    campaign, left_out, _ = usable_runs(campaign, need_load=False)
    runs, vehicle, model = campaign.runs, campaign.vehicle, campaign.model
    path = correct_paths(campaign)
    distance = np.abs(runs.number("distance_m"))
    known = path.source != "none"
    left, right = radius_error(path.left), radius_error(path.right)
    worse = np.maximum(np.abs(left), np.abs(right))
    weaving = np.isfinite(path.wavelength_m) & (path.wavelength_m > 0)
    phased = weaving & np.isfinite(path.phase_rad)
    allowed = np.full(len(runs), np.nan)
    allowed[weaving] = allowed_amplitude_m(tolerance, path.wavelength_m[weaving])
    if phased.any():
        length, phase, far = (part[phased] for part in (path.wavelength_m, path.phase_rad, distance))
        allowed[phased] = deviation.allowed_amplitude_on_run_m(tolerance, length, far, vehicle.track_m, phase_rad=phase)
    small = np.full(len(runs), np.nan)
    small[weaving] = small_amplitude_excess(path.amplitude_m[weaving], path.wavelength_m[weaving])
    # r_R / r_L as each run shows it; the distance cancels
    ratio = (np.abs(runs.number("counts_left")) / campaign.encoder.counts_per_rev_left * (1 + path.right)) / (
        np.abs(runs.number("counts_right")) / campaign.encoder.counts_per_rev_right * (1 + path.left)
    )
    believed = model.radius_right_m / model.radius_left_m
    turn = deviation.arc_of_radii_rad(distance, 1.0, ratio / believed, vehicle.track_m)
    unknown_nan = np.where(known, 0.0, np.nan)
    return RunDeviations(
        tolerance=tolerance,
        run_id=runs.run_id,
        source=path.source,
        verdict=np.where(~known, UNKNOWN, np.where(worse <= tolerance, PASSED, BEYOND)),
        distance_m=distance,
        amplitude_m=path.amplitude_m,
        wavelength_m=path.wavelength_m,
        excess_centre=path.centre + unknown_nan,
        excess_left=path.left + unknown_nan,
        excess_right=path.right + unknown_nan,
        small_amplitude=small,
        error_left=left + unknown_nan,
        error_right=right + unknown_nan,
        error_left_m=left * vehicle.wheel_radius_m + unknown_nan,
        error_right_m=right * vehicle.wheel_radius_m + unknown_nan,
        allowed_amplitude_m=allowed,
        arc_turn_rad=turn,
        arc_excess=arc_excess(turn, distance, vehicle.track_m).centre,
        left_out=left_out,
        notes=path.notes,
    )
