"""The prior of sets of effects: as closed forms say."""

from __future__ import annotations

from math import comb

import numpy as np
import pytest

from calib.gap.effects.effect import Form
from calib.gap.evidence.models import Columns

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
