"""Nothing that a machine or a shell gives ends in a bug report: a line says what to do, and JSON stays JSON."""

from __future__ import annotations

import json
import os
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from calib.cli.main import EXIT_BAD_INPUT, failed, run

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("given", ["", "abc", "-5", "1e9", "99999999999999999999"])
def test_a_date_of_the_environment_that_is_none_is_left_out(
    given: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The drawing library would stumble over it; an empty one is none."""
    monkeypatch.setenv("SOURCE_DATE_EPOCH", given)
    assert run(["effects", "track_width"]) == 0
    assert "SOURCE_DATE_EPOCH" not in os.environ
    assert ("SOURCE_DATE_EPOCH: found" in capsys.readouterr().err) == bool(given)


def test_a_date_of_the_environment_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    assert run(["effects", "track_width"]) == 0
    assert os.environ["SOURCE_DATE_EPOCH"] == "1700000000"


@pytest.mark.parametrize("option", [["--json", "-"], ["--json=-"]])
def test_a_refused_command_answers_in_json_too(
    option: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two runs allow no law: one document on standard output, the same line on standard error."""
    shutil.copytree(ROOT / "sample_runs" / "corridor_crossed", tmp_path / "c")
    table = tmp_path / "c" / "runs.csv"
    table.write_text("\n".join(table.read_text().splitlines()[:3]) + "\n")
    assert run(["fit", str(tmp_path / "c"), *option]) == EXIT_BAD_INPUT
    out, err = capsys.readouterr()
    document = json.loads(out)
    assert document["exit_status"] == EXIT_BAD_INPUT
    assert document["error"] in err


def test_little_address_space_is_one_line() -> None:
    """400 MB do not hold the libraries of linear algebra."""

    def little() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (400_000_000, 400_000_000))

    command = [sys.executable, "-m", "calib", "fit", "sample_runs/corridor_crossed"]
    done = subprocess.run(command, cwd=ROOT, preexec_fn=little, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == EXIT_BAD_INPUT
    (line,) = done.stderr.splitlines()
    assert line.startswith("calib: out of memory")


@pytest.mark.parametrize(
    "error",
    [ImportError("libx.so: failed to map segment from shared object"), MemoryError(), OSError(12, "Cannot allocate")],
)
def test_a_lack_of_memory_is_no_bug(error: Exception, capsys: pytest.CaptureFixture[str]) -> None:
    assert failed(error, ["fit", "x"]) == EXIT_BAD_INPUT
    assert "out of memory" in capsys.readouterr().err


@pytest.mark.usefixtures("undrawn")
def test_a_logo_that_is_no_picture_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copytree(ROOT / "sample_runs" / "corridor_crossed", tmp_path / "c")
    (tmp_path / "c" / "logo.png").write_text("no picture")
    with (tmp_path / "c" / "campaign.toml").open("a") as settings:
        settings.write('\n[report]\nlogo = "logo.png"\n')
    assert run(["report", str(tmp_path / "c"), "--into", str(tmp_path / "r.pdf")]) == EXIT_BAD_INPUT
    assert "report.logo: found a file that cannot be drawn" in capsys.readouterr().err
