"""Array odometry against a compiled loop, in the same run; ratios, never seconds."""

from __future__ import annotations

import ctypes
import math
import shutil
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from calib.odometry import end_poses, integrate
from calib.odometry.poses import Poses
from calib.odometry.routes import Axle, Route, end_of_route, find_route

TRACK_M = 0.7
REPEATS = 15

LOOP = r"""
#include <math.h>
#include <stddef.h>
void integrate(const double *left, const double *right, double track, size_t runs, size_t n,
               double *x, double *y, double *theta)
{
    for (size_t run = 0; run < runs; run++) {
        double px = 0.0, py = 0.0, heading = 0.0;
        for (size_t i = run * n; i < (run + 1) * n; i++) {
            double turn = (right[i] - left[i]) / track;
            double path = 0.5 * (right[i] + left[i]);
            double u = 0.5 * turn;
            double chord = fabs(u) < 1e-8 ? path : path * sin(u) / u;
            px += chord * cos(heading + u);
            py += chord * sin(heading + u);
            heading += turn;
            x[i] = px; y[i] = py; theta[i] = heading;
        }
    }
}
"""

Loop = Callable[[np.ndarray, np.ndarray, Poses], None]


def compiled_loop(folder: Path) -> Loop | None:
    """Return the plain loop, compiled with -O2 in a folder; None without a C compiler."""
    compiler = shutil.which("cc")
    if compiler is None:
        return None
    (folder / "loop.c").write_text(LOOP, encoding="utf-8")
    library = folder / "loop.so"
    subprocess.run([compiler, "-O2", "-shared", "-fPIC", "-o", str(library), str(folder / "loop.c"), "-lm"], check=True)
    function = ctypes.CDLL(str(library)).integrate
    pointer, size = ctypes.c_void_p, ctypes.c_size_t
    function.argtypes = [pointer, pointer, ctypes.c_double, size, size, pointer, pointer, pointer]
    function.restype = None

    def run(left: np.ndarray, right: np.ndarray, out: Poses) -> None:
        runs, n = left.shape if left.ndim == 2 else (1, len(left))
        arrays = (out.x_m, out.y_m, out.theta_rad)
        function(left.ctypes.data, right.ctypes.data, TRACK_M, runs, n, *(a.ctypes.data for a in arrays))

    return run


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> Loop:
    """The plain loop, compiled with -O2."""
    loop = compiled_loop(tmp_path_factory.mktemp("loop"))
    if loop is None:
        pytest.skip("no C compiler")
    return loop


def travel(shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """A log sampled every millimetre or so, on a path that wanders."""
    rng = np.random.default_rng(3)
    return 0.001 + 1e-4 * rng.standard_normal(shape), 0.001 + 1e-4 * rng.standard_normal(shape)


def seconds(work: Callable[[], object]) -> float:
    started = time.perf_counter()
    work()
    return time.perf_counter() - started


def quickest(*works: Callable[[], object], repeats: int = REPEATS) -> list[float]:
    """Time works in turns, so that all meet the same neighbours; the quickest of each is the least disturbed."""
    times = [[seconds(work) for work in works] for _ in range(repeats)]
    return [min(column) for column in zip(*times, strict=True)]


@pytest.mark.parametrize("shape", [(10_000_000,), (10_000, 1000)], ids=["one log", "10,000 runs"])
def test_array_odometry_keeps_up_with_a_compiled_loop(
    benchmark: BenchmarkFixture, compiled: Loop, shape: tuple[int, ...]
) -> None:
    """The exact arc over 10^7 samples: at least as fast as the plain C loop, memory given to both.

    As called by default, which is in machine code where the extra for it is installed; for the record also without.
    """
    if not benchmark.enabled:
        shape = (*shape[:-1], shape[-1] // 10)
    left, right = travel(shape)
    ours, theirs = (Poses(np.zeros(shape), np.zeros(shape), np.zeros(shape)) for _ in range(2))
    integrate(left, right, TRACK_M, out=ours)  # machine code is made or fetched once a process
    loop, default, arrays = quickest(
        lambda: compiled(left, right, theirs),
        lambda: integrate(left, right, TRACK_M, out=ours),
        lambda: integrate(left, right, TRACK_M, out=ours, compiled=False),
    )
    # a sequential sum of 10^7 numbers of the order of 10^3 m rounds to 1e-13 m each time
    np.testing.assert_allclose(ours.x_m, theirs.x_m, rtol=0.0, atol=1e-8)
    benchmark.extra_info |= {
        "compiled loop / as called by default": loop / default,
        "compiled loop / arrays": loop / arrays,
    }
    benchmark.pedantic(integrate, args=(left, right, TRACK_M), kwargs={"out": ours}, rounds=3)
    if benchmark.enabled:
        assert loop / default >= 1.0, f"compiled loop / array odometry = {loop / default:.2f}"


def test_cost_grows_linearly_with_samples_and_runs(benchmark: BenchmarkFixture) -> None:
    """Four times the samples, and four times the runs, cost about four times as much: one thread, end poses only."""
    factor = 4 if benchmark.enabled else 2
    unit = 1_000_000 if benchmark.enabled else 100_000
    short, long = travel((unit,)), travel((factor * unit,))
    few, many = travel((unit // 1000, 1000)), travel((factor * unit // 1000, 1000))
    works = [lambda pair=pair: end_poses(*pair, TRACK_M) for pair in (short, long, few, many)]
    times = quickest(*works)
    ratios = (times[1] / times[0] / factor, times[3] / times[2] / factor)
    benchmark.extra_info |= {"samples": ratios[0], "runs": ratios[1]}
    benchmark.pedantic(end_poses, args=(*short, TRACK_M), rounds=3)
    if benchmark.enabled:
        # larger arrays leave the cache: some tens of percent; a quadratic cost would show as a factor of four
        assert max(ratios) < 1.6, ratios


def stepped(route: Route, believed: tuple[float, ...], real: tuple[float, ...], step_m: float) -> tuple[float, ...]:
    """One vehicle, period by period: the controller turns the wheels as believed, they roll on the real radii."""
    x = y = theta = 0.0
    radius_left, radius_right, track = believed
    real_left, real_right, real_track = real
    for length, turn in zip(route.length_m.tolist(), route.turn_rad.tolist(), strict=True):
        n = max(1, math.ceil(length / step_m))
        for _ in range(n):
            left = (length - 0.5 * track * turn) / n / radius_left * real_left
            right = (length + 0.5 * track * turn) / n / radius_right * real_right
            bend = (right - left) / real_track
            u = 0.5 * bend
            chord = 0.5 * (left + right) * (math.sin(u) / u if abs(u) > 1e-8 else 1.0)
            x += chord * math.cos(theta + u)
            y += chord * math.sin(theta + u)
            theta += bend
    return x, y, theta


def segmented(route: Route, believed: tuple[float, ...], real: tuple[float, ...]) -> tuple[float, ...]:
    """One vehicle, segment by segment: what the arrays do, in a plain loop."""
    return stepped(route, believed, real, math.inf)


def test_ten_thousand_vehicles_at_once_against_a_loop(benchmark: BenchmarkFixture) -> None:
    """A closed-loop drive of the paper's route by 10,000 vehicles, against the same in a Python loop.

    The loop steps through the control periods (50 Hz at 0.5 m/s); it is run for a sample of the vehicles and counted
    for all. The arrays need no periods, because between two segments the answer is exact: that is where most of the
    factor comes from. Set against a loop over segments alone, the arrays win by their arithmetic only; that ratio is
    recorded, too.
    """
    vehicles, sample = (10_000, 100) if benchmark.enabled else (500, 5)
    route = find_route("paper_route")
    rng = np.random.default_rng(7)
    radii = 0.1 * (1 + 0.01 * rng.standard_normal((2, vehicles)))
    tracks = 0.7 * (1 + 0.005 * rng.standard_normal(vehicles))
    believed, real = Axle(0.1, 0.1, 0.7), Axle(radii[0], radii[1], tracks)
    rows = list(zip(radii[0].tolist(), radii[1].tolist(), tracks.tolist(), strict=True))
    looped: list[tuple[float, ...]] = []
    answer: list[Poses] = []
    period, segment, arrays = quickest(
        lambda: looped.extend(stepped(route, (0.1, 0.1, 0.7), row, 0.01) for row in rows[:sample]),
        lambda: [segmented(route, (0.1, 0.1, 0.7), row) for row in rows],
        lambda: answer.append(end_of_route(route, believed, real)),
        repeats=5,
    )
    # 1,500 additions of numbers of the order of 10 m
    np.testing.assert_allclose(answer[0].stacked()[:sample], looped[:sample], rtol=0.0, atol=1e-12)
    ratio = period * vehicles / sample / arrays
    benchmark.extra_info |= {"loop over periods / arrays": ratio, "loop over segments / arrays": segment / arrays}
    benchmark.pedantic(end_of_route, args=(route, believed, real), rounds=5)
    if benchmark.enabled:
        assert ratio >= 200.0, f"loop / arrays = {ratio:.0f}"
