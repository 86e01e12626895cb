"""The prior of sets of effects: as closed forms say."""

from __future__ import annotations

from math import comb

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from calib.gap.effects.effect import Form
from calib.gap.evidence.models import Columns, log_evidence_parts, log_right_sign

#: rounding of a sum of seven terms
ROUNDING = 1e-12
FURTHER = 0.5


def _columns(n_effects: int) -> Columns:
    forms = [Form(f"effect_{k % n_effects}", "", (), lambda _: []) for k in range(2 * n_effects)]
    return Columns.from_forms(forms, FURTHER)


def test_every_number_of_effects_has_the_same_odds_against_one_fewer() -> None:
    """All sets of k effects together weigh further^k, however many effects are on offer."""
    for n_effects in (3, 6, 30, 300):
        by_count = np.exp(_columns(n_effects).by_count)
        together = [comb(n_effects, k) * by_count[k] for k in range(4)]
        assert together == pytest.approx([FURTHER**k for k in range(4)], rel=ROUNDING)


def test_an_effect_costs_more_in_a_larger_library_and_less_beside_others() -> None:
    """Odds of one: further / N; of a second beside it, whichever it is, 2 further / (N - 1)."""
    by_count = _columns(25).by_count
    assert np.exp(by_count[1]) == pytest.approx(FURTHER / 25, rel=ROUNDING)
    assert np.exp(by_count[2] - by_count[1]) == pytest.approx(2 * FURTHER / 24, rel=ROUNDING)


@pytest.mark.parametrize("size", [-3.0, -0.5, 0.0, 0.5, 3.0])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_size_of_one_sign_is_weighed_over_the_half_line(size: float, sign: int) -> None:
    """The evidence of a size that can only have one sign: likelihood times twice the prior, over that half alone."""
    gram, variance = 4.0, 2.0
    log_det, gain = log_evidence_parts(np.array([[gram]]), np.array([gram * size]), np.array([variance]))
    half = float(log_right_sign(np.array([[gram]]), np.array([gram * size]), np.array([variance]), np.array([sign])))
    ours = np.exp(0.5 * (float(gain) - float(log_det)) + np.log(2.0) + half)

    def integrand(x: float) -> float:
        return 2.0 * float(norm.pdf(x, scale=variance**0.5)) * np.exp(gram * (size * x - 0.5 * x**2))

    ends = (0.0, np.inf) if sign > 0 else (-np.inf, 0.0)
    assert ours == pytest.approx(quad(integrand, *ends)[0], rel=1e-6)


def test_sizes_of_either_sign_pay_nothing() -> None:
    gram, right = np.diag([4.0, 9.0]), np.array([-3.0, 2.0])
    assert log_right_sign(gram, right, np.ones(2), np.zeros(2, dtype=np.int64)) == pytest.approx(0.0, abs=0.0)
