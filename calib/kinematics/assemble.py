"""From a fit to the result; the intervals that planned runs promise.

UMBmark: radii and track from the mean end position errors of squares driven both ways (Borenstein and Feng, IEEE T-RA
12, 1996).
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from scipy.special import chdtri

from calib.campaign.check import swapped_sessions
from calib.campaign.checks.counts import interrupted_counts
from calib.campaign.checks.measurements import implausible_loads
from calib.campaign.model import Campaign
from calib.campaign.read import GYRO_SIGMA
from calib.campaign.settings import Reference
from calib.campaign.wheels import odometry_source
from calib.errors import BadInputError
from calib.kinematics import Recording, recording_of
from calib.kinematics.adequacy import LENGTHS_ALONE, OUTLIER_CHANCE, bad_windows, judged
from calib.kinematics.blunders import Fault, corrected, of_gyro, still_counters
from calib.kinematics.departures import noise_sizes
from calib.kinematics.drives import GYRO_SCALE, GYRO_SCALE_STD, NOMINAL_STD, SENSOR, Drive, first_scales, parameters_of
from calib.kinematics.joint_fit import LONGEST_STEP_S, MEAN_RADIUS, Fitted, drive_of, fit_parameters
from calib.kinematics.model import Model, Prediction, Segments, end_pose_segments, window_segments
from calib.kinematics.readings import factor_faults
from calib.kinematics.result import Channels, Estimate, Geometry, RouteResidual, RunTrace, Umbmark
from calib.kinematics.solve import COMPONENTS, Solution
from calib.kinematics.uncertainty import ENOUGH_RUNS, FEWEST_CLUSTERS, Freedom
from calib.types import BoolArray, FloatArray, IntArray, in_frame


def _route_table(
    recording: Recording, segments: Segments, before: FloatArray, after: FloatArray
) -> tuple[RouteResidual, ...]:
    kind = recording.kind[segments.run]
    if (kind == "").all():
        turn = segments.measured[:, 2]
        kind = np.where(turn > 1.0, "turns left", np.where(turn < -1.0, "turns right", "hardly turns"))
    parts = ((str(name), before[kind == name], after[kind == name]) for name in np.unique(kind))
    rows = ((name, len(new), Channels.rms(old), Channels.rms(new), Channels.mean(new)) for name, old, new in parts)
    return tuple(RouteResidual(*row) for row in rows)


def of_kinds(campaign: Campaign, kinds: Iterable[str]) -> Campaign:
    """Return the campaign with the runs of some kinds, labels in its column ``kind``; all where none is named.

    Raises BadInputError where no run has such a label.
    """
    wanted, kind = set(kinds), campaign.runs.label("kind")
    if not wanted:
        return campaign
    if missing := wanted - set(kind):
        text = f"kinds: found {', '.join(sorted(missing))}"
        raise BadInputError(f"{text}; expected some of {', '.join(sorted(set(kind)))}; correct them")
    return campaign.select(np.isin(kind, sorted(wanted)))


#: no run is driven slower: a metre takes a quarter of an hour
SLOWEST_MPS: Final = 1e-3


def geometry_of(campaign: Campaign, fitted: Fitted, source: str, using: str, faults: tuple[Fault, ...]) -> Geometry:
    """Return the result of a fit; see `calib.kinematics.estimate.estimate_geometry`."""
    parameters, solution, model = fitted.parameters, fitted.solution, fitted.model
    nominal, values = parameters.nominal, solution.values
    estimates, covariance, freedom = _estimates(fitted)
    stated = {estimate.name for estimate in estimates}
    ratios = {e.name: e.value / e.nominal for e in estimates if e.nominal}
    faults = (*faults, *factor_faults(ratios, campaign.vehicle.drive, model.recording.speeds))
    if source == "rear":
        faults = (*faults, *still_counters(model.recording, model.motion(values).body[2]))
    by_load = any(name.startswith("slope") for name in stated)
    of_loads = [note for note in implausible_loads(campaign) if note.level == "wrong"] if by_load else []
    shown = {"counts_lost": interrupted_counts(campaign), "loads_implausible": of_loads}
    shown["swapped_wheels"] = swapped_sessions(campaign)
    told = ((code, note.sentence.rstrip(".")) for code, notes in shown.items() for note in notes)
    faults = (*faults, *(Fault(*each, seen=True) for each in told))
    whole = _whole(model)
    before, after = replace(whole, recording=fitted.logged).predict(nominal), whole.predict(values)
    left = np.where(seen := whole.segments.seen, after.residuals, np.nan)
    outliers = _outliers(model, solution)
    off = np.isin(model.recording.run_id, outliers)[whole.segments.run]
    good = replace(whole.segments, seen=whole.segments.seen & ~off[:, None])
    squares = (
        umbmark(before, after, good, campaign.model.track_m)
        if source == "rear" and len(whole.segments) and whole.segments.are_runs_of(whole.recording)
        else Umbmark(False, why="squares of a vehicle with two encoders on one axle are needed")
    )
    if model.recording.by_gyro.any():
        faults = tuple(map(of_gyro, faults))
    judgement = judged(campaign, fitted, whole, faults, outliers)
    noise, expected = noise_sizes(fitted, first_scales(campaign.reference))
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
        freedom=freedom,
        undetermined=fitted.undetermined,
        held={name: float(value) for name, value in zip(parameters.names, values, strict=True) if name not in stated},
        clusters=(fitted.uncertainty.by, fitted.uncertainty.clusters),
        noise=noise,
        noise_expected=expected,
        residual_rms=Channels.rms(left),
        outliers=outliers,
        faults=judgement.faults,
        mirrored=any(fault.code in {"reversed_front", "reversed_steering", "reversed_both"} for fault in faults),
        umbmark=squares,
        routes=_route_table(model.recording, whole.segments, np.where(seen, before.residuals, np.nan), left),
        notes=tuple(_notes(fitted, whole, campaign.vehicle.drive)),
        inputs=campaign.hashes,
        judgement=judgement,
    )


def _estimates(fitted: Fitted) -> tuple[tuple[Estimate, ...], FloatArray, Freedom | None]:
    parameters, uncertainty = fitted.parameters, fitted.uncertainty
    kept = np.flatnonzero(~np.isin(parameters.free_names, fitted.undetermined))
    index = np.flatnonzero(parameters.free)[kept]
    sizes = parameters.nominal[index], fitted.solution.values[index], uncertainty.std[kept]
    columns = (part.tolist() for part in (*sizes, uncertainty.free[kept]))
    names = [parameters.names[at] for at in index]
    freedom = uncertainty.freedom and uncertainty.freedom.select(kept)
    return tuple(map(Estimate.of, names, *columns)), uncertainty.covariance[np.ix_(kept, kept)], freedom


def _whole(model: Model) -> Model:
    known = np.isfinite(model.recording.end_pose[:, :2]).all(axis=1)
    if known.sum() >= ENOUGH_RUNS or model.segments.are_runs_of(model.recording):
        return replace(model, segments=end_pose_segments(model.recording))
    return replace(model, segments=model.segments.select(model.segments.level == 0))


def _outliers(model: Model, solution: Solution) -> tuple[str, ...]:
    size = np.maximum(model.segments.seen.sum(axis=1), 1)
    runs = np.unique(model.segments.run)
    beyond = solution.squares > chdtri(size, OUTLIER_CHANCE / len(runs))
    return tuple(str(model.recording.run_id[run]) for run in runs if beyond[model.segments.run == run].mean() > 0.5)


def _notes(fitted: Fitted, whole: Model, kind: str) -> Iterator[str]:
    recording, name, n = fitted.model.recording, fitted.uncertainty.by, fitted.uncertainty.clusters
    if name in {"session", "route"}:
        yield (
            f"Runs of one {name} pull the parameters alike: the intervals take the {n} {name}s, not single runs, for "
            "independent. What they share is no noise; 'calib diagnose' looks for its cause."
        )
    elif (n := len(np.unique(recording.routes))) < FEWEST_CLUSTERS:
        of = "one route" if n == 1 else f"{n} routes"
        yield f"The intervals are of {of}: what routes differ by is not in them; drive {FEWEST_CLUSTERS} or more."
    lengths = {"radius_left_m", "radius_right_m", "track_m"}
    if MEAN_RADIUS in fitted.undetermined and not lengths & set(fitted.undetermined):
        positions = fitted.model.segments.seen[:, :2].any()
        what = "These paths close, or nearly so, at any scale" if positions else "Headings alone hold at any scale"
        yield (
            f"{what}: the mean radius is not determined and was held at its "
            f"nominal value within {100 * NOMINAL_STD:g} %. The ratio of the radii and the track over the mean radius "
            "are determined; a straight run of known length would determine the scale."
        )
    if held := {"front_radius_m", "rear_radius_m", "wheel_radius_m"}.intersection(fitted.undetermined):
        yield f"{min(held)} is held at its nominal value: a straight run of known length would determine the scale."
    if kind == "skid" and "track_m" in fitted.parameters.free_names:
        yield "The track_m of a skid-steered vehicle is its effective track: it holds for this floor and load."
    if fitted.model.segments.gyro.any() and GYRO_SCALE in fitted.undetermined:
        yield (
            f"Turns rest on the gyro: its scale is not determined, and its {100 * GYRO_SCALE_STD:g} % are in the "
            "interval of the track. A closed loop, or a turn of known angle, tells the two apart."
        )
    ends, radii = recording.offsets[1:] - 1, [row.nominal for row in fitted.parameters.items if "radius" in row.name]
    took_s = float(recording.t_s[ends].sum())
    if (mps := float(recording.travel_rad[ends].sum()) * radii[0] / max(took_s, 1e-9)) < SLOWEST_MPS:
        yield (
            f"Times (t_s) make {1e3 * mps:.2g} mm/s on average, samples {took_s / len(recording.t_s):.2g} s apart: ms, "
            "or us, taken for s? Radii and track hold all the same; a delay of the reference needs right times."
        )
    if n_bad := int(bad_windows(fitted, whole).sum()):
        yield f"{n_bad} of {len(whole.segments)} windows are outliers, down-weighted: single poses are off."
    step_s = float(np.median(np.diff(recording.t_s)))
    if SENSOR[-1] in fitted.undetermined and step_s > LONGEST_STEP_S:
        yield f"Samples are {step_s:.2g} s apart: too coarse for a delay of the reference, which is taken for 0."
    if not fitted.solution.converged:
        yield "The search did not settle exactly; the values are good to a small part of their sd."
    if recording.left_out:
        yield f"Omitted: {len(recording.left_out)} runs; the first, {': '.join(recording.left_out[0])}."


@dataclass(frozen=True, slots=True, eq=False)
class Promise:
    """What `calib geometry` states of some runs, or will if the noise is as assumed."""

    estimates: tuple[Estimate, ...]  #: of planned runs at the nominal values
    undetermined: tuple[str, ...]  #: parameters that the runs leave open
    scales: FloatArray  #: variances of the noise's components, shape (4,)

    @classmethod
    def of(cls, geometry: Geometry) -> "Promise":
        """Return what a geometry's runs gave; noise that they do not show is assumed."""
        scales = np.square([geometry.noise[name] for name in COMPONENTS])
        if any(LENGTHS_ALONE in why for why in geometry.why):
            scales[1:3] = first_scales(Reference())[1:3]
        return cls(geometry.estimates, geometry.undetermined, scales)

    def after(self, driven: "Promise", design: "Promise") -> "Promise":
        """Return the promise from what the runs driven gave, `driven`, beside that of these alone, `design`."""
        own, before = ({row.name: row for row in one.estimates} for one in (driven, design))

        def scaled(row: Estimate) -> Estimate:
            if row.name not in own.keys() & before.keys():
                return row
            actual, alone = own[row.name], before[row.name]
            part, beside = (row.std / alone.std) ** 2, max((actual.std / alone.std) ** 2, 1.0)
            std = actual.std * float(np.sqrt(part * (part + (1.0 - part) / beside)))
            return Estimate.of(row.name, row.nominal, row.value, std, max(actual.dof * row.dof / alone.dof, 1.0))

        return replace(self, estimates=tuple(map(scaled, self.estimates)))

    def to_dict(self) -> dict[str, Any]:
        """Return each parameter's standard deviation and half 95 % interval, as plain JSON values."""
        parameters = {each.name: {"sd": each.std, "half_width95": each.half_width} for each in self.estimates}
        return {"parameters": parameters, "undetermined": list(self.undetermined)}


def promised(campaign: Campaign, scales: FloatArray | None = None) -> Promise:
    """Return what the end poses of planned runs will tell of the geometry (Fisher information).

    `scales` (4,): variances of the noise's components; None: the stated sigmas, and small random walks.
    """
    if scales is None:
        scales, sigma = first_scales(campaign.reference), campaign.runs.number(GYRO_SIGMA)
        if np.isfinite(sigma).any():
            scales[1] = np.nanmedian(sigma) ** 2
    source = odometry_source(campaign)
    recording = recording_of(campaign, source, planned=True)
    drive, segments = drive_of(campaign, source, recording), end_pose_segments(recording)
    fitted = fit_parameters(campaign, drive, recording, segments, sensor=False, known=scales)
    return Promise(_estimates(fitted)[0], fitted.undetermined, scales)


#: how far a piece of the way may point from its side's direction
SIDE_RAD: Final = 0.35
#: share of the way that belongs to sides, and of the shortest side beside the mean one
SIDES_SHARE: Final = 0.8
SHORTEST_SIDE: Final = 0.7
#: of each sense, for a scatter
FEWEST_SQUARES: Final = 2


def squares(prediction: Prediction, segments: Segments) -> tuple[FloatArray, BoolArray, FloatArray]:
    """Return the mean side of each stretch that is a square, else NaN, and whether it is counter-clockwise.

    Third: share of its way along four sides at right angles; 0 where it does not turn round once.
    """
    side, left = np.full(len(segments), np.nan), np.zeros(len(segments), dtype=np.bool_)
    share = np.zeros(len(segments))
    for at, (first, last) in enumerate(zip(segments.first, segments.last, strict=True)):
        x, y, theta = prediction.path.pose[:, first : last + 1]
        theta, step = theta - theta[0], np.hypot(np.diff(x), np.diff(y))
        turn = float(theta[-1])
        if not 1.4 * np.pi < abs(turn) < 2.1 * np.pi or step.sum() <= 0.0:
            continue
        quarter = 0.5 * (theta[1:] + theta[:-1]) * np.sign(turn) / (0.5 * np.pi)
        number = np.rint(quarter)
        near = (np.abs(quarter - number) * 0.5 * np.pi < SIDE_RAD) & (number >= 0) & (number <= 3)
        lengths = np.bincount(number[near].astype(np.int64), step[near], minlength=4)
        share[at] = lengths.sum() / step.sum()
        if share[at] > SIDES_SHARE and lengths.min() > SHORTEST_SIDE * lengths.mean():
            side[at], left[at] = step.sum() / 4.0, turn > 0.0
    return side, left, share


def umbmark(prediction: Prediction, calibrated: Prediction, segments: Segments, track_m: float) -> Umbmark:
    """Return what the squares among whole runs say.

    `prediction`: of the nominal vehicle; `calibrated`: tells which runs are squares; `track_m`: nominal.
    """
    side, left, share = squares(calibrated, segments)
    square = np.isfinite(side) & segments.seen[:, :2].all(axis=1)
    n_ccw, n_cw = int((square & left).sum()), int((square & ~left).sum())
    if not n_ccw or not n_cw:
        missing = "squares" if n_ccw == n_cw else "clockwise squares" if not n_cw else "counter-clockwise squares"
        why = f"no {missing} among the runs"
        if 0.0 < (most := float(share[~square].max(initial=0.0))) <= SIDES_SHARE:
            why += f": straight sides are {100 * most:.0f} % of the way round, of a square {100 * SIDES_SHARE:.0f} %"
        return Umbmark(False, n_cw=n_cw, n_ccw=n_ccw, why=why)
    from scipy.linalg import block_diag

    error = prediction.residuals[:, :2]
    side_m = float(np.mean(side[square]))
    both = [error[square & left], error[square & ~left]]
    centres = np.stack([part.mean(axis=0) for part in both])
    ratios = _ratios(centres, side_m, track_m)
    std = np.full(2, np.nan)
    if min(n_ccw, n_cw) >= FEWEST_SQUARES:
        step = 1e-6 * np.eye(4).reshape(4, 2, 2)
        slopes = np.array([np.subtract(_ratios(centres + d, side_m, track_m), ratios) for d in step]) / 1e-6
        spread = block_diag(*(np.cov(part.T) / len(part) for part in both))
        std = np.sqrt(np.diag(slopes.T @ spread @ slopes))
    E_d, E_b = ratios
    factors = 2.0 / (E_d + 1.0), 2.0 / (1.0 / E_d + 1.0)
    return Umbmark(True, E_d, E_b, *factors, float(std[0]), float(std[1]), side_m, n_cw, n_ccw)


def _ratios(centres: FloatArray, side_m: float, track_m: float) -> tuple[float, float]:
    (x_ccw, y_ccw), (x_cw, y_cw) = centres
    alpha = 0.5 * ((x_cw + x_ccw) + (y_cw - y_ccw)) / (4.0 * side_m)
    beta = 0.5 * ((x_ccw - x_cw) - (y_ccw + y_cw)) / (4.0 * side_m)
    half = track_m * np.sin(0.5 * beta) / side_m
    return float((1.0 + half) / (1.0 - half)), float(0.5 * np.pi / (0.5 * np.pi + alpha))


#: blocks for windows of a few long recordings, coarse to fine
BLOCKS: Final = (40, 160, 640)


def divisions(recording: Recording, using: str) -> Iterator[Segments]:
    """Yield whole runs (``end_poses``), or ever finer windows, first a block a run where they are many."""
    if using == "end_poses":
        yield end_pose_segments(recording)
        return
    before = 0
    for blocks in (len(recording), *BLOCKS) if len(recording) >= ENOUGH_RUNS else BLOCKS:
        segments = window_segments(recording, blocks)
        count = len(np.unique(segments.block))
        if count > before:
            yield segments
        before = count


def traces_of(campaign: Campaign, geometry: Geometry) -> tuple[RunTrace, ...]:
    """Return paths and residuals of runs by the nominal and the calibrated vehicle."""
    source, recording = geometry.source, recording_of(campaign, geometry.source)
    coarse = next(divisions(recording, geometry.using))
    recording, _ = corrected(recording, coarse, source, drive_of(campaign, source, recording))
    drive = drive_of(campaign, source, recording)
    nominal = {item.name: item.nominal for item in parameters_of(drive, campaign.reference)}
    values = geometry.values | {GYRO_SCALE: 1.0}
    calibrated = np.array([values.get(name, value) for name, value in nominal.items()])
    own_delay = {delay.label: delay.value_s - calibrated[-1] for delay in geometry.delays}
    labels = zip(recording.run_id, recording.session, strict=True)
    added = np.array([next((own_delay[name] for name in pair if name in own_delay), 0.0) for pair in labels])
    before = _sensor_paths(drive, recording, np.array([*nominal.values()]))
    after = _sensor_paths(drive, replace(recording, own_delay_s=added), calibrated)
    return tuple(_trace(recording, run, [before, after]) for run in range(len(recording)))


def _sensor_paths(drive: Drive, recording: Recording, values: FloatArray) -> FloatArray:
    run, n = recording.run, len(recording.t_s)
    seen, no_gyro = np.ones((n, 3), dtype=np.bool_), np.zeros(n, dtype=np.bool_)
    segments = Segments(run, recording.offsets[run], np.arange(n), np.zeros((n, 3)), seen, run, 0 * run, no_gyro)
    return -Model(drive, recording, segments).residuals(values).T


def _trace(recording: Recording, run: int, paths: list[FloatArray]) -> RunTrace:
    part = slice(int(recording.offsets[run]), int(recording.offsets[run + 1]))
    reference = recording.reference[:, part]
    seen = np.flatnonzero(np.isfinite(reference).any(axis=0)).astype(np.int64)
    before, after = paths = [path[:, part] for path in paths]
    if len(seen) > 1:
        measured = _aligned(reference[:, seen], after[:, seen], np.arange(len(seen)))
        aligned = [_aligned(before, measured, seen), after]
    else:
        seen = np.array([reference.shape[1] - 1], dtype=np.int64)
        measured, aligned = recording.end_pose[run][:, None], paths
    residuals = [in_frame(measured - path[:, seen], path[2, seen]) for path in aligned]
    names = str(recording.run_id[run]), str(recording.kind[run])
    before_m, after_m = (path[:2].T for path in aligned)
    return RunTrace(*names, before_m, after_m, seen, recording.t_s[part][seen], measured[:2].T, *residuals)


def _aligned(path: FloatArray, onto: FloatArray, seen: IntArray) -> FloatArray:
    good = np.isfinite(path[:2, seen]).all(axis=0) & np.isfinite(onto[:2]).all(axis=0)
    if good.sum() < 2:
        turn = float(np.nanmean(onto[2] - path[2, seen]))
        return np.asarray(path + np.array([0.0, 0.0, turn])[:, None])
    own, other = path[:2, seen][:, good], onto[:2, good]
    own_mean, other_mean = own.mean(axis=1), other.mean(axis=1)
    a, b = own - own_mean[:, None], other - other_mean[:, None]
    turn = float(np.arctan2(np.sum(a[0] * b[1] - a[1] * b[0]), np.sum(a * b)))
    apart = onto[2] - path[2, seen]
    if np.isfinite(apart).any():
        turn += 2.0 * np.pi * float(np.rint((np.nanmedian(apart) - turn) / (2.0 * np.pi)))
    cosine, sine = np.cos(turn), np.sin(turn)
    place = np.array([[cosine, -sine], [sine, cosine]]) @ (path[:2] - own_mean[:, None]) + other_mean[:, None]
    return np.concatenate([place, path[2:] + turn])
