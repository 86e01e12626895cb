"""Workbooks of a laboratory: readings at start and end, runs on several sheets, wheels in turns and degrees."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calib.campaign.ingest.build import ingest
from calib.campaign.ingest.describe import describe
from calib.campaign.model import Campaign
from calib.errors import BadFileError
from calib.types import GRAVITY_MPS2

#: metres and counts of three runs
WAY_M, LEFT, RIGHT = (20.1, 19.9, 20.05), (131361, 129811, 130700), (131106, 129561, 130450)


def _workbook(path: Path, sheets: dict[str, Sequence[Sequence[Any]]]) -> Path:
    import openpyxl

    book = openpyxl.Workbook()
    book.remove(book.active)
    for name, rows in sheets.items():
        sheet = book.create_sheet(name)
        for row in rows:
            sheet.append(row)
    book.save(path)
    return path


def _as_proposed(source: Path, change: tuple[str, str] = ("", "")) -> tuple[Campaign, str]:
    """Return the campaign that the proposal gives, and the proposal."""
    text = describe([source]).to_toml()
    mapping = source.with_suffix(".toml")
    mapping.write_text(text.replace(*change), encoding="utf-8")
    return ingest([source], source.parent / "c", mapping=mapping, dry_run=True).campaign, text


@pytest.mark.parametrize(
    ("header", "ahead"),
    [
        ("Lauf;Laser Anfang [mm];Laser Ende [mm];Zähler L Start;Zähler L Ende;Zähler R vor;Zähler R nach", True),
        ("Run;Distance start [mm];Distance end [mm];Enc L 0;Enc L 1;Enc R before;Enc R after", False),
        ("Essai;Télémètre début [mm];Télémètre fin [mm];Codeur G début;Codeur G fin;Codeur D avant;Codeur D fin", True),
    ],
    ids=["German", "English", "French"],
)
def test_readings_at_start_and_end_are_subtracted(header: str, ahead: bool, tmp_path: Path) -> None:
    """A distance to a target ahead falls, one to a target behind rises; counters go on from run to run."""
    rows: list[Sequence[Any]] = [header.split(";")]
    left, right = 1000, 2000
    for n, way in enumerate(WAY_M):
        laser = (45000.5, 45000.5 - 1000 * way) if ahead else (300.25, 300.25 + 1000 * way)
        rows.append((n + 1, *laser, left, left + LEFT[n], right, right + RIGHT[n]))
        left, right = left + LEFT[n], right + RIGHT[n]
    runs = _as_proposed(_workbook(tmp_path / "w.xlsx", {"Daten": rows}))[0].runs
    np.testing.assert_allclose(runs.number("distance_m"), WAY_M, rtol=1e-12)
    np.testing.assert_array_equal(runs.number("counts_left"), LEFT)
    np.testing.assert_array_equal(runs.number("counts_right"), RIGHT)
    assert runs.covariates == ()


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ('distance_m = {column = "b", minus = "no"}', "no"),
        ('distance_m = {minus = "a", value = 3}', "minus"),
        ('distance_m = {column = "b", minus = "a", sheet = "x", by = "Run"}', "minus"),
        ('counts_left = {column = "b", unit = "rpm"}', "turns, rad or deg"),
    ],
)
def test_lines_that_cannot_be_are_refused(line: str, expected: str, tmp_path: Path) -> None:
    """The message names the line and what it may say."""
    (tmp_path / "r.csv").write_text("Run;a;b\nx;1;21\ny;1;22\n")
    (tmp_path / "m.toml").write_text(f'[table]\nrun_id = "Run"\nkind = {{value = "corridor"}}\n{line}\n')
    with pytest.raises(BadFileError, match=expected):
        ingest([tmp_path / "r.csv"], tmp_path / "c", mapping=tmp_path / "m.toml", dry_run=True)


def test_a_log_has_no_second_reading(tmp_path: Path) -> None:
    """`minus` belongs to the run table."""
    (tmp_path / "r.csv").write_text("t_s,counts_left,counts_right\n0,0,0\n1,5,5\n")
    (tmp_path / "m.toml").write_text('[log]\ncounts_left = {column = "counts_left", minus = "t_s"}\n')
    with pytest.raises(BadFileError, match=r"\[table\] alone"):
        ingest([tmp_path / "r.csv"], tmp_path / "c", mapping=tmp_path / "m.toml", dry_run=True)


HEADER = ("Nr", "Strecke [m]", "Impulse links", "Impulse rechts")


def test_sheets_of_one_load_each_are_read_one_after_another(tmp_path: Path) -> None:
    """Names of runs that come again get the sheet's before them, and the sheets' names say the payload."""
    rows = [HEADER, *((n + 1, WAY_M[n], LEFT[n], RIGHT[n]) for n in range(3))]
    sheets = {"leer": rows, "mit 62,5 kg": rows, "Notizen": [("neue Reifen",)]}
    campaign, _ = _as_proposed(_workbook(tmp_path / "w.xlsx", sheets))
    runs = campaign.runs
    assert list(runs.run_id) == [f"{sheet} {n}" for sheet in ("leer", "mit 62,5 kg") for n in (1, 2, 3)]
    np.testing.assert_array_equal(runs.number("payload_kg"), [0, 0, 0, 62.5, 62.5, 62.5])
    np.testing.assert_array_equal(runs.number("counts_left"), LEFT * 2)


def test_runs_on_several_sheets_stand_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    """Drift is judged in the order driven, which a sheet a load does not keep."""
    first = [HEADER, *((n, WAY_M[0], LEFT[0], RIGHT[0]) for n in (1, 3, 11))]
    second = [HEADER, *((n, WAY_M[1], LEFT[1], RIGHT[1]) for n in (2, 4, 12))]
    runs = _as_proposed(_workbook(tmp_path / "w.xlsx", {"leer": first, "80 kg": second}))[0].runs
    assert list(runs.run_id) == ["1", "2", "3", "4", "11", "12"]
    np.testing.assert_array_equal(runs.number("payload_kg"), [0, 80, 0, 80, 0, 80])


def test_sheets_of_a_wheel_each_are_joined_by_the_run(tmp_path: Path) -> None:
    """Angles and loads stand on both under the same name; the way is that of the first."""
    header = ("Run", "Distance (ft)", "Rotation (deg)", "Load (N)")
    sheets = {
        f"{side} wheel": [header, *((n, WAY_M[n] / 0.3048, counts[n] * 360 / 4096, 300 + n) for n in range(3))]
        for side, counts in (("Left", LEFT), ("Right", RIGHT))
    }
    text = ("#counts_per_rev =", "counts_per_rev = 4096 #")
    runs = _as_proposed(_workbook(tmp_path / "w.xlsx", sheets), text)[0].runs
    np.testing.assert_allclose(runs.number("distance_m"), WAY_M, rtol=1e-12)
    np.testing.assert_allclose(runs.number("counts_left"), LEFT, rtol=1e-9)
    np.testing.assert_allclose(runs.number("counts_right"), RIGHT, rtol=1e-9)
    np.testing.assert_array_equal(runs.number("load_right_N"), [300, 301, 302])


def test_files_of_a_wheel_each_are_joined_by_the_run(tmp_path: Path) -> None:
    """In an order of their own and under one name; the command that is proposed names the run table first."""
    folder = tmp_path / "lab"
    folder.mkdir()
    (folder / "runs.csv").write_text("run,distance_m\n" + "".join(f"r{n},{WAY_M[n]}\n" for n in range(3)))
    for side, counts in (("left", LEFT), ("right", RIGHT)):
        rows = [f"r{n},{counts[n]}\n" for n in ((2, 0, 1) if side == "left" else (1, 2, 0))]
        (folder / f"counter_{side}.csv").write_text("run,counts\n" + "".join(rows))
    description = describe([folder])
    assert description.sources == (str(folder / "runs.csv"), str(folder))
    mapping = tmp_path / "m.toml"
    mapping.write_text(description.to_toml())
    sources = [Path(source) for source in description.sources]
    ingested = ingest(sources, tmp_path / "c", mapping=mapping)
    np.testing.assert_array_equal(ingested.campaign.runs.number("counts_left"), LEFT)
    np.testing.assert_array_equal(ingested.campaign.runs.number("counts_right"), RIGHT)
    assert str(folder / "counter_left.csv") in ingested.sources
    with pytest.raises(BadFileError, match=r"found 'counter_left'; expected the name of one further source"):
        ingest(sources[:1], tmp_path / "d", mapping=mapping)


def test_a_row_for_each_quantity_is_told_from_a_row_pasted_twice(tmp_path: Path) -> None:
    table = tmp_path / "long.csv"
    rows = (f"r{n},{what},{n}.5,{n}.7\n" for n in range(3) for what in ("turns", "load", "distance"))
    table.write_text("run_id,quantity,rear left,rear right\n" + "".join(rows))
    with pytest.raises(BadFileError, match="give what stands in several rows of a run columns of their own"):
        ingest([table], tmp_path / "c")


def test_turns_and_the_load_of_an_axle_are_proposed(tmp_path: Path) -> None:
    """Half of the axle's load on each wheel; turns become counts."""
    rows = [f"{n + 1};aller;61,2;{100 * WAY_M[n]:.2f};{LEFT[n] / 4096:.6f};{RIGHT[n] / 4096:.6f}" for n in range(3)]
    header = "Essai n°;Sens;Charge essieu arrière (kg);Distance (cm);Tours roue gauche;Tours roue droite"
    source = tmp_path / "essais.csv"
    source.write_text("\n".join([header, *rows]).replace(".", ","), encoding="latin-1")
    runs = _as_proposed(source, ("#counts_per_rev =", "counts_per_rev = 4096 #"))[0].runs
    for side, counts in (("left", LEFT), ("right", RIGHT)):
        np.testing.assert_allclose(runs.number(f"load_{side}_N"), 0.5 * 61.2 * GRAVITY_MPS2, rtol=1e-12)
        np.testing.assert_allclose(runs.number(f"counts_{side}"), counts, rtol=1e-7)


@pytest.mark.parametrize("comment", [(), ("Comment",)])
def test_a_group_names_the_last_columns_and_their_unit(comment: tuple[str, ...], tmp_path: Path) -> None:
    """Cells merged over the last columns end their row early; the group's unit is that of each column under it."""
    rows: list[Sequence[Any]] = [
        ("Run", "Distance [m]", "Encoder", None, "Wheel load [kg]", *([None, *comment] if comment else [])),
        (None, None, "L", "R", "L", "R"),
        *((n + 1, WAY_M[n], LEFT[n], RIGHT[n], 30.0 + n, 40.0) for n in range(3)),
    ]
    runs = _as_proposed(_workbook(tmp_path / "w.xlsx", {"Runs": rows}))[0].runs
    np.testing.assert_allclose(runs.number("load_left_N"), GRAVITY_MPS2 * np.array([30.0, 31.0, 32.0]), rtol=1e-12)
    np.testing.assert_allclose(runs.number("load_right_N"), 40.0 * GRAVITY_MPS2, rtol=1e-12)


def test_a_unit_that_each_cell_repeats_is_the_columns(tmp_path: Path) -> None:
    """Also beside decimal commas and a mean; a text that is no unit stays one."""
    rows = [f"R{n};{1000 * WAY_M[n]:.1f} mm;{LEFT[n]};{RIGHT[n]};{n} m/x".replace(".", ",") for n in range(3)]
    source = tmp_path / "runs.csv"
    source.write_text("\n".join(["Lauf;Strecke;Geber L;Geber R;Notiz", *rows, "Mittel;20016,7 mm;;;"]))
    campaign, text = _as_proposed(source)
    np.testing.assert_allclose(campaign.runs.number("distance_m"), WAY_M, rtol=1e-12)
    assert 'distance_m = "Strecke [mm]"' in text
    assert "not used: Notiz" in text


def test_sheets_of_a_day_each_are_sessions_where_the_mapping_says_so(tmp_path: Path) -> None:
    """Names that are there once stay as they are, and a column that one sheet lacks is empty there."""
    first = [HEADER, *((f"a{n}", WAY_M[n], LEFT[n], RIGHT[n]) for n in range(3))]
    second = [HEADER, *((f"b{n}", WAY_M[n], LEFT[n], RIGHT[n]) for n in range(3))]
    source = _workbook(tmp_path / "w.xlsx", {"Montag": first, "Dienstag": second})
    campaign, text = _as_proposed(source, ("#session", "session"))
    assert '#session = "sheet"' in text
    assert list(campaign.runs.run_id) == ["a0", "a1", "a2", "b0", "b1", "b2"]
    assert list(campaign.runs.label("session")) == ["Montag"] * 3 + ["Dienstag"] * 3


@pytest.mark.parametrize(("unit", "turn"), [("turns", 1.0), ("deg", 360.0), ("rad", 2.0 * np.pi)])
def test_wheels_of_a_run_table_may_be_angles(unit: str, turn: float, tmp_path: Path) -> None:
    """What a wheel turned in a run, times the counts of a revolution."""
    rows = [f"{n},{way},{left / 4096 * turn!r},{right / 4096 * turn!r}" for n, (way, left, right) in
            enumerate(zip(WAY_M, LEFT, RIGHT, strict=True))]  # fmt: skip
    source = tmp_path / "r.csv"
    source.write_text("\n".join(["Run,Distance [m],L,R", *rows]))
    mapping = tmp_path / "m.toml"
    lines = [f'{calib} = {{column = "{column}", unit = "{unit}"}}' for calib, column in
             (("counts_left", "L"), ("counts_right", "R"))]  # fmt: skip
    mapping.write_text('[encoder]\ncounts_per_rev = 4096\n[table]\nrun_id = "Run"\ndistance_m = "Distance [m]"\n'
                       'kind = {value = "corridor"}\n' + "\n".join(lines))  # fmt: skip
    runs = ingest([source], tmp_path / "c", mapping=mapping, dry_run=True).campaign.runs
    np.testing.assert_allclose(runs.number("counts_left"), LEFT, rtol=1e-9)
    np.testing.assert_allclose(runs.number("counts_right"), RIGHT, rtol=1e-9)


LENGTHS = "Strecke [mm];Impulse links;Impulse rechts;Radlast links [N];Radlast rechts [N]"


def _lengths(path: Path, name: str, cells: Sequence[str]) -> Path:
    rows = [f"{cell};{20000 + n % 7};{131361 + n % 5};{131106 + n % 3};300;301" for n, cell in enumerate(cells)]
    path.write_text("\n".join([f"{name};{LENGTHS}", *(row.removeprefix(";") for row in rows)]).removeprefix(";") + "\n")
    return path


@pytest.mark.parametrize(
    ("name", "cells"),
    [
        ("", [""] * 12),
        ("Datum", [f"0{1 + n // 6}.03.2026" for n in range(12)]),
        ("Uhrzeit", [f"08:{7 * n // 60:02}:{7 * n % 60:02}" for n in range(12)]),
        ("Pos", [str(n + 1) for n in range(12)]),
    ],
    ids=["nothing", "dates", "times seconds apart", "a running number"],
)
def test_runs_without_a_name_are_numbered(name: str, cells: Sequence[str], tmp_path: Path) -> None:
    """Distances and counts beside loads, without the clock of a log, are runs in the order of their rows."""
    runs = _as_proposed(_lengths(tmp_path / "t.csv", name, cells))[0].runs
    assert list(runs.run_id) == [f"r{n:03}" for n in range(1, 13)]
    assert ("session" in runs.labels) == (name == "Datum")
    np.testing.assert_allclose(runs.number("distance_m"), [20 + n % 7 / 1000 for n in range(12)])


@pytest.mark.parametrize(
    ("name", "cells"),
    [
        ("Zeit [s]", [f"{0.1 * n:.1f}" for n in range(60)]),
        ("Zeit", [str(n) for n in range(60)]),
        ("Stempel", [f"08:00:{n // 10:02},{n % 10}" for n in range(60)]),
        ("Uhr", [f"{0.02 * n:.2f}" for n in range(60)]),
    ],
)
def test_samples_beside_a_clock_are_a_log(name: str, cells: Sequence[str], tmp_path: Path) -> None:
    """With any name of the clock, and loads and distances beside it."""
    assert describe([_lengths(tmp_path / "t.csv", name, cells)]).table is None


def test_the_load_of_an_axle_stands_back_behind_those_of_its_wheels(tmp_path: Path) -> None:
    """One line for each wheel's load: two would be no mapping."""
    rows = [f"{n};{WAY_M[n]};{LEFT[n]};{RIGHT[n]};80;{30 + n};{50 - n}" for n in range(3)]
    header = "Run;Distance [m];Enc L;Enc R;Axle load [kg];Load left [kg];Load right [kg]"
    source = tmp_path / "runs.csv"
    source.write_text("\n".join([header, *rows]))
    runs = _as_proposed(source)[0].runs
    np.testing.assert_allclose(runs.number("load_left_N"), GRAVITY_MPS2 * np.array([30.0, 31.0, 32.0]), rtol=1e-12)
