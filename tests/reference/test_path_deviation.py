"""Fig. 9 as recomputed from the paper's equations: relative excess of a weave over 40 m, to the printed digits."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from calib.radius.deviation import radius_error, weave_excess
from calib.radius.path_length import small_amplitude_excess, whole_period_excess

#: amplitude m: excess in % at a wavelength of 40 m (exact, small amplitude) and of 5 m (the same, error of r_e)
TABLE = {
    0.05: (0.001542, 0.001542, 0.098623, 0.098696, -0.0985),
    0.10: (0.006168, 0.006169, 0.393623, 0.394784, -0.3921),
    0.20: (0.024669, 0.024674, 1.560910, 1.579137, -1.5369),
    0.30: (0.055493, 0.055517, 3.463583, 3.553058, -3.3476),
    0.50: (0.154035, 0.154213, 9.238355, 9.869604, -8.4571),
    0.70: (0.301575, 0.302257, 17.182629, 19.344425, -14.6631),
    1.00: (0.614025, 0.616850, 32.065823, 39.478418, -24.2802),
}
#: half a unit of the last printed digit, in %
SIX_DIGITS = 0.5e-6
FOUR_DIGITS = 0.5e-4
FIVE_DIGITS_M = 0.5e-5


@pytest.mark.parametrize("amplitude", TABLE)
def test_table_of_whole_periods(amplitude: float) -> None:
    long, long_small, short, short_small, error = TABLE[amplitude]
    assert 100 * whole_period_excess(amplitude, 40.0) == pytest.approx(long, abs=SIX_DIGITS)
    assert 100 * small_amplitude_excess(amplitude, 40.0) == pytest.approx(long_small, abs=SIX_DIGITS)
    assert 100 * whole_period_excess(amplitude, 5.0) == pytest.approx(short, abs=SIX_DIGITS)
    assert 100 * small_amplitude_excess(amplitude, 5.0) == pytest.approx(short_small, abs=SIX_DIGITS)
    assert 100 * radius_error(whole_period_excess(amplitude, 5.0)) == pytest.approx(error, abs=FOUR_DIGITS)


def test_half_a_period_of_forty_metres() -> None:
    path = weave_excess(0.5, 40.0, 20.0, 0.7)
    assert 100 * path.centre == pytest.approx(0.1540, abs=FOUR_DIGITS)
    assert 100 * path.right == pytest.approx(-0.1203, abs=FOUR_DIGITS)
    assert 100 * path.left == pytest.approx(0.4284, abs=FOUR_DIGITS)
    assert (path.right - path.left) * 20.0 == pytest.approx(-0.10973, abs=FIVE_DIGITS_M)


def test_seven_and_a_half_periods_of_five_metres() -> None:
    path = weave_excess(0.5, 5.0, 37.5, 0.7)
    assert (path.right - path.left) * 37.5 == pytest.approx(-0.78537, abs=FIVE_DIGITS_M)


@pytest.mark.parametrize(
    ("amplitude", "wavelength", "distance", "phase"),
    [(0.5, 5.0, 37.5, 0.0), (0.1, 40.0, 13.0, 1.1), (1.0, 3.0, 40.0, 2.0)],
)
def test_partial_periods_agree_with_quadrature(
    amplitude: float, wavelength: float, distance: float, phase: float
) -> None:
    """Arc length by adaptive quadrature shares nothing with the elliptic integrals."""
    k = 2 * np.pi / wavelength
    length, _ = quad(
        lambda x: np.hypot(1.0, amplitude * k * np.cos(k * x + phase)), 0.0, distance, limit=500, epsabs=1e-12
    )
    path = weave_excess(amplitude, wavelength, distance, 0.7, phase_rad=phase)
    # the quadrature's own error estimate is some 1e-11 m
    assert path.centre == pytest.approx(length / distance - 1, abs=1e-11)
