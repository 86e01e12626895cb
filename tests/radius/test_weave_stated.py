"""Amplitudes stated are held against the radii that they correct."""

from __future__ import annotations

import re

import numpy as np
import pytest

from calib.campaign.model import Campaign
from calib.radius.fit import fit_campaign
from calib.radius.regression import FAILED, NOTE, OK, Check
from tests.radius.campaigns import campaign_of

N = 30


def woven(
    stated: float = 1.0, *, read: float = 0.0, seed: int = 1, alike: bool = False, amplitude_m: float = 0.04
) -> Campaign:
    """Runs along whole periods of weaves; `stated`: of the true amplitudes, each read with a relative error `read`."""
    rng = np.random.default_rng(seed)
    amplitude, wavelength = amplitude_m * (np.ones(N) if alike else rng.uniform(0.5, 1.5, N)), np.full(N, 5.0)
    distance, load = 5.0 * rng.integers(5, 9, N), rng.choice([300.0, 500.0, 700.0, 900.0], N)
    longer = 1.0 + (np.pi * amplitude / wavelength) ** 2
    numbers = {"distance_m": distance + 0.0015 * rng.standard_normal(N), "wavelength_m": wavelength}
    numbers["amplitude_m"] = stated * amplitude * (1.0 + read * rng.standard_normal(N))
    turn = 0.35 * 0.02 * rng.standard_normal(N)
    for side, sense in (("left", -1.0), ("right", 1.0)):
        radius = (0.1 - 1.2e-6 * (load - 300.0)) * (1.0 + 1.2e-4 * rng.standard_normal(N))
        numbers |= {f"counts_{side}": np.floor((distance * longer + sense * turn) / (2 * np.pi * radius) * 4096)}
        numbers |= {f"load_{side}_N": load}
    return campaign_of(numbers, labels={"session": np.resize(["d1", "d2", "d3"], N)})


def found(made: Campaign) -> Check | None:
    fit = fit_campaign(made)
    checks = [check for wheel in fit.wheels.values() for check in wheel.checks if check.name == "weave"]
    assert checks[:1] == checks[1:]
    return checks[0] if checks else None


@pytest.mark.parametrize("stated", [2.0, 0.5])
def test_an_amplitude_from_peak_to_peak_or_halved_fails_with_its_factor(stated: float) -> None:
    for seed in range(5):
        check = found(woven(stated, seed=seed))
        assert check is not None
        assert check.level == FAILED
        times = re.search(r"amplitude were (\S+) times", check.sentence)
        assert times is not None
        assert float(times[1]) * stated == pytest.approx(1.0, rel=0.15)
        assert "half of peak to peak" in check.sentence


def test_amplitudes_as_they_are_alarm_as_often_as_stated() -> None:
    """One in a hundred is a remark: of 40 three once in 130; errors of a tenth of each amplitude forbid no law."""
    levels = [check.level for seed in range(40) if (check := found(woven(seed=seed)))]
    assert len(levels) == 40
    assert levels.count(NOTE) <= 2
    assert set(levels) <= {OK, NOTE}
    rough = [found(woven(read=0.1, seed=seed)) for seed in range(20)]
    assert not any(check is not None and check.level == FAILED for check in rough)


def test_a_weave_that_all_runs_have_alike_shows_nothing() -> None:
    assert found(woven(alike=True)) is None
    assert found(woven(amplitude_m=0.0)) is None
