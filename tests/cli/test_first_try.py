"""Any laboratory's folder at the first try: one description, a few lines edited, one ingestion; the truth comes out."""

from __future__ import annotations

import contextlib
import io
import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calib.campaign.read import read_campaign
from calib.cli.main import run
from tests.campaign.ingest.english import DROPOUT, N_RUNS, REPEATED, SWAPPED, english
from tests.campaign.ingest.lab import Lab
from tests.campaign.ingest.ros_lab import DELAY_S, RADIUS_LEFT_M, RADIUS_RIGHT_M, TRACK_M, ros_lab

#: lines of the proposal that a user changes at most
MOST_EDITED = 12
#: radius at 300 N and slope of the wheels that the English export was made of
TRUE = {"left": (0.0990, 1.3e-6), "right": (0.0993, 1.2e-6)}
#: distances are written to 0.1 mm, loads to 0.1 N
WRITTEN_M, WRITTEN_N = 5.1e-5, 0.06
VEHICLE = {
    "^#track_m = .*": "track_m = 0.7",
    "^#wheelbase_m = .*": "wheelbase_m = 1.0",
    "^#wheel_radius_m = .*": "wheel_radius_m = 0.1",
    "^#mass_kg = .*": "mass_kg = 100",
    "^#cog_x_m = .*": "cog_x_m = 0.388",
    "^#counts_per_rev = .*": "counts_per_rev = 4096",
    # the line that 'calib check' names
    r"^\[log\].*": f'[log]\nswapped = ["{SWAPPED}"]',
}
ROBOT = {
    "^#drive = .*": 'drive = "differential"',
    "^#track_m = .*": "track_m = 0.16",
    "^#wheel_radius_m = .*": "wheel_radius_m = 0.033",
    "^#sigma_xy_m = .*": "sigma_xy_m = 0.0005",
    "^#sigma_theta_rad = .*": "sigma_theta_rad = 0.001",
}


def _printed(arguments: Sequence[str]) -> str:
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        assert run(list(arguments)) == 0, arguments
    return out.getvalue()


def _ingested(folder: Path, sources: list[str], edits: dict[str, str]) -> str:
    """Describe, edit and ingest, once each; returns what ingest noted."""
    text = _printed(["ingest", "--describe", *sources])
    assert len(edits) <= MOST_EDITED
    for pattern, line in edits.items():
        text, n_changed = re.subn(pattern, line, text, count=1, flags=re.MULTILINE)
        assert n_changed == 1, pattern
    (folder / "m.toml").write_text(text, encoding="utf-8")
    command = ["ingest", *sources, "--mapping", str(folder / "m.toml"), "--into", str(folder / "c"), "--json", "-"]
    return "\n".join(note["where"] + ": " + note["text"] for note in json.loads(_printed(command))["notes"])


@pytest.fixture(scope="module")
def tried(tmp_path_factory: pytest.TempPathFactory) -> tuple[Lab, Path, str]:
    folder = tmp_path_factory.mktemp("english")
    lab = english(folder)
    return lab, folder, _ingested(folder, [str(lab.table), str(lab.logs)], VEHICLE)


def test_the_workbook_and_the_loggers_are_what_was_driven(tried: tuple[Lab, Path, str]) -> None:
    """Merged days, three header rows, units, the lookup sheet, wraps, epoch milliseconds: values of all runs."""
    lab, folder, _ = tried
    made, true = read_campaign(folder / "c"), lab.truth.runs
    assert made.runs.run_id.tolist() == [str(number + 1) for number in range(N_RUNS)]
    assert made.runs.label("session").tolist() == [f"2026-05-0{4 + number // 6}" for number in range(N_RUNS)]
    assert made.runs.label("direction").tolist() == true.label("direction").tolist()
    np.testing.assert_allclose(made.runs.number("distance_m"), true.number("distance_m"), atol=WRITTEN_M)
    for name in ("payload_kg", "speed_mps", "counts_left", "counts_right"):
        np.testing.assert_allclose(made.runs.number(name), true.number(name), rtol=1e-12)
    for side in ("left", "right"):
        # weighed in kg on the lookup sheet
        name = f"load_{side}_N"
        np.testing.assert_allclose(made.runs.number(name), true.number(name), atol=WRITTEN_N)
    np.testing.assert_allclose(made.runs.number("temperature_C"), 20.5 + 0.1 * (np.arange(N_RUNS) % 4))
    log = made.logs.of(REPEATED - 1)
    assert (np.diff(log["t_s"]) > 0).all()
    assert np.max(np.diff(made.logs.of(DROPOUT - 1)["t_s"])) == pytest.approx(3.05, abs=1e-6)


def test_what_was_passed_over_is_said(tried: tuple[Lab, Path, str]) -> None:
    said = tried[2]
    for words in (
        "20 cells of merged ranges were filled",
        "row 16: 'laser realigned after lunch' is a remark",
        "row 29: 'mean' is a mean",
        "row 30: 'sum' is a mean",
        "row 31: 'KM: tyres at 3.2 bar throughout' is a remark",
        "not known, so their numbers are not converted: d (Date), hh:mm (Start)",
        "V (Ubat)",
        "2 sample(s) whose time stamp comes again were omitted",
        "left and right were exchanged",
    ):
        assert words in said, words


@pytest.mark.usefixtures("undrawn")
def test_the_law_holds_the_truth_and_goes_on_to_the_vehicle(tried: tuple[Lab, Path, str]) -> None:
    _, folder, _ = tried
    _printed(["fit", str(folder / "c"), "--into", str(folder / "f")])
    fitted = json.loads((folder / "f" / "fit.json").read_text())
    for side, (radius, slope) in TRUE.items():
        wheel = fitted["wheels"][side]
        low, high = wheel["radius_ref_ci95_m"]
        assert low <= radius + slope * (wheel["reference_load_N"] - 300.0) <= high
        low, high = wheel["slope_ci95_m_per_N"]
        assert low <= slope <= high
    _printed(["report", str(folder / "f"), "--into", str(folder / "report.pdf")])
    assert (folder / "report.pdf").read_bytes().startswith(b"%PDF")
    _printed(["export", str(folder / "f"), "--to", "c", "--output", str(folder / "calib.h")])
    assert re.search(r"#define CALIB_WRAP_BITS 16\b", (folder / "calib.h").read_text())


def test_a_robots_folder_gives_its_geometry(tmp_path: Path) -> None:
    """MCAP files beside rosbag2 folders, Turtlebot names, motion capture 80 ms late: the truth within the intervals."""
    source = ros_lab(tmp_path / "bags")
    said = _ingested(tmp_path, [str(source)], ROBOT)
    assert "the reference lags" in said
    _printed(
        ["geometry", str(tmp_path / "c"), "--output", str(tmp_path / "g.json"), "--json", str(tmp_path / "told.json")]
    )
    told: dict[str, Any] = json.loads((tmp_path / "told.json").read_text())
    truth = {
        "radius_left_m": RADIUS_LEFT_M,
        "radius_right_m": RADIUS_RIGHT_M,
        "track_m": TRACK_M,
        "delay_s": DELAY_S,
        "sensor_x_m": 0.0,
        "sensor_y_m": 0.0,
    }
    for name, value in truth.items():
        low, high = (told["parameters"] | {"delay_s": told["delay_s"]})[name]["ci95"]
        assert low <= value <= high, (name, low, value, high)
    _printed(["export", str(tmp_path / "g.json"), "--to", "ros2", "--output", str(tmp_path / "ros2")])
    assert any((tmp_path / "ros2").iterdir())
