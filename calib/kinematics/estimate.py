"""Estimation of a campaign's geometry: choice of segments, blunders, delays and sensor, and held-out runs."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from typing import Final, Literal

import numpy as np

from calib.campaign.check import swapped_sessions
from calib.campaign.model import Campaign
from calib.campaign.wheels import odometry_source
from calib.errors import RefusedError
from calib.kinematics import Recording, blunder_search, departures, joint_fit, recording_of
from calib.kinematics.adequacy import LENGTHS_ALONE, rms
from calib.kinematics.assemble import divisions, geometry_of, of_kinds
from calib.kinematics.blunders import Fault, corrected, times_fault
from calib.kinematics.drives import SENSOR, Drive, nominal_motion
from calib.kinematics.joint_fit import Delay, Fitted, drive_of, fit_parameters
from calib.kinematics.model import Model, Segments, end_pose_segments
from calib.kinematics.readings import implausible_lengths
from calib.kinematics.result import Geometry, Transfer
from calib.kinematics.uncertainty import ENOUGH_RUNS, left_within
from calib.types import FloatArray, Progress, silent, stepped

Using = Literal["end_poses", "windows"]

#: a finer division is taken whose intervals are hardly wider: a bad measurement spoils less
AS_GOOD: Final = 1.25
#: heading errors beyond this bend the path by more than a linear model allows
BENT_RAD: Final = 0.1
#: faults that ends need not show
UNSEEN: Final = {"x_mirrored", "y_mirrored", "axes_exchanged", "outward_slip"}
OF_CLOCKS: Final = {"clock_rate", "time_unit"}
#: fits that find each recording's own delay
DELAY_ROUNDS: Final = 3
#: fits that find a departure's size; its last change
SIZE_ROUNDS, SIZE_FOUND = 6, 0.05


def estimate_geometry(
    campaign: Campaign,
    *,
    using: Using | None = None,
    kinds: Sequence[str] = (),
    sensor: bool | None = None,
    leave_out: Literal["session", "kind", "run_id"] | None = None,
    progress: Progress = silent,
) -> Geometry:
    """Estimate a drive's parameters together with the reference's sensor; see `calib.api.results.geometry`.

    Without `using`: windows where the reference follows the path, else end poses, also where eight runs or more have
    one and windows do not fit. `sensor`: estimate the sensor's place and delay; None: with windows, and where end poses
    need it. Raises RefusedError where no run has wheels and a reference, or nothing can be determined.
    """
    campaign = of_kinds(campaign, kinds)
    source = odometry_source(campaign)
    recording = recording_of(campaign, source)
    recording.refuse_constant_heading(nominal_motion(drive_of(campaign, source, recording), recording.steps)[2])

    by_windows = cache(lambda: _fitted(_Task(campaign, source, "windows", True, progress), recording))

    def estimated(way: Using) -> Geometry:
        task = _Task(campaign, source, way, (way == "windows") if sensor is None else sensor, progress)
        return _estimated(task, recording, by_windows, asked=sensor is not None or using is not None)

    geometry = estimated(using) if using else _best(recording, estimated)
    if leave_out is not None:
        placed = (geometry.using == "windows") if sensor is None else sensor
        geometry = replace(geometry, transfer=_transfer(campaign, geometry, placed, leave_out, progress))
    return geometry


def _best(recording: Recording, estimated: Callable[[Using], Geometry]) -> Geometry:
    if not recording.continuous:
        return estimated("end_poses")
    if np.isfinite(recording.end_pose[:, :2]).all(axis=1).sum() < ENOUGH_RUNS:
        return estimated("windows")
    try:
        by_windows = estimated("windows")
    except RefusedError:
        return estimated("end_poses")
    with suppress(RefusedError):
        codes = {fault.code for fault in by_windows.faults}
        trusted = by_windows.passed or UNSEEN & codes or (codes - OF_CLOCKS and not by_windows.misfit)
        return by_windows if trusted else _told_by(by_windows, estimated("end_poses"))
    return by_windows


def _told_by(windows: Geometry, ends: Geometry) -> Geometry:
    # what windows show, such as a clock or a sensor that was moved, hardly shows at ends
    by = f"By windows of the recordings the result is {windows.verdict.value}: "
    return replace(ends, notes=(*ends.notes, *(f"{by}{why.rstrip('.')}." for why in windows.why[:1])))


def _estimated(task: "_Task", recording: Recording, by_windows: Callable[[], "_Fit"], *, asked: bool) -> Geometry:
    try:
        fit = by_windows() if task.sensor and task.way == "windows" else _fitted(task, recording)
    except np.linalg.LinAlgError as error:
        if not recording.lengths_alone:
            raise
        raise RefusedError(f"geometry of {task.campaign.name!r}: found {LENGTHS_ALONE}") from error
    except RefusedError:
        corrected = _without_blunder(task, recording)
        if corrected is None:
            raise
        return corrected.geometry
    # of lengths alone a bend makes up for any reading or sensor
    if recording.lengths_alone:
        asked = True
    elif fit.geometry.misfit:
        fit = _without_blunder(task, recording) or fit
    geometry, judgement = fit.geometry, fit.geometry.judgement
    asked = asked or task.sensor
    # the place of a sensor explains nothing that differs between sessions
    if not (asked or judgement.position.apart or judgement.heading.apart or geometry.passed or geometry.faults):
        fit = _with_sensor(task, recording, fit, by_windows) or fit
    return fit.geometry if fit.geometry.faults else _without_departure(fit)


@dataclass(frozen=True, slots=True, eq=False)
class _Task:
    campaign: Campaign
    source: str
    way: Using
    sensor: bool
    progress: Progress

    def drive(self, recording: Recording) -> Drive:
        return drive_of(self.campaign, self.source, recording)

    def fit(self, drive: Drive, recording: Recording, segments: Segments, start: Fitted | None = None) -> Fitted:
        return fit_parameters(self.campaign, drive, recording, segments, self.sensor, start)

    def with_whole_turns(self, recording: Recording) -> tuple[Recording, list[str]]:
        return recording.with_whole_turns(nominal_motion(self.drive(recording), recording.steps)[2])


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    task: _Task
    fitted: Fitted
    geometry: Geometry
    common: Fitted  #: with one delay for all recordings


def _fitted(task: _Task, recording: Recording, known: tuple[Fault, ...] = ()) -> _Fit:
    as_read = recording.end_pose
    recording, off = task.with_whole_turns(recording)
    if off and task.way == "end_poses" and not any(swapped_sessions(task.campaign)):
        text = f"ref_theta_rad: found the end heading of {', '.join(off)} off by whole turns beside the others; "
        known = (*known, Fault("heading_turn", f"{text}correct it"))
    finer = divisions(recording, task.way)
    coarse = next(finer)
    recording, faults = corrected(recording, coarse, task.source, task.drive(recording))
    if faults:
        recording, _ = task.with_whole_turns(replace(recording, end_pose=as_read))
    drive = task.drive(recording)
    if task.way == "windows" and (timed := times_fault(recording)):
        faults = (*faults, timed)
    task.progress(0, 0, "fits")
    chosen = task.fit(drive, recording, coarse)
    turned = _turned_round(chosen) if task.sensor else None
    if turned:
        chosen = task.fit(drive, recording, coarse, turned)
    many = len(recording) >= ENOUGH_RUNS
    for number, segments in enumerate(finer, start=1):
        before, residuals = chosen.model.segments, chosen.solution.prediction.residuals
        bends = many and rms(residuals[(before.level == 0) & before.seen[:, 2], 2:]) > BENT_RAD
        if many and not (bends or set(chosen.undetermined) - set(SENSOR)):
            break
        task.progress(number, 0, "fits")
        # short windows do not find a delay of many steps
        try:
            other = task.fit(drive, recording, segments, None if many and not turned else chosen)
        except np.linalg.LinAlgError:
            # of wrong readings a search may end at lengths of zero
            break
        fewer = len(other.undetermined) < len(chosen.undetermined)
        if not (bends or (fewer if many else other.spread <= chosen.spread + np.log(AS_GOOD))):
            break
        chosen = other
    common, delays = chosen, tuple[Delay, ...]()
    if task.way == "windows":
        losses = joint_fit.delay_losses(common)
        if start := joint_fit.at_best_delay(common, losses):
            common = task.fit(drive, recording, common.model.segments, start)
            losses = joint_fit.delay_losses(common)
        chosen, delays = _with_own_delays(task, common, losses)
        if delays and not many and common.model.segments is not coarse:
            other = task.fit(drive, chosen.model.recording, coarse, chosen)
            chosen = other if chosen.spread > other.spread + np.log(AS_GOOD) else chosen
    chosen = _with_own_zeros(task, chosen)
    geometry = geometry_of(task.campaign, chosen, task.source, task.way, (*known, *faults))
    return _Fit(task, chosen, replace(geometry, delays=delays), common)


def _turned_round(fitted: Fitted) -> Fitted | None:
    names, values = np.array(fitted.parameters.names), fitted.solution.values
    lengths = np.char.endswith(names, "_m") | np.char.startswith(names, "slope")
    if (values[lengths & ~np.char.startswith(names, "sensor")] > 0.0).any():
        return None
    yaw = names == "sensor_yaw_rad"
    values = np.where(yaw, values - np.copysign(np.pi, values), np.where(lengths, -values, values))
    return replace(fitted, solution=replace(fitted.solution, values=values))


def _without_departure(fit: _Fit) -> Geometry:
    geometry = fit.geometry
    best = departures.find_departure(fit.fitted, misfit=geometry.misfit)
    # a delay that grows looks like several, and they hide it
    hidden = best is None and bool(geometry.delays)
    if hidden:
        best = departures.find_departure(fit.common, misfit=geometry.misfit)
        best = best or departures.hidden_clock(fit.fitted.model.recording)
    # where the runs tell no delay, they tell no clock either
    if best is None or (best[0].named(best[1]).code == "clock_rate" and SENSOR[-1] in geometry.undetermined):
        return geometry
    departure, size = best
    size = size if hidden else _refined(fit, departure, size)
    recording = replace(fit.fitted.model.recording, own_delay_s=None)
    for _ in range(SIZE_ROUNDS):
        try:
            other = _fitted(fit.task, departure.change(recording, size), (fault := departure.named(size),))
        except (RefusedError, np.linalg.LinAlgError):
            return geometry
        still = departures.hidden_clock(other.fitted.model.recording) if hidden and other.geometry.delays else None
        step = still[1] if still else departures.score(other.fitted, departure)[1]
        corrected, most = other.geometry, min(abs(size), departures.LARGEST_SIZE * abs(departure.step))
        settled = abs(step) < SIZE_FOUND * abs(size) <= SIZE_FOUND * most
        if (settled and still is None) or (corrected.misfit and geometry.misfit and abs(step) < 0.5 * abs(size)):
            break
        size += step
    explained = departure.share or (geometry.misfit and not corrected.misfit)
    moved = any(abs(corrected.values[one.name] - one.value) > one.half_width for one in geometry.estimates)
    if not (settled and (explained or moved)) or (corrected.misfit and geometry.misfit):
        return geometry
    if hidden:
        changed = departure.change(recording, size)
        model = replace(other.fitted.model, recording=changed, segments=fit.fitted.model.segments)
        pairs = (model, other.fitted), (fit.fitted.model, fit.fitted)
        off_m = [np.hypot(*one.residuals(by.solution.values)[:, :2].T).mean() for one, by in pairs]
        if corrected.misfit or corrected.delays or off_m[0] > off_m[1]:
            return geometry
    return geometry.doubted(fault) if corrected.misfit or fault.code.endswith("_slip") else corrected


def _refined(fit: _Fit, departure: departures.Departure, size: float) -> float:
    model, start = fit.fitted.model, fit.fitted
    for _ in range(SIZE_ROUNDS):
        changed = departure.change(model.recording, size)
        segments = departures.remeasured(model.segments, model.recording.reference, changed.reference)
        start = fit.task.fit(model.drive, changed, segments, start)
        size += (step := departures.score(start, departure)[1])
        if not abs(step) >= SIZE_FOUND * abs(size):
            break
    return size


def _without_blunder(task: _Task, recording: Recording) -> _Fit | None:
    task.progress(0, 0, "blunders")

    def divided(campaign: Campaign, other: Recording) -> Segments:
        if task.way == "end_poses":
            other, _ = replace(task, campaign=campaign).with_whole_turns(other)
        return next(divisions(other, task.way))

    correction = blunder_search.find_blunder(task.campaign, recording, task.source, divided)
    if correction is None:
        return None
    campaign, corrected, blunder = correction
    # of skid steering: no blunder
    wide = campaign.vehicle.drive == "skid" and blunder.code == "half_track"
    try:
        fit = _fitted(replace(task, campaign=campaign), corrected, () if wide else (blunder,))
    except RefusedError as error:
        raise RefusedError(f"{error}; {blunder.text}") from error
    except np.linalg.LinAlgError:
        return None
    return replace(fit, geometry=fit.geometry.with_wide_track(task.campaign.model.track_m, blunder)) if wide else fit


def _with_sensor(task: _Task, recording: Recording, fit: _Fit, by_windows: Callable[[], _Fit]) -> _Fit | None:
    try:
        other = by_windows() if recording.continuous else _fitted(replace(task, sensor=True), recording)
    except (RefusedError, np.linalg.LinAlgError):
        return None
    bent = other.task.way != task.way and fit.geometry.residual_rms.theta_rad > BENT_RAD
    # a fault named there is why end poses are not explained
    named = fit.geometry.misfit and other.geometry.faults and not other.geometry.misfit
    return other if other.geometry.passed or bent or named else None


def _with_own_delays(task: _Task, common: Fitted, losses: FloatArray) -> tuple[Fitted, tuple[Delay, ...]]:
    if implausible_lengths(common, task.campaign.vehicle.drive):
        return common, ()
    fitted, delays = common, tuple[Delay, ...]()
    added = joint_fit.sought_delays(common, losses)
    for number in range(DELAY_ROUNDS):
        if number or not added.any():
            delays, added = joint_fit.own_delays(fitted)
            if not delays:
                return common, ()
        recording = replace(fitted.model.recording, own_delay_s=added)
        fitted = task.fit(fitted.model.drive, recording, fitted.model.segments, fitted)
    return fitted, delays


def _with_own_zeros(task: _Task, fitted: Fitted) -> Fitted:
    model, free = fitted.model, fitted.parameters.free
    if task.way == "windows":
        return joint_fit.with_own_zeros(fitted)
    if left_within(fitted.solution, free, model.segments, model.recording.session)[0] == np.inf:
        return fitted
    own = joint_fit.with_own_zeros(fitted)
    if not own.zero_spread_rad or not fitted.undetermined:
        return own
    again = task.fit(model.drive, own.model.recording, model.segments)
    solution = replace(again.solution, prediction=model.predict(again.solution.values))
    again = joint_fit.with_own_zeros(replace(again, model=model, solution=solution, logged=model.recording))
    return own if again.undetermined else again


def _transfer(
    campaign: Campaign, whole: Geometry, sensor: bool, leave_out: str, progress: Progress
) -> tuple[Transfer, ...]:
    campaign = campaign.included()
    labels = campaign.runs.label(leave_out)
    rows = []
    for label in stepped(dict.fromkeys(labels), progress, "held out in turn"):
        parts = (campaign.select((labels == label) == held) for held in (False, True))
        kept, held_out = (recording_of(part, whole.source) for part in parts)
        drive = drive_of(campaign, whole.source, kept)
        fitted = fit_parameters(campaign, drive, kept, next(divisions(kept, whole.using)), sensor)
        model = Model(drive, held_out, end_pose_segments(held_out))
        vehicles = fitted.parameters.nominal, fitted.solution.values
        left_m = (rms(model.residuals(values)[:, :2]) for values in vehicles)
        rows.append(Transfer(str(label), len(held_out), *left_m))
    return tuple(rows)
