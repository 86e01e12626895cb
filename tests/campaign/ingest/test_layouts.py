"""Layouts of laboratories' tables that need nothing but the vehicle's own lines: two commands give the campaign."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calib.campaign.ingest.build import ingest
from calib.campaign.ingest.describe import describe
from calib.campaign.model import RunTable

Rows = Sequence[Sequence[Any]]
DISTANCE_M = (39.1, 40.7, 41.3, 38.4, 39.9, 40.6)
LEFT = (250001, 260402, 264003, 245004, 255005, 259006)
RIGHT = (250101, 260502, 264103, 245104, 255105, 259106)
LOAD_N = (300.0, 500.0, 1100.0, 300.0, 500.0, 1100.0)


def _workbook(path: Path, sheets: dict[str, Rows]) -> Path:
    import openpyxl

    book = openpyxl.Workbook()
    book.remove(book.active)
    for name, rows in sheets.items():
        sheet = book.create_sheet(name)
        for row in rows:
            sheet.append(row)
    book.save(path)
    return path


def _as_proposed(tmp_path: Path, *sources: Path) -> RunTable:
    mapping = tmp_path / "lab.toml"
    mapping.write_text(describe(sources).to_toml(), encoding="utf-8")
    return ingest(sources, tmp_path / "c", mapping=mapping, dry_run=True).campaign.runs


def _is_whole(runs: RunTable) -> None:
    order = np.argsort(runs.number("counts_left"))
    assert runs.number("counts_left")[order].tolist() == sorted(LEFT)
    assert runs.number("counts_right")[order].tolist() == sorted(RIGHT)
    np.testing.assert_allclose(runs.number("distance_m")[order], sorted(DISTANCE_M))


@pytest.mark.parametrize(
    ("load", "counts"),
    [("Load (N)", "Counts"), ("Load", "Counts"), ("Load (N)", "Counts [-]"), ("F", "Encoder counts")],
)
def test_names_beneath_a_name_that_spans_columns_are_no_units(load: str, counts: str, tmp_path: Path) -> None:
    head = [("Run", "Session", "Distance (m)", "Left wheel", None, "Right wheel", None)]
    head += [(None, None, None, load, counts, load, counts)]
    rows = [(n + 1, "A", DISTANCE_M[n], LOAD_N[n], LEFT[n], LOAD_N[n] + 10, RIGHT[n]) for n in range(len(LEFT))]
    runs = _as_proposed(tmp_path, _workbook(tmp_path / "w.xlsx", {"Runs": [*head, *rows]}))
    _is_whole(runs)
    if load != "F":
        assert runs.number("load_left_N").tolist() == list(LOAD_N)
        assert runs.number("load_right_N").tolist() == [load + 10 for load in LOAD_N]


def test_sheets_of_a_load_in_newtons_are_the_wheels_loads(tmp_path: Path) -> None:
    head = ("Run", "Day", "Distance [m]", "Enc L", "Enc R")
    sheets = {
        f"{load:.0f} N": [
            head,
            *((n + 1, "d", DISTANCE_M[n], LEFT[n], RIGHT[n]) for n in range(6) if LOAD_N[n] == load),
        ]
        for load in sorted({*LOAD_N})
    }
    runs = _as_proposed(tmp_path, _workbook(tmp_path / "w.xlsx", sheets))
    _is_whole(runs)
    assert runs.number("load_left_N").tolist() == runs.number("load_right_N").tolist() == list(LOAD_N)


@pytest.mark.parametrize("far", [False, True])
def test_x_and_y_beside_a_payload_are_its_place_where_they_lie_on_the_vehicle(far: bool, tmp_path: Path) -> None:
    """Forty metres away they are where the run ended."""
    head = ("Run", "Date", "Payload (kg)", "x (cm)", "y (cm)", "Distance (m)", "Pulses left", "Pulses right")
    stamps = [f"2026-05-0{4 + n // 3} 09:{7 * n:02}:00" for n in range(6)]
    rows = [
        (n + 1, stamps[n], 60, 3500 if far else 35, -20, DISTANCE_M[n], LEFT[n], RIGHT[n]) for n in range(len(LEFT))
    ]
    runs = _as_proposed(tmp_path, _workbook(tmp_path / "w.xlsx", {"Runs": [head, *rows]}))
    _is_whole(runs)
    assert len({*runs.label("session").tolist()}) == 2
    assert ("payload_x_m" in runs.numbers) != far
    assert runs.number("payload_y_m").tolist() == [-0.2] * 6


def test_headings_above_their_rows_are_sessions(tmp_path: Path) -> None:
    """Runs are numbered anew beneath each, so that their numbers are no names."""
    rows: list[Sequence[Any]] = [("No", "Load left N", "Load right N", "S / m", "Counts left", "Counts right", "ok?")]
    for n in range(len(LEFT)):
        rows += [(f"Day {1 + n // 3}",)] if n % 3 == 0 else []
        rows.append((1 + n % 3, LOAD_N[n], LOAD_N[n], DISTANCE_M[n], LEFT[n], RIGHT[n], "x"))
    runs = _as_proposed(tmp_path, _workbook(tmp_path / "w.xlsx", {"Data": rows}))
    _is_whole(runs)
    assert runs.label("session").tolist() == ["Day 1"] * 3 + ["Day 2"] * 3
    assert runs.run_id.tolist() == [f"r{n:03}" for n in range(1, 7)]


def test_a_remark_among_rows_makes_no_sessions(tmp_path: Path) -> None:
    rows: list[Sequence[Any]] = [("Run", "Distance (m)", "Enc L", "Enc R")]
    rows += [(n + 1, DISTANCE_M[n], LEFT[n], RIGHT[n]) for n in range(len(LEFT))]
    rows[3:3], rows[6:6] = [("Break 1",)], [("Break 2",)]
    runs = _as_proposed(tmp_path, _workbook(tmp_path / "w.xlsx", {"Data": rows}))
    _is_whole(runs)
    assert "section" not in {*runs.labels, *runs.numbers}


@pytest.mark.parametrize("a_file", [1, 3])
def test_files_of_the_same_columns_are_one_table(a_file: int, tmp_path: Path) -> None:
    """A file a run, or a file a day."""
    sources = []
    for first in range(0, len(LEFT), a_file):
        rows = [f"{n + 1},s{1 + n // 3},{DISTANCE_M[n]},{LEFT[n]},{RIGHT[n]}" for n in range(first, first + a_file)]
        sources.append(tmp_path / f"run_{first + 1:02}.csv")
        sources[-1].write_text("\n".join(["run,session,distance_m,counts_left,counts_right", *rows]) + "\n")
    runs = _as_proposed(tmp_path, *sources)
    _is_whole(runs)
    assert runs.label("session").tolist() == ["s1"] * 3 + ["s2"] * 3
    whole = ingest(sources, tmp_path / "d", mapping=tmp_path / "lab.toml", dry_run=True)
    assert {str(source) for source in sources} < set(whole.sources)


def test_motion_capture_names_its_columns_in_four_rows_and_points_its_y_up(tmp_path: Path) -> None:
    """Names that stand twice above numbers are no header; the axis that hardly moves is up; the unit is named above."""
    t = np.linspace(0.0, 20.0, 401)
    heading = 0.3 * t
    east, north = 2000.0 * np.sin(heading), -2000.0 * np.cos(heading)
    head = [
        "Format Version,1.23,Take Name,Take,Capture Frame Rate,120,Length Units,Millimeters",
        "",
        ",Type,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body",
        ",Name,AGV,AGV,AGV,AGV,AGV,AGV,AGV",
        ",ID,12,12,12,12,12,12,12",
        ",,Rotation,Rotation,Rotation,Rotation,Position,Position,Position",
        "Frame,Time (Seconds),X,Y,Z,W,X,Y,Z",
    ]
    turn = np.sin(heading / 2), np.cos(heading / 2)
    columns = (np.arange(401), t, 0 * t, turn[0], 0 * t, turn[1], north, 150.0 + 0.0 * t, east)
    rows = [",".join(f"{value:.6f}" for value in row) for row in zip(*columns, strict=True)]
    (tmp_path / "take.csv").write_text("\n".join([*head, *rows]) + "\n")
    lines = [line.partition("   #")[0] for line in describe([tmp_path / "take.csv"]).to_toml().splitlines()]
    assert 'ref_x_m = "Position Z [mm]"' in lines
    assert 'ref_y_m = "Position X [mm]"' in lines
    assert 'ref_theta_rad = {column = "Rotation Y", w = "Rotation W"}' in lines
