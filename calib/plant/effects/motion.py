"""What depends on how the vehicle moves: speed, curves, braking, direction, drive."""

from __future__ import annotations

import numpy as np

from calib.plant.effects.form import Form, Knobs, either_side, while_driving
from calib.plant.world import REFERENCE_LOAD_N, Moment, World
from calib.types import FloatArray


@while_driving
def _speed(now: Moment, _world: World, size: FloatArray, _knobs: Knobs) -> None:
    grown = size * (now.v_mps - 0.5)
    now.roll_more(grown)


@while_driving
def _speed_squared(now: Moment, _world: World, size: FloatArray, _knobs: Knobs) -> None:
    """Grows with the square of the speed, as fast as the plain form at 0.5 m/s."""
    grown = size * (now.v_mps**2 - 0.25)
    now.roll_more(grown)


def _transfer(world: World, size: FloatArray, _knobs: Knobs) -> None:
    vehicle = world.design.vehicle
    lever = world.total_weight_N * vehicle.cog_z_m / (9.81 * vehicle.track_m)

    def during(now: Moment) -> None:
        moved = size * lever * now.v_mps**2 * now.curvature_per_m
        now.roll_more(-moved, moved)

    world.during.append(during)


def _transfer_roll(world: World, size: FloatArray, _knobs: Knobs) -> None:
    # the body rolls on its springs first: the transfer follows with a lag
    vehicle = world.design.vehicle
    lever = world.total_weight_N * vehicle.cog_z_m / (9.81 * vehicle.track_m)
    roll, before_s = np.zeros(len(world.design)), 0.0

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
    # the contact patches spread: with the 0.85th power of the load
    low, high = REFERENCE_LOAD_N**0.85, 1100.0**0.85
    world.track = world.track * (1 + size * 800 * (world.mean_load_N**0.85 - low) / (high - low))


@while_driving
def _scrub(now: Moment, _world: World, size: FloatArray, _knobs: Knobs) -> None:
    now.track += size * np.abs(now.curvature_per_m)


def _scrub_torque(world: World, size: FloatArray, _knobs: Knobs) -> None:
    """By the torque that turns the contact patches: saturates in tight curves, a little more under load."""
    load = (world.mean_load_N / float(np.mean(world.mean_load_N))) ** 0.15

    def during(now: Moment) -> None:
        now.track += size * load * 1.6 * np.tanh(np.abs(now.curvature_per_m) / 1.6)

    world.during.append(during)


@while_driving
def _side_slip(now: Moment, _world: World, size: FloatArray, _knobs: Knobs) -> None:
    """Slip angle in proportion to the lateral acceleration; outwards in a curve."""
    now.lateral_mps -= size * now.v_mps**3 * now.curvature_per_m


@while_driving
def _skid(now: Moment, _world: World, size: FloatArray, _knobs: Knobs) -> None:
    # the wheels slip while braking: `size` metres a stop from 0.5 m/s, with the square of the speed
    # braking at a takes v^2/2a metres: the slip size * 2a/0.25 makes size (v/0.5)^2 of them
    slip = size * 2.0 * np.maximum(-now.acceleration_mps2, 0.0) / 0.25
    now.roll_more(slip)


def _drag(world: World, size: FloatArray, knobs: Knobs) -> None:
    """One wheel drags on the way back only, and so turns less than it rolls."""
    dragged = 1 + size * (world.design.direction == "back")
    if knobs["right"]:
        world.right = world.right * dragged
    else:
        world.left = world.left * dragged


def _direction(world: World, size: FloatArray, _knobs: Knobs) -> None:
    direction = world.design.direction
    sign = (direction == "out") * 1.0 - (direction == "back") * 1.0
    world.enlarge(size * sign)


@while_driving
def _drive_slip(now: Moment, _world: World, size: FloatArray, _knobs: Knobs) -> None:
    # the driven wheel slips with its traction: rolling resistance and acceleration; `size` at 0.3 m/s^2
    now.drive += size * (now.acceleration_mps2 + 0.02 * 9.81 * np.sign(now.v_mps)) / 0.3


def _drive_slip_soft(world: World, size: FloatArray, _knobs: Knobs) -> None:
    # the same, rising faster than its traction, and with the payload
    weight = world.total_weight_N / float(np.mean(world.total_weight_N))

    def during(now: Moment) -> None:
        force = (now.acceleration_mps2 + 0.02 * 9.81 * np.sign(now.v_mps)) / 0.3
        now.drive += size * weight**0.5 * force * (1 + 0.2 * np.abs(force))

    world.during.append(during)


FORMS = (
    Form("speed_radius", "plain", 3e-4, "s/m", _speed, frozenset({"speeds"})),
    Form("speed_radius", "squared", 3e-4, "s/m", _speed_squared, frozenset({"speeds"})),
    Form("curve_load_transfer", "plain", 1e-5, "1/N", _transfer, frozenset({"turns", "speeds", "loads", "poses"})),
    Form("curve_load_transfer", "roll", 1e-5, "1/N", _transfer_roll, frozenset({"turns", "speeds", "loads", "poses"})),
    Form("load_dependent_track", "plain", 1e-5, "1/N", _loaded_track, frozenset({"turns", "loads", "poses"})),
    Form("load_dependent_track", "soft", 1e-5, "1/N", _loaded_track_soft, frozenset({"turns", "loads", "poses"})),
    Form("curve_scrub", "plain", 2e-2, "m", _scrub, frozenset({"bends", "poses"})),
    Form("curve_scrub", "torque", 2e-2, "m", _scrub_torque, frozenset({"bends", "poses"})),
    Form("side_slip", "plain", 1e-2, "s2/m", _side_slip, frozenset({"turns", "speeds", "poses"})),
    Form("braking_skid", "plain", 8e-4, "m", _skid, frozenset({"stops", "speeds"})),
    Form("rear_drag", "plain", 5e-4, "1", _drag, frozenset({"directions", "poses"}), either_side),
    Form("travel_direction", "plain", 1e-3, "1", _direction, frozenset({"directions"})),
    Form("drive_slip", "plain", 5e-3, "1", _drive_slip, frozenset({"front", "stops"})),
    Form("drive_slip", "soft", 5e-3, "1", _drive_slip_soft, frozenset({"front", "stops"})),
)
