from __future__ import annotations

import numpy as np
import pytest

from calib.errors import RefusedError
from calib.radius.deviation import weave_excess
from calib.radius.effective import effective_radii
from calib.radius.fit import fit_campaign
from tests.radius.campaigns import COUNTS_PER_REV, campaign_of, straight, woven_counts

LOAD = np.linspace(300.0, 1100.0, 5)
SIDES = ("left", "right")


def test_straight_runs_give_equation_6() -> None:
    left, right = 0.1 + 1e-6 * LOAD, 0.1002 - 1e-6 * LOAD
    radii = effective_radii(straight(left, right, LOAD))
    np.testing.assert_allclose(radii.radius_left_m, left, rtol=1e-12)  # rounding
    np.testing.assert_allclose(radii.radius_right_m, right, rtol=1e-12)


def test_unequal_radii_are_never_taken_for_an_arc() -> None:
    """Wheels 1 % apart leave a difference of counts as an arc of 0.57 rad would."""
    left, right = np.full(5, 0.1), np.full(5, 0.101)
    radii = effective_radii(straight(left, right, LOAD))
    np.testing.assert_allclose(radii.radius_right_m / radii.radius_left_m, 1.01, rtol=1e-12)  # rounding
    assert set(radii.path_source) == {"none"}


def test_counts_of_a_reversing_vehicle_give_the_same_radii() -> None:
    forward = straight(np.full(3, 0.1), np.full(3, 0.1), LOAD[:3])
    numbers = dict(forward.runs.numbers)
    numbers["counts_left"], numbers["counts_right"] = -numbers["counts_left"], -numbers["counts_right"]
    np.testing.assert_allclose(effective_radii(campaign_of(numbers)).radius_left_m, 0.1, rtol=1e-12)  # rounding


WOVEN = [(0.05, 5.0, 37.7, 1.0), (0.02, 9.0, 40.0, 0.3), (0.1, 12.0, 41.3, 2.0), (0.03, 7.0, 38.0, 4.0)]


def woven_campaign(**columns: np.ndarray) -> object:
    logs = [woven_counts(*run, 0.1003, 0.0999) for run in WOVEN]
    return campaign_of(
        {
            "distance_m": np.array([run[2] for run in WOVEN]),
            "counts_left": np.array([left[-1] for left, _ in logs]),
            "counts_right": np.array([right[-1] for _, right in logs]),
            "load_left_N": LOAD[:4],
            "load_right_N": LOAD[:4],
            **columns,
        },
        logs=logs,
    )


def test_a_logged_weave_is_corrected_for_both_wheels() -> None:
    campaign = woven_campaign()
    radii = effective_radii(campaign)
    # a count is 4e-6 of the run; the weave is estimated to 1 % and moves these radii by up to 1e-3
    np.testing.assert_allclose(radii.radius_left_m, 0.1003, rtol=1.5e-5)
    np.testing.assert_allclose(radii.radius_right_m, 0.0999, rtol=1.5e-5)
    raw = radii.radius_left_m / (1 + radii.path_left)
    assert np.max(np.abs(raw / 0.1003 - 1)) > 3e-4


def test_a_measured_heading_corrects_the_turn_where_there_is_no_log() -> None:
    """A run that ends 0.02 rad to the left: the right wheel went half a track times the turn further."""
    turn = np.array([0.02, -0.015, 0.01, -0.02, 0.012])
    centre = 40.0 * (0.5 * turn) / np.sin(0.5 * turn)
    numbers = {
        "distance_m": np.full(5, 40.0),
        "counts_left": (centre - 0.35 * turn) / (2 * np.pi * 0.1) * COUNTS_PER_REV,
        "counts_right": (centre + 0.35 * turn) / (2 * np.pi * 0.1) * COUNTS_PER_REV,
        "load_left_N": LOAD,
        "load_right_N": LOAD,
        "ref_theta_rad": turn,
    }
    radii = effective_radii(campaign_of(numbers))
    # the heading is trusted to its signal over noise, 0.3 % short of fully, of 1.7e-4
    np.testing.assert_allclose(radii.radius_left_m, 0.1, rtol=1e-6)
    np.testing.assert_allclose(radii.radius_right_m, 0.1, rtol=1e-6)
    assert set(radii.path_source) == {"none+heading"}


def test_measured_amplitude_and_wavelength_correct_the_length() -> None:
    amplitude, wavelength = np.full(3, 0.1), np.full(3, 5.0)
    excess = float(weave_excess(0.1, 5.0, 40.0, 0.7).centre)
    counts = 40.0 * (1 + excess) / (2 * np.pi * 0.1) * COUNTS_PER_REV
    radii = effective_radii(
        campaign_of(
            {
                "distance_m": np.full(3, 40.0),
                "counts_left": np.full(3, counts),
                "counts_right": np.full(3, counts),
                "load_left_N": LOAD[:3],
                "load_right_N": LOAD[:3],
                "amplitude_m": amplitude,
                "wavelength_m": wavelength,
            }
        )
    )
    np.testing.assert_allclose(radii.radius_left_m, 0.1, rtol=1e-10)  # rounding; whole periods
    assert set(radii.path_source) == {"columns"}


def test_uncertainty_is_what_repeated_simulation_scatters() -> None:
    """Rangefinder noise and whole counts, by Monte Carlo over 4,000 runs."""
    rng, n = np.random.default_rng(3), 4000
    exact = 5.0 / (2 * np.pi * 0.1) * COUNTS_PER_REV / 16
    counts = np.floor(rng.uniform(size=(2, n)) + exact)
    numbers = {
        "distance_m": 5.0 / 16 * 4 + rng.normal(0.0, 0.0015, n),
        "counts_left": counts[0] * 4,
        "counts_right": counts[1] * 4,
        "load_left_N": np.full(n, 300.0),
        "load_right_N": np.full(n, 300.0),
    }
    radii = effective_radii(campaign_of(numbers))
    quantised = np.std(counts[0] * 4) / np.mean(counts[0] * 4)
    expected = 0.1 * np.hypot(0.0015 / 1.25, quantised)
    # 4,000 runs know a standard deviation to 1.1 %; four of those
    assert np.std(radii.radius_left_m) == pytest.approx(expected, rel=0.045)
    budget = {part.name: part.std_left_m for part in radii.budget}
    assert budget["rangefinder"] == pytest.approx(0.1 * 0.0015 / 1.25, rel=0.01)  # radii differ by 0.1 %


def test_quantisation_of_a_difference_of_two_readings() -> None:
    """floor(start + n) - floor(start) scatters by 1/sqrt(6) counts at most, on average over fractional n."""
    rng = np.random.default_rng(4)
    n, start = rng.uniform(1000, 2000, 200_000), rng.uniform(size=200_000)
    from calib.radius.effective import QUANTISATION_COUNTS

    # 200,000 draws know the standard deviation to 0.2 %
    assert np.std(np.floor(start + n) - n) == pytest.approx(QUANTISATION_COUNTS, rel=0.01)


def test_runs_that_cannot_be_used_are_named_with_the_reason() -> None:
    base = straight(np.full(7, 0.1), np.full(7, 0.1), np.linspace(300, 900, 7))
    numbers = {name: column.copy() for name, column in base.runs.numbers.items()}
    numbers["distance_m"][1] = np.nan
    numbers["counts_left"][2] = np.nan
    numbers["counts_right"][3] *= -1
    numbers["load_left_N"][4] = np.nan
    numbers["ref_theta_rad"] = np.array([0, 0, 0, 0, 0, 1.57, 0])
    excluded = np.array([False] * 6 + [True])
    radii = effective_radii(campaign_of(numbers, excluded=excluded))
    assert list(radii.run_id) == ["r0"]
    told = {run.run_id: run.reason for run in radii.left_out}
    assert told.keys() == {"r1", "r2", "r3", "r4", "r5", "r6"}
    for run, word in (("r1", "distance"), ("r2", "no counts_left"), ("r3", "sign"), ("r4", "load"), ("r5", "straight")):
        assert word in told[run]
    assert "excluded" in told["r6"]


def test_a_campaign_without_a_usable_run_is_refused() -> None:
    numbers = {"distance_m": np.full(3, np.nan), "counts_left": np.ones(3), "counts_right": np.ones(3)}
    with pytest.raises(RefusedError, match="distance"):
        effective_radii(campaign_of({**numbers, "load_left_N": np.ones(3), "load_right_N": np.ones(3)}))


def test_gross_encoder_scale_is_said() -> None:
    """Once, as calib check says it: a quarter is less than no wheel can be, and far more than loads make of one."""
    notes = fit_campaign(straight(np.full(3, 0.125), np.full(3, 0.1), LOAD[:3])).notes
    assert [("left" in note, "right" in note) for note in notes if "counts_per_rev" in note] == [(True, False)]


@pytest.mark.parametrize("along", [True, False])
def test_an_arc_is_held_against_the_way_that_the_rangefinder_measures(along: bool) -> None:
    """Arcs of 40 m by up to 0.1 rad, with end poses: distances along the start heading, or those of the chord."""
    turn = np.array([-0.1, -0.05, 0.05, 0.08, 0.1])
    path = 40.0
    x, y = path * np.sin(turn) / turn, path * (1.0 - np.cos(turn)) / turn
    wheels = (path - 0.35 * turn, path + 0.35 * turn)
    numbers = {
        "distance_m": x if along else np.hypot(x, y),
        **{f"counts_{side}": way / (2 * np.pi * 0.1) * COUNTS_PER_REV for side, way in zip(SIDES, wheels, strict=True)},
        **{f"load_{side}_N": LOAD for side in SIDES},
        "ref_x_m": x,
        "ref_y_m": y,
        "ref_theta_rad": turn,
    }
    radii = effective_radii(campaign_of(numbers))
    # what the heading's own noise keeps of an arc: 0.8 mrad of 50 and more
    for found in (radii.radius_left_m, radii.radius_right_m):
        np.testing.assert_allclose(found, 0.1, rtol=2e-6)
