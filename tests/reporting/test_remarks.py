"""What a fit says names its wheel, its runs and its file, each once."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.errors import CalibError


def test_a_remark_names_its_wheel_and_a_note_of_many_runs_stands_once(tmp_path: Path) -> None:
    """Sessions that shift one radius; loads beyond what is permitted in ten runs."""
    header = "run_id,session,kind,distance_m,counts_left,counts_right,load_left_N,load_right_N\n"
    rows, rng = [], np.random.default_rng(4)
    for n in range(30):
        load = (300, 700, 1100)[n % 3]
        radius = 0.1 + rng.normal(0.0, 1e-5, 2) - np.array([0.0, 2e-4 * (n // 10 - 1)])
        distance = 40.0 + 0.1 * (n % 7)
        left, right = np.rint(distance / (2 * np.pi * radius) * 4096).astype(int)
        rows.append(f"r{n:02d},s{n // 10},corridor,{distance:.4f},{left},{right},{load},{load}\n")
    (tmp_path / "runs.csv").write_text(header + "".join(rows), encoding="utf-8")
    settings = 'format = "calib-campaign/1"\nname = "heavy"\n[encoder]\ncounts_per_rev = 4096\n'
    settings += "[vehicle]\nmax_wheel_load_N = 1000\n"
    (tmp_path / "campaign.toml").write_text(settings, encoding="utf-8")
    said = " ".join(calib.fit(tmp_path).summary().split())
    assert "Right wheel: Sessions differ by" in said
    assert said.count("found 1100 N") == 1
    assert "runs r02, r05, r08, r11, r14, r17 and 4 more: found 1100 N" in said
    (tmp_path / "runs.csv").write_text(header, encoding="utf-8")
    with pytest.raises(CalibError, match=f"{re.escape(str(tmp_path))}/runs.csv: found no rows"):
        calib.read(tmp_path)
