"""How well a size is known: by the fit where the form is exact, worse where it may deviate."""

from __future__ import annotations

import numpy as np

from calib.gap.effects.temperature_radius import TemperatureRadius
from calib.gap.evidence.fit import fit
from calib.gap.evidence.sizes import size_spreads
from calib.gap.evidence.whitened import WhitenedSystem
from calib.gap.plan.separability import noise_at
from calib.gap.predict.path import predict
from tests.gap.effects.making import Motion, Run, rich_runs, situation

ALPHA = 3e-4


def spreads(tolerance: float) -> tuple[float, float]:
    """Standard uncertainty of a temperature coefficient: of the sizes, and of the fit, in 1/K."""

    def warm(run: Run, now: Motion) -> None:
        now.left = now.right = ALPHA * (run.numbers["temperature_C"] - 20.0)

    s = situation(rich_runs(), truth=warm)
    nominal = predict(s)
    noise = noise_at(nominal, {})
    fitted = fit(nominal, noise, TemperatureRadius().forms(s))
    made = size_spreads(WhitenedSystem(fitted.path, nominal, noise), fitted, tolerance)
    return float(made[0][0]), float(np.sqrt(fitted.covariance[4, 4]))


def test_an_exact_form_is_known_as_well_as_the_fit_says() -> None:
    """Projecting the calibration out and inverting the whole normal matrix are two ways to one number."""
    ours, of_the_fit = spreads(0.0)
    # the fit's matrix is that of its last step, a hundredth of an uncertainty away
    np.testing.assert_allclose(ours, of_the_fit, rtol=1e-2)


def test_a_form_that_may_deviate_is_known_no_better_than_its_conditions_average_out() -> None:
    loose = np.array([spreads(tolerance)[0] for tolerance in (0.0, 0.05, 0.15)])
    assert (np.diff(loose) > 0.0).all()
    # were every condition off by its own 15 %, all of equal weight, the mean would be off by less than that
    assert loose[-1] < 0.15 * ALPHA + loose[0]
