from __future__ import annotations

import json
from pathlib import Path

import pytest

from calib.cli.main import run


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
