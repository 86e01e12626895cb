"""Readings of a recording: blunder hypotheses, each of which changes it back."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Final

import numpy as np

from calib.campaign.model import Campaign
from calib.kinematics import Recording
from calib.kinematics.blunders import LARGEST_STEERING_RAD, NEAR, OF_A_COURSE, TWIST, Fault
from calib.kinematics.drives import Drive, nominal_motion
from calib.kinematics.joint_fit import Fitted
from calib.types import BoolArray, FloatArray, since_start
from calib.vehicle import SKID_TRACK

#: a sine, with noise of the reference
LARGEST_Z: Final = 1.05
#: widths of counters in use, bits
COUNTER_BITS: Final = (8, 10, 12, 13, 14, 16, 24, 32)

#: in metres
LENGTH_UNITS: Final = {
    "millimetres": 1e-3,
    "centimetres": 1e-2,
    "feet": 0.3048,
    "inches": 0.0254,
    "decimetres": 0.1,
    "kilometres": 1e3,
}
#: in radians
ANGLE_UNITS: Final = {"degrees": np.pi / 180.0, "turns": 2.0 * np.pi, "gon": np.pi / 200.0}
#: on counts per revolution
COUNT_FACTORS: Final = {"half": 0.5, "twice": 2.0, "a quarter of": 0.25, "four times": 4.0}

#: a step so many times those beside it, and above a revolution, is no motion
JUMP_FACTOR: Final = 8.0
#: jumps a run, on average; more are a counter that wraps
MOST_JUMPS: Final = 2.0
#: its jumps differ: wheels speed up
ALIKE: Final = 0.1
#: gear ratios tried, near enough to find the steering angle's scale from one
GEAR_RATIOS: Final = tuple(float(ratio) for ratio in np.geomspace(2.0, 64.0, 11))

Change = Callable[[Recording], Recording]
Setting = Callable[[Campaign], Campaign]
OfArray = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, slots=True)
class Reading:
    """A hypothesis: a change of the recording, and the blunder that it corrects."""

    blunder: Fault
    change: Change
    #: the same with the column zero: a reading must be better
    zeroed: Change | None = None
    #: the same for a factor of which a fit tells the rest: of the radii, or of the steering angle
    refined: "Callable[[tuple[float, float]], Reading] | None" = None
    setting: Setting | None = None


def readings(
    recording: Recording, per_rev: float, drive: Drive, turned_rad: float, *, plausible: bool
) -> Iterator[Reading]:
    """Yield readings, the simplest first.

    Parameters
    ----------
    recording, per_rev, drive
        As stated.
    turned_rad
        By which the reference's displacements are turned against the wheels'.
    plausible
        Whether lengths are near nominal as it stands.
    """
    if recording.by_course is not None and recording.by_course.any():
        yield Reading(Fault("mirrored", OF_A_COURSE), _scaled(1.0, -1.0, 1.0))
    else:
        yield from _axes(turned_rad)
    yield from _yaw_rates(recording)
    yield from _quaternions(recording, drive)
    yield from _units()
    yield from _tracks(drive)
    yield from _wheel_units(per_rev, drive)
    if not plausible:
        text = "counts: {:.3g} times too many for [encoder] and [vehicle] (the motor's? inches?); correct one"
        yield from _geared("count_gear", text, _rolled, 0)
    yield from _wraps(recording, per_rev)
    yield from _increments(recording)
    yield from _jumps(recording, per_rev)
    if recording.steps.steer_rad is not None:
        yield from _steering(recording.steps.steer_rad)


def _referred(change: OfArray) -> Change:
    def changed(recording: Recording) -> Recording:
        ends, other = np.asarray(change(recording.end_pose.T).T), recording.with_reference(change(recording.reference))
        return replace(other, end_pose=np.where(_followed(other)[:, None], other.end_pose, ends))

    return changed


def _followed(recording: Recording) -> BoolArray:
    return np.add.reduceat(np.isfinite(recording.reference).all(axis=0), recording.offsets[:-1], dtype=np.int64) > 1


def _linear(matrix: Sequence[Sequence[float]]) -> Change:
    return _referred(lambda pose: np.asarray(np.array(matrix) @ np.nan_to_num(pose) + 0.0 * pose))


@cache
def _scaled(x: float, y: float, theta: float) -> Change:
    return _linear([[x, 0, 0], [0, y, 0], [0, 0, theta]])


def _axes(turned_rad: float) -> Iterator[Reading]:
    if turned_rad:
        c, s = float(np.cos(turned_rad)), float(np.sin(turned_rad))
        text = (
            f"the reference's axes are turned by {np.degrees(turned_rad):+.3g} degrees against the start heading; turn "
            "them back, so that x is the vehicle's heading at the start, or add "
            f"{-turned_rad:+.3g} to sensor_yaw_rad in [reference]"
        )
        yield Reading(Fault("axes_turned", text), _linear([[c, s, 0], [-s, c, 0], [0, 0, 1]]))
    for code, what, matrix in (
        ("y_mirrored", "y is mirrored: it is positive to the left", [[1, 0, 0], [0, -1, 0], [0, 0, 1]]),
        ("x_mirrored", "x is mirrored: it is positive ahead", [[-1, 0, 0], [0, 1, 0], [0, 0, 1]]),
        ("heading_clockwise", "the heading is clockwise: left turns are positive", [[1, 0, 0], [0, 1, 0], [0, 0, -1]]),
        ("axes_exchanged", "x and y are exchanged: x is ahead, y to the left", [[0, 1, 0], [1, 0, 0], [0, 0, 1]]),
        ("axes_turned", "the axes are turned by 90 degrees: x is ahead", [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]),
        ("axes_turned", "the axes are turned by -90 degrees: x is ahead", [[0, -1, 0], [1, 0, 0], [0, 0, 1]]),
        ("axes_turned", "the axes are turned by 180 degrees: x is ahead", [[-1, 0, 0], [0, -1, 0], [0, 0, 1]]),
        ("mirrored", "y and heading are mirrored, or the wheels exchanged", [[1, 0, 0], [0, -1, 0], [0, 0, -1]]),
    ):
        yield Reading(Fault(code, f"ref_x_m, ref_y_m, ref_theta_rad: {what}; correct the mapping"), _linear(matrix))
    text = "ref_theta_rad: clockwise from y, as a compass' from north; ingest it by factor = -1, offset = 90 deg"
    compass = _referred(lambda pose: np.stack([pose[0], pose[1], 0.5 * np.pi - pose[2]]))
    yield Reading(Fault("heading_clockwise", text), compass)


def _rolled(change: OfArray) -> Change:
    return lambda recording: recording.with_turned(change(recording.steps.turned_rad))


def _yaw_rates(recording: Recording) -> Iterator[Reading]:
    for unit, radians in ANGLE_UNITS.items() if TWIST in recording.speeds else ():
        mix = 0.5 * np.array([[1.0 + radians, 1.0 - radians], [1.0 - radians, 1.0 + radians]])
        text = f"{TWIST}: found {unit}/s where rad/s are expected; convert, or state the unit in the mapping"
        yield Reading(Fault("omega_unit", text), _rolled(partial(np.matmul, mix)))


def _quaternions(recording: Recording, drive: Drive) -> Iterator[Reading]:
    z = np.append(recording.reference[2], np.where(_followed(recording), 0.0, recording.end_pose[:, 2]))
    if not (np.abs(z[np.isfinite(z)]) <= LARGEST_Z).all():
        return

    def headings(recording: Recording) -> Recording:
        heading = since_start(nominal_motion(drive, recording.steps)[2], recording.offsets)
        reference, first = recording.reference.copy(), recording.reference[2, recording.offsets[:-1]]
        starts = np.nan_to_num([2.0 * np.arcsin(first), 2.0 * (np.pi - np.arcsin(first))])
        of_start = [_of_quaternion(reference[2], heading + np.repeat(at, np.diff(recording.offsets))) for at in starts]
        off = [np.add.reduceat(np.nan_to_num(off), recording.offsets[:-1]) for _, off in of_start]
        nearer = np.repeat(np.argmin(off, axis=0), np.diff(recording.offsets))
        reference[2] = np.where(nearer, of_start[1][0], of_start[0][0])
        ends, other = heading[recording.offsets[1:] - 1], recording.with_reference(reference)
        ends = np.where(_followed(other), other.end_pose[:, 2], _of_quaternion(recording.end_pose[:, 2], ends)[0])
        return replace(other, end_pose=np.column_stack([other.end_pose[:, :2], ends]))

    text = "ref_theta_rad: found the z of a quaternion where a heading in rad is expected; take 2 atan2(z, w)"
    yield Reading(Fault("heading_quaternion", text), headings, _scaled(1.0, 1.0, 0.0))


def _of_quaternion(z: FloatArray, told_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
    # the heading nearest to what the wheels tell, and how far it is from that
    half = np.arcsin(np.clip(z, -1.0, 1.0))
    headings = np.stack([2.0 * half, 2.0 * (np.pi - half)])
    headings += 4.0 * np.pi * np.rint((told_rad - headings) / (4.0 * np.pi))
    nearest = np.argmin(np.abs(headings - told_rad), axis=0)
    heading = np.where(nearest, headings[1], headings[0]) + 0.0 * z
    return heading, np.abs(heading - told_rad)


def _units() -> Iterator[Reading]:
    for unit, metres in LENGTH_UNITS.items():
        for columns, x, y in (("ref_x_m, ref_y_m", metres, metres), ("ref_x_m", metres, 1.0), ("ref_y_m", 1.0, metres)):
            text = f"{columns}: found {unit} where metres are expected; convert, or state the unit in the mapping"
            zeroed = _scaled(float(x == 1.0), float(y == 1.0), 1.0)
            yield Reading(Fault("position_unit", text), _scaled(x, y, 1.0), zeroed)
    for unit, radians in ANGLE_UNITS.items():
        text = f"ref_theta_rad: found {unit} where radians are expected; convert, or state the unit in the mapping"
        yield Reading(Fault("heading_unit", text), _scaled(1.0, 1.0, float(radians)), _scaled(1.0, 1.0, 0.0))


def unchanged(recording: Recording) -> Recording:
    """Return the recording as it stands."""
    return recording


def _tracks(drive: Drive) -> Iterator[Reading]:
    if not any(item.name == "track_m" for item in drive.parameters):
        return
    for factor, words in TRACK_FACTORS.items():

        def stated(campaign: Campaign, factor: float = factor) -> Campaign:
            return replace(campaign, model=replace(campaign.model, track_m=factor * campaign.model.track_m))

        hint = SKID_HINT if factor > 1.0 else ""
        text = f"track_m: {words} that is stated explains the data{hint}; correct [vehicle]"
        yield Reading(Fault("half_track" if factor > 1.0 else "double_track", text), unchanged, setting=stated)


def _wheel_units(per_rev: float, drive: Drive) -> Iterator[Reading]:
    radius = next(item.nominal for item in drive.parameters if "radius" in item.name)
    units = {"radians": per_rev / (2.0 * np.pi), "degrees": per_rev / 360.0, "turns": per_rev}
    units |= {"metres": per_rev / (2.0 * np.pi * radius), "millimetres": 1e-3 * per_rev / (2.0 * np.pi * radius)}
    for side, which in _sides(sum(item.name.startswith("radius_") for item in drive.parameters)):
        for unit, factor in units.items():
            text = f"counts of {side}: found {unit} where encoder counts are expected; map the column with its unit"
            yield Reading(Fault("count_unit", text), _rolled(partial(np.multiply, np.where(which, factor, 1.0))))
        for words, factor in COUNT_FACTORS.items():
            text = f"counts of {side}: {words} the stated counts_per_rev explains the data; correct [encoder]"
            code = "radius_factor" if which.all() else "counts_per_rev"
            text += ", or the radius (a diameter?)" if which.all() else ""
            yield Reading(Fault(code, text), _rolled(partial(np.multiply, np.where(which, 1.0 / factor, 1.0))))


def _geared(code: str, text: str, change: Callable[[OfArray], Change], scale: int) -> Iterator[Reading]:
    def reading(ratio: float) -> Reading:
        by_ratio = change(partial(np.multiply, 1.0 / ratio))
        return Reading(Fault(code, text.format(ratio)), by_ratio, refined=lambda scales: reading(ratio / scales[scale]))

    yield from map(reading, GEAR_RATIOS)


def _sides(n_wheels: int) -> list[tuple[str, BoolArray]]:
    names = {"both wheels": [[1], [1]], "the left wheel": [[1], [0]], "the right wheel": [[0], [1]]}
    names = names if n_wheels == 2 else {"the wheels": [[1]]}
    return [(name, np.array(which, dtype=np.bool_)) for name, which in names.items()]


def _wraps(recording: Recording, per_rev: float) -> Iterator[Reading]:
    turned = recording.steps.turned_rad
    # what overflows stays within a period of where it began
    largest, farthest = np.abs(turned).max(), np.abs(since_start(turned, recording.offsets)).max()
    periods = {"one revolution (an absolute encoder)": 2.0 * np.pi}
    periods |= {f"2^{bits}": 2.0 * np.pi * 2.0**bits / per_rev for bits in COUNTER_BITS}
    for what, period in periods.items():
        if 0.5 * period < largest and farthest <= 1.01 * period:
            yield _wrapped(f"{what} and were not unwrapped; state wrap_bits in [encoder], or", period)


def _wrapped(what: str, period_rad: float) -> Reading:
    blunder = Fault("counts_wrap", f"counts overflow at {what} unwrap them")
    return Reading(blunder, _rolled(lambda turned: turned - period_rad * np.rint(turned / period_rad)))


def _increments(recording: Recording) -> Iterator[Reading]:
    for side, which in _sides(len(recording.steps.turned_rad)):

        def summed(recording: Recording, which: BoolArray = which) -> Recording:
            turned = recording.steps.turned_rad
            return recording.with_turned(np.where(which, since_start(turned, recording.offsets), turned))

        text = f"counts of {side}: found increments since the sample before where totals are expected; add them up"
        yield Reading(Fault("count_increments", text), summed)


def _jumps(recording: Recording, per_rev: float) -> Iterator[Reading]:
    def jumped(turned: FloatArray) -> tuple[BoolArray, FloatArray]:
        size = np.abs(turned)
        beside = np.maximum(np.roll(size, 1, axis=1), np.roll(size, -1, axis=1))
        return size > np.maximum(JUMP_FACTOR * beside, 2.0 * np.pi), size + beside

    jumps, there_and_back_rad = jumped(recording.steps.turned_rad)
    n_jumps, modulus_rad = int(jumps.any(axis=0).sum()), there_and_back_rad[jumps]
    if n_jumps > MOST_JUMPS and np.ptp(modulus_rad) < ALIKE * modulus_rad[0]:
        counts = round(float(np.median(modulus_rad)) * per_rev / (2.0 * np.pi))
        yield _wrapped(f"{counts}, by which they jump {n_jumps} times;", 2.0 * np.pi * counts / per_rev)
    if not 0 < n_jumps <= MOST_JUMPS * len(recording):
        return
    text = f"counts: found {n_jumps} jumps of more than a revolution in one sample (a counter that starts again); "
    blunder = Fault("count_jump", text + "join the parts of each run, or leave these runs out")
    yield Reading(blunder, _rolled(lambda turned: np.where(jumped(turned)[0], 0.0, turned)))


def _steering(steer: FloatArray) -> Iterator[Reading]:

    def steered(change: OfArray) -> Change:
        return lambda recording: recording.with_steering(change(np.asarray(recording.steps.steer_rad)))

    for unit, radians in ANGLE_UNITS.items():
        text = f"steer_rad: found {unit} where radians are expected; convert, or state the unit in the mapping"
        yield Reading(Fault("steering_unit", text), steered(partial(np.multiply, float(radians))))
    period = float(np.max(steer))
    if np.min(steer) >= 0.0 and period > 0.0:
        for factor in (1.0, 1.001, 1.01):
            text = f"steer_rad: it wraps at {factor * period:.3g} rad (an absolute encoder); unwrap it about its zero"

            def unwrapped(angle: FloatArray, full: float = factor * period) -> FloatArray:
                return np.where(angle > 0.5 * full, angle - full, angle)

            yield Reading(Fault("steering_wraps", text), steered(unwrapped))
    if float(np.max(np.abs(steer))) > LARGEST_STEERING_RAD:
        text = "steer_rad: found angles some {:.3g} times the wheel's (the motor's?); divide by the gear"
        yield from _geared("steering_gear", text, steered, 1)


#: of wrong settings
TRACK_FACTORS: Final = {0.5: "half the track", 2.0: "twice the track"}
RADIUS_FACTORS: Final = {
    0.5: "half the radius: twice the counts per revolution, or the radius for the diameter",
    2.0: "twice the radius: half the counts per revolution, or the diameter for the radius",
    4.0: "four times the radius: a quarter of the counts per revolution (quadrature)",
    0.25: "a quarter of the radius: four times the counts per revolution (quadrature)",
    float(np.pi): "pi times the radius",
    1.0 / 0.3048: "1 / 0.3048 times: positions in feet taken for m",
    1.0 / 0.0254: "1 / 0.0254 times: positions in inches taken for m",
    1e-3: "a thousandth: positions in m taken for mm, or lengths of the settings in mm taken for m",
    1e3: "a thousand times: positions in mm taken for m",
    1e-2: "a hundredth: positions in m taken for cm, or lengths of the settings in cm taken for m",
    1e2: "a hundred times: positions in cm taken for m",
    float(np.pi / 180.0): "pi / 180 times: angles of the wheels in degrees taken for rad",
    float(180.0 / np.pi): "180 / pi times: angles of the wheels in rad taken for degrees",
}
RADII: Final = ("radius_left_m", "radius_right_m", "front_radius_m", "rear_radius_m", "wheel_radius_m")
#: a radius off by more is no radius, no matter what made it
FARTHEST: Final = 5.0
#: a measured radius is nearer to the one at work; a gear's ratio may be any
_KNOWN_RADIUS: Final = 0.01
#: a length further off is a wrong setting; rubber, wear and load stay within it
PLAUSIBLE_CHANGE: Final = 0.15
#: a track may be an effective one, of a wide tread
PLAUSIBLE_TRACK_CHANGE: Final = 0.3
#: what a track too wide for two wheels may be
SKID_HINT: Final = ' (an effective track? of wheels that skid in turns state drive = "skid")'


def implausible(name: str, ratio: float, most: float, drive: str) -> bool:
    """Return whether a length is off by more than a share `most`; the track of a skid-steered `drive` may be wider."""
    return not -most <= ratio - 1.0 <= (SKID_TRACK - 1.0 if drive == "skid" and name == "track_m" else most)


def implausible_lengths(fitted: Fitted, drive: str) -> list[str]:
    """Return a `drive`'s determined lengths further from those stated than wheels and floors make them."""
    sentences, parameters, free = [], fitted.parameters, fitted.parameters.free
    sizes = zip(parameters.free_names, parameters.nominal[free], fitted.solution.values[free], strict=True)
    for name, nominal, value in sizes:
        length = name.startswith(("track", "wheelbase")) or "radius" in name
        if not nominal or not length or name in fitted.undetermined:
            continue
        change, track = value / nominal - 1.0, name == "track_m"
        if implausible(name, value / nominal, PLAUSIBLE_TRACK_CHANGE if track else PLAUSIBLE_CHANGE, drive):
            also = "; play or lag of the steering acts alike: see 'calib diagnose'" if name == "wheelbase_m" else ""
            sentences.append(
                f"{name} is {100 * change:+.3g} % from the stated {nominal:.6g}, more than wheels can change: check "
                f"lengths, counts per revolution and units{SKID_HINT if track and change > 0.0 else also}"
            )
    return sentences


def factor_faults(
    ratios: Mapping[str, float], drive: str = "differential", speeds: Sequence[str] = ()
) -> tuple[Fault, ...]:
    """Return faults of settings that leave a factor on a `drive`'s lengths.

    `ratios`: found over nominal, by parameter; `speeds`: columns that stand for counts.
    """
    faults = []
    track = ratios.get("track_m", 1.0)
    factors = _speed_factors(speeds, turns=1.0 / FARTHEST < track < FARTHEST) if speeds else RADIUS_FACTORS
    for name in ("track_m", "half_length_plus_half_width_m"):
        if name in ratios and implausible(name, ratio := ratios[name], NEAR, drive):
            faults += _factor(name, ratio, TRACK_FACTORS, SKID_HINT if ratio > 1.0 and name == "track_m" else "")
    for name, ratio in ratios.items():
        if name in RADII:
            explained = _factor(name, ratio, factors)
            if not explained and ratio > 0.0 and not 1.0 / FARTHEST < ratio < FARTHEST:
                text = f"{name} is {ratio:.3g} times the nominal value; check counts per revolution and units"
                explained = [Fault("radius_factor", text)]
            faults += explained
    return tuple(faults)


def _speed_factors(speeds: Sequence[str], *, turns: bool) -> dict[float, str]:
    times, lengths = "t_s in ms taken for s", f"{speeds[0]} in mm/s taken for m/s"
    what = f"{times}, or {lengths}" if TWIST not in speeds else times if turns else lengths
    return {1e-3: f"a thousandth: {what}", 1.0 / 3.6: f"1 / 3.6 times: {speeds[0]} in km/h taken for m/s"}


def _factor(name: str, ratio: float, factors: dict[float, str], hint: str = "") -> list[Fault]:
    factor = min(factors, key=lambda one: abs(ratio / one - 1.0))
    if abs(ratio / factor - 1.0) >= NEAR:
        return []
    meaning = factors[factor]
    if name in RADII and abs(ratio / factor - 1.0) > _KNOWN_RADIUS:
        meaning += f", or a gear of {1.0 / ratio:.3g} between counter and wheel"
    text = f"{name} is {ratio:.3g} times the nominal value, {meaning}{hint}; correct the settings or the mapping"
    return [Fault("radius_factor" if name in RADII else "half_track", text)]
