"""The regression against the certified values of NIST's Norris data set (linear, 36 points)."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from calib.radius.regression import fit_wheel

CERTIFIED = {
    "intercept": -0.262323073774029,
    "intercept_sd": 0.232818234301152,
    "slope": 1.00211681802045,
    "slope_sd": 0.429796848199937e-3,
    "residual_sd": 0.884796396144373,
    "r_squared": 0.999993745883712,
}
#: digits that have to agree; the certified values are printed to 15
DIGITS = 12


@pytest.fixture(scope="module")
def estimates(shared_data: Path) -> dict[str, float]:
    path = shared_data / "nist_strd" / "norris.csv"
    if not path.is_file():
        pytest.skip("the NIST data set is missing: nist_strd/norris.csv")
    with path.open(encoding="utf-8") as stream:
        rows = [(float(row["x"]), float(row["y"])) for row in csv.DictReader(stream)]
    x, y = np.array(rows).T
    fit = fit_wheel("left", x, y, np.full(len(x), "one"), reference_load_N=0.0)
    assert fit.naive is not None
    spread = np.sqrt(np.diag(fit.naive.covariance))
    return {
        "intercept": fit.law.radius_ref_m,
        "intercept_sd": spread[0],
        "slope": fit.law.slope_m_per_N,
        "slope_sd": spread[1],
        "residual_sd": fit.residual_std_m,
        "r_squared": fit.r_squared,
    }


@pytest.mark.parametrize("name", CERTIFIED)
def test_certified_value_is_reproduced_to_twelve_digits(estimates: dict[str, float], name: str) -> None:
    """The logarithm of the relative error (LRE) is the number of agreeing digits."""
    error = abs(estimates[name] - CERTIFIED[name]) / abs(CERTIFIED[name])
    digits = -np.log10(error) if error > 0 else 15.0
    assert digits >= DIGITS, f"{name}: {digits:.1f} digits agree"
