"""The floor of the plant's own numerical noise: how large a gap comes of nothing but computing.

Three sources are kept apart. *Repeats*: the same run from other wheel angles and starts. *Step*: the same run with
half the time step. *Remainder*: what the simulator's model (two straight lines and a track) cannot say of the sound
vehicle, because its contacts transfer load in curves and creep; it is mechanics, not noise, but a campaign with
nothing wrong contains it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from calib.types import FloatArray
from tests.plant.contact.baseline import (
    Baseline,
    baseline,
    belief_of,
    dead_reckoning,
    rolling_radii_m,
)
from tests.plant.contact.machine import Machine, Payload
from tests.plant.contact.ride import COUNTS_PER_REV, Ride, Track, drive, wheel_loads_N

__all__ = ["KINDS", "NoiseFloor", "RunFloor", "noise_floor"]


#: routes of the full measurement
KINDS: Final = ("corridor", "square_ccw", "square_cw", "route_left")
_PAYLOADS: Final = (Payload(), Payload(200.0, 0.3, 0.1))


@dataclass(frozen=True, slots=True, eq=False)
class RunFloor:
    """The floor of one kind of run; each triple is along (m), lateral (m) and heading (rad) at the end.

    Parameters
    ----------
    kind : str
        Route.
    payload_kg : float
        Payload.
    remainder : array of float, shape (3,)
        Mean gap of the repeats, odometry by exact wheel angles.
    repeats_exact : array of float, shape (3,)
        Standard deviation of the gap over repeats, exact wheel angles.
    repeats_counted : array of float, shape (3,)
        The same with the quantised counters.
    halved_step : array of float, shape (3,)
        Change of the gap when the time step is halved, exact wheel angles.
    """

    kind: str
    payload_kg: float
    remainder: FloatArray
    repeats_exact: FloatArray
    repeats_counted: FloatArray
    halved_step: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class NoiseFloor:
    """The floor of a machine.

    Parameters
    ----------
    baseline : Baseline
        What the odometry believed.
    radius_step : float
        Largest relative change of an effective radius when the time step is halved.
    radius_repeats : float
        Largest relative standard deviation of an effective radius over repeats.
    straight_drift_m : float
        Largest lateral drift over 20 m, steering held straight by the loop, unladen.
    runs : tuple of RunFloor
        By route and payload.
    """

    baseline: Baseline
    radius_step: float
    radius_repeats: float
    straight_drift_m: float
    runs: tuple[RunFloor, ...]


def _perturbed(ride: Ride, rng: np.random.Generator) -> Ride:
    """Return the same run from another start: place, heading and wheel angles."""
    return replace(
        ride,
        start_m=tuple(rng.normal(0.0, 0.005, 2).tolist()),
        heading_rad=float(rng.uniform(-math.pi, math.pi)),
        phases_rad=tuple(rng.uniform(0.0, 2.0 * math.pi, 3).tolist()),
    )


def _gaps(track: Track, ride: Ride) -> tuple[FloatArray, FloatArray]:
    """Return the gap with exact angles and with counters, each (along, lateral, heading), shape (3,)."""
    end = np.array([track.x_m[-1], track.y_m[-1], track.theta_rad[-1]])
    per_count = 2.0 * math.pi / COUNTS_PER_REV
    gaps = []
    for left, right in (
        (track.left_rad, track.right_rad),
        (track.counts_left * per_count, track.counts_right * per_count),
    ):
        gap = end - dead_reckoning(left, right, ride.belief)
        cos, sin = math.cos(end[2]), math.sin(end[2])
        gaps.append(np.array([cos * gap[0] + sin * gap[1], -sin * gap[0] + cos * gap[1], gap[2]]))
    return gaps[0], gaps[1]


def noise_floor(
    machine: Machine,
    rng: np.random.Generator,
    *,
    repeats: int = 6,
    length_m: float = 20.0,
    curve_speed_mps: float = 0.2,
    kinds: Sequence[str] = KINDS,
) -> NoiseFloor:
    """Measure the floor of a sound machine.

    Parameters
    ----------
    machine : Machine
        The vehicle and its floor.
    rng : numpy.random.Generator
        Draws the starts.
    repeats : int
        Runs of each kind, at least 2.
    length_m : float
        Of the corridor.
    curve_speed_mps : float
        In curves.
    kinds : sequence of str
        Routes; the figures of the radius want the corridor among them.
    """
    believed = baseline(machine)
    halved = replace(machine, step_s=machine.step_s / 2.0)
    runs = []
    radius_step = radius_repeats = drift = 0.0
    for payload in _PAYLOADS:
        loads = wheel_loads_N(machine, payload)
        belief = belief_of(
            believed.model,
            loads["left"],
            loads["right"],
            wheelbase_m=machine.vehicle.wheelbase_m,
            front_m=machine.radius_front_m,
        )
        for kind in kinds:
            ride = Ride(kind, payload, belief, length_m=length_m, curve_speed_mps=curve_speed_mps)
            rides = [_perturbed(ride, rng) for _ in range(repeats)]
            tracks = [drive(machine, each) for each in rides]
            gaps = np.array([_gaps(track, ride) for track in tracks])
            fine = drive(halved, rides[0])
            runs.append(
                RunFloor(
                    kind=kind,
                    payload_kg=payload.mass_kg,
                    remainder=gaps[:, 0].mean(axis=0),
                    repeats_exact=gaps[:, 0].std(axis=0, ddof=1),
                    repeats_counted=gaps[:, 1].std(axis=0, ddof=1),
                    halved_step=np.abs(_gaps(fine, ride)[0] - gaps[0, 0]),
                )
            )
            if kind == "corridor":
                radii = np.array([rolling_radii_m(track, machine.track_m) for track in tracks])
                finer = np.array(rolling_radii_m(fine, machine.track_m))
                radius_step = max(radius_step, float(np.abs(finer / radii[0] - 1.0).max()))
                radius_repeats = max(radius_repeats, float((radii.std(axis=0, ddof=1) / radii.mean(axis=0)).max()))
                if payload.mass_kg == 0.0:
                    drift = max(abs(float(track.y_m[-1])) for track in tracks)
    return NoiseFloor(
        baseline=believed,
        radius_step=radius_step,
        radius_repeats=radius_repeats,
        straight_drift_m=drift,
        runs=tuple(runs),
    )
