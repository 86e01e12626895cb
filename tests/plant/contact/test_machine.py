"""Laws of statics and of rolling that the built vehicle has to obey, for any engine."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest

from calib.errors import BadInputError, CalibError
from calib.types import GRAVITY_MPS2
from tests.plant.contact.baseline import rolling_radii_m
from tests.plant.contact.driver import Belief
from tests.plant.contact.engine import engine
from tests.plant.contact.machine import Floor, Machine, Payload, Tyre, Zone, mjcf
from tests.plant.contact.ride import Ride, drive, wheel_loads_N

pytest.importorskip("mujoco", reason="mujoco is not installed")

NOMINAL = Belief(0.1, 0.1, 0.7, 1.0, 0.1)
PAYLOADS = (Payload(), Payload(100.0, 0.3, 0.15), Payload(200.0, 0.5, -0.1))


def _loads_by_moments(machine: Machine, payload: Payload) -> dict[str, float]:
    """Wheel loads from the moments about the rear axle and about the right wheel, and the sum of forces."""
    vehicle = machine.vehicle
    weight, load = vehicle.mass_kg * GRAVITY_MPS2, payload.mass_kg * GRAVITY_MPS2
    front = (weight * vehicle.cog_x_m + load * payload.x_m) / vehicle.wheelbase_m
    half = machine.track_m / 2.0
    left = (weight * (vehicle.cog_y_m + half) + load * (payload.y_m + half) - front * half) / machine.track_m
    return {"front": front, "left": left, "right": weight + load - front - left}


@pytest.mark.parametrize("payload", PAYLOADS, ids=lambda p: f"{p.mass_kg:g}kg")
def test_contact_forces_at_rest_balance_the_moments(payload: Payload) -> None:
    """With contacts too hard to lean the vehicle, the forces are those of Eqs (1) and (2)."""
    hard = Tyre(impedance=(0.99, 0.99, 0.001, 0.5, 2.0))
    machine = replace(Machine(), tyre=hard, front_tyre=hard)
    found, expected = wheel_loads_N(machine, payload), _loads_by_moments(machine, payload)
    for wheel, force in expected.items():
        # the wheels still sink by up to 9 um: a lean of 1e-5 rad moves 0.45 m high masses by 5 um, 0.02 N
        assert found[wheel] == pytest.approx(force, abs=0.05)


@pytest.mark.parametrize("payload", PAYLOADS, ids=lambda p: f"{p.mass_kg:g}kg")
def test_soft_wheels_carry_the_whole_weight_and_lean_by_less_than_a_thousandth(payload: Payload) -> None:
    machine = Machine()
    found, expected = wheel_loads_N(machine, payload), _loads_by_moments(machine, payload)
    # forces in the vehicle's oblique frame: cos of a lean under 1e-3 rad
    assert sum(found.values()) == pytest.approx(sum(expected.values()), rel=1e-6)
    for wheel, force in expected.items():
        # sinkage differs by up to 0.35 mm over the track: 0.5e-3 rad x 0.45 m x 300 kg g / 0.7 m = 1 N
        assert found[wheel] == pytest.approx(force, abs=2.0)


def test_the_effective_radius_falls_as_payload_grows() -> None:
    """Monotonically, by sinkage: between the free radius and the height of the hub."""
    radii = []
    for mass in (0.0, 100.0, 200.0):
        track = drive(Machine(), Ride("corridor", Payload(mass), NOMINAL, length_m=6.0))
        radii.append(rolling_radii_m(track, 0.7))
    found = np.array(radii)
    assert np.all(np.diff(found, axis=0) < 0.0)
    assert np.all(found < 0.1)
    # 700 N more on a wheel: 0.1 to 1.5 % per kN is what the field reports of solid tyres
    assert 0.1e-2 * 0.7 < 1.0 - found[-1, 0] / found[0, 0] < 1.5e-2 * 0.7


def test_left_and_right_radius_agree_on_a_symmetric_vehicle_and_halving_the_step_changes_neither() -> None:
    machine = Machine()
    radii = [
        rolling_radii_m(drive(one, Ride("corridor", Payload(), NOMINAL, length_m=6.0)), 0.7)
        for one in (machine, replace(machine, step_s=machine.step_s / 2.0))
    ]
    # the stated floor of a radius: 1e-7
    assert radii[0][0] == pytest.approx(radii[0][1], rel=1e-7)
    assert radii[1][0] == pytest.approx(radii[0][0], rel=1e-7)


def test_a_symmetric_vehicle_on_a_level_floor_drives_straight() -> None:
    """Equal counts left and right leave nothing to steer by; the drift is rounding, far below a micrometre."""
    track = drive(Machine(), Ride("corridor", Payload(), NOMINAL, length_m=6.0))
    assert np.abs(track.y_m).max() < 1e-9
    assert np.abs(track.theta_rad).max() < 1e-9


@pytest.mark.parametrize(("left", "right", "side"), [(0.1, 0.0995, -1.0), (0.0995, 0.1, 1.0)])
def test_unequal_wheels_curve_towards_the_smaller_one_by_their_ratio(left: float, right: float, side: float) -> None:
    """A loop that believes in equal wheels turns equal angles: the heading grows by (r_R - r_L) / b per radian."""
    machine = replace(Machine(), radius_left_m=left, radius_right_m=right)
    track = drive(machine, Ride("corridor", Payload(), NOMINAL, length_m=6.0))
    rolled = 0.5 * (track.left_rad[-1] + track.right_rad[-1])
    assert np.sign(track.theta_rad[-1]) == side
    # the loop keeps counts equal to within one of 4096 a turn: 0.15 mm on 0.7 m, over 43 mrad of heading; and 1 N of
    # load shift by the lean
    assert track.theta_rad[-1] == pytest.approx((right - left) / 0.7 * rolled, abs=3e-4)


def test_on_an_incline_the_vehicle_is_pulled_downhill_against_its_own_odometry() -> None:
    """Across the slope the lower wheel carries more, rolls smaller and turns the vehicle downhill, out and back."""
    machine = replace(Machine(), floor=Floor(grade=0.02, downhill_rad=np.pi / 2))
    turned = [
        drive(machine, Ride("corridor", Payload(), NOMINAL, length_m=6.0, heading_rad=heading)).theta_rad[-1]
        for heading in (0.0, np.pi)
    ]
    # load shift W h grade / b on wheels that lose 3.1e-7 m/N: 2 x 11.2 N x 3.1e-7 / 0.7 m x 60 rad = 0.6 mrad; the
    # lean and the wheels' own share of the height leave a fifth open, the counters a quarter of a mrad
    assert turned[0] == pytest.approx(0.6e-3, abs=0.3e-3)
    assert turned[1] == pytest.approx(-turned[0], abs=0.3e-3)


def test_a_slippery_zone_acts_where_it_lies_and_nowhere_else() -> None:
    """Heading leaves the odometry's between the zone's ends, by the wheel inside, and stays put before and after."""
    zone = Zone((2.0, 4.0), (0.05, 1.0), friction=0.05, creep_damping_per_s=3.0)
    plain = drive(Machine(), Ride("corridor", Payload(), NOMINAL, length_m=6.0))
    slipping = drive(replace(Machine(), floor=Floor(zone=zone)), Ride("corridor", Payload(), NOMINAL, length_m=6.0))
    for track, step in ((plain, 0.0), (slipping, 1.0)):
        gap = track.theta_rad - (track.right_rad - track.left_rad) * 0.09991 / 0.7
        before, after = gap[track.x_m < 1.9], gap[track.x_m > 4.1]
        # transients of load while speeding up and slowing down: some microradians
        assert np.ptp(before) < 5e-5
        assert np.ptp(after) < 5e-5
        assert (abs(after[0] - before[-1]) > 1e-3) == bool(step)


@pytest.mark.parametrize(("kind", "side"), [("route_left", 1.0), ("route_right", -1.0)])
def test_free_play_of_the_steering_makes_the_wheel_lag_the_motor_by_half_of_it(kind: str, side: float) -> None:
    """The floor holds the wheel back: in the bend the motor stands half the play further than the bend needs."""
    play = 0.0175
    for machine, lag in ((Machine(), 0.0), (replace(Machine(), backlash_rad=play), side * play / 2)):
        track = drive(machine, Ride(kind, Payload(), Belief(0.0999, 0.0999, 0.7, 1.0, 0.1)))
        bend = np.diff(track.theta_rad) / np.maximum(np.hypot(np.diff(track.x_m), np.diff(track.y_m)), 1e-9)
        steady = (np.abs(track.theta_rad[1:]) > 0.5) & (np.abs(track.theta_rad[1:]) < 1.2)
        off = (track.steer_rad[1:] - np.arctan(bend))[steady]
        # the stops are soft and the wheels creep: half a mrad to a mrad
        assert float(off.mean()) == pytest.approx(lag, abs=1e-3)


def test_bad_machines_are_refused_in_words() -> None:
    with pytest.raises(BadInputError, match="expected 'crowned' or 'flat'"):
        mjcf(replace(Machine(), tyre=Tyre(shape="square")), Payload())
    with pytest.raises(BadInputError, match="expected more than 8"):
        mjcf(replace(Machine(), vehicle=replace(Machine().vehicle, mass_kg=5.0)), Payload())


def test_a_machine_that_cannot_move_is_reported_not_waited_for() -> None:
    ice = Tyre(friction=1e-5)
    with pytest.raises(CalibError, match="run lost"):
        drive(replace(Machine(), tyre=ice, front_tyre=ice), Ride("corridor", Payload(), NOMINAL, length_m=2.0))


def test_without_mujoco_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(CalibError, match=r"calib\[test\]") as caught:
        engine()
    assert "\n" not in str(caught.value)
