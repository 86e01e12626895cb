"""The delay of the reference's stamps: sought over a grid, and said not to be sought where logs are too coarse."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.campaign.model import Logs
from calib.kinematics import recording_of
from calib.kinematics.drives import parameters_of
from calib.kinematics.estimate import estimate_geometry
from calib.kinematics.joint_fit import at_best_delay, delay_losses, drive_of, fit_parameters
from calib.kinematics.model import Model, window_segments
from tests.kinematics.campaigns import Truth
from tests.kinematics.test_named_blunders import in_map


def test_a_delay_is_sought_beyond_its_valley() -> None:
    """From a delay that is 0.2 s off the fit begins near the right one; from the right one it stays."""
    made = in_map(4, truth=Truth(delay_s=0.15))
    recording = recording_of(made, "rear")
    fitted = fit_parameters(made, drive_of(made, "rear", recording), recording, window_segments(recording, 40), True)
    assert at_best_delay(fitted, delay_losses(fitted)) is None
    values = fitted.solution.values - np.array([*np.zeros(len(fitted.parameters.names) - 1), 0.2])
    away = replace(fitted, solution=replace(fitted.solution, values=values))
    start = at_best_delay(away, delay_losses(away))
    assert start is not None and start.solution.values[-1] == pytest.approx(0.15, abs=0.02)


@pytest.mark.parametrize(("samples", "told"), [(600, False), (150, True)])
def test_logs_too_coarse_for_a_delay_say_so(samples: int, told: bool) -> None:
    """Samples 0.4 s apart leave the delay at 0: a note says what that does."""
    found = estimate_geometry(in_map(4, samples=samples), using="windows")
    assert any("too coarse for a delay" in note for note in found.notes) is told
    assert ("delay_s" in found.undetermined) is told


def test_a_clock_that_steps_back_in_one_run_leaves_the_others_as_they_are() -> None:
    """The path is looked up by the time of each run: a step of 40 s in one is no other run's."""
    sound = in_map(8)
    t_s = np.array(sound.logs.columns["t_s"])
    first, last = sound.logs.offsets[1:3]
    t_s[(first + last) // 2 : last] -= 40.0
    stepped = replace(sound, logs=Logs(sound.logs.offsets, {**sound.logs.columns, "t_s": t_s}))
    left = []
    for made in (sound, stepped):
        recording = recording_of(made, "rear")
        model = Model(drive_of(made, "rear", recording), recording, window_segments(recording, 40))
        values = np.array([item.nominal for item in parameters_of(model.drive, made.reference)])
        left.append(model.predict(values).residuals[model.segments.run != 1])
    # exact but for the rounding of a sum of times
    np.testing.assert_allclose(left[1], left[0], atol=1e-9)
