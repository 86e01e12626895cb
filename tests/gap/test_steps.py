"""What a vehicle moved just before the end of a run, by its log, against motions in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from calib.gap.predict import predict
from tests.gap.effects.making import Motion, Run, situation

SPEED_MPS, BRAKING_MPS2 = 0.5, 0.4
#: a log at 10 Hz, its last step shorter, as where a run ends between two of its times
TIMES_S = np.append(np.arange(1, 31) * 0.1, 3.06)


def driven(way_m: np.ndarray, turn_rad: np.ndarray, steps_s: np.ndarray = TIMES_S) -> tuple[float, ...]:
    """Way and turn in the last 0.02, 0.05, 0.1 and 0.2 s of a run, by `calib`; given are both up to each time."""

    def truth(run: Run, now: Motion) -> None:
        now.ds_m[:], now.turn_rad[:] = np.diff(way_m, prepend=0.0), np.diff(turn_rad, prepend=0.0)
        now.t_s[:], now.dt_s[:] = steps_s, np.diff(steps_s, prepend=0.0)

    s = situation([Run([(1.0, 0.0)], steps=len(steps_s), front=False)], truth=truth)
    steps = predict(s).steps
    return tuple(float(part[0]) for delay_s in DELAYS_S for part in steps.motion_before_end(np.array([delay_s])))


DELAYS_S = (0.02, 0.05, 0.1, 0.2)


def test_a_vehicle_that_brakes_to_a_halt_lags_with_the_square_of_the_delay() -> None:
    """At a constant deceleration a the last tau seconds hold a tau^2 / 2: far less than the last step's mean says."""
    left_s = TIMES_S[-1] - TIMES_S
    still_to_go_m = np.where(
        left_s < SPEED_MPS / BRAKING_MPS2, 0.5 * BRAKING_MPS2 * left_s**2, SPEED_MPS * (left_s - 0.625)
    )
    whole_m = SPEED_MPS * (TIMES_S[-1] - 0.625)
    found = driven(whole_m - still_to_go_m, 0.0 * TIMES_S)
    # rtol: rounding alone; speeds that fall evenly are met exactly
    np.testing.assert_allclose(found[::2], [0.5 * BRAKING_MPS2 * t * t for t in DELAYS_S], rtol=1e-6)
    assert max(map(abs, found[1::2])) < 1e-12


def test_at_a_constant_speed_it_lags_by_speed_times_delay_on_a_line_and_on_the_spot() -> None:
    found = driven(SPEED_MPS * TIMES_S, 0.3 * TIMES_S)
    np.testing.assert_allclose(found[::2], [SPEED_MPS * t for t in DELAYS_S], rtol=1e-9)
    np.testing.assert_allclose(found[1::2], [0.3 * t for t in DELAYS_S], rtol=1e-9)
    on_the_spot = driven(0.0 * TIMES_S, 0.3 * TIMES_S)
    np.testing.assert_allclose(on_the_spot[1::2], [0.3 * t for t in DELAYS_S], rtol=1e-9)


@pytest.mark.parametrize("pause_s", [0.05, 0.3])
def test_a_vehicle_that_stands_at_its_end_lags_by_what_it_moved_before(pause_s: float) -> None:
    """Standing steps hold nothing; the step before them ends in a halt."""
    times_s = np.append(TIMES_S, TIMES_S[-1] + pause_s)
    way_m = SPEED_MPS * np.minimum(times_s, TIMES_S[-1])
    found = driven(way_m, 0.0 * times_s, times_s)[::2]
    for lag, delay_s in zip(found, DELAYS_S, strict=True):
        if delay_s <= pause_s:
            assert lag == pytest.approx(0.0, abs=1e-12)
        else:
            assert 0.0 < lag <= SPEED_MPS * (delay_s - pause_s) + 1e-12
