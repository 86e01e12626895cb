"""Static wheel loads: the paper's figures, balances, and the way back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.errors import RefusedError
from calib.types import GRAVITY_MPS2
from calib.vehicle import Vehicle, check_wheel_loads, payload_from_wheel_loads, wheel_loads_N

PRINTED_N = 0.005  # loads are printed to 0.01 N


def test_shifting_100_kg_across_gives_212_to_866_newtons() -> None:
    """Fig. 3a with L_R = 0.40 m, x_L = 0.50 m, y_L a third of the track to either side."""
    vehicle = Vehicle(cog_x_m=0.40)
    _, left, right = wheel_loads_N(vehicle, 100.0, 0.5, [-0.7 / 3, 0.7 / 3])
    np.testing.assert_allclose(left, [212.55, 866.55], rtol=0.0, atol=PRINTED_N)
    np.testing.assert_allclose(right, [866.55, 212.55], rtol=0.0, atol=PRINTED_N)


def test_unladen_wheels_carry_about_300_newtons() -> None:
    assert Vehicle(cog_x_m=0.40).unladen_load_N == pytest.approx(294.3, abs=PRINTED_N)
    # L_R is printed to four digits: 0.00005 m of it are 0.025 N
    assert Vehicle(cog_x_m=0.3884).unladen_load_N == pytest.approx(300.0, abs=0.03)


@pytest.mark.parametrize(("cog_x_m", "x_m"), [(0.40, 0.1787), (0.3884, 0.1845)])
def test_200_kg_bring_a_wheel_to_1100_newtons(cog_x_m: float, x_m: float) -> None:
    """Fig. 3b; x_L is printed to 0.0001 m, which is 0.1 N."""
    _, left, right = wheel_loads_N(Vehicle(cog_x_m=cog_x_m), 200.0, x_m, 0.0)
    assert float(left) == float(right) == pytest.approx(1100.0, abs=0.1)


VEHICLES = st.builds(
    Vehicle,
    track_m=st.floats(0.3, 2.0),
    wheelbase_m=st.floats(0.5, 3.0),
    mass_kg=st.floats(10.0, 500.0),
    cog_x_m=st.floats(0.05, 0.4),
    cog_y_m=st.floats(-0.05, 0.05),
)
PAYLOADS = st.tuples(st.floats(1.0, 500.0), st.floats(-0.2, 1.0), st.floats(-0.5, 0.5))


@settings(max_examples=200)
@given(vehicle=VEHICLES, payload=PAYLOADS)
def test_forces_and_moments_balance(vehicle: Vehicle, payload: tuple[float, float, float]) -> None:
    """Eqs (1), (2) as printed (y counted from the right wheel) and the sum of forces."""
    front, left, right = (float(load) for load in wheel_loads_N(vehicle, *payload))
    mass, x, y = payload
    g, b = GRAVITY_MPS2, vehicle.track_m
    rounding = 1e-9 * g * (vehicle.mass_kg + mass)
    pitch = mass * g * x + vehicle.mass_kg * g * vehicle.cog_x_m - front * vehicle.wheelbase_m
    roll = front * b / 2 + left * b - mass * g * (y + b / 2) - vehicle.mass_kg * g * (vehicle.cog_y_m + b / 2)
    assert abs(pitch) < rounding
    assert abs(roll) < rounding
    assert abs(front + left + right - g * (vehicle.mass_kg + mass)) < rounding


@settings(max_examples=200)
@given(vehicle=VEHICLES, payload=PAYLOADS)
def test_weighing_three_wheels_gives_the_payload_back(vehicle: Vehicle, payload: tuple[float, float, float]) -> None:
    found = payload_from_wheel_loads(vehicle, *(float(load) for load in wheel_loads_N(vehicle, *payload)))
    # the payload's weight is a difference of sums up to 500 times larger
    np.testing.assert_allclose((found.payload_kg, found.payload_x_m, found.payload_y_m), payload, rtol=1e-9, atol=1e-9)


def test_uncertainty_of_the_weighing_is_what_repeated_weighings_scatter() -> None:
    vehicle, sigma = Vehicle(), 2.0
    loads = np.array([float(load) for load in wheel_loads_N(vehicle, 80.0, 0.3, 0.1)])
    rng = np.random.default_rng(5)
    draws = loads + sigma * rng.standard_normal((4000, 3))
    found = [payload_from_wheel_loads(vehicle, *row, sigma_N=sigma) for row in draws.tolist()]
    spread = np.std([(f.payload_kg, f.payload_x_m, f.payload_y_m) for f in found], axis=0)
    said = payload_from_wheel_loads(vehicle, *loads.tolist(), sigma_N=sigma)
    # a standard deviation from 4000 draws is known to 1.1 %; four of those
    np.testing.assert_allclose(
        spread, (said.payload_std_kg, said.payload_x_std_m, said.payload_y_std_m), rtol=0.045, atol=0.0
    )


def test_tipping_is_refused_naming_the_wheel() -> None:
    vehicle = Vehicle()
    with pytest.raises(RefusedError, match="right wheel lifts off"):
        check_wheel_loads(vehicle, *wheel_loads_N(vehicle, 200.0, 0.2, 0.7))
    with pytest.raises(RefusedError, match="front wheel lifts off"):
        check_wheel_loads(vehicle, *wheel_loads_N(vehicle, 200.0, -0.3, 0.0))


def test_overload_is_refused_naming_wheel_and_limit() -> None:
    vehicle = Vehicle(max_wheel_load_N=885.0)
    with pytest.raises(RefusedError, match=r"left wheel carries 1016.*at most 885 N"):
        check_wheel_loads(vehicle, *wheel_loads_N(Vehicle(cog_x_m=0.4), 100.0, 0.5, 0.34))


def test_an_unladen_vehicle_has_no_payload_to_place() -> None:
    vehicle = Vehicle()
    with pytest.raises(RefusedError, match="no payload"):
        payload_from_wheel_loads(vehicle, *(float(load) for load in wheel_loads_N(vehicle, 0.0, 0.0, 0.0)))
