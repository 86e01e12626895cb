"""The Shapiro-Wilk test against scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import shapiro

from calib.radius.normality import shapiro_wilk

#: scipy takes the normal's quantiles from an approximation good to some 1e-9, which p-values stretch
STATISTIC_TOLERANCE, P_TOLERANCE = 1e-8, 1e-5


@pytest.mark.parametrize("n", [8, 11, 12, 60, 4999])
@pytest.mark.parametrize("drawn", ["normal", "heavy", "skew"])
def test_statistic_and_p_value_are_those_of_scipy(n: int, drawn: str) -> None:
    rng = np.random.default_rng(n)
    values = {"normal": rng.normal, "heavy": lambda size: rng.standard_t(3, size), "skew": rng.standard_exponential}
    sample = values[drawn](size=n)
    reference = shapiro(sample)
    statistic, p_value = shapiro_wilk(sample)
    assert statistic == pytest.approx(reference.statistic, abs=STATISTIC_TOLERANCE)
    assert p_value == pytest.approx(reference.pvalue, rel=P_TOLERANCE)


def test_values_that_are_normal_scores_are_as_normal_as_can_be() -> None:
    """W is 1 to rounding or nearly so, and the p-value is a number."""
    statistic, p_value = shapiro_wilk(np.linspace(-1.0, 1.0, 9))
    assert 0.9 < statistic < 1.0
    assert p_value > 0.5


def test_too_few_values_are_refused() -> None:
    with pytest.raises(ValueError, match="expected 8 or more"):
        shapiro_wilk(np.arange(7.0))
