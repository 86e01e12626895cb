"""Least squares beside lack of fit, and scalar products at each of its scales."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.gap.effects.drift import TemperatureRadius
from calib.gap.inference.fit import fit
from calib.gap.inference.least_squares import Weighting
from calib.gap.inference.linear_model import LinearSystem
from calib.gap.plan.identifiability import noise_at
from calib.gap.predict import predict
from tests.gap.effects.making import Motion, Run, rich_runs, situation

#: rounding of a solve over some hundred rows, and the 1e-11 by which the diagonal is kept positive
ROUNDING = 1e-8


def _system() -> LinearSystem:
    s = situation([replace(run, front=False) for run in rich_runs()])
    nominal = predict(s)
    noise = noise_at(nominal, {})
    return LinearSystem(fit(nominal, noise), nominal, noise, TemperatureRadius().forms(s)[:1])


@pytest.mark.parametrize("kind", [-1, 0, -2])
def test_a_square_is_that_of_the_whole_covariance(kind: int) -> None:
    """Without a lack of fit, beside one of each condition's own, and beside one common to all conditions."""
    system, rng = _system(), np.random.default_rng(5)
    number = kind if kind != -2 else next(k for k, one in enumerate(system.kinds) if one.common is not None)
    deviations, y = 0.3 * rng.standard_normal((len(system.gap), 2)), rng.standard_normal(len(system.gap))
    weighting = Weighting.from_component(system, number, 3.0, deviations)
    covariance = weighting.common @ weighting.common.T
    for rows_b, of_block in zip(system.blocks.slices(), weighting.covariance, strict=True):
        covariance[rows_b, rows_b] += of_block
    assert weighting.square(y) == pytest.approx(float(y @ np.linalg.solve(covariance, y)), rel=ROUNDING)


def _warm_system() -> LinearSystem:
    def truth(run: Run, now: Motion) -> None:
        now.left = now.right = 3e-4 * (run.numbers["temperature_C"] - 20.0)

    s = situation([replace(run, front=False) for run in rich_runs()], truth=truth)
    nominal = predict(s)
    noise = noise_at(nominal, {})
    return LinearSystem(fit(nominal, noise), nominal, noise, TemperatureRadius().forms(s)[:1])


def test_what_a_deviation_takes_all_of_has_no_negative_square() -> None:
    """Columns 1e8 noise levels long that conditions may deviate by: the residual is rounding, not negative."""
    system = _warm_system()
    long = 1e8 * system.calibration[:, :3] / np.linalg.norm(system.calibration[:, :3], axis=0)
    mixed = long @ np.random.default_rng(7).standard_normal((3, 40))
    sums = system.sums_of(mixed, system.calibration, 1e4 * long, prior_rest=0.1)
    squares = np.diagonal(sums.gram, axis1=1, axis2=2)
    assert np.all(squares >= 0.0)
    assert np.all(sums.square >= 0.0)
