"""The front wheel: errors of its steering angle."""

from typing import Final

import numpy as np

from calib.gap import Perturbation, joined_perturbation
from calib.gap.effects import Effect, Family, Form, Parameter, always
from calib.gap.observations import Channel, Observations
from calib.kinematics.blunders import still_steering, straight_reading_rad
from calib.types import BoolArray, FloatArray, IntArray

#: an angle is judged beside a smaller offset of its zero: beside 0.5 rad a play was named
FARTHEST_STRAIGHT_RAD: Final = 0.35


def has_front(observations: Observations) -> BoolArray:
    """Return which observations have front counts and steering angle, (n_obs,)."""
    if observations.by_front:
        return np.isfinite(observations.total(observations.front_roll_rad + observations.steer_rad))
    return observations.usable[:, Channel.STEERING]


def front_travel_m(observations: Observations) -> FloatArray:
    """Return the front wheel's travel of each step, 0 where not logged, (n_steps,)."""
    logged = has_front(observations)[observations.unit]
    roll_rad = np.where(logged, np.nan_to_num(observations.front_roll_rad), 0.0)
    return roll_rad * observations.model.steered(observations.vehicle).radius_m


def front_turn_rad(observations: Observations) -> FloatArray:
    """Return each step's turn by the front wheel, 0 where not logged, (n_steps,)."""
    return front_travel_m(observations) * observations.steer_sin / observations.vehicle.wheelbase_m


def steer_rad(observations: Observations) -> FloatArray:
    """Return each step's logged steering angle, 0 where not logged, (n_steps,)."""
    return np.nan_to_num(observations.steer_rad)


def excess(observations: Observations, ahead_m: FloatArray, turn_rad: FloatArray) -> Perturbation:
    """Return what it does that the front wheel says more than is true, by these excesses of way and turn in each step.

    Where rear wheels drive the odometry, the front channels grow by it; else the vehicle moves less.
    """
    if observations.by_front:
        return Perturbation(along_m=-ahead_m, heading_rad=-turn_rad)
    front, steering = observations.total(ahead_m), observations.total(turn_rad)
    return Perturbation.on_readings(observations, front=front, steering=steering)


def angle_error(observations: Observations, error_rad: FloatArray, exact_at: float = 0.0) -> Perturbation:
    """Return what it does that the logged steering angle is too large by `error_rad`, shape (n_steps,), per unit.

    The heading by steering is then too large by ds cos(delta) error / L, and the distance by the front wheel too small
    by ds sin(delta) error. `exact_at`: size at which sine and cosine are of the whole error.
    """

    def acts(part: Observations, error: FloatArray) -> Perturbation:
        travel_m, sine, cosine = front_travel_m(part), part.steer_sin, part.steer_cos
        if part.by_shaft:
            # where the way is counted behind the steering, the curvature is tan(delta) / L
            tangent = np.tan(exact_at * error)
            turn = (sine**2 + 1.0) * (tangent / (1.0 + sine * tangent) / exact_at if exact_at else error)
            ahead = np.zeros_like(travel_m)
        elif exact_at:
            less, aside = np.cos(exact_at * error) - 1.0, np.sin(exact_at * error)
            ahead, turn = (-(cosine * less + sine * aside) / exact_at, (cosine * aside - sine * less) / exact_at)
        else:
            ahead, turn = -error * sine, error * cosine
        return excess(part, travel_m * ahead, travel_m * turn / part.vehicle.wheelbase_m)

    edges = observations.starts
    errors = ((units, error_rad[edges[units.start] : edges[units.stop]]) for units in observations.spans)
    return joined_perturbation(
        observations, ((units, acts(observations.part(units), error)) for units, error in errors)
    )


class SteeringZero(Effect):
    """The logged angle is too large by delta_0, minus the zero of `geometry`: e_delta = S delta_0 / L on a straight."""

    id = "steering_zero"
    title = "a steering angle whose zero is off"
    implausible = "backlash, or rear wheels of unequal radius"
    family = Family.STEERING
    needs = "the front wheel in the log"
    separates = "forward and back"

    def forms(self, observations: Observations) -> list[Form]:
        """See `Effect`."""
        if not has_front(observations).any():
            return []
        parameter = Parameter("zero", "rad", typical=8e-3, largest=3.5e-2)
        error = angle_error(observations, np.ones(len(observations.unit)), _straight_ahead_rad(observations))
        return [Form(self.id, "", (parameter,), always(error))]


def steering_blunder(observations: Observations) -> str:
    """Return what is wrong with an angle that no vehicle steers by; empty where it is right or unused."""
    headed = observations.usable[:, Channel.HEADING] & has_front(observations)
    if not observations.by_front or not headed.any():
        return ""
    rolled, turned_rad = observations.total(front_travel_m(observations)), observations.measured[:, Channel.HEADING]
    still = still_steering(steer_rad(observations), rolled[headed], turned_rad[headed], observations.run[headed])
    found_rad = _straight_ahead_rad(observations)
    if still or abs(found_rad) <= FARTHEST_STRAIGHT_RAD:
        return still
    return (
        f"found {found_rad:.3g} rad ({np.degrees(found_rad):.0f} degrees) where the wheels stand straight ahead; "
        f"expected 0 within {FARTHEST_STRAIGHT_RAD:g} rad; subtract that from the column"
    )


def _straight_ahead_rad(observations: Observations) -> float:
    headed = observations.usable[:, Channel.HEADING] & has_front(observations)
    if not observations.by_front:
        return 0.0
    measured_rad = observations.measured[headed, Channel.HEADING]
    # its whole turns are those of the path that the angle itself bends
    for turned_rad in (measured_rad, np.angle(np.exp(1j * measured_rad))):
        found_rad = straight_reading_rad(
            front_travel_m(observations),
            steer_rad(observations),
            turned_rad,
            lambda steps: observations.total(steps)[headed],
        )
        if np.isfinite(found_rad):
            return found_rad
    return 0.0


class SteeringScale(Effect):
    """The logged angle is (1 + k) times the true one, or the wheelbase is (1 + k) times the believed one."""

    id = "steering_scale"
    title = "a steering angle of wrong scale, or a wrong wheelbase"
    implausible = "slip of the front wheel"
    family = Family.STEERING
    needs = "the front wheel in the log, turned"
    separates = "several steering angles"
    wrong_beyond = 0.3

    def forms(self, observations: Observations) -> list[Form]:
        """See `Effect`."""
        angle = steer_rad(observations)
        if not has_front(observations).any() or not (np.abs(angle) > 0.02).any():
            return []
        parameters = (Parameter("relative", "1", typical=1e-2, largest=1e-1),)
        # the distance by the front wheel knows nothing of the wheelbase
        longer = excess(observations, np.zeros_like(angle), front_turn_rad(observations))
        scaled = always(angle_error(observations, angle))
        return self.offer([("scale of the angle", parameters, scaled), ("wheelbase", parameters, always(longer))])


#: logged angle from which on a step belongs to a turn
TURN_ANGLE_RAD: Final = 0.02
#: logged angle below which nothing moves, however fine the sensor
STILL_ANGLE_RAD: Final = 2e-3
#: plays that are tried; the least stands for the side of the last move
PLAYS_RAD: Final = (2e-3, 8e-3, 2e-2)
#: way to either side for the rear wheels' turn: for less the counters are coarse
SMOOTHING_M: Final = 0.2


class SteeringBacklash(Effect):
    """Play lies between the wheel and the sensor of its angle.

    Where the sensor sits at the motor, the logged angle is ahead of the wheel by half the play on the side of the last
    moves. Where it sits beyond the play, it follows what the rear wheels tell, and lags.
    """

    id = "steering_backlash"
    title = "backlash in the steering"
    implausible = "a steering angle whose zero is off"
    family = Family.STEERING
    needs = "the front wheel in the log, turned both ways"
    separates = "one angle approached from the left and from the right"

    def forms(self, observations: Observations) -> list[Form]:
        """See `Effect`."""
        angle = steer_rad(observations)
        if not has_front(observations).any() or not (np.abs(angle) > TURN_ANGLE_RAD).any():
            return []
        parameters = (Parameter("play", "rad", typical=8e-3, largest=4e-2, sign=1),)
        # only a clear turn has a side: near zero the sign is noise
        by_side = np.where(np.abs(angle) > TURN_ANGLE_RAD, np.sign(angle), 0.0)
        noise = _noise_rad(observations, angle)
        # to a coarse sensor a turn alone is a move
        band = STILL_ANGLE_RAD if 6.0 * noise < STILL_ANGLE_RAD else max(TURN_ANGLE_RAD, 6.0 * noise)
        moved = np.where(np.abs(angle) > band, angle, 0.0)
        wheel = _wheel_rad(observations, angle)
        rough = _noise_rad(observations, wheel)
        errors: list[tuple[str, FloatArray, dict[str, float]]] = []
        for play in PLAYS_RAD:
            label, settings = f"through {1e3 * play:g} mrad", {"play_rad": play}
            ahead = _lost_in_play(observations, moved, play, 6.0 * noise) / play
            behind = -_lost_in_play(observations, wheel, play, 3.0 * rough) / play
            errors.append((f"by the moves of the motor, {label}", ahead, settings))
            errors.append((f"by the moves of the wheel, {label}", behind, settings))
        errors.append(("by the side of the turn", 0.5 * by_side, {}))
        return [
            Form(self.id, label, parameters, always(angle_error(observations, error)), settings, len(errors))
            for label, error, settings in errors
        ]


def _noise_rad(observations: Observations, angle: FloatArray) -> float:
    inside = np.flatnonzero(observations.unit[2:] == observations.unit[:-2])
    bent = np.abs(angle[inside + 2] - 2.0 * angle[inside + 1] + angle[inside])
    bent = bent[np.isfinite(bent)]
    return float(1.4826 * np.median(bent) / np.sqrt(6.0)) if len(bent) else 0.0


def _wheel_rad(observations: Observations, angle: FloatArray) -> FloatArray:
    # by a line through the rear wheels' headings to either side, less the median on the straight;
    # NaN where the vehicle hardly moves
    steered = np.concatenate([_bend_rad(part) for part in observations.parts()])
    straight = (np.abs(angle) < TURN_ANGLE_RAD) & np.isfinite(steered)
    return steered - (np.median(steered[straight]) if straight.any() else 0.0)


def _bend_rad(observations: Observations) -> FloatArray:
    # from each start on: squares over many runs leave nothing of a difference
    turn, path = observations.cumulative(observations.turn_rad), observations.cumulative(observations.path_m)
    way = np.cumsum(np.abs(observations.path_m))
    index = np.arange(len(way))
    first = np.minimum(np.searchsorted(way, way - SMOOTHING_M), index - 1)
    last = np.maximum(np.searchsorted(way, way + SMOOTHING_M, side="right") - 1, index + 1)
    first = np.maximum(first, observations.starts[observations.unit])
    last = np.minimum(last, observations.starts[observations.unit + 1] - 1)
    long_enough = np.abs(path[last] - path[first]) > 0.5 * SMOOTHING_M

    def summed(values: FloatArray) -> FloatArray:
        restarted = values.copy()
        # else the sums of runs before round a difference
        restarted[observations.starts[1:-1]] -= observations.total(values)[:-1]
        running = np.cumsum(restarted)
        return running[last] - running[first] + values[first]

    count = last - first + 1.0
    with np.errstate(divide="ignore", invalid="ignore"):
        variance = summed(path**2) - summed(path) ** 2 / count
        slope = (summed(path * turn) - summed(path) * summed(turn) / count) / variance
    return np.arctan(observations.vehicle.wheelbase_m * np.where(long_enough & np.isfinite(slope), slope, np.nan))


def _side_by_side(observations: Observations) -> tuple[IntArray, IntArray]:
    rows = np.arange(int(observations.lengths.max()))[:, None]
    index = np.minimum(observations.starts[:-1] + rows, observations.starts[1:] - 1)
    return index, np.arange(len(observations.unit)) - observations.starts[observations.unit]


def _lost_in_play(observations: Observations, angle: FloatArray, play: float, least: float) -> FloatArray:
    # the play starts in its middle; below `least` it is taken up by the last move above the noise
    wide = max(play, least)
    index, step = _side_by_side(observations)
    through = angle[index]
    now = np.zeros(through.shape[1])
    for row in through:
        now = np.fmin(np.fmax(now, row - 0.5 * wide), row + 0.5 * wide)
        row[:] = now
    return np.nan_to_num((angle - through[step, observations.unit]) * (play / wide))


#: delays tried beside the tangent: scaled from 0.27 to 0.3 s a shape is off by a tenth, the tangent by half
DELAYS_S: Final = (0.1, 0.2, 0.3, 0.4)


class SteeringDelay(Effect):
    """The logged angle is tau old, so short of the true one by delta(t + tau) - delta(t), nearly tau d(delta)/dt.

    Below 0 it is ahead, as a command is: the wheel follows it later, or as a lag of first order does.
    """

    id = "steering_delay"
    title = "a logged steering angle that lags the wheel, or leads it (below 0)"
    implausible = "a steering angle of wrong scale"
    family = Family.STEERING
    needs = "the front wheel in a log with times"
    separates = "runs that end in a turn"

    def forms(self, observations: Observations) -> list[Form]:
        """See `Effect`."""
        angle = steer_rad(observations)
        rate = rate_per_s(observations, angle, 1)
        if not has_front(observations).any() or not (np.abs(rate) > 1e-3).any():
            return []
        parameters = (Parameter("delay", "s", typical=1e-1, largest=5e-1),)
        # a log that lags by the first order is short by tau d(delta)/dt: the form of a short delay
        errors = {"": (-rate, 0.0)}
        for delay in DELAYS_S:
            errors[f"about {delay:g} s"] = -_moves_within(observations, angle, rate, delay) / delay, delay
            errors[f"about {-delay:g} s"] = _moves_within(observations, angle, rate, -delay) / delay, -delay
            errors[f"a lag of about {delay:g} s"] = -_lag_behind(observations, angle, delay) / delay, -delay

        def form(label: str, error: FloatArray, exact_at: float) -> Form:
            settings, acts = {"shift_s": exact_at} if exact_at else {}, angle_error(observations, error, exact_at)
            return Form(self.id, label, parameters, always(acts), settings, len(errors))

        return [form(label, *error) for label, error in errors.items()]


def _moves_within(observations: Observations, values: FloatArray, rate: FloatArray, delay_s: float) -> FloatArray:
    # past a run's end at its last rate; before its start it stood still
    middle = observations.time_s - 0.5 * observations.duration_s
    if not np.isfinite(middle).all():
        return rate * delay_s
    first, end = (at[observations.unit] for at in (observations.starts[:-1], observations.starts[1:] - 1))
    apart = observations.unit * (np.ptp(middle) + 1.0)
    at = np.clip(middle + delay_s, middle[first], middle[end])
    inside = np.interp(at + apart, middle + apart, values)
    return inside - values + rate[end] * np.maximum(middle + delay_s - middle[end], 0.0)


def _lag_behind(observations: Observations, values: FloatArray, lag_s: float) -> FloatArray:
    index, step = _side_by_side(observations)
    steps = np.maximum(np.nan_to_num(observations.duration_s)[index] / lag_s, 1e-9)
    # exact where the angle moves evenly from the middle of one step to that of the next
    share = -np.expm1(-steps)
    behind = values[index]
    moved = np.diff(behind, axis=0) * (1.0 - share[1:] / steps[1:])
    for row in range(1, len(index)):
        before = values[index[row - 1]]
        behind[row] = behind[row - 1] + share[row] * (before - behind[row - 1]) + moved[row - 1]
    return values - behind[step, observations.unit]


def rate_per_s(observations: Observations, values: FloatArray, reach: int) -> FloatArray:
    """Return the rate of a step quantity over `reach` steps to either side within each run, shape (n_steps,)."""
    index = np.arange(len(values))
    before = np.maximum(index - reach, observations.starts[observations.unit])
    after = np.minimum(index + reach, observations.starts[observations.unit + 1] - 1)
    middle = observations.time_s - 0.5 * observations.duration_s
    with np.errstate(divide="ignore", invalid="ignore"):
        rate = (values[after] - values[before]) / (middle[after] - middle[before])
    return np.where(np.isfinite(rate), rate, 0.0)
