"""A campaign driven again, with a planted effect or an outside cause, and its own noise redrawn."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import combinations
from typing import Any, Final

import numpy as np

from calib.campaign.settings import FrontModel
from calib.gap.observations import Observations
from calib.plant import Moment, World, build_world, standardised
from calib.plant.design import Design
from calib.types import BoolArray, FloatArray, IntArray, floats

#: fewest exchangeable units: with fewer draws repeat
MIN_EXCHANGEABLE: Final = 8


@dataclass(frozen=True, slots=True, eq=False)
class OwnNoise:
    """Residuals of the diagnosis, less the mean of repeats, and which units are exchangeable.

    A unit's channels stay together: tails and correlations are the real ones.
    """

    whitened: FloatArray  #: shape (n_units, 6)
    root: FloatArray  #: shape (n_units, 6, 6): cholesky factor of the covariance
    group: IntArray  #: shape (n_units,): units of one number are exchangeable
    repeated: BoolArray  #: shape (n_units,)

    def draw(self, rng: np.random.Generator) -> FloatArray:
        """Return one draw, shape (n_units, 6), in metres and radians."""
        n_units = len(self.group)
        chosen = np.arange(n_units)
        for number in np.unique(self.group):
            members = np.flatnonzero(self.group == number)
            chosen[members] = rng.choice(members, len(members))
        sign = np.where(self.repeated[chosen], 1.0, rng.choice([-1.0, 1.0], n_units))
        return np.asarray(np.einsum("uij,uj->ui", self.root, self.whitened[chosen] * sign[:, None]))


def own_noise(observations: Observations, left: FloatArray, covariance: FloatArray) -> OwnNoise:
    """Return the noise of what a fit leaves (n_units, 6) under its covariance (n_units, 6, 6)."""
    # exchangeable are units of one condition, else of one route, else with the same channels
    channels = observations.usable @ (2 ** np.arange(6))
    alike = (observations.condition, observations.kind, np.zeros_like(channels))
    rings = [np.unique(by.astype(np.int64) * 64 + channels, return_inverse=True)[1] for by in alike]
    group = rings[2] + rings[0].max() + rings[1].max() + 2
    for offset, ring in ((rings[0].max() + 1, rings[1]), (0, rings[0])):
        group = np.where(np.bincount(ring)[ring] >= MIN_EXCHANGEABLE, ring + offset, group)
    root = floats(np.linalg.cholesky(covariance))
    kept = np.where(observations.usable, left, 0.0)[:, :, None]
    whitened = floats(np.linalg.solve(root, kept)[:, :, 0])
    size = np.bincount(rings[0])[rings[0]]
    for number in np.flatnonzero(np.bincount(rings[0]) > 1):
        members = rings[0] == number
        n = int(members.sum())
        whitened[members] = (whitened[members] - whitened[members].mean(axis=0)) * np.sqrt(n / (n - 1))
    return OwnNoise(whitened, root, group, size > 1)


#: change, also in standard deviations of its noise, by which a steering sensor has reversed
MIN_REVERSAL_RAD: Final = 2e-3
MIN_REVERSAL_STD: Final = 6.0


def true_angles(read: FloatArray, time_s: FloatArray, last: IntArray, world: World) -> FloatArray:
    """Return true angles (n_steps_most, n_units) that the world's sensor reads as logged."""
    true = (read - world.steer_zero_rad) / world.steer_scale
    if world.steer_backlash_rad.any():
        true = true + 0.5 * world.steer_backlash_rad * _side(true, last)
    if world.steer_delay_s.any():
        late = np.broadcast_to(world.steer_delay_s, last.shape)
        true = true.copy()
        for unit, end in enumerate(last + 1):
            at = time_s[:end, unit]
            true[:end, unit] = np.interp(at + late[unit], at, true[:end, unit])
    return true


def _side(angle: FloatArray, last: IntArray) -> FloatArray:
    side = np.zeros_like(angle)
    bent = [np.abs(np.diff(angle[: end + 1, unit], 2)) for unit, end in enumerate(last)]
    noise = 1.4826 * float(np.median(np.concatenate(bent))) / np.sqrt(6.0) if any(map(len, bent)) else 0.0
    least = max(MIN_REVERSAL_RAD, MIN_REVERSAL_STD * noise)
    low, high = angle[0].copy(), angle[0].copy()
    now = np.zeros(angle.shape[1])
    for step, value in enumerate(angle):
        high = np.where(now >= 0, np.maximum(high, value), high)
        low = np.where(now <= 0, np.minimum(low, value), low)
        up = (now < 1) & (value - low > least)
        down = (now > -1) & (high - value > least) & ~up
        now = np.where(up, 1.0, np.where(down, -1.0, now))
        high, low = np.where(up, value, high), np.where(down, value, low)
        side[step] = now
    return side


#: span over which a speed is smoothed before it is differentiated, also in steps
SMOOTH_S, MOST_STEPS = 0.5, 50
MAX_STRAIGHT_TURN_RAD: Final = 0.5
ZERO_WHERE_UNKNOWN: Final = ("payload_kg", "payload_x_m", "payload_y_m", "minutes_under_load")
#: fields of `Moment` that the log gives
LOGGED: Final = ("v_mps", "acceleration_mps2", "curvature_per_m", "angle_left_rad", "angle_right_rad")

Act = Callable[[World], None]


def _design(observations: Observations) -> Design:
    n_units = len(observations)

    def number(name: str) -> FloatArray:
        values = observations.number(name)
        known = np.isfinite(values)
        return np.where(known, values, values[known].mean() if known.any() else 0.0)

    straight = observations.total(np.abs(observations.turn_rad)) < MAX_STRAIGHT_TURN_RAD
    names = np.array([f"{'corridor' if s else 'route'}_{k}" for s, k in zip(straight, observations.kind, strict=True)])
    speed = number("speed_mps")
    if not speed.any():
        elapsed, way = (observations.total(part) for part in (observations.duration_s, np.abs(observations.path_m)))
        speed = np.divide(way, elapsed, out=np.zeros_like(way), where=elapsed > 0)
    unstated: dict[str, Any] = {name: np.nan_to_num(observations.number(name)) for name in ZERO_WHERE_UNKNOWN}
    return Design(
        kind=names,
        direction=observations.labels["direction"],
        session=observations.labels["session"],
        **unstated,
        speed_mps=speed,
        temperature_C=number("temperature_C"),
        flying=np.zeros(n_units, dtype=bool),
        stops=np.zeros(n_units, dtype=np.int64),
        length_m=float(np.max(observations.length_m, initial=1e-3)),
        vehicle=observations.vehicle,
    )


def _world(observations: Observations, design: Design) -> World:
    world = build_world(design, observations.model)
    left, right = observations.number("load_left_N"), observations.number("load_right_N")
    # stated payloads keep the plant's statics: another payload changes both
    stated = np.isfinite(left) & np.isfinite(right) & (np.ptp(design.payload_kg) == 0)
    world.load_left_N = np.where(stated, left, world.load_left_N)
    world.load_right_N = np.where(stated, right, world.load_right_N)
    world.believed_left_m, world.believed_right_m = observations.radius_left_m, observations.radius_right_m
    return world


@dataclass(frozen=True, slots=True, eq=False)
class Replay:
    """A campaign's route, ready to be driven in other worlds."""

    observations: Observations
    design: Design  #: what was driven, as the plant's forms ask for it
    #: logged steps of every unit, zeros beyond, shape (n_steps_most, n_units): smoothed motion as in `Moment`; rotation
    #: of the wheels, duration, end; way and angle of a driven front wheel
    steps: Mapping[str, FloatArray]
    last: IntArray  #: shape (n_units,): last step of each unit

    @staticmethod
    def of(observations: Observations) -> "Replay":
        """Return the replay of a campaign."""
        lengths = observations.lengths
        shape = (int(lengths.max()), len(observations))
        place = np.arange(len(observations.unit)) - np.repeat(observations.starts[:-1], lengths)

        def wide(steps: FloatArray) -> FloatArray:
            laid = np.zeros(shape)
            laid[place, observations.unit] = np.nan_to_num(steps)
            return laid

        same = ("roll_left_rad", "roll_right_rad", "duration_s", "time_s", "curvature_per_m")
        steps = {name: wide(getattr(observations, name)) for name in same}
        known = observations.duration_s[observations.duration_s > 0.0]
        half = int(np.clip(np.rint(0.5 * SMOOTH_S / np.median(known)), 0, MOST_STEPS)) if len(known) else 0
        speed = wide(observations.smoothed(observations.speed_mps, half))
        change = np.diff(speed, axis=0, prepend=speed[:1])
        front = observations.model.front or FrontModel(0.0, 1.0)
        if observations.by_front:
            front = observations.model.steered(observations.vehicle)
        with np.errstate(divide="ignore", invalid="ignore"):
            acceleration = np.where(steps["duration_s"] > 0, change / steps["duration_s"], 0.0)
        steps |= {
            "v_mps": speed,
            "acceleration_mps2": acceleration,
            "angle_left_rad": wide(observations.phase_left_rad),
            "angle_right_rad": wide(observations.phase_right_rad),
            "front_m": front.radius_m * wide(observations.front_roll_rad),
            "steer_rad": front.scale * wide(observations.steer_rad) + front.zero_rad,
        }
        return Replay(observations, _design(observations), steps, lengths - 1)

    def readings(self, act: Act | None, *, level: bool = False) -> FloatArray:
        """Return distance, x, y, heading, path and turn as read at each unit's end, (n_units, 6).

        `level` removes the mean change of the radii, as a calibration does.
        """
        world = _world(self.observations, self.design)
        if act is not None:
            act(world)
        if level:
            mean = 0.5 * (world.left.mean() + world.right.mean())
            world.left, world.right = world.left / mean, world.right / mean
        return _instruments(self, world, *_driven(self, world))

    def change(self, act: Act, *, level: bool = False) -> FloatArray:
        """Return what a cause does to the readings, shape (n_units, 6)."""
        return self.readings(act, level=level) - self.readings(None)


def _driven(replay: Replay, world: World) -> tuple[Moment, FloatArray, FloatArray]:
    steps, n_units = replay.steps, len(replay.observations)
    now = Moment.at_rest(n_units)
    path = np.zeros(n_units)
    poses = np.zeros((3, len(steps["time_s"]), n_units))
    angles = None
    if replay.observations.by_front:
        angles = true_angles(steps["steer_rad"], steps["time_s"], replay.last, world)
    left_m, right_m = world.believed_left_m * world.left, world.believed_right_m * world.right
    track_m = world.model.track_m * world.track
    for step, duration in enumerate(steps["duration_s"]):
        now.t_s = float(steps["time_s"][step].max())
        for name in LOGGED:
            setattr(now, name, steps[name][step])
        if world.during:
            now.added.fill(0.0)
            for effect in world.during:
                effect(now)
        left = steps["roll_left_rad"][step] * left_m * (1.0 + now.left) / (1.0 - now.lost_left)
        right = steps["roll_right_rad"][step] * right_m * (1.0 + now.right) / (1.0 - now.lost_right)
        way = 0.5 * (left + right) / (1.0 + world.rise)
        turn = (right - left) / (track_m * (1.0 + now.track)) + now.yaw_radps * duration
        if angles is not None:
            ahead, curve = _steered(replay, world, step, angles[step])
            # a wheel that slips is counted further than the vehicle moves
            way, turn = way * ahead / (1.0 + now.drive), (turn * ahead + curve) / (1.0 + now.drive)
        middle = now.theta_rad + 0.5 * turn
        chord, drift = way * np.sinc(turn / (2 * np.pi)), now.lateral_mps * duration
        now.x_m = now.x_m + chord * np.cos(middle) - drift * np.sin(middle)
        now.y_m = now.y_m + chord * np.sin(middle) + drift * np.cos(middle)
        now.theta_rad = now.theta_rad + turn
        path += way
        poses[:, step] = now.x_m, now.y_m, now.theta_rad
    units = np.arange(n_units)
    now.v_mps, now.curvature_per_m = (steps[name][replay.last, units] for name in ("v_mps", "curvature_per_m"))
    return now, path, _seen(replay, poses, now, world.latency_s)


def _seen(replay: Replay, poses: FloatArray, end: Moment, late_s: FloatArray) -> FloatArray:
    """Return each unit's pose `late_s` before its end, (3, n_units)."""
    from scipy.interpolate import PchipInterpolator

    way_m, theta = late_s * end.v_mps, end.theta_rad
    seen = [end.x_m - way_m * np.cos(theta), end.y_m - way_m * np.sin(theta), theta - way_m * end.curvature_per_m]
    then = np.stack(seen)
    for unit in np.flatnonzero(late_s > 0.0):
        time_s = replay.steps["time_s"][: replay.last[unit] + 1, unit]
        if len(time_s) > 1 and (np.diff(time_s) > 0.0).all():
            pose = PchipInterpolator(time_s, poses[:, : len(time_s), unit], axis=1)
            then[:, unit] = pose(max(time_s[-1] - late_s[unit], time_s[0]))
    return then


def _steered(replay: Replay, world: World, step: int, true: FloatArray) -> tuple[FloatArray, FloatArray]:
    read, way = replay.steps["steer_rad"][step], replay.steps["front_m"][step]
    wheelbase_m = world.model.steered(replay.observations.vehicle).wheelbase_m
    if replay.observations.by_shaft:
        return np.ones_like(true), way * (np.tan(true) - np.tan(read)) / wheelbase_m
    ahead = np.cos(true) / np.cos(read)
    return ahead, way * (np.sin(true) - ahead * np.sin(read)) / wheelbase_m


def _instruments(replay: Replay, world: World, end: Moment, path_m: FloatArray, seen_late: FloatArray) -> FloatArray:
    x, y, theta = end.x_m, end.y_m, end.theta_rad
    x_late, y_late, theta_late = seen_late
    axis = replay.observations.axis
    line = np.where(np.abs(axis) == 1, axis * x, np.where(axis == 2, np.hypot(x, y), np.abs(path_m)))
    distance = world.laser_scale * line + world.laser_offset_m
    if replay.observations.windowed:
        v, omega = replay.steps["v_mps"][0], replay.steps["v_mps"][0] * replay.steps["curvature_per_m"][0]
        x_late, theta_late = x_late + world.latency_s * v, theta_late + world.latency_s * omega
    seen = world.seen_target(x_late, y_late, theta_late, world.ref_yaw_rad)
    return np.stack([distance, *seen, theta_late, path_m, theta], axis=1)


SizedAct = Callable[[World, float], None]

#: outside cause -> size at which it is tried first
OUTSIDERS: Final = {"interaction": 1e-3, "one_speed": 2e-3, "left_turns": 1e-2, "unlogged": 1e-3}

#: largest correlation of two columns that vary apart
MAX_CORRELATION: Final = 0.9
#: width of the resonance over its speed
RESONANCE_WIDTH: Final = 0.1
#: smallest curvature of a left turn that counts
MIN_CURVATURE_PER_M: Final = 0.05


def outsiders(replay: Replay, rng: np.random.Generator) -> dict[str, SizedAct | str]:
    """Return each outside cause, or why this campaign cannot have it."""
    columns = _uncorrelated_columns(replay)
    speeds = np.unique(np.round(replay.design.speed_mps, 2))
    condition = replay.observations.condition
    n_repeated = int((np.bincount(condition) > 1).sum())
    drawn = rng.standard_normal((2, int(condition.max()) + 1))
    turns_left = bool((replay.observations.turn_rad > 0).any())
    crossed = None if columns is None else _on_both_radii(_standardised(columns[0]) * _standardised(columns[1]))
    return {
        "interaction": crossed or "no two columns vary apart",
        "one_speed": "all runs have one speed" if len(speeds) < 2 else _one_speed(float(speeds[len(speeds) // 2])),
        "left_turns": _left_turns if turns_left else "nothing turns left",
        "unlogged": "fewer than three conditions have repeats" if n_repeated < 3 else _unlogged(drawn, condition),
    }


def _on_both_radii(share: FloatArray) -> SizedAct:
    return lambda world, size: world.enlarge(size * share)


def _standardised(values: FloatArray) -> FloatArray:
    return standardised(np.where(np.isfinite(values), values, np.nanmean(values)))


def by_column(values: FloatArray) -> SizedAct:
    """Return what makes both radii larger by a column (n_units,), in standard deviations."""
    return _on_both_radii(_standardised(values))


def _uncorrelated_columns(replay: Replay) -> tuple[FloatArray, FloatArray] | None:
    design, observations = replay.design, replay.observations
    order = np.arange(len(observations), dtype=np.float64)
    driven = (design.temperature_C, design.speed_mps, design.minutes_under_load)
    candidates = (observations.number("load_left_N"), *driven, observations.length_m, order)
    varying = [v for v in candidates if np.isfinite(v).all() and np.std(v) > 1e-6 * (1e-3 + np.abs(np.mean(v)))]
    return next(
        (pair for pair in combinations(varying, 2) if abs(float(np.corrcoef(*pair)[0, 1])) < MAX_CORRELATION), None
    )


def _one_speed(at_mps: float) -> SizedAct:
    def during(size: float, now: Moment) -> None:
        now.roll_more(size * np.exp(-(((np.abs(now.v_mps) - at_mps) / (RESONANCE_WIDTH * at_mps)) ** 2)))

    return lambda world, size: world.during.append(partial(during, size))


def _left_turns(world: World, size: float) -> None:
    def during(now: Moment) -> None:
        now.track += size * (now.curvature_per_m * np.sign(now.v_mps) > MIN_CURVATURE_PER_M)

    world.during.append(during)


def _unlogged(drawn: FloatArray, condition: IntArray) -> SizedAct:
    left, right = drawn[0, condition], 0.7 * (drawn[0, condition] + drawn[1, condition])
    return lambda world, size: world.enlarge(size * left, size * right)
