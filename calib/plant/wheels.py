"""What wheels leave that differ from the model's, and what depends on how the vehicle moves."""

import numpy as np

from calib.plant import (
    Draw,
    Form,
    Knobs,
    Moment,
    World,
    drawn,
    either_side,
    rolling,
    scaled,
    standardised,
    while_driving,
)
from calib.plant.design import COLUMNS, REFERENCE_LOAD_N, Design
from calib.types import FloatArray


def _load_linear(world: World, size: FloatArray, knobs: Knobs) -> None:
    left_N, right_N = world.load_left_N - REFERENCE_LOAD_N, world.load_right_N - REFERENCE_LOAD_N
    world.enlarge(size * left_N, size * knobs["right_ratio"] * right_N)


def _power(load_N: FloatArray, exponent: float) -> FloatArray:
    low, high = REFERENCE_LOAD_N**exponent, 1100.0**exponent
    return np.asarray(800.0 * (np.maximum(load_N, 1.0) ** exponent - low) / (high - low))


def _load_power(world: World, size: FloatArray, knobs: Knobs) -> None:
    left, right = (_power(load, knobs["exponent"]) for load in (world.load_left_N, world.load_right_N))
    world.enlarge(size * left, size * knobs["right_ratio"] * right)


def _with_exponent(draw: Draw, exponent: float) -> Draw:
    return lambda rng, design: {**draw(rng, design), "exponent": exponent}


def _load_dynamic(world: World, size: FloatArray, knobs: Knobs) -> None:
    _load_linear(world, size, knobs)
    vehicle, moment = world.design.vehicle, world.total_weight_N * world.design.vehicle.cog_z_m

    def during(now: Moment) -> None:
        across = moment * now.v_mps**2 * now.curvature_per_m / (9.81 * vehicle.track_m)
        along = -0.5 * moment * now.acceleration_mps2 / (9.81 * vehicle.wheelbase_m)
        now.roll_more(size * (-across - along), size * knobs["right_ratio"] * (across - along))

    world.during.append(during)


def _payload_share(world: World) -> list[FloatArray]:
    bare, loaded = world.design.vehicle.unladen_load_N, world.design.payload_kg > 0
    return [np.where(loaded, load - bare, 0.0) for load in (world.load_left_N, world.load_right_N)]


def _creep_one(world: World, size: FloatArray, knobs: Knobs) -> None:
    grown = 1 - np.exp(-np.nan_to_num(world.design.minutes_under_load) / knobs["tau_min"])
    world.enlarge(*(-size * share * grown for share in _payload_share(world)))


def _creep_two(world: World, size: FloatArray, knobs: Knobs) -> None:
    minutes = np.nan_to_num(world.design.minutes_under_load)
    left, right = _payload_share(world)

    def grown(t_min: FloatArray) -> FloatArray:
        fast, slow = 1 - np.exp(-t_min / (0.5 * knobs["tau_min"])), 1 - np.exp(-t_min / (3 * knobs["tau_min"]))
        return 0.55 * fast + 0.45 * slow

    start = grown(minutes)
    world.enlarge(-size * left * start, -size * right * start)

    def during(now: Moment) -> None:
        growth = grown(minutes + now.t_s / 60) - start
        now.roll_more(-size * left * growth, -size * right * growth)

    world.during.append(during)


@while_driving
def _eccentric(now: Moment, world: World, size: FloatArray, knobs: Knobs) -> None:
    share = size / world.design.vehicle.wheel_radius_m
    left, right = now.angle_left_rad + knobs["left_rad"], now.angle_right_rad + knobs["right_rad"]
    now.roll_more(share * np.cos(left), share * np.cos(right))


def _warm(world: World, size: FloatArray, _knobs: Knobs) -> None:
    world.enlarge(size * np.nan_to_num(world.design.temperature_C - 20.0))


def _warm_stiffness(world: World, size: FloatArray, _knobs: Knobs) -> None:
    warm = 40.0 * np.expm1(np.nan_to_num(world.design.temperature_C - 20.0) / 40.0)
    mean, loads = float(np.mean(world.mean_load_N)), (world.load_left_N, world.load_right_N)
    world.enlarge(*(size * warm * (1 + 0.15 * (load / mean - 1)) for load in loads))


def load_by_temperature(world: World, size: FloatArray, _knobs: Knobs) -> None:
    """Enlarge the radii by load and temperature together, as no library has it."""
    world.enlarge(size * (standardised(world.mean_load_N) * standardised(world.design.temperature_C)))


def _session_index(design: Design) -> tuple[FloatArray, int]:
    names, first, index = np.unique(design.session, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[index].astype(np.float64), len(names)


def _wear(world: World, size: FloatArray, knobs: Knobs) -> None:
    grown = _session_index(world.design)[0] ** knobs.get("exponent", 1.0)
    world.enlarge(-size * grown, -size * knobs["right_ratio"] * grown)


def _session_knobs(rng: np.random.Generator, design: Design) -> dict[str, float]:
    steps = rng.standard_normal(_session_index(design)[1])
    steps -= steps.mean()
    steps /= max(float(np.sqrt(np.mean(steps**2))), 1e-9)
    return {f"step_{number}": float(value) for number, value in enumerate(steps)}


def _one_session(rng: np.random.Generator, design: Design) -> dict[str, float]:
    _, count = _session_index(design)
    odd = int(rng.integers(1, count)) if count > 1 else 0
    return {f"step_{number}": 2.0 if number == odd else 0.0 for number in range(count)}


def _session(world: World, size: FloatArray, knobs: Knobs) -> None:
    index, count = _session_index(world.design)
    steps = np.array([knobs.get(f"step_{number}", 0.0) for number in range(count)])[index.astype(np.int64)]
    world.enlarge(size * steps)


def _column(world: World, size: FloatArray, knobs: Knobs) -> None:
    name = next(key for key in knobs if key.startswith("column:")).removeprefix("column:")
    world.enlarge(size * standardised(world.design.columns[name]))


def _named(name: str) -> Draw:
    return lambda _rng, _design: {f"column:{name}": 1.0}


_WHEEL_SLOPES = drawn(right_ratio=(0.75, 1.15))
_MILD_POWER = drawn(right_ratio=(0.75, 1.15), exponent=(0.83, 0.92))
_CREEP_TIME = drawn(tau_min=(8.0, 25.0))
_PHASES = drawn(left_rad=(0, 2 * np.pi), right_rad=(0, 2 * np.pi))
_WEAR_RATES = drawn(right_ratio=(0.3, 0.8))
_RUNNING_IN = _with_exponent(_WEAR_RATES, 0.8)
_POWERS = {name: _with_exponent(_WHEEL_SLOPES, p) for name, p in (("hertz", 2 / 3), ("root", 0.5), ("quadratic", 2.0))}

FORMS = (
    Form("radius_scale", "plain", 3e-3, "1", scaled("left", "right")),
    Form("unequal_radii", "plain", 1.5e-3, "1", lambda world, size, _: world.enlarge(-0.5 * size, 0.5 * size), "poses"),
    Form("track_width", "plain", 1e-2, "1", scaled("track"), "turns"),
    Form("load_radius", "plain", 8e-6, "1/N", _load_linear, "loads", _WHEEL_SLOPES),
    Form("load_radius", "power", 8e-6, "1/N", _load_power, "loads", _MILD_POWER),
    Form("load_radius", "dynamic", 8e-6, "1/N", _load_dynamic, "loads", _WHEEL_SLOPES),
    *(
        Form("load_radius_nonlinear", form, 8e-6, "1/N", _load_power, "loads offsets", knobs)
        for form, knobs in _POWERS.items()
    ),
    Form("load_creep", "plain", 2e-6, "1/N", _creep_one, "loads dwell", _CREEP_TIME),
    Form("load_creep", "two_times", 2e-6, "1/N", _creep_two, "loads dwell", _CREEP_TIME),
    Form("wheel_eccentricity", "plain", 2e-4, "m", _eccentric, "trace", _PHASES),
    Form("temperature_radius", "plain", 6e-5, "1/K", _warm, "temperatures"),
    Form("temperature_radius", "stiffness", 6e-5, "1/K", _warm_stiffness, "temperatures"),
    Form("wear", "plain", 2e-4, "1/session", _wear, "sessions poses", _WEAR_RATES),
    Form("wear", "running_in", 2e-4, "1/session", _wear, "sessions poses", _RUNNING_IN),
    Form("session_step", "plain", 5e-4, "1", _session, "sessions", _session_knobs),
    Form("session_step", "one_session", 4e-4, "1", _session, "sessions", _one_session),
    *(Form(f"covariate:{name}", "plain", 5e-4, "1/sd", _column, f"column:{name}", _named(name)) for name in COLUMNS),
)


def _lever(world: World) -> FloatArray:
    vehicle = world.design.vehicle
    return world.total_weight_N * vehicle.cog_z_m / (9.81 * vehicle.track_m)


@while_driving
def _transfer(now: Moment, world: World, size: FloatArray, _knobs: Knobs) -> None:
    moved = size * _lever(world) * now.v_mps**2 * now.curvature_per_m
    now.roll_more(-moved, moved)


def _transfer_roll(world: World, size: FloatArray, _knobs: Knobs) -> None:
    # the body rolls on its springs first
    lever, roll, before_s = _lever(world), np.zeros(len(world.design)), 0.0

    def during(now: Moment) -> None:
        nonlocal roll, before_s
        roll = roll + (now.v_mps**2 * now.curvature_per_m - roll) * (now.t_s - before_s) / 0.35
        before_s = now.t_s
        moved = size * lever * roll
        now.roll_more(-moved, moved)

    world.during.append(during)


def _loaded_track(world: World, size: FloatArray, _knobs: Knobs) -> None:
    world.track = world.track * (1 + size * (world.mean_load_N - REFERENCE_LOAD_N))


def _loaded_track_soft(world: World, size: FloatArray, _knobs: Knobs) -> None:
    world.track = world.track * (1 + size * _power(world.mean_load_N, 0.85))


@while_driving
def _scrub(now: Moment, _world: World, size: FloatArray, _knobs: Knobs) -> None:
    now.track += size * np.abs(now.curvature_per_m)


@while_driving
def _scrub_torque(now: Moment, world: World, size: FloatArray, _knobs: Knobs) -> None:
    # the torque that turns the contact patches saturates
    load = (world.mean_load_N / float(np.mean(world.mean_load_N))) ** 0.15
    now.track += size * load * 1.6 * np.tanh(np.abs(now.curvature_per_m) / 1.6)


@while_driving
def _side_slip(now: Moment, _world: World, size: FloatArray, _knobs: Knobs) -> None:
    now.lateral_mps -= size * now.v_mps**3 * now.curvature_per_m


def _braked(now: Moment) -> FloatArray:
    # its size in metres a stop from 0.5 m/s: braking at a takes v^2/2a
    return 8.0 * np.maximum(-now.acceleration_mps2, 0.0)


def _drag(world: World, size: FloatArray, knobs: Knobs) -> None:
    dragged = size * (world.design.direction == "back")
    world.enlarge(dragged * (not knobs["right"]), dragged * bool(knobs["right"]))


def _direction(world: World, size: FloatArray, _knobs: Knobs) -> None:
    direction = world.design.direction
    world.enlarge(size * ((direction == "out") * 1.0 - (direction == "back") * 1.0))


@while_driving
def _drive_slip(now: Moment, _world: World, size: FloatArray, _knobs: Knobs) -> None:
    now.drive += size * (now.acceleration_mps2 + 0.02 * 9.81 * np.sign(now.v_mps)) / 0.3


@while_driving
def _drive_slip_soft(now: Moment, world: World, size: FloatArray, _knobs: Knobs) -> None:
    weight = world.total_weight_N / float(np.mean(world.total_weight_N))
    force = (now.acceleration_mps2 + 0.02 * 9.81 * np.sign(now.v_mps)) / 0.3
    now.drive += size * weight**0.5 * force * (1 + 0.2 * np.abs(force))


MOVING = (
    Form("speed_radius", "plain", 3e-4, "s/m", rolling(lambda now: now.v_mps - 0.5), "speeds"),
    Form("speed_radius", "squared", 3e-4, "s/m", rolling(lambda now: now.v_mps**2 - 0.25), "speeds"),
    Form("curve_load_transfer", "plain", 1e-5, "1/N", _transfer, "turns speeds loads poses"),
    Form("curve_load_transfer", "roll", 1e-5, "1/N", _transfer_roll, "turns speeds loads poses"),
    Form("load_dependent_track", "plain", 1e-5, "1/N", _loaded_track, "turns loads poses"),
    Form("load_dependent_track", "soft", 1e-5, "1/N", _loaded_track_soft, "turns loads poses"),
    Form("curve_scrub", "plain", 2e-2, "m", _scrub, "bends poses"),
    Form("curve_scrub", "torque", 2e-2, "m", _scrub_torque, "bends poses"),
    Form("side_slip", "plain", 1e-2, "s2/m", _side_slip, "turns speeds poses"),
    Form("braking_skid", "plain", 8e-4, "m", rolling(_braked), "stops speeds"),
    Form("rear_drag", "plain", 5e-4, "1", _drag, "directions poses", either_side),
    Form("travel_direction", "plain", 1e-3, "1", _direction, "directions"),
    Form("drive_slip", "plain", 5e-3, "1", _drive_slip, "front stops"),
    Form("drive_slip", "soft", 5e-3, "1", _drive_slip_soft, "front stops"),
)
