"""Logged runs replayed through odometry, against their reference poses; the runtime is fed the same logs."""

from collections import Counter
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import ArrayLike

from calib.campaign import checks
from calib.campaign.checks import counts, measurements, settings
from calib.campaign.model import REFERENCE_POSE, Campaign
from calib.campaign.read import poses_are_in_a_map
from calib.campaign.settings import WHEEL_LOADS, OdometryModel
from calib.campaign.wheels import ASIDE, counted_source, logged_columns, on_one_axle, without_rear_wheels
from calib.coefficients.file import CoefficientFile, believed_model
from calib.documents import Result, plain
from calib.errors import RefusedError
from calib.odometry import end_poses, integrate
from calib.odometry.poses import PoseErrors, Poses, pose_errors, poses_of_vehicle
from calib.odometry.routes import loads_in_steps, radii_of_model, radii_under_load, travel_from_counts
from calib.radius.law import RadiusLaw, within_law
from calib.runtime import Coefficients, Odometer, OdometerFault, Status
from calib.types import BoolArray, FloatArray, StrArray, in_frame, since_start, unwrapped
from calib.vehicle import wheel_loads_N

if TYPE_CHECKING:
    from pandas import DataFrame


#: as the simulator believes; by the law unladen; by the law at the load of each run, or step (Fig. 7)
METHODS = ("model", "constant", "corrected")

#: ends so many standard deviations off are no chance: fewest runs, and least share
FAR_SD, FAR_RUNS, FAR_SHARE = 3.0, 3, 0.1
#: of the bootstrap over runs
RESAMPLES: Final = 2000


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Replay(Result):
    """End poses of logged runs by each odometry of `METHODS`, against the reference."""

    campaign: str
    simulated: bool
    #: shape (n,): runs with a log and a reference end pose
    run_id: StrArray
    kind: StrArray
    #: shape (n,): wheel loads, unless logged
    load_left_N: FloatArray
    load_right_N: FloatArray
    distance_m: FloatArray  #: shape (n,): driven by the reference law
    reference: Poses  #: reference end poses, shape (n,)
    ends: dict[str, Poses]
    errors: dict[str, PoseErrors]  #: odometry minus reference
    in_range: BoolArray  #: shape (n,): whether the law was measured at all its loads
    #: rms end error of position and heading over the runs in range
    rms_m: dict[str, float]
    rms_heading_rad: dict[str, float]
    #: rms of the constant radii over that of the corrected ones, bootstrapped over runs
    ratio: float
    ratio_ci95: tuple[float, float]
    runtime: "RuntimeCheck"  #: the vehicle's own code on the same logs
    left_out: dict[str, int]  #: runs that could not be compared, by reason
    #: whether other wheels drive the odometry: ``constant`` is ``corrected``, the runtime not fed
    by_geometry: bool = False
    notes: tuple[str, ...] = ()

    @property
    def table(self) -> "DataFrame":
        """End errors of the runs by each odometry; SI units."""
        from pandas import DataFrame

        return DataFrame(self.to_dict()["runs"])

    def to_dict(self) -> dict[str, Any]:
        """Return the replay as plain values, as ``calib simulate replay --json``.

        The runtime's differences are null without a sample to compare.
        """
        names = ("run_id", "kind", "load_left_N", "load_right_N", "in_range", "distance_m")
        columns = {name: getattr(self, name) for name in names}
        for method in METHODS:
            for name in ("along_m", "lateral_m", "heading_rad", "distance_m"):
                columns[f"{method}_{name}"] = getattr(self.errors[method], name)
        rows = zip(*(column.tolist() for column in columns.values()), strict=True)
        written = ("campaign", "simulated", "rms_m", "rms_heading_rad", "ratio", "ratio_ci95", "runtime", "left_out")
        document = {name: plain(getattr(self, name)) for name in written}
        return document | {"runs": [dict(zip(columns, row, strict=True)) for row in rows]}


def replay(
    campaign: Campaign,
    coefficients: CoefficientFile,
    *,
    rng: np.random.Generator,
    scheme: str = "exact",
    runtime_runs: int = 20,
) -> Replay:
    """Replay the logged runs of a campaign; for schemes see `calib.odometry.SCHEMES`.

    `runtime_runs`: fed to the runtime. Raises RefusedError where no run has a log, a reference end pose, valid loads.
    """
    coefficients.refuse_other_vehicle(campaign)
    chosen, left_out, notes = _usable(campaign, coefficients.law)
    if not len(chosen.runs):
        reasons = ", ".join(f"{count} {reason}" for reason, count in left_out.items() if count) or "no runs"
        raise RefusedError(
            f"{campaign.name}: no run can be replayed ({reasons}); expected runs with a log, a reference end pose and "
            "wheel loads; log counts and ref_x_m, ref_y_m, ref_theta_rad, in a map at both ends"
        )
    law, runs, logs = coefficients.law, chosen.runs, chosen.logs
    carried = carried_loads_N(chosen)
    by_geometry = without_rear_wheels(chosen)
    read = np.stack([runs.number(name) for name in REFERENCE_POSE], axis=1)
    reference = Poses.from_stacked(poses_of_vehicle(read, coefficients.sensor(chosen.reference), in_map=False))
    ends, travelled = _driven(chosen, coefficients, carried, scheme)
    errors = {method: pose_errors(end, reference) for method, end in ends.items()}
    in_range = np.logical_and.reduceat(within_law(law, *carried) | by_geometry, logs.offsets[:-1])
    if not in_range.any():
        text = f"{campaign.name}: no run's wheel loads lie within the range that the law was measured in"
        raise RefusedError(f"{text}; give coefficients that were measured under these loads")
    square = {method: errors[method].distance_m[in_range] ** 2 for method in METHODS}
    picks = rng.integers(0, in_range.sum(), size=(RESAMPLES, int(in_range.sum())))
    means = {method: square[method][picks].mean(axis=1) for method in ("constant", "corrected")}
    low, high = np.quantile(np.sqrt(means["constant"] / np.maximum(means["corrected"], 1e-300)), [0.025, 0.975])
    rms = {method: float(np.sqrt(part.mean())) for method, part in square.items()}
    fed, along_std_m = _fed_runs(chosen, coefficients, runtime_runs)
    along = errors["corrected"].along_m / np.where(in_range, along_std_m, np.nan)
    return Replay(
        campaign=campaign.name,
        simulated=campaign.simulated,
        run_id=runs.run_id,
        kind=runs.label("kind"),
        load_left_N=runs.number("load_left_N"),
        load_right_N=runs.number("load_right_N"),
        distance_m=travelled,
        reference=reference,
        ends=ends,
        errors=errors,
        in_range=in_range,
        rms_m=rms,
        rms_heading_rad={by: float(np.sqrt(np.mean(errors[by].heading_rad[in_range] ** 2))) for by in METHODS},
        ratio=rms["constant"] / rms["corrected"],
        ratio_ci95=(float(low), float(high)),
        runtime=fed,
        left_out=left_out,
        by_geometry=by_geometry,
        notes=(*notes, *_doubts(chosen, along)),
    )


def _doubts(campaign: Campaign, along: FloatArray) -> list[str]:
    # along (n_runs,): end errors, in those expected
    of_loads = [*measurements.wheel_loads(campaign), *settings.logged_loads(campaign)]
    notes = [*{note.code: note.sentence for note in reversed(of_loads) if "log" in note.where}.values()]
    of_others = {note.run_id: note for note in counts.counts_against_log(campaign)}
    if of_others:
        first = next(iter(of_others.values())).text.partition(";")[0]
        text = f"{len(of_others)} log(s) count other than the run table, whose end poses are those of the reference"
        named = f"{checks.listed([*of_others])}; the first: {first}"
        notes.append(f"{text} ({named}): cut, exchanged or of another run? 'calib check' says more")
    known = along[np.isfinite(along) & ~np.isin(campaign.runs.run_id, [*of_others])]
    far = int((np.abs(known) > FAR_SD).sum())
    if far >= FAR_RUNS and far > FAR_SHARE * len(known):
        text = f"{far} of {len(known)} runs end more than {FAR_SD:g} standard deviations of the prediction off"
        notes.append(f"{text} along the way: the coefficients no longer fit; 'calib fit NEW --model OLD' compares them")
    return notes


def _driven(
    campaign: Campaign, coefficients: CoefficientFile, carried_N: tuple[FloatArray, FloatArray], scheme: str
) -> tuple[dict[str, Poses], FloatArray]:
    offsets, columns, law = campaign.logs.offsets, campaign.logs.columns, coefficients.law
    if without_rear_wheels(campaign):
        calibrated = believed_model(coefficients, campaign.model.reference_load_N)
        before, _ = stood_in(campaign, campaign.model, scheme=scheme)
        after, distance = stood_in(campaign, calibrated, scheme=scheme)
        last = offsets[1:] - 1
        ends = dict(zip(METHODS, (before[last], after[last], after[last]), strict=True))
        return ends, np.add.reduceat(distance, offsets[:-1])
    unladen, track_m = coefficients.geometry.unladen_load_N, coefficients.geometry.track_m
    believed = {
        "model": (radii_of_model(campaign.model, *carried_N), campaign.model.track_m),
        "constant": (radii_under_load(law, unladen, unladen), track_m),
        "corrected": (radii_under_load(law, *carried_N), track_m),
    }
    ends = {}
    counts = columns["counts_left"], columns["counts_right"]
    for method, (radii, track) in believed.items():
        left, right = travel_from_counts(*counts, campaign.encoder, *radii, offsets=offsets)
        ends[method] = end_poses(left, right, track, offsets=offsets, scheme=scheme)
    return ends, np.add.reduceat(0.5 * np.abs(left + right), offsets[:-1])


def _usable(campaign: Campaign, law: RadiusLaw) -> tuple[Campaign, dict[str, int], tuple[str, ...]]:
    campaign, notes = with_loads(_with_end_poses(campaign), law)
    runs, logs = campaign.runs, campaign.logs
    posed = np.isfinite(np.stack([runs.number(c) for c in REFERENCE_POSE])).all(axis=0)
    loaded = np.isfinite(runs.number("load_left_N")) & np.isfinite(runs.number("load_right_N"))
    counted = logs.present.copy()
    for name in (*logged_columns(counted_source(campaign)), "t_s"):
        column = logs.columns.get(name, np.full(logs.offsets[-1], np.nan))
        gaps = np.concatenate(([0], np.cumsum(~np.isfinite(column))))
        counted &= (gaps[logs.offsets[1:]] == gaps[logs.offsets[:-1]]) & (name in logs.columns)
    left_out, usable = {}, np.ones(len(runs), dtype=np.bool_)
    reasons = ("excluded", "without a complete log", "without a reference end pose", "without wheel loads")
    for reason, fits in zip(reasons, (~runs.excluded, counted, posed, loaded), strict=True):
        left_out[reason] = int((usable & ~fits).sum())
        usable &= fits
    return campaign.select(usable), left_out, notes


def _with_end_poses(campaign: Campaign) -> Campaign:
    columns, offsets, names = campaign.logs.columns, campaign.logs.offsets, REFERENCE_POSE
    ends = np.stack([campaign.runs.number(name) for name in names])
    if poses_are_in_a_map(campaign.included()):
        ends[:] = np.nan
    counters = [name for name in logged_columns(counted_source(campaign)) if "counts" in name and name in columns]
    logged = set(names) <= columns.keys() and len(counters) > 0
    for run in np.flatnonzero(campaign.logs.present & np.isnan(ends).all(axis=0) & logged):
        part = slice(offsets[run], offsets[run + 1])
        poses, counted = (np.stack([columns[name][part] for name in of]) for of in (names, counters))
        known = np.flatnonzero(np.isfinite(poses).all(axis=0))
        # a vehicle that stands is where it was last seen
        if len(known) and (counted[:, known[[0, -1]]] == counted[:, [0, -1]]).all():
            first, last = poses[:, known[0]], poses[:, known[-1]]
            last[2] = unwrapped(poses[2, known])[-1]
            ends[:, run] = in_frame((last - first)[:, None], first[2:])[0]
    numbers = {**campaign.runs.numbers, **dict(zip(names, ends, strict=True))}
    return replace(campaign, runs=replace(campaign.runs, numbers=numbers))


def with_loads(campaign: Campaign, law: RadiusLaw) -> tuple[Campaign, tuple[str, ...]]:
    """Return the campaign, where no run has loads with unladen ones, else the law's centre."""
    runs, columns = campaign.runs, WHEEL_LOADS
    if any(np.isfinite(runs.number(name)).any() for name in columns):
        return campaign, ()
    unladen = wheel_loads_N(campaign.vehicle, 0.0, 0.0, 0.0)[1:]
    centre = law.left.reference_load_N, law.right.reference_load_N
    bare = bool(within_law(law, *unladen))
    loads = {name: np.full(len(runs), load) for name, load in zip(columns, unladen if bare else centre, strict=True)}
    campaign = replace(campaign, runs=replace(runs, numbers={**runs.numbers, **loads}))
    if without_rear_wheels(campaign):
        return campaign, ()
    taken = "as unladen" if bare else "at the load that the law is centred on"
    return campaign, (f"no wheel load is given: all runs are taken {taken}",)


def carried_loads_N(campaign: Campaign) -> tuple[FloatArray, FloatArray]:
    """Return the loads of left and right wheel in each step, (n_samples,); see `loads_in_steps`."""
    runs, logs, names = campaign.runs, campaign.logs, WHEEL_LOADS
    left, right = (loads_in_steps(runs.number(name), logs.columns.get(name), logs.offsets) for name in names)
    return left, right


def stood_in(campaign: Campaign, model: OdometryModel, *, scheme: str = "exact") -> tuple[Poses, FloatArray]:
    """Return the poses (n_samples,) of logs without rear wheels, each run from (0, 0, 0), and each step's way.

    The way, also sideways, is 0 at the first sample of a run.
    """
    axle = on_one_axle(campaign, model)
    columns, offsets = axle.logs.columns, axle.logs.offsets
    radii: tuple[ArrayLike, ArrayLike] = (model.radius_left_m, model.radius_right_m)
    if axle.odometry.source == "shaft":
        known_N = np.nan_to_num(carried_loads_N(campaign), nan=model.reference_load_N)
        radii = radii_of_model(model, *known_N, by_shaft=True)
    counts = columns["counts_left"], columns["counts_right"]
    left, right = travel_from_counts(*counts, axle.encoder, *radii, offsets=offsets)
    poses = integrate(left, right, model.track_m, offsets=offsets, scheme=scheme)
    ahead = 0.5 * (left + right)
    if ASIDE not in columns:
        return poses, np.abs(ahead)
    aside = np.diff(columns[ASIDE], prepend=0.0)
    aside[offsets[:-1]] = 0.0
    half = 0.5 * (right - left) / model.track_m
    chord = aside * np.sinc(half / np.pi)
    heading = poses.theta_rad - half
    x, y = since_start(-chord * np.sin(heading), offsets), since_start(chord * np.cos(heading), offsets)
    return Poses(poses.x_m + x, poses.y_m + y, poses.theta_rad), np.hypot(ahead, aside)


@dataclass(frozen=True, slots=True, eq=False)
class RuntimeCheck:
    """The vehicle's runtime against the array odometry on the same logs."""

    runs: int
    samples: int
    #: over all samples; NaN where none was accepted
    largest_difference_m: float
    largest_difference_rad: float
    faults: dict[str, int]  #: refused loads and samples by status


def _fed_runs(campaign: Campaign, coefficients: CoefficientFile, runs: int) -> tuple[RuntimeCheck, FloatArray]:
    # and the standard deviation of the end along the way, (n_runs,), NaN where not fed
    heading, along_std_m = campaign.runs.number("ref_theta_rad"), np.full(len(campaign.runs), np.nan)
    if without_rear_wheels(campaign):
        # the runtime reads two wheels on one axle
        return RuntimeCheck(0, 0, float("nan"), float("nan"), {}), along_std_m
    odometer = Odometer(Coefficients.parse(coefficients.to_bytes().decode("utf-8")))
    carried = np.stack(carried_loads_N(campaign), axis=1)
    faults: Counter[str] = Counter()
    samples, fed = 0, min(runs, len(campaign.runs))
    worst_m = worst_rad = float("nan")
    for run in range(fed):
        log = campaign.logs.of(run)
        loads = carried[campaign.logs.offsets[run] : campaign.logs.offsets[run + 1]]
        poses, fault, taken = _fed(odometer, log, loads)
        samples += taken
        faults.update([fault] if fault else [])
        if poses is None:
            continue
        ahead = np.array([np.cos(heading[run]), np.sin(heading[run]), 0.0])
        variance = ahead @ np.array(odometer.covariance) @ ahead
        along_std_m[run] = np.sqrt(variance + campaign.reference.sigma_xy_m**2)
        radii = radii_under_load(coefficients.law, *loads.T)
        travel = travel_from_counts(log["counts_left"], log["counts_right"], campaign.encoder, *radii)
        gap = np.abs(integrate(*travel, coefficients.geometry.track_m).stacked() - poses).max(axis=0)
        worst_m = float(np.fmax(worst_m, max(gap[0], gap[1])))
        worst_rad = float(np.fmax(worst_rad, gap[2]))
    return RuntimeCheck(fed, samples, worst_m, worst_rad, dict(faults)), along_std_m


def _fed(odometer: Odometer, log: dict[str, FloatArray], loads_N: FloatArray) -> tuple[FloatArray | None, str, int]:
    odometer.reset()
    changed = np.concatenate(([True], (np.diff(loads_N, axis=0) != 0.0).any(axis=1))).tolist()
    readings = zip(*(log[name].tolist() for name in ("counts_left", "counts_right", "t_s")), strict=True)
    poses, clamped = [], False
    for number, (left, right, t_s) in enumerate(readings):
        try:
            if changed[number]:
                odometer.set_wheel_loads(*loads_N[number].tolist())
        except OdometerFault as fault:
            return None, fault.status.name, number
        status = odometer.feed(left, right, t_s)
        if status is not Status.OK:
            return None, status.name, number + 1
        pose = odometer.pose
        clamped = clamped or pose.clamped
        poses.append((pose.x_m, pose.y_m, pose.theta_rad))
    return None if clamped else np.array(poses), "", len(poses)
