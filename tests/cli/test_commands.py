from __future__ import annotations

import json
from pathlib import Path

import pytest

from calib.campaign import write_campaign
from calib.campaign.check import notes_for_results
from calib.campaign.read import read_campaign
from calib.cli import COMMANDS, SUMMARIES
from calib.cli.main import run
from tests.campaign.making import campaign


def test_every_command_has_its_line_in_the_list(capsys: pytest.CaptureFixture[str]) -> None:
    assert set(COMMANDS) <= set(SUMMARIES)
    assert run(["--help"]) == 0
    out = capsys.readouterr().out
    for name in COMMANDS:
        assert f"{name.split()[0]} " in out
    assert "..." not in out.split("Commands:")[1]


def test_an_unknown_command_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["frobnicate"]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)


def test_a_fault_of_a_campaign_is_named_with_its_folder_key_and_cure(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One line each: a newer format, a log with a bad cell, and an export onto files that are there."""
    made = campaign()
    settings = write_campaign(made, tmp_path / "c") / "campaign.toml"
    assert run(["export", str(tmp_path / "c"), "--to", "ros2", "--output", str(tmp_path / "out")]) == 0
    capsys.readouterr()
    assert run(["export", str(tmp_path / "c"), "--to", "ros2", "--output", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    log = next((tmp_path / "c" / "logs").iterdir())
    log.write_text(log.read_text().replace("\n0", "\nx", 1))
    assert run(["fit", str(tmp_path / "c")]) == 2
    assert f"{log}, row 2" in capsys.readouterr().err
    settings.write_text(settings.read_text().replace("calib-campaign/1", "calib-campaign/2"))
    assert run(["check", str(tmp_path / "c")]) == 2
    line = capsys.readouterr().err
    assert f"{settings}, column format" in line and "newer calib" in line and "leave the key out" not in line


def test_predictions_in_logs_alone_are_said_not_to_be_used(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_campaign(campaign(), tmp_path / "c")
    for log in (folder / "logs").iterdir():
        head, *rows = log.read_text().splitlines()
        log.write_text("\n".join([f"{head},sim_x_m", *(f"{row},0.0" for row in rows)]) + "\n")
    run(["check", str(folder), "--json", "-"])
    assert "sim_in_logs" in {note["code"] for note in json.loads(capsys.readouterr().out)["suspicious"]}
    assert any("sim_x_m" in note for note in notes_for_results(read_campaign(folder)))
