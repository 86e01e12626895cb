"""The example's core drives without ROS: loads in, radii out, odometry by the runtime."""

from __future__ import annotations

import ast
import csv
import math
from pathlib import Path

import numpy as np
import pytest

from calib.campaign.read import read_campaign
from calib.coefficients.build import from_fit
from calib.coefficients.file import CoefficientFile
from calib.radius.fit import fit_campaign
from calib.runtime import Coefficients, Odometer, Status
from examples.load_follower.follower import UNSEEN, LoadFollower, Odometry, quaternion_zw

FOLDER = Path(__file__).resolve().parents[2] / "examples" / "load_follower"
PERIOD_S = 0.1
#: a double's rounding over some hundred steps
ROUNDING = 1e-12


@pytest.fixture(scope="module")
def corridor(project_root: Path) -> Path:
    return project_root / "sample_runs" / "corridor"


@pytest.fixture(scope="module")
def file(corridor: Path) -> CoefficientFile:
    return from_fit(fit_campaign(read_campaign(corridor)))


@pytest.fixture
def odometer(file: CoefficientFile) -> Odometer:
    return Odometer(Coefficients.parse(file.to_bytes().decode()))


@pytest.fixture
def follower(odometer: Odometer) -> LoadFollower:
    return LoadFollower(odometer, settling_s=0.0)


def turn(follower: LoadFollower, angles_rad: np.ndarray, start_s: float = 0.0) -> list[Odometry | None]:
    """Feed equal angles of both wheels, one each period."""
    return [follower.feed_angles(angle, angle, start_s + PERIOD_S * i) for i, angle in enumerate(angles_rad)]


def test_radii_follow_the_loads(follower: LoadFollower, file: CoefficientFile) -> None:
    """The radii in force are those of the law at the load that was fed last."""
    for i, loads in enumerate([(300.0, 310.0), (900.0, 700.0), (400.0, 1000.0)]):
        assert follower.feed_loads(*loads, t_s=i) is Status.OK
        odometry = follower.feed_angles(0.0, 0.0, t_s=i + 0.5)
        assert odometry and list(odometry.radii_m) == pytest.approx(
            [float(radius) for radius in file.radius_m(*loads)], rel=ROUNDING
        )


def test_a_load_that_changes_while_driving_changes_the_path(
    follower: LoadFollower, odometer: Odometer, file: CoefficientFile
) -> None:
    """Path of the vehicle's middle: the angle turned under each load times the mean of the radii at that load."""
    angles = np.linspace(0.0, 20.0, 101)
    way = 0.0
    for part, load in enumerate((320.0, 1050.0)):
        follower.feed_loads(load, load, t_s=part * 100.0 * PERIOD_S)
        last = turn(follower, part * 20.0 + angles[part:], part * 100.0 * PERIOD_S + part * PERIOD_S)[-1]
        left, right = file.radius_m(load, load)
        way += 20.0 * 0.5 * float(left + right)
    assert last
    # the left and right radius differ, so the way is an arc: its length is speed times time in every step
    assert odometer.pose.distance_m == pytest.approx(way, rel=ROUNDING)
    assert last.speed_mps == pytest.approx(0.2 / PERIOD_S * 0.5 * float(left + right), rel=1e-6)


def test_a_recorded_run_ends_at_the_distance_of_the_rangefinder(odometer: Odometer, corridor: Path) -> None:
    """The heaviest run, by its own weighed loads; the radii at the reference load miss by far more."""
    with (corridor / "runs.csv").open(encoding="utf-8") as stream:
        run = max(csv.DictReader(stream), key=lambda row: float(row["load_left_N"]))
    with (corridor / run["log"]).open(encoding="utf-8") as stream:
        log = [(float(row["t_s"]), int(row["counts_left"]), int(row["counts_right"])) for row in csv.DictReader(stream)]
    misses = {}
    for name, loads in (
        ("weighed", (float(run["load_left_N"]), float(run["load_right_N"]))),
        ("reference", (300.0, 300.0)),
    ):
        odometer.reset()
        follower = LoadFollower(odometer)
        follower.feed_loads(*loads, t_s=0.0)
        for t_s, left, right in log:
            angles = (2.0 * math.pi * count / 4096.0 for count in (left, right))
            assert follower.feed_angles(*angles, t_s=t_s), follower.status
        misses[name] = abs(odometer.pose.distance_m / float(run["distance_m"]) - 1.0)
    # scatter of single runs about the law: 2e-5 m of 0.1 m; three sigma, and the weave that the way has beside the line
    assert misses["weighed"] < 3 * 2e-4
    assert misses["reference"] > 5 * misses["weighed"]


def test_loads_are_smoothed_by_their_time_constant(odometer: Odometer) -> None:
    """After one time constant a step has reached 1 - 1/e, for any sampling."""
    for steps in (1, 7):
        follower = LoadFollower(odometer, settling_s=2.0)
        follower.feed_loads(400.0, 400.0, 0.0)
        for i in range(steps):
            follower.feed_loads(1000.0, 400.0, 2.0 * (i + 1) / steps)
            # what the file refuses is no part of it
            assert follower.feed_loads(2000.0, 400.0, 2.0 * (i + 1) / steps) is Status.LOAD_OUT_OF_RANGE
        assert follower.loads_N == pytest.approx((1000.0 - 600.0 / math.e, 400.0), rel=ROUNDING)


def test_without_a_load_there_is_no_odometry(follower: LoadFollower) -> None:
    assert follower.feed_angles(0.0, 0.0, 0.0) is None
    assert follower.status is Status.NO_LOAD
    assert follower.feed_loads(math.nan, 300.0, 0.0) is Status.NOT_FINITE
    assert follower.loads_N is None


def test_a_refused_load_stops_the_odometry_until_a_valid_one_comes(follower: LoadFollower) -> None:
    follower.feed_loads(400.0, 400.0, 0.0)
    before = turn(follower, np.linspace(0.0, 1.0, 11))[-1]
    assert follower.feed_loads(4000.0, 400.0, 1.05) is Status.LOAD_OUT_OF_RANGE
    assert follower.feed_angles(1.1, 1.1, 1.1) is None
    assert follower.status is Status.LOAD_OUT_OF_RANGE
    follower.feed_loads(400.0, 400.0, 1.15)
    after = follower.feed_angles(1.2, 1.2, 1.2)
    assert before and after and not after.interrupted
    # nothing is lost: the counts went on, the pose follows from the last good ones
    assert after.x_m / before.x_m == pytest.approx(1.2, rel=1e-6)


def test_a_single_bad_sample_is_ignored_and_a_lasting_fault_stops(follower: LoadFollower) -> None:
    follower.feed_loads(400.0, 400.0, 0.0)
    turn(follower, np.linspace(0.0, 1.0, 11))
    assert follower.feed_angles(900.0, 1.1, 1.1) is None and follower.status is Status.JUMP
    odometry = follower.feed_angles(1.2, 1.2, 1.2)
    assert odometry and not odometry.interrupted
    offset = turn(follower, np.full(20, 901.2), 1.3)
    assert offset[0] is None and offset[-1] and offset[-1].interrupted
    # the way goes on from where it stood
    assert offset[-1].x_m == odometry.x_m and offset[-1].speed_mps == 0.0


def test_old_loads_are_kept_and_flagged_as_old(follower: LoadFollower) -> None:
    follower.feed_loads(400.0, 400.0, 0.0)
    samples = turn(follower, np.zeros(31))
    assert [odometry.loads_are_old for odometry in samples if odometry] == [i * PERIOD_S > 2.0 for i in range(31)]


def test_covariances_have_the_order_of_ros(follower: LoadFollower, odometer: Odometer) -> None:
    """Six by six, symmetric and positive; x, y, yaw as the runtime states them, the others not measured."""
    follower.feed_loads(400.0, 900.0, 0.0)
    last = turn(follower, np.linspace(0.0, 30.0, 301))[-1]
    assert last
    for cells in (last.pose_covariance, last.twist_covariance):
        matrix = np.reshape(cells, (6, 6))
        np.testing.assert_array_equal(matrix, matrix.T)
        assert np.linalg.eigvalsh(matrix).min() > 0.0
        assert (np.diag(matrix)[2:5] == UNSEEN).all()
    planar = np.reshape(last.pose_covariance, (6, 6))[np.ix_([0, 1, 5], [0, 1, 5])]
    np.testing.assert_array_equal(planar, odometer.covariance)


def test_messages_of_other_joints_are_ignored(follower: LoadFollower) -> None:
    follower.feed_loads(400.0, 400.0, 0.0)
    joints = ("left", "right")
    assert follower.feed_joints(["arm", "left"], [0.0, 0.0], joints, 0.0) is None
    assert follower.feed_joints(["left", "right"], [], joints, 0.0) is None
    assert follower.feed_joints(["right", "arm", "left"], [0.2, 9.0, 0.1], joints, 0.1)
    odometry = follower.feed_joints(["right", "arm", "left"], [0.4, 9.0, 0.1], joints, 0.2)
    assert odometry and odometry.yaw_rate_radps > 0.0  # the right wheel alone turned: to the left


def test_a_quaternion_turns_by_its_yaw() -> None:
    z, w = quaternion_zw(0.5)
    assert 2.0 * math.atan2(z, w) == pytest.approx(0.5, rel=ROUNDING)


def imported(path: Path) -> set[str]:
    tree = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    names = [name for node in tree for name in _names(node)]
    return {name.partition(".")[0] for name in names}


def _names(node: ast.AST) -> list[str]:
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    return [node.module or ""] if isinstance(node, ast.ImportFrom) else []


def test_only_the_node_imports_ros() -> None:
    """The core imports the standard library and the runtime; only the node imports ROS, and no mathematics."""
    assert imported(FOLDER / "follower.py") <= {"__future__", "math", "collections", "dataclasses", "calib"}
    assert "rclpy" in imported(FOLDER / "node.py") and "math" not in imported(FOLDER / "node.py")
