"""Blunders of wheels and settings: swapped columns, signs, units, half a track, mirrors."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.special import ndtr, stdtrit

from calib.campaign.wheels import SLOWEST_RADPS, STEERED
from calib.errors import RefusedError
from calib.types import FloatArray, IntArray

if TYPE_CHECKING:
    from calib.kinematics import Recording
    from calib.kinematics.drives import Drive
    from calib.kinematics.model import Segments

#: relative distance of a ratio from its factor
NEAR: Final = 0.08
#: turns of the wheels by less, rms over the stretches, say nothing of the heading's unit
TURNS_RAD: Final = 0.1
#: nor logged but once a second where it is so slow
SLOWEST_OF_ROWS_RADPS: Final = 0.2
#: part of a spike that is left of it one sample later
SPIKE_LEFT: Final = 0.1
#: a steering angle that reads more straight ahead was never zeroed
FARTHEST_ZERO_RAD: Final = 0.1
#: standard deviations by which a sign must stand out
CLEAR: Final = 5.0
#: no wheel is steered further
LARGEST_STEERING_RAD: Final = 2.0
LEAST_COSINE: Final = 0.2
#: estimates of the angle read straight ahead, each by the one before
STRAIGHT_ROUNDS: Final = 5
#: an angle that moves less over a campaign is not that of a wheel that steers
STILL_RAD: Final = 1e-3
#: a reference mirrored in y and heading is to the wheels the same as left for right
OR_MIRRORED: Final = (
    "; or ref_y_m and ref_theta_rad are both mirrored (clockwise, y to the right, NED): then change their signs and "
    "exchange nothing. Drive a left turn: ref_theta_rad must grow, and the right wheel roll further"
)
#: without headings, also the same as backward for ahead
OF_A_COURSE: Final = (
    "the course bends the other way than by the wheels: ref_x_m and ref_y_m are exchanged or one is mirrored, wheels "
    "are exchanged, or counters or the steering angle have the other sign: drive a left turn, and correct the wrong one"
)
#: column of the yaw rate that, with v_mps, stands for two wheels
TWIST: Final = "omega_radps"
#: displacements within 60 degrees of the wheels' way tell its sense
ALONG: Final = 0.5
#: where turns are not told, a displacement below this part of the way (a loop) tells nothing
FAR: Final = 0.1
Between = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, slots=True)
class Fault:
    """A blunder: its stable name, and a sentence that says what is wrong and what to do."""

    code: str
    text: str
    seen: bool = False  #: whether the readings alone show it, well fitted or not


Corrected = tuple["Recording", tuple[Fault, ...]]


def rear_faults(recording: "Recording", segments: "Segments") -> Corrected:
    """Return the recording with signs and sides of two wheels corrected, by regressing headings, and the fault."""
    twist, good = TWIST in recording.speeds, segments.seen[:, 2]
    slopes = _regression(segments.between(recording.steps.turned_rad)[:, good], segments.measured[good, 2])
    if slopes is None or slopes[0] < 0.0 < slopes[1]:
        return recording, ()
    left, right = recording.steps.turned_rad
    forward = sense(segments, slopes @ recording.steps.turned_rad, left + right)
    names = " and ".join((recording.speeds or ("counts_left", "counts_right"))[:2])
    both = f"v_mps and {TWIST} have the other sign" if twist else "both counters run backwards"
    wiring, turns = "counter runs backwards; correct its sign or its wiring", "left turns are positive; correct it"
    cases = (
        (min(slopes) > 0.0, (-left, right), "reversed_left", f"the left {wiring}"),
        (max(slopes) < 0.0, (left, -right), "reversed_right", f"the right {wiring}"),
        (forward < 0.0, (-left, -right), "reversed_both", f"{both}; correct their signs"),
        (twist, (right, left), "reversed_omega", f"{TWIST} has the other sign: {turns}{OR_MIRRORED}"),
        (True, (right, left), "swapped_wheels", f"the wheels are swapped; exchange the columns {names}{OR_MIRRORED}"),
    )
    _, corrected, code, text = next(case for case in cases if case[0])
    return recording.with_turned(np.stack(corrected)), (Fault(code, text),)


def sense(segments: "Segments", turn_rad: FloatArray, rolled: FloatArray, far: float = 0.0) -> float:
    """Return how far displacements point where the wheels rolled, from -1 (backwards) to 1.

    `turn_rad`, `rolled` (shape (n_steps,)): turn in each step by the measured headings, and the wheels' way;
    displacements below the part `far` of it do not count.
    """
    heading = np.cumsum(turn_rad)
    steps = rolled * np.exp(1j * (heading - 0.5 * turn_rad))
    seen = segments.seen[:, :2].all(axis=1)
    by_wheels = (segments.between(steps) * np.exp(-1j * heading[segments.first]))[seen]
    measured = segments.measured[seen, 0] + 1j * segments.measured[seen, 1]
    measured[np.abs(measured) < far * segments.between(np.abs(rolled))[seen]] = 0.0
    return float(np.vdot(by_wheels, measured).real / max(float(np.sum(np.abs(by_wheels) * np.abs(measured))), 1e-12))


def _regression(turned: FloatArray, heading: FloatArray, tested: slice = slice(None)) -> FloatArray | None:
    normal, dof = turned @ turned.T, len(heading) - len(turned)
    if dof < 2 or np.linalg.cond(normal) > 1e10:
        return None
    weights = np.ones(len(heading))
    for _ in range(10):
        slope = np.linalg.solve((turned * weights) @ turned.T, (turned * weights) @ heading)
        residuals = heading - slope @ turned
        spread = 1.483 * float(np.median(np.abs(residuals))) * float(np.sqrt(len(heading) / dof)) + 1e-9
        weights = 1.0 / (1.0 + np.square(residuals / (3.0 * spread)))
    std = spread * np.sqrt(np.diag(np.linalg.inv(normal)))
    return np.asarray(slope) if np.all(np.abs(slope[tested]) > stdtrit(dof, ndtr(CLEAR)) * std[tested]) else None


def front_faults(recording: "Recording", segments: "Segments", radius_m: float, *, by_shaft: bool) -> Corrected:
    """Return the recording with steering zero and signs corrected, and what was wrong.

    `radius_m`: nominal; `by_shaft`: the counter tells the rear axle's way. Lengths are positive in the right one of two
    mirrored solutions.
    """
    faults: list[Fault] = []
    steer, headed, rolled = recording.steps.steer_rad, segments.seen[:, 2], recording.steps.turned_rad[0]
    if steer is None or not headed.any():
        return recording, ()
    turns, longest = segments.measured[:, 2], headed & (segments.level == 0)
    if still := still_steering(steer, segments.between(rolled)[longest], turns[longest], segments.run[longest]):
        return recording, (Fault("steering_still", f"steer_rad: {still}", seen=True),)
    turned = turns[headed]
    zero_rad = straight_reading_rad(
        rolled, steer, turned, lambda steps: segments.between(steps)[headed], by_shaft=by_shaft
    )
    if abs(zero_rad) > 0.0:
        degrees = f"{zero_rad:.3g} rad ({np.degrees(zero_rad):.0f} degrees)"
        text = f"steer_rad: it reads {degrees} where the wheels stand straight ahead; subtract that"
        faults.append(Fault("steering_offset", text))
        steer = np.angle(np.exp(1j * (steer - zero_rad)))
        recording = recording.with_steering(steer)
    ways = (_of_front(rolled, steer) if by_shaft else rolled) * np.stack([np.sin(steer), np.cos(steer)])
    by_ways = segments.between(ways)[:, headed]
    turning, *_ = np.linalg.lstsq(by_ways.T, turned, rcond=None)
    clear = _regression(by_ways, turned, tested=slice(1)) is not None
    backwards = sense(segments, turning @ ways, radius_m * ways[1], 0.0 if clear else FAR) < -ALONG
    if backwards:
        faults.append(Fault("reversed_front", "the front counter runs backwards; correct its sign"))
        recording = recording.with_turned(-recording.steps.turned_rad)
    if (turning[0] < 0.0) != backwards and clear:
        text = f"the steering angle has the other sign: left turns are positive{OR_MIRRORED}"
        faults.append(Fault("reversed_steering", text))
        recording = recording.with_steering(-steer)
    return recording, tuple(faults)


def still_steering(steer_rad: FloatArray, rolled: FloatArray, turned_rad: FloatArray, run: IntArray) -> str:
    """Return what is wrong where the angle never moves but the curvature does; empty if right.

    `steer_rad` (shape (n_steps,)): as read; `rolled`, `turned_rad`, `run` (shape (n,)): of each stretch, run by run.
    """
    if not len(run) or not float(np.ptp(steer_rad)) <= STILL_RAD:
        return ""
    left_rad = turned_rad - rolled * float(rolled @ turned_rad) / max(float(rolled @ rolled), 1e-12)
    first = np.flatnonzero(np.diff(run, prepend=-1))
    departed_rad = max(float(np.ptp(np.append(0.0, np.cumsum(part)))) for part in np.split(left_rad, first[1:]))
    if departed_rad < TURNS_RAD:
        return ""
    return (
        f"it reads {np.mean(steer_rad):.3g} rad throughout, while the vehicle turned by {departed_rad:.2g} rad more "
        "than one steering angle turns it; check the sensor of the steering and its column"
    )


def _of_front(rolled: FloatArray, steer_rad: FloatArray) -> FloatArray:
    return rolled / np.maximum(np.cos(steer_rad), LEAST_COSINE)


def straight_reading_rad(
    rolled: FloatArray, steer_rad: FloatArray, turned_rad: FloatArray, between: Between, *, by_shaft: bool = False
) -> float:
    """Return the steering angle read straight ahead; 0 near that, NaN where these turns do not follow it.

    A reading delta counted from c turns the vehicle by ``k phi sin(delta - c)``.

    Parameters
    ----------
    rolled, steer_rad
        Way of the front wheel in each step, and the angle read, shape (n_steps,).
    turned_rad, between
        Measured turns of stretches, shape (n,), and sums of steps over these.
    by_shaft
        The way is that of a counted rear axle: turns go by the tangent.
    """
    if len(turned_rad) < 4 or float(np.ptp(steer_rad)) > 2.0 * LARGEST_STEERING_RAD:
        return np.nan
    most = np.sum(np.abs(rolled) * np.exp(1j * steer_rad))
    total, found_rad = turned_rad @ turned_rad, float(np.angle(most))
    for _ in range(STRAIGHT_ROUNDS if by_shaft else 1):
        front = _of_front(rolled, steer_rad - found_rad) if by_shaft else rolled
        ways = np.stack([between(front * np.sin(steer_rad)), between(front * np.cos(steer_rad))])
        (by_sine, by_cosine), *_ = np.linalg.lstsq(ways.T, turned_rad)
        straight = complex(by_sine, -by_cosine)
        straight *= np.sign((straight * most.conjugate()).real)
        found_rad = float(np.angle(straight))
    left = np.sum((turned_rad - by_sine * ways[0] - by_cosine * ways[1]) ** 2)
    # where the largest zero that a fit finds leaves as little, these turns do not tell
    near_rad = float(np.copysign(FARTHEST_ZERO_RAD, found_rad))
    by_near = np.cos(near_rad) * ways[0] - np.sin(near_rad) * ways[1]
    alone = total - (by_near @ turned_rad) ** 2 / max(by_near @ by_near, 1e-12)
    if left > POOR * total:
        return np.nan
    near = abs(found_rad) <= FARTHEST_ZERO_RAD or (straight.real > 0.0 and left > CLEARLY_LESS * alone)
    return 0.0 if near else found_rad


def refuse_heading_unit(told_rad: FloatArray, measured_rad: FloatArray) -> None:
    """Raise RefusedError where a reference turns by pi / 180, or 180 / pi, of what the wheels say: no radians.

    `told_rad`, `measured_rad` (shape (n,)): turns of stretches by the nominal wheels, and by the reference.
    """
    square = float(told_rad @ told_rad)
    if not len(told_rad) or square < len(told_rad) * TURNS_RAD**2:
        return
    # of either sign: all counters may run backwards
    slope = float(told_rad @ measured_rad) / square
    ratio, left_rad = abs(slope), measured_rad - slope * told_rad
    if float(left_rad @ left_rad) > CLEARLY_LESS * float(measured_rad @ measured_rad):
        return
    units = {np.pi / 180.0: "radians taken for degrees", 180.0 / np.pi: "degrees taken for radians"}
    for factor, what in units.items():
        if abs(ratio / factor - 1.0) < 2.0 * NEAR:
            text = f"ref_theta_rad: found turns that are {ratio:.3g} times those of the wheels; expected about as much"
            raise RefusedError(f"{text}; the heading's unit is wrong ({what}): correct it in the mapping or the log")


WHEELS: Final = ("front_left", "front_right", "rear_left", "rear_right")
#: columns are wrong where others leave less than this part of what they leave
CLEARLY_LESS: Final = 0.25
#: and where they leave more than this part of the way and of the turns
POOR: Final = 0.1
#: within this factor of the least, readings are as good
ALIKE: Final = 1.1
#: turns of less are noise
LEAST_TURN_RAD: Final = 0.05


def corrected(recording: "Recording", segments: "Segments", source: str, drive: "Drive") -> Corrected:
    """Return the recording with blunders of the wheels corrected, and these faults.

    `source`: one of `WHEEL_COLUMNS`. Raises RefusedError where the reference's heading is not in radians.
    """
    faults: tuple[Fault, ...] | None = None
    if source in STEERED:
        recording, faults = front_faults(recording, segments, drive.parameters[0].nominal, by_shaft=source == "shaft")
    # with a heading of another unit any reading of the wheels that hardly turns would look best
    seen = segments.seen[:, 2]
    measured = segments.measured[seen, 2]
    refuse_heading_unit(measured - _nominal_residuals(recording, segments, drive)[seen, 2], measured)
    if faults is not None:
        return recording, faults
    return wheels_faults(recording, segments, drive) if source == "wheels" else rear_faults(recording, segments)


def still_counters(recording: "Recording", told_rad: FloatArray) -> Iterator[Fault]:
    """Yield the counters that stand still in a run that does not turn about that wheel.

    `told_rad` (shape (n_samples,)): turn in each step by fitted wheels, so that units do not matter.
    """
    names = recording.speeds or ("counts_left", "counts_right")
    step, after = recording.steps.turned_rad[:2, :-1], recording.steps.turned_rad[:2, 1:]
    spikes = (np.abs(step + after) < SPIKE_LEFT * np.abs(step)) & (np.abs(step) > 2.0 * np.pi)
    spikes_of = [np.flatnonzero(of_side) for of_side in spikes]
    for side, name in enumerate(names if TWIST not in recording.speeds else ()):
        if len(spiked := spikes_of[side]):
            runs = sorted(set(recording.run_id[recording.run[spiked]]))
            text = f"{name}: {len(spiked)} sample(s) jump by more than a revolution and back, in {', '.join(runs)}"
            yield Fault("count_spike", f"{text}; remove these samples", seen=True)
        for run, first, last in zip(recording.run_id, recording.offsets, recording.offsets[1:] - 1, strict=False):
            part = slice(first, last + 1)
            rolled = np.cumsum(np.abs(recording.steps.turned_rad[:, part]), axis=1)
            heading, t_s = recording.reference[2, part], recording.t_s[part]
            moved = np.concatenate([[0], np.flatnonzero(recording.steps.turned_rad[side, part]), [last - first]])
            longest = int(np.argmax(np.diff(rolled[1 - side, moved])))
            begin, end = int(moved[longest]), int(moved[longest + 1])
            known = np.flatnonzero(np.isfinite(heading[begin : end + 1])) + begin
            spiked = spikes_of[1 - side] - first
            jumps = bool(((begin <= spiked) & (spiked <= end)).any())
            if jumps or not len(known) or np.ptp(rolled[1 - side, known]) < 2.0 * np.pi:
                continue
            begin, end = int(known[0]), int(known[-1])
            turn, seen = told_rad[part][begin + 1 : end + 1].sum(), heading[end] - heading[begin]
            if abs(seen) < CLEARLY_LESS * abs(turn):
                text = (
                    f"{name}: it stands still from {t_s[begin]:.3g} to {t_s[end]:.3g} s in {run}, and the vehicle "
                    f"turns by {seen:.2g} rad, not {turn:.2g} rad about that wheel; check the encoder, omit this run"
                )
                yield Fault("counter_still", text, seen=True)


def times_fault(recording: "Recording") -> Fault | None:
    """Return what is wrong with times in another unit, whose delay of the reference no fit can find."""
    step_s, rolled_rad = np.diff(recording.t_s), float(np.abs(recording.steps.turned_rad).mean(axis=0).sum())
    step_s = step_s[np.diff(recording.run) == 0]
    per_s = rolled_rad / max(float(step_s.sum()), 1e-9)
    rows = bool((np.abs(step_s - 1.0) < 1e-6).all()) and per_s < SLOWEST_OF_ROWS_RADPS
    if not rows and per_s > SLOWEST_RADPS:
        return None
    what = "numbers of rows" if rows else "times in ms, us or ns"
    text = f"t_s: found {what} where seconds are expected: the wheels turn by {per_s:.2g} rad/s on average"
    return Fault("time_unit", f"{text}; convert, or state the unit in the mapping", seen=True)


def wheels_faults(recording: "Recording", segments: "Segments", drive: "Drive") -> Corrected:
    """Return the recording with the signs and sides of four wheels that fit the reference, and what was wrong."""
    turned, as_it_stands = recording.steps.turned_rad, _left(recording, segments, drive)[0]
    if as_it_stands < POOR:
        return recording, ()
    read = ((recording.with_turned(turned[order] * signs[:, None]), fault) for fault, order, signs in _readings())
    scored = [(_left(changed, segments, drive), changed, fault) for changed, fault in read]
    least = min(left for (left, _), *_ in scored)
    if least > CLEARLY_LESS * as_it_stands:
        return recording, ()
    # of two half a turn of the sensor apart the one that turns it less is likelier
    _, changed, fault = min((one for one in scored if one[0][0] <= ALIKE * least + 1e-9), key=lambda one: one[0][1])
    return changed, (fault,)


def _readings() -> Iterator[tuple[Fault, list[int], FloatArray]]:
    same, plain = list(range(4)), np.ones(4)
    for wheel, signs in zip(WHEELS, 1.0 - 2.0 * np.eye(4), strict=True):
        text = f"the {wheel.replace('_', ' ')} counter runs backwards; correct its sign or its wiring"
        yield Fault(f"reversed_{wheel}", text), same, signs
    yield Fault("reversed_both", "all four counters run backwards; correct their signs"), same, -plain
    exchanged = [[pair] for pair in combinations(range(4), 2)] + [[(0, 1), (2, 3)], [(0, 2), (1, 3)], [(0, 3), (1, 2)]]
    for pairs in exchanged:
        order = list(same)
        for one, other in pairs:
            order[one], order[other] = other, one
        names = ", ".join(f"counts_{WHEELS[one]} and counts_{WHEELS[other]}" for one, other in pairs)
        names += OR_MIRRORED if pairs == [(0, 1), (2, 3)] else ""
        yield Fault("swapped_wheels", f"wheels are exchanged; exchange {names}"), order, plain


def _nominal_residuals(recording: "Recording", segments: "Segments", drive: "Drive") -> FloatArray:
    from calib.kinematics.drives import nominal_values
    from calib.kinematics.model import Model

    return Model(drive, recording, segments).residuals(nominal_values(drive))


def _left(recording: "Recording", segments: "Segments", drive: "Drive") -> tuple[float, float]:
    seen = segments.seen.all(axis=1)
    measured, residuals = segments.measured[seen], _nominal_residuals(recording, segments, drive)[seen]
    if not len(measured):
        return 0.0, 0.0
    way, missed = (part[:, 0] + 1j * part[:, 1] for part in (measured, residuals))
    turned = float(np.angle(np.vdot(way - missed, way)))
    short = np.mean(np.abs(way - (way - missed) * np.exp(1j * turned)) ** 2) / max(np.mean(np.abs(way) ** 2), 1e-12)
    turn, of_turn = np.mean(np.square([measured[:, 2], residuals[:, 2]]), axis=1)
    return float(short + of_turn / (turn + LEAST_TURN_RAD**2)), abs(turned)


def of_gyro(fault: Fault) -> Fault:
    """Return a fault of headings in the words of a campaign whose turns a gyro measured."""
    text = fault.text.removeprefix("ref_x_m, ref_y_m, ").replace("ref_y_m and ref_theta_rad are", "ref_theta_rad is")
    either = " (or left and right wheels are exchanged)" * (fault.code == "heading_clockwise")
    return replace(fault, text=text.replace("ref_theta_rad", "gyro_z_radps") + either)
