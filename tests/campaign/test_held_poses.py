"""Poses that a slower reference holds between its readings are read as what they are."""

from __future__ import annotations

import numpy as np
import pytest

from calib.campaign.model import Border, Logs
from calib.campaign.read import without_held_poses

RATE_HZ, HELD = 50.0, 10


def _log(held: int = 1, digits: int = 6, lost: slice = slice(0, 0)) -> Logs:
    """A vehicle that rests for a second, rolls at 0.2 to 0.8 m/s and rests; each reading stands for `held` samples."""
    t_s = np.arange(0.0, 20.0, 1.0 / RATE_HZ)
    speed = np.where((t_s > 1.0) & (t_s < 19.0), 0.5 + 0.3 * np.sin(t_s), 0.0)
    way = np.cumsum(speed) / RATE_HZ
    read = np.arange(len(t_s)) // held * held
    read[lost] = read[lost.start]
    x_m, y_m, theta = (np.round(of[read], digits) for of in (way, 0.05 * way**2, 0.1 * way))
    counts = np.floor(6000.0 * way)
    columns = {"t_s": t_s, "counts_left": counts, "counts_right": counts, "ref_x_m": x_m, "ref_y_m": y_m}
    return Logs(np.array([0, len(t_s)]), columns | {"ref_theta_rad": theta})


def test_of_a_held_pose_the_first_counts() -> None:
    logs, border = _log(HELD), Border(lenient=True)
    known = np.isfinite(without_held_poses(logs, border).columns["ref_x_m"])
    rolls = np.append(False, np.diff(logs.columns["counts_left"]) > 0.0)
    fresh = np.arange(len(known)) % HELD == 0
    assert known[fresh].all() and known[~rolls].all()
    assert not known[rolls & ~fresh].any()
    (note,) = border.notes
    assert "poses stand for 0.2 s" in note.text


@pytest.mark.parametrize("logs", [_log(), _log(digits=2), _log(digits=1)])
def test_poses_of_every_sample_and_rounded_ones_stay(logs: Logs) -> None:
    """Rounded to a centimetre or ten they stand, too, for longer the slower it rolls."""
    border = Border(lenient=True)
    assert without_held_poses(logs, border) is logs
    assert not border.notes


def test_a_lost_reference_still_stands() -> None:
    """Two seconds of one pose are no reading of a slower reference: the check finds them."""
    lost = slice(400, 500)
    known = np.isfinite(without_held_poses(_log(HELD, lost=lost), Border(lenient=True)).columns["ref_x_m"])
    assert known[lost.start + 2 * HELD : lost.stop].all()
