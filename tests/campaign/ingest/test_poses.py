"""Poses and ranges from the start of a run."""

from __future__ import annotations

import numpy as np
import pytest

from calib.campaign.ingest.poses import end_values, from_start


def _run(first_known: int) -> dict[str, np.ndarray]:
    """A straight drive of 2 m, two seconds of rest at both ends, in a frame turned by 30 degrees and shifted."""
    time = np.arange(0, 8, 0.1)
    along = np.clip(time - 2.0, 0.0, 4.0) * 0.5
    angle = np.pi / 6
    columns = {
        "t_s": time,
        "counts_left": np.round(1000 * along),
        "counts_right": np.round(1000 * along),
        "range_m": 7.0 - along,
        "ref_x_m": 3.0 + along * np.cos(angle),
        "ref_y_m": -1.0 + along * np.sin(angle),
        "ref_theta_rad": np.full(len(time), angle),
    }
    for name in ("range_m", "ref_x_m", "ref_y_m", "ref_theta_rad"):
        columns[name][:first_known] = np.nan
    return columns


@pytest.mark.parametrize("first_known", [0, 5])
def test_a_straight_drive_lies_on_the_x_axis(first_known: int) -> None:
    turned = from_start(_run(first_known), poses=True, distance=True)
    ends = end_values(turned)
    assert ends["distance_m"] == pytest.approx(2.0)
    assert (ends["ref_x_m"], ends["ref_y_m"], ends["ref_theta_rad"]) == pytest.approx((2.0, 0.0, 0.0), abs=1e-12)


def test_a_reference_that_starts_after_the_wheels_counts_from_its_first_pose() -> None:
    """Never a path of nothing, because one sample at the start is missing."""
    turned = from_start(_run(30), poses=True, distance=True)
    assert np.isfinite(turned["ref_x_m"][30:]).all()
    assert turned["ref_x_m"][30] == pytest.approx(0.0, abs=1e-12)
