"""The plain line has the digits of statsmodels."""

from __future__ import annotations

import numpy as np
import pytest
from statsmodels.regression.linear_model import OLS

from calib.radius.least_squares import fit_line

#: rounding, where the same steps are taken in another order
ROUNDING = 1e-12


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
