"""The way through: from a campaign to its geometry."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, Literal, cast

import numpy as np

from calib.arrays import FloatArray
from calib.campaign.wheels import mecanum_model, odometry_source
from calib.errors import RefusedError
from calib.geometry.clusters import ENOUGH_RUNS, Clustering, clustered
from calib.geometry.delays import Delay, own_delays, sought_delays
from calib.geometry.drives import Differential, Drive, FrontWheel, MeanHeld, Mecanum
from calib.geometry.gross import Fault, factor_faults
from calib.geometry.gross_wheels import put_right
from calib.geometry.identifiability import NOMINAL_STD, loosest, scale_is_open, scale_is_weakest, weakest
from calib.geometry.model import Model
from calib.geometry.noise import COMPONENTS
from calib.geometry.notes import notes_on
from calib.geometry.parameters import SENSOR, Parameters, sensor_parameters
from calib.geometry.parts import Estimate, Transfer
from calib.geometry.recording import Recording, recording_of
from calib.geometry.result import Geometry
from calib.geometry.routes import of_kinds, rms, route_table
from calib.geometry.segments import Segments, end_pose_segments, window_segments
from calib.geometry.solve import Solution, solve
from calib.geometry.umbmark import Umbmark, umbmark
from calib.progress import Progress, silent, stepped

if TYPE_CHECKING:
    from calib.campaign.model import Campaign

Using = Literal["end_poses", "windows"]

#: blocks that windows of a few long recordings are laid in, coarse to fine; many runs are blocks themselves
BLOCKS: Final = (40, 160, 640)
#: a finer division is taken where its intervals are at most this much wider: a failed measurement then spoils less, and
#: a standard deviation from some dozens of blocks is itself known to 15 %
AS_GOOD: Final = 1.25
#: random walks of heading and distance to begin with, per metre
WALKS: Final = (2.5e-7, 2.5e-7)
#: an outlier is a run that chance makes once in a hundred campaigns
OUTLIER_CHANCE: Final = 0.01
#: a delay is sought where samples are at most so far apart
LONGEST_STEP_S: Final = 0.25
#: fits in which each recording's own delay is found, where one for all will not do
DELAY_ROUNDS: Final = 3
#: loads that vary by less than this part of their mean say nothing of a slope
LOADS_VARY: Final = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class _Fitted:
    """One estimate with what stands behind it."""

    model: Model
    parameters: Parameters
    solution: Solution
    clustering: Clustering
    dropped: tuple[str, ...]

    @property
    def spread(self) -> float:
        """Mean logarithm of the drive parameters' standard deviations beside their prior ones."""
        n_drive = len(self.parameters.items) - len(SENSOR)
        free = self.parameters.free
        std = self.parameters.prior_std.copy()
        std[free] = self.clustering.uncertainty.apart
        if isinstance(self.model.drive, MeanHeld):
            # what is held is no better known for that
            std[:n_drive] = np.hypot(std[:n_drive], NOMINAL_STD * self.solution.values[:n_drive])
        return float(np.mean(np.log(std[:n_drive] / self.parameters.prior_std[:n_drive])))


def estimate_geometry(
    campaign: Campaign,
    *,
    using: Using | None = None,
    kinds: Sequence[str] = (),
    sensor: bool | None = None,
    leave_out: Literal["session", "kind", "run_id"] | None = None,
    progress: Progress = silent,
) -> Geometry:
    """Estimate radii and track, or what the drive has in their place, together with the reference's sensor.

    Parameters
    ----------
    campaign : Campaign
        Runs with logs of the wheels, and end poses or poses along the way.
    using : {"end_poses", "windows"}, optional
        Whole runs, or windows of several lengths. None: end poses where eight runs or more have one, since they ask
        nothing of clocks; else windows where the reference follows the vehicle along the way.
    kinds : sequence of str
        Kinds of routes to use; none: all.
    sensor : bool, optional
        Estimate the sensor's pose on the vehicle and its delay; None: with windows.
    leave_out : {"session", "kind", "run_id"}, optional
        Leave each of these out in turn and say the end position error of the runs left out, before and after.
    progress : callable
        See `calib.progress.Progress`.

    Returns
    -------
    Geometry
        Values with intervals, what stayed undetermined, residuals by route.

    Raises
    ------
    RefusedError
        Where no run has wheels and a reference, or nothing can be determined.
    """
    campaign = of_kinds(campaign, kinds)
    source = odometry_source(campaign)
    recording = recording_of(campaign, source)
    recording = recording.unwrapped(_turns(drive_of(campaign, source, recording), recording))
    way = using or _way(recording)
    divisions = _divisions(recording, way)
    coarse = next(divisions)
    recording, faults = put_right(recording, coarse, source, drive_of(campaign, source, recording))
    drive = drive_of(campaign, source, recording)
    estimated = (way == "windows") if sensor is None else sensor
    progress(0, 0, "fits")
    chosen = _fit(campaign, drive, recording, coarse, estimated)
    for number, segments in enumerate(divisions, start=1):
        progress(number, 0, "fits")
        # from where the coarser one ended: over short windows a delay of many steps is not found from nought
        other = _fit(campaign, drive, recording, segments, estimated, start=chosen)
        if other.spread > chosen.spread + np.log(AS_GOOD):
            break
        chosen = other
    chosen, delays = _with_own_delays(campaign, chosen, estimated) if way == "windows" else (chosen, ())
    geometry = replace(_result(campaign, chosen, source, way, faults), delays=delays)
    if leave_out is not None:
        transfer = _transfer(campaign, geometry, estimated, leave_out, progress)
        geometry = replace(geometry, transfer=transfer)
    return geometry


def _with_own_delays(campaign: Campaign, common: _Fitted, sensor: bool) -> tuple[_Fitted, tuple[Delay, ...]]:
    """Return the estimate with a delay for each recording, where one for all will not do, and these delays."""
    fitted = common
    delays: tuple[Delay, ...] = ()
    added = sought_delays(common.model, common.solution, common.parameters)
    for number in range(DELAY_ROUNDS):
        if number or not added.any():
            delays, added = own_delays(fitted.model, fitted.solution, fitted.parameters)
            if not delays:
                return common, ()
        recording = replace(fitted.model.recording, own_delay_s=added)
        fitted = _fit(campaign, fitted.model.drive, recording, fitted.model.segments, sensor, start=fitted)
    return fitted, delays


def _way(recording: Recording) -> Using:
    ends = int(np.isfinite(recording.end_pose[:, :2]).all(axis=1).sum())
    return "windows" if recording.continuous and ends < ENOUGH_RUNS else "end_poses"


def _turns(drive: Drive, recording: Recording) -> FloatArray:
    """Return the turn of each run by the nominal vehicle."""
    nominal = np.array([item.nominal for item in drive.parameters])
    turn = drive.motion(nominal, recording.steps).body[2]
    return np.add.reduceat(turn, recording.offsets[:-1])


def _divisions(recording: Recording, using: Using) -> Iterator[Segments]:
    """Yield stretches: whole runs, or windows in ever finer divisions."""
    if using == "end_poses":
        yield end_pose_segments(recording)
        return
    if len(recording) >= ENOUGH_RUNS:
        yield window_segments(recording, len(recording))
        return
    before = 0
    for blocks in BLOCKS:
        segments = window_segments(recording, blocks)
        count = len(np.unique(segments.block))
        if count > before:
            yield segments
        before = count


def recordings_put_right(campaign: Campaign, source: str) -> tuple[Recording, tuple[Fault, ...]]:
    """Return wheels and reference with gross faults put right, and these faults."""
    recording = recording_of(campaign, source)
    divisions = _divisions(recording, _way(recording))
    return put_right(recording, next(divisions), source, drive_of(campaign, source, recording))


def drive_of(campaign: Campaign, source: str, recording: Recording) -> Drive:
    """Return the drive with its nominal values.

    `campaign`: its vehicle, and its model of the wheels; `source` ({"rear", "front", "wheels"}); `recording`: says
    whether the loads varied, so that radii have slopes.
    """
    vehicle, model = campaign.vehicle, campaign.model
    if source == "front":
        return FrontWheel(vehicle.front_radius_m, vehicle.wheelbase_m)
    if source == "wheels":
        wheels = mecanum_model(campaign)
        return Mecanum(wheels.radius_m, wheels.arm_m)
    loads = recording.steps.load_offset_N
    varied = loads is not None and bool(np.all(np.ptp(loads, axis=1) > LOADS_VARY * max(model.reference_load_N, 1.0)))
    return Differential(
        model.radius_left_m,
        model.radius_right_m,
        model.track_m,
        slopes=varied,
        slope_left_m_per_N=model.slope_left_m_per_N,
        slope_right_m_per_N=model.slope_right_m_per_N,
    )


def _fit(
    campaign: Campaign,
    drive: Drive,
    recording: Recording,
    segments: Segments,
    sensor: bool,
    start: _Fitted | None = None,
) -> _Fitted:
    """Estimate, and leave out what the data cannot determine, one parameter at a time."""
    reference = campaign.reference
    place = sensor_parameters(reference.sensor_x_m, reference.sensor_y_m, reference.sensor_yaw_rad)
    items = (*drive.parameters, *place)
    free = [item.name for item in drive.parameters]
    dropped: list[str] = []
    if sensor:
        free += list(SENSOR)
        if float(np.median(np.diff(recording.t_s))) > LONGEST_STEP_S:
            free.remove("delay_s")
            dropped.append("delay_s")
    parameters = Parameters.of(items, free)
    model = Model(drive, recording, segments)
    scales = np.array([reference.sigma_xy_m**2, reference.sigma_theta_rad**2, *WALKS])
    values = parameters.nominal
    if start is not None and start.model.drive == drive:
        values = np.where(parameters.free, start.solution.values, values)
    while True:
        if not parameters.free.any():
            raise RefusedError(
                f"geometry of {campaign.name!r}: found nothing that these runs determine; expected runs with turns and "
                "straights and a reference of their end poses; drive squares both ways"
            )
        solution = solve(model, parameters, values, scales)
        loose = weakest(solution, parameters)
        wheels = drive if isinstance(drive, Differential) and not drive.slopes and parameters.free[:3].all() else None
        if loose is not None and wheels is not None and scale_is_weakest(solution, parameters):
            return _fit(campaign, MeanHeld(wheels), recording, segments, sensor)
        if loose is None:
            clustering = clustered(solution, parameters, recording, segments)
            loose = loosest(clustering.uncertainty.std, parameters)
            covariance = clustering.uncertainty.covariance[:3, :3]
            if wheels is not None and scale_is_open(covariance, solution.values[:3]):
                return _fit(campaign, MeanHeld(wheels), recording, segments, sensor)
            if loose is None:
                return _Fitted(model, parameters, solution, clustering, tuple(dropped))
        dropped.append(loose)
        parameters = parameters.without([loose])
        values = np.where(parameters.free, solution.values, parameters.nominal)


def _result(campaign: Campaign, fitted: _Fitted, source: str, using: Using, faults: tuple[Fault, ...]) -> Geometry:
    parameters, solution, model = fitted.parameters, fitted.solution, fitted.model
    nominal, values = parameters.nominal, solution.values
    estimates, covariance = _estimates(fitted)
    nominal_of, value_of = ({e.name: getattr(e, kind) for e in estimates} for kind in ("nominal", "value"))
    faults = (*faults, *factor_faults(nominal_of, value_of))
    whole = _whole(model)
    before, after = whole.predict(nominal), whole.predict(values)
    squares = (
        umbmark(before, after, whole.segments, campaign.model.track_m)
        if source == "rear" and len(whole.segments) and whole.segments.are_runs_of(whole.recording)
        else Umbmark(False, why="squares of a vehicle with two encoders on one axle are needed")
    )
    return Geometry(
        name=campaign.name,
        simulated=campaign.simulated,
        drive=campaign.vehicle.drive,
        source=source,
        using=using,
        n_runs=len(np.unique(model.segments.run)),
        n_segments=len(model.segments),
        estimates=estimates,
        covariance=covariance,
        # where one radius stands for two, directions of the free parameters say nothing of both
        freedom=None if isinstance(model.drive, MeanHeld) else fitted.clustering.uncertainty.freedom,
        undetermined=(*fitted.dropped, *(("mean_radius_m",) if isinstance(model.drive, MeanHeld) else ())),
        held={name: float(nominal[at]) for at, name in enumerate(parameters.names) if not parameters.free[at]},
        clusters=(fitted.clustering.name, fitted.clustering.uncertainty.clusters),
        noise=dict(zip(COMPONENTS, np.sqrt(solution.scales).tolist(), strict=True)),
        residual_rms=rms(after.residuals),
        outliers=_outliers(model, solution),
        faults=faults,
        mirrored=any(fault.code in {"reversed_front", "reversed_steering", "reversed_both"} for fault in faults),
        umbmark=squares,
        routes=route_table(model.recording, whole.segments, before.residuals, after.residuals),
        notes=notes_on(
            fitted.clustering,
            model.recording,
            mean_held=isinstance(model.drive, MeanHeld),
            converged=solution.converged,
        ),
        inputs=campaign.hashes,
    )


def _estimates(fitted: _Fitted) -> tuple[tuple[Estimate, ...], FloatArray]:
    """Return the estimates and their covariance; a right radius that the held mean left comes back as one of them."""
    from scipy.special import stdtrit

    parameters, uncertainty = fitted.parameters, fitted.clustering.uncertainty
    index = np.flatnonzero(parameters.free)
    names = [parameters.names[at] for at in index]
    nominal, values = parameters.nominal[index], fitted.solution.values[index]
    covariance, dof = uncertainty.covariance, uncertainty.dof
    free = dof
    drive = fitted.model.drive
    if isinstance(drive, MeanHeld) and names[0] == "radius_left_m":
        spread = np.insert(np.eye(len(names)), 1, -np.eye(len(names))[0], axis=0)
        names.insert(1, "radius_right_m")
        nominal = np.insert(nominal, 1, drive.wheels.radius_right_m)
        values, dof = np.insert(values, 1, 2.0 * drive.mean_m - values[0]), np.insert(dof, 1, dof[0])
        scale = np.where(np.isin(names, ("radius_left_m", "radius_right_m", "track_m")), NOMINAL_STD * values, 0.0)
        covariance = spread @ covariance @ spread.T
        by_runs = np.diag(covariance).copy()
        covariance = covariance + np.outer(scale, scale)
        # the part that is taken for known adds no doubt about its own size (Welch and Satterthwaite)
        free = dof * np.square(np.diag(covariance) / by_runs)
    std = np.sqrt(np.diag(covariance))
    half = std * stdtrit(free, 0.975)
    rows = zip(names, nominal, values, std, half, dof, strict=True)
    estimates = tuple(
        Estimate(name, float(before), float(value), float(sd), (float(value - wide), float(value + wide)), float(own))
        for name, before, value, sd, wide, own in rows
    )
    return estimates, np.asarray(covariance)


def _whole(model: Model) -> Model:
    """Return the model of whole runs where many end poses are known, else of the longest windows.

    The end of one long recording says little: what heading noise has gathered by then is all that it shows.
    """
    many = int(np.isfinite(model.recording.end_pose[:, :2]).all(axis=1).sum()) >= ENOUGH_RUNS
    if many or model.segments.are_runs_of(model.recording):
        return Model(model.drive, model.recording, end_pose_segments(model.recording))
    return Model(model.drive, model.recording, model.segments.select(model.segments.level == 0))


def _outliers(model: Model, solution: Solution) -> tuple[str, ...]:
    """Return the runs that the noise cannot explain: by their end pose, or by most of their windows."""
    from scipy.special import chdtri

    size = np.maximum(model.segments.seen.sum(axis=1), 1)
    runs = np.unique(model.segments.run)
    beyond = solution.squares > chdtri(size, OUTLIER_CHANCE / len(runs))
    return tuple(str(model.recording.run_id[run]) for run in runs if beyond[model.segments.run == run].mean() > 0.5)


def _transfer(
    campaign: Campaign, whole: Geometry, sensor: bool, leave_out: str, progress: Progress
) -> tuple[Transfer, ...]:
    """Return the end position errors of runs left out in turn."""
    source = whole.source
    campaign = campaign.included()
    labels = campaign.runs.label(leave_out)
    rows = []
    for label in stepped(dict.fromkeys(labels), progress, "left out in turn"):
        away = labels == label
        rest, tried = recording_of(campaign.select(~away), source), recording_of(campaign.select(away), source)
        drive = drive_of(campaign, source, rest)
        fitted = _fit(campaign, drive, rest, next(_divisions(rest, cast(Using, whole.using))), sensor)
        model = Model(fitted.model.drive, tried, end_pose_segments(tried))
        errors = [
            float(np.sqrt(np.mean(np.square(model.predict(values).residuals[:, :2]).sum(axis=1))))
            for values in (fitted.parameters.nominal, fitted.solution.values)
        ]
        rows.append(Transfer(str(label), len(tried), errors[0], errors[1]))
    return tuple(rows)
