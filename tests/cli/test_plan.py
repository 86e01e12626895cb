"""`calib plan`: next runs of a campaign, and plans judged before anything is driven."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from calib.cli.main import run

PLAN = """
format = "calib-plan/1"
name = "first idea"
[vehicle]
track_m = 0.7
wheel_radius_m = 0.1
[encoder]
counts_per_rev = 4096
[[runs]]
kind = "corridor"
direction = "out"
count = 6
[[runs]]
kind = "corridor"
direction = "back"
payload_kg = 150
payload_x_m = 0.3
count = 6
"""


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    path = tmp_path / "PLAN.toml"
    path.write_text(PLAN)
    return path


def test_the_next_run_of_the_corridor_campaign_splits_load_and_session(
    project_root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["plan", str(project_root / "sample_runs/corridor"), "--json", "-"]) == 0
    first = json.loads(capsys.readouterr().out)["next_runs"][0]
    assert first["payload_kg"] > 0
    assert "load_radius from session_step" in first["why"]
    # all runs were driven so fast: another speed tells hardly more, and would be a second difference
    assert first["speed_mps"] == 0.5


def test_only_candidates_given_are_named(
    project_root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "candidates.toml"
    path.write_text("[[runs]]\nkind = 'figure8'\npayload_kg = 120\npayload_x_m = 0.3\n[[runs]]\nkind = 'corridor'\n")
    given = ["plan", str(project_root / "sample_runs/corridor"), "--candidates", str(path), "--json", "-"]
    assert run(given) == 0
    kinds = {one["kind"] for one in json.loads(capsys.readouterr().out)["next_runs"]}
    assert kinds <= {"figure8", "corridor"}


def test_a_plan_is_judged_as_matrix_and_picture(plan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Straight unladen and laden runs: no turn, so nothing about turns can be seen; direction correlates with load."""
    figures = tmp_path / "figures"
    assert run(["plan", "--from", str(plan), "--figures", str(figures), "--json", "-"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["runs"] == 12
    number = {name: k for k, name in enumerate(document["effects"])}
    assert document["distance"][number["load_radius"]][number["load_radius"]] is None
    # the laden runs are the runs back: at their sizes the two cannot be told apart
    assert document["distance"][number["travel_direction"]][number["load_radius"]] < 3
    assert "curve_scrub" in document["absent"] or "curve_scrub" in document["not_seen"]
    assert (figures / "plan-matrix.png").read_bytes().startswith(b"\x89PNG")
    assert run(["plan", "--from", str(plan)]) == 0
    # one reason, told once
    assert capsys.readouterr().out.count("acts") == 1
    assert run(["plan", "--from", str(plan), "--figures", str(figures)]) == 2
    assert "--force" in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [[], ["somewhere", "--from", "PLAN.toml"], ["--from", "nowhere.toml"]])
def test_bad_usage_is_one_line(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["plan", *arguments]) == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize("wheels", ["front", "wheels"])
def test_a_plan_without_rear_encoders_needs_its_logs(
    wheels: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A steered wheel, or four, are counted along the way: a plan that takes no log is refused for that reason."""
    vehicle = {"front": 'drive = "tricycle"\n', "wheels": 'drive = "mecanum"\nhalf_length_plus_half_width_m = 0.4\n'}
    sections = PLAN.replace("[vehicle]\n", f"[vehicle]\n{vehicle[wheels]}", 1)
    sections = sections.replace("[[runs]]", f'[odometry]\nfrom = "{wheels}"\n[measured]\nlog = false\n[[runs]]', 1)
    path = tmp_path / "p.toml"
    path.write_text(sections)
    assert run(["plan", "--from", str(path)]) == 2
    error = capsys.readouterr().err
    assert "measured.log" in error and "without a log" in error
    assert "Traceback" not in error and error.count("\n") == 1
