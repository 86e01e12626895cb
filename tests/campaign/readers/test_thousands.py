"""Marks between thousands, base 16, names in an upper row, further units, and clocks that start again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import openpyxl
import pytest

from calib.campaign.checks.counts import clock
from calib.campaign.ingest import file_contents
from calib.campaign.ingest.describe import describe
from calib.campaign.logs import from_first_sample
from calib.campaign.model import Border, Logs
from calib.campaign.readers.table import comma_evidence, numbers, object_array
from calib.campaign.settings import Encoder, recognise
from calib.errors import BadFileError
from tests.campaign.making import campaign, with_log_columns


def read(*cells: str, beside: tuple[str, ...] = ()) -> list[float]:
    column = object_array(cells)
    evidence = comma_evidence([column, object_array(beside)])
    line = np.arange(2, 2 + len(cells))
    return numbers(column, shown="runs.csv", column="load", line=line, decimal_comma=evidence)[0].tolist()


@pytest.mark.parametrize(
    ("cells", "beside", "expected"),
    [
        (("300", "900", "1.200"), ("39,6595",), [300.0, 900.0, 1200.0]),
        (("300,0", "1.100,0"), (), [300.0, 1100.0]),
        (("39.287,5", "40.012,5"), (), [39287.5, 40012.5]),
        (("39 287,5",), (), [39287.5]),
        (("1,100", "900"), ("39.6595",), [1100.0, 900.0]),
        (("0x0003E6BB", "0x10"), (), [255675.0, 16.0]),
        (("39.287", "40.012"), (), [39.287, 40.012]),
        # a logger's times beside counters of five digits, which have no marks
        (("3,200", "3,300"), ("81454", "81460"), [3.2, 3.3]),
    ],
)
def test_what_reads_in_one_way_is_read(cells: tuple[str, ...], beside: tuple[str, ...], expected: list[float]) -> None:
    assert read(*cells, beside=beside) == expected


@pytest.mark.parametrize("cells", [("300", "900", "1.200"), ("1,234", "2,345"), ("16", "0x10")])
def test_what_reads_in_two_ways_is_refused(cells: tuple[str, ...]) -> None:
    with pytest.raises(BadFileError, match="column load"):
        read(*cells)


def test_the_proposal_names_such_a_column_and_counts_its_cells(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    rows = "".join(f"r{n};{load};{load};39,65{n:02}\n" for n, load in enumerate(["300", "600", "900", "1.200"] * 3))
    path.write_text("Lauf;Radlast links [N];Radlast rechts [N];Strecke [m]\n" + rows, encoding="utf-8")
    proposed = describe([path]).to_toml()
    assert 'load_left_N = "Radlast links [N]"' in proposed
    assert "3 cells were read as is '1.200': as 1200" in " ".join(proposed.replace("#", " ").split())


def test_a_column_that_only_the_upper_row_names_keeps_its_name(tmp_path: Path) -> None:
    book = openpyxl.Workbook()
    for row in (
        ["Lauf", "Radlast", None, "Weg"],
        [None, "links", "rechts"],
        ["r1", 300, 320, 40.1],
        ["r2", 600, 640, 41],
    ):
        book.active.append(row)
    book.save(tmp_path / "a.xlsx")
    names = [column.name for column in file_contents(tmp_path / "a.xlsx").columns]
    assert names == ["Lauf", "Radlast links", "Radlast rechts", "Weg"]


@pytest.mark.parametrize(("name", "factor"), [("distance (in)", 0.0254), ("distance [ft]", 0.3048)])
def test_feet_and_inches(name: str, factor: float) -> None:
    found = recognise(name, ("distance_m",))
    assert (found.name, found.factor) == ("distance_m", factor)


@pytest.mark.parametrize("bits", [8, 14, 32])
def test_counters_of_any_usual_width(bits: int) -> None:
    from pydantic import TypeAdapter

    assert TypeAdapter(Encoder).validate_python({"wrap_bits": bits}).wrap_bits == bits


def test_days_are_proposed_for_the_times_of_a_spreadsheet(tmp_path: Path) -> None:
    path = tmp_path / "log_1.csv"
    rows = "".join(f"{46083.41 + n * 0.1 / 86400:.8f};{5 * n};{5 * n + n % 2}\n" for n in range(60))
    path.write_text("Zeit;Geber links;Geber rechts\n" + rows.replace(".", ","), encoding="utf-8")
    assert 't_s = {column = "Zeit", unit = "day"}' in describe([path]).to_toml()


def test_a_clock_of_32_bits_goes_on() -> None:
    columns = {"t_s": ((2**32 - 500 + 100 * np.arange(20)) % 2**32) / 1e3}
    from_first_sample(columns, "log", Border(lenient=False))
    np.testing.assert_allclose(np.diff(columns["t_s"]), 0.1, atol=1e-6)


def test_a_rate_that_no_logger_has_is_wrong() -> None:
    driven = campaign()
    days = with_log_columns(driven, t_s=driven.logs.columns["t_s"] / 86400.0)
    assert isinstance(days.logs, Logs)
    assert [note.code for note in clock(days)] == ["sample_rate"]


def test_a_year_has_no_mark_anywhere_and_leaves_a_comma_unclear() -> None:
    with pytest.raises(BadFileError, match="column load"):
        read("3,200", "3,300", beside=("2024", "2025"))
