"""What is wrong with what measures: rangefinder, pose reference, counters, steering sensor, payload labels."""

from __future__ import annotations

import numpy as np

from calib.arrays import FloatArray
from calib.plant.design import Design
from calib.plant.effects.form import Form, Knobs
from calib.plant.world import Moment, World


def _laser_scale(world: World, size: FloatArray, _knobs: Knobs) -> None:
    world.laser_scale = world.laser_scale * (1 + size)


def _laser_offset(world: World, size: FloatArray, _knobs: Knobs) -> None:
    world.laser_offset_m = world.laser_offset_m + size


def _beam(world: World, size: FloatArray, _knobs: Knobs) -> None:
    world.laser_scale = world.laser_scale / np.cos(size)


def _lever_knobs(rng: np.random.Generator, _design: Design) -> dict[str, float]:
    return {"towards_rad": float(rng.uniform(-np.pi, np.pi))}


def _lever(world: World, size: FloatArray, knobs: Knobs) -> None:
    world.ref_lever_x_m = world.ref_lever_x_m + size * np.cos(knobs["towards_rad"])
    world.ref_lever_y_m = world.ref_lever_y_m + size * np.sin(knobs["towards_rad"])


def _yaw(world: World, size: FloatArray, _knobs: Knobs) -> None:
    world.ref_yaw_rad = world.ref_yaw_rad + size


def _latency(world: World, size: FloatArray, _knobs: Knobs) -> None:
    world.latency_s = world.latency_s + size


# counters


def _side_knobs(rng: np.random.Generator, _design: Design) -> dict[str, float]:
    return {"right": float(rng.integers(2))}


def _lost_with_speed(world: World, size: FloatArray, knobs: Knobs) -> None:
    # a share of `size` at 0.5 m/s, with the square of the speed
    def during(now: Moment) -> None:
        share = size * (now.v_mps / 0.5) ** 2
        if knobs["right"]:
            now.lost_right += share
        else:
            now.lost_left += share

    world.during.append(during)


def _lost_above(world: World, size: FloatArray, knobs: Knobs) -> None:
    """Nothing is lost below 0.3 m/s, and more and more above it."""

    def during(now: Moment) -> None:
        share = size * np.maximum(now.v_mps - 0.3, 0.0) / 0.2
        if knobs["right"]:
            now.lost_right += share
        else:
            now.lost_left += share

    world.during.append(during)


def _lost_constant(world: World, size: FloatArray, knobs: Knobs) -> None:
    # a fixed share: exactly a larger radius of that wheel
    def during(now: Moment) -> None:
        if knobs["right"]:
            now.lost_right += size
        else:
            now.lost_left += size

    world.during.append(during)


def _gross(kind: str) -> object:
    def act(world: World, size: FloatArray, _knobs: Knobs) -> None:
        world.gross = kind
        world.gross_runs = np.maximum(world.gross_runs, size)

    return act


# steering sensor


def _steer_zero(world: World, size: FloatArray, _knobs: Knobs) -> None:
    world.steer_zero_rad = world.steer_zero_rad + size


def _steer_scale(world: World, size: FloatArray, _knobs: Knobs) -> None:
    world.steer_scale = world.steer_scale * (1 + size)


def _steer_backlash(world: World, size: FloatArray, _knobs: Knobs) -> None:
    world.steer_backlash_rad = world.steer_backlash_rad + size


def _steer_delay(world: World, size: FloatArray, _knobs: Knobs) -> None:
    world.steer_delay_s = world.steer_delay_s + size


# payload as reported


def _payload_mass(world: World, size: FloatArray, _knobs: Knobs) -> None:
    # the heaviest label's mass is not what it says
    wrong = world.design.payload_kg == world.design.payload_kg.max()
    world.payload_scale = world.payload_scale * (1 + size * wrong)
    world.settle()


def _payload_sideways(world: World, size: FloatArray, _knobs: Knobs) -> None:
    world.payload_dy_m = world.payload_dy_m + size
    world.settle()


def _payload_lengthwise(world: World, size: FloatArray, _knobs: Knobs) -> None:
    world.payload_dx_m = world.payload_dx_m + size
    world.settle()


def _outside_scheme(world: World, size: FloatArray, _knobs: Knobs) -> None:
    world.euler = np.maximum(world.euler, np.sign(size))


_LASER = frozenset({"laser", "corridor", "lengths", "turns", "poses"})
_LABELS = frozenset({"loads", "slope", "poses"})

FORMS = (
    Form("rangefinder_scale", "plain", 1.5e-3, "1", _laser_scale, _LASER),
    Form("rangefinder_offset", "plain", 5e-3, "m", _laser_offset, _LASER),
    Form("beam_misalignment", "plain", 0.05, "rad", _beam, _LASER),
    Form("reference_lever_arm", "plain", 8e-3, "m", _lever, frozenset({"turns", "poses"}), _lever_knobs),
    Form("reference_yaw", "plain", 4e-3, "rad", _yaw, frozenset({"poses", "turns"})),
    Form("reference_latency", "plain", 0.05, "s", _latency, frozenset({"flying", "speeds", "poses"})),
    Form("lost_counts", "squared", 1e-3, "1", _lost_with_speed, frozenset({"speeds", "poses"}), _side_knobs),
    Form("lost_counts", "threshold", 1e-3, "1", _lost_above, frozenset({"speeds", "poses"}), _side_knobs),
    Form("lost_counts", "constant", 2e-3, "1", _lost_constant, frozenset({"poses"}), _side_knobs),
    *(
        Form("encoder_gross", kind, 1.0, "1", _gross(kind), frozenset({"poses", "turns"}))  # type: ignore[arg-type]
        for kind in ("double_left", "quad_both", "pi_right", "swapped", "sign_left", "half_right")
    ),
    Form("steering_zero", "plain", 5e-3, "rad", _steer_zero, frozenset({"front"})),
    Form("steering_scale", "plain", 1.5e-2, "1", _steer_scale, frozenset({"front", "bends"})),
    Form("steering_backlash", "plain", 8e-3, "rad", _steer_backlash, frozenset({"front", "turns"})),
    Form("steering_delay", "plain", 0.1, "s", _steer_delay, frozenset({"front", "flying", "turns", "speeds"})),
    Form("payload_mass", "plain", 0.15, "1", _payload_mass, _LABELS | {"offsets"}),
    Form("payload_position", "sideways", 0.02, "m", _payload_sideways, _LABELS),
    Form("payload_position", "lengthwise", 0.04, "m", _payload_lengthwise, _LABELS),
    Form("integration_scheme", "plain", 1.0, "1", _outside_scheme, frozenset({"outside", "turns", "poses"})),
)
