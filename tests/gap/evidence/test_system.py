"""Sums under each scale of the rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.gap.effects.temperature_radius import TemperatureRadius
from calib.gap.evidence.fit import fit
from calib.gap.evidence.system import LinearSystem
from calib.gap.plan.separability import noise_at
from calib.gap.predict.path import predict
from tests.gap.effects.making import Motion, Run, rich_runs, situation


def _system() -> LinearSystem:
    def truth(run: Run, now: Motion) -> None:
        now.left = now.right = 3e-4 * (run.numbers["temperature_C"] - 20.0)

    s = situation([replace(run, front=False) for run in rich_runs()], truth=truth)
    nominal = predict(s)
    noise = noise_at(nominal, {})
    return LinearSystem(fit(nominal, noise), nominal, noise, TemperatureRadius().forms(s)[:1])


def test_what_a_deviation_takes_all_of_has_no_negative_square() -> None:
    """Columns 1e8 floors long that conditions may deviate by: what is left is rounding, of which no root is taken."""
    system = _system()
    long = 1e8 * system.calibration[:, :3] / np.linalg.norm(system.calibration[:, :3], axis=0)
    mixed = long @ np.random.default_rng(7).standard_normal((3, 40))
    sums = system.sums(mixed, system.calibration, 1e4 * long)
    squares = np.diagonal(sums.gram, axis1=1, axis2=2)
    assert np.all(squares >= 0.0)
    assert np.all(sums.square >= 0.0)
