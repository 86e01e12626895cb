"""A front wheel that is logged too seldom for its steering: what it may do between two samples is no cause."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
import pytest

import calib
from calib.campaign.wheels import turn_between_samples_rad
from calib.gap.decision import constancy
from calib.gap.diagnose import diagnose_in_full

WHEELBASE_M, RADIUS_M, COUNTS = 1.0, 0.1, 4096
#: of the drive, beside which a log has few samples
FINE_S: Final = 1e-3
#: a corner is steered within this time, at this angle
SWEEP_S, ANGLE_RAD = 0.15, 0.9
KINDS: Final = {"corridor": 0.0, "square_ccw": 1.0, "square_cw": -1.0}
TOML: Final = f"""format = "calib-campaign/1"
name = "seldom"
simulated = true
[vehicle]
drive = "tricycle"
track_m = 0.7
wheelbase_m = {WHEELBASE_M}
wheel_radius_m = 0.1
front_wheel_radius_m = {RADIUS_M}
[encoder]
counts_per_rev = {COUNTS}
[reference]
sigma_xy_m = 0.001
sigma_theta_rad = 0.0005
frame = "start"
[odometry]
from = "front"
"""


def _steered(side: float, speed_mps: float) -> np.ndarray:
    """The steering angle at each fine step: four corners between straights, turned by about a quarter each."""
    held_s = 0.5 * np.pi * WHEELBASE_M / (speed_mps * np.sin(ANGLE_RAD)) - 0.5 * SWEEP_S
    sweep = np.linspace(0.0, ANGLE_RAD, round(SWEEP_S / FINE_S))
    corner = np.concatenate([sweep, np.full(max(round(held_s / FINE_S), 1), ANGLE_RAD), sweep[::-1]])
    straight = np.zeros(round(2.0 / speed_mps / FINE_S))
    return side * np.concatenate([part for _ in range(4) for part in (straight, corner)] + [straight])


def _write(folder: Path, rate_hz: float, *, zero_rad: float = 0.0) -> Path:
    rng = np.random.default_rng(5)
    (folder / "logs").mkdir(parents=True)
    (folder / "campaign.toml").write_text(TOML)
    rows = ["run_id,session,kind,speed_mps,ref_x_m,ref_y_m,ref_theta_rad,log"]
    for run in range(30):
        kind = list(KINDS)[run % 3]
        speed = (0.4, 0.6, 0.8)[int(rng.integers(3))]
        angle = _steered(KINDS[kind], speed)
        way = speed * FINE_S * (1.0 + 3e-4 * rng.standard_normal())
        heading = np.cumsum(way * np.sin(angle + zero_rad) / WHEELBASE_M)
        ahead = way * np.cos(angle + zero_rad)
        x, y = np.sum(ahead * np.cos(heading)), np.sum(ahead * np.sin(heading))
        every = round(1.0 / rate_hz / FINE_S)
        at = np.unique([*range(0, len(angle), every), len(angle) - 1])
        counts = np.round((at + 1) * way / (2 * np.pi * RADIUS_M) * COUNTS)
        log = [f"{t:.4f},{n:.0f},{d:.6f}" for t, n, d in zip(at * FINE_S, counts - counts[0], angle[at], strict=True)]
        (folder / f"logs/r{run:02}.csv").write_text("\n".join(["t_s,counts_front,steer_rad", *log]) + "\n")
        ends = np.array([x, y, heading[-1]]) + rng.standard_normal(3) * (1e-3, 1e-3, 5e-4)
        pose = ",".join(f"{value:.6f}" for value in ends)
        rows.append(f"r{run:02},s{run // 10},{kind},{speed},{pose},logs/r{run:02}.csv")
    (folder / "runs.csv").write_text("\n".join(rows) + "\n")
    return folder


def test_what_steering_may_do_between_samples_is_no_fix(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is wrong; a heading is uncertain by 40 mrad at 5 Hz, 4 at 20 Hz and 0.14 at 100 Hz, noise is 0.5."""
    campaigns = {rate_hz: calib.read(_write(tmp_path / f"{rate_hz}", rate_hz)) for rate_hz in (5.0, 20.0, 100.0)}
    uncertain_rad = [float(turn_between_samples_rad(one).mean()) for one in campaigns.values()]
    assert uncertain_rad[0] > 0.03 > 0.005 > uncertain_rad[1] > 0.003 > 0.0002 > uncertain_rad[2]
    for rate_hz in (5.0, 20.0):
        diagnosis = diagnose_in_full(campaigns[rate_hz], plan=False)
        assert not diagnosis.recommended
        assert all(cause.probability <= 0.5 for cause in diagnosis.causes)
        assert "between two samples" in " ".join(diagnosis.fix.why)
    monkeypatch.setattr(constancy, "_between_samples", lambda evidence, names: {})
    assert all(diagnose_in_full(campaigns[rate_hz], plan=False).recommended for rate_hz in (5.0, 20.0))


def test_a_zero_beyond_what_samples_leave_uncertain_is_corrected(tmp_path: Path) -> None:
    diagnosis = diagnose_in_full(calib.read(_write(tmp_path / "c", 100.0, zero_rad=0.005)), plan=False)
    assert diagnosis.recommended and diagnosis.causes[0].effect == "steering_zero"
    low, high = diagnosis.causes[0].parameters["zero"].ci95
    assert low < -0.005 < high


def test_turns_that_readings_explain_as_they_are_have_no_zero_far_off(tmp_path: Path) -> None:
    """Squares turn once about: without their whole turns they would look as if the wheels stood 39 degrees off."""
    diagnosis = diagnose_in_full(calib.read(_write(tmp_path / "c", 10.0, zero_rad=0.02)), plan=False)
    assert diagnosis.closure.channels[-1].after_rms < 0.1 * diagnosis.closure.channels[-1].before_rms
