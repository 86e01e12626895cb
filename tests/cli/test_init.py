from __future__ import annotations

import json
from pathlib import Path

import pytest

from calib.campaign.settings_file import STATED, read_settings
from calib.cli.main import run


def test_an_empty_campaign_is_made_with_remarks(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It reads as settings in which nothing is stated; taken out of their remarks, its keys state everything."""
    folder = tmp_path / "hall3"
    assert run(["init", str(folder)]) == 0
    assert "campaign.toml" in capsys.readouterr().out
    settings = read_settings(folder / "campaign.toml", "campaign.toml")
    assert settings.name == "hall3"
    keys = {f"{section}.{key}" for section, names in STATED.items() for key in names}
    assert set(settings.assumed) == keys
    text = (folder / "campaign.toml").read_text()
    assert all(f"#{key.partition('.')[2]} = " in text for key in keys)
    (folder / "campaign.toml").write_text(
        "\n".join(line[1:] if line.startswith("#") and line[1:2].strip() else line for line in text.splitlines())
    )
    assert read_settings(folder / "campaign.toml", "campaign.toml").assumed == ()


def test_an_empty_campaign_says_what_it_lacks(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["init", str(tmp_path / "c"), "--json", "-"]) == 0
    assert len(json.loads(capsys.readouterr().out)["written"]) == 3
    assert run(["check", str(tmp_path / "c")]) == 2
    assert "found no rows; expected one row a run; add the runs" in capsys.readouterr().err


def test_what_stands_there_is_not_replaced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["init", str(tmp_path / "c")]) == 0
    (tmp_path / "c" / "runs.csv").write_text("run_id\na\n")
    assert run(["init", str(tmp_path / "c")]) == 2
    assert "--force" in capsys.readouterr().err
    assert (tmp_path / "c" / "runs.csv").read_text() == "run_id\na\n"
    assert run(["init", str(tmp_path / "c"), "--force"]) == 0
    assert (tmp_path / "c" / "runs.csv").read_text() != "run_id\na\n"


@pytest.mark.parametrize(
    "arguments", [["init", ""], ["check", ""], ["ingest", "a.csv", "--into", ""], ["ingest", "a.csv", "--into="]]
)
def test_an_empty_path_is_refused(
    arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It is not the working folder: status 2, one line, and nothing is written."""
    monkeypatch.chdir(tmp_path)
    assert run(arguments) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "found ''; expected the path of a file or folder; name one" in error
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("command", "name"), [("init", "FOLDER"), ("check", "CAMPAIGN"), ("ingest", "SOURCE")])
def test_an_empty_argument_is_called_by_its_name(command: str, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run([command, ""]) == 2
    assert f"{name}: found ''" in capsys.readouterr().err
