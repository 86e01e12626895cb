"""Corridors whose lengths alone were measured end in plain words, and no reading of them is named."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd

from calib.campaign.read import read_campaign
from calib.errors import RefusedError
from calib.kinematics.adequacy import GeometryVerdict
from calib.kinematics.estimate import estimate_geometry

LOADS_N = (300.0, 500.0, 700.0, 900.0, 1100.0)


def corridor(folder: Path, lengths_m: tuple[float, ...], offset_m: float, right: float) -> Path:
    """Write straight runs with loads; distances have an offset, the right wheel is larger by a share."""
    rng = np.random.default_rng(1)
    folder.mkdir(parents=True)
    rows = ["run_id,session,kind,load_left_N,load_right_N,distance_m,counts_left,counts_right"]
    for number in range(40):
        load, length = LOADS_N[number % 5], rng.choice(lengths_m) + rng.uniform(-0.5, 0.5)
        radii = 0.1 * np.array([1.0, 1.0 + right]) - 1.4e-6 * (load - 300.0)
        left, other = np.rint(length / (radii * (1.0 + rng.normal(0.0, 5e-5, 2))) * 4096.0 / (2.0 * np.pi))
        distance = length + offset_m + rng.normal(0.0, 0.0015)
        rows.append(f"r{number},d{number // 8},corridor,{load},{load},{distance:.4f},{left:.0f},{other:.0f}")
    (folder / "runs.csv").write_text("\n".join(rows) + "\n")
    (folder / "campaign.toml").write_text(
        'format = "calib-campaign/1"\nsimulated = true\n[vehicle]\ndrive = "differential"\ntrack_m = 0.7\n'
        "wheel_radius_m = 0.1\nmax_wheel_load_N = 5000.0\n[encoder]\ncounts_per_rev = 4096\n"
        "[rangefinder]\nsigma_m = 0.0015\n"
    )
    return folder


def test_equal_wheels_are_doubtful_and_no_blunder_is_named(tmp_path: Path) -> None:
    """A bend makes up for any reading: the track is not one of twice the stated width."""
    found = estimate_geometry(read_campaign(corridor(tmp_path / "c", (40.0,), 0.0, 0.0)))
    assert found.verdict is GeometryVerdict.DOUBTFUL
    assert not found.faults
    assert any("lengths of straight runs alone" in sentence for sentence in found.why)


def test_positions_along_the_line_alone_are_lengths(tmp_path: Path) -> None:
    """``ref_x_m`` along the path, and no ``ref_y_m``, tells the wheels apart no better than the distance."""
    folder = corridor(tmp_path / "c", (10.0, 20.0, 40.0), 0.0, 0.003)
    runs = pd.read_csv(folder / "runs.csv").rename(columns={"distance_m": "ref_x_m"})
    runs.to_csv(folder / "runs.csv", index=False)
    (folder / "logs").mkdir()
    for _, run in runs.iterrows():
        share = np.linspace(0.0, 1.0, 50)
        columns = {name: share * run[name] for name in ("counts_left", "counts_right", "ref_x_m")}
        log = pd.DataFrame({"t_s": 20.0 * share} | columns).round({"counts_left": 0, "counts_right": 0})
        log.to_csv(folder / "logs" / f"{run.run_id}.csv", index=False)
    found = estimate_geometry(read_campaign(folder))
    assert found.using == "windows"
    assert found.verdict is GeometryVerdict.DOUBTFUL
    assert any("lengths of straight runs alone" in sentence for sentence in found.why)


def test_lengths_that_no_bend_explains_end_in_plain_words(tmp_path: Path) -> None:
    """A rangefinder 0.2 m off over corridors of 10, 20 and 40 m: doubtful, or refused where rounding decides so."""
    campaign = read_campaign(corridor(tmp_path / "c", (10.0, 20.0, 40.0), 0.2, 0.003))
    try:
        found = estimate_geometry(campaign)
    except RefusedError as error:
        said = str(error)
    else:
        assert found.verdict is not GeometryVerdict.CALIBRATED
        assert not found.faults
        said = " ".join(found.why)
    assert re.search(r"lengths of straight runs alone .* 'calib fit' .* end headings", said)
