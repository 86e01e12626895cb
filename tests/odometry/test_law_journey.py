"""Journeys under a fitted law: both propagations agree, the headline is what it says, the table is the law's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import t as student

from calib.errors import BadInputError
from calib.odometry.law_path import AxleLaw, law_journey, law_path
from calib.odometry.routes import Loading, find_route
from calib.odometry.simulation import LawJourneys, law_table, simulate
from calib.radius.law import LineEstimate, RadiusLaw, WheelLaw

SLOPES = {"growing": (1.4862e-5, 1.2996e-5), "shrinking": (-1.4688e-5, -1.2863e-5)}  # left, right, per newton


def law(reading: str = "growing", dof: float = 58.0, residual_m: float = 2e-5) -> RadiusLaw:
    def wheel(beta: float) -> WheelLaw:
        # 60 runs, 12 at each of five loads from 300 to 1100 N: variances of mean and slope, centred on 300 N
        sxx = 12 * sum((load - 700.0) ** 2 for load in (300.0, 500.0, 700.0, 900.0, 1100.0))
        slope, mean = residual_m**2 / sxx, residual_m**2 / 60
        covariance = np.array([[mean + 400.0**2 * slope, -400.0 * slope], [-400.0 * slope, slope]])
        return WheelLaw(300.0, 0.1, 0.1 * beta, covariance, dof, residual_m, 300.0, 1100.0, 60)

    left, right = SLOPES[reading]
    return RadiusLaw(left=wheel(left), right=wheel(right))


@pytest.mark.parametrize("reading", SLOPES)
def test_the_papers_four_ratios_follow_from_linear_laws(reading: str) -> None:
    """Eqs (18) to (21): unladen over laden where radii grow, the inverse where they shrink."""
    given = law(reading)
    ratio = {
        side: float(wheel.radius_m(300.0) / wheel.radius_m(1100.0))
        for side, wheel in (("left", given.left), ("right", given.right))
    }
    if reading == "shrinking":
        ratio = {side: 1.0 / value for side, value in ratio.items()}
    assert ratio["right"] == pytest.approx(0.98971, abs=5e-6)  # digits printed
    assert ratio["left"] == pytest.approx(0.98825, abs=5e-6)
    first = float(given.right.radius_m(200.0) / given.left.radius_m(900.0))
    second = float(given.right.radius_m(900.0) / given.left.radius_m(200.0))
    if reading == "shrinking":
        first, second = 1.0 / first, 1.0 / second
    # the ratio of the two wheels' radii at 300 N is printed nowhere; both of these numbers give it, and linear laws
    # agree with the four numbers only to 3 or 4 in 10,000
    assert 0.990766 / first == pytest.approx(1.009821 / second, abs=4e-4)


def test_the_table_holds_mean_and_prediction_bands_of_student() -> None:
    given = law()
    rows = law_table(given, np.array([200.0, 300.0, 700.0]))
    factor = student.ppf(0.975, 58)
    middle = rows[2]
    assert middle.radius_left_m == pytest.approx(0.1 * (1 + 1.4862e-5 * 400), rel=1e-14)
    assert middle.mean_left_m == pytest.approx(factor * 2e-5 / np.sqrt(60), rel=1e-9)
    assert middle.prediction_left_m == pytest.approx(factor * 2e-5 * np.sqrt(1 + 1 / 60), rel=1e-9)
    assert [row.extrapolated_left for row in rows] == [True, False, False]
    # with 60 runs the band of a single run is several times that of the mean: 4.6 on average over the loads
    loads = law_table(given, np.linspace(300.0, 1100.0, 81))
    widths = [row.prediction_left_m / row.mean_left_m for row in loads]
    assert 4.0 < float(np.mean(widths)) < 7.9


@pytest.mark.parametrize("band", ["mean", "prediction"])
@pytest.mark.parametrize("dof", [3.0, 58.0])
@pytest.mark.parametrize("loads", [(200.0, 900.0), (1100.0, 1100.0)])
def test_linear_propagation_and_monte_carlo_agree(band: str, dof: float, loads: tuple[float, float]) -> None:
    draws = 40_000
    made = law_journey(
        law(dof=dof),
        find_route("paper_route"),
        loads_N=loads,
        reference_N=(300.0, 300.0),
        track_m=0.7,
        band=band,
        draws=draws,
        rng=np.random.default_rng(11),
    )
    for part in (made.without, made.corrected):
        for name, interval in part.items():
            linear = np.diff(interval.linear)[0]
            drawn = np.diff(interval.monte_carlo)[0]
            # 2.5 % quantiles of 40,000 draws: 1.6 % of the width at 58 degrees of freedom, 3 % at 3; four of those,
            # and second-order terms of the same size where radii scatter by 1e-3 (3 degrees of freedom)
            assert drawn == pytest.approx(linear, rel=0.06 if dof > 10 else 0.12), name
            assert interval.linear[0] <= interval.value <= interval.linear[1]


def test_without_a_scatter_of_single_runs_there_is_one_band_and_a_note() -> None:
    """Radii of a geometry: nothing is drawn for a single run, and the table has no number there."""
    given = law(residual_m=0.0)
    under = LawJourneys(AxleLaw(given, 0.7), [(900.0, 300.0)], draws=500)
    part = simulate("custom", track_m=0.7, under=under, rng=np.random.default_rng(0)).law
    assert part is not None and [journey.band for journey in part.journeys] == ["mean"]
    assert np.isnan([row.prediction_left_m for row in part.table]).all()
    assert sum("scatter of single runs" in note for note in part.notes) == 1
    # the way's own covariance is that of the law, to the last bits
    alone = RadiusLaw(given.left, given.right).covariance(single_run=True)
    np.testing.assert_allclose(alone, given.covariance(), rtol=1e-15, atol=0)
    at = (300.0, 300.0)
    with pytest.raises(BadInputError, match="expected one of mean and"):
        law_journey(
            given,
            find_route("corridor"),
            loads_N=at,
            reference_N=at,
            track_m=0.7,
            band="prediction",
            draws=500,
            rng=np.random.default_rng(0),
        )


def test_the_correction_leaves_only_the_scatter() -> None:
    """With it, the expected end is the intended one; without it, the error is that of the ratio of radii."""
    given = law()
    made = law_journey(
        given,
        find_route("straight15"),
        loads_N=(900.0, 200.0),
        reference_N=(300.0, 300.0),
        track_m=0.7,
        band="prediction",
        draws=2000,
        rng=np.random.default_rng(0),
    )
    assert made.corrected["lateral_m"].value == pytest.approx(0.0, abs=1e-12)
    # first order: e_y = (E_r - 1) S^2 / 2b; E_r here is about 0.99, second order 1 %
    assert made.without["lateral_m"].value == pytest.approx((made.radius_ratio - 1) * 15.0**2 / 1.4, rel=0.03)
    assert made.ratio == pytest.approx(made.without_rms_m / made.corrected_rms_m, rel=1e-12)
    assert made.ratio_ci95[0] < made.ratio < made.ratio_ci95[1]
    # by hand: e_y = S^2 / 2b times the difference of the wheels' relative scatter, e_x = S times its mean
    relative = 2e-5 * np.sqrt(1 + 1 / 60 + np.array([200.0, -500.0]) ** 2 / (12 * 400_000.0)) / [0.1009, 0.09987]
    across = 15.0**2 / 1.4 * np.hypot(*relative)
    along = 15.0 * 0.5 * np.hypot(*relative)
    assert made.corrected_rms_m == pytest.approx(np.hypot(across, along), rel=2e-3)


def test_the_same_seed_gives_the_same_numbers_and_another_one_others() -> None:
    runs = [
        law_journey(
            law(),
            find_route("paper_route"),
            loads_N=(200.0, 900.0),
            reference_N=(300.0, 300.0),
            track_m=0.7,
            band="mean",
            draws=500,
            rng=np.random.default_rng(seed),
        ).corrected_95_m
        for seed in (1, 1, 2)
    ]
    assert runs[0] == runs[1] != runs[2]


def test_the_headline_is_about_seventeen_at_both_tracks() -> None:
    """1.1 m to 0.06 m is the paper's claim."""
    for track in (0.7, 0.8):
        found = simulate("corrected", track_m=track, rng=np.random.default_rng(0))
        assert {line.which for line in found.headlines} == {"right", "left", "both"}
        assert all(16.0 < line.ratio < 17.5 for line in found.headlines)
    assert max(line.without_m for line in found.headlines) == pytest.approx(1.1, abs=0.05)
    assert max(line.corrected_m for line in found.headlines) == pytest.approx(0.06, abs=0.005)


def test_a_law_beyond_its_loads_says_so() -> None:
    under = LawJourneys(AxleLaw(law(), 0.7), [(200.0, 900.0)], draws=200)
    found = simulate("asymmetric", track_m=0.7, under=under, rng=np.random.default_rng(0))
    assert found.law is not None
    assert any("200 N lie outside" in note for note in found.law.notes)


def test_a_small_vehicle_stands_on_its_own_loads() -> None:
    """A law of 20 to 60 N centred on 300 N: the nearest load that it holds for, and no load of the paper's vehicle."""
    own = law()
    small = RadiusLaw(*(replace(wheel, load_min_N=20.0, load_max_N=60.0) for wheel in (own.left, own.right)))
    under = LawJourneys(AxleLaw(small, 0.15), draws=200)
    part = simulate("corrected", track_m=0.15, under=under, rng=np.random.default_rng(0)).law
    assert part is not None and part.notes == ()
    assert part.path.reference_N == (60.0, 60.0)
    assert [row.load_N for row in part.table] == [20.0, 40.0, 60.0]
    pairs = {(one.load_left_N, one.load_right_N) for one in part.journeys}
    assert pairs == {(20.0, 60.0), (60.0, 20.0), (60.0, 60.0)}


def test_rows_of_a_run_and_the_path_below_them_have_one_band() -> None:
    """Four sessions, 43 degrees of freedom of runs: both are the t of the run's own parts, not that of the mean."""
    within = np.array([[9e-12, -1e-14], [-1e-14, 5e-17]])
    between = np.diag([8e-12, 0.0])
    strata = LineEstimate(np.zeros(2), 43.0, 3.0, 4e-10, 2e-11, within, between, None, hc3=False, design="crossed")
    wheel = replace(law().left, covariance=within + between, dof=3.0, residual_std_m=4.2e-10**0.5, strata=strata)
    route, at, rng = find_route("straight15"), (700.0, 700.0), np.random.default_rng(1)
    both = RadiusLaw(wheel, wheel)
    journey = law_journey(
        both, route, loads_N=at, reference_N=at, track_m=0.7, band="prediction", draws=40_000, rng=rng
    ).corrected["lateral_m"]
    loading = Loading.from_rows([(0.0, *at)])
    path = law_path(AxleLaw(both, 0.7), route, loading=loading, reference_N=at, rng=rng)
    half = 0.5 * float(np.diff(journey.linear)[0])
    assert path.corrected.half["lateral_m"] == pytest.approx(half, rel=1e-3)  # the integral over the law's own route
    # 4e-10 of the variance has 43 degrees of freedom: near the normal, far from the 3.18 of three
    k = half / float(path.corrected.std["lateral_m"][-1])
    assert k == pytest.approx(student.ppf(0.975, 60), rel=0.03)
    # 2.5 % quantiles of 40,000 draws: 1.6 % of the width, three of those
    assert 0.5 * float(np.diff(journey.monte_carlo)[0]) == pytest.approx(half, rel=0.05)


def test_unknown_studies_and_empty_ones_are_refused() -> None:
    with pytest.raises(BadInputError, match="symmetric"):
        simulate("sideways", track_m=0.7, rng=np.random.default_rng(0))
    with pytest.raises(BadInputError, match="cases or a law"):
        simulate("custom", track_m=0.7, rng=np.random.default_rng(0))


def test_radii_and_track_that_were_fitted_together_err_together() -> None:
    """Closed loops tell ratios alone: table, path and draws have the joint covariance, with one Student's t."""
    common = np.array([1.0, 0.0, 1.0, 0.0, 7.0]) * 1e-4
    apart = np.diag([1e-10, 1e-20, 1e-10, 1e-20, 1e-9])
    joint = np.outer(common, common) + apart
    wheel = replace(law().left, covariance=joint[:2, :2], dof=7.0, residual_std_m=0.0)
    given, at, route = RadiusLaw(wheel, wheel, joint), (300.0, 300.0), find_route("square_ccw")
    rng = np.random.default_rng(2)
    journey = law_journey(given, route, loads_N=at, reference_N=at, track_m=0.7, band="mean", draws=40_000, rng=rng)
    path = law_path(AxleLaw(given, 0.7), route, loading=Loading.from_rows([(0.0, *at)]), reference_N=at)
    assert journey.corrected_rms_m == pytest.approx(path.corrected.rms_m[-1], rel=1e-9)
    for name, interval in journey.corrected.items():
        half = float(student.ppf(0.975, 7.0) * path.corrected.std[name][-1])
        assert path.corrected.half[name] == pytest.approx(half, rel=1e-9)
        assert interval.linear[1] - interval.value == pytest.approx(half, rel=1e-9)
        # 2.5 % quantiles of 40,000 draws: 2 % of the width at seven degrees of freedom, three of those
        assert 0.5 * float(np.diff(interval.monte_carlo)[0]) == pytest.approx(half, rel=0.06), name
    # b theta = S_r - S_l: a common scale of radii and track turns nothing, what each has of its own does
    ways = [route.total_m - 0.7 * np.pi, route.total_m + 0.7 * np.pi, 2.0 * np.pi * 0.7]
    turned = np.linalg.norm(np.array(ways) * [1e-5 / 0.1, 1e-5 / 0.1, 10.0**-4.5 / 0.7])
    assert path.corrected.std["heading_rad"][-1] == pytest.approx(turned / 0.7, rel=1e-6)


def test_a_wheel_that_hardly_scatters_costs_what_was_fitted_together_no_degrees_of_freedom() -> None:
    """The left wheel far beyond its loads has all of the variance: its 58 count, not the right one's four."""
    own = law()
    right = replace(own.right, dof=4.0)
    joint = RadiusLaw(own.left, right).covariance()
    given, at, route = RadiusLaw(own.left, right, joint), (5000.0, 700.0), find_route("corridor")
    rng = np.random.default_rng(2)
    journey = law_journey(given, route, loads_N=at, reference_N=at, track_m=0.7, band="mean", draws=100, rng=rng)
    alone = law_journey(
        RadiusLaw(own.left, right), route, loads_N=at, reference_N=at, track_m=0.7, band="mean", draws=100, rng=rng
    )
    halves = [float(np.diff(one.corrected["lateral_m"].linear)[0]) for one in (journey, alone)]
    # wheels that err apart need no degrees of freedom in common; the right one has a 150th of the variance
    assert halves[0] == pytest.approx(halves[1], rel=0.01)


def test_one_degree_of_freedom_draws_no_wheel_below_nothing() -> None:
    """Two sessions leave Student's t with one: its tails are no lengths, and its 95 % as wide as by propagation."""
    given, route = law(dof=1.0, residual_m=2e-4), find_route("corridor")
    for seed in range(5):
        journey = law_journey(
            given,
            route,
            loads_N=(700.0, 700.0),
            reference_N=(300.0, 300.0),
            track_m=0.7,
            band="mean",
            draws=20_000,
            rng=np.random.default_rng(seed),
        )
        lateral = journey.corrected["lateral_m"]
        assert lateral.monte_carlo[1] == pytest.approx(lateral.linear[1], rel=0.2)
