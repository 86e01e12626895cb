"""Guided runs without an end pose have two wheels: a heading of zero, as uncertain as the way is straight."""

from __future__ import annotations

import numpy as np
import pytest

from calib.campaign.wheels import steered_by_counts
from calib.gap.observations.from_campaign import observations_of
from calib.gap.observations.routes import ASSUMED_LATERAL_M, WheelTravel, weave_of_log
from calib.gap.predict import predict, residuals
from tests.gap.observations.paths import TRACK_M, Truth, campaign_of


def corridor(unequal: float = 1e-4, length: float = 40.0, n: int = 12, **columns: np.ndarray) -> dict:
    straight = Truth([(length, 0.0)])
    counts = straight.counts()
    counts["counts_left"] = counts["counts_left"] * (1 + unequal)
    return {"logs": [counts] * n, "numbers": {"distance_m": np.full(n, length), **columns}}


def test_unequal_wheels_show_as_a_heading_of_the_straight() -> None:
    """One wheel that counts 1 % more over S m turns the odometry by -0.01 S/b; the gap says so, as e = +0.01 S/b."""
    observations = observations_of(campaign_of(**corridor(0.01)))
    assert observations.guided.all()
    assert observations.usable[:, 3].all()
    path = predict(observations)
    np.testing.assert_allclose(residuals(path, path)[:, 3], 0.01 * 40.0 / TRACK_M, rtol=1e-9)


def test_a_stated_weave_gives_the_uncertainty() -> None:
    """Amplitude A and wavelength l: the heading goes up to 2 pi A / l."""
    made = corridor(amplitude_m=np.full(12, 0.03), wavelength_m=np.full(12, 8.0))
    observations = observations_of(campaign_of(**made))
    np.testing.assert_allclose(observations.sigma[:, 3], 2 * np.pi * 0.03 / 8.0, rtol=1e-12)


def test_without_a_log_or_a_stated_weave_the_uncertainty_is_assumed_and_said() -> None:
    made = corridor()
    counts = {name: np.array([log[name][-1] for log in made["logs"]]) for name in ("counts_left", "counts_right")}
    empty = [{name: column[:1] for name, column in log.items()} for log in made["logs"]]
    observations = observations_of(campaign_of(empty, numbers=made["numbers"] | counts))
    middle_m = 40.0 * (1 + 0.5e-4)
    np.testing.assert_allclose(observations.sigma[:, 3], 2 * np.pi * ASSUMED_LATERAL_M / middle_m, rtol=1e-5)
    assert any("assumed" in note for note in observations.notes)


def test_the_weave_of_a_log_is_that_of_its_sine() -> None:
    """A heading a sin(2 pi s/l) beside an even turn has root mean square a / sqrt(2); whole waves, fine steps."""
    n, a = 4000, 0.02
    way = np.full(n, 40.0 / n)
    along = np.cumsum(way)
    heading = a * np.sin(2 * np.pi * along / 5.0) + 0.01 * along
    turn = np.diff(heading, prepend=0.0)
    travel = WheelTravel(np.array([0, n]), way - 0.5 * turn, way + 0.5 * turn, 1.0, np.ones(n), np.array([True]))
    found = weave_of_log(travel)
    # the trend takes a little of eight whole waves: (6 / (2 pi 8))^2 / 2 = 0.7 % of the square
    assert found[0] == pytest.approx(a / np.sqrt(2), rel=5e-3)


@pytest.mark.parametrize("spoil", ["pose", "bent", "short"])
def test_other_runs_get_no_heading_for_nothing(spoil: str) -> None:
    """A measured end pose, a bent way or a distance that is not the way's leaves the run alone."""
    made = corridor()
    if spoil == "pose":
        made["numbers"]["ref_theta_rad"] = np.full(12, 0.01)
    if spoil == "bent":
        made["logs"] = [Truth([(40.0, 0.1)]).counts()] * 12
    if spoil == "short":
        made["numbers"]["distance_m"] = np.where(np.arange(12) < 3, 30.0, 40.0)
    led = observations_of(campaign_of(**made)).guided
    assert not led[:3].any()
    assert led[3:].all() == (spoil == "short")


COUNT_M = (1.5e-4, 1.5e-4)


@pytest.mark.parametrize(
    ("walk", "mean_m", "count_m", "expected"),
    [
        (0.0, 0.0, COUNT_M, True),
        (3e-4, 0.0, COUNT_M, False),
        (9e-4, 0.0, COUNT_M, False),
        (0.0, 0.02, COUNT_M, False),
        (0.0, 0.0, (2e-3, 2e-3), False),
    ],
    ids=["to a count", "a smooth floor", "a real robot", "unequal wheels", "coarse counts"],
)
def test_wheels_alike_to_a_count_say_that_the_vehicle_kept_them_so(
    walk: float, mean_m: float, count_m: tuple[float, float], expected: bool
) -> None:
    """Thirty runs of 20 m: each end is off by a uniform share of a count, and the floor lets the wheels part."""
    rng = np.random.default_rng(1)
    counted = (rng.random((30, 2)) - rng.random((30, 2))) * 0.5 * count_m[0]
    apart = counted[:, 1] - counted[:, 0] + walk * np.sqrt(20.0) * rng.standard_normal(30) + mean_m
    assert steered_by_counts(apart, np.full(30, 20.0), count_m) is expected


def test_a_few_runs_may_roll_alike_by_chance() -> None:
    assert not steered_by_counts(np.zeros(4), np.full(4, 20.0), COUNT_M)


def test_runs_steered_by_their_counts_get_no_heading_and_it_is_said() -> None:
    """The wheels turned alike wherever the vehicle went: a heading of zero would say that the radii are equal."""
    observations = observations_of(campaign_of(**corridor(1e-6)))
    assert not observations.guided.any()
    assert not observations.usable[:, 3].any()
    assert any("steered by its own counts" in note for note in observations.notes)
