"""The drive itself: fine time steps, all runs at once, each closed on its own odometry."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.arrays import FloatArray, IntArray
from calib.plant.noise import NoiseDraw
from calib.plant.routes import PITCH_M, tabulate
from calib.plant.world import Moment, World

STEP_S: Final = 0.02
_ACCELERATION_MPS2: Final = 0.35
_STEER_LAG_S: Final = 0.12
_STEER_RATE_RADPS: Final = 1.2
_STEER_MAX_RAD: Final = 1.2
_CREEP_MPS: Final = 0.02
_PAUSE_S: Final = 0.8
_BLOCK: Final = 128


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """What happened, sampled at the logs' rate; the last frame of a run is its end."""

    frames: IntArray  #: shape (n_runs,): frames of a run; frame 0 is its start
    #: t_s, x_m, y_m, theta_rad, v_mps, omega_radps, steer_rad: shape (n_frames, n_runs): true motion in the run's own
    #: frame; frames behind a run's end repeat it
    t_s: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    theta_rad: FloatArray
    v_mps: FloatArray
    omega_radps: FloatArray
    steer_rad: FloatArray
    #: shape (3, n_frames, n_runs): counters left, right, front since the start; whole numbers unless the drive was not
    #: quantised
    counts: FloatArray
    odo: FloatArray  #: shape (4, n_frames, n_runs): the vehicle's own odometry: x, y, theta, path length

    def last(self, values: FloatArray) -> FloatArray:
        """Return the last frame of each run of an array of shape (..., n_frames, n_runs), shape (..., n_runs)."""
        end: FloatArray = values[..., self.frames - 1, np.arange(len(self.frames))]
        return end


def drive(world: World, noise: NoiseDraw, *, quantise: bool = True, step_s: float = STEP_S) -> Record:
    """Drive all runs of a world.

    The path follower sees only the vehicle's odometry; its steering has a lag and a rate limit; the rear wheels roll on
    the true radii and track, and the floor's texture makes a random walk of every wheel. Counts are whole, or, for
    derivatives, keep their fractions. Frames stand every `design.log_period_s` (0.25 s where that is 0).
    """
    design, model = world.design, world.model
    n_runs = len(design)
    vehicle = design.vehicle
    tables = tabulate(
        [str(kind) for kind in design.kind],
        length_m=design.length_m,
        side_m=design.side_m,
        radius_m=design.radius_m,
        weaves=[(float(a), float(w)) for a, w in zip(world.weave_m, world.wavelength_m, strict=True)],
    )
    every = max(1, round((design.log_period_s or 0.25) / step_s))
    wheelbase, track_true = vehicle.wheelbase_m, model.track_m * world.track
    radius_left = world.believed_left_m * world.left * noise.scale_left
    radius_right = world.believed_right_m * world.right * noise.scale_right
    radius_front = vehicle.wheel_radius_m * (1.0 + noise.front)
    per_rad = design.counts_per_rev / (2 * np.pi)
    texture = noise.texture_m.any()
    rng = np.random.default_rng(noise.seed)
    unique = n_runs // noise.copies

    # stops on the way, evenly spread, then the end; a flying run has no stop at its end
    n_stops = int(design.stops.max(initial=0)) + 1
    order = np.arange(1, n_stops + 1)[:, None]
    stop_m = np.where(order <= design.stops, tables.end_m * order / (design.stops + 1), np.inf)
    at_end = order == design.stops + 1
    stop_m = np.where(at_end, np.where(design.flying, tables.end_m + 50.0, tables.end_m), stop_m)
    pointer = np.zeros(n_runs, dtype=np.int64)
    runs = np.arange(n_runs)

    look = 0.6 * (design.speed_mps + 0.6)  # follower's length scale
    gain_offset, gain_heading = 1.0 / look**2, 1.6 / look
    preview = ((design.speed_mps * (_STEER_LAG_S + 0.1)) / PITCH_M).astype(np.int64)
    last_index = tables.last

    now = Moment.at_rest(n_runs)
    speed, steer, progress, pause = (np.zeros(n_runs) for _ in range(4))
    angle = np.zeros((3, n_runs))  # as the counters see it
    odo_x, odo_y, odo_theta, odo_s = (np.zeros(n_runs) for _ in range(4))
    rolled_old = np.zeros(n_runs)
    done = np.zeros(n_runs, dtype=bool)
    before_end = np.zeros(n_runs, dtype=np.int64)
    final = np.zeros((14, n_runs))
    keep: list[FloatArray] = []

    def snap() -> FloatArray:
        counted = angle * per_rad
        if quantise:
            counted = np.floor(counted + noise.phase)
        omega = now.v_mps * now.curvature_per_m
        motion = (np.full(n_runs, now.t_s), now.x_m, now.y_m, now.theta_rad, now.v_mps, omega, steer)
        return np.stack([*motion, *counted, odo_x, odo_y, odo_theta, odo_s])

    keep.append(snap())
    longest = float(np.max(tables.end_m / design.speed_mps + (design.stops + 2) * (_PAUSE_S + 6.0))) + 20.0
    grain = np.zeros((_BLOCK, 3, n_runs))
    target = np.where(done, 0.0, stop_m[pointer, runs])
    for number in range(1, int(longest / step_s) + 1):
        # follower, on the odometry
        index = tables.first + (progress * (1 / PITCH_M)).astype(np.int64)
        np.minimum(index, last_index, out=index)
        cos, sin = tables.cos[index], tables.sin[index]
        off_x, off_y = odo_x - tables.x_m[index], odo_y - tables.y_m[index]
        lateral = cos * off_y - sin * off_x
        heading = odo_theta - tables.theta_rad[index]
        kappa = tables.curvature_per_m[np.minimum(index + preview, last_index)]
        kappa = kappa - gain_offset * lateral - gain_heading * heading
        wanted = np.clip(np.arctan(wheelbase * kappa), -_STEER_MAX_RAD, _STEER_MAX_RAD)
        change = np.clip((wanted - steer) / _STEER_LAG_S, -_STEER_RATE_RADPS, _STEER_RATE_RADPS) * step_s
        # the sensor is read at the end of a step, the wheel rolls at the middle angle
        rolling = steer + 0.5 * change
        steer = steer + change

        # speed: ramps up, down to the next stop, waits there
        remaining = target - progress
        held = pause > 0.0
        pause -= step_s
        allowed = np.sqrt(2 * _ACCELERATION_MPS2 * np.maximum(remaining, 0.0)) + _CREEP_MPS
        asked = np.where(held | done, 0.0, np.minimum(design.speed_mps, allowed))
        change = np.clip(asked - speed, -2 * _ACCELERATION_MPS2 * step_s, _ACCELERATION_MPS2 * step_s)
        arrived = remaining <= 0.0
        if arrived.any():
            change = np.where(arrived & (speed <= 2 * _CREEP_MPS), -speed, change)
        speed = speed + change

        # true motion and what the effects add to it
        curvature = np.tan(rolling) / wheelbase
        now.t_s, now.v_mps, now.acceleration_mps2, now.curvature_per_m = (
            number * step_s,
            speed,
            change * (1 / step_s),
            curvature,
        )
        if world.during:
            now.clear()
            for effect in world.during:
                effect(now)
        way = speed * step_s
        turned = way * curvature
        half = 0.5 * turned * track_true * (1.0 + now.track)
        way_rolled = way * (1.0 + world.rise)
        left = (way_rolled - half) / (radius_left * (1.0 + now.left))
        right = (way_rolled + half) / (radius_right * (1.0 + now.right))
        if texture:
            place = (number - 1) % _BLOCK
            if place == 0:
                grain = np.tile(rng.standard_normal((_BLOCK, 3, unique)), (1, 1, noise.copies))
            rough = noise.texture_m * np.sqrt(np.abs(way))
            left += rough * grain[place, 0] / radius_left
            right += rough * grain[place, 1] / radius_right
        now.angle_left_rad += left
        now.angle_right_rad += right
        true_turn = turned + now.yaw_radps * step_s
        middle = now.theta_rad + 0.5 * true_turn
        cos, sin = np.cos(middle), np.sin(middle)
        drift = now.lateral_mps * step_s
        now.x_m += cos * way - sin * drift
        now.y_m += sin * way + cos * drift
        now.theta_rad += true_turn

        # counters and the vehicle's own odometry
        angle[0] += left * (1.0 - now.lost_left)
        angle[1] += right * (1.0 - now.lost_right)
        front = way_rolled / np.cos(rolling) * (1.0 + now.drive)
        angle[2] += (front + rough * grain[place, 2] if texture else front) / radius_front
        seen = angle[:2]
        if quantise:
            seen = np.floor(seen * per_rad + noise.phase[:2]) / per_rad
        rolled_left, rolled_right = seen[0] * world.believed_left_m, seen[1] * world.believed_right_m
        theta_new = (rolled_right - rolled_left) / model.track_m
        rolled = 0.5 * (rolled_left + rolled_right)
        step = rolled - rolled_old
        rolled_old = rolled
        middle = 0.5 * (odo_theta + theta_new)
        odo_x = odo_x + step * np.cos(middle)
        odo_y = odo_y + step * np.sin(middle)
        odo_s = odo_s + step
        progress += step * np.cos(heading) / np.maximum(1.0 - tables.curvature_per_m[index] * lateral, 0.3)
        odo_theta = theta_new

        # who has reached a stop, who the end
        standing = arrived & (speed == 0.0) & ~held & ~done
        flown = design.flying & ~done & (progress >= tables.end_m)
        ended = np.zeros(n_runs, dtype=bool)
        if standing.any():
            pointer = pointer + standing
            ended = standing & (pointer > design.stops)
            pause = np.where(standing & ~ended, _PAUSE_S, pause)
            target = np.where(ended, target, stop_m[np.minimum(pointer, n_stops - 1), runs])
        if flown.any():
            ended = ended | flown
        framed = number % every == 0
        ending = ended.any()
        if framed or ending:
            frame = snap()
            if ending:
                final = np.where(ended, frame, final)
                before_end = np.where(ended, len(keep), before_end)
                done = done | ended
                speed = np.where(ended, 0.0, speed)
            if framed:
                keep.append(frame)
            if done.all():
                break
    final = np.where(done, final, snap())
    before_end = np.where(done, before_end, len(keep))
    stacked = np.stack([*keep, final], axis=1)
    stacked = np.where(np.arange(stacked.shape[1])[:, None] >= before_end, final[:, None], stacked)
    return Record(
        frames=before_end + 1,
        t_s=stacked[0],
        x_m=stacked[1],
        y_m=stacked[2],
        theta_rad=stacked[3],
        v_mps=stacked[4],
        omega_radps=stacked[5],
        steer_rad=stacked[6],
        counts=stacked[7:10],
        odo=stacked[10:14],
    )
