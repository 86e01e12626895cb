"""Observations (runs, or windows of recordings) and their steps, as arrays."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from enum import IntEnum
from functools import cached_property
from itertools import pairwise
from typing import Any, Final, Generic, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike

from calib.campaign.settings import OdometryModel
from calib.gap.observations.observation import let_go
from calib.odometry.routes import radii_of_model
from calib.types import GRAVITY_MPS2, BoolArray, FloatArray, IntArray, StrArray, floats
from calib.vehicle import Vehicle


class Channel(IntEnum):
    """A channel, by its column in arrays of shape (n_obs, n_channels).

    Distance by rangefinder; along, left of and heading of the end pose; front against rear wheels, in way and turn.
    """

    DISTANCE = 0
    ALONG = 1
    LATERAL = 2
    HEADING = 3
    FRONT = 4
    STEERING = 5

    @property
    def label(self) -> str:
        """Name as files and people have it."""
        return self.name.lower()

    @property
    def unit(self) -> str:
        """``m`` or ``rad``."""
        return "rad" if self in {Channel.HEADING, Channel.STEERING} else "m"


N_CHANNELS: Final = len(Channel)
POSE: Final = (Channel.ALONG, Channel.LATERAL)

#: steps worked on at a time: forty arrays of half a megabyte stay in the cache
STEPS_AT_ONCE: Final = 2**16
#: so many steps keep what follows from counts: ten values each
KEPT_STEPS: Final = 2**20

#: one window follows another that ended within this: rounding of a log's times
SAME_TIME_S: Final = 1e-6
#: standard uncertainty of curvature by whole counts, over that of a turn about one track
CURVATURE_ERROR_PER_TRACK: Final = 0.02
#: smoothing over more steps would join one turn with the next
MOST_SMOOTHED_STEPS: Final = 10
#: turn below which a run without a log is one arc
STRAIGHT_RAD: Final = 0.35

_OF_STEPS: Final = frozenset(
    {"roll_left_rad", "roll_right_rad", "phase_left_rad", "phase_right_rad", "time_s", "duration_s"}
    | {"front_roll_rad", "steer_rad", "steer_change_rad", "aside_rad", "carried_N"}
)
Value = TypeVar("Value")


class _KeptIfFew(Generic[Value]):
    def __init__(self, make: "Callable[[Observations], Value]") -> None:
        self.make, self.__doc__ = make, make.__doc__

    def __get__(self, observations: "Observations", _: type) -> Value:
        name, known = self.make.__name__, vars(observations)
        if name in known:
            return cast("Value", known[name])
        value = self.make(observations)
        if len(observations.unit) <= KEPT_STEPS:
            known[name] = value
        return value


@dataclass(frozen=True, eq=False)
class Observations:
    """A campaign's observations and steps."""

    vehicle: Vehicle
    model: OdometryModel  #: what the simulator believes
    #: shape (n_units + 1,): observation u has steps ``starts[u]:starts[u + 1]``, at least one
    starts: IntArray
    #: roll_left_rad, roll_right_rad: shape (n_steps,): wheel rotation of each step
    roll_left_rad: FloatArray
    roll_right_rad: FloatArray
    #: phase_left_rad, phase_right_rad: shape (n_steps,): counted wheel angle at the end of each step
    phase_left_rad: FloatArray
    phase_right_rad: FloatArray
    #: time_s, duration_s: shape (n_steps,): time since the run's start at the end of each step, and its duration
    time_s: FloatArray
    duration_s: FloatArray
    #: front wheel's rotation, mean steering angle and its change in each step, shape (n_steps,); NaN where not logged
    front_roll_rad: FloatArray
    steer_rad: FloatArray
    steer_change_rad: FloatArray
    from_log: BoolArray  #: shape (n_obs,): false where steps were made up from totals
    #: shape (n_units, 6): measured distance, x, y and heading in its own frame, else NaN; the last two are for the
    #: prediction, front wheel against rear ones
    measured: FloatArray
    simulated: FloatArray  #: shape (n_obs, 6): an outside simulator's prediction, else NaN
    usable: BoolArray  #: shape (n_obs, 6): channels that an observation has
    numbers: Mapping[str, FloatArray]  #: shape (n_obs,): covariates of each observation
    labels: Mapping[str, StrArray]  #: shape (n_obs,): ``run_id``, ``session``, ``kind``, ``direction``
    #: shape (n_units,): replicates (same route, direction, loads, speed, as driven, not as labelled) share a number
    condition: IntArray
    #: shape (n_units,): replicates that were also driven in the same session, warmth, dwell and further columns
    cell: IntArray
    kind: IntArray  #: shape (n_obs,): units of the same route and direction
    #: shape (n_obs,): the laser's distance is the projection on the start heading (1; -1 backward), the chord to the
    #: end point (2), or the line's length (0)
    axis: FloatArray
    sigma: FloatArray  #: shape (n_obs, 4): stated standard uncertainty of distance, x, y and heading
    #: shape (n_obs,): of the start frame's heading, where that was read too; else 0
    sigma_start_rad: FloatArray
    count_rad: tuple[float, float]  #: rotation of the left and right wheel between two counts
    windowed: bool  #: whether recordings were cut
    #: run, window: shape (n_obs,): row of the run among those included, and window within it
    run: IntArray
    window: IntArray
    #: shape (n_obs, 3): start in the frame common to all, else NaN
    start_pose: FloatArray
    #: shape (n_obs, 2, 5): error of headings from the course at start and end, rad a metre of the sensor's place (x, y)
    #: a second of delay, and of slip angles of -v^2 and -v times the curvature; zero where measured
    course_error: FloatArray
    common_frame: bool  #: whether places on the floor mean the same in all observations
    guided: BoolArray  #: shape (n_obs,): observations whose heading is that of a guided run, not a measured one
    by_gyro: BoolArray  #: shape (n_obs,): observations whose turn a gyro measured
    sensor_m: tuple[float, float] = (0.0, 0.0)  #: stated place of the reference's sensor on the vehicle
    sigmas_assumed: bool = False  #: whether a program filled in an instrument's uncertainty because nobody stated it
    notes: tuple[str, ...] = ()  #: what had to be omitted or assumed, in sentences
    #: whether front wheel alone, or the rear axle's way and the steering, drive the odometry
    by_front: bool = False
    by_shaft: bool = False  #: whether that is the rear axle's way, under the name of the front wheel's
    #: shape (n_steps,): what mecanum wheels roll to the left in each step, or an axle slips, over the mean radius
    aside_rad: FloatArray | None = None
    carried_N: FloatArray | None = None  #: shape (n_steps, 2): loads of both wheels, where logs have them
    #: whether parameters of a user's simulator replace a free recalibration
    calibration_held: bool = False
    #: whether to look up effects of the model that act where nothing varies, too
    applied: bool = False
    first_unit: int = 0  #: of a `part`: number of its first observation in the whole campaign

    def __len__(self) -> int:
        return len(self.starts) - 1

    @property
    def start_s(self) -> FloatArray:
        """Time since the run's start at which each observation begins, shape (n_obs,)."""
        return self.time_s[self.starts[:-1]] - self.duration_s[self.starts[:-1]]

    @cached_property
    def follows(self) -> BoolArray:
        """Whether each observation starts where the last one ended, as windows do, (n_obs,)."""
        same = (self.run[1:] == self.run[:-1]) & self.from_log[1:] & self.from_log[:-1]
        return np.append(False, same & (np.abs(self.start_s[1:] - self.time_s[self.starts[1:-1] - 1]) < SAME_TIME_S))

    @cached_property
    def unit(self) -> IntArray:
        """Observation of each step, shape (n_steps,)."""
        return np.repeat(np.arange(len(self)), np.diff(self.starts))

    @cached_property
    def lengths(self) -> IntArray:
        """Steps of each observation, shape (n_obs,)."""
        return np.diff(self.starts)

    @cached_property
    def spans(self) -> tuple[slice, ...]:
        """Observations worked on at a time: `STEPS_AT_ONCE` steps or one unit."""
        edges = [0]
        while edges[-1] < len(self):
            most = self.starts[edges[-1]] + STEPS_AT_ONCE
            edges.append(max(int(np.searchsorted(self.starts, most, side="right")) - 1, edges[-1] + 1))
        return tuple(slice(first, behind) for first, behind in pairwise(edges))

    def parts(self) -> "Iterator[Observations]":
        """Yield observations by `spans`; itself where steps are few."""
        for units in self.spans:
            yield self if len(self.spans) == 1 else self.part(units)
            let_go(*self.steps)

    @property
    def steps(self) -> tuple[FloatArray | None, ...]:
        """What has a value for each step."""
        return tuple(getattr(self, name) for name in _OF_STEPS)

    def of_parts(self, what: "Callable[[Observations], FloatArray]") -> FloatArray:
        """Return a quantity (n_obs, ...) worked out from steps, part by part."""
        return np.concatenate([what(part) for part in self.parts()])

    def part(self, units: slice) -> "Observations":
        """Return some observations, arrays as views. Parts are kept with what is derived from them."""
        place = (units.start, units.stop)
        if place in self._parts:
            return self._parts[place]
        part = self._part(units)
        if len(self.unit) <= KEPT_STEPS:
            self._parts[place] = part
        return part

    @cached_property
    def _parts(self) -> "dict[tuple[int, int], Observations]":
        return {}

    def _part(self, units: slice) -> "Observations":
        first, behind = int(self.starts[units.start]), int(self.starts[units.stop])
        starts = self.starts[units.start : units.stop + 1] - first
        changes: dict[str, Any] = {"starts": starts, "first_unit": self.first_unit + units.start}
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name in _OF_STEPS:
                changes[field.name] = None if value is None else value[first:behind]
            elif isinstance(value, np.ndarray) and field.name != "starts":
                changes[field.name] = value[units]
            elif isinstance(value, Mapping):
                changes[field.name] = {name: column[units] for name, column in value.items()}
        part = replace(self, **changes)
        if "front_ways" in vars(self):
            vars(part)["front_ways"] = self.front_ways[units]
        return part

    def here(self, values: FloatArray | IntArray | BoolArray) -> Any:
        """Return an array (n, ...) over all observations of the campaign for these, (n_obs, ...)."""
        return values[self.first_unit : self.first_unit + len(self)]

    def total(self, steps: ArrayLike) -> FloatArray:
        """Sum a step array (n_steps,) over each observation, shape (n_obs,)."""
        return np.add.reduceat(floats(steps), self.starts[:-1])

    def cumulative(self, steps: FloatArray) -> FloatArray:
        """Return the running sum of steps (n_steps,) in each observation, the step included, (n_steps,)."""
        running = np.cumsum(steps)
        before = np.zeros(len(self))
        before[1:] = running[self.starts[1:-1] - 1]
        running -= np.repeat(before, self.lengths)
        return running

    def number(self, name: str) -> FloatArray:
        """Return a covariate, shape (n_obs,); NaN where the campaign has none."""
        return self.numbers[name] if name in self.numbers else np.full(len(self), np.nan)

    @property
    def wheel_loads_N(self) -> FloatArray:
        """Load of left and right wheel, the mean over its way, shape (2, n_obs); else NaN."""
        return np.stack([self.number("load_left_N"), self.number("load_right_N")])

    @property
    def loads_N(self) -> FloatArray:
        """Wheel loads, shape (2, n_steps), where logs have them, else `wheel_loads_N`."""
        return self.wheel_loads_N if self.carried_N is None else self.carried_N.T

    def radii_m(self, loads_N: FloatArray) -> FloatArray:
        """Return the radii that the model believes under loads of both wheels, each shape (2, n)."""
        known_N = np.nan_to_num(loads_N, nan=self.model.reference_load_N)
        return np.stack(radii_of_model(self.model, *known_N, by_shaft=self.by_shaft))

    @cached_property
    def radius_left_m(self) -> FloatArray:
        """The model's radius of the left wheel in each observation, (n_obs,)."""
        return np.asarray(self.radii_m(self.wheel_loads_N)[0])

    @cached_property
    def radius_right_m(self) -> FloatArray:
        """The same of the right wheel."""
        return np.asarray(self.radii_m(self.wheel_loads_N)[1])

    def _wide(self, radii_m: FloatArray) -> FloatArray:
        return radii_m[self.unit] if self.carried_N is None else radii_m

    @_KeptIfFew
    def travel_left_m(self) -> FloatArray:
        """Left wheel's travel of each step by the model, (n_steps,)."""
        return self.roll_left_rad * self._wide(self.radii_m(self.loads_N)[0])

    @_KeptIfFew
    def travel_right_m(self) -> FloatArray:
        """Return that of the right wheel, (n_steps,)."""
        return self.roll_right_rad * self._wide(self.radii_m(self.loads_N)[1])

    @_KeptIfFew
    def path_m(self) -> FloatArray:
        """Signed path of each step by the model, shape (n_steps,)."""
        return 0.5 * (self.travel_left_m + self.travel_right_m)

    @_KeptIfFew
    def aside_m(self) -> FloatArray | None:
        """Way to the left of each step by the model, shape (n_steps,); None of wheels that only roll ahead."""
        if self.aside_rad is None:
            return None
        return self.aside_rad * self._wide(self.radii_m(self.loads_N).mean(axis=0))

    @_KeptIfFew
    def turn_rad(self) -> FloatArray:
        """Signed turn of each step by the model, shape (n_steps,)."""
        return (self.travel_right_m - self.travel_left_m) / self.model.track_m

    @_KeptIfFew
    def steer_cos(self) -> FloatArray:
        """Return the rear wheels' share of the front wheel's way, (n_steps,).

        1 without a logged angle or where the rear axle's way is counted.
        """
        return np.ones(len(self.unit)) if self.by_shaft else self._over_way(np.cos)

    @_KeptIfFew
    def steer_sin(self) -> FloatArray:
        """Return the share of the front wheel's way over the wheelbase that is turn, else 0, (n_steps,)."""
        return self._over_way(np.tan if self.by_shaft else np.sin)

    @cached_property
    def front_ways(self) -> FloatArray:
        """Way (m) and turn (rad) of each observation by front wheel and steering, shape (n_obs, 2)."""
        if len(self.spans) > 1:
            return self.of_parts(lambda part: part.front_ways)
        front_m = np.nan_to_num(self.front_roll_rad) * self.vehicle.front_radius_m
        turn = self.total(front_m * self.steer_sin) / self.vehicle.wheelbase_m
        return np.stack([self.total(front_m * self.steer_cos), turn], axis=1)

    def _over_way(self, of: Callable[[FloatArray], FloatArray]) -> FloatArray:
        """Return the mean of a function of the steering angle over the front wheel's way, (n_steps,).

        The mean of both ends, and a sixth of what function and wheel's rate change by (Euler and Maclaurin).
        """
        angle, half = np.nan_to_num(self.steer_rad), 0.5 * np.nan_to_num(self.steer_change_rad)
        begin, end = of(angle - half), of(angle + half)
        with np.errstate(divide="ignore", invalid="ignore"):
            rate = np.nan_to_num(self.front_roll_rad / self.duration_s, posinf=0.0, neginf=0.0)
            before, behind = np.roll(rate, 1), np.roll(rate, -1)
            before[self.starts[:-1]], behind[self.starts[1:] - 1] = rate[self.starts[:-1]], rate[self.starts[1:] - 1]
            faster = np.nan_to_num(0.5 * (behind - before) / rate, posinf=0.0, neginf=0.0)
        return 0.5 * (begin + end) + faster * (end - begin) / 6.0

    @_KeptIfFew
    def speed_mps(self) -> FloatArray:
        """Speed of each step by the log, else as set, else 0, shape (n_steps,)."""
        with np.errstate(divide="ignore", invalid="ignore"):
            logged = self.path_m / self.duration_s
        known = self.number("speed_mps")[self.unit]
        return np.nan_to_num(np.where(self.from_log[self.unit] & np.isfinite(logged), logged, known))

    @_KeptIfFew
    def curvature_per_m(self) -> FloatArray:
        """Curvature of each step, smoothed over `_half_window` steps to either side, shape (n_steps,)."""
        return self.curvature_of(self.turn_rad, self.path_m)

    def curvature_of(self, turn_rad: FloatArray, path_m: FloatArray) -> FloatArray:
        """Return the curvature of steps by turns and paths (n_steps,), smoothed like the model's."""
        turn, path = (self.smoothed(part, self._half_window) for part in (turn_rad, np.abs(path_m)))
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(path > 1e-6, turn / path, 0.0)

    @cached_property
    def _half_window(self) -> int:
        step_m = np.abs(self.path_m)
        rolling = step_m > 1e-6
        if not rolling.any():
            return 0
        count_m = float(np.hypot(*self.count_rad)) * self.vehicle.wheel_radius_m
        steps = count_m / np.sqrt(6.0) / CURVATURE_ERROR_PER_TRACK / float(np.median(step_m[rolling]))
        return int(np.clip(np.ceil(0.5 * (steps - 1.0)), 0, MOST_SMOOTHED_STEPS))

    def smoothed(self, steps: FloatArray, half: int) -> FloatArray:
        """Return the mean of each step, (n_steps,), and `half` steps to either side within its observation."""
        running = np.concatenate(([0.0], np.cumsum(steps)))
        index = np.arange(len(steps))
        first = np.maximum(index - half, self.starts[self.unit])
        last = np.minimum(index + half + 1, self.starts[self.unit + 1])
        return np.asarray((running[last] - running[first]) / (last - first))

    @cached_property
    def length_m(self) -> FloatArray:
        """Unsigned path of each observation, shape (n_obs,)."""
        return self.of_parts(lambda part: part.total(np.abs(part.path_m)))

    @cached_property
    def heading_sign(self) -> FloatArray:
        """+1 out (or no label), -1 back along the same floor, shape (n_obs,)."""
        return np.where(self.labels["direction"] == "back", -1.0, 1.0)

    @cached_property
    def weight_N(self) -> FloatArray:
        """Weight of vehicle and payload, shape (n_obs,)."""
        return GRAVITY_MPS2 * (self.vehicle.mass_kg + np.nan_to_num(self.number("payload_kg")))
