"""From a campaign to observations: runs, or windows of recordings, in the frames of their starts."""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from itertools import compress, pairwise
from typing import Any, Final

import numpy as np

from calib.campaign.checks import listed
from calib.campaign.checks.paths import lost_stretches_s
from calib.campaign.model import REFERENCE_POSE, Campaign
from calib.campaign.read import GYRO_SIGMA, GYRO_TURN, poses_are_in_a_map
from calib.campaign.settings import WHEEL_LOADS, OdometryModel, Reference
from calib.campaign.wheels import SLOWEST_RADPS, mecanum_model, odometry_source, on_one_axle, without_rear_wheels
from calib.errors import BadInputError, RefusedError
from calib.gap.observations import Observations, observation
from calib.gap.observations.assemble import assemble, filled_loads
from calib.gap.observations.observation import (
    CourseOverGround,
    Observation,
    ReferencePoses,
    Setup,
    log_rows,
    observation_from_log,
)
from calib.odometry.poses import poses_of_vehicle
from calib.odometry.routes import loads_in_steps
from calib.types import FloatArray, IntArray

#: fewer runs are cut into windows
MIN_WHOLE_RUNS: Final = 12
WINDOW_M: Final = 4.0
#: windows of all recordings
WINDOWS_WANTED: Final = 48
#: shortest window, in tracks
MIN_WINDOW_TRACKS: Final = 1.5
#: share of their mean, beyond which loads matter
LOADS_VARY: Final = 0.05
#: a millimetre's square is 1e-18 of this one's: double precision ends there
LONGEST_RUN_M: Final = 1e6
MIN_WINDOW_SAMPLES: Final = 4


def edges_along(way_m: FloatArray, count: float) -> IntArray:
    """Return samples that border windows of equal way, at most one a sample.

    `way_m`: (n_samples,), rising; `count`: windows wanted.
    """
    windows = max(int(count), 1) if count < len(way_m) else len(way_m)
    edges = np.unique(np.searchsorted(way_m, np.linspace(0.0, way_m[-1], windows + 1)))
    return np.asarray(np.minimum(edges, len(way_m) - 1), dtype=np.int64)


def cut(whole: Observation, setup: Setup, length_m: float, lost_s: FloatArray) -> list[Observation]:
    """Cut a recording into windows of about a length of rolling; empty if there is but one.

    Those that hold a time (n, 2) of `lost_s`, at which the reference does not follow the wheels, are omitted.
    A front wheel is kept if it drives the odometry, else compared over whole runs only, as a laser's distance is.
    """
    if (reference := whole.reference) is None:
        return []
    log = setup.campaign.logs.of(whole.run)
    edges = edges_along(reference.travelled_m, float(np.rint(reference.travelled_m[-1] / length_m)))
    rows, way, half_m = log_rows(log), reference.travelled_m, 0.0
    if isinstance(reference, CourseOverGround):
        # courses about a pose, none beside it: wheels that are off bend these
        half_m = 0.5 * reference.way_m
        ends = np.searchsorted(way, half_m), np.searchsorted(way, way[-1] - half_m, side="right") - 1
        edges = np.unique(np.clip(edges, *ends))
    lost_m = np.interp(lost_s, log["t_s"][reference.rows], way) + np.array([-half_m, half_m])
    windows: list[Observation] = []
    for number, (first, last) in enumerate(pairwise(edges.tolist())):
        if ((lost_m[:, 0] < way[last]) & (lost_m[:, 1] > way[first])).any():
            continue
        inside = rows[(rows >= reference.rows[first]) & (rows <= reference.rows[last])]
        if len(inside) < MIN_WINDOW_SAMPLES:
            continue
        unit = replace(observation_from_log(whole.run, log, inside, setup.per_rad), window=number)
        unit = unit if setup.stands_in else replace(unit, front_rad=None, steer_rad=None)
        windows.append(_between(unit, reference, first, last, setup.campaign.reference))
    return windows if len(windows) > 1 or len(lost_s) else []


def _between(unit: Observation, reference: ReferencePoses, first: int, last: int, settings: Reference) -> Observation:
    (start, start_sd, start_error), (end, end_sd, end_error) = reference.pose(first), reference.pose(last)
    measured = unit.measured.copy()
    measured[1:] = observation.relative_pose(start, end)
    if isinstance(reference, CourseOverGround):
        # a course is known up to whole turns
        turned = reference.by_wheels[last, 2] - reference.by_wheels[first, 2]
        measured[3] = turned + (measured[3] - turned + np.pi) % (2 * np.pi) - np.pi
    return replace(
        unit,
        measured=measured,
        sigma_xy_m=float(np.sqrt(2.0)) * settings.sigma_xy_m,
        sigma_theta_rad=settings.sigma_theta_rad if np.isnan(end_sd) else end_sd,
        sigma_start_rad=settings.sigma_theta_rad if np.isnan(start_sd) else start_sd,
        start_pose=start if reference.in_map else unit.start_pose,
        course_error=np.stack([start_error, end_error]),
    )


#: roll after the reference's last pose within which that is the end pose
END_TOLERANCE_M = 1e-3
#: runs like another one below which recordings are cut, too
MIN_REPLICATED = 8


def observations_of(
    campaign: Campaign,
    model: OdometryModel | None = None,
    *,
    into_windows: bool | None = None,
    without: Collection[tuple[str, int]] = (),
) -> Observations:
    """Arrange a campaign for the diagnosis; `model`: the simulator's, by default the campaign's own.

    Recordings with poses are cut into windows where runs are fewer than a dozen, or hardly any was driven twice, or by
    `into_windows`, but for those `without` (id of the run, number) or in which the reference was lost. Refused where no
    run has both counts and something measured.
    """
    setup = _setup(campaign, model)
    n_runs, samples = len(setup.campaign.runs), observation.MAX_STEPS + 1
    # thousands of small arrays would leave memory in holes
    room = np.empty((len(observation.ALONG_RUN), n_runs, samples))
    recorded = [_recorded(run, setup, room[:, run]) for run in range(n_runs)]
    with_counts = [run for run in recorded if run is not None]
    if into_windows is not None:
        return _arranged(with_counts, setup, without, into_windows=into_windows, share=3 * n_runs / WINDOWS_WANTED)
    few = len(recorded) < MIN_WHOLE_RUNS
    observations = _arranged(with_counts, setup, without, into_windows=few)
    sizes = np.bincount(observations.condition)
    repeated = int(sizes[sizes > 1].sum())
    if not few and any(run.reference is not None for run in with_counts) and repeated < MIN_REPLICATED:
        return _arranged(with_counts, setup, without, into_windows=True)
    return observations


def _setup(campaign: Campaign, model: OdometryModel | None) -> Setup:
    campaign = campaign.included()
    model = model or campaign.model
    stands_in = without_rear_wheels(campaign)
    if stands_in:
        if odometry_source(campaign) == "front":
            model = replace(model, slope_left_m_per_N=0.0, slope_right_m_per_N=0.0)
        elif odometry_source(campaign) == "wheels":
            # the axle that turns as the wheels of both sides do
            four = mecanum_model(campaign, model)
            model = replace(model, track_m=2.0 * four.arm_m, mecanum=four)
        campaign = on_one_axle(campaign, model)
    logs = campaign.logs
    for name, load in zip(WHEEL_LOADS, filled_loads(campaign)[:2], strict=True):
        if name in logs.columns:
            carried = loads_in_steps(load, logs.columns[name], logs.offsets)
            logs = replace(logs, columns={**logs.columns, name: carried})
    campaign = replace(campaign, logs=logs)
    encoder = campaign.encoder
    per_rev = np.array([encoder.counts_per_rev_left, encoder.counts_per_rev_right, encoder.front])
    return Setup(campaign, model, per_rev / (2 * np.pi), poses_are_in_a_map(campaign), stands_in)


def check_distances(campaign: Campaign, observations: Observations) -> None:
    """Raise BadInputError where runs are longer, or slower, than any vehicle's: units are wrong."""
    for travel_m in (observations.travel_left_m, observations.travel_right_m):
        distances_m = np.bincount(observations.unit, np.abs(travel_m), len(observations))
        number = int(np.argmax(distances_m))
        if not distances_m[number] <= LONGEST_RUN_M:
            raise BadInputError(
                f"{campaign.name}: run {observations.labels['run_id'][number]}: found counts of a distance of "
                f"{distances_m[number]:.3g} m; expected {LONGEST_RUN_M:.0e} m at most, beyond which rounding hides "
                "millimetres; check the counts of this run"
            )
    took_s = observations.duration_s[observations.from_log[observations.unit]].sum()
    way_m = 0.5 * (np.abs(observations.travel_left_m).sum() + np.abs(observations.travel_right_m).sum())
    if took_s * SLOWEST_RADPS * campaign.vehicle.wheel_radius_m > way_m:
        raise BadInputError(
            f"{campaign.name}: columns t_s, counts: found {took_s:.3g} s for {way_m:.3g} m; expected seconds (are they "
            "ms, us or ns?) and counts (are they radians, metres or increments?); convert them, then diagnose again"
        )


def with_known_loads(campaign: Campaign) -> tuple[Campaign, str]:
    """Return the campaign without runs of unknown load where measured ones vary, and a note.

    Taken as unladen they contradict any law. Of payloads alone none stated is none carried.
    """
    runs, logs = campaign.runs, campaign.logs
    loads_N = runs.number("load_left_N") + runs.number("load_right_N")
    for run, log in logs.each(1) if logs.columns.keys() >= set(WHEEL_LOADS) else ():
        if (carried := (log["load_left_N"] + log["load_right_N"])[np.isfinite(log["load_left_N"])]).size:
            loads_N[run] = carried.mean()
    used_N = loads_N[np.isfinite(loads_N) & ~runs.excluded]
    lacking = np.isnan(loads_N) & np.isnan(runs.number("payload_kg")) & ~runs.excluded
    varied = used_N.size and np.ptp(used_N) > LOADS_VARY * used_N.mean()
    if not lacking.any() or not varied or without_rear_wheels(campaign):
        return campaign, ""
    named = f" Omitted are {lacking.sum()} runs without wheel loads or a payload ({listed(runs.run_id[lacking])})"
    note = f"{named}, since the loads measured vary: state them, or payload_kg = 0 where unladen."
    return replace(campaign, runs=replace(runs, excluded=runs.excluded | lacking)), note


def measured_poses(campaign: Campaign, observations: Observations) -> Iterator[tuple[FloatArray, FloatArray] | None]:
    """Yield times since the start (n,) and reference poses of the vehicle (n, 3) of each observation, else None."""
    setup, starts_s = _setup(campaign, observations.model), observations.start_s
    known: tuple[int, ReferencePoses | None, FloatArray] = (-1, None, np.zeros(0))
    for number, run in enumerate(observations.run.tolist()):
        if known[0] != run:
            log = setup.campaign.logs.of(run)
            known = (run, observation.reference_poses(log, setup), log.get("t_s", np.zeros(0)))
        _, reference, time = known
        begin, end = starts_s[number], observations.time_s[observations.starts[number + 1] - 1]
        if reference is None or isinstance(reference, CourseOverGround):
            yield None
            continue
        times = time[reference.rows]
        inside = (times >= begin) & (times <= end)
        yield (times[inside] - begin, reference.poses[inside]) if inside.sum() > 1 else None


def _arranged(
    recorded: list[Observation],
    setup: Setup,
    without: Collection[tuple[str, int]],
    *,
    into_windows: bool,
    share: float = 1.0,
) -> Observations:
    campaign, references = setup.campaign, [run.reference for run in recorded if run.reference is not None]
    travelled_m = sum(float(each.travelled_m[-1]) for each in references)
    # of three windows one begins and ends on the move
    wanted_m = travelled_m / (WINDOWS_WANTED * max(share, 1.0))
    # many windows, long enough that wheels matter; beside noise longer ones tell more
    longest_m = max(WINDOW_M, observation.COURSE_SIGMAS * campaign.reference.sigma_xy_m)
    length_m = float(np.clip(wanted_m, min(MIN_WINDOW_TRACKS * setup.model.track_m, WINDOW_M), longest_m))
    ends = np.isfinite(campaign.runs.number("ref_x_m")) & setup.in_map
    units: list[Observation] = []
    n_cut = lacking = 0
    lost = lost_stretches_s(campaign) if into_windows else {}
    for run in recorded:
        windows = cut(run, setup, length_m, lost.get(run.run, np.zeros((0, 2)))) if into_windows else []
        n_cut += bool(windows)
        posed = windows if run.run in lost else windows or [_with_gyro(_with_log_pose(run, setup), setup)]
        run_id = str(campaign.runs.run_id[run.run])
        posed = [unit for unit in posed if (run_id, unit.window) not in without]
        lacking += sum(bool(ends[run.run] and np.isnan(unit.measured[1:]).all()) for unit in posed)
        units.extend(posed)
        if windows and not setup.stands_in:
            # front wheel and laser are compared over the whole
            units.append(replace(run, measured=np.append(run.measured[:1], np.full(3, np.nan))))
    notes = []
    if without_counts := len(campaign.runs) - len(recorded):
        notes.append(f"{without_counts} runs have no encoder counts and were omitted")
    if n_cut:
        notes.append(f"{n_cut} recordings with a continuous reference were cut into windows of about {length_m:.2g} m")
    if lost:
        notes.append(f"of {len(lost)} recordings windows are omitted in which the position does not follow the wheels")
    if any(isinstance(each, CourseOverGround) for each in references):
        taken = "headings are taken from the course over ground"
        notes.append(f"the reference measures positions without a heading: {taken}")
    if lacking:
        notes.append(
            f"{lacking} runs have an end pose in a map, which is not used: their logs lack ref_x_m, ref_y_m, "
            "ref_theta_rad where they begin"
        )
    units = [unit for unit in units if np.isfinite(unit.measured).any() or unit.front_rad is not None]
    if not units:
        raise RefusedError(
            f"{campaign.name}: no run has both encoder counts and a measured distance or end pose; "
            + "; ".join(["nothing can be said of a gap; measure distance_m or ref_x_m, ref_y_m, ref_theta_rad", *notes])
        )
    observations = assemble(setup, units, notes)
    read: list[bool] = np.asarray(observations.usable.any(axis=1)).tolist()
    return observations if all(read) or not any(read) else assemble(setup, list(compress(units, read)), notes)


def _recorded(run: int, setup: Setup, room: FloatArray) -> Observation | None:
    campaign, runs, per_rad = setup.campaign, setup.campaign.runs, setup.per_rad
    log = campaign.logs.of(run)
    rows = log_rows(log)
    logged = len(rows) >= 2
    from_row = observation.observation_from_row
    unit = observation_from_log(run, log, rows, per_rad) if logged else from_row(run, runs, per_rad)
    if unit is None:
        return None
    placed: dict[str, Any] = {}
    for name, place in zip(observation.ALONG_RUN, room, strict=True):
        if (values := getattr(unit, name)) is not None:
            placed[name] = place[: len(values)]
            placed[name][:] = values
    distance = runs.number("distance_m")[run]
    if np.isnan(distance) and "range_m" in log and np.isfinite(log["range_m"][-1]):
        distance = log["range_m"][-1]
    read = np.array([[runs.number(name)[run] for name in REFERENCE_POSE]])
    if setup.in_map:
        # an end pose in a map means nothing without the start, which the log alone has
        log = _with_end(log, read[0]) if campaign.reference.frame == "map" else log
        read[:] = np.nan
    pose = poses_of_vehicle(read, campaign.reference, in_map=False)[0]
    simulated = [runs.number(f"sim_{name}")[run] for name in ("distance_m", "x_m", "y_m", "theta_rad")]
    placed["reference"] = observation.reference_poses(log, setup) if logged else None
    return replace(unit, measured=np.array([distance, *pose]), simulated=np.array(simulated), **placed)


def _with_end(log: dict[str, FloatArray], end: FloatArray) -> dict[str, FloatArray]:
    if not set(REFERENCE_POSE) <= log.keys():
        return log
    poses = np.stack([log[name] for name in REFERENCE_POSE])
    if np.isfinite(poses).all(axis=0).sum() == 1:
        poses[:, log_rows(log)[-1:]] = end[:, None]
    return {**log, **dict(zip(REFERENCE_POSE, poses, strict=True))}


def _with_log_pose(unit: Observation, setup: Setup) -> Observation:
    reference = unit.reference
    if reference is None or not np.isnan(unit.measured[1:]).all():
        return unit
    log = setup.campaign.logs.of(unit.run)
    rows = log_rows(log)
    inside = rows[(rows >= (reference.rows[0] if reference.from_first else 0)) & (rows <= reference.rows[-1])]
    if len(inside) < len(rows) and _rolled_outside_m(log, rows, inside, setup) > END_TOLERANCE_M:
        part = observation_from_log(unit.run, log, inside, setup.per_rad)
        unit = replace(part, measured=np.full(4, np.nan))
    if reference.from_first:
        return _between(unit, reference, 0, len(reference.rows) - 1, setup.campaign.reference)
    return replace(unit, measured=np.concatenate([unit.measured[:1], reference.poses[-1]]))


def _with_gyro(unit: Observation, setup: Setup) -> Observation:
    runs = setup.campaign.runs
    turn, sigma = (float(runs.number(name)[unit.run]) for name in (GYRO_TURN, GYRO_SIGMA))
    if not (np.isnan(unit.measured[3]) and np.isfinite(turn)):
        return unit
    return replace(unit, measured=np.append(unit.measured[:3], turn), sigma_theta_rad=sigma, by_gyro=True)


def _rolled_outside_m(log: Mapping[str, FloatArray], rows: IntArray, inside: IntArray, setup: Setup) -> float:
    ends = [rows[0], inside[0], inside[-1], rows[-1]]
    sides = zip(("counts_left", "counts_right"), setup.per_rad, strict=False)
    rolled = [np.diff(log[name][ends])[::2] / scale for name, scale in sides]
    return float(np.abs(rolled).max() * setup.campaign.vehicle.wheel_radius_m)
