from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from calib.campaign import write_campaign
from calib.cli.main import run
from tests.campaign.making import campaign


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_campaign(campaign(), tmp_path / "c")


def test_a_sound_campaign_exits_0_and_says_what_is_there(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["check", str(folder)]) == 0
    out, err = capsys.readouterr()
    assert "30" in out
    assert "Sound: No fault" in out
    assert err == ""


def test_something_wrong_exits_1(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "logs" / "r003.csv").unlink()
    assert run(["check", str(folder)]) == 1
    assert "row 5" in capsys.readouterr().out


def test_suspicious_alone_exits_0(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["check", str(write_campaign(campaign(crossed=False), tmp_path / "c"))]) == 0
    out = capsys.readouterr().out
    assert "cannot be told apart" in " ".join(out.split())
    assert "Look at this" in out


def test_strict_turns_suspicion_into_exit_status_1(tmp_path: Path, folder: Path) -> None:
    suspicious = write_campaign(campaign(crossed=False), tmp_path / "suspicious")
    assert run(["check", str(suspicious), "--strict"]) == 1
    assert run(["check", str(folder), "--strict"]) == 0


def test_the_verdict_of_the_document_is_that_of_the_screen(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nothing under suspicion ends in words that say all is well."""
    for crossed, verdict in ((True, "sound"), (False, "look at this")):
        target = tmp_path / f"{crossed}.json"
        made = write_campaign(campaign(crossed=crossed), tmp_path / str(crossed))
        run(["check", str(made), "--json", str(target)])
        assert json.loads(target.read_text())["verdict"] == verdict
        said, what_next = capsys.readouterr().out.split("\nNext: ")
        assert verdict in " ".join(said.lower().splitlines()[-2:])
        assert "'calib fit" in what_next


def test_json_on_standard_output_stands_alone(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["check", str(folder), "--json", "-"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["found"]["n_runs"] == 30
    assert result["wrong"] == []


def test_json_is_not_overwritten_unless_forced(folder: Path, tmp_path: Path) -> None:
    target = tmp_path / "out.json"
    assert run(["check", str(folder), "--json", str(target)]) == 0
    assert run(["check", str(folder), "--json", str(target)]) == 2
    assert run(["check", str(folder), "--json", str(target), "--force"]) == 0


def test_bad_input_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["check", str(tmp_path / "nothing")]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)


def test_help_shows_an_example(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["check", "--help"]) == 0
    assert "calib check" in capsys.readouterr().out


def test_many_of_a_kind_are_named_in_part(
    tmp_path: Path, project_root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Sixty logs that are missing are sixty faults, of which a screen names eight; the JSON names them all."""
    folder = tmp_path / "c"
    folder.mkdir()
    for name in ("campaign.toml", "runs.csv"):
        shutil.copy(project_root / "sample_runs" / "corridor" / name, folder / name)
    assert run(["check", str(folder)]) == 1
    shown = capsys.readouterr().out
    assert shown.count("column log [") == 8
    assert "and 52 more like these: missing log" in shown
    assert run(["check", str(folder), "--json", "-"]) == 1
    assert len(json.loads(capsys.readouterr().out)["wrong"]) == 60


def test_settings_that_a_later_command_refuses_are_wrong_and_unknown_ones_are_named(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "other"
    shutil.copytree(folder, other)
    settings = (other / "campaign.toml").read_text(encoding="utf-8")
    added = """
[report]
foo = 3
[uncertainty.moon]
scale = {std = 1.0}
[[effects]]
id = "tyres"
column = "nowhere"
acts_on = "both"
typical = 1e-3
largest = 1e-2
[bananas]
a = 1
"""
    (other / "campaign.toml").write_text("blah = 3\n" + settings + added, encoding="utf-8")
    assert run(["check", str(other), "--json", "-"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert [note["where"].rpartition(" ")[2] for note in found["wrong"]] == [
        "report.foo",
        "uncertainty.moon.scale",
        "effects[0].column",
    ]
    unknown = [note["where"] for note in found["suspicious"] if "not known" in note["text"]]
    assert [where.rpartition(" ")[2] for where in unknown] == ["bananas", "blah"]
