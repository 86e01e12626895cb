from __future__ import annotations

import numpy as np
import pytest

from calib.campaign.model import Logs
from calib.radius.deviation import weave_excess
from calib.radius.path_length import estimate_weaves, fit_headings
from tests.radius.campaigns import COUNTS_PER_REV, woven_counts

METRES_PER_COUNT = 2 * np.pi * 0.1 / COUNTS_PER_REV
#: amplitude, wavelength, distance, phase
RUNS = [
    (0.02, 9.0, 40.0, 0.3),
    (0.05, 5.0, 37.5, 1.0),
    (0.5, 5.0, 37.5, 0.0),
    (0.5, 40.0, 40.0, 0.0),
    (0.01, 12.0, 41.0, 2.0),
    (0.3, 30.0, 40.0, 1.0),
]


def weaves_of(runs: list[tuple[float, float, float, float]], left: float = 0.1, right: float = 0.1) -> object:
    counted = [woven_counts(*run, left, right) for run in runs]
    lengths = [len(one) for one, _ in counted]
    logs = Logs(
        offsets=np.concatenate(([0], np.cumsum(lengths))).astype(np.int64),
        columns={
            "counts_left": np.concatenate([one for one, _ in counted]),
            "counts_right": np.concatenate([one for _, one in counted]),
        },
    )
    return estimate_weaves(logs, (METRES_PER_COUNT, METRES_PER_COUNT), 0.7)


@pytest.mark.parametrize(("left", "right"), [(0.1, 0.1), (0.1004, 0.0996)])
def test_amplitude_wavelength_and_path_are_reproduced_from_whole_counts(left: float, right: float) -> None:
    """Also where the wheels differ by 0.8 %: the steady trend that leaves in the heading is no weave."""
    weaves = weaves_of(RUNS, left, right)
    for row, (amplitude, wavelength, distance, phase) in enumerate(RUNS):
        truth = weave_excess(amplitude, wavelength, distance, 0.7, phase_rad=phase)
        # whole counts are 0.15 mm of path, 0.2 mrad of heading; lengths carry the 0.4 % of the assumed radii
        assert weaves.amplitude_m[row] == pytest.approx(amplitude, rel=0.01)
        assert weaves.wavelength_m[row] == pytest.approx(wavelength, rel=0.01)
        # relative path 0.5 % of itself: assumed radii and interpolation between samples
        assert weaves.excess[row] == pytest.approx(float(truth.centre), rel=0.01, abs=5e-8)
        assert weaves.yaw_rad[row] == pytest.approx(float(truth.yaw_rad), rel=0.01, abs=1e-4)


def test_a_straight_run_has_no_excess() -> None:
    weaves = weaves_of([(0.0, 10.0, 40.0, 0.0)])
    # half the mean square of 0.1 mrad, the heading that whole counts leave
    assert abs(weaves.excess[0]) < 2e-8
    assert weaves.amplitude_m[0] < 5e-4


def test_a_run_without_a_log_has_no_weave() -> None:
    weaves = estimate_weaves(Logs.empty(3), (METRES_PER_COUNT, METRES_PER_COUNT), 0.7)
    assert not weaves.known.any()


def test_standstill_and_reverse_driving_change_nothing() -> None:
    left, right = woven_counts(0.05, 8.0, 40.0, 0.5, 0.1, 0.1)
    still = [np.concatenate((np.repeat(one[0], 20), one, np.repeat(one[-1], 20))) for one in (left, right)]
    for one, other in ((still[0], still[1]), (-still[0], -still[1])):
        logs = Logs(offsets=np.array([0, len(one)]), columns={"counts_left": one, "counts_right": other})
        weaves = estimate_weaves(logs, (METRES_PER_COUNT, METRES_PER_COUNT), 0.7)
        assert weaves.amplitude_m[0] == pytest.approx(0.05, rel=0.01)  # whole counts
        assert weaves.wavelength_m[0] == pytest.approx(8.0, rel=0.01)


def test_a_random_walk_of_the_heading_gives_no_wave() -> None:
    """The excess stays that of the heading about a straight trend, half its square."""
    rng, n, points = np.random.default_rng(3), 300, 256
    u = np.linspace(0.0, 1.0, points)
    heading = np.cumsum(rng.normal(0.0, 1e-3, (n, points)), axis=1) + 0.02 * rng.normal(size=(n, 1)) * u**2
    trend = ((u - 0.5) * heading).sum(axis=1) / ((u - 0.5) ** 2).sum()
    about_trend = heading - heading.mean(axis=1, keepdims=True) - trend[:, None] * (u - 0.5)
    excess = fit_headings(np.full(n, 20.0), heading)[3]
    # an axis that a long wave turns may leave three times as much, nine times in squares, and never more
    assert np.all(excess <= 9.5 * 0.5 * np.mean(about_trend**2, axis=1) + 1e-9)
