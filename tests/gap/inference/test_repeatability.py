"""What a noise level rests on: repeats, neighbours, windows, stated sigmas; never on motion that no wheel saw."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.campaign.settings import Reference
from calib.gap.inference.noise import Basis, Noise, estimate_noise, window_growth
from calib.gap.inference.repeatability import Replicates, neighbours, thinned_replicates
from calib.gap.observations import Observations
from calib.gap.observations.from_campaign import observations_of
from calib.gap.predict import predict, residuals
from tests.gap.effects.making import ROUTE, Motion, Run, situation
from tests.gap.inference.test_noise import SIGMA_DISTANCE_M, repeats
from tests.gap.observations.paths import Truth, campaign_of, seen
from tests.real import recordings

SIGMA_XY_M, SIGMA_RAD = 0.002, 0.004


def estimated(observations: Observations) -> Noise:
    path = predict(observations)
    return estimate_noise(path, residuals(path, path))


def recording(
    seed: int, *, walk: float = 0.0, bias: float = 0.0, strafe_m: float = 0.0, way_m: float = 150.0
) -> Observations:
    """One long free drive seen by a noisy reference, cut into windows.

    `walk`: rad per root metre that no wheel sees; `bias`: relative, one wheel's radius; `strafe_m`: way sideways, to
    and fro, in stretches of ten metres.
    """
    rng = np.random.default_rng(seed)
    pieces = [(float(rng.uniform(1, 3)), float(rng.choice([-0.5, 0.0, 0.5, 1.0]))) for _ in range(int(way_m / 2))]
    truth = Truth(pieces, 3.0 + 1j, 0.8, steps=6000)
    log = truth.counts()
    log["counts_left"] = log["counts_left"] * (1 + bias)
    ds = np.abs(truth.ds)
    extra = np.cumsum(walk * np.sqrt(ds) * rng.normal(size=len(ds)))
    turned = truth.heading + extra
    sideways = strafe_m / 10.0 * np.where(np.floor(np.cumsum(ds) / 10.0) % 2 == 0, 1.0, -1.0)
    steps = np.diff(truth.place, prepend=truth.place[0]) * np.exp(1j * extra) + 1j * sideways * ds * np.exp(1j * turned)
    truth.place, truth.heading = truth.place[0] + np.cumsum(steps), turned
    poses = seen(truth, in_map=True)
    log["ref_x_m"] = poses["ref_x_m"] + rng.normal(0, SIGMA_XY_M, len(ds))
    log["ref_y_m"] = poses["ref_y_m"] + rng.normal(0, SIGMA_XY_M, len(ds))
    log["ref_theta_rad"] = poses["ref_theta_rad"] + rng.normal(0, SIGMA_RAD, len(ds))
    stated = Reference(sigma_xy_m=SIGMA_XY_M, sigma_theta_rad=SIGMA_RAD)
    return observations_of(campaign_of([log], stated))


def test_repeats_support_a_floor_however_large_it_is() -> None:
    """Repeats that scatter far more than stated give a noise level all the same; that it does is a finding."""
    noise = estimated(repeats(1, scale=20.0))
    assert noise.supported
    assert noise.support.startswith(Basis.REPEATS)
    assert float(np.nanmax(noise.excess)) > 10
    assert "times as much as the stated sigmas" in noise.finding
    calm = estimated(repeats(1, scale=0.05))
    # the laser of these runs is twice as bad as stated, and walks by twice the typical
    assert float(np.nanmax(calm.excess)) < 2.5
    assert calm.finding == ""


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_windows_of_a_free_drive_give_the_floor_of_the_reference(seed: int) -> None:
    """No repeats, a reference that scatters as stated and no wheel at fault: supported, at the stated size."""
    observations = recording(seed)
    noise = estimated(observations)
    assert observations.windowed
    assert noise.supported, noise.support
    # some 40 windows: a scale is known to 1 / sqrt(2 * 40) = 11 %; three of these, the prior drawing towards 1
    np.testing.assert_allclose(noise.excess[1:4], 1.0, atol=0.35)


@pytest.mark.parametrize("seed", [4, 5])
def test_a_wheel_at_fault_is_no_part_of_the_floor_of_windows(seed: int) -> None:
    """One radius 1 % off turns each 3 m window by 60 mrad, fifteen noise levels; neighbours share it: a gap."""
    noise, clean = estimated(recording(seed, bias=0.01)), estimated(recording(seed))
    assert noise.supported, noise.support
    # windows of unlike shape share it but in part
    np.testing.assert_allclose(noise.excess[1:4], clean.excess[1:4], rtol=0.6)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_random_walk_of_the_heading_is_a_floor_and_found_in_windows(seed: int) -> None:
    """Twelve milliradians a root metre that no wheel sees, twice what the reference scatters: found as such."""
    noise = estimated(recording(seed, walk=0.012))
    assert noise.supported, noise.support
    # some 35 degrees of freedom in the heading: 12 %; three of these, the prior drawing down from its tail
    assert noise.scales["heading_walk"] == pytest.approx(0.012, rel=0.4)


@pytest.mark.parametrize("seed", [6, 7])
def test_motion_that_no_wheel_sees_supports_no_floor(seed: int) -> None:
    """0.8 m sideways in every ten metres, to and fro: for any windows' scatter is, it is no floor."""
    noise = estimated(recording(seed, strafe_m=0.8))
    assert not noise.supported
    assert noise.support.startswith("nothing")


def test_strafing_of_a_real_robot_supports_no_floor(shared_data: Path) -> None:
    """A mecanum robot taken for a differential drive strafes by 0.4 m and more; nothing may call that noise."""
    noise = estimated(observations_of(recordings.mecanum_as_differential(shared_data, "bag1")))
    assert not noise.supported


def test_one_run_supports_nothing_and_few_runs_their_stated_sigmas_unless_assumed() -> None:
    straight = [Truth([(10.0 + k * k, 0.0)]) for k in range(6)]
    ends = np.array([t.end() for t in straight])
    numbers = dict(zip(("ref_x_m", "ref_y_m", "ref_theta_rad"), ends.T, strict=True))
    made = campaign_of([t.counts() for t in straight], numbers=numbers)
    few = estimated(observations_of(made))
    assert few.supported
    assert few.support == Basis.STATED
    assert not estimated(observations_of(made.select([0]))).supported
    filled_in = replace(made, extra={"assumed": ["reference.sigma_xy_m"]})
    assert estimated(observations_of(filled_in)).support == Basis.NOTHING


def test_neighbourhoods_are_of_one_label_and_in_the_order_driven() -> None:
    labels = np.array([0, 1, 0, 1, 0, 0, 1, 0, 2])
    number = neighbours(labels, 2)
    groups = {frozenset(np.flatnonzero(number == k).tolist()) for k in np.unique(number)}
    # the residual over joins the last
    assert groups == {frozenset({0, 2}), frozenset({4, 5, 7}), frozenset({1, 3, 6}), frozenset({8})}


@pytest.mark.parametrize(("given", "part"), [("constant", 0), ("walk", 1), ("bias", 2)])
def test_growth_tells_reference_walk_and_systematic_apart(given: str, part: int) -> None:
    """Constant, root and proportional growth of the heading's error are told from windows joined to longer ones."""
    arguments = {"constant": {}, "walk": {"walk": 0.02}, "bias": {"bias": 0.02}}[given]
    observations = recording(9, way_m=400.0, **arguments)
    growth = window_growth(predict(observations))
    assert growth is not None
    lengths_m, heading = growth
    assert heading[part] > 0.6 * heading.sum(), heading
    if given == "walk":
        # 0.02 rad per root metre; some hundred windows
        assert np.sqrt(heading[1] / lengths_m[0]) == pytest.approx(0.02, rel=0.25)


def test_thinned_groups_keep_two_of_each_and_the_share_of_all() -> None:
    labels = np.repeat(np.arange(7), [2, 3, 1, 100, 400, 900, 2])
    whole = Replicates.by(np.random.default_rng(1).permutation(labels))
    some = thinned_replicates(whole, 200)
    assert set(some.units) <= set(whole.units)
    sizes = np.bincount(some.group)
    assert (sizes >= 2).all()
    assert 0.8 * 200 < len(some.units) < 1.2 * 200
    assert thinned_replicates(whole, 10_000) is whole


def test_the_floor_of_many_runs_is_that_of_some_of_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """Scales from a fifth of the units are those of all, to their uncertainty, and every unit keeps its own weight."""
    observations = repeats(11, 60)
    every = estimated(observations)
    few = "calib.gap.inference.noise.repeatability.thinned_replicates"
    monkeypatch.setattr(few, lambda grouped: thinned_replicates(grouped, 48))
    some = estimated(observations)
    # 48 units of 4 conditions, some 40 degrees of freedom a channel: 11 % each; three of these
    np.testing.assert_allclose(np.median(some.floor, axis=0)[:4], np.median(every.floor, axis=0)[:4], rtol=0.33)
    assert len(some.weight) == len(observations)
    assert (some.weight < 1.0).sum() > 0


def driven_once(n_runs: int, *, step: float = 0.0, per_K: float = 0.0) -> Observations:
    """Runs on two routes at four speeds, none under the same surroundings twice, two sessions in turn.

    `step`: relative, both radii in every second session; `per_K`: relative, both radii with the temperature.
    """
    rng = np.random.default_rng(1)

    def truth(run: Run, now: Motion) -> None:
        now.laser_m, now.end_x_m, now.end_y_m = rng.normal(0, [SIGMA_DISTANCE_M, SIGMA_XY_M, SIGMA_XY_M])
        now.end_rad = rng.normal(0, SIGMA_RAD)
        now.left = now.right = step * (run.session == "s2") + per_K * (run.numbers["temperature_C"] - 20.0)

    runs = []
    for number in range(n_runs):
        warmth = 5.0 + 35.0 * (11 * number % n_runs) / n_runs
        run = Run(
            [[(10.0, 0.0)], ROUTE][number % 2],
            steps=50,
            kind=["corridor", "route_left"][number % 2],
            session=f"s{1 + number // 8 % 2}",
            speed_mps=[0.3, 0.6, 0.9, 0.45][number // 2 % 4],
            numbers={"temperature_C": warmth, "minutes_under_load": float(17 * number % 60)},
        )
        run.front = False
        runs.append(run)
    return situation(runs, truth=truth)


def test_a_step_between_sessions_is_no_part_of_the_floor_of_neighbours() -> None:
    """Radii that step by 1 % between sessions leave the noise level as it is: 25 times of it would hide them."""
    noise, calm = estimated(driven_once(32, step=0.01)), estimated(driven_once(32))
    assert noise.support.startswith(Basis.NEIGHBOURS)
    # what is compared differs from one to the other: 60 degrees of freedom in four channels, 18 % each; two of these
    np.testing.assert_allclose(noise.excess[:4], calm.excess[:4], rtol=0.36)


def test_runs_with_the_temperature_as_a_trend_go_before_neighbours_that_support_nothing() -> None:
    """Radii follow the temperature: neighbours scatter by it thirteen times as stated, runs of a route have a trend."""
    noise, calm = estimated(driven_once(30, per_K=5e-4)), estimated(driven_once(30))
    assert noise.supported, noise.support
    assert noise.support.startswith(Basis.ROUTE)
    # 40 degrees of freedom in four channels: 22 % each; two of these
    np.testing.assert_allclose(noise.excess[:4], calm.excess[:4], rtol=0.45)
