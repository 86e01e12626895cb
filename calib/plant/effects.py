"""Every form of every effect; here those of place, instruments, and no library."""

from collections.abc import Callable
from typing import Final

import numpy as np

from calib.errors import BadInputError
from calib.plant import Act, Form, Knobs, Moment, World, added, drawn, either_side, scaled, wheels, while_driving
from calib.plant.design import Design, conditions
from calib.types import BoolArray, FloatArray


def _map_x_m(world: World, now: Moment) -> FloatArray:
    return world.design.start_x_m + world.design.heading_sign * now.x_m


def _slope_knobs(rng: np.random.Generator, design: Design) -> dict[str, float]:
    return {"downhill_rad": 0.0 if design.corridor.all() else float(rng.uniform(-np.pi, np.pi))}


@while_driving
def _slope(now: Moment, world: World, size: FloatArray, knobs: Knobs) -> None:
    offset = np.where(world.design.heading_sign < 0, np.pi, 0.0) - knobs["downhill_rad"]
    now.roll_more(size * np.cos(now.theta_rad + offset))


def _zone_knobs(rng: np.random.Generator, design: Design) -> dict[str, float]:
    reach = design.length_m if design.corridor.all() else min(design.length_m, 8.0)
    return {"at_m": float(rng.uniform(0.2, 0.6) * reach), "long_m": float(rng.uniform(1.0, 2.5))}


def _in_zone(world: World, now: Moment, knobs: Knobs) -> BoolArray:
    place = _map_x_m(world, now) - knobs["at_m"]
    return (place > 0) & (place < knobs["long_m"])


@while_driving
def _zone_distance(now: Moment, world: World, size: FloatArray, knobs: Knobs) -> None:
    now.roll_more(size * _in_zone(world, now, knobs))


@while_driving
def _zone_heading(now: Moment, world: World, size: FloatArray, knobs: Knobs) -> None:
    inside = size * _in_zone(world, now, knobs) * world.design.heading_sign
    now.roll_more(0.5 * inside, -0.5 * inside)


def _undulation(world: World, size: FloatArray, _knobs: Knobs) -> None:
    world.rise = world.rise + size * np.char.endswith(world.design.kind, "_b")


def _weave(world: World, size: FloatArray, knobs: Knobs) -> None:
    shares = np.array([knobs[f"share_{number}"] for number in range(8)])
    world.weave_m = np.where(world.design.corridor, size * shares[np.arange(len(world.design)) % 8], 0.0)
    world.wavelength_m = np.full(len(world.design), knobs["wavelength_m"])


def _weave_knobs(rng: np.random.Generator, design: Design) -> dict[str, float]:
    shares = {f"share_{number}": float(rng.uniform(0.0, 1.0)) for number in range(8)}
    return {**shares, "wavelength_m": design.length_m / float(rng.integers(3, 6))}


@while_driving
def _one_speed(now: Moment, _world: World, size: FloatArray, knobs: Knobs) -> None:
    now.roll_more(size * np.exp(-(((now.v_mps - knobs["at_mps"]) / 0.04) ** 2)))


def _middle_speed(_rng: np.random.Generator, design: Design) -> dict[str, float]:
    speeds = np.unique(design.speed_mps)
    return {"at_mps": float(speeds[len(speeds) // 2])}


@while_driving
def _left_only(now: Moment, _world: World, size: FloatArray, _knobs: Knobs) -> None:
    now.track += size * (now.curvature_per_m > 0.05)


def _hidden(world: World, size: FloatArray, knobs: Knobs) -> None:
    number = conditions(world.design)
    drawn = np.random.default_rng(int(knobs["seed"])).standard_normal((2, int(number.max()) + 1))
    drawn -= drawn.mean(axis=1, keepdims=True)
    world.enlarge(size * drawn[0, number], size * (0.7 * drawn[0, number] + 0.7 * drawn[1, number]))


@while_driving
def _pull(now: Moment, world: World, size: FloatArray, knobs: Knobs) -> None:
    wave = np.sin(2 * np.pi * _map_x_m(world, now) / knobs["wave_x_m"] + knobs["phase_rad"])
    map_y_m = world.design.heading_sign * now.y_m
    now.yaw_radps += size * now.v_mps * wave * np.cos(2 * np.pi * map_y_m / knobs["wave_y_m"])


_PULL_WAVES = drawn(wave_x_m=(5.0, 9.0), wave_y_m=(6.0, 12.0), phase_rad=(-np.pi, np.pi))


FLOOR = (
    Form("floor_slope", "plain", 3e-4, "1", _slope, "directions poses", _slope_knobs),
    Form("floor_zone", "distance", 3e-3, "m/m", _zone_distance, "corridor directions", _zone_knobs),
    Form("floor_zone", "heading", 3e-3, "m/m", _zone_heading, "corridor directions", _zone_knobs),
    Form("floor_undulation", "plain", 4e-4, "1", _undulation, "lanes"),
    Form("path_weave", "plain", 0.05, "m", _weave, "corridor no_logs laser", _weave_knobs),
)

OUTSIDE = (
    Form("outside:load_by_temperature", "plain", 8e-4, "1", wheels.load_by_temperature, "loads temperatures"),
    Form("outside:one_speed", "plain", 1.5e-3, "1", _one_speed, "three_speeds", _middle_speed),
    Form("outside:left_only", "plain", 1e-2, "1", _left_only, "turns bends poses"),
    Form("outside:hidden", "plain", 6e-4, "1", _hidden, "poses", lambda rng, _: {"seed": float(rng.integers(2**31))}),
    Form("outside:map_pull", "plain", 1.5e-3, "rad/m", _pull, "poses turns directions", _PULL_WAVES),
)


def _beam(world: World, size: FloatArray, _knobs: Knobs) -> None:
    world.laser_scale = world.laser_scale / np.cos(size)


def _lever(world: World, size: FloatArray, knobs: Knobs) -> None:
    world.ref_lever_x_m = world.ref_lever_x_m + size * np.cos(knobs["towards_rad"])
    world.ref_lever_y_m = world.ref_lever_y_m + size * np.sin(knobs["towards_rad"])


def _lost(share: Callable[[FloatArray], FloatArray | float]) -> Act:
    @while_driving
    def act(now: Moment, _world: World, size: FloatArray, knobs: Knobs) -> None:
        now.added[4 if knobs["right"] else 3] += size * share(now.v_mps)

    return act


def _blunder(kind: str) -> Act:
    def act(world: World, size: FloatArray, _knobs: Knobs) -> None:
        world.blunder = kind
        world.blunder_runs = np.maximum(world.blunder_runs, size)

    return act


def _payload_mass(world: World, size: FloatArray, _knobs: Knobs) -> None:
    wrong = world.design.payload_kg == world.design.payload_kg.max()
    world.payload_scale = world.payload_scale * (1 + size * wrong)
    world.settle()


def _payload_moved(name: str) -> Act:
    move = added(name)

    def act(world: World, size: FloatArray, knobs: Knobs) -> None:
        move(world, size, knobs)
        world.settle()

    return act


def _outside_scheme(world: World, size: FloatArray, _knobs: Knobs) -> None:
    world.euler = np.maximum(world.euler, np.sign(size))


#: form -> share of the counts lost at a speed
_BY_SPEED: Final[dict[str, Callable[[FloatArray], FloatArray]]] = {
    "squared": lambda v: (v / 0.5) ** 2,
    "threshold": lambda v: np.maximum(v - 0.3, 0.0) / 0.2,
}
_TOWARDS = drawn(towards_rad=(-np.pi, np.pi))
_LASER = "laser corridor lengths turns poses"

INSTRUMENTS = (
    Form("rangefinder_scale", "plain", 1.5e-3, "1", scaled("laser_scale"), _LASER),
    Form("rangefinder_offset", "plain", 5e-3, "m", added("laser_offset_m"), _LASER),
    Form("beam_misalignment", "plain", 0.05, "rad", _beam, _LASER),
    Form("reference_lever_arm", "plain", 8e-3, "m", _lever, "turns poses", _TOWARDS),
    Form("reference_yaw", "plain", 4e-3, "rad", added("ref_yaw_rad"), "poses turns"),
    Form("reference_latency", "plain", 0.05, "s", added("latency_s"), "flying speeds poses"),
    *(Form("lost_counts", form, 1e-3, "1", _lost(by), "speeds poses", either_side) for form, by in _BY_SPEED.items()),
    Form("lost_counts", "constant", 2e-3, "1", _lost(lambda _v: 1.0), "poses", either_side),
    *(
        Form("encoder_gross", kind, 1.0, "1", _blunder(kind), "poses turns")
        for kind in ("double_left", "quad_both", "pi_right", "swapped", "sign_left", "half_right")
    ),
    Form("steering_zero", "plain", 5e-3, "rad", added("steer_zero_rad"), "front"),
    Form("steering_scale", "plain", 1.5e-2, "1", scaled("steer_scale"), "front bends"),
    Form("steering_backlash", "plain", 8e-3, "rad", added("steer_backlash_rad"), "front turns"),
    Form("steering_delay", "plain", 0.1, "s", added("steer_delay_s"), "front flying turns speeds"),
    Form("payload_mass", "plain", 0.15, "1", _payload_mass, "loads slope poses offsets"),
    Form("payload_position", "sideways", 0.02, "m", _payload_moved("payload_dy_m"), "loads slope poses"),
    Form("payload_position", "lengthwise", 0.04, "m", _payload_moved("payload_dx_m"), "loads slope poses"),
    Form("integration_scheme", "plain", 1.0, "1", _outside_scheme, "outside turns poses"),
)


# sealed sets depend on this order
ALL: Final[tuple[Form, ...]] = (*wheels.FORMS, *wheels.MOVING, *FLOOR, *INSTRUMENTS, *OUTSIDE)


def effects() -> tuple[str, ...]:
    """Return the ids of all effects, each once, in the registry's order."""
    return tuple(dict.fromkeys(form.effect for form in ALL))


def forms_of(effect: str) -> tuple[Form, ...]:
    """Return the forms of an effect."""
    forms = tuple(form for form in ALL if form.effect == effect)
    if not forms:
        raise BadInputError(f"effect {effect!r} found; expected one of {', '.join(effects())}; name one of these")
    return forms


def find(effect: str, form: str = "") -> Form:
    """Return one form of an effect; its first where `form` is empty or not known for it."""
    forms = {known.form: known for known in forms_of(effect)}
    if form and form not in forms:
        raise BadInputError(f"form of {effect}: found {form!r}; expected one of {', '.join(forms)}; choose one")
    return forms[form or next(iter(forms))]
