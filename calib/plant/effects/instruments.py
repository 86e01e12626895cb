"""What is wrong with what measures: rangefinder, pose reference, counters, steering sensor, payload labels."""

from __future__ import annotations

import numpy as np

from calib.plant.effects.form import Act, Form, Knobs, added, drawn, either_side, scaled, while_driving
from calib.plant.world import Moment, World
from calib.types import FloatArray


def _beam(world: World, size: FloatArray, _knobs: Knobs) -> None:
    world.laser_scale = world.laser_scale / np.cos(size)


def _lever(world: World, size: FloatArray, knobs: Knobs) -> None:
    world.ref_lever_x_m = world.ref_lever_x_m + size * np.cos(knobs["towards_rad"])
    world.ref_lever_y_m = world.ref_lever_y_m + size * np.sin(knobs["towards_rad"])


# counters


@while_driving
def _lost_with_speed(now: Moment, _world: World, size: FloatArray, knobs: Knobs) -> None:
    # a share of `size` at 0.5 m/s, with the square of the speed
    share = size * (now.v_mps / 0.5) ** 2
    now.lose_counts(share, right=bool(knobs["right"]))


@while_driving
def _lost_above(now: Moment, _world: World, size: FloatArray, knobs: Knobs) -> None:
    """Nothing is lost below 0.3 m/s, and more and more above it."""
    share = size * np.maximum(now.v_mps - 0.3, 0.0) / 0.2
    now.lose_counts(share, right=bool(knobs["right"]))


@while_driving
def _lost_constant(now: Moment, _world: World, size: FloatArray, knobs: Knobs) -> None:
    # a fixed share: exactly a larger radius of that wheel
    now.lose_counts(size, right=bool(knobs["right"]))


def _gross(kind: str) -> Act:
    def act(world: World, size: FloatArray, _knobs: Knobs) -> None:
        world.gross = kind
        world.gross_runs = np.maximum(world.gross_runs, size)

    return act


# steering sensor


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


_TOWARDS = drawn(towards_rad=(-np.pi, np.pi))
_LASER = frozenset({"laser", "corridor", "lengths", "turns", "poses"})
_LABELS = frozenset({"loads", "slope", "poses"})
_FRONT = frozenset({"front"})

FORMS = (
    Form("rangefinder_scale", "plain", 1.5e-3, "1", scaled("laser_scale"), _LASER),
    Form("rangefinder_offset", "plain", 5e-3, "m", added("laser_offset_m"), _LASER),
    Form("beam_misalignment", "plain", 0.05, "rad", _beam, _LASER),
    Form("reference_lever_arm", "plain", 8e-3, "m", _lever, frozenset({"turns", "poses"}), _TOWARDS),
    Form("reference_yaw", "plain", 4e-3, "rad", added("ref_yaw_rad"), frozenset({"poses", "turns"})),
    Form("reference_latency", "plain", 0.05, "s", added("latency_s"), frozenset({"flying", "speeds", "poses"})),
    Form("lost_counts", "squared", 1e-3, "1", _lost_with_speed, frozenset({"speeds", "poses"}), either_side),
    Form("lost_counts", "threshold", 1e-3, "1", _lost_above, frozenset({"speeds", "poses"}), either_side),
    Form("lost_counts", "constant", 2e-3, "1", _lost_constant, frozenset({"poses"}), either_side),
    *(
        Form("encoder_gross", kind, 1.0, "1", _gross(kind), frozenset({"poses", "turns"}))
        for kind in ("double_left", "quad_both", "pi_right", "swapped", "sign_left", "half_right")
    ),
    Form("steering_zero", "plain", 5e-3, "rad", added("steer_zero_rad"), _FRONT),
    Form("steering_scale", "plain", 1.5e-2, "1", scaled("steer_scale"), _FRONT | {"bends"}),
    Form("steering_backlash", "plain", 8e-3, "rad", added("steer_backlash_rad"), _FRONT | {"turns"}),
    Form("steering_delay", "plain", 0.1, "s", added("steer_delay_s"), _FRONT | {"flying", "turns", "speeds"}),
    Form("payload_mass", "plain", 0.15, "1", _payload_mass, _LABELS | {"offsets"}),
    Form("payload_position", "sideways", 0.02, "m", _payload_sideways, _LABELS),
    Form("payload_position", "lengthwise", 0.04, "m", _payload_lengthwise, _LABELS),
    Form("integration_scheme", "plain", 1.0, "1", _outside_scheme, frozenset({"outside", "turns", "poses"})),
)
