"""Intervals of a fleet hold where runs that follow each other scatter alike, and stay as they were where none do."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from calib.fleet.vehicle import WheelSums, line_from_sums, widened
from calib.radius.regression import fit_wheel
from calib.types import FloatArray, StrArray

LOADS_N = (0.0, 200.0, 400.0, 600.0, 800.0)
SLOPE = -1e-9
#: standard error of a coverage of 95 % over 60 wheels: 2.8 %; three of them
WHEELS, LEAST = 60, 0.866


def _runs(design: str, rho: float, rng: np.random.Generator) -> tuple[FloatArray, FloatArray, StrArray]:
    """Return load, radius and session of 60 runs in the order driven; each session's scatter has its own start."""
    n_sessions = {"ascending in three": 3, "drawn in three": 3, "ascending in one": 1, "twelve of five": 12}[design]
    per_session = 60 // n_sessions
    load = np.tile(LOADS_N, 12)
    if design.startswith("ascending"):
        load = np.concatenate([np.sort(part) for part in np.split(load, n_sessions)])
    elif design.startswith("drawn"):
        load = rng.permutation(load)
    noise = rng.standard_normal((n_sessions, per_session))
    noise[:, 1:] *= np.sqrt(1.0 - rho**2)
    scatter = lfilter([1.0], [1.0, -rho], noise, axis=1).ravel()
    session = np.repeat(np.arange(n_sessions), per_session)
    shift = rng.standard_normal(n_sessions)[session] if n_sessions > 1 else 0.0
    return load, SLOPE * load + 1e-5 * scatter + 4e-6 * shift, session.astype(np.str_)


def _sums(load: FloatArray, radius: FloatArray, session: StrArray) -> WheelSums:
    return WheelSums.from_runs(session, load, radius, np.zeros(len(load)), radius)


@pytest.mark.parametrize(
    ("design", "rho"),
    [("ascending in three", 0.0), ("ascending in three", 0.8), ("drawn in three", 0.8), ("ascending in one", 0.8)],
)
def test_the_interval_of_the_slope_holds_the_truth(design: str, rho: float) -> None:
    """Independent or autocorrelated by 0.8, where intervals that count runs as independent hold it in 51 to 91 %."""
    rng = np.random.default_rng(1)
    held = 0
    for _ in range(WHEELS):
        sums = _sums(*_runs(design, rho, rng))
        line = line_from_sums(sums)
        assert line is not None
        estimate, _ = widened(line, sums)
        held += bool(abs(estimate.coefficients[1] - SLOPE) <= estimate.half_width(np.eye(2))[1])
    assert held / WHEELS >= LEAST


def test_the_autocorrelation_is_that_of_the_fit() -> None:
    """From sums as from the runs: within 0.1, on wheels whose loads are drawn and whose scatter is autocorrelated."""
    rng = np.random.default_rng(3)
    apart = []
    for _ in range(40):
        load, radius, session = _runs("drawn in three", 0.8, rng)
        line = line_from_sums(_sums(load, radius, session))
        assert line is not None
        _, rho = widened(line, _sums(load, radius, session))
        fitted = fit_wheel("left", load, radius, session, reference_load_N=0.0).autocorrelation
        assert fitted is not None
        apart.append(abs(rho - fitted.rho))
    assert np.median(apart) < 0.1


def test_sums_of_the_order_add() -> None:
    """Two files of different sessions: the same as all runs at once, but for the pair across the files."""
    load, radius, session = _runs("twelve of five", 0.8, np.random.default_rng(4))
    half = np.arange(len(load)) < 30
    parts = [_sums(load[side], radius[side], session[side]) for side in (half, ~half)]
    added, whole = parts[0].added(parts[1]), _sums(load, radius, session)
    np.testing.assert_allclose(added.table, whole.table, rtol=1e-12, atol=1e-30)
    assert added.whole[0] == whole.whole[0] - 1
