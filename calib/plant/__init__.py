"""The independent plant: vehicles driven in fine steps through known worlds.

It imports nothing of `calib.odometry`, `calib.radius` or `calib.gap`: it checks them. Here the true world of a
campaign, run by run, its noise, and the forms of effects.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Final

import numpy as np

from calib.campaign.settings import OdometryModel
from calib.plant.design import Design
from calib.types import GRAVITY_MPS2, FloatArray
from calib.vehicle import Vehicle


@dataclass(frozen=True, slots=True)
class Noise:
    """Scales of the noise, all as standard deviations."""

    texture_m: float = 1.5e-4  #: random walk of each wheel's rolled path, metres per square root of a metre
    #: of a run: relative change of both radii, and of their difference
    common: float = 4e-5
    differential: float = 1.5e-5
    start_heading_rad: float = 2e-4  #: of a run: the reference frame's heading at the start
    laser_m: float = 0.0015
    ref_xy_m: float = 0.002
    ref_theta_rad: float = 0.0008
    stated_ratio: float = 1.0  #: stated uncertainty of the reference over the true one
    #: of a run: zero of the steering angle, and relative front radius
    steer_rad: float = 1e-3
    front: float = 3e-4
    reading_rad: float = 2e-3
    tail: float = 5.0  #: degrees of freedom of Student's t over the runs; above 2, infinite is normal

    def times(self, factor: float) -> "Noise":
        """Return the noise with every scale times a factor, to four digits."""
        scales = [field.name for field in fields(self) if field.name not in ("stated_ratio", "tail")]
        return replace(self, **{name: float(f"{getattr(self, name) * factor:.4g}") for name in scales})


@dataclass(frozen=True, slots=True, eq=False)
class NoiseDraw:
    """One draw of everything random about n runs."""

    texture_m: FloatArray  #: shape (n_runs,): texture of each run
    #: shape (n_runs,): factors on the true radii
    scale_left: FloatArray
    scale_right: FloatArray
    #: shape (3, n_runs): part of a count at the start, 0 to 1, left, right, front
    phase: FloatArray
    #: shape (n_runs,): errors of instruments and sensors
    laser_m: FloatArray
    start_heading_rad: FloatArray
    steer_rad: FloatArray
    front: FloatArray
    pose: FloatArray  #: shape (n_runs, 3): errors of the reference end pose: x, y in m, theta in rad
    seed: int  #: of the texture along the way and of the reference trace
    reading_rad: float = 0.0  #: scale of one reading of the steering angle
    copies: int = 1

    def tile(self, times: int) -> "NoiseDraw":
        """Return the draw for `times` copies of the runs, end to end."""
        values = {field.name: getattr(self, field.name) for field in fields(self) if field.name != "pose"}
        tiled: dict[str, Any] = {name: np.tile(x, times) for name, x in values.items() if isinstance(x, np.ndarray)}
        return replace(self, pose=np.tile(self.pose, (times, 1)), copies=times * self.copies, **tiled)


def _tailed(rng: np.random.Generator, shape: tuple[int, ...], tail: float) -> FloatArray:
    if np.isinf(tail):
        return rng.standard_normal(shape)
    return np.asarray(rng.standard_t(tail, shape) * np.sqrt((tail - 2.0) / tail))


#: scales of errors drawn for each run, in this order
_TAILED: Final = ("laser_m", "start_heading_rad", "steer_rad", "front")


def draw_noise(noise: Noise, n_runs: int, rng: np.random.Generator) -> NoiseDraw:
    """Draw the noise of `n_runs` runs."""
    tail, one_each = noise.tail, (n_runs,)
    common = noise.common * _tailed(rng, one_each, tail)
    differential = noise.differential * _tailed(rng, one_each, tail)
    mixing = np.ones(n_runs) if np.isinf(tail) else np.sqrt((tail - 2.0) / rng.chisquare(tail, n_runs))
    axes = np.array([noise.ref_xy_m, noise.ref_xy_m, noise.ref_theta_rad])
    return NoiseDraw(
        texture_m=noise.texture_m * mixing,
        scale_left=1.0 + common - 0.5 * differential,
        scale_right=1.0 + common + 0.5 * differential,
        phase=rng.random((3, n_runs)),
        **{name: getattr(noise, name) * _tailed(rng, one_each, tail) for name in _TAILED},
        pose=axes * _tailed(rng, (n_runs, 3), tail),
        seed=int(rng.integers(2**62)),
        reading_rad=noise.reading_rad,
    )


def quiet(n_runs: int) -> NoiseDraw:
    """Return a draw without any noise."""
    zero, one = np.zeros(n_runs), np.ones(n_runs)
    return NoiseDraw(zero, one, one, np.zeros((3, n_runs)), zero, zero, zero, zero, np.zeros((n_runs, 3)), seed=0)


#: smallest and largest scale of each source, in the order drawn
_SCALES: Final = {
    "texture_m": (7e-5, 3e-4), "common": (1e-5, 8e-5), "differential": (4e-6, 3e-5), "start_heading_rad": (5e-5, 6e-4),
    "laser_m": (8e-4, 3e-3), "ref_xy_m": (1e-3, 4e-3), "ref_theta_rad": (3e-4, 1.5e-3), "stated_ratio": (0.6, 1.6),
    "steer_rad": (3e-4, 2e-3), "front": (1e-4, 5e-4), "reading_rad": (8e-4, 4e-3),
}  # fmt: skip


def random_noise(rng: np.random.Generator, **fixed: Any) -> Noise:
    """Draw a case's noise."""
    drawn = {name: float(np.exp(rng.uniform(*np.log(ends)))) for name, ends in _SCALES.items()}
    drawn["tail"] = float(rng.choice([3.5, 5.0, 8.0, np.inf]))
    return Noise(**{**drawn, **fixed})


@dataclass(slots=True)
class Moment:
    """All runs at one time step; effects add to `left` to `drive`."""

    t_s: float
    #: shape (n_runs,): true motion of the rear axle's middle
    v_mps: FloatArray
    acceleration_mps2: FloatArray
    curvature_per_m: FloatArray
    #: shape (n_runs,): true pose in the run's own frame
    x_m: FloatArray
    y_m: FloatArray
    theta_rad: FloatArray
    #: shape (n_runs,): rotation of the rear wheels
    angle_left_rad: FloatArray
    angle_right_rad: FloatArray
    #: shape (n_runs,): relative change of the rolling radii
    left: FloatArray
    right: FloatArray
    track: FloatArray  #: shape (n_runs,): relative change of the effective track
    #: shape (n_runs,): share of the counts that is lost
    lost_left: FloatArray
    lost_right: FloatArray
    lateral_mps: FloatArray  #: shape (n_runs,): true lateral speed of the rear axle's middle
    yaw_radps: FloatArray  #: shape (n_runs,): true yaw that no wheel sees
    drive: FloatArray  #: shape (n_runs,): slip of the driven front wheel
    added: FloatArray  #: shape (8, n_runs): what the effects add, `left` to `drive` being its rows
    turned_rad: FloatArray  #: shape (2, n_runs): `angle_left_rad` and `angle_right_rad`

    @staticmethod
    def at_rest(n_runs: int) -> "Moment":
        """Return the moment before the start."""
        added, turned_rad = np.zeros((8, n_runs)), np.zeros((2, n_runs))
        rows = (*np.zeros((6, n_runs)), *turned_rad, *added, added, turned_rad)
        return Moment(0.0, *rows)

    def roll_more(self, left: FloatArray, right: FloatArray | None = None) -> None:
        """Add shares to the rolling radii."""
        self.left += left
        self.right += left if right is None else right


@dataclass(slots=True)
class World:
    """What is true, arrays over runs; effects change it before the drive."""

    design: Design
    model: OdometryModel  #: what the vehicle and the simulator believe
    #: shape (n_runs,): true static loads of the rear wheels
    load_left_N: FloatArray
    load_right_N: FloatArray
    #: shape (n_runs,): the model's radii at the reported loads
    believed_left_m: FloatArray
    believed_right_m: FloatArray
    #: shape (n_runs,): true radii and track over what the model believes at the *true* load
    left: FloatArray
    right: FloatArray
    track: FloatArray
    #: shape (n_runs,): of the rangefinder
    laser_scale: FloatArray
    laser_offset_m: FloatArray
    #: shape (n_runs,): of the pose reference
    ref_yaw_rad: FloatArray
    ref_lever_x_m: FloatArray
    ref_lever_y_m: FloatArray
    latency_s: FloatArray
    #: shape (n_runs,): of the steering angle sensor
    steer_zero_rad: FloatArray
    steer_scale: FloatArray
    steer_backlash_rad: FloatArray
    steer_delay_s: FloatArray
    #: shape (n_runs,): weave of the path driven
    weave_m: FloatArray
    wavelength_m: FloatArray
    rise: FloatArray  #: shape (n_runs,): surplus of the path over its plan, from an uneven floor
    euler: FloatArray  #: shape (n_runs,): 1 where the simulator takes headings at the ends of steps
    blunder_runs: FloatArray  #: shape (n_runs,): 1 for the runs that it strikes
    #: shape (n_runs,): true payload against the reported one
    payload_scale: FloatArray
    payload_dx_m: FloatArray
    payload_dy_m: FloatArray
    blunder: str = ""  #: a blunder of the counters in the record; empty is none
    during: list[Callable[[Moment], None]] = field(default_factory=list)  #: effects that act while driving

    def enlarge(self, left: FloatArray, right: FloatArray | None = None) -> None:
        """Make the radii larger by shares."""
        self.left, self.right = self.left * (1 + left), self.right * (1 + (left if right is None else right))

    @property
    def mean_load_N(self) -> FloatArray:
        """Mean true load of the rear wheels, shape (n_runs,)."""
        return 0.5 * (self.load_left_N + self.load_right_N)

    @property
    def total_weight_N(self) -> FloatArray:
        """True weight of vehicle and payload, shape (n_runs,)."""
        return GRAVITY_MPS2 * (self.design.vehicle.mass_kg + self.payload_scale * self.design.payload_kg)

    def seen_target(
        self, x_m: FloatArray, y_m: FloatArray, theta_rad: FloatArray, turned_rad: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return where the pose reference sees its target."""
        lever_x, lever_y = self.ref_lever_x_m, self.ref_lever_y_m
        cos, sin = np.cos(theta_rad), np.sin(theta_rad)
        x, y = x_m + cos * lever_x - sin * lever_y - lever_x, y_m + sin * lever_x + cos * lever_y - lever_y
        cos, sin = np.cos(turned_rad), np.sin(turned_rad)
        return cos * x - sin * y, sin * x + cos * y

    def settle(self) -> None:
        """Put the true payload on: loads, and radii."""
        design, payload_kg = self.design, self.payload_scale * self.design.payload_kg
        left_before, right_before = _lawful_radii_m(self.model, self.load_left_N, self.load_right_N)
        x_m, y_m = design.payload_x_m + self.payload_dx_m, design.payload_y_m + self.payload_dy_m
        self.load_left_N, self.load_right_N = wheel_loads(design.vehicle, payload_kg, x_m, y_m)
        left_after, right_after = _lawful_radii_m(self.model, self.load_left_N, self.load_right_N)
        self.left, self.right = self.left * left_after / left_before, self.right * right_after / right_before


def standardised(values: FloatArray) -> FloatArray:
    """Return values less their mean, in standard deviations."""
    return np.asarray((values - values.mean()) / max(float(values.std()), 1e-12))


def wheel_loads(
    vehicle: Vehicle, payload_kg: FloatArray, payload_x_m: FloatArray, payload_y_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the static loads of the left and right rear wheel; the payload stands ahead and left of their middle."""
    length, width = vehicle.wheelbase_m, vehicle.track_m
    rear = vehicle.mass_kg * (1 - vehicle.cog_x_m / length) + payload_kg * (1 - payload_x_m / length)
    moment = vehicle.mass_kg * vehicle.cog_y_m + payload_kg * payload_y_m
    left: FloatArray = GRAVITY_MPS2 * (0.5 * rear + moment / width)
    right: FloatArray = GRAVITY_MPS2 * (0.5 * rear - moment / width)
    return left, right


def _lawful_radii_m(model: OdometryModel, left_N: FloatArray, right_N: FloatArray) -> tuple[FloatArray, FloatArray]:
    left = model.radius_left_m + model.slope_left_m_per_N * (left_N - model.reference_load_N)
    right = model.radius_right_m + model.slope_right_m_per_N * (right_N - model.reference_load_N)
    return left, right


def build_world(design: Design, model: OdometryModel) -> World:
    """Return the world in which the model is right."""
    n_runs = len(design)
    left_N, right_N = wheel_loads(design.vehicle, design.payload_kg, design.payload_x_m, design.payload_y_m)
    arrays: dict[str, Any] = {field.name: np.zeros(n_runs) for field in fields(World) if field.type == FloatArray}
    ones = ("left", "right", "track", "laser_scale", "steer_scale", "payload_scale")
    arrays |= {name: np.ones(n_runs) for name in ones} | {"wavelength_m": np.full(n_runs, 5.0)}
    arrays |= {"load_left_N": left_N, "load_right_N": right_N}
    arrays["believed_left_m"], arrays["believed_right_m"] = _lawful_radii_m(model, left_N, right_N)
    return World(design, model, **arrays)


Knobs = Mapping[str, float]


#: changes the world; a size a run, 0 where the effect is absent
Act = Callable[[World, FloatArray, Knobs], None]
Draw = Callable[[np.random.Generator, Design], dict[str, float]]


def drawn(**ranges: tuple[float, float]) -> Draw:
    """Draw knobs evenly from their ranges."""
    return lambda rng, _: {name: float(rng.uniform(low, high)) for name, (low, high) in ranges.items()}


_NO_KNOBS: Final = drawn()


def either_side(rng: np.random.Generator, _: Design) -> dict[str, float]:
    """Draw the side that an effect is on."""
    return {"right": float(rng.integers(2))}


def added(name: str) -> Act:
    """Return an act that adds its size to a field of the world."""
    return lambda world, size, _: setattr(world, name, getattr(world, name) + size)


def scaled(*names: str) -> Act:
    """Return an act that makes fields of the world larger by a share."""

    def act(world: World, size: FloatArray, _: Knobs) -> None:
        for name in names:
            setattr(world, name, getattr(world, name) * (1 + size))

    return act


def while_driving(act: Callable[[Moment, World, FloatArray, Knobs], None]) -> Act:
    """Return the act of an effect that acts at each moment of the drive."""
    return lambda world, size, knobs: world.during.append(lambda now: act(now, world, size, knobs))


def rolling(share: Callable[[Moment], FloatArray]) -> Act:
    """Return an act that makes both wheels roll more while driving: a share per unit of size."""
    return while_driving(lambda now, _world, size, _knobs: now.roll_more(size * share(now)))


@dataclass(frozen=True, slots=True)
class Form:
    """One form of one effect."""

    effect: str  #: id of the effect; those outside any library begin with ``outside:``
    form: str  #: name of the form; ``plain`` is the textbook's
    typical: float
    unit: str
    act: Act
    #: what a design must have; see `calib.plant.signal.lacks`
    words: str = ""
    knobs: Draw = _NO_KNOBS

    @property
    def needs(self) -> frozenset[str]:
        """The words of what a design must have."""
        return frozenset(self.words.split())


@dataclass(frozen=True, slots=True)
class Cause:
    """An effect with its size, as it truly acts in a case."""

    effect: str
    size: float
    form: str = "plain"
    knobs: Knobs = field(default_factory=dict)


Causes = Sequence[Cause]
