"""A real recording: the scale of a robot's odometry by laser and by motion capture."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from calib.campaign import write_campaign
from calib.campaign.read import read_campaign
from tests.campaign.straightline import COUNTS_PER_REV, RADIUS_M, convert


def _scales(folder: Path) -> tuple[int, float, float, float]:
    """Runs, and r_e = S / (2 pi n) over the nominal radius: of all, of the forward and of the backward runs."""
    made = read_campaign(folder)
    turns = made.runs.number("counts_left") / COUNTS_PER_REV
    distance = made.runs.number("distance_m")
    out = made.runs.label("direction") == "out"
    scales = [
        float(distance[part].sum() / (2 * np.pi * turns[part].sum()) / RADIUS_M)
        for part in (np.ones(len(out), dtype=bool), out, ~out)
    ]
    return len(distance), scales[0], scales[1], scales[2]


@pytest.mark.parametrize(
    ("by", "scale", "forward", "backward"),
    [("motion_capture", 0.9394, 0.9411, 0.9378), ("laser", 0.9410, None, None)],
)
def test_the_scale_of_the_odometry_comes_out(
    by: Literal["laser", "motion_capture"],
    scale: float,
    forward: float | None,
    backward: float | None,
    shared_data: Path,
    tmp_path: Path,
) -> None:
    """The published reference is the ratio over 194 one-way segments, to 0.1 %."""
    source = shared_data / "straightline_laser" / "dataset1.mat"
    if not source.is_file():
        pytest.skip("real recordings are not here: straightline_laser/dataset1.mat does not exist")
    n_runs, found, out, back = _scales(write_campaign(convert(source, by=by), tmp_path / "c"))
    print(f"{by}: {n_runs} runs, scale {found:.5f}, forward {out:.5f}, backward {back:.5f}")  # noqa: T201
    assert n_runs == 194
    assert found == pytest.approx(scale, rel=1e-3)
    if forward and backward:
        assert (out, back) == pytest.approx((forward, backward), rel=1e-3)
    assert out > back
