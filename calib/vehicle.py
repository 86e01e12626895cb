"""The vehicle: its geometry, mass and static wheel loads."""

from dataclasses import dataclass, fields
from typing import Annotated, Final, Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field

from calib.errors import SWEEP_VALUES, BadInputError, RefusedError
from calib.types import GRAVITY_MPS2, FloatArray, floats, rows_of

Drive = Literal["tricycle", "differential", "mecanum", "ackermann", "skid"]
#: below it a length or a mass is a typing error
Positive = Annotated[float, Field(ge=1e-12)]
#: a skid's effective track: 1.2 to 2.5 times the geometric one (Mandow et al., IROS 2007)
SKID_TRACK: Final = 2.5


@dataclass(frozen=True, slots=True)
class Usual:
    """Usual range of a setting in its unit; `calib check` names what is outside."""

    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Vehicle:
    """Geometry and mass of a vehicle; by default a driven, steered front wheel and two free rear wheels.

    The origin is the middle of the rear axle, x forward, y left, yaw counter-clockwise (REP-103).
    """

    #: distance between the contact points of the rear wheels
    track_m: Annotated[Positive, Usual(0.02, 20.0)] = 0.700
    #: rear axle to front wheel
    wheelbase_m: Annotated[Positive, Usual(0.02, 50.0)] = 1.000
    #: nominal free radius of the rear wheels
    wheel_radius_m: Annotated[Positive, Usual(0.003, 3.0)] = 0.100
    #: mass without payload
    mass_kg: Annotated[Positive, Usual(0.05, 5e5)] = 100.0
    #: centre of mass without payload, ahead of the rear axle and left of the centre line
    cog_x_m: Annotated[float, Usual(-25.0, 25.0)] = 0.388
    cog_y_m: Annotated[float, Usual(-10.0, 10.0)] = 0.0
    #: height of the centre of mass above the floor
    cog_z_m: float = 0.4
    #: permissible wheel load
    max_wheel_load_N: Positive = 5000.0
    #: tricycle: front wheel driven and steered; differential: two rear wheels driven; mecanum: four wheels, rollers at
    #: 45 degrees; ackermann: front steered, way counted at rear axle or drive shaft; skid: differential of effective
    #: track
    drive: Drive = "tricycle"
    #: radius of the front wheel; None where the rear wheels' holds for it too
    front_wheel_radius_m: Positive | None = None
    #: half the wheelbase plus half the track of a mecanum vehicle; None where unspecified
    half_length_plus_half_width_m: Positive | None = None

    @property
    def front_radius_m(self) -> float:
        """Radius of the front wheel, the rear wheels' where it has none of its own."""
        return self.wheel_radius_m if self.front_wheel_radius_m is None else self.front_wheel_radius_m

    @property
    def unladen_load_N(self) -> float:
        """Mean load of a rear wheel without payload (Eqs 1 and 2 plus the force balance)."""
        return 0.5 * self.mass_kg * GRAVITY_MPS2 * (1.0 - self.cog_x_m / self.wheelbase_m)


def wheel_loads_N(
    vehicle: Vehicle, payload_kg: npt.ArrayLike, payload_x_m: npt.ArrayLike, payload_y_m: npt.ArrayLike
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the static loads of the front, left and right wheel (Eqs 1 and 2 plus the force balance).

    With ``cog_y_m = 0`` and ``y_paper = y + track / 2`` these are the paper's equations.

    `payload_kg`, `payload_x_m`, `payload_y_m`: payload, its distance ahead of the rear axle, and left of the centre
    line; any shapes that broadcast. A negative result means that a wheel would lift off. Returns `front_N`, `left_N`,
    `right_N`: wheel loads, of the broadcast shape.
    """
    mass, x, y = np.broadcast_arrays(floats(payload_kg), floats(payload_x_m), floats(payload_y_m))
    weight = (vehicle.mass_kg + mass) * GRAVITY_MPS2
    front = (vehicle.mass_kg * vehicle.cog_x_m + mass * x) * GRAVITY_MPS2 / vehicle.wheelbase_m
    roll = (vehicle.mass_kg * vehicle.cog_y_m + mass * y) * GRAVITY_MPS2 / vehicle.track_m
    rear = weight - front
    return front, 0.5 * rear + roll, 0.5 * rear - roll


def check_wheel_loads(
    vehicle: Vehicle, front_N: npt.ArrayLike, left_N: npt.ArrayLike, right_N: npt.ArrayLike, *, what: str = "payload"
) -> None:
    """Refuse wheel loads under which the vehicle would tip or carry too much.

    Raises RefusedError where a wheel would lift off or carry more than is permitted; names the wheel and the load.

    Parameters
    ----------
    vehicle, front_N, left_N, right_N
        Its permissible wheel load is the limit; arrays of any shapes.
    what
        What causes the loads; begins the message.
    """
    for name, load in (("front", front_N), ("left", left_N), ("right", right_N)):
        loads = np.atleast_1d(floats(load))
        if not loads.size:
            continue
        if not np.isfinite(loads).all():
            raise BadInputError(
                f"{what}: found a {name} wheel load that is not finite; expected newtons; check masses and lengths"
            )
        least, most = float(loads.min()), float(loads.max())
        if least <= 0.0:
            raise RefusedError(
                f"{what}: the {name} wheel lifts off ({least:.4g} N): the vehicle tips; expected a load above 0 N on "
                "every wheel; put the payload nearer to the middle or reduce it"
            )
        if most > vehicle.max_wheel_load_N:
            raise RefusedError(
                f"{what}: the {name} wheel carries {most:.5g} N: overload; expected at most "
                f"{vehicle.max_wheel_load_N:.5g} N a wheel; reduce the payload or shift it to another wheel"
            )


@dataclass(frozen=True, slots=True)
class WeighedPayload:
    """Payload and its position from three weighed wheels, with standard uncertainties."""

    #: mass, distance ahead of the rear axle, distance left of the centre line
    payload_kg: float
    payload_x_m: float
    payload_y_m: float
    #: standard uncertainties that those of the weighings cause
    payload_std_kg: float
    payload_x_std_m: float
    payload_y_std_m: float


def payload_from_wheel_loads(
    vehicle: Vehicle, front_N: float, left_N: float, right_N: float, *, sigma_N: float = 0.0
) -> WeighedPayload:
    """Return payload mass and position from three weighed wheels: Eqs (1), (2) and the force balance.

    Raises RefusedError where the wheels carry no more than the vehicle alone: there is then no payload to place.

    Parameters
    ----------
    vehicle
        Geometry and mass without payload.
    front_N, left_N, right_N
        Weighed wheel loads.
    sigma_N
        Standard uncertainty of each weighing.
    """
    total = front_N + left_N + right_N
    own = vehicle.mass_kg * GRAVITY_MPS2
    weight = total - own
    if not weight > max(1e-6 * own, 2.0 * sigma_N):
        raise RefusedError(
            f"weighed wheels: found {total:.6g} N in all, the vehicle alone weighs {own:.6g} N; expected "
            "more than that; there is no payload to place; check the weighings or the vehicle's mass"
        )
    x = (front_N * vehicle.wheelbase_m - own * vehicle.cog_x_m) / weight
    y = (0.5 * (left_N - right_N) * vehicle.track_m - own * vehicle.cog_y_m) / weight
    # derivatives of x and y by each weighed load
    by_x = np.array([vehicle.wheelbase_m - x, -x, -x]) / weight
    by_y = np.array([-y, 0.5 * vehicle.track_m - y, -0.5 * vehicle.track_m - y]) / weight
    return WeighedPayload(
        payload_kg=weight / GRAVITY_MPS2,
        payload_x_m=x,
        payload_y_m=y,
        payload_std_kg=sigma_N * float(np.sqrt(3.0)) / GRAVITY_MPS2,
        payload_x_std_m=sigma_N * float(np.linalg.norm(by_x)),
        payload_y_std_m=sigma_N * float(np.linalg.norm(by_y)),
    )


#: what can be swept -> unit
SWEPT: Final = {"payload_kg": "kg", "payload_x_m": "m", "payload_y_m": "m"}


@dataclass(frozen=True, slots=True, eq=False)
class LoadSweep:
    """Wheel loads over a sweep."""

    swept: str  #: what varies, of `SWEPT`; empty for a single payload
    #: shape (n,): payloads
    payload_kg: FloatArray
    payload_x_m: FloatArray
    payload_y_m: FloatArray
    #: shape (n,): wheel loads
    front_N: FloatArray
    left_N: FloatArray
    right_N: FloatArray

    def rows(self) -> list[dict[str, float]]:
        """Return one row a payload, with the sum of the loads."""
        columns = {part.name: getattr(self, part.name) for part in fields(self) if part.name != "swept"}
        columns["total_N"] = self.front_N + self.left_N + self.right_N
        return rows_of(columns)


def sweep_loads(
    vehicle: Vehicle,
    payload_kg: float,
    payload_x_m: float,
    payload_y_m: float,
    *,
    swept: str = "",
    span: tuple[float, float] = (0.0, 0.0),
    steps: int = 21,
) -> LoadSweep:
    """Return the wheel loads of a payload, or of a sweep of its mass or place; see `LoadSweep`.

    `span`, `steps`: both ends, number of values. Raises RefusedError for the first payload that cannot be carried.
    """
    values = {"payload_kg": payload_kg, "payload_x_m": payload_x_m, "payload_y_m": payload_y_m}
    if swept and (swept not in SWEPT or not 2 <= steps <= SWEEP_VALUES):
        expected = f"{', '.join(SWEPT)} in 2 to {SWEEP_VALUES} steps"
        raise BadInputError(f"sweep: found {swept!r} in {steps} steps; expected {expected}")
    count = steps if swept else 1
    columns = {name: np.full(count, value) for name, value in values.items()}
    if swept:
        columns[swept] = np.linspace(span[0], span[1], steps)
    mass, x, y = columns.values()
    if not np.isfinite([mass, x, y]).all() or (mass < 0.0).any():
        raise BadInputError("payload: found a value below 0 or not finite; expected a mass from 0 kg and a place in m")
    loads = np.stack(wheel_loads_N(vehicle, mass, x, y))
    # NaN is bad, too
    bad = ~((loads.min(axis=0) > 0.0) & (loads.max(axis=0) <= vehicle.max_wheel_load_N))
    if bad.any():
        k = int(np.argmax(bad))
        check_wheel_loads(vehicle, *loads[:, k], what=f"payload {mass[k]:g} kg at x {x[k]:g} m, y {y[k]:g} m")
    return LoadSweep(swept, mass, x, y, *loads)
