"""The marginal likelihood against dense multivariate normals, and the prior of sets and signs."""

from __future__ import annotations

from math import comb

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.stats import multivariate_normal, multivariate_t, norm

from calib.gap.effects import Form, Parameter
from calib.gap.inference.fit import whitened_rows
from calib.gap.inference.marginal_likelihood import (
    FLOOR_DOF,
    Nuisance,
    log_evidence_parts,
    log_marginal,
    log_sign_probability,
    log_weights,
    model_sizes,
    project,
)
from calib.gap.inference.scalar_products import SCALE_CHOICE_COST, FormPriors, Layout, Sums, WideSums
from calib.gap.plan import noise_at
from calib.gap.predict import predict
from tests.gap.effects.making import rich_runs, situation

# dense algebra on some forty rows keeps eight digits of logarithms of order 100
RTOL = 1e-8


def density(y: np.ndarray, columns: np.ndarray) -> float:
    """Log N(y | 0, I + X X^T), by scipy."""
    return float(multivariate_normal.logpdf(y, cov=np.eye(len(y)) + columns @ columns.T))


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), n=st.integers(2, 40), k=st.integers(0, 6), size=st.sampled_from([1e-3, 1.0, 30.0]))
def test_a_nuisance_is_the_dense_normal_of_its_columns(seed: int, n: int, k: int, size: float) -> None:
    """Square and determinant of I + X X^T give the density that scipy gives of the dense covariance."""
    rng = np.random.default_rng(seed)
    x, y = rng.normal(0, size, (n, k)), rng.normal(0, 1, (n, 2))
    made = Nuisance(x)
    inverse = np.linalg.inv(np.eye(n) + x @ x.T)
    # the broadest columns cancel a factor of a thousand in the scalar product
    np.testing.assert_allclose(made.scalar(y, y), y.T @ inverse @ y, rtol=1e-6, atol=1e-8)
    value = -0.5 * (made.scalar(y[:, :1], y[:, :1])[0, 0] + made.log_det + n * np.log(2 * np.pi))
    assert value == pytest.approx(density(y[:, 0], x), rel=1e-6)


def test_a_floor_known_up_to_a_factor_gives_the_odds_of_students_t() -> None:
    """Integrating the factor out of the normal density is Student's t of the same shape."""
    rng = np.random.default_rng(11)
    y = rng.normal(0, 1.7, 30)
    made, expected = [], []
    for columns in (rng.normal(0, 1, (30, 2)), np.zeros((30, 1))):
        nuisance = Nuisance(columns)
        made.append(log_marginal(nuisance.scalar(y[:, None], y[:, None])[0, 0], nuisance.log_det, len(y)))
        expected.append(multivariate_t.logpdf(y, shape=np.eye(30) + columns @ columns.T, df=FLOOR_DOF))
    assert made[0] - made[1] == pytest.approx(expected[0] - expected[1], rel=RTOL)


def test_a_floor_too_small_gives_no_odds() -> None:
    """Noise three times as large favours columns that it does not follow far less than a known level would."""
    rng = np.random.default_rng(12)
    y, columns = 3.0 * rng.normal(0, 1, 300), 0.3 * rng.normal(0, 1, (300, 40))
    nuisance = Nuisance(columns)
    square = nuisance.scalar(y[:, None], y[:, None])[0, 0]
    known = -0.5 * (square + nuisance.log_det) + 0.5 * y @ y
    assert known > 0.0 > log_marginal(square, nuisance.log_det, 300) - log_marginal(y @ y, 0.0, 300)


def test_columns_exactly_alike_and_of_very_different_size_stay_factorable() -> None:
    """Twice the same column is one of twice the variance; sizes twelve orders apart do not matter."""
    rng = np.random.default_rng(7)
    x, y = rng.normal(0, 1, (30, 1)), rng.normal(0, 1, (30, 1))
    twice = Nuisance(np.concatenate([1e3 * x, 1e3 * x, 1e-9 * rng.normal(0, 1, (30, 1))], axis=1))
    once = Nuisance(np.sqrt(2) * 1e3 * x)
    # the unit diagonal is lifted by 1e-11; columns of 6e7 times the noise's variance make 3e-4 of it in the logarithm
    np.testing.assert_allclose(twice.scalar(y, y), once.scalar(y, y), rtol=1e-3)
    assert twice.log_det == pytest.approx(once.log_det, abs=1e-3)


def test_a_broad_nuisance_leaves_what_least_squares_leave() -> None:
    """`project` on broad columns is the residual of ordinary least squares, and its products are `scalar`'s."""
    rng = np.random.default_rng(8)
    x, a = rng.normal(0, 1, (30, 3)), rng.normal(0, 1, (30, 2))
    broad = Nuisance(1e3 * x)
    left = project(broad, a)
    residual = a - x @ np.linalg.lstsq(x, a, rcond=None)[0]
    # columns a thousand times the noise take all but a millionth
    np.testing.assert_allclose(left, residual, atol=1e-5)
    np.testing.assert_allclose(left.T @ left, broad.scalar(a, a), rtol=1e-5, atol=1e-5)


def test_rows_hold_the_usable_channels_whitened() -> None:
    """The sum of squares of a unit's rows is g^T C^-1 g over the channels that it has."""
    s = situation(rich_runs())
    path = predict(s)
    noise = noise_at(path, {})
    rng = np.random.default_rng(9)
    gap = rng.normal(0, 1, (len(s), 6, 1)) * noise.floor[:, :, None]
    made = whitened_rows(path, noise, gap)
    assert made.shape == (int(s.usable.sum()), 1)
    expected = 0.0
    for unit in range(len(s)):
        on = s.usable[unit]
        g = gap[unit, on, 0]
        expected += g @ np.linalg.inv(noise.covariance[unit][np.ix_(on, on)]) @ g
    # the inverse of covariances whose correlations come near to one
    assert float((made**2).sum()) == pytest.approx(expected, rel=1e-5)


def test_form_columns_are_derivatives_in_typical_sizes() -> None:
    """Re-simulating with a thousandth of a typical size steps the readings by a thousandth of the column."""
    from calib.gap.effects.load import LoadRadius
    from calib.gap.inference.fit import hypothesis_path, signature_columns
    from calib.gap.predict import residuals

    s = situation(rich_runs())
    nominal = predict(s)
    form = LoadRadius().forms(s)[0]
    made = signature_columns(nominal, [form])[0]
    before = residuals(nominal, nominal)
    for k, parameter in enumerate(form.parameters):
        theta = np.zeros(len(form.parameters))
        theta[k] = 1e-3 * parameter.typical
        moved = before - residuals(hypothesis_path(s, np.zeros(4), [form], [theta], nominal), nominal)
        scale = np.abs(made[:, :, k]).max()
        # the second order of a thousandth of a typical size
        np.testing.assert_allclose(moved * 1e3, np.where(s.usable, made[:, :, k], 0.0), atol=2e-3 * scale)


#: rounding of a sum of seven terms
ROUNDING = 1e-12
FURTHER = 0.5


def _columns(n_effects: int) -> FormPriors:
    forms = [Form(f"effect_{k % n_effects}", "", (), lambda _: []) for k in range(2 * n_effects)]
    return FormPriors.from_forms(forms)


def test_every_number_of_effects_has_the_same_odds_against_one_fewer() -> None:
    """All sets of k effects together weigh further^k, however many effects are on offer."""
    for n_effects in (3, 6, 30, 300):
        by_count = np.exp(_columns(n_effects).by_count)
        together = [comb(n_effects, k) * by_count[k] for k in range(4)]
        assert together == pytest.approx([FURTHER**k for k in range(4)], rel=ROUNDING)


def test_an_effect_costs_more_in_a_larger_library_and_less_beside_others() -> None:
    """Odds of one: further / N; of a second beside it, each it is, 2 further / (N - 1)."""
    by_count = _columns(25).by_count
    assert np.exp(by_count[1]) == pytest.approx(FURTHER / 25, rel=ROUNDING)
    assert np.exp(by_count[2] - by_count[1]) == pytest.approx(2 * FURTHER / 24, rel=ROUNDING)


@pytest.mark.parametrize("size", [-3.0, -0.5, 0.0, 0.5, 3.0])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_size_of_one_sign_is_weighed_over_the_half_line(size: float, sign: int) -> None:
    """The evidence of a size that can only have one sign: likelihood times twice the prior, over that half alone."""
    gram, variance = 4.0, 2.0
    log_det, gain = log_evidence_parts(np.array([[gram]]), np.array([gram * size]), np.array([variance]))
    half = float(
        log_sign_probability(np.array([[gram]]), np.array([gram * size]), np.array([variance]), np.array([sign]))
    )
    ours = np.exp(0.5 * (float(gain) - float(log_det)) + np.log(2.0) + half)

    def integrand(x: float) -> float:
        return 2.0 * float(norm.pdf(x, scale=variance**0.5)) * np.exp(gram * (size * x - 0.5 * x**2))

    ends = (0.0, np.inf) if sign > 0 else (-np.inf, 0.0)
    assert ours == pytest.approx(quad(integrand, *ends)[0], rel=1e-6)


def test_sizes_of_either_sign_pay_nothing() -> None:
    gram, right = np.diag([4.0, 9.0]), np.array([-3.0, 2.0])
    assert log_sign_probability(gram, right, np.ones(2), np.zeros(2, dtype=np.int64)) == pytest.approx(0.0, abs=0.0)


def test_a_hypothesis_of_many_columns_is_weighed_as_one_of_few() -> None:
    """In the axes of the wide form, or in one matrix: with signs, two columns exactly alike, and several forms.

    What is not weighed is far below the best.
    """
    rng = np.random.default_rng(4)
    counts = np.array([1, 100, 3])
    apart, together = Layout(counts, 1), Layout(counts, -1)
    rows = rng.normal(0, 1, (4, 300, 104))
    # in the order in which they stand where the wide one is last
    rows[:, :, 11] = rows[:, :, 12]
    gap = 0.3 * rows[:, :, 4:94].sum(axis=2) + rng.normal(0, 1, (4, 300)) + 3.0 * rows[:, :, 0]
    # a scale far off, beside which nothing is left to explain, and the covariance is as large as that takes
    gap[3] *= 1e-2
    gram, right = rows.transpose(0, 2, 1) @ rows, np.einsum("srk,sr->sk", rows, gap)
    others = (
        np.einsum("sr,sr->s", gap, gap),
        np.array([0.0, 3.0, 5.0, 6e3]),
        np.array([0.0, -1.0, -1.0, -1.0]),
        np.array([-1, 0, 0, 0]),
        np.array([0.0, 1.0, 3.0, 10.0]),
        300,
    )
    sign = np.zeros(104, dtype=np.int64)
    sign[[0, 2]] = 1, -1
    back = np.argsort(np.concatenate([apart.of_form(k) for k in range(3)]))
    asked: list[int] = []

    def wide(scale: int) -> tuple[np.ndarray, np.ndarray]:
        asked.append(scale)
        return gram[scale, 4:, 4:], np.concatenate([gram[scale, 4:, :4], right[scale, 4:, None]], axis=1)

    of_wide = WideSums(wide, np.arange(4))
    in_axes = Sums(gram[:, :4, :4], right[:, :4], *others, wide=of_wide)
    order = np.argsort(back)
    in_one = Sums(gram[:, order[:, None], order], right[:, order], *others)
    most, odds, by_count = np.full(104, 5.0), np.array([-1.0, -2.0, -3.0]), -np.arange(4.0)
    models = [(1,), (0,), (0, 1), (2, 1, 0), (2, 1), (2,)]
    made = log_weights(in_axes, FormPriors((), apart, most, sign, np.ones(104), odds, by_count, np.zeros(3)), models)
    wanted = log_weights(
        in_one, FormPriors((), together, most, sign[order], np.ones(104), odds, by_count, np.zeros(3)), models
    )
    weighed = np.isfinite(made)
    np.testing.assert_allclose(made[weighed], wanted[weighed], rtol=RTOL)
    assert weighed[:3].all()
    assert not weighed[3, [0, 2, 3, 4]].any()
    assert wanted[3, [0, 2, 3, 4]].max() < wanted.max() - 60.0
    assert np.ptp(made[:3], axis=0).min() > 1.0
    # what was worked out is kept
    assert sorted(asked) == [0, 1, 2, 3]


def test_sizes_of_a_wide_form_stand_in_the_order_of_the_model() -> None:
    """Beside a narrow form, and averaged over the scales."""
    rng = np.random.default_rng(9)
    rows, gap = rng.normal(0, 1, (2, 200, 32)), rng.normal(0, 1, (2, 200))
    gram, right = rows.transpose(0, 2, 1) @ rows, np.einsum("srk,sr->sk", rows, gap)
    zero = np.zeros(2)
    of_wide = WideSums(lambda n: (gram[n, 2:, 2:], np.c_[gram[n, 2:, :2], right[n, 2:]]), np.arange(2))
    sums = Sums(gram[:, :2, :2], right[:, :2], zero, zero, zero, zero.astype(int), zero, 200, of_wide)
    layout = Layout(np.array([30, 2]), 0)
    alike = np.full(32, 5.0), np.zeros(32, dtype=int), np.ones(32)
    priors = FormPriors((), layout, *alike, np.zeros(2), np.zeros(3), np.zeros(2))
    wanted = sum(share * np.linalg.solve(gram[n] + 1e-2 * np.eye(32), right[n]) for n, share in enumerate((0.25, 0.75)))
    for model, places in (((0, 1), [*range(2, 32), 0, 1]), ((1, 0), range(32))):
        made = model_sizes(sums, priors, model, np.array([0.25, 0.75]))
        np.testing.assert_allclose(made, np.asarray(wanted)[list(places)], rtol=1e-6)


def test_straight_and_curved_law_of_the_load_are_one_cause() -> None:
    """Both together are as likely before any data as one of them, but for the choice of the second's form."""
    names = ("load_radius", "load_radius_nonlinear", "speed_radius")
    parameter = Parameter("size", "1", typical=1.0, largest=3.0)
    forms = [Form(name, "", (parameter,), lambda _: [], tries=1) for name in names]
    priors = FormPriors.from_forms(forms)
    one, both, other, all_three = priors.priors([(0,), (0, 1), (0, 2), (0, 1, 2)])
    np.testing.assert_allclose([both, all_three], [one - SCALE_CHOICE_COST, other - SCALE_CHOICE_COST])
    assert both > other
