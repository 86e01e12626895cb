"""Whether a geometry is adequate: residuals of runs used and held out, against the noise."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import chain, islice
from typing import Final

import numpy as np
from scipy.special import chdtri, fdtri

from calib.campaign.model import Campaign
from calib.kinematics.blunders import Fault
from calib.kinematics.drives import STEERING_ZERO
from calib.kinematics.joint_fit import LOADS_VARY, Fitted, noise_by_windows, parted
from calib.kinematics.model import Model, Segments, replicates
from calib.kinematics.readings import implausible_lengths
from calib.kinematics.solve import solve
from calib.kinematics.uncertainty import ENOUGH_RUNS, FEWEST_CLUSTERS, flattened, left_within, whitened
from calib.types import BoolArray, FloatArray, IntArray, StrArray, few_digits

#: residual over noise that is a lack of fit: no chance makes a mean square of 9 of ten runs
LACK_OF_FIT: Final = 3.0
#: share of distance or rotation that wheel odometry leaves at best (recordings: 0.1 to 0.5 %)
SMALL_SHARE: Final = 0.005
#: what leaves more of the error held out explains nothing
USELESS_SHARE: Final = 0.9
#: where sessions differ, one calibration for all takes off three quarters of the mean square
WORTH_SHARE: Final = 0.5
#: a residual above this share of the distance or rotation is no calibration
WRONG_SHARE: Final = 0.05
#: folds in which runs are held out: each fit still sees four fifths of them
FOLDS: Final = 5
#: of fewer runs one is held out where the others keep this part of what is told
LEAST_TOLD: Final = 0.25
#: and of any number: what one fold alone tells (a taped length) no other predicts
CARRIED_ALONE: Final = 0.01
#: from which replicates' scatter counts: known to about a third
REPLICATE_DOF: Final = 4
#: drift of a calibrated odometry (UMBmark: 0.1 to 0.5 %)
USUAL_DRIFT: Final = 0.003
#: chance of an outlier: one in a hundred campaigns
OUTLIER_CHANCE: Final = 0.01
#: share of single bad runs, which take no part; one always may be
FEW_OUTLIERS: Final = 0.1
#: share of runs beyond noise that makes a result doubtful
MANY_OUTLIERS: Final = 0.25
#: a reference nearer to the nominal odometry, as a share of the distance, is a copy: 24 um in 8 m
COPIED_SHARE: Final = 3e-6
#: or, where its wheels were counted, within so many counts: both ends of two wheels
COPIED_COUNTS: Final = 2.0
FINE_M: Final = 2e-4
#: least turn that heading residuals are held against: of less the reference's noise is most
LEAST_ROTATION_RAD: Final = 1.0


class GeometryVerdict(StrEnum):
    """Whether the estimates are to be used."""

    CALIBRATED = "calibrated"
    DOUBTFUL = "doubtful"
    WRONG = "wrong"


CALIBRATED, DOUBTFUL, WRONG = GeometryVerdict


@dataclass(frozen=True, slots=True)
class Residuals:
    """Root mean squares of position (m) or heading (rad), and the distance or rotation beside them."""

    before: float
    after: float
    held_out: float
    noise: float
    travelled: float
    #: by the reference's stated noise and usual drift
    usual_noise: float = math.inf
    #: left by fits of each session, where these differ beyond chance
    within: float = math.inf
    #: added by fitted differences between recordings, such as steering zeros
    between: float = 0.0

    @property
    def expected(self) -> float:
        """What a further recording leaves: noise, and differences between recordings."""
        return math.hypot(self.noise, self.between)

    @property
    def apart(self) -> float:
        """Residual over what is left within sessions; 0 where that is no lack of fit."""
        ratio = math.sqrt(max((self.after / self.within) ** 2 - 1.0, 0.0)) if self.within > 0.0 else 0.0
        return ratio if ratio > LACK_OF_FIT else 0.0

    @property
    def figures(self) -> dict[str, float]:
        """The sizes by name; NaN where nothing was measured."""
        sizes = {"before": self.before, "after": self.after, "noise": self.expected, "held_out": self.held_out}
        return sizes if self.before or self.after else dict.fromkeys(sizes, math.nan)


def judge(residuals: Residuals, what: str = "position", unit: str = "mm") -> tuple[GeometryVerdict, tuple[str, ...]]:
    """Return whether a result is to be used, and why not; `unit`: of a residual times 1000."""
    sizes = (residuals.before, residuals.after, residuals.held_out, residuals.expected)
    words = (f"{few_digits(1e3 * value)} {unit}" if math.isfinite(value) else "an unknown part" for value in sizes)
    before, after, held_out, noise = words
    of = "distance travelled" if what == "position" else "rotation"
    travelled, unusual = max(residuals.travelled, 1e-12), LACK_OF_FIT * residuals.usual_noise
    if residuals.noise > max(WRONG_SHARE * travelled, unusual):
        share = f"{100 * residuals.noise / travelled:.2g} % of the {of}"
        reason = f"{what}: replicates scatter by {few_digits(1e3 * residuals.noise)} {unit}, {share}"
        return WRONG, (f"{reason}: more than wheels that roll; look for slip and a bad reference",)
    useless = residuals.held_out > USELESS_SHARE * residuals.before
    small = max(LACK_OF_FIT * residuals.expected, SMALL_SHARE * residuals.travelled)
    worst = max(residuals.after, residuals.held_out)
    # a calibrated vehicle leaves noise, or a small share of its way
    unexplained = useless and worst > max(math.sqrt(2.0) * residuals.noise, SMALL_SHARE * travelled)
    if min(residuals.noise, residuals.before) > unusual and unexplained:
        scatter = f"stretches of the same wheel motion scatter by {few_digits(1e3 * residuals.noise)} {unit}"
        reason = f"{what}: nothing of {before} is explained, and {scatter}"
        return DOUBTFUL, (f"{reason}: the wheels, or a steering sensor, do not tell how the vehicle moved",)
    stays = worst > small or residuals.held_out > WORTH_SHARE * residuals.before
    if residuals.apart and stays and worst <= WRONG_SHARE * travelled:
        return DOUBTFUL, (
            f"{what}: sessions differ by {few_digits(residuals.apart, 2)} times what is left within each "
            f"({1e3 * residuals.within:.3g} {unit}), and held-out runs end off by {held_out} ({before} before): radii, "
            "steering or reference changed in between; calibrate each session by itself, 'calib diagnose' looks for "
            "what changed",
        )
    if worst <= small:
        return CALIBRATED, ()
    if residuals.before > small and useless:
        reason = f"{what}: on held-out runs it leaves {held_out} of {before}: these parameters do not explain the error"
        return WRONG, (reason,)
    where = f"{after} on the runs used, {held_out} on held-out runs, noise {noise}"
    if worst > WRONG_SHARE * travelled:
        return WRONG, (f"{what}: the residual is {100 * worst / travelled:.2g} % of the {of} ({where})",)
    times = few_digits(worst / max(residuals.expected, 1e-12), 2)
    return DOUBTFUL, (f"{what}: the residual is {times} times the noise ({where})",)


@dataclass(frozen=True, slots=True)
class Judgement:
    """A verdict with its figures and reasons; no reasons where it is ``calibrated``."""

    verdict: GeometryVerdict
    #: at the ends of runs, or of windows
    position: Residuals
    heading: Residuals
    why: tuple[str, ...]
    #: blunders named; none where the data stay unexplained once corrected
    faults: tuple[Fault, ...] = ()

    @property
    def adequacy(self) -> dict[str, float]:
        """Root mean square errors of the position and of the heading, as the JSON names them."""
        parts = (("", "m", self.position), ("heading_", "rad", self.heading))
        return {f"{of}{at}_rms_{unit}": size for of, unit, part in parts for at, size in part.figures.items()}


def judged(
    campaign: Campaign, fitted: Fitted, whole: Model, faults: Sequence[Fault], outliers: Sequence[str]
) -> Judgement:
    """Judge a fit by its residuals.

    Parameters
    ----------
    campaign, fitted
        The first states the reference's noise.
    whole
        Whole runs, or the longest windows.
    faults, outliers
        Blunders; runs that noise cannot explain, which take no part.
    """
    used, seen = _used(whole, outliers) & ~bad_windows(fitted, whole), whole.segments.seen
    after = np.where(seen, whole.residuals(fitted.solution.values), 0.0)
    logged = replace(whole, recording=fitted.logged)
    before = np.where(seen, logged.residuals(fitted.parameters.nominal), 0.0)
    by_zero = _by_zero(fitted, logged)
    held_out = np.where(seen, _held_out(fitted, whole, after), 0.0)
    way_m, rotation_rad = travelled(whole, fitted.solution.values)
    by_motion = replicates(whole, way_m)
    alike = replicates(whole, way_m, LOADS_VARY * max(campaign.model.reference_load_N, 1.0))
    session = whole.recording.session
    in_session = np.unique(session, return_inverse=True)[1][whole.segments.run] * len(alike) + alike
    within = left_within(fitted.solution, fitted.parameters.free, fitted.model.segments, session)

    def of(columns: slice, travelled: FloatArray, usual: float, by_windows: float) -> Residuals:
        at, left = used & seen[:, columns].any(axis=1), within[columns.start // 2]
        scatters = (_scatter(after[:, columns], group, at) for group in (in_session, alike, by_motion))
        *apart, over_all = (size if dof >= REPLICATE_DOF else 0.0 for size, dof in scatters)
        scatter = min(next(filter(None, apart), min(usual, by_windows)), over_all or np.inf)
        sizes = [rms(part[at, columns]) for part in (before, after, held_out)]
        # scatter over sessions that differ is no noise
        noise = min(scatter, left)
        scales = rms(travelled[at, None]), usual, left, rms(by_zero[at, columns])
        return Residuals(sizes[0], sizes[1], sizes[2], noise, *scales)

    rotated_rad = np.maximum(rotation_rad, LEAST_ROTATION_RAD)
    turned = np.mean(rotation_rad[used]) + np.mean(way_m[used])
    usual_m = math.hypot(math.sqrt(2.0) * campaign.reference.sigma_xy_m, USUAL_DRIFT * way_m.mean())
    usual_rad = math.hypot(math.sqrt(2.0) * campaign.reference.sigma_theta_rad, USUAL_DRIFT * turned)
    told_m, told_rad = noise_by_windows(fitted, whole)
    position = of(slice(0, 2), way_m, usual_m, told_m)
    heading = of(slice(2, 3), rotated_rad, usual_rad, told_rad)
    level, reasons = judge(position)
    level_of_heading, of_heading = judge(heading, "heading", "mrad")
    # a factor that is recognised says by itself that the length is off
    explained = {fault.code for fault in faults} & {"half_track", "radius_factor"}
    impossible = [] if explained else implausible_lengths(fitted, campaign.vehicle.drive)
    large = np.hypot(*after[:, :2].T) > SMALL_SHARE * way_m
    large |= np.abs(after[:, 2]) > SMALL_SHARE * rotated_rad
    named = tuple(fault for fault in faults if fault.seen or WRONG not in (level, level_of_heading))
    extra = (*impossible, *_further(fitted, whole, outliers, large, position, heading))
    if not (named or extra or reasons or of_heading):
        runs = whole.recording.run_id[whole.segments.run[used]]
        scatters = (_scatter(after[:, :2], group, used) for group in (alike, by_motion))
        harmed = (_harmed(runs, before[used], after[used], way_m[used], *scatter) for scatter in scatters)
        extra = tuple(islice(chain(*harmed), 1))
    verdicts = (level, level_of_heading, WRONG if named or impossible else DOUBTFUL if extra else CALIBRATED)
    why = (*(fault.text for fault in named), *extra, *reasons, *of_heading)
    return Judgement(max(verdicts, key=list(GeometryVerdict).index), position, heading, why, named)


def _harmed(
    run_id: StrArray, before: FloatArray, after: FloatArray, way_m: FloatArray, scatter_m: float, dof: int
) -> Iterator[str]:
    near, left = (np.hypot(*part[:, :2].T) for part in (before, after))
    worse = np.where(left > SMALL_SHARE * way_m, left**2 - near**2, 0.0)
    worst = int(np.argmax(worse))
    if dof and worse[worst] > scatter_m**2 * fdtri(2.0, 2.0 * dof, 1.0 - 0.5 * OUTLIER_CHANCE / len(worse)):
        yield (
            f"position: run {run_id[worst]} ends {few_digits(1e3 * left[worst])} mm off with the result and "
            f"{few_digits(1e3 * near[worst])} mm without it: 'calib diagnose' looks for a cause that acts elsewhere "
            "alone"
        )


def _used(whole: Model, outliers: Sequence[str]) -> BoolArray:
    segments, recording = whole.segments, whole.recording
    bad: BoolArray = np.isin(recording.run_id, list(outliers))
    used: BoolArray = ~bad[segments.run]
    kinds, runs = recording.kind[bad], np.unique(segments.run)
    alone = all((recording.kind == kind).sum() > (kinds == kind).sum() or not kind for kind in set(kinds.tolist()))
    few = bad[runs].sum() <= max(1.0, FEW_OUTLIERS * len(runs))
    return used if few and alone and used.sum() >= 2 else np.ones_like(used)


def bad_windows(fitted: Fitted, whole: Model) -> BoolArray:
    """Return the windows that noise cannot explain, where few: single poses of a tracker are off."""
    longest = fitted.model.segments.level == 0
    if whole.segments.are_runs_of(whole.recording) or longest.sum() != len(whole.segments):
        return np.zeros(len(whole.segments), dtype=np.bool_)
    size = np.maximum(whole.segments.seen.sum(axis=1), 1)
    bad: BoolArray = fitted.solution.squares[longest] > chdtri(size, OUTLIER_CHANCE / len(size))
    return bad if bad.mean() <= FEW_OUTLIERS else np.zeros_like(bad)


def travelled(model: Model, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return each segment's way in m, a radian counted as 0.1, and rotation in rad, shape (n,)."""
    body = model.motion(values).body
    turn = np.abs(body[2])
    return model.segments.between(np.hypot(body[0], body[1]) + 0.1 * turn), model.segments.between(turn)


def rms(residuals: FloatArray) -> float:
    """Return the root mean square of residuals (n, n_channels) together."""
    return float(np.sqrt(np.mean(np.square(residuals).sum(axis=1)))) if len(residuals) else 0.0


def _scatter(after: FloatArray, group: IntArray, used: BoolArray) -> tuple[float, int]:
    members = [after[used & (group == number)] for number in np.unique(group[used])]
    squares, dof = sum(len(part) * part.var(axis=0).sum() for part in members), int(used.sum()) - len(members)
    return float(np.sqrt(squares / max(dof, 1))), dof


def _held_out(fitted: Fitted, whole: Model, after: FloatArray) -> FloatArray:
    model, solution = fitted.model, fitted.solution
    runs = np.unique(model.segments.run)
    by_run = len(runs) >= min(ENOUGH_RUNS, FOLDS) or whole.segments.are_runs_of(whole.recording)
    units, ours = (model.segments.run, whole.segments.run) if by_run else (model.segments.block, whole.segments.block)
    fold = {unit: number % FOLDS for number, unit in enumerate(np.unique(units))}
    of_fit, of_whole = (np.array([fold.get(unit, 0) for unit in part]) for part in (units, ours))
    residuals, jacobian = np.full_like(after, np.nan), whitened(solution, fitted.parameters.free)[0]
    logged = replace(whole, recording=fitted.logged)
    for number in range(FOLDS):
        kept: Segments = model.segments.select(of_fit != number)
        away = of_whole == number
        jacobians = (flattened(jacobian[of_fit != out]) for out in (FOLDS, number))
        information, kept_information = (part.T @ part + solution.pull for part in jacobians)
        least = np.linalg.eigvals(np.linalg.lstsq(information, kept_information)[0]).real.min()
        if len(kept) and away.any() and least > (LEAST_TOLD if by_run and len(runs) < FOLDS else CARRIED_ALONE):
            # by angles from their own zeros; held-out runs have the common one
            seen = Model(model.drive, model.recording, kept)
            fit = solve(seen, fitted.parameters, solution.values, solution.scales, noise_rounds=1)
            residuals[away] = logged.residuals(fit.values)[away]
    return residuals


def _by_zero(fitted: Fitted, logged: Model) -> FloatArray:
    if not fitted.zero_spread_rad:
        return np.zeros((len(logged.segments), 3))
    values = fitted.solution.values.copy()
    common = logged.residuals(values)
    values[fitted.parameters.names.index(STEERING_ZERO)] += fitted.zero_spread_rad
    return logged.residuals(values) - common


def _along(fitted: Fitted, outliers: Sequence[str], noise_m: float) -> Iterator[str]:
    segments, solution, free = fitted.model.segments, fitted.solution, fitted.parameters.free
    used = _used(fitted.model, outliers) & (segments.level > 0) & segments.seen.all(axis=1)
    if not used.any():
        return
    sizes, residuals = travelled(fitted.model, solution.values), solution.prediction.residuals[used]
    way_m, rotation_rad = (rms(size[used, None]) for size in sizes)
    off_m = float(np.median(np.hypot(residuals[:, 0], residuals[:, 1])))
    if off_m > max(WRONG_SHARE * way_m, LACK_OF_FIT * noise_m):
        yield (
            f"position: {few_digits(1e3 * off_m)} mm of {way_m:.2g} m are left within runs: the path does not bend "
            "as the wheels turn; is an axis of the reference mirrored, or are x and y exchanged?"
        )
        return
    own = left_within(solution, free, replace(segments, level=(~used).astype(np.int64)), fitted.model.recording.run_id)
    left, small = (rms(residuals[:, :2]), rms(residuals[:, 2:])), (way_m, max(rotation_rad, LEAST_ROTATION_RAD))
    if any(one > max(LACK_OF_FIT * by, SMALL_SHARE * of) for one, by, of in zip(left, own, small, strict=True)):
        name, sides = parted(fitted, used)
        yield (
            f"runs differ: within them {1e3 * left[0]:.3g} mm and {1e3 * left[1]:.3g} mrad are left, "
            f"{1e3 * own[0]:.3g} mm and {1e3 * own[1]:.3g} mrad by parameters of each; {name}, for one, is less in "
            f"{sides[0] or 'no run'} than in {sides[1] or 'the others'}: vehicle, sensor or reference changed; "
            "calibrate these runs by themselves"
        )


#: what then tells the wheels apart, how a bent path shortens a run, is a square: alike to either side
LENGTHS_ALONE: Final = (
    "lengths of straight runs alone do not tell the wheels apart, nor the track; 'calib fit' takes the runs for "
    "straight, and end headings (ref_theta_rad, a gyro) or closed loops tell the wheels apart"
)


def _further(
    fitted: Fitted, whole: Model, outliers: Sequence[str], large: BoolArray, position: Residuals, heading: Residuals
) -> Iterator[str]:
    n_runs = len(np.unique(whole.segments.run))
    yield from _along(fitted, outliers, position.usual_noise)
    numbers, n_free = int(fitted.model.segments.seen.sum()), int(fitted.parameters.free.sum())
    if numbers <= n_free:
        yield f"{numbers} measured numbers for {n_free} parameters are fitted exactly and show nothing: drive more runs"
    n_off = len(np.intersect1d(outliers, whole.recording.run_id[np.unique(whole.segments.run[large])]))
    if n_off > MANY_OUTLIERS * n_runs:
        beyond = f", {n_off} by more than {100 * SMALL_SHARE:g} % of way or rotation" if n_off < len(outliers) else ""
        yield f"{len(outliers)} of {n_runs} runs are outliers{beyond}: look at their references, times and counts"
    rolled = float(np.hypot(heading.after * position.travelled, position.usual_noise))
    if heading.before and position.after > LACK_OF_FIT * rolled:
        yield (
            f"position: {few_digits(1e3 * position.after)} mm are left where the headings and the usual drift make "
            f"{few_digits(1e3 * rolled)} mm: the vehicle moves as its wheels do not (it strafes or slides sideways), "
            "or the reference's positions are wrong"
        )
    share_m, n_seen = COPIED_SHARE * position.travelled, whole.segments.seen[:, 0].sum()
    # a taped length or two agree by chance
    if n_seen >= FEWEST_CLUSTERS and 0.0 < position.before < max(share_m, COPIED_COUNTS * FINE_M):
        rolled_rad = np.abs(whole.recording.steps.turned_rad)
        radius_m = max(row.nominal for row in fitted.parameters.items if "radius" in row.name)
        count_m = min(radius_m * float(rolled_rad[rolled_rad > 0.0].min(initial=np.inf)), FINE_M)
        # no instrument agrees that well
        if position.before < max(share_m, COPIED_COUNTS * count_m):
            yield (
                f"position: the reference agrees with the nominal odometry within {few_digits(1e6 * position.before)} "
                "um: it was computed from the counts; give poses of an instrument of its own"
            )
    if whole.recording.lengths_alone and {"radius_left_m", "radius_right_m"} & set(fitted.parameters.free_names):
        yield LENGTHS_ALONE
    if fitted.zero_spread_rad and heading.between > SMALL_SHARE * heading.travelled:
        what = "sessions" if len(np.unique(fitted.logged.session)) > 1 else "recordings"
        yield (
            f"{STEERING_ZERO} differs between {what} by {1e3 * fitted.zero_spread_rad:.2g} mrad (standard deviation), "
            "beyond chance: the steering has play, or does not follow its command; a further recording ends off by "
            f"{heading.between:.2g} rad; log the angle of the wheels, or calibrate the zero before each drive"
        )
