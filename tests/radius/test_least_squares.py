"""The plain line and the test of normality have the digits of statsmodels and scipy, whose imports they spare."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from statsmodels.regression.linear_model import OLS

from calib.radius.least_squares import fit_line
from calib.radius.shapiro_wilk import FEWEST, MOST, shapiro_wilk

#: rounding, where the same steps are taken in another order
ROUNDING = 1e-12
#: rounding of 1 - W where W is near one, which the p-value of thousands of values enlarges
ROUNDING_P = 1e-9


@pytest.mark.parametrize("n_runs", [3, 5, 60, 1000])
def test_the_plain_line_is_that_of_statsmodels(n_runs: int) -> None:
    """Coefficients, residuals, scatter and both covariances, with scatter that grows with the load."""
    rng = np.random.default_rng(n_runs)
    x = rng.uniform(0.0, 800.0, n_runs)
    y = 0.1 + 1.3e-6 * x + rng.normal(0.0, 1e-5, n_runs) * (1.0 + x / 400.0)
    line, oracle = fit_line(x, y), OLS(y, np.column_stack((np.ones(n_runs), x))).fit()
    np.testing.assert_allclose(line.coefficients, oracle.params, rtol=ROUNDING)
    np.testing.assert_allclose(line.residual, oracle.resid, atol=ROUNDING * 0.1)
    assert line.variance == pytest.approx(oracle.scale, rel=1e-9)  # squares of residuals near the rounding of y
    assert line.dof == oracle.df_resid
    np.testing.assert_allclose(line.covariance, oracle.cov_params(), rtol=1e-9)
    np.testing.assert_allclose(line.robust_covariance, oracle.cov_HC3, rtol=1e-6)  # leverages near one with three runs


@pytest.mark.parametrize("n_values", [FEWEST, 9, 11, 12, 59, 160, MOST])
@pytest.mark.parametrize("law", ["normal", "standard_cauchy", "exponential", "random"])
def test_w_and_its_p_value_are_those_of_scipy(law: str, n_values: int) -> None:
    values = 1e-5 * getattr(np.random.default_rng(n_values), law)(size=n_values)
    statistic, p_value = shapiro_wilk(values)
    oracle = stats.shapiro(values)
    assert statistic == pytest.approx(oracle.statistic, rel=ROUNDING)
    assert p_value == pytest.approx(oracle.pvalue, rel=ROUNDING_P)
