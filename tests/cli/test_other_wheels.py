"""Vehicles without rear encoders, a front wheel or four mecanum wheels alone, through every command."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from calib.campaign import write_campaign
from calib.campaign.wheels import logged_columns
from calib.cli.main import run
from calib.reporting.topics.runs import after_check
from tests.kinematics.campaigns import mecanum, tricycle

#: what the runs were made with
TRUTH = {
    "front": {"front_radius_m": 0.102, "wheelbase_m": 1.03, "steering_zero_rad": 0.012},
    "wheels": {"wheel_radius_m": 0.068, "half_length_plus_half_width_m": 0.36},
}
#: what the diagnosis has to name on them: the nominal radius is 0.1 m, the wheelbase 1 m; 0.07 m and l + w 0.369 m
CAUSES = {"front": {"radius_scale", "steering_zero", "steering_scale"}, "wheels": {"radius_scale", "track_width"}}
KINDS = list(TRUTH)
#: standard deviations: one in 15,000 is further off
SIGMAS = 4.0


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("wheels")
    for kind, make in (("front", tricycle), ("wheels", mecanum)):
        write_campaign(make(np.random.default_rng(1)), folder / kind)
        assert run(["geometry", str(folder / kind), "--output", str(folder / f"{kind}.json")]) == 0
    return {kind: folder / kind for kind in KINDS}


def told(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, dict[str, Any]]:
    """Status and document of a command."""
    capsys.readouterr()
    status = run([*arguments, "--json", "-"])
    document: dict[str, Any] = json.loads(capsys.readouterr().out)
    return status, document


@pytest.mark.parametrize("kind", KINDS)
def test_check_asks_for_the_wheels_there_are(
    kind: str, folders: dict[str, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    """Counts of rear wheels are not missed; a run whose log lacks a wheel is named with that wheel."""
    status, document = told(["check", str(folders[kind])], capsys)
    assert status == 0 and "missing_counts" not in {note["code"] for note in document["suspicious"]}
    # nor is a law of two wheels on an axle, which they do not have, the next step where distances were measured
    found = SimpleNamespace(n_runs=12, n_excluded=0, distance_m=(1.0, 2.0), counts_left=None)
    report = SimpleNamespace(found=found, suspicious=(), verdict="sound")
    assert after_check(report, ["ref_x_m", *logged_columns(kind)]) == "check without distances"  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", KINDS)
def test_geometry_finds_the_lengths(kind: str, folders: dict[str, Path], capsys: pytest.CaptureFixture[str]) -> None:
    status, document = told(["geometry", str(folders[kind])], capsys)
    assert status == 0 and document["from"] == kind
    for name, value in TRUTH[kind].items():
        found = document["parameters"][name]
        assert abs(found["value"] - value) < SIGMAS * found["sd"], name


@pytest.mark.parametrize("kind", KINDS)
def test_fit_says_what_it_needs(kind: str, folders: dict[str, Path], capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["fit", str(folders[kind])]) == 2
    line = capsys.readouterr().err
    assert "counts_left and counts_right" in line and "calib geometry" in line and line.count("\n") == 1


@pytest.mark.parametrize("kind", KINDS)
def test_diagnose_names_what_is_off_and_nothing_once_it_is_calibrated(
    kind: str, folders: dict[str, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    """The wrong lengths are the causes, none of them of rear wheels; calibrated lengths leave no gap."""
    _, document = told(["diagnose", str(folders[kind])], capsys)
    assert {cause["effect"] for cause in document["causes"]} == CAUSES[kind]
    model = folders[kind].with_suffix(".json")
    status, document = told(["diagnose", str(folders[kind]), "--model", str(model)], capsys)
    assert (status, document["verdict"]) == (0, "no_gap")


@pytest.mark.parametrize("kind", KINDS)
def test_a_written_fix_closes_the_gap_and_has_the_lengths(
    kind: str, folders: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What --apply writes leaves no gap under --model, and holds the lengths that the runs were made with."""
    model = tmp_path / "model.json"
    told(["diagnose", str(folders[kind]), "--apply", str(model)], capsys)
    status, document = told(["diagnose", str(folders[kind]), "--model", str(model)], capsys)
    assert (status, document["verdict"]) == (0, "no_gap")
    written = json.loads(model.read_text())["joint_geometry"]
    assert written["source"] == kind
    for name, value in TRUTH[kind].items() if kind == "wheels" else ():
        # 24 runs of some 3 m whose ends are good to 2 mm
        assert written["parameters"][name]["value"] == pytest.approx(value, rel=5e-4), name


@pytest.mark.parametrize("kind", KINDS)
def test_replay_ends_where_the_reference_does_once_calibrated(
    kind: str, folders: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """End errors fall to the reference's noise; without coefficients the campaign's own geometry is taken."""
    model = folders[kind].with_suffix(".json")
    arguments = ["simulate", "replay", str(folders[kind]), "--tum", str(tmp_path)]
    status, document = told([*arguments, "--law", str(model)], capsys)
    # the reference is good to 2 mm on each axis
    assert status == 0 and document["rms_m"]["corrected"] < 0.006 < 0.05 < document["rms_m"]["model"]
    assert len(list(tmp_path.glob("*.tum"))) == len(document["runs"])
    _, by_itself = told(["simulate", "replay", str(folders[kind])], capsys)
    assert by_itself["rms_m"]["corrected"] == pytest.approx(document["rms_m"]["corrected"])


@pytest.mark.parametrize("kind", KINDS)
def test_export_writes_the_controller_that_has_these_wheels(
    kind: str, folders: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """ROS 2 parameters hold the estimated radius; the header for two wheels on one axle is refused in one line."""
    model = tmp_path / "model.json"
    told(["diagnose", str(folders[kind]), "--apply", str(model)], capsys)
    (_, document), (_, applied) = (told(["export", str(of), "--to", "ros2"], capsys) for of in (folders[kind], model))
    text, of_fix = (each["files"][0]["text"] for each in (document, applied))
    controller, key = {
        "front": ("tricycle_controller", "wheel_radius"),
        "wheels": ("mecanum_drive_controller", "wheels_radius"),
    }[kind]
    assert text.count("_controller:") == 1 and f"{controller}:" in text
    radius = float(text.split(f"{key}: ")[1].split()[0])
    assert radius == pytest.approx(next(iter(TRUTH[kind].values())), rel=1e-3)
    if kind == "wheels":
        (arm,) = (float(line.split(": ")[1]) for line in of_fix.splitlines() if "sum_of_robot_center" in line)
        assert arm == pytest.approx(TRUTH[kind]["half_length_plus_half_width_m"], rel=1e-3)
    assert run(["export", str(folders[kind]), "--to", "c"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
