"""Time and memory grow with what is useful in an input; beyond a stated size one line says so."""

from __future__ import annotations

import re
import time
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from calib import campaign as tables
from calib import errors
from calib.campaign.readers import read_table
from calib.campaign.readers.workbook import check_size
from calib.cli.main import run
from calib.errors import BadFileError, refuse_hostile_keys
from calib.gap.effects import library
from tests.fuzz.sound import ROOT, small_campaign

#: twice the content takes twice the time, and as much again for a busy machine; four times would be the square
MOST_GROWTH = 3.0
#: processor time in which a hostile input is refused, imports included; the smallest of those cured took 18 s
REFUSED_S = 5.0


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    return small_campaign(tmp_path / "C")


def _append(text: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        with (folder / "campaign.toml").open("a", encoding="utf-8") as stream:
            stream.write(f"\n{text}\n")

    return change


def _in_settings(old: str, new: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        path = folder / "campaign.toml"
        path.write_text(re.sub(old, new, path.read_text(encoding="utf-8"), count=1), encoding="utf-8")

    return change


def _in_runs(change_cells: Callable[[list[str]], None]) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        path = folder / "runs.csv"
        rows = [line.split(",") for line in path.read_text(encoding="utf-8").splitlines()]
        for cells in rows[1:]:
            change_cells(cells)
        path.write_text("\n".join(map(",".join, rows)) + "\n", encoding="utf-8")

    return change


def _many_columns(folder: Path) -> None:
    path = folder / "runs.csv"
    header, *rows = path.read_text(encoding="utf-8").splitlines()
    names = [f"c{number}" for number in range(errors.COLUMNS)]
    text = "\n".join([",".join([header, *names]), *(row + ",1" * errors.COLUMNS for row in rows)])
    path.write_text(text + "\n", encoding="utf-8")


HOSTILE: dict[str, tuple[Callable[[Path], None], str]] = {
    "a dotted key of 200 kB": (_append("a." * 100_000 + "b = 1"), "a key of more than 32 parts"),
    "a dotted section of 200 kB": (_append("[" + "a." * 100_000 + "b]\nc = 1"), "a key of more than 32 parts"),
    "nested lists": (_append("q = " + "[" * 50 + "]" * 50), "more than 32 deep"),
    "lists beyond the parser": (_append("q = " + "[" * 50_000 + "]" * 50_000), "no valid TOML"),
    "a long key": (_append("k" * 100_000 + " = 1"), "characters in a key; expected at most 200"),
    "a long text": (_append(f'q = "{"x" * 100_000}"'), "100000 characters; expected at most 20000"),
    "a long name": (_in_settings(r'(?m)^name = "', 'name = "' + "n" * 10_000), "expected at most 500"),
    "settings of 5 MB": (_append("# " + "x" * (5 << 20)), "bytes; expected at most 4194304"),
    "labels of 10^5 characters": (
        _in_runs(lambda cells: cells.__setitem__(0, cells[0] + "x" * 100_000)),
        "100004 characters; expected at most 500",
    ),
    "too many columns": (_many_columns, "columns; expected at most 5000"),
}  # fmt: skip


@pytest.mark.parametrize("name", list(HOSTILE))
def test_a_size_beyond_its_limit_is_one_line_and_quick(
    name: str, campaign: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What took 18 to 200 s is refused at once, with the limit."""
    change, words = HOSTILE[name]
    change(campaign)
    started = time.process_time()
    assert run(["check", str(campaign)]) == 2
    assert time.process_time() - started < REFUSED_S
    err = capsys.readouterr().err
    assert words in err
    assert err.count("\n") == 1


def test_too_many_runs_and_too_many_causes_are_said(
    campaign: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Held with smaller limits, so that the test is quick."""
    with monkeypatch.context() as patched:
        patched.setattr(tables, "RUNS", 5)
        assert run(["check", str(campaign)]) == 2
        assert "12 runs; expected at most 5; divide the campaign" in capsys.readouterr().err
    _append('[[effects]]\nid = "own"\ncolumn = "speed_mps"\nacts_on = "both"\ntypical = 0.001\nlargest = 0.01')(
        campaign
    )
    monkeypatch.setattr(library, "COVARIATES", 0)
    assert run(["diagnose", str(campaign)]) == 2
    assert "expected at most 0; keep the columns that could matter" in capsys.readouterr().err


def _workbook(path: Path, rows: str) -> Path:
    import openpyxl

    openpyxl.Workbook().save(path.with_suffix(".plain"))
    sheet = (
        '<worksheet xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"><sheetData>'
        '<row r="1"><c r="A1" t="inlineStr"><is><t>run_id</t></is></c>'
        f'<c r="B1" t="inlineStr"><is><t>distance_m</t></is></c></row>{rows}</sheetData></worksheet>'
    )
    with (
        zipfile.ZipFile(path.with_suffix(".plain")) as source,
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as target,
    ):
        for entry in source.infolist():
            is_sheet = entry.filename == "xl/worksheets/sheet1.xml"
            target.writestr(entry.filename, sheet if is_sheet else source.read(entry.filename))
    return path


@pytest.mark.parametrize(
    "rows",
    [
        "".join(f'<row r="{row}"><c r="XFD{row}"><v>1</v></c></row>' for row in range(2, 2000)),
        '<row r="1048576"><c r="B1048576"><v>1</v></c></row>',
    ],
    ids=["cells far to the right", "a cell far below"],
)
def test_a_small_workbook_that_spreads_widely_is_refused(
    rows: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """15 kB that lay out 33 million places, 2 kB that lay out a million rows."""
    path = _workbook(tmp_path / "w.xlsx", rows)
    assert path.stat().st_size < 20_000
    started = time.process_time()
    assert run(["ingest", str(path), "--describe"]) == 2
    assert time.process_time() - started < REFUSED_S
    assert "empty places between the cells; expected at most 1000000" in capsys.readouterr().err


def test_rows_that_hold_nothing_below_the_table_are_passed_over(tmp_path: Path) -> None:
    """A column formatted down to the sheet's end is no content: the table above is read, and nothing else."""
    cells = "".join(f'<row r="{row}"><c r="A{row}"><v>{row}</v></c><c r="B{row}"><v>1</v></c></row>' for row in (2, 3))
    empty = "".join(f'<row r="{row}"><c r="A{row}" s="0"/></row>' for row in range(4, 30_000))
    path = _workbook(tmp_path / "w.xlsx", cells + empty)
    assert check_size(path, "w.xlsx") == 3
    assert len(read_table(path, "w.xlsx").line) == 2


def test_a_workbook_with_more_than_may_be_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Bytes, sheets, texts and cells each have their limit."""
    path = _workbook(tmp_path / "w.xlsx", '<row r="2"><c r="A2"><v>1</v></c></row>')
    for name, what in (("SHEET_UNPACKED_BYTES", "bytes unpacked"), ("SHEETS", "sheets"), ("SHEET_CELLS", "cells")):
        with monkeypatch.context() as patched:
            patched.setattr(f"calib.errors.{name}", 0)
            with pytest.raises(BadFileError, match=f"found .* {what}; expected at most 0"):
                check_size(path, "w.xlsx")


def test_a_part_that_is_listed_as_many_sheets_counts_as_many(tmp_path: Path) -> None:
    path = _workbook(tmp_path / "w.xlsx", '<row r="2"><c r="A2"><v>1</v></c></row>')
    many = "".join(f'<sheet name="s{number}" sheetId="{number}" r:id="rId1"/>' for number in range(1, 20_001))
    with zipfile.ZipFile(path) as source, zipfile.ZipFile(tmp_path / "many.xlsx", "w") as target:
        for entry in source.infolist():
            data = source.read(entry.filename).decode() if entry.filename == "xl/workbook.xml" else ""
            begin, end = data.find("<sheets>"), data.find("</sheets>")
            changed = f"{data[: begin + 8]}{many}{data[end:]}".encode()
            target.writestr(entry.filename, changed if data else source.read(entry.filename))
    with pytest.raises(BadFileError, match=r"found (20,?000) sheets; expected at most 200"):
        check_size(tmp_path / "many.xlsx", "many.xlsx")


def _settings_text(size: int) -> Callable[[], None]:
    text = "".join(f"[[a{number}]]\nx = {{y = [1.0, 2.0], z = 'q.q'}}\n" for number in range(size))
    return lambda: refuse_hostile_keys(text, "settings")


def _checked(base: Path, size: int) -> Callable[[], None]:
    folder = small_campaign(base / str(size))
    path = folder / "runs.csv"
    header, *rows = path.read_text(encoding="utf-8").splitlines()
    path.write_text(
        "\n".join([header, *(f"q{number:05d}{rows[3 + number % 9][4:]}" for number in range(size))]) + "\n",
        encoding="utf-8",
    )
    return lambda: (run(["check", str(folder)]), run(["fit", str(folder)]))[0] and None


def _read_workbook(base: Path, size: int) -> Callable[[], None]:
    rows = "".join(
        f'<row r="{row}"><c r="A{row}"><v>{row}</v></c><c r="B{row}"><v>1</v></c></row>' for row in range(2, size)
    )
    path = _workbook(base / f"{size}.xlsx", rows)
    return lambda: read_table(path, "w.xlsx") and None


@pytest.mark.parametrize(
    ("size", "job"),
    [
        (20_000, lambda base, size: _settings_text(size)),
        (800, _checked),
        (2_000, _read_workbook),
    ],
    ids=["settings", "check and fit", "workbook"],
)
def test_twice_the_content_takes_no_more_than_about_twice_the_time(
    size: int, job: Callable[[Path, int], Callable[[], None]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Processor time, the better of two, after a first call that pays for the imports."""
    small, large = job(tmp_path, size), job(tmp_path, 2 * size)
    small()
    seconds = [min(_seconds(task), _seconds(task)) for task in (small, large)]
    capsys.readouterr()
    assert seconds[1] < MOST_GROWTH * seconds[0] + 0.05


def _seconds(task: Callable[[], None]) -> float:
    started = time.process_time()
    task()
    return time.process_time() - started


def test_every_limit_stands_in_the_documentation() -> None:
    text = (ROOT / "docs" / "robustness.md").read_text(encoding="utf-8")
    for name in (name for name in vars(errors) if not name.startswith("_")):
        value = getattr(errors, name)
        if isinstance(value, int):
            shown = f"{value >> 20} MiB" if name.endswith("BYTES") else f"{value:,}"
            assert shown in text, (name, shown)
