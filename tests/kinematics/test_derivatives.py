"""Derivatives of what each drive predicts agree with finite differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.kinematics import Recording
from calib.kinematics.drives import Differential, Drive, FrontWheel, Mecanum, RearShaft, Steps, integrate_motion
from calib.kinematics.model import Model, Segments, window_segments

#: relative step of the finite differences, and how well they can agree with the derivative
STEP, AGREE = 1e-6, 2e-6

DRIVES = {
    "differential": (Differential(0.05, 0.051, 0.4), 2),
    "loaded": (Differential(0.05, 0.051, 0.4, slopes=True, slope_left_m_per_N=1e-6, slope_right_m_per_N=-2e-6), 2),
    "front": (FrontWheel(0.1, 1.1), 1),
    "mecanum": (Mecanum(0.07, 0.37), 4),
    "shaft": (RearShaft(0.1, 1.1, slips=True), 1),
}


def recording(n_wheels: int) -> Recording:
    rng = np.random.default_rng(1)
    n = 300
    turned = rng.uniform(0.02, 0.3, (n_wheels, n))
    offsets = np.array([0, 170, n])
    turned[:, offsets[:-1]] = 0.0
    steps = Steps(turned, rng.uniform(-0.8, 0.8, n), rng.uniform(-200, 400, (2, n)), rng.uniform(0.0, 2.0, n))
    reference = np.cumsum(rng.normal(size=(3, n)) * 0.1, axis=1)
    labels = np.array(["a", "b"])
    t_s = np.concatenate([np.arange(170), np.arange(130)]) * 0.05
    return Recording(labels, labels, labels, offsets, t_s, steps, reference, np.full((2, 3), np.nan), np.zeros(2, bool))


@pytest.mark.parametrize("name", list(DRIVES))
def test_the_jacobian_is_the_derivative(name: str) -> None:
    drive, n_wheels = DRIVES[name]
    record = recording(n_wheels)
    segments = window_segments(record, 4)
    # a gyro measures the turn of every third
    segments = replace(segments, gyro=np.arange(len(segments)) % 3 == 0)
    # every other has a chord for its direction
    half = 3 * (np.arange(len(segments)) % 2)
    inside = segments.select(segments.first > record.offsets[segments.run] + 3)
    half = half[: len(inside)]
    chords = inside.first[:, None] + np.stack([-half, half], axis=1)
    model = Model(drive, record, replace(inside, around=chords))
    # away from zero, where a step of a millionth is lost in rounding
    values = np.array([*(item.nominal or 0.02 for item in drive.parameters), 1.02, 0.1, -0.05, 0.3, 0.07])
    here = model.predict(values)
    # a delay's is the speed over some samples
    for at in range(len(values) - 1):
        step = np.zeros(len(values))
        step[at] = STEP * max(abs(values[at]), 1e-3)
        ahead, behind = (model.predict(values + sign * step).residuals for sign in (1, -1))
        numeric = -(ahead - behind) / (2 * step[at])
        size = np.abs(numeric).max()
        np.testing.assert_allclose(here.jacobian[:, :, at], numeric, atol=AGREE * size + 1e-9)


@pytest.mark.parametrize("name", list(DRIVES))
def test_a_steady_twist_draws_its_arc(name: str) -> None:
    """Equal steps close the circle that their twist draws, for any size of a step."""
    drive, n_wheels = DRIVES[name]
    values = np.array([item.nominal for item in drive.parameters])
    turned = np.tile(np.linspace(0.05, 0.2, n_wheels)[:, None], (1, 50))
    steps = Steps(turned, np.full(50, 0.4), np.zeros((2, 50)), np.full(50, 0.5))
    fine = Steps(np.repeat(turned, 10, axis=1) / 10, np.full(500, 0.4), np.zeros((2, 500)), np.full(500, 0.5))
    coarse_end, fine_end = (integrate_motion(drive.motion(values, one)).pose[:, -1] for one in (steps, fine))
    np.testing.assert_allclose(coarse_end, fine_end, atol=1e-12)


def test_every_drive_is_one() -> None:
    for drive, _ in DRIVES.values():
        checked: Drive = drive
        assert len({item.name for item in checked.parameters}) == len(checked.parameters)


def test_between_samples_the_path_bends_and_speeds_up() -> None:
    """By a tenth of the samples and a delay of half a step it ends where all samples say, and not on chords."""
    rate, t_s = 10, np.arange(601) * 0.01
    # up to 2 m/s, sped up by 1 m/s^2, on curves of a metre and more: a chord is 2 mm off
    rolled_m = np.stack([t_s - np.sin(t_s) + side * 0.2 * np.sin(0.9 * t_s) for side in (-1, 1)])

    def moved(every: int) -> np.ndarray:
        turned = np.diff(rolled_m[:, ::every], axis=1, prepend=0.0) / 0.05
        n = turned.shape[1]
        name, seen = np.array(["a"]), np.zeros((3, n))
        record = Recording(
            name, name, name, np.array([0, n]), t_s[::every], Steps(turned), seen, seen[:, :1].T, seen[0, :1] > 0
        )
        samples = np.arange(10, 60) * rate // every
        none, all_seen = 0 * samples, np.ones((50, 3), dtype=bool)
        segments = Segments(none, none, samples, 0.0 * all_seen, all_seen, none, none, samples < 0)
        drive = Differential(0.05, 0.05, 0.4)
        model, undelayed = Model(drive, record, segments), np.array([0.05, 0.05, 0.4, 1.0, 0.0, 0.0, 0.0, 0.0])
        late = undelayed + np.eye(8)[7] * 0.05
        return np.asarray(model.predict(late).residuals - model.predict(undelayed).residuals)

    np.testing.assert_allclose(moved(rate), moved(1), atol=5e-5)
