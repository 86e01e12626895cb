"""Tables of every format: title rows, units beneath the header, sheets; times as loggers write them; damage."""

from __future__ import annotations

import datetime
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.campaign.model import Note
from calib.campaign.readers import Layout, read_table
from calib.campaign.readers.table import moment_ns, moments_ns, numbers, object_array, time_format
from calib.errors import BadFileError

ROWS = "Lauf;Strecke [mm];Richtung\nLauf 1;40250,5;hin\nLauf 2;41000,25;zurück\n"
PREAMBLES = {
    "none": "",
    "logger": "Datenlogger DL-8, Firmware 2.1\nNummer: 12-345\n\nKanal 1, Kanal 2\nStart: 04.05.2026\nOhne Gewähr\n",
    "title of a spreadsheet": "Messkampagne Halle 3;;\n;;\n",
    "keys and values": "Gerät;DL-8\nDatum;04.05.2026\n\n",
}


@pytest.mark.parametrize("preamble", PREAMBLES)
def test_the_header_is_found_beneath_a_preamble(preamble: str, tmp_path: Path) -> None:
    """The same table what stands above it; rows are named by their place in the file."""
    path = tmp_path / "table.csv"
    path.write_text(PREAMBLES[preamble] + ROWS, encoding="utf-8")
    table = read_table(path, "table", lambda name: name.startswith("Strecke"))
    assert table.columns["Strecke [mm]"].tolist() == [40250.5, 41000.25]
    lines = PREAMBLES[preamble].count("\n")
    assert table.line.tolist() == [lines + 2, lines + 3]
    assert list(read_table(path, "table").columns) == ["Lauf", "Strecke [mm]", "Richtung"]


def test_a_header_row_that_is_named_is_taken(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text("a,b,c\n1,2,3\nx,y,z\n4,5,6\n")
    assert read_table(path, "t", lambda name: True, Layout(header_row=3)).columns["y"].tolist() == [5.0]
    with pytest.raises(BadFileError, match="header in row 9"):
        read_table(path, "t", None, Layout(header_row=9))


def test_units_beneath_the_header_join_it(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("Zeit;Weg;Links\n[ms];mm;\n0;1,5;10\n10;2,5;20\n")
    assert list(read_table(path, "log", lambda name: True).columns) == ["Zeit [ms]", "Weg [mm]", "Links"]


def test_the_sheet_with_the_table_is_found_and_another_can_be_named(tmp_path: Path) -> None:
    import openpyxl

    book = openpyxl.Workbook()
    book.active.title = "Deckblatt"
    book.active.append(["Messkampagne Halle 3"])
    for name, value in (("Läufe", 1.5), ("Alt", 9.5)):
        sheet = book.create_sheet(name)
        sheet.append(["Messprotokoll", None, None, None])
        sheet.append([])
        sheet.append(["Lauf", "Strecke [mm]", None, "Datum"])
        sheet.append(["Lauf 1", value, None, "04.05.2026"])
    path = tmp_path / "book.xlsx"
    book.save(path)
    found = read_table(path, "book")
    assert found.columns["Strecke [mm]"].tolist() == [1.5]
    assert found.line.tolist() == [4]
    assert read_table(path, "book", None, Layout(sheet="Alt")).columns["Strecke [mm]"].tolist() == [9.5]
    with pytest.raises(BadFileError, match="Deckblatt, Läufe, Alt"):
        read_table(path, "book", None, Layout(sheet="Neu"))


def test_times_of_the_clock_become_seconds_with_an_exact_start(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("Zeit;L\n2026-05-04T10:15:30.250+02:00;1\n2026-05-04T10:15:30.270+02:00;2\n")
    table = read_table(path, "log", lambda name: True)
    np.testing.assert_allclose(table.columns["Zeit"], [0.0, 0.02], atol=1e-15)
    assert table.epochs == {"Zeit": 1777882530_250000000}


def test_decimal_commas_in_a_comma_file_are_explained(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("run_id,distance_m\na,40,2505\n")
    with pytest.raises(BadFileError, match=r"row 2: found 3 cells; expected 2.*semicolons where commas are decimal"):
        read_table(path, "t")


def test_parquet_time_stamps_are_exact(tmp_path: Path) -> None:
    pa = pytest.importorskip("pyarrow")
    import pyarrow.parquet as pq

    times = 1777888999_123456789 + np.arange(3) * 20_000_001
    path = tmp_path / "t.parquet"
    pq.write_table(pa.table({"time": pa.array(times, pa.timestamp("ns")), "left": [1, 2, 3]}), path)
    table = read_table(path, "t", lambda name: True)
    assert table.epochs == {"time": int(times[0])}
    np.testing.assert_allclose(table.columns["time"], np.arange(3) * 0.020000001, atol=1e-15)


def test_bytes_that_are_no_text_are_named_with_their_column(tmp_path: Path) -> None:
    """They are met only where the column is looked into."""
    pa = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    offsets = pa.py_buffer(np.array([0, 3], np.int32).tobytes())
    texts = pa.Array.from_buffers(pa.string(), 1, [None, offsets, pa.py_buffer(b"ab\xa8")])
    path = tmp_path / "runs.parquet"
    parquet.write_table(pa.table({"run_id": texts}), path)
    with pytest.raises(BadFileError, match="column run_id: found a damaged parquet file"):
        read_table(path, "runs.parquet")


@given(
    st.datetimes(
        min_value=datetime.datetime(1970, 1, 2),
        max_value=datetime.datetime(2150, 1, 1),
        timezones=st.sampled_from([datetime.timezone(datetime.timedelta(minutes=m)) for m in (-300, 0, 60, 330)]),
    )
)
def test_iso_8601_is_what_python_reads(moment: datetime.datetime) -> None:
    since = moment - datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC)
    expected = (since.days * 86_400 + since.seconds) * 10**9 + since.microseconds * 1000
    assert moment_ns(moment.isoformat()) == expected
    assert time_format(moment.isoformat()) == "iso8601"


@pytest.mark.parametrize(
    ("text", "same"),
    [
        ("2026-05-04T10:15:30.250Z", "2026-05-04T12:15:30.25+02:00"),
        ("2026-05-04 10:15:30,250", "2026-05-04T10:15:30.25Z"),
        ("04.05.2026 10:15:30,250", "2026-05-04T10:15:30.25Z"),
        ("2026-05-04T10:15:30.123456789Z", "2026-05-04T10:15:30.123456789+00:00"),
        ("2026-05-04 10:15", "2026-05-04T10:15:00Z"),
    ],
)
def test_other_spellings_mean_the_same(text: str, same: str) -> None:
    assert moment_ns(text) == moment_ns(same)


def test_a_time_of_day_runs_on_over_midnight() -> None:
    times, bad = moments_ns(["23:59:59.5", "00:00:00.5", "00:00:01.5"])
    assert bad is None
    assert np.diff(times).tolist() == [10**9, 10**9]


@pytest.mark.parametrize("text", ["2026-13-01T00:00:00", "2026-02-30T00:00:00", "25:00:00", "10:61:00", "soon"])
def test_what_is_no_time_is_refused(text: str) -> None:
    with pytest.raises(ValueError):
        moment_ns(text)


@pytest.mark.parametrize(
    ("cells", "words"),
    [
        (("18/05/2026 10:15:30,250", "18/05/2026 10:15:31"), "day/month/year"),
        (("05/18/2026, 10:15:30.250 AM", "05/18/2026, 10:15:31 AM"), "month/day/year"),
        (("2026/05/18 10:15:30.250", "2026/05/18 10:15:31"), "ISO 8601"),
    ],
)
def test_days_between_slashes_are_read_by_the_cell_that_shows_their_order(
    cells: tuple[str, str], words: str, tmp_path: Path
) -> None:
    """The same moment in three countries; seconds from the first, and the order is said."""
    (tmp_path / "log.csv").write_text("when;x\n" + "".join(f"{cell};1\n" for cell in cells))
    table = read_table(tmp_path / "log.csv", "log", lambda _: True)
    assert table.epochs["when"] == moment_ns("2026-05-18T10:15:30.250Z")
    np.testing.assert_array_equal(table.columns["when"], [0.0, 0.75])
    assert any(words in note.text for note in table.notes)


@pytest.mark.parametrize(("text", "hour"), [("12:05:00 AM", 0), ("12:05:00 PM", 12), ("1:05:00 pm", 13)])
def test_half_days_are_read(text: str, hour: int) -> None:
    assert moment_ns(f"05/18/2026 {text}", month_first=True) == moment_ns(f"2026-05-18T{hour:02}:05:00Z")


def test_what_was_not_measured_is_empty_and_counted() -> None:
    """Words for it are few and known: any other text in a column of numbers is refused."""
    cells = object_array(["1.5", "n.a.", "N/A", "k.A.", "--", "?", "-", "", None])
    notes: list[Note] = []
    values, _ = numbers(cells, shown="t", column="c", line=np.arange(2, 11), notes=notes)
    np.testing.assert_array_equal(np.isfinite(values), [True] + [False] * 8)
    assert [(note.code, note.text.partition(" ")[0]) for note in notes] == [("not_measured", "5")]
    for text in ("??", "---", "defekt", "k.B."):
        with pytest.raises(BadFileError):
            numbers(object_array(["1", text]), shown="t", column="c", line=np.arange(2))
