"""Search for blunders and departures that explain a recording.

A blunder (units, axes, columns, wraps) changes the recording, and the vehicle's parameters are fitted again
within plausible bounds. Residuals count relative to the distance travelled, so that no unit makes them small by
itself; a blunder is named where its correction leaves a small part of them.

A departure is one more parameter: a change of the recording of unknown size that no residual need show, fitted beside
those of the vehicle in the linearised problem. It is named where its size is beyond noise, by the scatter between
groups of segments, and of whole runs, where it explains more of the residual than is left without it.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import pairwise
from typing import Final

import numpy as np

from calib.campaign.model import Campaign
from calib.campaign.wheels import smoothed_speed_mps
from calib.errors import CalibError
from calib.kinematics import drives
from calib.kinematics.blunders import Fault
from calib.kinematics.joint_fit import Fitted, drive_of
from calib.kinematics.model import Model, Segments, measured_between
from calib.kinematics.readings import Change, Reading, Setting, implausible, readings, unchanged
from calib.kinematics.recording import Recording
from calib.kinematics.rough_fit import residual_share, rough_fit
from calib.kinematics.solve import solve
from calib.kinematics.uncertainty import whitened
from calib.types import FloatArray

#: a reading is named where it leaves less than this part of what the recording as it stands leaves: a quarter in
#: squares
CLEARLY_LESS: Final = 0.5
#: and less than this share of the distance travelled: what a calibrated vehicle may leave
SMALL_SHARE: Final = 0.03
#: a right reading's displacements are as long as the wheels', within this factor, and point their way, in rad: lengths
#: and mounting angles stay within it
SAME_LENGTH: Final = 1.3
SAME_WAY_RAD: Final = 0.3
#: linearisations of a trial: a right reading is near its end after four, a wrong one never
TRIAL_ROUNDS: Final = 6
#: of these, those that estimate the noise: it only weighs position against heading, and costs most of a trial
TRIAL_NOISE_ROUNDS: Final = 1
#: and up to a step of less log likelihood
TRIAL_STEADY: Final = 0.1
#: a reading that leaves twice as much in a rough fit, or lengths twice as far off as plausible, is not tried: a wrong
#: one mostly leaves ten times as much
SCREENED: Final = 2.0
#: of more than twice so many runs, so many, shortest and longest among them, tell
SCREENED_RUNS: Final = 16
#: readings within this factor of the least are alike: the first, the simplest, is named
ALIKE: Final = 1.3
#: lengths further from nominal are no calibration
PLAUSIBLE_CHANGE: Final = 0.2
#: of the sensor, found beside the lengths; its yaw would be a reading's
PLACE: Final = ("sensor_x_m", "sensor_y_m", "delay_s")
MOUNTED: Final = (*PLACE, "sensor_yaw_rad")
Divide = Callable[["Campaign", Recording], Segments]


@dataclass(frozen=True, slots=True)
class Trial:
    """Residuals under a hypothesis, and whether it is plausible."""

    #: rms residual as a share of the distance and rotation
    share: float
    #: lengths near nominal, displacements of the wheels' length and direction
    plausible: bool
    #: the reference's displacements against the wheels'
    turned_rad: float
    #: fitted mean radius over the nominal one, and scale of the steering angle
    scales: tuple[float, float] = (1.0, 1.0)


def find_blunder(
    campaign: Campaign, recording: Recording, source: str, divide: Divide
) -> tuple[Campaign, Recording, Fault] | None:
    """Return corrected settings and recording, and the blunder; None where none explains the data.

    The campaign states vehicle, encoder and noise of the reference. `source`: wheels that drive the odometry (``rear``,
    ``front``, ``wheels``, ``shaft``); `divide` cuts a recording into segments by a campaign's nominal vehicle.
    """
    try:
        whole = divide(campaign, recording).are_runs_of(recording)
    except CalibError:
        # no reading brings a reference
        return None
    per_rev = float(campaign.encoder.counts_per_rev_left or campaign.encoder.front)
    drive = drive_of(campaign, source, recording)
    travel_rad = recording.travel_rad[recording.offsets[1:] - 1]
    some = np.argsort(travel_rad)[np.linspace(0, len(recording) - 1, SCREENED_RUNS).astype(int)]
    many = len(recording) > 2 * SCREENED_RUNS

    def tried(
        change: Change, setting: Setting | None = None, sensor: tuple[str, ...] = PLACE, *, screened: bool = False
    ) -> Trial:
        stated = setting(campaign) if setting else campaign
        driven = drive_of(stated, source, recording) if setting else drive
        changed = change(recording)
        if screened and _hopeless(stated, changed.select(some) if many else changed, driven, divide):
            return Trial(np.inf, False, 0.0)
        return _tried(stated, changed, driven, divide, sensor)

    as_it_stands, without = tried(unchanged), cache(partial(tried, screened=True))
    # the sensor is none of whole runs' parameters
    turned = as_it_stands if whole else tried(unchanged, sensor=MOUNTED, screened=True)
    # impossible lengths explain nothing, and a sensor that is turned a little no reading
    enough = min([SMALL_SHARE, *(CLEARLY_LESS * trial.share for trial in (as_it_stands, turned) if trial.plausible)])
    best: list[tuple[Trial, Reading]] = []
    for reading in readings(recording, per_rev, drive, as_it_stands.turned_rad, plausible=as_it_stands.plausible):
        trial = tried(reading.change, reading.setting, screened=True)
        if trial.plausible and trial.share >= enough and not whole:
            trial = tried(reading.change, reading.setting, MOUNTED)
        if not trial.plausible or trial.share >= enough:
            continue
        zeroed = without(reading.zeroed) if reading.zeroed else None
        if zeroed is None or not zeroed.plausible or trial.share < CLEARLY_LESS * zeroed.share:
            best.append((trial, reading))
    if not best:
        return None
    least = min(trial.share for trial, _ in best)
    trial, chosen = next(each for each in best if each[0].share <= ALIKE * least)
    if chosen.refined is not None:
        chosen = chosen.refined(trial.scales)
    return chosen.setting(campaign) if chosen.setting else campaign, chosen.change(recording), chosen.blunder


def _model_of(
    campaign: Campaign, recording: Recording, drive: drives.Drive, divide: Divide, sensor: tuple[str, ...]
) -> tuple[Model, drives.Parameters]:
    model = Model(drive, recording, divide(campaign, recording))
    # a lever arm would be a share of each window's short way; whole runs do not tell it from other readings
    placed = () if model.segments.are_runs_of(recording) else sensor
    items = drives.parameters_of(drive, campaign.reference)
    return model, drives.Parameters.of(items, [*(item.name for item in drive.parameters), *placed])


def _hopeless(campaign: Campaign, recording: Recording, drive: drives.Drive, divide: Divide) -> bool:
    try:
        model, parameters = _model_of(campaign, recording, drive, divide, MOUNTED)
        # without headings no linear step tells how a path bends
        if not model.segments.seen[:, 2].all():
            return False
        with np.errstate(all="ignore"):
            values, share = rough_fit(model, parameters, SCREENED * SMALL_SHARE)
    except (CalibError, np.linalg.LinAlgError, ValueError):
        return True
    near = _near_nominal(campaign, drive, values, SCREENED * PLAUSIBLE_CHANGE)
    return not (near and share < SCREENED * SMALL_SHARE)


def _near_nominal(campaign: Campaign, drive: drives.Drive, values: FloatArray, most: float) -> bool:
    return not any(
        implausible(item.name, float(value) / item.nominal, most, campaign.vehicle.drive)
        for item, value in zip(drive.parameters, values, strict=False)
        if item.nominal and not item.name.startswith(("steering", "slope"))
    )


def _tried(
    campaign: Campaign, recording: Recording, drive: drives.Drive, divide: Divide, sensor: tuple[str, ...] = PLACE
) -> Trial:
    scales = drives.first_scales(campaign.reference)
    rounds = (TRIAL_ROUNDS, TRIAL_NOISE_ROUNDS, TRIAL_STEADY)
    try:
        model, parameters = _model_of(campaign, recording, drive, divide, sensor)
        with np.errstate(all="ignore"):
            solution = solve(model, parameters, parameters.nominal, scales, *rounds)
            values, residuals = solution.values, solution.prediction.residuals
            share = residual_share(model, values, residuals)
    except (CalibError, np.linalg.LinAlgError, ValueError):
        return Trial(np.inf, False, 0.0)
    measured = model.segments.measured
    ahead, seen = (part[:, 0] + 1j * part[:, 1] for part in (measured - residuals, measured))
    turned = float(np.angle(np.vdot(ahead, seen)))
    stretched = float(np.sum(np.abs(seen)) / max(float(np.sum(np.abs(ahead))), 1e-12))
    found = dict(zip(parameters.names, values.tolist(), strict=True))
    near = 1.0 / SAME_LENGTH < stretched < SAME_LENGTH and abs(turned) < SAME_WAY_RAD
    near = near and _near_nominal(campaign, drive, values, PLAUSIBLE_CHANGE)
    scale = float(np.mean([found[item.name] / item.nominal for item in drive.parameters if "radius" in item.name]))
    return Trial(share, near, turned, (scale, found.get(drives.STEERING_SCALE, 1.0)))


#: standard deviations by which a size must stand out: a few departures are tried, with the scatter of few groups
CLEAR: Final = 6.0
#: of slip: sound runs have up to 2.2
CLEAR_SLIP: Final = 4.5
#: of an axis: displacements by a laser scanner, which have no axes, make up to 9.4
CLEAR_AXIS: Final = 12.0
#: share of the weighted squares, noise included, that a departure must explain
EXPLAINED: Final = 0.5
#: that one must explain to be followed where the fit is refused: it is named only if the fit corrected for it is not
LEAD: Final = 0.1
PLAYS_RAD: Final = (0.01, 0.04)
#: of a steering angle: from half the least on, which is no step of a log any more
SHIFTS_S: Final = (0.1, 0.3, -0.1, -0.3)
#: scale of a tracking system's axis, from which it is tried
AXIS_SCALE: Final = 0.01
#: resultant of the doubled start headings, above which runs begin along one axis, in either sense
ALONG_ONE: Final = 0.9
#: scale of the reference's heading beside its positions
HEADING_SCALE: Final = 0.005
#: sound clocks differ by 1e-4
CLOCK_RATE: Final = 5e-4
#: recordings, and part of the longest that they differ by, from which their delays tell of a clock
FEWEST_OF_A_CLOCK: Final = 4
OF_TWO_LENGTHS: Final = 0.2
SLIP_S_PER_RAD: Final = 0.01


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
    """Return the departure that explains most, and its size; None where none is clear.

    `misfit`: the residuals speak against the fit: departures that sound ones need no test for are tried, too.
    """
    most, found = 0.0, None
    # beside a delay that nobody estimated, the delay itself looks like a clock
    timed = "delay_s" in fitted.parameters.free_names
    for departure in _departures(fitted.model, timed=timed, misfit=misfit):
        share, size, std = score(fitted, departure)
        clear = abs(size) >= departure.clear * std and size / departure.step > LEAST_SIZE
        if clear and share >= departure.share and share > most:
            most, found = share, (departure, size)
    return found


def hidden_clock(recording: Recording) -> tuple[Departure, float] | None:
    """Return the clock, and its rate, that gives recordings of different lengths their delays."""
    middle_s = 0.5 * recording.t_s[recording.offsets[1:] - 1]
    if len(recording) < FEWEST_OF_A_CLOCK or np.ptp(middle_s) < OF_TWO_LENGTHS * middle_s.max():
        return None
    return Departure(_clocked, CLOCK_RATE, _clock, 0.0), float(np.polyfit(middle_s, recording.delay_added_s, 1)[0])


def score(fitted: Fitted, departure: Departure) -> tuple[float, float, float]:
    """Return the share of squares a departure explains, its size, and that one's standard uncertainty."""
    model, solution = fitted.model, fitted.solution
    recording = departure.change(model.recording, departure.step)
    segments = remeasured(model.segments, model.recording.reference, recording.reference)
    changed = Model(model.drive, recording, segments).residuals(solution.values)
    jacobian, residuals = whitened(solution, fitted.parameters.free)
    shift = np.einsum("nij,nj->ni", solution.whitener, solution.prediction.residuals - changed)
    shift *= np.sqrt(solution.weights)[:, None]
    flat, rest = jacobian.reshape(-1, jacobian.shape[2]), residuals.ravel()
    both = np.column_stack([shift.ravel(), rest])
    # without what the vehicle's parameters explain
    column, rest = (both - flat @ np.linalg.lstsq(flat, both, rcond=None)[0]).T
    information = float(column @ column)
    if information <= 0.0:
        return 0.0, 0.0, np.inf
    steps = float(column @ rest) / information
    runs = model.segments.run
    group = np.repeat(runs if len(np.unique(runs)) >= FEWEST_GROUPS else model.segments.block, 3)
    pulls = np.bincount(group, column * (rest - steps * column))
    std = float(np.sqrt(np.square(pulls).sum())) / information
    share = 1.0 - float(np.square(rest - steps * column).sum() / max(float(rest @ rest), 1e-300))
    return share, steps * departure.step, std * abs(departure.step)


#: runs from which on they are the groups, not blocks of them
FEWEST_GROUPS: Final = 8
#: a size below this part of the one tried is another one's, or of the wrong sign
LEAST_SIZE: Final = 0.5
#: so many times the one tried, a third of an axis or seconds of steering, no linear step reaches
LARGEST_SIZE: Final = 30.0


def remeasured(segments: Segments, before: FloatArray, after: FloatArray) -> Segments:
    """Return the same stretches as another reference measures them; references have shape (3, n_samples)."""
    if after is before:
        return segments
    ends = segments.first, segments.last
    finite = np.isfinite(after[:, ends])
    # of positions alone no heading is needed
    finite[2] |= ~segments.seen[:, 2]
    known = segments.seen & np.asarray(finite.all(axis=(0, 1)))[:, None]
    added = np.subtract(*(measured_between(part, *ends, segments.around) for part in (after, before)))
    return replace(segments, measured=segments.measured + np.where(known, added, 0.0))


def _departures(model: Model, *, timed: bool, misfit: bool) -> Iterator[Departure]:
    whole = model.segments.are_runs_of(model.recording)
    share = EXPLAINED if whole else 0.0
    if model.recording.steps.steer_rad is None:
        yield Departure(partial(_without_slip, drive=model.drive), SLIP_S_PER_RAD, _slip, share, CLEAR_SLIP)
    else:
        yield from (Departure(_without_play, play_rad, _play, share) for play_rad in PLAYS_RAD)
        yield from (Departure(_shifted, shift_s, _shift, share) for shift_s in SHIFTS_S)
    # where all begin at one heading, an axis of the reference is one of the vehicle, which may slide along it
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


def _without_slip(recording: Recording, slip_s_per_rad: float, drive: drives.Drive) -> Recording:
    yaw_radps = np.abs(smoothed_speed_mps(np.cumsum(drives.nominal_turn(drive, recording.steps)), recording.t_s))
    return recording.with_turned(recording.steps.turned_rad / (1.0 + slip_s_per_rad * yaw_radps))


def _slip(slip_s_per_rad: float) -> Fault:
    text = f"the wheels slip by {100 * slip_s_per_rad:.2g} % per rad/s of yaw rate: radii and track hold for these "
    return Fault("turn_slip", f"{text}turns alone; turn slower")


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
    begin_rad = np.repeat(recording.reference[2, recording.offsets[:-1]], np.diff(recording.offsets))
    wound = _stretched(recording, share, 2)
    return wound.with_reference(wound.reference - share * begin_rad * np.array([[0.0], [0.0], [1.0]]))


def _heading_scale(share: float) -> Fault:
    text = f"ref_theta_rad: it turns {100 * abs(share):.2g} % too {'little' if share > 0 else 'much'} beside the path "
    return Fault("heading_scale", f"{text}of its positions; calibrate what measures it (a gyro?)")


def _axis(share: float, name: str) -> Fault:
    text = f"{name}: distances along this axis are {100 * abs(share):.3g} % too {'short' if share > 0 else 'long'} "
    return Fault("axis_scale", f"{text}beside the other; calibrate the tracking system or the camera")
