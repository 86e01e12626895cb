"""The vehicle and floor as the contact plant builds them, and the MJCF text made of that.

Three wheels under a chassis on six free degrees of freedom; the rear wheels turn freely, the front wheel is driven
and steered. Payloads are separate bodies that rest on the deck by contact and friction. Wheel and floor meet in soft
contacts: the wheel sinks in until the contact carries its load, and rolls on what is left of its radius. Nothing
here states a rolling radius, a slip or a gap.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from calib.errors import BadInputError
from calib.types import GRAVITY_MPS2
from calib.vehicle import Vehicle

__all__ = ["Floor", "Machine", "Payload", "Tyre", "Zone", "mjcf"]

_REAR_WHEEL_KG = 2.0
_FORK_KG = 1.0
_FRONT_WHEEL_KG = 3.0
_DECK_TOP_M = 0.30
_LOAD_HALF_M = (0.20, 0.15, 0.15)


@dataclass(frozen=True, slots=True)
class Tyre:
    """Soft contact of a wheel with the floor, in MuJoCo's terms.

    Parameters
    ----------
    shape : str
        ``crowned`` (an ellipsoid, touches in one point amid the band) or ``flat`` (a cylinder, touches along both
        edges of the band and scrubs when it turns).
    band_m : float
        Width of the band.
    stiffness_per_s2, damping_per_s : float
        Reference acceleration of the contact for each metre of sinkage and each m/s (``solref``, direct form).
    impedance : tuple of float
        ``solimp``: impedance at first touch, at full depth, depth (m), mid-point, power. Two equal impedances give a
        sinkage proportional to load; a rising one a tyre that stiffens.
    creep_damping_per_s : float
        The same for sliding (``solreffriction``); the smaller, the more a loaded contact creeps.
    friction : float
        Coefficient of sliding friction.
    torsion_m, rolling_m : float
        Coefficients of torsional and rolling friction; act with 4 or 6 contact dimensions.
    dimensions : int
        3 (sliding), 4 (and torsion) or 6 (and rolling).
    """

    shape: str = "crowned"
    band_m: float = 0.050
    stiffness_per_s2: float = 25_000.0
    damping_per_s: float = 320.0
    impedance: tuple[float, float, float, float, float] = (0.5, 0.5, 0.001, 0.5, 2.0)
    creep_damping_per_s: float = 320.0
    friction: float = 0.8
    torsion_m: float = 0.003
    rolling_m: float = 0.0003
    dimensions: int = 3


@dataclass(frozen=True, slots=True)
class Zone:
    """A rectangle of other floor, in the frame of the hall; a wheel stands in it where its hub does.

    Parameters
    ----------
    x_m, y_m : tuple of float
        Extent.
    friction : float
        Coefficient of sliding friction there.
    creep_damping_per_s : float
        See `Tyre`; a lubricated contact has less.
    """

    x_m: tuple[float, float]
    y_m: tuple[float, float]
    friction: float
    creep_damping_per_s: float

    def holds(self, x_m: float, y_m: float) -> bool:
        """Return whether the point lies inside."""
        return self.x_m[0] <= x_m <= self.x_m[1] and self.y_m[0] <= y_m <= self.y_m[1]


@dataclass(frozen=True, slots=True)
class Floor:
    """The hall's floor: a plane, level or inclined, with perhaps a zone of its own.

    An inclined plane is the same motion as a level one under an inclined gravity, which keeps the frame in the plane.

    Parameters
    ----------
    grade : float
        Rise over run.
    downhill_rad : float
        Direction of the steepest descent in the frame of the hall.
    zone : Zone or None
        A place with another surface.
    """

    grade: float = 0.0
    downhill_rad: float = 0.0
    zone: Zone | None = None

    @property
    def gravity_mps2(self) -> tuple[float, float, float]:
        """Gravity in the frame of the plane."""
        tilt = math.atan(self.grade)
        along = GRAVITY_MPS2 * math.sin(tilt)
        down = -GRAVITY_MPS2 * math.cos(tilt)
        return along * math.cos(self.downhill_rad), along * math.sin(self.downhill_rad), down


@dataclass(frozen=True, slots=True)
class Payload:
    """A box on the deck; x ahead of the rear axle, y left of the centre line; a mass of 0 means none."""

    mass_kg: float = 0.0
    x_m: float = 0.3
    y_m: float = 0.0


@dataclass(frozen=True, slots=True)
class Machine:
    """The true vehicle on the true floor.

    Parameters
    ----------
    vehicle : Vehicle
        Mass, centre of mass and wheelbase as built.
    radius_left_m, radius_right_m, radius_front_m : float
        Free radii of the wheels.
    track_m : float
        Distance of the rear wheels' middles.
    eccentricity_left_m : float
        Offset of the left wheel's middle from its axle.
    axle_drag_Nms : float
        Viscous torque of a rear wheel's bearing, seal and encoder.
    drag_left_Nm : float
        Dry friction torque on the left rear wheel.
    backlash_rad : float
        Free play between the steering motor and the front wheel, end to end.
    tyre, front_tyre : Tyre
        Contacts of the rear wheels, and of the driven wheel, whose band is far harder and resists being turned.
    floor : Floor
        What it drives on.
    step_s : float
        Time step of the integrator.
    """

    vehicle: Vehicle = field(default_factory=Vehicle)
    radius_left_m: float = 0.100
    radius_right_m: float = 0.100
    radius_front_m: float = 0.100
    track_m: float = 0.700
    eccentricity_left_m: float = 0.0
    axle_drag_Nms: float = 0.05
    drag_left_Nm: float = 0.0
    backlash_rad: float = 0.0
    tyre: Tyre = field(default_factory=Tyre)
    front_tyre: Tyre = field(default_factory=lambda: Tyre(impedance=(0.98, 0.98, 0.001, 0.5, 2.0), dimensions=4))
    floor: Floor = field(default_factory=Floor)
    step_s: float = 0.002


def _wheel(name: str, radius_m: float, mass_kg: float, tyre: Tyre, *, offset_m: float = 0.0) -> str:
    """Return inertia and geometry of a wheel about its own hinge."""
    spin = 0.5 * mass_kg * radius_m**2
    half = 0.5 * tyre.band_m
    if tyre.shape == "crowned":
        shape = f'type="ellipsoid" size="{radius_m} {half} {radius_m}"'
    else:
        shape = f'type="cylinder" size="{radius_m} {half}" zaxis="0 1 0"'
    return (
        f'<inertial pos="0 0 0" mass="{mass_kg}" diaginertia="{spin / 2} {spin} {spin / 2}"/>'
        f'<geom name="{name}" {shape} pos="{offset_m} 0 0" contype="0" conaffinity="0"/>'
    )


def _pair(wheel: str, tyre: Tyre) -> str:
    """Return the contact of a wheel with the floor."""
    friction = f"{tyre.friction} {tyre.friction} {tyre.torsion_m} {tyre.rolling_m} {tyre.rolling_m}"
    solimp = " ".join(repr(value) for value in tyre.impedance)
    return (
        f'<pair name="{wheel}" geom1="floor" geom2="{wheel}" condim="{tyre.dimensions}" friction="{friction}" '
        f'solref="{-tyre.stiffness_per_s2} {-tyre.damping_per_s}" solimp="{solimp}" '
        f'solreffriction="-1 {-tyre.creep_damping_per_s}"/>'
    )


def mjcf(machine: Machine, payload: Payload) -> str:
    """Return the MJCF text of the vehicle with its payload on its floor.

    The frame of the vehicle body is the middle of the rear axle, x forward, y left.

    Raises
    ------
    BadInputError
        Where masses leave no chassis, or the tyre is of no known shape or dimension.
    """
    vehicle = machine.vehicle
    tyres = {"left": machine.tyre, "right": machine.tyre, "front": machine.front_tyre}
    for tyre in tyres.values():
        if tyre.shape not in {"crowned", "flat"} or tyre.dimensions not in {3, 4, 6}:
            raise BadInputError(
                f"contact plant: found tyre {tyre.shape!r} with {tyre.dimensions} dimensions; "
                "expected 'crowned' or 'flat' with 3, 4 or 6; choose one of them"
            )
    wheels_kg = 2 * _REAR_WHEEL_KG + _FORK_KG + _FRONT_WHEEL_KG
    chassis_kg = vehicle.mass_kg - wheels_kg
    if chassis_kg <= 0.0:
        raise BadInputError(
            f"contact plant: found a vehicle of {vehicle.mass_kg} kg; expected more than {wheels_kg} kg; "
            "the wheels alone weigh that"
        )
    hub = machine.vehicle.wheel_radius_m
    front_kg = _FORK_KG + _FRONT_WHEEL_KG
    # The chassis takes what the wheels leave, so that the whole has the stated mass and centre of mass.
    cog_x = (vehicle.mass_kg * vehicle.cog_x_m - front_kg * vehicle.wheelbase_m) / chassis_kg
    cog_y = vehicle.mass_kg * vehicle.cog_y_m / chassis_kg
    cog_z = (vehicle.mass_kg * vehicle.cog_z_m - wheels_kg * hub) / chassis_kg - hub
    pairs = "".join(_pair(wheel, tyre) for wheel, tyre in tyres.items())
    rear = "".join(
        f'<body name="{name}" pos="0 {side * machine.track_m / 2} {radius - hub}">'
        f'<joint name="{name}" axis="0 1 0" damping="{machine.axle_drag_Nms}" frictionloss="{drag}"/>'
        f"{_wheel(name, radius, _REAR_WHEEL_KG, machine.tyre, offset_m=offset)}</body>"
        for name, side, radius, drag, offset in (
            ("left", 1, machine.radius_left_m, machine.drag_left_Nm, machine.eccentricity_left_m),
            ("right", -1, machine.radius_right_m, 0.0, 0.0),
        )
    )
    stop = machine.backlash_rad / 2
    play = (
        f'<joint name="play" axis="0 0 1" limited="true" range="{-stop} {stop}" '
        'damping="0.5" frictionloss="0.2" armature="0.01" solreflimit="0.01 1"/>'
        if machine.backlash_rad > 0.0
        else ""
    )
    load = ""
    if payload.mass_kg > 0.0:
        half = _LOAD_HALF_M
        load = (
            f'<body name="load" pos="{payload.x_m} {payload.y_m} {_DECK_TOP_M + half[2]}"><freejoint name="load"/>'
            f'<geom name="load" type="box" size="{half[0]} {half[1]} {half[2]}" mass="{payload.mass_kg}" '
            'contype="0" conaffinity="0"/></body>'
        )
        # A box on a rubber mat: grips long before it slides, and creeps less than a tenth of a millimetre a stop.
        pairs += (
            '<pair geom1="deck" geom2="load" condim="3" friction="1 1 0 0 0" solref="0.01 1" '
            'solimp="0.98 0.98 0.001 0.5 2" solreffriction="0.004 1"/>'
        )
    gravity = " ".join(repr(value) for value in machine.floor.gravity_mps2)
    # Gains times the time step stay well below the rotors' reflected inertias (armature): the integrator adds a motor's
    # damping after the contacts are solved, and a stiffer motor would tear the wheel off its rolling.
    return f"""<mujoco model="tricycle">
<compiler angle="radian"/>
<option timestep="{machine.step_s}" integrator="implicitfast" cone="elliptic" impratio="10" solver="Newton"
 iterations="50" tolerance="1e-12" gravity="{gravity}"/>
<worldbody>
<geom name="floor" type="plane" size="100 100 1" contype="0" conaffinity="0"/>
<body name="vehicle" pos="0 0 {hub}"><freejoint name="vehicle"/>
<inertial pos="{cog_x} {cog_y} {cog_z}" mass="{chassis_kg}" diaginertia="6 12 14"/>
<geom name="deck" type="box" size="0.6 0.4 0.02" pos="0.4 0 {_DECK_TOP_M - 0.02 - hub}"
 mass="0" contype="0" conaffinity="0"/>
{rear}
<body name="fork" pos="{vehicle.wheelbase_m} 0 {machine.radius_front_m - hub}">
<joint name="steer" axis="0 0 1" armature="0.2"/>
<inertial pos="0 0 0" mass="{_FORK_KG / 2}" diaginertia="0.005 0.005 0.005"/>
<body name="knuckle">{play}<inertial pos="0 0 0" mass="{_FORK_KG / 2}" diaginertia="0.005 0.005 0.005"/>
<body name="front"><joint name="front" axis="0 1 0" damping="{machine.axle_drag_Nms}" armature="0.2"/>
{_wheel("front", machine.radius_front_m, _FRONT_WHEEL_KG, machine.front_tyre)}</body></body>
</body></body>
{load}
</worldbody>
<contact>{pairs}</contact>
<actuator><position name="steer" joint="steer" kp="2000" kv="40"/>
<velocity name="drive" joint="front" kv="20"/></actuator>
</mujoco>"""
