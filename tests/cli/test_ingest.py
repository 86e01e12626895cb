from __future__ import annotations

import json
import tomllib
from pathlib import Path

import pytest

from calib.cli.main import run
from tests.campaign.ingest.continuous import mapping_text, recorded, write
from tests.campaign.ingest.test_lab import Laboratory


@pytest.fixture
def table(tmp_path: Path) -> Path:
    path = tmp_path / "table.csv"
    path.write_text("run_id,distance_mm,counts_left,counts_right\na,40000,260000,260100\n")
    return path


def test_a_table_with_known_names_needs_no_mapping(
    table: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["ingest", str(table), "--into", str(tmp_path / "c"), "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["n_runs"] == 1
    assert run(["check", str(tmp_path / "c")]) == 0


def test_an_existing_campaign_is_not_replaced(table: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["ingest", str(table), "--into", str(tmp_path / "c")]) == 0
    capsys.readouterr()
    assert run(["ingest", str(table), "--into", str(tmp_path / "c")]) == 2
    assert "--force" in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [["nothing.csv"], ["nothing.csv", "more.csv"]])
def test_bad_sources_are_one_line(arguments: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["ingest", *arguments, "--into", str(tmp_path / "c")]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_help_documents_the_mapping(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["ingest", "--help"]) == 0
    out = capsys.readouterr().out
    assert "[table]" in out
    assert "calib ingest" in out


def test_without_a_target_the_options_are_named(table: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["ingest", str(table)]) == 2
    err = capsys.readouterr().err
    assert "--into" in err
    assert "--describe" in err


@pytest.mark.parametrize("variant", ["german", "plain"])
def test_a_description_is_a_mapping(
    variant: str, laboratory: Laboratory, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Standard output is TOML that ingest takes; as JSON the same and what was found in each file."""
    lab, _ = laboratory(variant)
    assert run(["ingest", "--describe", str(lab.table), str(lab.logs)]) == 0
    text = capsys.readouterr().out
    assert tomllib.loads(text)["encoder"]["wrap_bits"] == 16
    (tmp_path / "m.toml").write_text(text, encoding="utf-8")
    arguments = ["ingest", str(lab.table), str(lab.logs), "--mapping", str(tmp_path / "m.toml")]
    assert run([*arguments, "--into", str(tmp_path / "c"), "--dry-run"]) == 0
    assert "nothing was written" in capsys.readouterr().out
    assert not (tmp_path / "c").exists()
    assert run(["ingest", "--describe", str(lab.table), str(lab.logs), "--json", "-"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["mapping"] == text
    assert document["n_files"] == 24


def test_the_screen_of_24_runs(
    laboratory: Laboratory, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """At 80 columns the notes on the export fit on two screens, and no line is longer."""
    monkeypatch.setenv("COLUMNS", "80")
    lab, proposed = laboratory("german")
    (tmp_path / "m.toml").write_text(proposed, encoding="utf-8")
    arguments = ["ingest", str(lab.table), str(lab.logs), "--mapping", str(tmp_path / "m.toml")]
    assert run([*arguments, "--into", str(tmp_path / "c")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) <= 48, len(lines)
    # a path may be longer than a line
    assert all(len(line) <= 80 or " " not in line.strip() or line.startswith("Next: ") for line in lines)


def test_one_command_from_a_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """check, fit and diagnose take a recording with its mapping as if it had been ingested."""
    driven = recorded(tmp_path)
    source = write(driven.drive, tmp_path, "mcap")
    mapping = tmp_path / "m.toml"
    mapping.write_text(mapping_text("mcap") + '[table]\nfile = "runs.csv"\n')
    campaign = tmp_path / "c"
    assert run(["ingest", str(source), "--mapping", str(mapping), "--into", str(campaign)]) == 0
    for command in ("check", "fit", "diagnose"):
        capsys.readouterr()
        first = run([command, str(source), "--mapping", str(mapping), "--json", "-"])
        direct = json.loads(capsys.readouterr().out)
        assert run([command, str(campaign), "--json", "-"]) == first
        written = json.loads(capsys.readouterr().out)
        if command == "check":
            assert direct["found"] == written["found"]
        elif command == "fit":
            assert direct["wheels"] == written["wheels"]
        else:
            assert direct["verdict"] == written["verdict"]
            assert direct["causes"] == written["causes"]
