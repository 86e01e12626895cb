"""A sensor mounted turned by a large angle: found with its angle, corrected, and nothing else is said of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.campaign.model import Campaign
from calib.campaign.read import read_campaign
from calib.gap.diagnose import diagnose_in_full
from calib.gap.effects.mounting import TurnedReference, find_turned
from calib.gap.observations.from_campaign import observations_of
from calib.gap.predict import predict, residuals
from tests.blunders import plant
from tests.blunders.blunders import axes_turned
from tests.gap.effects.making import SQUARE, STRAIGHT, Motion, Run, campaign, rich_runs
from tests.real.recordings import optiodom_differential


def mounted(sound: Campaign, yaw_rad: float, x_m: float = 0.0, y_m: float = 0.0) -> Campaign:
    """The end poses as a sensor at a place on the vehicle and turned by an angle reports them from its own start."""
    numbers = dict(sound.runs.numbers)
    x, y, theta = (numbers[name] for name in ("ref_x_m", "ref_y_m", "ref_theta_rad"))
    place = x_m + 1j * y_m
    seen = np.exp(-1j * yaw_rad) * (x + 1j * y + (np.exp(1j * np.nan_to_num(theta)) - 1.0) * place)
    numbers |= {"ref_x_m": seen.real, "ref_y_m": seen.imag}
    return replace(sound, runs=replace(sound.runs, numbers=numbers))


def found(turned: Campaign) -> TurnedReference | None:
    return find_turned(predict(observations_of(turned)))


@pytest.mark.parametrize("yaw_rad", [-3.0, -np.pi / 2, -0.3, 0.3, np.pi / 2, np.pi])
@pytest.mark.parametrize("place_m", [(0.0, 0.0), (0.35, -0.2)], ids=["on the axle", "off the axle"])
def test_the_angle_planted_is_found_and_put_right(yaw_rad: float, place_m: tuple[float, float]) -> None:
    """For any angle and the place; what is left is the place's own share, linear and another effect's."""
    sound = campaign(rich_runs())
    turned = mounted(sound, yaw_rad, *place_m)
    fault = found(turned)
    assert fault is not None
    # the path by counts is that of exact arcs to 2 mm in 10 m
    assert abs(np.angle(np.exp(1j * (fault.yaw_rad - yaw_rad)))) < 1e-3
    right, alone = (predict(observations_of(case)) for case in (fault.correct(turned), mounted(sound, 0.0, *place_m)))
    np.testing.assert_allclose(residuals(right, right), residuals(alone, alone), atol=0.02)


@pytest.mark.parametrize("exchanged", [True, False])
def test_straight_runs_that_end_aside_tell_axes_exchanged_from_a_sensor_turned(exchanged: bool) -> None:
    """Radii a hundredth off leave decimetres along; the side that each run ends on, by its heading, tells."""
    rng = np.random.default_rng(5)

    def bent(_: Run, now: Motion) -> None:
        now.left = now.right = 1e-2
        now.yaw_rad = np.full(len(now.ds_m), rng.normal(0.0, 1e-4))

    sound = campaign([Run(STRAIGHT, front=False)] * 24, truth=bent)
    numbers = dict(sound.runs.numbers)
    turn_rad = rng.normal(0.0, 5e-3, 24)
    # each ends as far aside as it turned on the way
    x_m, y_m = numbers["ref_x_m"], numbers["ref_y_m"] + 5.0 * turn_rad + rng.normal(0.0, 5e-3, 24)
    numbers |= {"ref_theta_rad": numbers["ref_theta_rad"] + turn_rad, "ref_x_m": y_m, "ref_y_m": x_m}
    numbers["ref_x_m"] = y_m if exchanged else -y_m
    fault = found(replace(sound, runs=replace(sound.runs, numbers=numbers)))
    assert fault is not None and fault.mirrored == exchanged
    assert ("x and y are exchanged" in fault.label) is exchanged


def test_loops_that_close_on_their_mark_say_nothing_of_the_axes() -> None:
    sound = campaign([Run(SQUARE, kind="square_ccw", front=False)] * 6)
    closed = {name: np.zeros(6) for name in ("ref_x_m", "ref_y_m")}
    assert found(replace(sound, runs=replace(sound.runs, numbers=dict(sound.runs.numbers) | closed))) is None


@pytest.mark.parametrize("yaw_rad", [0.0, 0.05])
def test_a_small_angle_is_left_to_the_search(yaw_rad: float) -> None:
    assert found(mounted(campaign(rich_runs()), yaw_rad)) is None


@pytest.mark.parametrize("unequal", [0.02, 0.05])
def test_unequal_radii_bend_the_path_and_are_no_turned_reference(unequal: float) -> None:
    """On straight runs of one length both turn the end alike; only radii turn the heading too."""
    sound = campaign([Run(STRAIGHT, front=False) for _ in range(12)])
    numbers, columns = dict(sound.runs.numbers), dict(sound.logs.columns)
    for table in (numbers, columns):
        table["counts_left"] = (1.0 + unequal) * table["counts_left"]
    bent = replace(sound, runs=replace(sound.runs, numbers=numbers), logs=replace(sound.logs, columns=columns))
    assert found(bent) is None


def test_swapped_wheels_are_no_turned_reference() -> None:
    """A mirrored path is no turned one."""
    sound = campaign(rich_runs())
    numbers, columns = dict(sound.runs.numbers), dict(sound.logs.columns)
    for table in (numbers, columns):
        table["counts_left"], table["counts_right"] = table["counts_right"], table["counts_left"]
    swapped = replace(sound, runs=replace(sound.runs, numbers=numbers), logs=replace(sound.logs, columns=columns))
    assert found(swapped) is None


def test_a_real_robot_with_its_markers_turned_a_quarter_is_diagnosed_as_before(shared_data: Path) -> None:
    """Motion capture's rigid body turned by 90 degrees: the same causes beside it, and what to state is said."""
    sound = optiodom_differential(shared_data)
    # every other recording names them, too
    sound = sound.select(np.isin(sound.runs.label("session"), np.unique(sound.runs.label("session"))[::2]))
    columns = dict(sound.logs.columns) | {"ref_theta_rad": sound.logs.columns["ref_theta_rad"] + np.pi / 2}
    reference = replace(sound.reference, frame="map")
    turned = replace(sound, logs=replace(sound.logs, columns=columns), reference=reference)
    causes = {cause.effect: cause for cause in diagnose_in_full(turned, plan=False).causes}
    assert "sensor_yaw_rad = 1.5" in causes["reference_yaw"].remark
    low, high = causes["reference_yaw"].parameters["yaw"].ci95
    # the robot's own radii bend its paths: a hundredth of a radian on these routes
    assert low - 0.01 < np.pi / 2 < high + 0.01
    assert {"track_width", "unequal_radii"} <= causes.keys()


def test_the_angle_is_the_one_beside_the_other_causes(tmp_path: Path) -> None:
    """Odometry that bends the path turns its end: the angle first found is 0.3 degrees off, the one stated is not."""
    recording = plant.tricycle(np.random.default_rng(1))
    axes_turned(30.0)(recording)
    diagnosis = diagnose_in_full(read_campaign(plant.write(recording, tmp_path / "turned", along=False)), plan=False)
    causes = diagnosis.causes
    assert [cause.effect for cause in causes] == ["reference_yaw", "radius_scale", "steering_delay"]
    size = causes[0].parameters["yaw"]
    assert size.value == pytest.approx(-np.radians(30.0), abs=1e-3)  # two and a half of its standard uncertainty
    assert size.ci95[0] <= -np.radians(30.0) <= size.ci95[1]
    # what the fix is worth is counted from the gap as it was read: metres, not what the turned axes leave
    assert diagnosis.recommended and diagnosis.closure.before_rms_m == pytest.approx(1.9, abs=0.1)
