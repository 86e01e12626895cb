"""Whatever the plan of a campaign, the fit ends in a result that JSON can hold or in one helpful line."""

from __future__ import annotations

import json

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.errors import CalibError
from calib.radius.fit import fit_campaign
from calib.radius.fitted import Fit
from tests.radius.making import COUNTS_PER_REV, campaign_of


@settings(max_examples=150, deadline=None)
@given(
    st.integers(1, 14),
    st.integers(1, 14),
    st.integers(1, 6),
    st.sampled_from([0.0, 1e-12, 1e-5, 1e-3, 0.5]),
    st.booleans(),
    st.integers(0, 2**32 - 1),
)
def test_any_plan_gives_a_fit_or_one_line(
    n: int, n_sessions: int, n_loads: int, scatter: float, whole: bool, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    load = rng.choice(np.linspace(0.0, 1100.0, n_loads), n)
    distance = rng.uniform(0.5, 42.0, n)
    counts = {side: distance / (0.2 * np.pi) * COUNTS_PER_REV * (1 + scatter * rng.normal(size=n)) for side in "lr"}
    numbers = {
        "distance_m": np.where(rng.uniform(size=n) < 0.05, np.nan, distance),
        "counts_left": np.floor(counts["l"]) if whole else counts["l"],
        "counts_right": np.floor(counts["r"]) if whole else counts["r"],
        "load_left_N": load,
        "load_right_N": np.where(rng.uniform(size=n) < 0.05, np.nan, load[::-1]),
        "ref_theta_rad": np.where(rng.uniform(size=n) < 0.5, np.nan, 1e-2 * rng.normal(size=n)),
        "amplitude_m": np.where(rng.uniform(size=n) < 0.5, np.nan, 0.1),
        "wavelength_m": rng.choice([0.0, 5.0, np.nan], n),
        "static_radius_left_m": rng.choice([0.1, np.nan], n),
    }
    labels = {
        "session": np.array([f"s{one}" for one in rng.integers(n_sessions, size=n)]),
        "direction": rng.choice(["out", "back", ""], n),
    }
    try:
        fit = fit_campaign(campaign_of(numbers, labels=labels))
    except CalibError as error:
        assert "\n" not in str(error)
        return
    document = json.loads(json.dumps(fit.to_dict(), allow_nan=False))
    assert Fit.from_dict(document).to_dict() == fit.to_dict()
    for wheel in fit.wheels.values():
        low, high = wheel.radius_ref_ci95_m
        assert low <= wheel.law.radius_ref_m <= high
        assert np.all(np.linalg.eigvalsh(wheel.law.covariance) >= -1e-12 * np.trace(wheel.law.covariance))
