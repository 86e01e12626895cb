"""Closed loops, headings alone and taped lengths: what they leave open is held, and what they tell has its own scatter.

The reality is that of `tests.kinematics.unaided`, integrated in fine steps by no code of calib's.
"""

from __future__ import annotations

import numpy as np
import pytest

from calib.campaign.model import Campaign
from calib.kinematics.drives import Parameter, Parameters
from calib.kinematics.estimate import estimate_geometry
from calib.kinematics.joint_fit import MEAN_RADIUS, left_open
from calib.kinematics.result import GeometryVerdict
from calib.kinematics.uncertainty import Uncertainty
from tests.campaign.making import with_numbers
from tests.kinematics.campaigns import Truth, square
from tests.kinematics.unaided import Drive, Gyro, unaided

TRUTH = Truth(radius_left_m=0.0503, radius_right_m=0.0501, track_m=0.404)
LOOP, TAPE = frozenset({"loop"}), frozenset({"tape"})
#: campaigns, and how many of two ratios each their intervals hold at least: of 80 at 95 % fewer come once in 1300
CAMPAIGNS, LEAST_HELD = 40, 69
#: of the nominal lengths: no unit, and no campaign of loops, makes more
NEAR = 0.1


def _loops(n: int, rng: np.random.Generator, *, open_m: tuple[float, ...] = (), taped: int = 0) -> Campaign:
    """Squares in turn to either side, the first of them open by so much, and straights along a tape."""
    runs = []
    for number in range(n):
        sense = 1 - 2 * (number % 2)
        legs = list(square(2.0, sense))
        way, turn = legs[0]
        legs[0] = (way + (open_m[number] if number < len(open_m) else 0.0), turn)
        runs.append(Drive(f"square{sense}", legs, LOOP))
    runs += [Drive("corridor", [(8.0, 0.0)], TAPE) for _ in range(taped)]
    return unaided(runs, TRUTH, Gyro(), rng)


def test_ratios_of_few_loops_have_the_freedom_of_few_loops() -> None:
    """The nominal mean radius, known to a per cent, has no part in them, though radii and track rest on it."""
    mean_m = 0.5 * (TRUTH.radius_left_m + TRUTH.radius_right_m)
    truth = {"right_over_left": TRUTH.radius_right_m / TRUTH.radius_left_m, "track_over_radius": TRUTH.track_m / mean_m}
    held = 0
    for seed in range(CAMPAIGNS):
        ratios = estimate_geometry(_loops(6, np.random.default_rng([1, seed]))).ratios
        assert {one.name for one in ratios} == truth.keys()
        assert all(one.dof <= 6.0 for one in ratios)
        held += sum(one.ci95[0] <= truth[one.name] <= one.ci95[1] for one in ratios)
    assert held >= LEAST_HELD


def test_a_loop_that_did_not_close_is_an_outlier() -> None:
    """Paths of no length close as well: with one of twelve open by half a metre the radii came out a millionth."""
    found = estimate_geometry(_loops(12, np.random.default_rng(2), open_m=(0.5,)))
    assert found.outliers == ("r000",)
    assert found.passed
    assert found["track_m"].value / found["radius_left_m"].value == pytest.approx(
        TRUTH.track_m / TRUTH.radius_left_m, rel=5e-3
    )


def test_loops_that_are_all_open_keep_their_scale_and_give_no_result() -> None:
    found = estimate_geometry(_loops(12, np.random.default_rng(3), open_m=(0.5,) * 12))
    assert not found.passed
    assert all(abs(one.value / one.nominal - 1.0) < NEAR for one in found.estimates if one.nominal)


def test_the_one_taped_run_beside_loops_need_not_be_predicted_by_them() -> None:
    """What it alone tells cannot be held out: without it no loop has a scale."""
    found = estimate_geometry(_loops(12, np.random.default_rng(4), taped=1))
    assert found.verdict is GeometryVerdict.CALIBRATED, found.why
    assert not found.scaled
    assert found["radius_left_m"].value == pytest.approx(TRUTH.radius_left_m, rel=2e-3)


def _headings(n: int, rng: np.random.Generator, taped: int) -> Campaign:
    """Free drives and straights along a tape, all with the heading at their end."""
    legs = [[(rng.uniform(0.5, 1.5), rng.uniform(-1.5, 1.5)) for _ in range(6)] for _ in range(n)]
    runs = [Drive("free", some, frozenset()) for some in legs]
    runs += [Drive("corridor", [(8.0, 0.0)], TAPE) for _ in range(taped)]
    turned = np.array([sum(turn for _, turn in run.legs) for run in runs]) + 0.002 * rng.normal(size=len(runs))
    return with_numbers(unaided(runs, TRUTH, Gyro(), rng), ref_theta_rad=turned)


def test_a_taped_length_counts_beside_a_measured_heading() -> None:
    """Headings leave the scale open; a straight of known length gives it, whether or not its own heading was read."""
    found = estimate_geometry(_headings(12, np.random.default_rng(5), taped=4))
    assert not found.scaled
    for name in ("radius_left_m", "radius_right_m", "track_m"):
        # a tape of four straights tells the scale to some 1e-4
        assert found[name].value == pytest.approx(getattr(TRUTH, name), rel=2e-3)


def test_as_many_headings_as_parameters_and_slips_tell_no_slip() -> None:
    """Of six, two are left beside three parameters and a slip: one sound campaign in thirteen was doubted."""
    doubted = [
        fault.code
        for seed in range(40)
        for fault in estimate_geometry(_headings(6, np.random.default_rng([7, seed]), taped=0)).faults
    ]
    assert [code for code in doubted if "slip" in code] == []


@pytest.mark.parametrize(("scale", "words"), [(-1.0, "wheels are"), (180.0 / np.pi, "found degrees")])
def test_a_gyro_of_another_sense_or_unit_is_named_as_such(scale: float, words: str) -> None:
    """To it wheels that are exchanged look alike; no column is named that the campaign does not have."""
    rng = np.random.default_rng(8)
    legs = [[(rng.uniform(0.5, 1.5), rng.uniform(-0.7, 0.7)) for _ in range(4)] for _ in range(12)]
    runs = [Drive("free", some, frozenset({"gyro"})) for some in legs]
    runs += [Drive("corridor", [(8.0, 0.0)], frozenset({"gyro", "tape"})) for _ in range(4)]
    fault, *_ = estimate_geometry(unaided(runs, TRUTH, Gyro(scale=scale), rng)).faults
    assert words in fault.text
    assert "gyro_z_radps" in fault.text and "ref_" not in fault.text


@pytest.mark.parametrize(("dof", "is_open"), [(1.0, True), (20.0, False)])
def test_a_mean_radius_from_hardly_any_runs_is_open(dof: float, is_open: bool) -> None:
    """0.8 % from one degree of freedom is 1.5 % as a normal law's: no better than the nominal radius."""
    items = (Parameter("radius_left_m", 0.05, 0.005), Parameter("radius_right_m", 0.05, 0.005))
    parameters = Parameters.of(items, [item.name for item in items])
    covariance, free = np.full((2, 2), (0.008 * 0.05) ** 2), np.full(2, dof)
    uncertainty = Uncertainty(covariance, free, "run", 8, np.sqrt(np.diag(covariance)), np.zeros(2))
    assert (MEAN_RADIUS in left_open(uncertainty, parameters)) is is_open
