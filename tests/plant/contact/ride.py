"""One run of the vehicle on the floor: settle, weigh, drive the route, stop, read."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.errors import CalibError
from calib.types import FloatArray
from tests.plant.contact.driver import Belief, Driver
from tests.plant.contact.engine import engine
from tests.plant.contact.machine import Machine, Payload, Zone, mjcf
from tests.plant.contact.routes import route

__all__ = ["COUNTS_PER_REV", "Ride", "Track", "drive", "wheel_loads_N"]


COUNTS_PER_REV = 4096.0
_CONTROL_HZ = 50
_SETTLE_S = 1.5
_REST_S = 1.0
_WHEELS = ("left", "right", "front")


@dataclass(frozen=True, slots=True)
class Ride:
    """What one run is told to do, and how it happens to stand at the start.

    Parameters
    ----------
    kind : str
        Route, see `tests.plant.contact.routes.route`.
    payload : Payload
        The box that really stands on the deck.
    belief : Belief
        What the odometry in the loop believes.
    speed_mps, curve_speed_mps, acceleration_mps2 : float
        Limits of the speed profile.
    length_m, side_m, turn_radius_m : float
        Dimensions of the corridor and of the square.
    start_m : tuple of float
        Position of the start in the hall.
    heading_rad : float
        Heading of the start in the hall.
    phases_rad : tuple of float
        Angles of the left, right and front wheel at the start.
    """

    kind: str
    payload: Payload
    belief: Belief
    speed_mps: float = 0.5
    curve_speed_mps: float = 0.3
    acceleration_mps2: float = 0.3
    length_m: float = 12.0
    side_m: float = 3.0
    turn_radius_m: float = 1.0
    start_m: tuple[float, float] = (0.0, 0.0)
    heading_rad: float = 0.0
    phases_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """What really happened in a run, at 50 Hz; the frame is that of the start pose.

    Parameters
    ----------
    t_s : array of float, shape (n,)
        Time since the start.
    x_m, y_m, theta_rad : array of float, shape (n,)
        True pose of the middle of the rear axle; heading not wrapped.
    left_rad, right_rad, front_rad : array of float, shape (n,)
        Wheel angles since the start.
    counts_left, counts_right, counts_front : array of float, shape (n,)
        Counters since the start.
    steer_rad : array of float, shape (n,)
        Angle of the steering motor.
    load_left_N, load_right_N : float
        Contact forces of the rear wheels at rest before the start.
    """

    t_s: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    theta_rad: FloatArray
    left_rad: FloatArray
    right_rad: FloatArray
    front_rad: FloatArray
    counts_left: FloatArray
    counts_right: FloatArray
    counts_front: FloatArray
    steer_rad: FloatArray
    load_left_N: float
    load_right_N: float


def _contact_forces_N(physics: Any, model: Any, data: Any) -> dict[str, float]:
    """Return the normal force that the floor exerts on each wheel, in N."""
    force, forces = np.zeros(6), dict.fromkeys(_WHEELS, 0.0)
    for index in range(data.ncon):
        geoms = {model.geom(int(geom)).name for geom in data.contact[index].geom}
        wheel = geoms & set(_WHEELS)
        if wheel and "floor" in geoms:
            physics.mj_contactForce(model, data, index, force)
            forces[wheel.pop()] += float(force[0])
    return forces


def _stand(machine: Machine, payload: Payload, ride: Ride | None) -> tuple[Any, Any, Any]:
    """Return the engine, the model, and the data after the vehicle has come to rest at the start of `ride`."""
    physics = engine()
    model = physics.MjModel.from_xml_string(mjcf(machine, payload))
    data = physics.MjData(model)
    if ride is not None:
        cos, sin = math.cos(ride.heading_rad), math.sin(ride.heading_rad)
        turned = np.array([math.cos(ride.heading_rad / 2), 0.0, 0.0, math.sin(ride.heading_rad / 2)])
        for name in ("vehicle", "load") if payload.mass_kg > 0.0 else ("vehicle",):
            pose = data.joint(name).qpos
            x, y = float(pose[0]), float(pose[1])
            pose[:2] = ride.start_m[0] + cos * x - sin * y, ride.start_m[1] + sin * x + cos * y
            pose[3:] = turned
        for name, phase in zip(_WHEELS, ride.phases_rad, strict=True):
            data.joint(name).qpos[0] = phase
    physics.mj_step(model, data, round(_SETTLE_S / machine.step_s))
    return physics, model, data


def wheel_loads_N(machine: Machine, payload: Payload) -> dict[str, float]:
    """Return the contact forces of a vehicle at rest: keys ``left``, ``right`` and ``front``, in N.

    Parameters
    ----------
    machine : Machine
        The vehicle and its floor.
    payload : Payload
        What stands on it.
    """
    physics, model, data = _stand(machine, payload, None)
    return _contact_forces_N(physics, model, data)


def _apply_zone(model: Any, hubs: dict[str, Any], zone: Zone, machine: Machine) -> None:
    """Give each wheel's contact the surface on which its hub stands."""
    for wheel, hub in hubs.items():
        inside = zone.holds(float(hub[0]), float(hub[1]))
        pair, tyre = model.pair(wheel).id, machine.front_tyre if wheel == "front" else machine.tyre
        model.pair_friction[pair, :2] = zone.friction if inside else tyre.friction
        creep = zone.creep_damping_per_s if inside else tyre.creep_damping_per_s
        model.pair_solreffriction[pair, 1] = -creep


def _yaw_rad(w: float, x: float, y: float, z: float) -> float:
    """Return the heading of an orientation given as a unit quaternion."""
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def drive(machine: Machine, ride: Ride) -> Track:
    """Drive one run and return what happened.

    Parameters
    ----------
    machine : Machine
        The vehicle and its floor.
    ride : Ride
        The run.

    Raises
    ------
    CalibError
        Where MuJoCo is missing, or the vehicle has not arrived long after it should have.
    """
    physics, model, data = _stand(machine, ride.payload, ride)
    forces = _contact_forces_N(physics, model, data)
    path = route(ride.kind, length_m=ride.length_m, side_m=ride.side_m, turn_radius_m=ride.turn_radius_m)
    driver = Driver(
        path,
        ride.belief,
        counts_per_rev=COUNTS_PER_REV,
        speed_mps=ride.speed_mps,
        curve_speed_mps=ride.curve_speed_mps,
        acceleration_mps2=ride.acceleration_mps2,
    )
    angles = tuple(data.joint(name).qpos for name in _WHEELS)
    motor, body = data.joint("steer").qpos, data.joint("vehicle").qpos
    steer, spin = data.actuator("steer").ctrl, data.actuator("drive").ctrl
    zone = machine.floor.zone
    hubs = {name: data.body(name).xpos for name in _WHEELS}
    per_rad = COUNTS_PER_REV / (2.0 * math.pi)
    zero = [math.floor(angle[0] * per_rad) for angle in angles]
    dt = 1.0 / _CONTROL_HZ
    substeps = round(dt / machine.step_s)
    patience = round(_CONTROL_HZ * (30.0 + 4.0 * float(path.s_m[-1]) / min(ride.speed_mps, ride.curve_speed_mps)))
    rest = round(_REST_S * _CONTROL_HZ)
    samples = []

    def read() -> list[int]:
        """Record the state now and return the counters."""
        counts = [math.floor(angle[0] * per_rad) - start for angle, start in zip(angles, zero, strict=True)]
        samples.append((body[0], body[1], _yaw_rad(*body[3:7]), *(angle[0] for angle in angles), *counts, motor[0]))
        return counts

    tick = 0
    counts = read()
    while rest > 0:
        steer[0], spin[0] = driver.command(counts[0], counts[1], dt)
        if zone is not None:
            _apply_zone(model, hubs, zone, machine)
        physics.mj_step(model, data, substeps)
        tick += 1
        rest -= driver.arrived
        counts = read()
        if tick > patience or data.warning[physics.mjtWarning.mjWARN_BADQACC].number > 0:
            raise CalibError(
                f"contact plant: found the {ride.kind} run lost after {tick * dt:.0f} s; expected it to arrive; "
                "give the machine a shorter time step, more friction, or a lower speed"
            )
    table = np.array(samples, dtype=np.float64).T
    x, y, yaw = table[0] - table[0, 0], table[1] - table[1, 0], np.unwrap(table[2])
    cos, sin = math.cos(yaw[0]), math.sin(yaw[0])
    return Track(
        t_s=np.asarray(dt * np.arange(table.shape[1]), dtype=np.float64),
        x_m=cos * x + sin * y,
        y_m=-sin * x + cos * y,
        theta_rad=yaw - yaw[0],
        left_rad=table[3] - table[3, 0],
        right_rad=table[4] - table[4, 0],
        front_rad=table[5] - table[5, 0],
        counts_left=table[6],
        counts_right=table[7],
        counts_front=table[8],
        steer_rad=table[9],
        load_left_N=forces["left"],
        load_right_N=forces["right"],
    )
