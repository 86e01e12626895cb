"""What stands in data is data, and what a machine refuses is one line: terminals, spreadsheets, pipes, signals."""

from __future__ import annotations

import csv
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path

import pytest

from calib.cli import visible
from calib.cli.main import run
from calib.documents import csv_text, spreadsheet_cell

ROOT = Path(__file__).resolve().parents[2]
CORRIDOR = ROOT / "sample_runs" / "corridor"
#: cells that a run table may hold; those with control characters are refused by the reader
HOSTILE = ("[/red]", "[link=file:///etc]x[/link]", "=1+1", "@SUM(A1)", "+cmd|' /C calc'!A0", "-2+3", "\u202egnp.exe")
#: ``python -m calib`` in the foreground: a suite in the background hands on that interruptions are ignored
FRONT = (
    "import runpy, signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
    "runpy.run_module('calib', run_name='__main__', alter_sys=True)"
)
STEERING = ("\x1b[2J\x1b]0;owned\x07", "\x9b31m")


def _environment(**more: str) -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT), **more}


def _hostile(folder: Path, texts: Sequence[str] = HOSTILE) -> Path:
    shutil.copytree(CORRIDOR, folder)
    with (folder / "runs.csv").open(newline="", encoding="utf-8") as stream:
        names, *rows = list(csv.reader(stream))
    for number, text in enumerate(texts):
        rows[number][0] = text
        rows[number][names.index("session")] = text
    with (folder / "runs.csv").open("w", newline="", encoding="utf-8") as stream:
        csv.writer(stream).writerows([names, *rows])
    return folder


def _is_clean(text: str) -> bool:
    return not any(mark in text for mark in ("\x1b", "\x07", "\x9b", "\u202e"))


@pytest.mark.parametrize("command", [["check"], ["fit", "--runs"]])
def test_nothing_in_data_steers_the_terminal(
    command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Markup stays text, escape sequences are shown as escapes."""
    folder = _hostile(tmp_path / "C")
    assert run([command[0], str(folder), *command[1:]]) in {0, 1}
    shown = capsys.readouterr()
    assert _is_clean(shown.out + shown.err)


@pytest.mark.parametrize("text", STEERING)
def test_a_cell_with_controls_is_refused_or_shown_harmlessly(
    text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["check", str(_hostile(tmp_path / "C", [text]))]) in {0, 2}
    shown = capsys.readouterr()
    assert _is_clean(shown.out + shown.err)


def test_an_error_shows_escapes_and_never_sends_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["check", str(tmp_path / "\x1b[2J")]) == 2
    err = capsys.readouterr().err
    assert _is_clean(err)
    assert "\\x1b[2J" in err


def test_what_is_plain_stays_as_it_is() -> None:
    assert visible("r(F₀) ± 3 µm, 中文, [/red]") == "r(F₀) ± 3 µm, 中文, [/red]"
    assert visible("a\udcff") == "a\\udcff"


def test_cells_for_spreadsheets_are_never_formulas(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Texts that begin like a formula get a quote; negative numbers stay numbers."""
    run(["fit", str(_hostile(tmp_path / "C")), "--into", str(tmp_path / "r")])
    capsys.readouterr()
    with (tmp_path / "r" / "runs.csv").open(newline="", encoding="utf-8") as stream:
        for row in csv.reader(stream):
            for cell in row:
                assert spreadsheet_cell(cell) == cell
    assert csv_text(["=a", "b"], [["@x", -1.5], ["ok", None]]) == "'=a,b\n'@x,-1.5\nok,\n"
    assert [spreadsheet_cell(value) for value in ("=1", "-3.5", -3.5, "+x", "ok")] == ["'=1", "-3.5", -3.5, "'+x", "ok"]


def test_every_table_for_spreadsheets_is_written_in_one_place() -> None:
    """But for the campaign's own run table, which calib reads back and which therefore holds what was given.

    A reader turns rows of text into columns in memory; nobody opens that.
    """
    writers = {
        str(path.relative_to(ROOT))
        for path in (ROOT / "calib").rglob("*.py")
        if re.search(r"csv\.(Dict)?[wW]riter\(|\.to_csv\(", path.read_text(encoding="utf-8"))
    }
    assert writers == {"calib/documents.py", "calib/campaign/__init__.py", "calib/campaign/readers/delimited.py"}


def test_a_description_and_an_export_steer_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Names of folders and campaigns reach standard output as escapes, and JSON stays JSON."""
    folder = tmp_path / "a\x1b[2Jb"
    shutil.copytree(CORRIDOR, folder)
    path = folder / "campaign.toml"
    path.write_text(path.read_text(encoding="utf-8").replace('name = "', 'name = "\\u001b[2J', 1), encoding="utf-8")
    for to in ("json", "c", "csv", "ros2"):
        assert run(["export", str(folder), "--to", to, *(["--load", "400"] if to == "ros2" else [])]) == 0
        shown = capsys.readouterr()
        assert _is_clean(shown.out + shown.err)
        if to == "json":
            assert json.loads(shown.out)["name"].startswith("\x1b[2J")
    assert run(["ingest", str(folder), "--describe"]) == 0
    shown = capsys.readouterr()
    assert _is_clean(shown.out + shown.err)


def test_json_to_a_fifo_is_written_and_never_replaces_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    read: list[bytes] = []
    reader = threading.Thread(target=lambda: read.append(fifo.read_bytes()))
    reader.start()
    assert run(["check", str(CORRIDOR), "--json", str(fifo)]) == 0
    reader.join(timeout=30)
    assert json.loads(read[0])["campaign"] == "corridor"
    assert fifo.is_fifo()
    capsys.readouterr()


def test_devices_and_fifos_are_no_inputs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An endless device is refused at once, and nothing waits for a FIFO."""
    os.mkfifo(tmp_path / "runs.csv")
    for arguments in (
        ["check", "/dev/zero"],
        ["export", "/dev/zero", "--to", "json"],
        ["ingest", str(tmp_path / "runs.csv"), "--into", str(tmp_path / "out")],
        ["check", str(tmp_path)],
    ):
        assert run(arguments) == 2, arguments
        assert capsys.readouterr().err.count("\n") == 1


def test_a_reader_that_goes_away_is_no_fault() -> None:
    """``calib ... | head -1`` ends with 141 or 0, without a line."""
    process = subprocess.Popen(
        [sys.executable, "-m", "calib", "export", str(CORRIDOR), "--to", "json"],
        env=_environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    assert process.stdout is not None
    process.stdout.close()
    error = process.stderr.read() if process.stderr is not None else b""
    assert process.wait() in {0, 141}
    assert b"bug" not in error


@pytest.mark.parametrize("seconds", [0.05, 0.4])
def test_an_interruption_is_one_line_at_any_moment(seconds: float) -> None:
    """Imports included; before Python itself is up nothing can be promised."""
    process = subprocess.Popen(
        [sys.executable, "-X", "importtime", "-c", FRONT, "report", str(CORRIDOR), "--into", os.devnull + "x/r.pdf"],
        env=_environment(),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
    )
    assert process.stderr is not None
    lines = []
    for line in process.stderr:
        lines.append(line)
        if b"calib.cli" in line and b"import time" in line:
            # the program's own code has begun
            break
    time.sleep(seconds)
    process.send_signal(signal.SIGINT)
    rest = [line for line in process.stderr if not line.startswith(b"import time")]
    status = process.wait()
    assert status in {130, 2}
    assert len(rest) == 1, rest
    assert b"Traceback" not in b"".join(rest)
