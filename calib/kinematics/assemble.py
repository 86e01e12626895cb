"""From a fit to the result: residuals by route, intervals and notes; intervals that planned runs promise."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from calib.campaign.read import GYRO_SIGMA
from calib.campaign.wheels import odometry_source
from calib.errors import BadInputError
from calib.kinematics.adequacy import judged
from calib.kinematics.blunders import Fault, factor_faults
from calib.kinematics.drives import GYRO_SCALE, GYRO_SCALE_STD, MeanHeld, first_scales
from calib.kinematics.joint_fit import NOMINAL_STD, Fitted, drive_of, fit_parameters
from calib.kinematics.model import Model, Segments, end_pose_segments
from calib.kinematics.recording import Recording, recording_of
from calib.kinematics.result import Channels, Estimate, Geometry, RouteResidual
from calib.kinematics.solve import COMPONENTS, Solution
from calib.kinematics.umbmark import Umbmark, umbmark
from calib.kinematics.uncertainty import ENOUGH_RUNS
from calib.types import FloatArray

if TYPE_CHECKING:
    from calib.campaign.model import Campaign


def route_table(
    recording: Recording, segments: Segments, before: FloatArray, after: FloatArray
) -> tuple[RouteResidual, ...]:
    """Return the residuals by kind of route; where no kind is given, by the sense of the turn.

    `before`, `after` (shape (n, 3)): residuals of the nominal and the calibrated vehicle.
    """
    kind = recording.kind[segments.run]
    if (kind == "").all():
        turn = segments.measured[:, 2]
        kind = np.where(turn > 1.0, "turns left", np.where(turn < -1.0, "turns right", "hardly turns"))
    rows = []
    for name in np.unique(kind):
        part = kind == name
        sizes = (Channels.rms(before[part]), Channels.rms(after[part]))
        rows.append(RouteResidual(str(name), int(part.sum()), *sizes, Channels(*after[part].mean(axis=0).tolist())))
    return tuple(rows)


def of_kinds(campaign: Campaign, kinds: Iterable[str]) -> Campaign:
    """Return the campaign with the runs of some kinds of routes; of all where none is named.

    `kinds`: labels in its column ``kind``. Raises BadInputError where no run has such a label.
    """
    wanted = set(kinds)
    if not wanted:
        return campaign
    kind = campaign.runs.label("kind")
    missing = wanted - set(kind)
    if missing:
        raise BadInputError(
            f"kinds: found {', '.join(sorted(missing))}; expected some of {', '.join(sorted(set(kind)))}; correct them"
        )
    return campaign.select(np.isin(kind, sorted(wanted)))


#: an outlier is a run that chance makes once in a hundred campaigns
OUTLIER_CHANCE: Final = 0.01


def geometry_of(campaign: Campaign, fitted: Fitted, source: str, using: str, faults: tuple[Fault, ...]) -> Geometry:
    """Return the result of a fit; for what it was made from see `calib.kinematics.estimate.estimate_geometry`."""
    parameters, solution, model = fitted.parameters, fitted.solution, fitted.model
    nominal, values = parameters.nominal, solution.values
    estimates, covariance = _estimates(fitted)
    nominal_of, value_of = ({e.name: getattr(e, kind) for e in estimates} for kind in ("nominal", "value"))
    faults = (*faults, *factor_faults(nominal_of, value_of))
    whole = _whole(model)
    before, after = replace(whole, recording=fitted.logged).predict(nominal), whole.predict(values)
    outliers = _outliers(model, solution)
    squares = (
        umbmark(before, after, whole.segments, campaign.model.track_m)
        if source == "rear" and len(whole.segments) and whole.segments.are_runs_of(whole.recording)
        else Umbmark(False, why="squares of a vehicle with two encoders on one axle are needed")
    )
    judgement = judged(campaign, fitted, whole, faults, outliers)
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
        undetermined=_undetermined(fitted),
        held={name: float(nominal[at]) for at, name in enumerate(parameters.names) if not parameters.free[at]},
        clusters=(fitted.clustering.name, fitted.clustering.uncertainty.clusters),
        noise=dict(zip(COMPONENTS, np.sqrt(solution.scales).tolist(), strict=True)),
        residual_rms=Channels.rms(after.residuals),
        outliers=outliers,
        faults=judgement.faults,
        mirrored=any(fault.code in {"reversed_front", "reversed_steering", "reversed_both"} for fault in faults),
        umbmark=squares,
        routes=route_table(model.recording, whole.segments, before.residuals, after.residuals),
        notes=_notes(fitted),
        inputs=campaign.hashes,
        judgement=judgement,
    )


def _estimates(fitted: Fitted) -> tuple[tuple[Estimate, ...], FloatArray]:
    """Return the estimates and their covariance; where the mean radius is held, both radii are among them."""
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
    if _gyro_alone(fitted) and "track_m" in names:
        # a turn that the gyro measures by 1 % too much is a track that is 1 % too short
        at, by_runs = names.index("track_m"), np.diag(covariance).copy()
        covariance = covariance.copy()
        covariance[at, at] += (GYRO_SCALE_STD * values[at]) ** 2
        free = free * np.square(np.diag(covariance) / by_runs)
    std = np.sqrt(np.diag(covariance))
    half = std * stdtrit(free, 0.975)
    rows = zip(names, nominal, values, std, half, dof, strict=True)
    estimates = tuple(
        Estimate(name, float(before), float(value), float(sd), (float(value - wide), float(value + wide)), float(own))
        for name, before, value, sd, wide, own in rows
    )
    return estimates, np.asarray(covariance)


def _undetermined(fitted: Fitted) -> tuple[str, ...]:
    return (*fitted.dropped, *(("mean_radius_m",) if isinstance(fitted.model.drive, MeanHeld) else ()))


def _gyro_alone(fitted: Fitted) -> bool:
    """Return whether a gyro of undetermined scale alone measured the turns."""
    return bool(fitted.model.segments.gyro.any()) and GYRO_SCALE in fitted.dropped


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


def _notes(fitted: Fitted) -> tuple[str, ...]:
    """Return notes on the estimates, in sentences."""
    recording, clustering = fitted.model.recording, fitted.clustering
    notes = []
    name, n = clustering.name, clustering.uncertainty.clusters
    if name in {"session", "route"}:
        notes.append(
            f"Runs of one {name} pull the parameters alike: the intervals take the {n} {name}s, not single runs, for "
            "independent. What they share is no noise; 'calib diagnose' looks for its cause."
        )
    if isinstance(fitted.model.drive, MeanHeld):
        positions = fitted.model.segments.seen[:, :2].any()
        what = "These paths close, or nearly so, at any scale" if positions else "Headings alone hold at any scale"
        notes.append(
            f"{what}: the mean radius is not determined and was held at its "
            f"nominal value within {100 * NOMINAL_STD:g} %. The ratio of the radii and the track over the mean radius "
            "are determined; a straight run of known length would determine the scale."
        )
    if _gyro_alone(fitted):
        notes.append(
            f"Turns rest on the gyro: its scale is not determined, and its {100 * GYRO_SCALE_STD:g} % are in the "
            "interval of the track. A closed loop, or a turn of known angle, tells the two apart."
        )
    if not fitted.solution.converged:
        notes.append("The search did not settle exactly; the values are good to a small part of their sd.")
    if recording.left_out:
        first = recording.left_out[0]
        notes.append(f"Held out: {len(recording.left_out)} runs; the first, {first[0]}: {first[1]}.")
    return tuple(notes)


@dataclass(frozen=True, slots=True, eq=False)
class Promise:
    """What `calib geometry` will state of some runs, if the noise is as assumed: the information of their design."""

    estimates: tuple[Estimate, ...]  #: at the nominal values
    undetermined: tuple[str, ...]  #: parameters that the runs leave open
    scales: FloatArray  #: variances of the noise's components, shape (4,)

    def to_dict(self) -> dict[str, Any]:
        """Return standard deviation and half width of the 95 % interval of each parameter, as plain JSON values."""
        parameters = {each.name: {"sd": each.std, "half_width95": each.half_width} for each in self.estimates}
        return {"parameters": parameters, "undetermined": list(self.undetermined)}


def promised(campaign: Campaign, scales: FloatArray | None = None, driven: Campaign | None = None) -> Promise:
    """Return what the end poses of planned runs will tell of the geometry (Fisher information).

    The runs are driven as the model says; driven ones may be among them. `scales`, shape (4,), are variances of the
    components of the noise: by default the stated sigmas and small random walks. Runs of `driven` show the random
    walks.

    Raises RefusedError where no run has wheels and a reference, or nothing can be determined.
    """
    if scales is None:
        scales = first_scales(campaign.reference)
        sigma = campaign.runs.number(GYRO_SIGMA)
        if np.isfinite(sigma).any():
            scales[1] = np.nanmedian(sigma) ** 2
        if driven is not None:
            scales[2:] = _of_end_poses(driven).solution.scales[2:]
    fitted = _of_end_poses(campaign, scales)
    return Promise(_estimates(fitted)[0], _undetermined(fitted), scales)


def _of_end_poses(campaign: Campaign, known: FloatArray | None = None) -> Fitted:
    source = odometry_source(campaign)
    recording = recording_of(campaign, source)
    drive, segments = drive_of(campaign, source, recording), end_pose_segments(recording)
    return fit_parameters(campaign, drive, recording, segments, sensor=False, known=known)
