"""Least squares beside lack of fit, and scalar products at each of its scales."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.gap.effects.radii import TemperatureRadius
from calib.gap.inference.fit import fit
from calib.gap.inference.least_squares import LinearSystem, Weighting
from calib.gap.plan import noise_at
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
    """Without a lack of fit, beside one of each condition's own, and beside one common to all conditions.

    So are the spread along a change, and estimates without some of the runs.
    """
    system, rng = _system(), np.random.default_rng(5)
    number = kind if kind != -2 else next(k for k, one in enumerate(system.kinds) if one.common is not None)
    deviations, y = 0.3 * rng.standard_normal((len(system.gap), 2)), rng.standard_normal(len(system.gap))
    weighting = Weighting(system, number, 3.0, deviations)
    covariance = np.eye(len(y)) + weighting.common @ weighting.common.T
    for rows_b in system.blocks.slices():
        covariance[rows_b, rows_b] += deviations[rows_b] @ deviations[rows_b].T
    for stack in system.kinds[number].stacks if number >= 0 else ():
        blocks = system.blocks.alike[stack.group][0][stack.same]
        for block, part in zip(blocks, stack.part, strict=True):
            rows_b = system.blocks.slices()[block]
            covariance[rows_b, rows_b] += 9.0 * part @ part.T
    assert weighting.square(y) == pytest.approx(float(y @ np.linalg.solve(covariance, y)), rel=ROUNDING)
    used = rng.random(len(system.path.s)) < 0.7
    rows = used[system.blocks.unit]
    assert weighting.spread(y, used) == pytest.approx(
        float(np.sqrt((y * rows) @ covariance @ (y * rows))), rel=ROUNDING
    )
    columns = np.concatenate([system.calibration[:, :3], system.of(0)], axis=1)
    of_rows, gap = columns[rows], system.gap[rows]
    normal = np.eye(4) + of_rows.T @ np.linalg.solve(covariance[np.ix_(rows, rows)], of_rows)
    expected = np.linalg.solve(normal, of_rows.T @ np.linalg.solve(covariance[np.ix_(rows, rows)], gap))
    estimates, spread = weighting.solve(columns, np.ones(4), use=used)
    np.testing.assert_allclose(estimates, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())
    np.testing.assert_allclose(spread, np.linalg.inv(normal), rtol=1e-6)


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
    sums = system.sums_of(mixed, system.calibration, 1e4 * long)
    squares = np.diagonal(sums.gram, axis1=1, axis2=2)
    assert np.all(squares >= 0.0)
    assert np.all(sums.square >= 0.0)
