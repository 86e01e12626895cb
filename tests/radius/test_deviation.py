from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.campaign.model import Campaign
from calib.campaign.read import looks_ahead
from calib.campaign.settings import Reference
from calib.errors import BadInputError
from calib.radius.deviation import (
    allowed_amplitude_m,
    allowed_amplitude_on_run_m,
    arc_of_ratio_rad,
    arc_row,
    judge_runs,
    radius_error,
    weave_excess,
)
from calib.radius.effective import effective_radii
from calib.radius.path_length import arc_excess, small_amplitude_excess, whole_period_excess
from tests.radius.campaigns import COUNTS_PER_REV, campaign_of

AMPLITUDES = st.floats(1e-4, 1.5)
WAVELENGTHS = st.floats(0.5, 80.0)


@given(AMPLITUDES, WAVELENGTHS, st.integers(1, 12))
def test_over_whole_periods_centre_and_wheels_agree(amplitude: float, wavelength: float, periods: int) -> None:
    path = weave_excess(amplitude, wavelength, periods * wavelength, 0.7)
    whole = whole_period_excess(amplitude, wavelength)
    for one in (path.centre, path.left, path.right):
        # rounding of a path of many periods; the excess itself may be as small as 1e-11
        np.testing.assert_allclose(one, whole, rtol=1e-9, atol=1e-13 * periods + 1e-14 / wavelength)


@given(AMPLITUDES, WAVELENGTHS)
def test_small_amplitude_form_is_an_upper_bound_and_near_for_small_slopes(amplitude: float, wavelength: float) -> None:
    exact, small = whole_period_excess(amplitude, wavelength), small_amplitude_excess(amplitude, wavelength)
    u = (2 * np.pi * amplitude / wavelength) ** 2
    assert exact <= small * (1 + 1e-9)
    # next term of the series: the forms differ by the share 3 u / 16 at most
    assert exact >= small * (1 - 3 * u / 16 - 1e-9)


@given(AMPLITUDES, WAVELENGTHS, st.floats(1.0, 60.0), st.floats(0, 6.3))
def test_wheels_keep_half_a_track_from_the_centre(
    amplitude: float, wavelength: float, distance: float, phase: float
) -> None:
    path = weave_excess(amplitude, wavelength, distance, 0.7, phase_rad=phase)
    # rounding of numbers near one
    np.testing.assert_allclose(path.right + path.left, 2 * path.centre, atol=1e-12)
    np.testing.assert_allclose((path.right - path.left) * distance, 0.7 * path.yaw_rad, atol=1e-12 * distance)


@given(st.floats(1e-7, 0.3), WAVELENGTHS)
def test_allowed_amplitude_uses_up_the_tolerance(tolerance: float, wavelength: float) -> None:
    amplitude = allowed_amplitude_m(tolerance, wavelength)
    # digits lost where 1 is subtracted from an excess of 1e-7
    np.testing.assert_allclose(-radius_error(whole_period_excess(amplitude, wavelength)), tolerance, rtol=1e-8)


@given(st.floats(1e-5, 0.01), st.floats(3.0, 30.0), st.floats(20.0, 45.0), st.floats(0, 6.3))
def test_allowed_amplitude_on_a_run_uses_up_the_tolerance_of_the_worse_wheel(
    tolerance: float, wavelength: float, distance: float, phase: float
) -> None:
    amplitude = allowed_amplitude_on_run_m(tolerance, wavelength, distance, 0.7, phase_rad=phase)
    path = weave_excess(amplitude, wavelength, distance, 0.7, phase_rad=phase)
    worse = max(abs(float(radius_error(path.left))), abs(float(radius_error(path.right))))
    assert worse == pytest.approx(tolerance, rel=1e-7)  # rounding of 1 + excess


@given(st.floats(-0.5, 0.5))
def test_error_of_a_radius_undoes_the_excess(excess: float) -> None:
    assert (1 + excess) * (1 + radius_error(excess)) == pytest.approx(1.0, rel=1e-12)  # rounding


def test_arc_is_longer_than_its_chord_by_a_24th_of_the_turn_squared() -> None:
    path = arc_excess(0.01, 40.0, 0.7)
    assert path.centre == pytest.approx(0.01**2 / 24, rel=1e-4)  # next term of the series is 7 turn^4 / 5760
    assert (path.right - path.left) * 40.0 == pytest.approx(0.7 * 0.01, rel=1e-9)
    assert arc_excess(0.0, 40.0, 0.7).centre == 0.0


def test_steady_arc_of_unequal_radii_is_the_circle_both_wheels_share() -> None:
    """Wheels that turn alike run on circles whose radii are in the ratio of the wheels' radii."""
    turn = float(arc_of_ratio_rad(40.0, 0.101 / 0.1, 0.7))
    circle = 40.0 / turn
    assert (circle + 0.35) / (circle - 0.35) == pytest.approx(1.01, rel=1e-12)  # rounding


@pytest.mark.parametrize("ratio", [1.05, 0.98, 1.0])
def test_turn_offset_and_excess_of_an_arc_are_those_of_one_chord(ratio: float) -> None:
    """The path of both wheels, integrated in small steps until it is a chord of 20 m away from its start."""
    found = arc_row(ratio, 20.0, 0.7)
    step = 1e-4  # m of the middle; the chord is met to half of it
    turn_per_m = (ratio - 1.0) / (ratio + 1.0) * 2.0 / 0.7
    heading = turn_per_m * step * (np.arange(400_000) + 0.5)
    x, y = np.cumsum(step * np.cos(heading)), np.cumsum(step * np.sin(heading))
    last = int(np.argmax(np.hypot(x, y) >= 20.0))
    path = step * (last + 1)
    assert found["turn_rad"] == pytest.approx(turn_per_m * path, abs=1e-4)
    assert found["offset_m"] == pytest.approx(y[last], abs=3e-4)
    assert found["excess_centre"] == pytest.approx(path / 20.0 - 1.0, abs=1e-5)
    sides = found["excess_right"] - found["excess_left"]
    assert sides == pytest.approx(0.7 * turn_per_m * path / 20.0, abs=1e-5)


def test_an_arc_that_never_gets_so_far_away_is_refused() -> None:
    """Wheels of ratio 1.3 on a track of 0.7 m drive a circle of 0.7 * 2.3 / 0.3 = 5.37 m across."""
    assert arc_row(1.3, 5.36, 0.7)["turn_rad"] == pytest.approx(np.pi, abs=0.15)
    with pytest.raises(BadInputError, match=r"distance: found 20 m; expected at most 5\.367 m"):
        arc_row(1.3, 20.0, 0.7)


#: true radii, and radius of the bow in m; the chord of 40 m is 0.074 % shorter than the arc
LEFT_M, RIGHT_M, BOW_M, CHORD_M = 0.1003, 0.0998, 300.0, 40.0


def bowed(bows_m: np.ndarray, *, heading: bool = True) -> Campaign:
    """Runs of constant curvature, left positive; the wheels roll the arc, half a track from its middle."""
    turn = 2.0 * np.arcsin(0.5 * CHORD_M / bows_m)
    numbers = {
        "distance_m": np.full(len(turn), CHORD_M),
        "counts_left": (bows_m - 0.35) * turn / (2 * np.pi * LEFT_M) * COUNTS_PER_REV,
        "counts_right": (bows_m + 0.35) * turn / (2 * np.pi * RIGHT_M) * COUNTS_PER_REV,
        "load_left_N": np.full(len(turn), 500.0),
        "load_right_N": np.full(len(turn), 500.0),
    }
    if heading:
        return campaign_of({**numbers, "ref_theta_rad": turn})
    straight = np.linspace(0.0, 1.0, 400)
    logs = [
        tuple(np.round(straight * numbers[f"counts_{side}"][k]) for side in ("left", "right")) for k in range(len(turn))
    ]
    return campaign_of(numbers, logs=logs)


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_a_bow_makes_uncorrected_radii_too_small_by_what_its_arc_is_longer(sense: float) -> None:
    """Arc less chord is L^3 / (24 R^2); the outer wheel rolls half a track's turn more, the inner one less."""
    campaign = replace(bowed(np.full(6, sense * BOW_M)), reference=Reference(sigma_theta_rad=1e-4))
    found, radii = judge_runs(campaign, 0.0005).columns, effective_radii(campaign)
    # the next term of the series is a 500th of this one
    np.testing.assert_allclose(found["excess_centre"], CHORD_M**2 / (24 * BOW_M**2), rtol=3e-3)
    turn = 2.0 * np.arcsin(0.5 * CHORD_M / BOW_M)
    for name, aside_m in (("error_left", -sense * 0.35), ("error_right", sense * 0.35)):
        np.testing.assert_allclose(found[name], CHORD_M / ((BOW_M + aside_m) * turn) - 1, atol=1e-6)
    np.testing.assert_allclose(radii.radius_left_m, LEFT_M, rtol=2e-6)
    np.testing.assert_allclose(radii.radius_right_m, RIGHT_M, rtol=2e-6)


def test_a_steady_bow_that_no_log_shows_is_said_with_the_size_that_uses_up_the_tolerance() -> None:
    """A bow h turns the vehicle by 8 h / L, and half a track of that is each wheel's error."""
    blind = " ".join(judge_runs(bowed(np.full(6, BOW_M), heading=False), 0.0005).notes)
    assert "A steady bow of 6 of 6 runs is not seen" in blind
    assert f"One of {1e3 * 0.0005 * CHORD_M**2 / (8 * 0.35):.3g} mm moves a radius by 0.05 %" in blind
    assert "steady bow" not in " ".join(judge_runs(bowed(np.full(6, BOW_M)), 0.0005).notes)


@pytest.mark.parametrize("ahead", [True, False])
def test_small_bows_tell_what_a_distance_lies_along(ahead: bool) -> None:
    """Chord and way ahead are 2 mm apart, less than their noise of 2.5 mm; 40 runs tell, one mistyped end or not."""
    rng, right = np.random.default_rng(7), 0
    for trial in range(100):
        x, aside = np.full(40, 40.0), np.full(40, 0.4)
        distance = (x if ahead else np.hypot(x, aside)) + rng.normal(0.0, 0.0015, 40)
        aside[-1] += 3.0 * (trial % 2)
        right += looks_ahead(distance, x + rng.normal(0.0, 0.002, 40), aside) == ahead
    # by the medians alone it would be nine in ten
    assert right >= 95
