"""Least squares beside a rest, against the whole covariance matrix."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.gap.effects.temperature_radius import TemperatureRadius
from calib.gap.evidence.fit import fit
from calib.gap.evidence.system import LinearSystem
from calib.gap.evidence.weighting import Weighting
from calib.gap.plan.separability import noise_at
from calib.gap.predict.path import predict
from tests.gap.effects.making import rich_runs, situation

#: rounding of a solve over some hundred rows, and the 1e-11 by which the diagonal is kept positive
ROUNDING = 1e-8


def _system() -> LinearSystem:
    s = situation([replace(run, front=False) for run in rich_runs()])
    nominal = predict(s)
    noise = noise_at(nominal, {})
    return LinearSystem(fit(nominal, noise), nominal, noise, TemperatureRadius().forms(s)[:1])


@pytest.mark.parametrize("kind", [-1, 0, -2])
def test_a_square_is_that_of_the_whole_covariance(kind: int) -> None:
    """Without a rest, beside one of each condition's own, and beside one common to all conditions."""
    system, rng = _system(), np.random.default_rng(5)
    number = kind if kind != -2 else next(k for k, one in enumerate(system.kinds) if one.common is not None)
    deviations, y = 0.3 * rng.standard_normal((len(system.gap), 2)), rng.standard_normal(len(system.gap))
    weighting = Weighting.from_rest(system, number, 3.0, deviations)
    covariance = weighting.common @ weighting.common.T
    for rows_b, of_block in zip(system.blocks.slices(), weighting.covariance, strict=True):
        covariance[rows_b, rows_b] += of_block
    assert weighting.square(y) == pytest.approx(float(y @ np.linalg.solve(covariance, y)), rel=ROUNDING)
