"""What a fit leaves: departures, changes of the recording of unknown size; and the noise, with radii that scatter."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Final

import numpy as np

from calib.campaign.wheels import smoothed_speed_mps
from calib.kinematics import Recording, drives
from calib.kinematics.blunders import Fault
from calib.kinematics.joint_fit import Fitted
from calib.kinematics.model import Model, Segments, measured_between
from calib.kinematics.solve import COMPONENTS, DEGREES, LEAST, NOISE_STRETCHES, POWER, STATED_READINGS, kernels
from calib.kinematics.uncertainty import ENOUGH_RUNS, UNBIASED, flattened, whitened
from calib.types import FloatArray

#: standard deviations by which a size must stand out: several are tried
CLEAR: Final = 6.0
#: of slip: sound runs have up to 3.2
CLEAR_SLIP: Final = 4.5
#: of an axis: displacements by a laser scanner, which have no axes, make up to 9.4
CLEAR_AXIS: Final = 12.0
#: share of the weighted squares, noise included, that a departure must explain
EXPLAINED: Final = 0.5
#: and to be followed where the fit is refused: it is named only if the corrected fit is not
LEAD: Final = 0.1
PLAYS_RAD: Final = (0.01, 0.04)
#: of a steering angle: from half the least on, which is no step of a log any more
SHIFTS_S: Final = (0.1, 0.3, -0.1, -0.3)
#: of a tracking system's axis
AXIS_SCALE: Final = 0.01
#: resultant of the doubled start headings, above which runs begin along one axis
ALONG_ONE: Final = 0.9
#: of headings beside positions
HEADING_SCALE: Final = 0.005
#: sound clocks differ by 1e-4
CLOCK_RATE: Final = 5e-4
#: recordings, and part of the longest that they differ by, from which delays tell of a clock
FEWEST_OF_A_CLOCK: Final = 4
OF_TWO_LENGTHS: Final = 0.2
#: of the wheels' way
SLIP: Final = 0.01
#: code, what it grows with and what helps
SLIPS: Final = (
    ("speed_slip", "% per m/s of speed: the radii hold for these speeds alone; drive as in use"),
    ("strafe_slip", "% on the way to the side, as rollers do; correct that way in the vehicle"),
    ("turn_slip", "% per rad/s of yaw rate: radii and track hold for these turns alone; turn slower"),
    ("outward_slip", "cm/s outward per m/s^2 in turns: the sensor's place holds for these turns alone; turn slower"),
)
ASIDE: Final = 1
OUTWARD: Final = 3
_ROLLERS: Final = np.array([-1.0, 1.0, 1.0, -1.0])


@dataclass(frozen=True, slots=True)
class Departure:
    """A change of the recording of a size that a fit tells, and its name."""

    change: Callable[[Recording, float], Recording]
    #: at which residuals are differentiated
    step: float
    named: Callable[[float], Fault]
    share: float = EXPLAINED
    clear: float = CLEAR


def find_departure(fitted: Fitted, *, misfit: bool) -> tuple[Departure, float] | None:
    """Return the departure that explains most, and its size; None where none is clear; more are tried of a `misfit`."""
    most, best = 0.0, None
    # beside a delay that nobody estimated, the delay itself looks like a clock
    for departure in _departures(fitted.model, timed="delay_s" in fitted.parameters.free_names, misfit=misfit):
        share, size, std = score(fitted, departure)
        clear = abs(size) >= departure.clear * std and size / departure.step > LEAST_SIZE
        if clear and share >= departure.share and share > most:
            most, best = share, (departure, size)
    return best


def hidden_clock(recording: Recording) -> tuple[Departure, float] | None:
    """Return the clock, and its rate, that gives recordings of different lengths their delays."""
    middle_s = 0.5 * recording.t_s[recording.offsets[1:] - 1]
    if len(recording) < FEWEST_OF_A_CLOCK or np.ptp(middle_s) < OF_TWO_LENGTHS * middle_s.max():
        return None
    return Departure(_clocked, CLOCK_RATE, _clock, 0.0), float(np.polyfit(middle_s, recording.delay_added_s, 1)[0])


def score(fitted: Fitted, departure: Departure) -> tuple[float, float, float]:
    """Return the share of squares a departure explains, its size, and that one's uncertainty."""
    model, solution = fitted.model, fitted.solution
    recording = departure.change(model.recording, departure.step)
    segments = remeasured(model.segments, model.recording.reference, recording.reference)
    changed = Model(model.drive, recording, segments).residuals(solution.values)
    jacobian, residuals = whitened(solution, fitted.parameters.free)
    shift = np.einsum("nij,nj->ni", solution.whitener, solution.prediction.residuals - changed)
    shift *= np.sqrt(solution.weights)[:, None]
    back = np.linalg.inv(solution.whitener)
    back /= np.linalg.norm(back, axis=2, keepdims=True)
    flat = (back @ jacobian).reshape(-1, jacobian.shape[2])
    both = (back @ np.stack([shift, residuals], axis=2)).reshape(-1, 2)
    column, unexplained = (both - flat @ np.linalg.lstsq(flat, both, rcond=None)[0]).T
    information, runs = float(column @ column), model.segments.run
    group = np.repeat(runs if len(np.unique(runs)) >= FEWEST_GROUPS else model.segments.block, 3)
    few = model.segments.seen.sum() <= flat.shape[1] + FEWEST_GROUPS
    if few or information <= 0.0 or len(np.unique(group)) < min(FEWEST_GROUPS, flat.shape[1] + 2):
        return 0.0, 0.0, np.inf
    steps = float(column @ unexplained) / information
    rest = unexplained - steps * column
    std = float(np.linalg.norm(np.bincount(group, column * rest))) / information
    share = 1.0 - float(rest @ rest / max(unexplained @ unexplained, 1e-300))
    return share, steps * departure.step, std * abs(departure.step)


#: runs from which on they are the groups, not blocks of them; readings beside the parameters
FEWEST_GROUPS: Final = 8
#: a smaller part of the size tried is another's, or of the wrong sign
LEAST_SIZE: Final = 0.5
#: no linear step reaches as far
LARGEST_SIZE: Final = 30.0


def remeasured(segments: Segments, before: FloatArray, after: FloatArray) -> Segments:
    """Return the same stretches as another reference measures them; references have shape (3, n_samples)."""
    if after is before:
        return segments
    ends = segments.first, segments.last
    finite = np.isfinite(after[:, ends])
    finite[2] |= ~segments.seen[:, 2]
    known = segments.seen & np.asarray(finite.all(axis=(0, 1)))[:, None]
    added = np.subtract(*(measured_between(part, *ends, segments.around) for part in (after, before)))
    return replace(segments, measured=segments.measured + np.where(known, added, 0.0))


def _departures(model: Model, *, timed: bool, misfit: bool) -> Iterator[Departure]:
    whole = model.segments.are_runs_of(model.recording)
    share = EXPLAINED * whole
    if model.recording.steps.steer_rad is None:
        for rate in range(len(SLIPS)):
            without, named = partial(_without_slip, drive=model.drive, rate=rate), partial(_slip, rate)
            if rate != (OUTWARD if isinstance(model.drive, drives.Mecanum) else ASIDE):
                yield Departure(without, SLIP, named, max(share, LEAD) if rate <= ASIDE else share, CLEAR_SLIP)
    else:
        yield from (Departure(_without_play, play_rad, _play, share) for play_rad in PLAYS_RAD)
        yield from (Departure(_shifted, shift_s, _shift, share) for shift_s in SHIFTS_S)
    # where all begin at one heading, an axis of the reference is one of the vehicle
    if whole and not abs(np.mean(np.exp(2j * model.recording.reference[2, model.segments.first]))) < ALONG_ONE:
        return
    for sign in (1.0, -1.0):
        if not whole and timed:
            yield Departure(_clocked, sign * CLOCK_RATE, _clock, share)
        if misfit and not whole:
            for change in (partial(_stretched, axis=2), _wound_since_start):
                yield Departure(change, sign * HEADING_SCALE, _heading_scale, LEAD)
        for axis, name in enumerate(("ref_x_m", "ref_y_m")):
            change, named = partial(_stretched, axis=axis), partial(_axis, name=name)
            yield Departure(change, sign * AXIS_SCALE, named, share, CLEAR_AXIS)


def _clocked(recording: Recording, rate: float) -> Recording:
    return replace(recording, clock_rate=recording.clock_rate + rate)


def _clock(rate: float) -> Fault:
    text = f"t_s: the reference's clock runs {100 * abs(rate):.2g} % {'fast' if rate > 0.0 else 'slow'} beside the "
    return Fault("clock_rate", f"{text}counts'; stamp both by one clock or divide its times by {1.0 + rate:.5g}")


def _without_slip(recording: Recording, slip: float, drive: drives.Drive, rate: int) -> Recording:
    steps, turned = recording.steps, recording.steps.turned_rad
    if rate == ASIDE:
        return recording.with_turned(turned - slip * np.outer(_ROLLERS, 0.25 * _ROLLERS @ turned))
    motion = drives.nominal_motion(drive, steps)
    per_s = smoothed_speed_mps(np.cumsum(motion[rate % OUTWARD]), recording.t_s)
    if rate == OUTWARD:
        return replace(recording, steps=replace(steps, aside_m=steps.aside_m - slip * per_s * motion[2]))
    return recording.with_turned(turned / (1.0 + slip * np.abs(per_s)))


def _slip(rate: int, slip: float) -> Fault:
    code, text = SLIPS[rate]
    return Fault(code, f"the wheels slip by {100 * slip:.2g} {text}")


def _without_play(recording: Recording, play_rad: float) -> Recording:
    wheel, half = np.array(recording.steps.steer_rad), 0.5 * play_rad
    for first, last in pairwise(recording.offsets.tolist()):
        angle = float(wheel[first])
        for at in range(first, last):
            wheel[at] = angle = min(max(angle, wheel[at] - half), wheel[at] + half)
    return recording.with_steering(wheel)


def _play(play_rad: float) -> Fault:
    text = f"steer_rad: the wheels follow it with a play of {1e3 * play_rad:.3g} mrad, by the direction of the last "
    return Fault("steering_play", f"{text}turn; take it out of the steering, or log the angle of the wheels")


def _shifted(recording: Recording, shift_s: float) -> Recording:
    steer = np.asarray(recording.steps.steer_rad).copy()
    for first, last in pairwise(recording.offsets.tolist()):
        t_s = recording.t_s[first:last]
        steer[first:last] = np.interp(t_s - shift_s, t_s, steer[first:last])
    return recording.with_steering(steer)


def _shift(shift_s: float) -> Fault:
    late = "after it: the wheels follow a command" if shift_s > 0.0 else "before it: it is filtered or stamped"
    text = f"steer_rad: the vehicle steers {abs(shift_s):.2g} s {late} late"
    return Fault("steering_shift", f"{text}; log the angle of the wheels by the clock of the counts")


def _stretched(recording: Recording, share: float, axis: int) -> Recording:
    return recording.with_reference((recording.reference.T * (1.0 + share * np.eye(3)[axis])).T)


def _wound_since_start(recording: Recording, share: float) -> Recording:
    begin_rad = recording.reference[2, recording.offsets[recording.run]]
    wound = _stretched(recording, share, 2)
    return wound.with_reference(wound.reference - share * np.outer(np.eye(3)[2], begin_rad))


def _heading_scale(share: float) -> Fault:
    text = f"ref_theta_rad: it turns {100 * abs(share):.2g} % too {'little' if share > 0 else 'much'} beside the path "
    return Fault("heading_scale", f"{text}of its positions; calibrate what measures it (a gyro?)")


def _axis(share: float, name: str) -> Fault:
    text = f"{name}: distances along this axis are {100 * abs(share):.3g} % too {'short' if share > 0 else 'long'} "
    return Fault("axis_scale", f"{text}beside the other; calibrate the tracking system or the camera")


#: of the weights in none to three channels: normal noise keeps its mean square
NORMAL_GAIN: Final = np.array([1.0, 1.2382, 1.1846, 1.1469])
#: steps: most settles in half of them
ROUNDS: Final = 100
#: degrees of freedom with which variances have a mean
FEWEST_DOF: Final = 5
#: scatter -> the walk that it is told from, and relative changes of the radii, left and right
_SCATTERS: Final = {"radius_scatter": ("along_walk", (1.0, 1.0)), "yaw_scatter": ("heading_walk", (-0.5, 0.5))}
_RADII: Final = ("radius_left_m", "radius_right_m")
#: of what the walk is without scatter, all alike likely
_WALK_PARTS: Final = np.linspace(0.05, 1.55, 16)
#: of what the scatter is without other noise: even odds of none, else all alike likely (Gelman, Bayesian Analysis 1,
#: 2006)
_SCATTER_PARTS: Final = np.linspace(0.0, 4.0, 81)
_ODDS: Final = np.where(_SCATTER_PARTS > 0.0, 1.0 / 80.0, 1.0)


def noise_sizes(fitted: Fitted, stated: FloatArray) -> tuple[dict[str, float], dict[str, float]]:
    """Return standard deviations of the noise's components: estimated, and to expect of a further journey.

    `stated`: variances by the settings, shape (4,). Estimated from residuals enlarged by what the parameters took (Bell
    and McCaffrey); to expect is the mean variance, with the scatter of radii from run to run.
    """
    model, solution = fitted.model, fitted.solution
    segments, scales = model.segments, solution.scales
    thinned = slice(None, None, max(1, len(segments) // NOISE_STRETCHES))
    seen, block, residuals = segments.seen[thinned], segments.block[thinned], _enlarged(fitted)[thinned]
    body, yaw_rad = model.motion(solution.values).body, float(solution.values[-2])
    whole = kernels(solution.prediction.path, body, segments, yaw_rad)
    kernel = whole[:, thinned]
    size = seen.sum(axis=1)
    for _ in range(ROUNDS):
        inverse = np.linalg.inv(np.tensordot(scales, kernel, 1) + np.eye(3) * ~seen[:, None])
        pull, pulled = (inverse @ residuals[:, :, None])[:, :, 0], inverse @ kernel
        squares = (pull * residuals).sum(axis=1)
        weights = NORMAL_GAIN[size] * (DEGREES + size) / (DEGREES + squares)
        parts, traces = np.einsum("n,ni,knij,nj->kn", weights, pull, kernel, pull), np.einsum("knii->kn", pulled)
        readings = STATED_READINGS / scales
        quotient = (parts.sum(axis=1) + readings * stated / scales) / np.maximum(traces.sum(axis=1) + readings, 1e-300)
        scales = np.maximum(scales * np.clip(quotient, 0.05, 20.0) ** POWER, LEAST * stated)

    scores = np.stack([np.bincount(block, row) for row in 0.5 * (parts - traces)])
    kept = (weights * squares * DEGREES / (DEGREES + squares)).sum() / size.sum()
    by_stated = np.diag(0.5 * readings / scales)
    bread = np.linalg.pinv(0.5 * kept * np.einsum("knij,lnji->kl", pulled, pulled) + by_stated, hermitian=True)
    variance_std = np.sqrt(np.diag(bread @ (scores @ scores.T + by_stated) @ bread))
    dof = max(len(np.unique(block)) - int(fitted.parameters.free.sum()), FEWEST_DOF)
    # uncertain by sqrt(2 / dof), an inverse chi squared: its mean is dof / (dof - 4) of
    expected = scales + variance_std * np.sqrt(8.0 * dof) / (dof - 4.0)
    estimated, further = (dict(zip(COMPONENTS, row, strict=True)) for row in np.sqrt([scales, expected]).tolist())
    return estimated, _told_from_walks(fitted, further, whole)


def _enlarged(fitted: Fitted) -> FloatArray:
    solution, block = replace(fitted.solution, shared=None), fitted.model.segments.block
    jacobian, white = whitened(solution, fitted.parameters.free)
    flat = flattened(jacobian)
    columns = jacobian @ np.linalg.inv(np.linalg.cholesky(flat.T @ flat + solution.pull)).T
    for one in np.unique(block):
        rows = block == one
        left, singular, _ = np.linalg.svd(flattened(columns[rows]), full_matrices=False)
        grow = np.maximum(1.0 - singular**2, 1e-6) ** -UNBIASED - 1.0
        white[rows] += (left @ (grow * (left.T @ white[rows].ravel()))).reshape(-1, 3)
    white = white[:, :, None] / np.sqrt(solution.weights)[:, None, None]
    return np.asarray(np.linalg.solve(solution.whitener, white)[:, :, 0])


def _told_from_walks(fitted: Fitted, expected: Mapping[str, float], kernel: FloatArray) -> dict[str, float]:
    segments, solution, out = fitted.model.segments, fitted.solution, dict(expected)
    run = np.unique(segments.run, return_inverse=True)[1]
    if run.max() + 1 < ENOUGH_RUNS or not set(_RADII) <= set(fitted.parameters.free_names):
        return out
    at = [fitted.parameters.names.index(name) for name in _RADII]
    by_wheel = solution.prediction.jacobian[:, :, at] * solution.values[at]
    for name, (walk, shares) in _SCATTERS.items():
        columns = np.stack([by_wheel @ shares, solution.prediction.residuals], axis=2)
        rows: list[tuple[float, FloatArray, FloatArray]] = []
        for part in _WALK_PARTS:
            scales = solution.scales * np.where(np.array(COMPONENTS) == walk, part**2, 1.0)
            inverse = np.linalg.inv(np.tensordot(scales, kernel, 1) + np.eye(3) * ~segments.seen[:, None])
            each = solution.weights[:, None, None] * (columns.transpose(0, 2, 1) @ inverse @ columns)
            likelihood = 0.5 * float(np.linalg.slogdet(inverse)[1].sum() - each[:, 1, 1].sum())
            size, pull = (np.bincount(run, of).astype(np.float64) for of in each[:, 0].T)
            rows.append((likelihood, size, pull))
        # a single run that does not tell the radii tells no scatter
        if float(np.median(rows[-1][1])) * drives.NOMINAL_STD**2 < 1.0:
            continue
        variances = np.square(_SCATTER_PARTS) * max((pull @ pull) / (size @ size) for _, size, pull in rows)
        likely = np.stack([one + _log_likelihood(size, pull, variances) for one, size, pull in rows])
        likely = np.exp(likely - likely.max()) * _ODDS
        likely /= likely.sum()
        out[name] = float(np.sqrt(likely.sum(axis=0) @ variances))
        out[walk] *= float(np.sqrt(likely.sum(axis=1) @ np.square(_WALK_PARTS)))
    return out


def _log_likelihood(information: FloatArray, pulls: FloatArray, variances: FloatArray) -> FloatArray:
    # of each variance of what runs add; what all have in common is integrated over
    wider = 1.0 + variances[:, None] * information
    common, pull = (information / wider).sum(axis=1), (pulls / wider).sum(axis=1)
    gained = (variances[:, None] * np.square(pulls) / wider - np.log(wider)).sum(axis=1)
    return np.asarray(0.5 * (gained - np.log(common) + np.square(pull) / common))
