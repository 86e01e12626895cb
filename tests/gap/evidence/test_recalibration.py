"""Which calibration parameter is off: each alone, none, and beside an effect counted from another zero."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calib.gap.effects.temperature_radius import TemperatureRadius
from calib.gap.evidence.climb import Settings
from calib.gap.evidence.fit import fit
from calib.gap.evidence.recalibration import NAMES, Recalibration, judge_recalibration
from calib.gap.plan.separability import noise_at
from calib.gap.predict.path import predict
from tests.gap.effects.making import Motion, Run, rich_runs, situation

SHIFTS = {"temperature_radius": ("radius_scale",)}


def judged(
    truth: Callable[[Run, Motion], None], *, temperature: bool = False, shifts: dict[str, tuple[str, ...]] | None = None
) -> Recalibration:
    """The judgement on rich runs with instruments that scatter as stated."""
    rng = np.random.default_rng(1)

    def shaken(run: Run, now: Motion) -> None:
        truth(run, now)
        now.laser_m, now.end_x_m, now.end_y_m = rng.normal(0, [0.0015, 0.002, 0.002])
        now.end_rad = rng.normal(0, 0.0008)

    # the made steering angle jumps within a step, which the front channels would show
    s = situation([replace(run, front=False) for run in rich_runs()], truth=shaken)
    nominal = predict(s)
    noise = noise_at(nominal, {})
    forms = TemperatureRadius().forms(s) if temperature else []
    return judge_recalibration(fit(nominal, noise, forms, steps=8), nominal, noise, Settings(), shifts)


def radius_scale(run: Run, now: Motion) -> None:
    now.left = now.right = 0.004


def unequal_radii(run: Run, now: Motion) -> None:
    now.left, now.right = -0.0015, 0.0015


def track_width(run: Run, now: Motion) -> None:
    now.track = 0.015


TRUE = {"radius_scale": 0.004, "unequal_radii": 0.003, "track_width": 0.015}


@pytest.mark.parametrize("truth", [radius_scale, unequal_radii, track_width], ids=NAMES)
def test_the_parameter_that_is_off_is_named_alone(truth: Callable[[Run, Motion], None]) -> None:
    made = judged(truth)
    name = truth.__name__
    assert made.subsets[0] == made.needed == (name,)
    assert made.probability(name) > 0.95
    expected = np.array([TRUE[name] if one == name else 0.0 for one in NAMES])
    # four standard uncertainties
    np.testing.assert_allclose((made.values - expected) / made.sd, 0.0, atol=4)
    np.testing.assert_allclose(made.probabilities.sum(), 1.0, rtol=1e-12)


def test_two_parameters_off_are_both_named() -> None:
    def both(run: Run, now: Motion) -> None:
        radius_scale(run, now)
        track_width(run, now)

    assert judged(both).subsets[0] == ("radius_scale", "track_width")


def test_a_sound_calibration_names_none() -> None:
    assert judged(lambda run, now: None).subsets[0] == ()


def warm(run: Run, now: Motion) -> None:
    now.left = now.right = 3e-4 * (run.numbers["temperature_C"] - 15.0)


def test_a_temperature_counted_from_another_zero_is_no_recalibration() -> None:
    """Counted from 15 degrees instead of the mean, both radii are off by a constant that belongs to the effect."""
    assert judged(warm, temperature=True, shifts=SHIFTS).subsets[0] == ()
    # the control: unless the effect says so, the constant is named
    assert judged(warm, temperature=True).subsets[0] == ("radius_scale",)


def test_a_shift_beyond_the_effect_is_a_recalibration_all_the_same() -> None:
    """A zero point explains no more than the effect's own size."""

    def more(run: Run, now: Motion) -> None:
        warm(run, now)
        now.left = now.right = now.left + 0.015

    assert judged(more, temperature=True, shifts=SHIFTS).subsets[0] == ("radius_scale",)
