"""Radii are held against the lengths of the runs and the stated uncertainty of the instruments."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.campaign.model import Campaign
from calib.radius.checks import with_checks
from calib.radius.deviation import UNKNOWN, judge_runs, radius_error, weave_excess
from calib.radius.fit import fit_campaign, with_instrument_checks
from calib.radius.regression import FAILED, NOTE, OK, Check, fit_wheel
from tests.campaign.faults import steered_by_itself, without_logs
from tests.campaign.making import campaign, with_numbers
from tests.radius.campaigns import straight

N = 40
LASER_M = 0.0015
LENGTHS_M = (10.0, 20.0, 40.0)


def checks_of(
    seed: int,
    *,
    offset_m: float = 0.0,
    lengths_m: tuple[float, ...] = LENGTHS_M,
    spread_m: float = 0.5,
    load_by_length: float = 0.0,
    longer: float = 0.0,
    run_m: float = 0.0,
) -> dict[str, Check]:
    """Return the checks of forty runs in five sessions that scatter by 5e-5 and shift by 1e-4 from day to day.

    `load_by_length`: share of the load that follows the length; `longer`: largest share by which a weave, unmeasured,
    lengthens a path; `run_m`: what one run's radius is off.
    """
    rng = np.random.default_rng(seed)
    session = np.repeat([f"d{day}" for day in range(5)], N // 5)
    length = np.resize(lengths_m, N) + rng.uniform(-spread_m, spread_m, N)
    load = rng.choice([300.0, 500.0, 700.0, 900.0, 1100.0], N)
    load = (1.0 - load_by_length) * load + load_by_length * 20.0 * (40.0 / length + 15.0)
    true = (0.1 - 1.4e-6 * (load - 300.0)) * (1.0 + 5e-5 * rng.standard_normal(N))
    true = true * np.repeat(1.0 + 1e-4 * rng.standard_normal(5), N // 5)
    true[11] += run_m
    measured = length + offset_m + LASER_M * rng.standard_normal(N)
    radius = true * measured / (length * (1.0 + longer * rng.random(N)))
    fit = fit_wheel("left", load, radius, session, reference_load_N=300.0)
    fit = with_checks(fit, session, np.resize(["out", "back"], N), np.array([f"r{run:02d}" for run in range(N)]))
    fit = with_instrument_checks(fit, measured, radius * LASER_M / measured, session)
    return {check.name: check for check in fit.checks}


@pytest.mark.parametrize("offset_m", [0.08, -0.08])
def test_a_constant_error_of_the_distances_fails_and_is_stated(offset_m: float) -> None:
    """Runs of 10, 20 and 40 m give other radii where the rangefinder counts from elsewhere; the interval holds it."""
    for seed in range(4):
        checks = checks_of(seed, offset_m=offset_m)
        check = checks["run_length"]
        assert check.level == FAILED
        stated, _, rest = check.sentence.partition("constant ")[2].partition(" mm (")
        low, high = (float(end) for end in rest.partition("), and")[0].split(" to "))
        assert float(stated) == pytest.approx(1e3 * offset_m, abs=3.0)
        # of four intervals of 95 %, with a margin for the rounding of the sentence
        assert low - 1.0 <= 1e3 * offset_m <= high + 1.0
        assert "scatter" not in checks


def test_loads_that_partly_follow_the_length_leave_the_error_visible() -> None:
    """What the load explains is taken off first: no error is read from it, and a true one is still found."""
    assert all(checks_of(seed, load_by_length=0.8)["run_length"].level == OK for seed in range(6))
    assert all(checks_of(seed, load_by_length=0.8, offset_m=0.08)["run_length"].level == FAILED for seed in range(6))


def test_loads_that_follow_the_length_are_said_to_hide_it() -> None:
    """Where each load has its length nothing tells the two apart, and the check says so."""
    check = checks_of(1, load_by_length=1.0, offset_m=0.08)["run_length"]
    assert (check.level, check.p_value) == (NOTE, None)
    assert "follow loads or sessions" in check.sentence


def test_runs_of_one_length_show_nothing() -> None:
    """Lengths that differ by little more than the rangefinder's own uncertainty are no lengths to compare."""
    assert "run_length" not in checks_of(1, lengths_m=(40.0,), spread_m=0.01, offset_m=0.08)


@pytest.mark.parametrize("lengths_m", [LENGTHS_M, (40.0,), (*[40.0] * 9, 10.0)])
def test_sound_runs_seldom_alarm(lengths_m: tuple[float, ...]) -> None:
    """Two checks at 1 % each: 60 campaigns give one or two remarks, and never a failure."""
    found = [checks_of(seed, lengths_m=lengths_m) for seed in range(60)]
    levels = [checks[name].level for checks in found for name in ("run_length", "scatter") if name in checks]
    assert FAILED not in levels
    assert levels.count(NOTE) <= 5


def test_scatter_far_beyond_the_instruments_is_a_remark() -> None:
    """A weave that lengthens paths by up to 0.6 % scatters radii by 170 um beside 4 um of the rangefinder."""
    check = checks_of(2, lengths_m=(40.0,), spread_m=2.0, longer=0.006)["scatter"]
    assert (check.level, check.passed) == (NOTE, True)
    assert check.statistic == pytest.approx(0.006 / np.sqrt(12) / (LASER_M / 40.0), rel=0.25)
    assert f"{check.statistic:.0f} times what rangefinder and counters explain" in check.sentence


def test_scatter_that_another_check_explains_is_not_said_twice() -> None:
    """One run far off fails by itself, and the weave is not suspected beside it."""
    checks = checks_of(3, run_m=2e-3)
    assert checks["influence"].level == FAILED
    assert "scatter" not in checks


def test_loads_that_nobody_gave_are_not_said_to_be_one() -> None:
    """Runs under three loads whose column got lost scatter by far more than their instruments: doubtful, with why."""
    loads = np.tile([300.0, 600.0, 900.0], 8)
    radius = 0.1 - 1.4e-6 * (loads - 300.0) + np.random.default_rng(2).normal(0.0, 1e-5, len(loads))
    driven = straight(radius, radius, loads)
    unknown = {**driven.runs.numbers, **dict.fromkeys(("load_left_N", "load_right_N"), np.full(len(loads), np.nan))}
    sessions = {**driven.runs.labels, "session": np.repeat(["a", "b"], 12)}
    fit = fit_campaign(replace(driven, runs=replace(driven.runs, numbers=unknown, labels=sessions)))
    checks = {check.name: check for check in fit.left.checks}
    assert "No run's load is given" in checks["design"].sentence
    assert "load_left_N" in checks["scatter"].sentence
    assert not checks["scatter"].passed


def path_check(made: Campaign) -> Check | None:
    return next((check for check in fit_campaign(made).left.checks if check.name == "path"), None)


def test_a_vehicle_that_steered_by_its_own_counts_gets_no_law() -> None:
    """Its radii, 3e-3 apart, went into the arc of the path: none of the logs says so, and no run's path is known."""
    made = steered_by_itself(campaign())
    check = path_check(made)
    assert check is not None
    assert check.level == FAILED
    assert "only the mean of both radii is known" in check.sentence
    listed = with_numbers(made, amplitude_m=np.full(len(made.runs), 0.01), wavelength_m=np.full(len(made.runs), 8.0))
    judged = judge_runs(listed, 5e-4)
    assert (judged.verdict == UNKNOWN).all()
    assert "ref_theta_rad" in judged.summary


def test_headings_at_the_end_leave_nothing_open() -> None:
    made = steered_by_itself(campaign())
    assert path_check(with_numbers(made, ref_theta_rad=np.full(len(made.runs), 2e-3))) is None


def test_a_bow_that_all_runs_have_moves_the_radius_as_stated() -> None:
    """An arc that bows by h over S turns by 8 h / S, and the right wheel rolls b times that beyond the left."""
    made = without_logs(campaign())
    check = path_check(made)
    assert check is not None
    assert check.level == NOTE
    stated_m = 1e-6 * float(check.sentence.partition("radius by ")[2].partition(" um")[0])
    apart_m = made.vehicle.track_m * 8 * 0.01 / made.runs.number("distance_m")
    left, right = (made.runs.number(f"counts_{side}") for side in ("left", "right"))
    per_m = made.encoder.counts_per_rev_left / (2 * np.pi * 0.1)
    bowed = with_numbers(made, counts_left=left - 0.5 * apart_m * per_m, counts_right=right + 0.5 * apart_m * per_m)
    before, after = (float(fit_campaign(one).left.radius_m.mean()) for one in (made, bowed))
    assert after - before == pytest.approx(stated_m, rel=0.05)
    declared = replace(made, extra={"uncertainty": {"path": {"apart_m": {"std": float(apart_m.mean())}}}})
    assert path_check(declared) is None
    # what one wheel gains by it the other loses
    for wheel, sign in zip(fit_campaign(declared).wheels.values(), (-1.0, 1.0), strict=True):
        assert wheel.estimate.systematic[0, 0] == pytest.approx(sign * stated_m, rel=0.05)


def _weighing_check(made: Campaign) -> Check | None:
    return next((check for check in fit_campaign(made).left.checks if check.name == "weighing"), None)


def test_errors_of_loads_weighed_once_move_the_slope_as_stated() -> None:
    """By a Monte Carlo: each of three loads is off by 1 % in all of its runs; no repeat shows it."""
    rng, draws = np.random.default_rng(6), 2000
    loads = np.repeat([300.0, 700.0, 1100.0], [6, 12, 6])
    radius = 0.1 - 1.4e-6 * (loads - 300.0) + rng.normal(0.0, 3e-6, len(loads))
    made = straight(radius, radius, loads)
    check = _weighing_check(made)
    assert check is not None and check.level == NOTE
    assert "3 loads stand for 24 runs" in check.sentence
    errors = 1.0 + 0.01 * rng.standard_normal((draws, 3))
    slopes = [np.polyfit(loads * np.repeat(error, [6, 12, 6]), radius, 1)[0] for error in errors]
    # the scatter of a standard deviation over so many draws, three times, and two digits printed
    stated = 0.01 * float(check.sentence.partition("slope by ")[2].partition(" %")[0])
    assert stated == pytest.approx(float(np.std(slopes)) / 1.4e-6, rel=3.0 / np.sqrt(2.0 * draws) + 0.03)
    declared = replace(made, extra={"uncertainty": {"weighing": {"scale": {"std": 0.01}}}})
    assert _weighing_check(declared) is None
    anew = loads + rng.normal(0.0, 1.0, len(loads))
    assert _weighing_check(with_numbers(made, load_left_N=anew, load_right_N=anew)) is None


def test_a_weave_of_unknown_phase_is_within_only_where_every_phase_is() -> None:
    """Of columns neither start nor end on the weave is known: a quarter period at either end turns the vehicle."""
    phase = np.linspace(0.0, 2.0 * np.pi, 400)
    amplitude, wavelength = (grid.ravel() for grid in np.meshgrid(np.linspace(0.005, 0.06, 8), np.linspace(5, 12, 9)))
    n = len(amplitude)
    made = straight(np.full(n, 0.1), np.full(n, 0.1), np.full(n, 300.0), 38.7)
    judged = judge_runs(with_numbers(made, amplitude_m=amplitude, wavelength_m=wavelength), 5e-4)
    path = weave_excess(amplitude[:, None], wavelength[:, None], 38.7, made.vehicle.track_m, phase_rad=phase)
    worst = np.abs([radius_error(path.left), radius_error(path.right)]).max(axis=(0, 2))
    least = np.abs([radius_error(path.left), radius_error(path.right)]).max(axis=0).min(axis=1)
    # by half of the tenth that the middle of the axle may gain over parts of a period
    assert (worst[judged.verdict == "within"] < 5.3e-4).all()
    assert (worst[judged.verdict == UNKNOWN] > 4.5e-4).all()
    assert (least[judged.verdict == "beyond"] > 4.5e-4).all()
    assert min((judged.verdict == verdict).sum() for verdict in ("within", "beyond", UNKNOWN)) > 5
    assert "where on the weave they began" in judged.summary
