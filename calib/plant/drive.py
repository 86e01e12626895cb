"""The drive itself: fine time steps, all runs at once, each closed on its own odometry; and what instruments read."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.plant import Moment, NoiseDraw, World
from calib.plant.design import PITCH_M, RouteTables, tabulate
from calib.types import BoolArray, FloatArray, IntArray

STEP_S: Final = 0.02
_ACCELERATION_MPS2: Final = 0.35
_STEER_LAG_S: Final = 0.12
_STEER_RATE_RADPS: Final = 1.2
_STEER_MAX_RAD: Final = 1.2
_CREEP_MPS: Final = 0.02
_PAUSE_S: Final = 0.8
_BLOCK: Final = 128
_SIDES: Final = np.array([[-1.0], [1.0]])
#: a frame: motion, counts of three wheels, the vehicle's own odometry, the pose as it was
_MOTION: Final = ("t_s", "x_m", "y_m", "theta_rad", "v_mps", "steer_rad", "late_rad")
_COUNTS, _ODO, _PAST, _SIZE = 7, 10, 14, 17


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """What happened, at the logs' rate; the last frame of a run is its end."""

    frames: IntArray  #: shape (n_runs,): frames of a run; frame 0 is its start
    #: shape (n_frames, n_runs): true motion in the run's own frame, its end repeated; late_rad: delayed steering angle
    t_s: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    theta_rad: FloatArray
    v_mps: FloatArray
    steer_rad: FloatArray
    late_rad: FloatArray
    #: shape (3, n_frames, n_runs): counters left, right, front since the start; whole numbers where quantised
    counts: FloatArray
    odo: FloatArray  #: shape (4, n_frames, n_runs): the vehicle's own odometry: x, y, theta, path length
    past: FloatArray  #: shape (3, n_frames, n_runs): true x, y, theta the reference's latency ago
    ends: FloatArray  #: shape (17, n_driven): last frame of every run, logged or not

    @staticmethod
    def of(frames: IntArray, stacked: FloatArray, ends: FloatArray) -> "Record":
        """Return the record of frames (17, n_frames, n_runs); see `_Runs.frame`."""
        motion = dict(zip(_MOTION, stacked[:_COUNTS], strict=True))
        counts, odo, past = stacked[_COUNTS:_ODO], stacked[_ODO:_PAST], stacked[_PAST:]
        return Record(frames=frames, **motion, counts=counts, odo=odo, past=past, ends=ends)

    @property
    def end(self) -> "Record":
        """The ends of all runs driven, a frame each."""
        return Record.of(np.ones(self.ends.shape[1], dtype=np.int64), self.ends[:, None], self.ends)

    def last(self, values: FloatArray) -> FloatArray:
        """Return the last frame of each run of an array of shape (..., n_frames, n_runs), shape (..., n_runs)."""
        return values[..., self.frames - 1, np.arange(len(self.frames))]


def drive(
    world: World, noise: NoiseDraw, *, quantise: bool = True, step_s: float = STEP_S, logged: int | None = None
) -> Record:
    """Drive all runs of a world, its path follower on the vehicle's odometry.

    Without `quantise` counts keep fractions, as derivatives need. The first `logged` runs have frames, by default
    all; see `Record.end`.
    """
    design = world.design
    every = max(1, round((design.log_period_s or 0.25) / step_s))
    runs = _Runs(world, noise, quantise, step_s)
    kept = slice(logged)
    frames, final = [runs.frame(kept)], np.zeros((_SIZE, len(design)))
    before_end = np.zeros(len(design), dtype=np.int64)
    longest = float(np.max(runs.tables.end_m / design.speed_mps + (design.stops + 2) * (_PAUSE_S + 6.0))) + 20.0
    for number in range(1, int(longest / step_s) + 1):
        rolling = runs.steer()
        arrived = runs.accelerate(number)
        runs.count(*runs.roll(rolling, number))
        ended = runs.arrive(arrived)
        if len(ended):
            final[:, ended], before_end[ended] = runs.frame(ended), len(frames)
            runs.halt(ended)
        framed = number % every == 0
        if framed:
            frames.append(runs.frame(kept))
        if (framed or len(ended)) and runs.done.all():
            break
    on_the_way = np.flatnonzero(~runs.done)
    final[:, on_the_way], before_end[on_the_way] = runs.frame(on_the_way), len(frames)
    stacked = np.stack([*frames, final[:, kept]], axis=1)
    behind = np.arange(stacked.shape[1])[:, None] >= before_end[kept]
    np.copyto(stacked, final[:, None, kept], where=behind)
    return Record.of(before_end[kept] + 1, stacked, final)


class _Past:
    """Values (n_values, n_runs) of each run's own delay ago."""

    def __init__(self, n_values: int, delay_s: FloatArray, step_s: float) -> None:
        back = delay_s / step_s
        self.whole = np.maximum(np.floor(back), 0.0).astype(np.int64)
        share = back - self.whole
        # a parabola: straight lines would cut every bend
        self.weights = np.stack([0.5 * (1 - share) * (2 - share), share * (2 - share), -0.5 * share * (1 - share)])
        # before its start a run stands
        self.values = np.zeros((int(self.whole.max(initial=0)) + 3, n_values, len(back)))
        self.number = 0

    def add(self, *values: FloatArray) -> None:
        self.number += 1
        self.values[self.number % len(self.values)] = values

    def read(self, at: slice | IntArray) -> FloatArray:
        places = (self.number - self.whole[at] - np.arange(3)[:, None]) % len(self.values)
        values = self.values[places, :, np.arange(len(self.whole))[at]]
        return np.asarray((self.weights[:, at, None] * values).sum(axis=0).T)


class _Runs:
    def __init__(self, world: World, noise: NoiseDraw, quantise: bool, step_s: float) -> None:
        design, model = world.design, world.model
        n_runs = len(design)
        self.world, self.noise, self.quantise, self.step_s = world, noise, quantise, step_s
        weaves = list(zip(world.weave_m.tolist(), world.wavelength_m.tolist(), strict=True))
        lengths = {name: getattr(design, name) for name in ("length_m", "side_m", "radius_m")}
        self.tables = tabulate(design.kind.tolist(), weaves=weaves, **lengths)
        self.wheelbase_m, self.track_m = design.vehicle.wheelbase_m, model.track_m * world.track
        #: left and right wheel, shape (2, n_runs): what the vehicle believes, and what is true
        self.believed_m = np.stack([world.believed_left_m, world.believed_right_m])
        self.radius_m = self.believed_m * [world.left * noise.scale_left, world.right * noise.scale_right]
        self.radius_front_m = design.vehicle.wheel_radius_m * (1.0 + noise.front)
        self.surplus = 1.0 + world.rise
        self.per_rad = design.counts_per_rev / (2 * np.pi)
        self.textured = bool(noise.texture_m.any())
        self.rng = np.random.default_rng(noise.seed)
        self.grain = np.zeros((_BLOCK, 3, n_runs))
        self.stop_m = _stops(world, self.tables)
        self.pointer = np.zeros(n_runs, dtype=np.int64)
        self.target_m = self.stop_m[0]
        look = 0.6 * (design.speed_mps + 0.6)  # follower's length scale
        self.gain_offset, self.gain_heading = 1.0 / look**2, 1.6 / look
        self.preview = ((design.speed_mps * (_STEER_LAG_S + 0.1)) / PITCH_M).astype(np.int64)
        self.now = Moment.at_rest(n_runs)
        self.speed, self.steering, self.progress_m, self.pause_s = (np.zeros(n_runs) for _ in range(4))
        self.angle = np.zeros((3, n_runs))
        self.odo = np.zeros((4, n_runs))
        self.fly_m = np.where(design.flying, self.tables.end_m, np.inf)
        # progress along the plan a metre of odometry: its cosine, over what a bend shortens
        self.ahead, self.bend = np.ones(n_runs), np.ones(n_runs)
        self.done = np.zeros(n_runs, dtype=bool)
        self.past = _Past(1, world.steer_delay_s, step_s) if world.steer_delay_s.any() else None
        self.past_poses = _Past(3, world.latency_s, step_s) if world.latency_s.any() else None

    def frame(self, at: slice | IntArray) -> FloatArray:
        """Return what a record has of these runs now, shape (17, n_runs)."""
        now, counted = self.now, self.angle[:, at] * self.per_rad
        if self.quantise:
            counted = np.floor(counted + self.noise.phase[:, at])
        late = self.steering[at] if self.past is None else self.past.read(at)[0]
        frame = np.empty((_SIZE, len(late)))
        frame[0], frame[1], frame[2], frame[3] = now.t_s, now.x_m[at], now.y_m[at], now.theta_rad[at]
        frame[4], frame[5], frame[6] = now.v_mps[at], self.steering[at], late
        frame[_COUNTS:_ODO], frame[_ODO:_PAST] = counted, self.odo[:, at]
        frame[_PAST:] = frame[1:4] if self.past_poses is None else self.past_poses.read(at)
        return frame

    def steer(self) -> FloatArray:
        tables, odo = self.tables, self.odo
        index = tables.first + (self.progress_m * (1 / PITCH_M)).astype(np.int64)
        np.minimum(index, tables.last, out=index)
        x, y, cos, sin, theta, bend = tables.plan.take(index, axis=1)
        lateral = cos * (odo[1] - y) - sin * (odo[0] - x)
        heading = odo[2] - theta
        kappa = tables.plan[5].take(np.minimum(index + self.preview, tables.last))
        kappa = kappa - self.gain_offset * lateral - self.gain_heading * heading
        wanted = _within(np.arctan(self.wheelbase_m * kappa), _STEER_MAX_RAD)
        change = _within((wanted - self.steering) / _STEER_LAG_S, _STEER_RATE_RADPS) * self.step_s
        rolling = self.steering + 0.5 * change
        self.steering = self.steering + change
        if self.past is not None:
            self.past.add(self.steering)
        self.ahead, self.bend = np.cos(heading), np.maximum(1.0 - bend * lateral, 0.3)
        return rolling

    def accelerate(self, number: int) -> BoolArray:
        remaining = self.target_m - self.progress_m
        held = self.done | (self.pause_s > 0.0)
        self.pause_s -= self.step_s
        allowed = np.sqrt(2 * _ACCELERATION_MPS2 * np.maximum(remaining, 0.0)) + _CREEP_MPS
        asked = np.where(held, 0.0, np.minimum(self.world.design.speed_mps, allowed))
        most = _ACCELERATION_MPS2 * self.step_s
        change = np.minimum(np.maximum(asked - self.speed, -2 * most), most)
        arrived = remaining <= 0.0
        if np.count_nonzero(arrived):
            change = np.where(arrived & (self.speed <= 2 * _CREEP_MPS), -self.speed, change)
        self.speed = self.speed + change
        self.now.t_s, self.now.v_mps = number * self.step_s, self.speed
        self.now.acceleration_mps2 = change * (1 / self.step_s)
        return np.asarray(arrived & ~held)

    def roll(self, rolling: FloatArray, number: int) -> tuple[FloatArray, FloatArray]:
        world, now, step_s = self.world, self.now, self.step_s
        now.curvature_per_m = np.tan(rolling) / self.wheelbase_m
        way = self.speed * step_s
        turned = way * now.curvature_per_m
        half, way_rolled = 0.5 * turned * self.track_m, way * self.surplus
        front, radius_m = way_rolled / np.cos(rolling), self.radius_m
        if world.during:
            now.added.fill(0.0)
            for effect in world.during:
                effect(now)
            half, front = half * (1.0 + now.track), front * (1.0 + now.drive)
            radius_m = radius_m * (1.0 + now.added[:2])
            turned = turned + now.yaw_radps * step_s
        wheels = (way_rolled + _SIDES * half) / radius_m
        if self.textured:
            place, copies = (number - 1) % _BLOCK, self.noise.copies
            if place == 0:
                unique = len(way) // copies
                self.grain = np.tile(self.rng.standard_normal((_BLOCK, 3, unique)), (1, 1, copies))
            rough = self.noise.texture_m * np.sqrt(np.abs(way))
            wheels += rough * self.grain[place, :2] / self.radius_m
            front = front + rough * self.grain[place, 2]
        now.turned_rad += wheels
        middle = now.theta_rad + 0.5 * turned
        cos, sin = np.cos(middle), np.sin(middle)
        drift = now.lateral_mps * step_s
        now.x_m += cos * way - sin * drift
        now.y_m += sin * way + cos * drift
        now.theta_rad += turned
        if self.past_poses is not None:
            self.past_poses.add(now.x_m, now.y_m, now.theta_rad)
        return wheels, front / self.radius_front_m

    def count(self, wheels: FloatArray, front: FloatArray) -> None:
        seen = self.angle[:2]
        seen += wheels * (1.0 - self.now.added[3:5]) if self.world.during else wheels
        self.angle[2] += front
        if self.quantise:
            seen = np.floor(seen * self.per_rad + self.noise.phase[:2]) / self.per_rad
        left_m, right_m = seen * self.believed_m
        x, y, before, way = self.odo
        theta = (right_m - left_m) / self.world.model.track_m
        rolled = 0.5 * (left_m + right_m)
        step = rolled - way
        middle = 0.5 * (before + theta)
        x += step * np.cos(middle)
        y += step * np.sin(middle)
        before[:], way[:] = theta, rolled
        self.progress_m += step * self.ahead / self.bend

    def arrive(self, arrived: BoolArray) -> IntArray:
        design = self.world.design
        ends = self.progress_m >= self.fly_m
        standing = arrived & (self.speed == 0.0)
        if np.count_nonzero(standing):
            self.pointer = self.pointer + standing
            ended = standing & (self.pointer > design.stops)
            self.pause_s = np.where(standing & ~ended, _PAUSE_S, self.pause_s)
            following = self.stop_m[np.minimum(self.pointer, len(self.stop_m) - 1), np.arange(len(design))]
            self.target_m = np.where(ended, self.target_m, following)
            ends |= ended
        return np.flatnonzero(ends)

    def halt(self, ended: IntArray) -> None:
        self.speed = self.speed.copy()
        self.done[ended], self.speed[ended], self.fly_m[ended] = True, 0.0, np.inf


def _within(values: FloatArray, most: float) -> FloatArray:
    # on short arrays three times as fast as np.clip
    return np.minimum(np.maximum(values, -most), most)


def _stops(world: World, tables: RouteTables) -> FloatArray:
    design = world.design
    order = np.arange(1, int(design.stops.max(initial=0)) + 2)[:, None]
    stop_m = np.where(order <= design.stops, tables.end_m * order / (design.stops + 1), np.inf)
    end_m = np.where(design.flying, tables.end_m + 50.0, tables.end_m)
    return np.where(order == design.stops + 1, end_m, stop_m)


_STEER_STEP_RAD: Final = 5e-4


def reference_poses(world: World, noise: NoiseDraw, record: Record) -> FloatArray:
    """Return the pose reference without reading noise, shape (3, n_frames, n_runs)."""
    x, y, theta = record.past
    x, y = world.seen_target(x, y, theta, world.ref_yaw_rad + noise.start_heading_rad)
    return np.stack([x, y, theta + noise.start_heading_rad])


def steering_readings(world: World, noise: NoiseDraw, record: Record, *, quantise: bool = True) -> FloatArray:
    """Return steering readings, shape (n_frames, n_runs)."""
    steer = record.late_rad
    if world.steer_backlash_rad.any():
        half = 0.5 * world.steer_backlash_rad
        shown = np.empty_like(steer)
        at = steer[0]
        for number, angle in enumerate(steer):
            shown[number] = at = np.clip(at, angle - half, angle + half)
        steer = shown
    steer = world.steer_scale * steer + world.steer_zero_rad + noise.steer_rad
    if noise.reading_rad:
        steer = steer + noise.reading_rad * np.random.default_rng([noise.seed, 8]).standard_normal(steer.shape)
    return np.round(steer / _STEER_STEP_RAD) * _STEER_STEP_RAD if quantise else steer


def with_blunder(world: World, counts: FloatArray) -> FloatArray:
    """Return counters (3, ...) as the world's blunder, if any, leaves them."""
    if not world.blunder:
        return counts
    struck = world.blunder_runs > 0
    left, right, front = counts
    faulty = {
        "double_left": (2 * left, right),
        "quad_both": (4 * left, 4 * right),
        "pi_right": (left, np.round(np.pi * right)),
        "swapped": (right, left),
        "sign_left": (-left, right),
        "half_right": (left, np.floor(0.5 * right)),
    }[world.blunder]
    return np.stack([np.where(struck, faulty[0], left), np.where(struck, faulty[1], right), front])


def simulated_poses(world: World, record: Record) -> FloatArray:
    """Return an outside simulator's end poses, shape (3, n_runs), by exact arcs or (`world.euler`) Euler steps."""
    left, right = record.counts[:2] / (world.design.counts_per_rev / (2 * np.pi))
    left_m, right_m = left * world.believed_left_m, right * world.believed_right_m
    theta = (right_m - left_m) / world.model.track_m
    way, turn = np.diff(0.5 * (left_m + right_m), axis=0), np.diff(theta, axis=0)
    heading = np.where(world.euler > 0, theta[1:], 0.5 * (theta[1:] + theta[:-1]))
    chord = np.where(world.euler > 0, way, way * np.sinc(turn / (2 * np.pi)))
    x, y = np.sum(chord * np.cos(heading), axis=0), np.sum(chord * np.sin(heading), axis=0)
    return np.stack([x, y, theta[-1]])
