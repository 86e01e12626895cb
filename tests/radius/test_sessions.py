"""A line from sums is the line from runs, and sums of parts are the sums of the whole."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import stdtrit

from calib.fleet.vehicle import WheelSums, line_from_sums
from calib.radius import groups_of, stratified_line
from calib.radius.regression import fit_wheel, independent_line, least_squares

#: sums of squares about a far origin lose about six of sixteen digits against sums about the mean
SUMS_TOLERANCE = 1e-8
FIELDS = ("coefficients", "cov_within", "cov_between", "dof_within", "dof_between", "run_variance", "session_variance")


def _runs(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    number = rng.integers(0, rng.integers(2, 6), rng.integers(8, 40))
    own = (200.0 * number, rng.choice([0.0, 300.0, 600.0], len(number)), rng.uniform(0.0, 800.0, len(number)))[seed % 3]
    radius = -1.2e-6 * own + 2e-5 * rng.standard_normal(len(number)) + 1e-5 * number**1.5
    return np.array([f"s{k}" for k in number]), own, radius


@pytest.mark.parametrize("seed", range(60))
def test_the_line_from_sums_is_the_line_from_runs(seed: int) -> None:
    """Coefficients, covariances and degrees of freedom, however loads and sessions are crossed."""
    session, load, radius = _runs(seed)
    expected = stratified_line(load, radius, groups_of(session)) if len(set(session)) < len(session) else None
    expected = expected or independent_line(least_squares(load, radius))
    if expected.hc3:
        pytest.skip("the scatter grows with the load: sums cannot tell")
    line = line_from_sums(WheelSums.from_runs(session, load, radius, np.zeros_like(load), radius))
    assert line is not None
    for name in FIELDS:
        values = np.asarray(getattr(expected, name))
        scale = max(float(np.abs(values).max()), 1e-20)
        np.testing.assert_allclose(getattr(line, name), values, rtol=SUMS_TOLERANCE, atol=SUMS_TOLERANCE * scale)


@pytest.mark.parametrize("seed", range(10))
def test_sums_of_parts_add_up_to_those_of_the_whole(seed: int) -> None:
    """However the runs are cut into parts, sessions that go on in another part included."""
    session, load, radius = _runs(seed)
    day = np.arange(len(load), dtype=np.float64)
    whole = WheelSums.from_runs(session, load, radius, day, radius)
    cut = len(load) // 3
    parts = [
        WheelSums.from_runs(session[k], load[k], radius[k], day[k], radius[k]) for k in (slice(cut), slice(cut, None))
    ]
    added = parts[0].added(parts[1])
    assert added.session.tolist() == whole.session.tolist()
    np.testing.assert_allclose(added.table[:, :7], whole.table[:, :7], rtol=1e-12, atol=1e-18)
    np.testing.assert_array_equal(added.loads_N, whole.loads_N)


def test_a_single_load_carries_no_line() -> None:
    """Where every run has one load there is no slope."""
    load = np.full(6, 300.0)
    sums = WheelSums.from_runs(np.array(["a", "a", "a", "b", "b", "b"]), load, load * 1e-4, load, load)
    assert line_from_sums(sums) is None


def test_sessions_that_agree_by_chance_make_no_band_narrower_than_their_runs() -> None:
    """Of sessions that do not scatter a third agree far too well; independent runs bound what the mean can be known."""
    load, session = np.tile([300.0, 500.0, 700.0, 900.0, 1100.0], 6), np.repeat(["a", "b", "c", "d", "e"], 6)
    rng, agreed = np.random.default_rng(3), 0
    for _ in range(40):
        radius = 0.1 + 1e-5 * rng.standard_normal(len(load))
        fit = fit_wheel("left", load, radius, session, reference_load_N=300.0)
        at, naive = np.array([300.0, 700.0, 1100.0]), fit.naive
        assert naive is not None
        c = fit.law.contrast(at)
        variance = np.einsum("ni,ij,nj->n", c, naive.covariance, c) * (fit.run_std_m / fit.residual_std_m) ** 2
        bound = stdtrit(24.0, 0.975) * np.sqrt(variance)
        agreed += int(fit.estimate.sessions_agree)
        assert (fit.law.half_width_m(at) > 0.99 * bound).all()
        assert fit.law.half_width_m(700.0) == pytest.approx(
            float(stdtrit(float(fit.law.dof_of(fit.law.contrast(700.0))), 0.975) * fit.law.mean_std_m(700.0)), rel=1e-6
        )
    assert agreed > 10
