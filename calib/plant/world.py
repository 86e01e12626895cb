"""The true world of a campaign: what the wheels, floor and instruments really are, run by run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from calib.campaign.settings import OdometryModel
from calib.plant.design import Design
from calib.types import FloatArray
from calib.units import GRAVITY_MPS2
from calib.vehicle import Vehicle

REFERENCE_LOAD_N = 300.0


@dataclass(slots=True)
class Moment:
    """All runs at one time step; effects read the upper part and add to the lower."""

    t_s: float  #: time since the start
    #: v_mps, acceleration_mps2, curvature_per_m: shape (n_runs,): true motion of the rear axle's middle
    v_mps: FloatArray
    acceleration_mps2: FloatArray
    curvature_per_m: FloatArray
    #: x_m, y_m, theta_rad: shape (n_runs,): true pose in the run's own frame
    x_m: FloatArray
    y_m: FloatArray
    theta_rad: FloatArray
    #: angle_left_rad, angle_right_rad: shape (n_runs,): rotation of the rear wheels
    angle_left_rad: FloatArray
    angle_right_rad: FloatArray
    #: left, right: shape (n_runs,): relative change of the rolling radii
    left: FloatArray
    right: FloatArray
    track: FloatArray  #: shape (n_runs,): relative change of the effective track
    #: lost_left, lost_right: shape (n_runs,): share of the counts that is lost
    lost_left: FloatArray
    lost_right: FloatArray
    lateral_mps: FloatArray  #: shape (n_runs,): true lateral speed of the rear axle's middle
    yaw_radps: FloatArray  #: shape (n_runs,): true yaw that no wheel sees
    drive: FloatArray  #: shape (n_runs,): slip of the driven front wheel

    @staticmethod
    def at_rest(n_runs: int) -> Moment:
        """Return the moment before the start."""
        zero = np.zeros(n_runs)
        return Moment(0.0, *(zero.copy() for _ in range(16)))

    def clear(self) -> None:
        """Forget what the effects added."""
        for name in ("left", "right", "track", "lost_left", "lost_right", "lateral_mps", "yaw_radps", "drive"):
            getattr(self, name).fill(0.0)

    def roll_more(self, left: FloatArray, right: FloatArray | None = None) -> None:
        """Add shares to the rolling radii; the same to both where only one is given."""
        self.left += left
        self.right += left if right is None else right

    def lose_counts(self, share: FloatArray, *, right: bool) -> None:
        """Add a share to what the counter of one side loses."""
        lost = self.lost_right if right else self.lost_left
        lost += share


@dataclass(slots=True)
class World:
    """What is true, an array over runs each; effects change it before the drive."""

    design: Design  #: the runs
    model: OdometryModel  #: what the vehicle and the simulator believe
    #: load_left_N, load_right_N: shape (n_runs,): true static loads of the rear wheels
    load_left_N: FloatArray
    load_right_N: FloatArray
    #: believed_left_m, believed_right_m: shape (n_runs,): the model's radii at the reported loads
    believed_left_m: FloatArray
    believed_right_m: FloatArray
    #: left, right, track: shape (n_runs,): true radii and track over what the model believes at the *true* load
    left: FloatArray
    right: FloatArray
    track: FloatArray
    #: laser_scale, laser_offset_m: shape (n_runs,): of the rangefinder
    laser_scale: FloatArray
    laser_offset_m: FloatArray
    #: ref_yaw_rad, ref_lever_x_m, ref_lever_y_m, latency_s: shape (n_runs,): of the pose reference
    ref_yaw_rad: FloatArray
    ref_lever_x_m: FloatArray
    ref_lever_y_m: FloatArray
    latency_s: FloatArray
    #: steer_zero_rad, steer_scale, steer_backlash_rad, steer_delay_s: shape (n_runs,): of the steering angle sensor
    steer_zero_rad: FloatArray
    steer_scale: FloatArray
    steer_backlash_rad: FloatArray
    steer_delay_s: FloatArray
    #: weave_m, wavelength_m: shape (n_runs,): weave of the path driven
    weave_m: FloatArray
    wavelength_m: FloatArray
    rise: FloatArray  #: shape (n_runs,): surplus of the path over its plan, from an uneven floor
    euler: FloatArray  #: shape (n_runs,): 1 where the outside simulator takes the heading at the end of its steps
    gross_runs: FloatArray  #: shape (n_runs,): 1 for the runs that it strikes
    #: payload_scale, payload_dx_m, payload_dy_m: shape (n_runs,): true payload against the reported one
    payload_scale: FloatArray
    payload_dx_m: FloatArray
    payload_dy_m: FloatArray
    gross: str = ""  #: a blunder of the counters in the record; empty is none
    during: list[Callable[[Moment], None]] = field(default_factory=list)  #: effects that act while driving

    def enlarge(self, left: FloatArray, right: FloatArray | None = None) -> None:
        """Make the radii larger by a share, by the same where only one is given."""
        self.left = self.left * (1 + left)
        self.right = self.right * (1 + (left if right is None else right))

    @property
    def mean_load_N(self) -> FloatArray:
        """Mean true load of the rear wheels, shape (n_runs,)."""
        mean: FloatArray = 0.5 * (self.load_left_N + self.load_right_N)
        return mean

    @property
    def total_weight_N(self) -> FloatArray:
        """True weight of vehicle and payload, shape (n_runs,)."""
        weight: FloatArray = GRAVITY_MPS2 * (self.design.vehicle.mass_kg + self.payload_scale * self.design.payload_kg)
        return weight

    def settle(self) -> None:
        """Put the true payload on: the true loads, and the radii that follow from the law truth and model share."""
        design, model = self.design, self.model

        def lawful() -> tuple[FloatArray, FloatArray]:
            left_N, right_N = self.load_left_N - model.reference_load_N, self.load_right_N - model.reference_load_N
            return (
                model.radius_left_m + model.slope_left_m_per_N * left_N,
                model.radius_right_m + model.slope_right_m_per_N * right_N,
            )

        left_before, right_before = lawful()
        self.load_left_N, self.load_right_N = wheel_loads(
            design.vehicle,
            self.payload_scale * design.payload_kg,
            design.payload_x_m + self.payload_dx_m,
            design.payload_y_m + self.payload_dy_m,
        )
        left_after, right_after = lawful()
        self.left = self.left * left_after / left_before
        self.right = self.right * right_after / right_before


def standardised(values: FloatArray) -> FloatArray:
    """Return values less their mean, in standard deviations."""
    spread: FloatArray = (values - values.mean()) / max(float(values.std()), 1e-12)
    return spread


def wheel_loads(
    vehicle: Vehicle, payload_kg: FloatArray, payload_x_m: FloatArray, payload_y_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the static loads of the left and right rear wheel by moments about the axle and the centre line.

    The payload stands ahead of the rear axle and left of the centre line; all arrays (n_runs,).
    """
    length, width = vehicle.wheelbase_m, vehicle.track_m
    rear = vehicle.mass_kg * (1 - vehicle.cog_x_m / length) + payload_kg * (1 - payload_x_m / length)
    moment = vehicle.mass_kg * vehicle.cog_y_m + payload_kg * payload_y_m
    left: FloatArray = GRAVITY_MPS2 * (0.5 * rear + moment / width)
    right: FloatArray = GRAVITY_MPS2 * (0.5 * rear - moment / width)
    return left, right


def build_world(design: Design, model: OdometryModel) -> World:
    """Return the world in which the model is right."""
    n_runs = len(design)
    left_N, right_N = wheel_loads(design.vehicle, design.payload_kg, design.payload_x_m, design.payload_y_m)
    arrays: dict[str, Any] = {field.name: np.zeros(n_runs) for field in fields(World) if field.type == "FloatArray"}
    ones = ("left", "right", "track", "laser_scale", "steer_scale", "payload_scale")
    arrays |= {name: np.ones(n_runs) for name in ones} | {"wavelength_m": np.full(n_runs, 5.0)}
    arrays |= {"load_left_N": left_N, "load_right_N": right_N}
    arrays["believed_left_m"] = model.radius_left_m + model.slope_left_m_per_N * (left_N - model.reference_load_N)
    arrays["believed_right_m"] = model.radius_right_m + model.slope_right_m_per_N * (right_N - model.reference_load_N)
    return World(design, model, **arrays)
