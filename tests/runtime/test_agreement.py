"""Both runtimes against array odometry and against an oracle of their own covariance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from calib.coefficients.file import CoefficientFile
from calib.odometry import integrate
from calib.radius.law import JOINT
from calib.runtime import Coefficients, Odometer

STEPS = 100_000
LOADS = ((300.0, 301.5), (820.0, 410.0), (1100.0, 200.0), (350.0, 990.0))
WRAP = 1 << 16


@dataclass(frozen=True)
class Drive:
    """A log: counts as they run on, and the wheel loads of each step."""

    left: np.ndarray
    right: np.ndarray
    loads_left: np.ndarray
    loads_right: np.ndarray

    def travels(self, file: CoefficientFile) -> tuple[np.ndarray, np.ndarray]:
        radii = file.radius_m(self.loads_left, self.loads_right)
        per_rev = (file.encoder.counts_per_rev_left.value, file.encoder.counts_per_rev_right.value)
        return tuple(
            np.diff(counts) * 2 * np.pi / rev * radius
            for counts, rev, radius in zip((self.left, self.right), per_rev, radii, strict=True)
        )


@pytest.fixture(scope="module")
def log() -> Drive:
    """100,000 steps of winding travel, forward and back, wrapping often, four load states."""
    random = np.random.default_rng(20190511)
    s = np.arange(STEPS) / STEPS
    centre = 40.0 * np.cos(2 * np.pi * 3 * s) + 15.0
    turn = 9.0 * np.sin(2 * np.pi * 40 * s) + 2.0
    left, right = (np.rint(centre + sign * turn + random.normal(0, 2, STEPS)).astype(np.int64) for sign in (-1, 1))
    state = np.repeat(np.arange(len(LOADS)), STEPS // len(LOADS))
    loads = np.array(LOADS)[state]
    counts = [np.concatenate(([65_000], 65_000 + np.cumsum(steps))) for steps in (left, right)]
    assert all(np.ptp(one) > 4 * WRAP for one in counts)
    return Drive(counts[0], counts[1], loads[:, 0], loads[:, 1])


def oracle(left: np.ndarray, right: np.ndarray, track: float) -> np.ndarray:
    """End pose by complex exponentials in extended precision, summed exactly enough to judge 1e-9 m."""
    d = ((right.astype(np.longdouble) - left) / track).astype(np.longdouble)
    heading = np.concatenate(([np.longdouble(0)], np.cumsum(d)))
    with np.errstate(divide="ignore", invalid="ignore"):
        radius = (left + right) / 2 / d
        x = np.where(d == 0, (left + right) / 2 * np.cos(heading[:-1]), radius * np.diff(np.sin(heading)))
        y = np.where(d == 0, (left + right) / 2 * np.sin(heading[:-1]), -radius * np.diff(np.cos(heading)))
    return np.array([x.sum(), y.sum(), heading[-1]], dtype=np.float64)


def python_end(file: CoefficientFile, log: Drive) -> Odometer:
    odometer = Odometer(Coefficients.parse(file.to_bytes().decode()))
    before = None
    odometer.set_wheel_loads(float(log.loads_left[0]), float(log.loads_right[0]))
    odometer.update(int(log.left[0]) % WRAP, int(log.right[0]) % WRAP)
    rows = zip(log.left[1:].tolist(), log.right[1:].tolist(), log.loads_left, log.loads_right, strict=True)
    for left, right, load_left, load_right in rows:
        if (load_left, load_right) != before:
            odometer.set_wheel_loads(load_left, load_right)
            before = (load_left, load_right)
        odometer.update(left % WRAP, right % WRAP)
    return odometer


def script(log: Drive) -> list[str]:
    lines = ["q", f"L {log.loads_left[0]} {log.loads_right[0]}", f"F {log.left[0] % WRAP} {log.right[0] % WRAP}"]
    change = np.flatnonzero(np.diff(log.loads_left, prepend=np.nan) != 0)
    starts = set(change.tolist())
    for step in range(len(log.loads_left)):
        if step in starts:
            lines.append(f"L {log.loads_left[step]} {log.loads_right[step]}")
        lines.append(f"F {log.left[step + 1] % WRAP} {log.right[step + 1] % WRAP}")
    return [*lines, "s"]


def test_both_runtimes_agree_with_array_odometry_over_100000_steps(
    file: CoefficientFile, log: Drive, drive: Callable[..., np.ndarray]
) -> None:
    """To 1e-9 m with loads that change on the way and counters that wrap; the demand's figure."""
    left, right = log.travels(file)
    track = file.vehicle.track.value
    poses = integrate(left, right, track)
    arrays = np.array([poses.x_m[-1], poses.y_m[-1], poses.theta_rad[-1]])
    python = python_end(file, log)
    pose = python.pose
    c = drive(file, script(log))[0]
    independent = oracle(left, right, track)
    for found in (arrays, np.array([pose.x_m, pose.y_m, pose.theta_rad]), c[4:7]):
        np.testing.assert_allclose(found, independent, rtol=0, atol=1e-9)
    assert pose.distance_m == pytest.approx(np.abs((left + right) / 2).sum(), abs=1e-9)
    # rtol: rounding over 1e5 steps of sums of one sign
    np.testing.assert_allclose(np.array(python.covariance), c[8:].reshape(3, 3), rtol=1e-9, atol=0)
    assert np.linalg.eigvalsh(python.covariance).min() > 0


def quiet(file: CoefficientFile, **noise: float) -> CoefficientFile:
    """The file with only the named parts of its noise, everything else zero."""
    document = file.to_dict()
    for key in ("along", "heading", "count_std"):
        document["noise"][key]["value"] = noise.get(key, 0.0)
    document["vehicle"]["track_std"]["value"] = noise.get("track_std", 0.0)
    for side in ("left", "right"):
        for key in ("variance_radius_ref", "covariance_radius_ref_slope", "variance_slope"):
            document["wheels"][side][key]["value"] *= noise.get("law", 0.0)
    return file.changed(**{key: document[key] for key in ("noise", "vehicle", "wheels")})


def run(
    file: CoefficientFile, left: np.ndarray, right: np.ndarray, loads: np.ndarray, band: str | None = "mean"
) -> Odometer:
    odometer = Odometer(Coefficients.parse(file.to_bytes().decode()), band=band)
    odometer.set_wheel_loads(*loads[0])
    odometer.update(0, 0)
    for index in range(len(left)):
        odometer.set_wheel_loads(*loads[index])
        odometer.update(int(left[index]) % WRAP, int(right[index]) % WRAP)
    return odometer


def winding(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    s = np.arange(n) / n
    left = np.cumsum(np.rint(400 - 90 * np.sin(5 * s) - 60)).astype(np.int64)
    right = np.cumsum(np.rint(400 + 90 * np.sin(5 * s) + 60)).astype(np.int64)
    loads = np.where((s < 0.4)[:, None], [[320.0, 900.0]], [[1000.0, 450.0]])
    return left, right, loads


def together(file: CoefficientFile, covariance: np.ndarray, run_covariance_m2: float = 0.0) -> CoefficientFile:
    """The file as if its laws and its track had been estimated together."""
    units = dict(zip(JOINT, ("m", "m/N", "m", "m/N", "m"), strict=True))
    entries = [
        {
            "first": first,
            "second": second,
            "covariance": {
                "value": covariance[row, row + ahead],
                "unit": f"({units[first]})^2"
                if units[first] == units[second]
                else f"({units[first]})({units[second]})",
            },
        }
        for row, first in enumerate(JOINT)
        for ahead, second in enumerate(JOINT[row:])
    ]
    wheels = file.wheels
    values = {"radius_left_m": wheels.left.radius_ref.value, "radius_right_m": wheels.right.radius_ref.value}
    parameters = {name: {"value": value, "unit": "m"} for name, value in values.items()}
    parameters["track_m"] = {"value": file.vehicle.track.value, "unit": "m"}
    for side, wheel in (("left", wheels.left), ("right", wheels.right)):
        parameters[f"slope_{side}_m_per_N"] = {"value": wheel.slope.value, "unit": "m/N"}
    section = {"drive": "differential", "source": "rear", "parameters": parameters, "covariance": entries}
    section["run_covariance"] = {"value": run_covariance_m2, "unit": "m^2"}
    return file.changed(joint_geometry=section)


@pytest.mark.parametrize("coupled", [False, True])
@pytest.mark.parametrize("band", ["mean", "prediction"])
def test_systematic_covariance_is_the_laws_carried_through_the_end_pose(
    file: CoefficientFile, drive: Callable[..., np.ndarray], band: str, coupled: bool
) -> None:
    """Against central differences of an independent integration by each coefficient; loads change on the way.

    Where the wheels and the track were estimated together, what couples them counts too, in both runtimes.
    """
    only = quiet(file, law=1.0, track_std=1e-3)
    left, right, loads = winding(300)
    rev = (4096.0, 4000.0)
    turns = [np.diff(counts, prepend=0) * 2 * np.pi / n for counts, n in zip((left, right), rev, strict=True)]

    def end(p: np.ndarray) -> np.ndarray:
        radii = [p[2 * i] + p[2 * i + 1] * (loads[:, i] - 300.0) for i in (0, 1)]
        return oracle(turns[0] * radii[0], turns[1] * radii[1], p[4])

    at = np.array([0.0990, 1.3e-6, 0.0991, -1.47e-6, 0.7])
    steps = np.array([1e-6, 1e-9, 1e-6, 1e-9, 1e-6])
    jacobian = np.column_stack([(end(at + h) - end(at - h)) / (2 * h.max()) for h in np.diag(steps)])
    scatter = 4e-10 if band == "prediction" else 0.0
    block = np.array([[9e-10 + scatter, -1e-12], [-1e-12, 4e-15]])
    c = np.zeros((5, 5))
    c[:2, :2] = c[2:4, 2:4] = block
    c[4, 4] = 1e-6
    if coupled:
        # radii that go together, slopes against them, and a track that follows the radii
        for first, second, share in ((0, 2, 0.9), (0, 3, -0.2), (1, 2, -0.3), (1, 3, 0.5), (0, 4, 0.6), (2, 4, 0.6)):
            c[first, second] = c[second, first] = share * np.sqrt(c[first, first] * c[second, second])
        c[1, 4] = c[4, 1] = -3e-12
        c[3, 4] = c[4, 3] = 2e-12
        only = together(only, c - np.diag([scatter, 0.0, scatter, 0.0, 0.0]), run_covariance_m2=-1e-10)
        c[[0, 2], [2, 0]] -= 1e-10 if band == "prediction" else 0.0
    expected = jacobian @ c @ jacobian.T
    found = np.array(run(only, left, right, loads, band).covariance)
    # rtol: central differences leave about 1e-9 of each derivative; entries cancel to a hundredth
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())
    lines = ["q", f"L {loads[0][0]} {loads[0][1]}", "F 0 0"]
    for index in range(len(left)):
        lines += [f"L {loads[index][0]} {loads[index][1]}", f"F {left[index] % WRAP} {right[index] % WRAP}"]
    header = drive(only, [*lines, "s"], f"CALIB_PREDICTION_BAND={int(band == 'prediction')}")[0]
    np.testing.assert_allclose(header[8:].reshape(3, 3), found, rtol=1e-9, atol=0)
    if band == "prediction":
        # a journey is one run: its scatter is in the covariance unless omitted
        np.testing.assert_array_equal(run(only, left, right, loads, None).covariance, found)
        np.testing.assert_array_equal(drive(only, [*lines, "s"])[0], header)


def test_on_a_straight_the_random_walk_has_its_closed_form(file: CoefficientFile) -> None:
    """x: a^2 S, theta: h^2 S, y: h^2 S^3/3, y and theta: h^2 S^2/2."""
    document = file.to_dict()
    document["encoder"]["counts_per_rev_right"]["value"] = 4096.0
    document["wheels"]["right"] = document["wheels"]["left"]
    a, h, n = 2e-3, 3e-3, 2000
    straight = quiet(file.changed(encoder=document["encoder"], wheels=document["wheels"]), along=a, heading=h)
    counts = np.arange(1, n + 1) * 40
    odometer = run(straight, counts, counts, np.full((n, 2), 300.0))
    s = odometer.pose.distance_m
    expected = [[a**2 * s, 0, 0], [0, h**2 * s**3 / 3, h**2 * s**2 / 2], [0, h**2 * s**2 / 2, h**2 * s]]
    # rtol: a sum of 2000 steps in place of an integral, 1/n^2; atol: zeros
    np.testing.assert_allclose(odometer.covariance, expected, rtol=1e-6, atol=1e-12)


def test_on_a_straight_the_reading_of_the_encoders_has_its_closed_form(file: CoefficientFile) -> None:
    """One reading at either end: the first turns the whole path, the last only the pose."""
    document = file.to_dict()
    document["encoder"]["counts_per_rev_right"]["value"] = 4096.0
    document["wheels"]["right"] = document["wheels"]["left"]
    straight = quiet(file.changed(encoder=document["encoder"], wheels=document["wheels"]), count_std=0.5)
    counts = np.arange(1, 501) * 40
    odometer = run(straight, counts, counts, np.full((500, 2), 300.0))
    s, track = odometer.pose.distance_m, 0.7
    q = (0.5 * 2 * np.pi * 0.0990 / 4096) ** 2
    turn = 2 * q / track**2
    expected = [[q, 0, 0], [0, turn * s**2, turn * s], [0, turn * s, 2 * turn]]
    # rtol: rounding; atol: zeros
    np.testing.assert_allclose(odometer.covariance, expected, rtol=1e-9, atol=1e-18)


def test_the_random_walk_is_that_of_the_estimator_of_its_size(file: CoefficientFile) -> None:
    """Straights, bends and a turn on the spot: the walks whose sizes `calib geometry` estimates from such stretches."""
    drives, model, solve = (pytest.importorskip(f"calib.kinematics.{name}") for name in ("drives", "model", "solve"))
    along, heading, track = 4e-3, 5e-3, 0.7
    document = file.to_dict()
    document["encoder"]["counts_per_rev_right"]["value"] = 4096.0
    document["wheels"]["right"] = document["wheels"]["left"]
    alike = quiet(file.changed(encoder=document["encoder"], wheels=document["wheels"]), along=along, heading=heading)
    # ahead, back in a bend, round on the spot, ahead
    steps = np.repeat([[40, 40], [-30, -50], [-35, 35], [45, 30]], 120, axis=0)
    left, right = np.cumsum(steps, axis=0).T
    found = np.array(run(alike, left, right, np.full((len(steps), 2), 300.0)).covariance)

    turned = np.concatenate([np.zeros((1, 2)), steps]).T * 2 * np.pi / 4096
    vehicle = drives.Differential(0.0990, 0.0990, track, False)
    motion = vehicle.motion(np.array([0.0990, 0.0990, track]), drives.Steps(turned, None, None, None))
    ends = np.array([0]), np.array([len(steps)])
    whole = model.Segments(
        np.array([0]), *ends, np.zeros((1, 3)), np.ones((1, 3), bool), np.array([0]), np.array([0]), np.array([False])
    )
    walks = solve.kernels(drives.integrate_motion(motion), motion.body, whole, 0.0)[2:, 0]
    expected = heading**2 * walks[0] + along**2 * walks[1]
    # a step's noise acts at its end there and along its arc here: steps of 1/480 of the path
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=0.01 * np.abs(expected).max(axis=(0, 1)))
    assert found[2, 2] == pytest.approx(expected[2, 2], rel=1e-9)


def test_on_a_winding_path_the_random_walk_is_that_of_simulated_vehicles(file: CoefficientFile) -> None:
    """Monte Carlo over 20,000 vehicles with a step noise of their own."""
    a, h, n, vehicles = 4e-3, 5e-3, 120, 20_000
    only = quiet(file, along=a, heading=h)
    left, right, loads = winding(n)
    found = np.array(run(only, left, right, loads).covariance)
    radii = file.radius_m(loads[:, 0], loads[:, 1])
    travel = [
        np.diff(counts, prepend=0) * 2 * np.pi / rev * radius
        for counts, rev, radius in zip((left, right), (4096.0, 4000.0), radii, strict=True)
    ]
    random = np.random.default_rng(7)
    s = (travel[0] + travel[1]) / 2
    d = (travel[1] - travel[0]) / 0.7
    way = np.sqrt(np.abs(s) + 0.1 * np.abs(d))
    s, d = (value + random.normal(size=(vehicles, n)) * noise * way for value, noise in ((s, a), (d, h)))
    theta = np.cumsum(d, axis=1)
    middle = theta - d / 2
    chord = s * np.sinc(d / 2 / np.pi)
    ends = np.stack([(chord * np.cos(middle)).sum(1), (chord * np.sin(middle)).sum(1), theta[:, -1]])
    expected = np.cov(ends)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    # five standard errors of a covariance from 20,000 draws: 5 sqrt(2 / 20000)
    np.testing.assert_allclose(found / scale, expected / scale, rtol=0, atol=0.05)


@pytest.mark.parametrize("band", ["mean", "prediction"])
def test_the_runtimes_covariance_is_that_of_the_array_form(file: CoefficientFile, band: str) -> None:
    """Systematic, random and encoder parts together, with loads that change on the way."""
    arrays = pytest.importorskip("calib.odometry.poses")
    left, right, loads = winding(300)
    radii = file.radius_m(loads[:, 0], loads[:, 1])
    rev = (4096.0, 4000.0)
    travel = [
        np.diff(counts, prepend=0) * 2 * np.pi / n * radius
        for counts, n, radius in zip((left, right), rev, radii, strict=True)
    ]
    path = arrays.steps(*travel, 0.7, radius_left_m=radii[0], radius_right_m=radii[1])
    jacobian = arrays.jacobian(path, load_offset_left_N=loads[:, 0] - 300.0, load_offset_right_N=loads[:, 1] - 300.0)[
        -1
    ]
    parameters = file.law.covariance(1e-3, single_run=band == "prediction")
    walk = arrays.RandomWalk(
        sigma_along_m_per_sqrt_m=file.noise.along.value,
        sigma_heading_rad_per_sqrt_m=file.noise.heading.value,
        count_std=file.noise.count_std.value,
        counts_per_rev_left=rev[0],
        counts_per_rev_right=rev[1],
    )
    expected = jacobian @ parameters @ jacobian.T + walk.covariance(path)[-1]
    found = np.array(run(file, left, right, loads, band).covariance)
    # rtol: two orders of summation; atol: entries that cancel
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12 * np.abs(expected).max())
