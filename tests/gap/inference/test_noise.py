"""Noise: known shapes against closed forms and Monte Carlo, scales against what was put in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calib.gap.inference.noise import Noise, _contradicts_repeats, estimate_noise
from calib.gap.inference.noise_components import (
    COMPONENTS,
    NoiseComponents,
    ambient_interactions,
    ambient_trends,
    kernels,
    quantisation,
)
from calib.gap.inference.repeatability import Replicates, ScaleLikelihood
from calib.gap.observations import Observations
from calib.gap.predict import Path, predict, residuals
from tests.gap import noise_bias
from tests.gap.effects.making import (
    COUNTS,
    RADIUS_M,
    ROUTE,
    SQUARE,
    TRACK_M,
    Motion,
    Run,
    campaign,
    end_pose,
    motion_of,
    rich_runs,
    situation,
)

#: ten draws of some 50 degrees of freedom each scatter by 5 %, the true variance by 7 % in each channel and by 3 % over
#: four, the bias allowed is 5 %
MEAN_VARIANCE_REL = 0.15
#: a reference's positions over what is stated of them, and what their estimate may be off by: the mean of twenty that
#: scatter by a quarter, and a tenth for what the stated sigma still pulls at it
COARSE, COARSE_REL = 3.0, 0.15
NAMES = [name for name, _, _ in COMPONENTS]
SIGMA_DISTANCE_M, SIGMA_XY_M, SIGMA_RAD = 0.0015, 0.002, 0.0008


def kernel(s: Observations, name: str) -> np.ndarray:
    return kernels(predict(s))[NAMES.index(name), 0]


def in_end_frame(pose: np.ndarray, heading: float) -> np.ndarray:
    """Along, left of and turned about the end heading, from x, y and heading (3, n)."""
    c, sn = np.cos(heading), np.sin(heading)
    return np.stack([c * pose[0] + sn * pose[1], c * pose[1] - sn * pose[0], pose[2]])


def test_heading_noise_on_a_straight_has_its_closed_form() -> None:
    """A heading walk of q rad/sqrt(m) over S m: lateral q^2 S^3/3, heading q^2 S, covariance q^2 S^2/2."""
    length = 12.0
    made = kernel(situation([Run([(length, 0.0)], steps=2000)]), "heading_walk")
    # sums over 2000 steps instead of integrals
    assert made[2, 2] == pytest.approx(length**3 / 3, rel=1e-5)
    assert made[2, 3] == pytest.approx(length**2 / 2, rel=1e-5)
    assert made[3, 3] == pytest.approx(length, rel=1e-9)
    np.testing.assert_allclose(made[:2, :], 0.0, atol=1e-9)


@pytest.mark.parametrize("pieces", [ROUTE, SQUARE], ids=["route", "square"])
def test_walks_of_heading_and_way_along_a_bent_path_are_those_of_monte_carlo(pieces: list[tuple[float, float]]) -> None:
    """End poses of a thousand bent paths with random kicks scatter as the kernels say."""
    run = Run(pieces, steps=60)
    made = motion_of(run)
    rng = np.random.default_rng(2)
    q, draws = 1e-3, 1500
    clean = end_pose(made.ds_m, made.turn_rad)
    root = np.sqrt(np.abs(made.ds_m))
    s = situation([run])
    for name in ("heading_walk", "along_walk"):
        moved = []
        for _ in range(draws):
            kick = rng.normal(0, q, len(root)) * root
            on_turn = float(name == "heading_walk")
            moved.append(end_pose(made.ds_m + (1 - on_turn) * kick, made.turn_rad + on_turn * kick) - clean)
        sample = np.cov(in_end_frame(np.array(moved).T, clean[2])) / q**2
        expected = kernel(s, name)[1:4, 1:4]
        scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected))) + 1e-9
        # a sample covariance of 1500 draws scatters by sqrt(2 / 1500) = 3.7 %; four of these
        np.testing.assert_allclose(sample / scale, expected / scale, atol=0.15)


def test_counting_in_whole_counts_is_that_of_monte_carlo() -> None:
    """First and last reading of each wheel rounded to whole counts: distance and heading scatter as stated."""
    rng = np.random.default_rng(3)
    n = 20_000
    lost = (rng.uniform(-0.5, 0.5, (2, n)) - rng.uniform(-0.5, 0.5, (2, n))) * 2 * np.pi / COUNTS * RADIUS_M
    s = situation([Run([(10.0, 0.0)])])
    # the vehicle's nominal wheel is the model's here
    assert s.vehicle.wheel_radius_m == pytest.approx(RADIUS_M)
    made = quantisation(predict(s))[0]
    # a sample variance of 20 000 draws scatters by 1 %; four of these
    assert made[0, 0] == pytest.approx(lost.mean(axis=0).var(), rel=0.04)
    assert made[3, 3] == pytest.approx(((lost[1] - lost[0]) / TRACK_M).var(), rel=0.04)


def test_the_gradient_of_the_likelihood_is_that_of_central_differences() -> None:
    """On a campaign with every component active, trends and weights included."""
    s = situation(rich_runs())
    path = predict(s)
    rng = np.random.default_rng(4)
    gap = residuals(path, path) + rng.normal(0, 3e-3, (len(s), 6)) * s.usable
    trends = np.concatenate([ambient_trends(path), *ambient_interactions(path)[:2]], axis=2)
    problem = likelihood(path, gap, np.arange(len(s)) // 4, trends)
    weight = rng.uniform(0.3, 1.0, len(problem.usable))
    at = np.log([median for _, median, _ in COMPONENTS]) + rng.normal(0, 0.4, len(NAMES))
    _, gradient = problem.cost(at, weight)
    step = 1e-4
    for k in range(len(NAMES)):
        away = np.eye(len(NAMES))[k] * step
        change = (problem.cost(at + away, weight)[0] - problem.cost(at - away, weight)[0]) / (2 * step)
        # differences of a cost of order 1000 over 1e-4 keep some six digits
        assert gradient[k] == pytest.approx(change, rel=1e-4, abs=1e-4), NAMES[k]


def test_trends_that_a_group_has_of_its_own_leave_no_more_than_rounding() -> None:
    """Own columns nearly alike, and trends in their span 1e6 noise levels large: the residual is never less than zero.

    It is the difference of two large sums, and the inverse of columns alike to 1e-5 is wrong in its sixth digit.
    """
    s = situation(rich_runs())
    path = predict(s)
    rng = np.random.default_rng(1)
    problem = likelihood(path, residuals(path, path), np.arange(len(s)) // 4, np.zeros((len(s), 6, 4)))
    n = len(problem.columns)
    alike = rng.standard_normal((n, 6, 1))
    problem.columns[:, :, :9] = alike + 1e-5 * rng.standard_normal((n, 6, 9))
    problem.columns[:, :, 9:13] = 1e6 * alike + rng.standard_normal((n, 6, 4))
    problem.prior[:] = 1e-6
    _, kept, middle = problem.solved(np.broadcast_to(np.eye(6), (n, 6, 6)))
    assert np.isfinite(middle)
    # what a unit keeps of itself lies between nothing and all
    assert np.linalg.eigvalsh(0.5 * (kept + kept.transpose(0, 2, 1))).max() < 1.0 + 1e-6


def likelihood(path: Path, gap: np.ndarray, labels: np.ndarray, trends: np.ndarray | None = None) -> ScaleLikelihood:
    return ScaleLikelihood(path, gap, NoiseComponents.about(path), Replicates.by(labels), trends)


def repeats(seed: int, n_repeats: int = 12, scale: float = 1.0, warmth: float = 0.0, **given: object) -> Observations:
    """Four conditions driven again and again: the vehicle strays as its wheels do not say, instruments scatter."""
    rng = np.random.default_rng(seed)

    def truth(run: Run, now: Motion) -> None:
        root = np.sqrt(np.abs(now.ds_m))
        now.yaw_rad = scale * 2e-3 * rng.normal(size=len(root)) * root
        now.along_m = scale * 3e-3 * rng.normal(size=len(root)) * root
        now.turn_rad, now.ds_m = now.turn_rad + now.yaw_rad, now.ds_m + now.along_m
        now.laser_m, now.end_x_m, now.end_y_m = rng.normal(0, [2 * SIGMA_DISTANCE_M, SIGMA_XY_M, SIGMA_XY_M])
        now.end_rad = rng.normal(0, SIGMA_RAD)
        now.left = now.right = warmth * (run.numbers.get("temperature_C", 20.0) - 20.0)

    runs = []
    for number in range(4 * n_repeats):
        pieces = [[(10.0, 0.0)], ROUTE][number % 2]
        run = Run(pieces, steps=50, kind=["corridor", "route_left"][number % 2], speed_mps=[0.4, 0.7][number // 2 % 2])
        run.front = False
        runs.append(replace(run, numbers={k: float(v[number]) for k, v in given.items()}))  # type: ignore[index]
    return situation(runs, truth=truth)


def estimated(s: Observations) -> Noise:
    nominal = predict(s)
    return estimate_noise(nominal, residuals(nominal, nominal))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_scales_come_back_from_repeats(seed: int) -> None:
    """Walks ten times their prior and a laser twice as bad as stated come back within four standard errors."""
    noise = estimated(repeats(seed))
    assert noise.dof > 100
    truth = {"heading_walk": 2e-3, "along_walk": 3e-3, "distance": 2.0}
    # some 40 degrees of freedom in each channel: the logarithm scatters by 1/sqrt(2 * 40); the laser is read on half of
    # the runs, and its own prior (0.4) draws it a tenth back
    for name, free in (("heading_walk", 40), ("along_walk", 40), ("distance", 15)):
        assert abs(np.log(noise.scales[name] / truth[name])) < 4 / np.sqrt(2 * free), name


def test_an_outlier_weighs_less_and_leaves_the_floor_alone() -> None:
    """One run far from its repeats gets a small weight; the others keep theirs, and the scales hardly move."""
    s = repeats(5)
    clean = estimated(s)
    measured = s.measured.copy()
    measured[8, :4] += 15 * clean.floor[8, :4]
    spoiled = estimated(replace(s, measured=measured))
    assert spoiled.weight[8] < 0.2
    assert np.median(np.delete(spoiled.weight, 8)) > 0.7
    # without weights one unit of 15 noise levels in 48 would raise the noise level by sqrt(1 + 225 / 48) = 2.4
    ratio = np.median(spoiled.floor[:, 3] / clean.floor[:, 3])
    assert 0.7 < ratio < 1.4


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_normal_noise_keeps_its_weight(seed: int) -> None:
    """One unit in twenty lies further from its repeats than normal noise takes nineteen; the others weigh all they can.

    Where more weighed less, the noise level would come from those close by, and what repeats have in common lie beyond
    it.
    """
    weight = estimated(repeats(seed)).weight
    # four standard errors of a share of 0.05 among 48 units; the scales are estimated from the same units
    assert (weight < 1.0).mean() < 0.05 + 4 * np.sqrt(0.05 * 0.95 / 48)
    assert weight.mean() > 0.95


def test_few_repeats_fall_back_to_coarser_groups() -> None:
    """Hardly two runs in one warmth and humidity: conditions serve as repeats, and what the warmth does is no noise."""
    rng = np.random.default_rng(6)
    values = {name: rng.uniform(*span, 64) for name, span in (("temperature_C", (5, 45)), ("humidity", (0.2, 0.8)))}
    warm, even = repeats(6, 16, warmth=1e-3, **values), repeats(6, 16, warmth=0.0, **values)
    path = predict(warm)
    assert likelihood(path, residuals(path, path), warm.cell).dof < 30
    noise, without = estimated(warm), estimated(even)
    assert noise.dof >= 30
    # 1e-3 a kelvin over 10 m and some 12 K is 120 mm, beside a walk of 10 mm: a tenth of it left would double the scale
    for name, value in without.scales.items():
        assert noise.scales[name] == pytest.approx(value, rel=0.1), name


def varied(seed: int) -> Observations:
    """Return sixty runs whose radii scatter, hardly two of one load and speed."""
    truth = noise_bias.truth_of("radius", np.random.default_rng(seed))
    return situation(noise_bias.runs_of("varied", 60), truth=truth)


def test_few_repeats_leave_the_noise_to_the_routes_they_agree_with() -> None:
    """The laws of load and speed are taken out route by route; ten estimates scatter half as much as by repeats."""
    scales = []
    for seed in range(10):
        s = varied(seed)
        assert likelihood(predict(s), residuals(predict(s), predict(s)), s.cell).dof < 30
        noise = estimated(s)
        assert noise.support.startswith("runs of one route")
        assert noise.dof > 60
        scales.append(noise.scales["yaw_scatter"])
    # sixty degrees of freedom over four channels; by repeats alone the logarithm scatters by 0.5
    assert np.std(np.log(scales)) < 0.25


@pytest.mark.parametrize("seed", range(3))
def test_few_repeats_tell_a_noise_level_that_is_not_theirs(seed: int) -> None:
    """Four degrees of freedom a channel: a scatter four times too large is not theirs, the true one is."""
    s = varied(seed)
    path = predict(s)
    shapes = NoiseComponents.about(path)
    noise = estimated(s)
    for times, contradicted in ((1.0, False), (4.0, True)):
        scales = {**noise.scales, "yaw_scatter": times * noise.scales["yaw_scatter"]}
        log_scale = np.log([scales.get(name, median) for name, median, _ in COMPONENTS])
        assert _contradicts_repeats(path, residuals(path, path), shapes, log_scale) is contradicted


def test_a_single_run_keeps_the_stated_instruments() -> None:
    """Without repeats every scale is its prior's median."""
    noise = estimated(situation([Run([(10.0, 0.0)])]))
    assert noise.dof == 0
    assert noise.weight.tolist() == [1.0]
    medians = {name: median for name, median, _ in COMPONENTS}
    for name, value in noise.scales.items():
        assert value == pytest.approx(medians[name])


def test_a_missing_channel_has_unit_variance_and_no_correlation() -> None:
    made = campaign([Run([(10.0, 0.0)], front=False)] * 3)
    made.runs.numbers["distance_m"][1] = np.nan
    from calib.gap.observations.from_campaign import observations_of

    noise = estimated(observations_of(made))
    assert noise.covariance[1, 0, 0] == pytest.approx(1.0)
    np.testing.assert_array_equal(noise.covariance[1, 0, 1:], 0.0)
    assert noise.covariance[0, 0, 0] < 1e-2


@pytest.mark.parametrize(
    ("design", "scatter"),
    [("corridors", "start pose"), ("squares", "radius"), ("mixed", "heading walk"), ("varied", "start pose")],
)
def test_variances_are_the_true_ones(design: str, scatter: str) -> None:
    """Sixty runs: the mean of ten estimates against the variance of 400 runs whose every parameter is known."""
    quotient = noise_bias.ratio((design, scatter, 60), draws=10, seed=11, n_true=400)
    assert np.exp(np.nanmean(np.log(quotient))) == pytest.approx(1.0, rel=MEAN_VARIANCE_REL)


def test_positions_three_times_as_coarse_as_stated_are_no_walk_of_the_heading() -> None:
    """Forty runs of a vehicle whose heading walks 9e-4 rad per sqrt(m): what is estimated of the positions' noise."""

    def truth_of(rng: np.random.Generator) -> Callable[[Run, Motion], None]:
        walk = noise_bias.truth_of("heading walk", rng)

        def truth(run: Run, now: Motion) -> None:
            walk(run, now)
            now.end_x_m, now.end_y_m, now.yaw_rad = COARSE * now.end_x_m, COARSE * now.end_y_m, 3.0 * now.yaw_rad

        return truth

    scales = []
    for seed in range(20):
        truth = truth_of(np.random.default_rng([5, seed]))
        observations = situation(noise_bias.runs_of("mixed", 40), truth=truth)
        scales.append(estimated(observations).scales["position"])
    assert np.exp(np.mean(np.log(scales))) == pytest.approx(COARSE, rel=COARSE_REL)
