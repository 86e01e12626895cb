"""What a mapping may say of a source: units as people write them, lookups, cells filled down, names of logs."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from calib.campaign.ingest import expected_name, fits_name
from calib.campaign.ingest.build import ingest
from calib.campaign.ingest.describe import describe
from calib.campaign.ingest.mapping import LogSection, MappedColumn, unit_spelled, units_for
from calib.campaign.ingest.proposal_table import name_pattern
from calib.campaign.model import Campaign
from calib.campaign.read import log_totals
from calib.errors import CalibError
from calib.types import GRAVITY_MPS2, SUFFIXES, unit_named

RUNS = "Run;Label;Day;Dist\n;;;mm\n1;A;Mon;40100\n2;B;;40200\n3;A;Tue;40300\n4;B;;40400\n"
MAPPING = 'counts_left = {value = 1000}\ncounts_right = {value = 1001}\nrun_id = "Run"\nkind = {value = "corridor"}\n'


def _made(folder: Path, lines: str, source: Path | None = None) -> tuple[Campaign, list[str]]:
    if source is None:
        source = folder / "runs.csv"
        source.write_text(RUNS)
    (folder / "m.toml").write_text(f"[table]\n{MAPPING}{lines}")
    done = ingest([source], folder / "c", mapping=folder / "m.toml", dry_run=True)
    return done.campaign, [note.text for note in done.notes]


def _workbook(folder: Path) -> Path:
    import openpyxl

    book = openpyxl.Workbook()
    for row in RUNS.splitlines():
        book.active.append([float(cell) if cell.isdigit() else cell or None for cell in row.split(";")])
    sheet = book.create_sheet("Payloads")
    for cells in (["Label", "Mass", "Left"], [None, "t", "kg"], ["a", 0.1, 40.0], ["B ", 0.2, 45.5]):
        sheet.append(cells)
    book.save(folder / "runs.xlsx")
    return folder / "runs.xlsx"


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("mm/s", "mmps"), ("km/h", "kmh"), ("°C", "C"), ("deg C", "C"), ("metres", "m"), ("Grad", "deg"), ("sec", "s"),
        ("µs", "us"), ("Millimeter", "mm"), ("kN", "kN"), ("K", "K"), ("grad", None), ("hh:mm", None), ("", None),
    ],
)  # fmt: skip
def test_units_are_read_as_people_write_them(text: str, unit: str | None) -> None:
    assert unit_named(text) == unit
    assert unit_spelled(text) == (unit or text)


@pytest.mark.parametrize(
    ("text", "unit"), [("ticks", "counts"), ("U/min", "rpm"), ("°", "deg"), ("rev", "turns"), ("cnt/s", "counts/s")]
)
def test_so_are_those_of_wheels(text: str, unit: str) -> None:
    assert MappedColumn(column="c", unit=text).wheel_unit == unit


def test_a_wrong_unit_lists_those_that_may_be(tmp_path: Path) -> None:
    with pytest.raises(CalibError, match=r"distance_m: found 'ells'; expected one of m, mm, cm, km, um"):
        _made(tmp_path, 'distance_m = {column = "Dist", unit = "ells"}\n')
    assert set(units_for("load_left_N")) == {unit for unit, (to, _, _) in SUFFIXES.items() if to in {"N", "kg"}}


@pytest.mark.parametrize("name", ["Dist", "Dist [mm]"])
def test_a_column_is_named_with_or_without_its_unit(name: str, tmp_path: Path) -> None:
    made, _ = _made(tmp_path, f'distance_m = "{name}"\n')
    np.testing.assert_allclose(made.runs.number("distance_m"), [40.1, 40.2, 40.3, 40.4])


def test_a_constant_is_added_in_the_unit_of_the_line(tmp_path: Path) -> None:
    """(40100 mm * 0.5 + 60 mm); 90 degrees less a compass, clockwise from north, is counter-clockwise from east."""
    made, _ = _made(tmp_path, 'distance_m = {column = "Dist", factor = 0.5, offset = 60.0}\n')
    np.testing.assert_allclose(made.runs.number("distance_m"), [20.11, 20.16, 20.21, 20.26])
    log = tmp_path / "a.csv"
    log.write_text("t_s,counts_left,counts_right,Compass\n" + "".join(f"{k},{k},{k},{80 + k}\n" for k in range(9)))
    line = 'ref_theta_rad = {column = "Compass", unit = "deg", factor = -1, offset = 90}\n'
    mapping = tmp_path / "log.toml"
    mapping.write_text(f'[log]\n{line}[reference]\nframe = "map"\n')
    headings = ingest([log], tmp_path / "logged", mapping=mapping).campaign.logs.of(0)["ref_theta_rad"]
    np.testing.assert_allclose(headings, np.radians(10.0 - np.arange(9.0)), atol=1e-9)


@pytest.mark.parametrize(("line", "said"), [('"Dist [bar]"', True), ('{column = "Dist [bar]", factor = 1.1}', False)])
def test_a_unit_that_a_column_cannot_have_is_said(line: str, said: bool, tmp_path: Path) -> None:
    source = tmp_path / "bar.csv"
    source.write_text("Run,Dist [bar]\n1,4.1\n2,4.2\n")
    _, notes = _made(tmp_path, f"distance_m = {line}\n", source)
    assert any("[bar] is no unit of distance_m" in note for note in notes) == said


def test_values_are_looked_up_on_another_sheet_and_weighed(tmp_path: Path) -> None:
    """Labels in any case and spacing; tonnes become kg, and a load in kg its weight."""
    lines = 'payload_kg = {column = "Mass", sheet = "Payloads", by = "Label"}\n'
    lines += 'load_left_N = {column = "Left", sheet = "Payloads", by = "Label"}\n'
    made, _ = _made(tmp_path, lines, _workbook(tmp_path))
    np.testing.assert_allclose(made.runs.number("payload_kg"), [100, 200, 100, 200])
    np.testing.assert_allclose(made.runs.number("load_left_N"), GRAVITY_MPS2 * np.array([40.0, 45.5, 40.0, 45.5]))
    text = describe([tmp_path / "runs.xlsx"]).to_toml()
    assert 'payload_kg = {column = "Mass [t]", sheet = "Payloads", by = "Label"}' in text, text


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ('{column = "Mass", sheet = "Payload", by = "Label"}', "a sheet 'Payload'"),
        ('{column = "Mess", sheet = "Payloads", by = "Label"}', "column Mess: found only Label, Mass"),
        ('{column = "Mass", sheet = "Payloads", by = "Labels"}', "the column that `by` names"),
        ('{column = "Mass", sheet = "Payloads", by = "Run"}', "no label '1', which row 3"),
        ('{column = "Mass", sheet = "Payloads"}', "by a column of the run table"),
    ],
)
def test_a_lookup_that_fails_says_where(line: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(CalibError, match=words) as caught:
        _made(tmp_path, f"payload_kg = {line}\n", _workbook(tmp_path))
    assert "\n" not in str(caught.value)


def test_sessions_that_are_missing_are_said_or_filled_down(tmp_path: Path) -> None:
    made, said = _made(tmp_path, 'session = "Day"\n')
    assert made.runs.label("session").tolist() == ["Mon", "", "Tue", ""]
    assert any("2 of 4 rows name no session" in text for text in said)
    made, said = _made(tmp_path, 'session = {column = "Day", fill_down = true}\n')
    assert made.runs.label("session").tolist() == ["Mon", "Mon", "Tue", "Tue"]
    assert not any("name no session" in text for text in said)


def test_rows_at_the_end_that_name_no_run_are_omitted(tmp_path: Path) -> None:
    (tmp_path / "runs.csv").write_text(RUNS + ";;;40250\n;;;161000\n")
    made, said = _made(tmp_path, 'distance_m = "Dist"\n', tmp_path / "runs.csv")
    assert len(made.runs) == 4
    assert sum("names no run" in text for text in said) == 2


@pytest.mark.parametrize(
    ("wanted", "name", "fits"),
    [
        ("{date}_{time}_TR7.csv", "20260504_081500_TR7.csv", True),
        ("{date}_{time}_TR7.csv", "2026-05-04_08-15_tr7.CSV", True),
        ("{date}_{time}_TR7.csv", "20260504_081500_TR17.csv", False),
        ("*_7.csv", "anything (2)_7.csv", True),
        ("log+7.csv", "log+7.csv", True),
        ("log+7.csv", "logg7.csv", False),
    ],
)
def test_names_of_logs_may_hold_a_time(wanted: str, name: str, fits: bool) -> None:
    assert fits_name(name, wanted) == fits


@pytest.mark.parametrize("given", ["{stem}.csv", "{stem}", "data\\\\day 1\\\\{stem}.csv"])
def test_a_column_of_the_names_of_logs_is_taken_for_them(given: str, tmp_path: Path) -> None:
    """Each run has the log that its row names, by any name of the column."""
    rows, logs = ["No;Filename;Dist [m]"], []
    for number in range(4):
        stem = f"2026-11-2{number}_10-3{number}-22_drive"
        rows.append(f"{number + 1};{given.format(stem=stem)};{10 + number}")
        logs.append(tmp_path / f"{stem}.csv")
        logs[-1].write_text("t_s,enc_l,enc_r\n" + "".join(f"{at},{at * (number + 2)},{at * 9}\n" for at in range(30)))
    (tmp_path / "runs.csv").write_text("\n".join(rows) + "\n")
    sources = [tmp_path / "runs.csv", *logs[::-1]]
    proposed = describe(sources).to_toml()
    assert 'log = "Filename"' in proposed
    assert "file =" not in proposed
    (tmp_path / "m.toml").write_text(proposed)
    campaign = ingest(sources, tmp_path / "c", mapping=tmp_path / "m.toml").campaign
    assert log_totals(campaign.logs, "counts_left").tolist() == [29.0 * (number + 2) for number in range(4)]


@pytest.mark.parametrize(
    ("stems", "pattern"),
    [
        (["2026-05-04_09-00_Fahrt01", "2026-05-04_09-07_Fahrt02"], "{date}_{time}_Fahrt{n:02}"),
        (["20260504T091500_TR9", "20260505T091500_TR10"], "{date}T{time}_TR{n}"),
        (["run 01 (take 1)", "run 02 (take 1)"], "run {n:02} (take 1)"),
        (["Lauf_1_am", "Lauf_2_pm"], "Lauf_{n}_*"),
        (["TR1_1204", "TR2_1207"], "TR{n}_*"),
        (["first", "second"], None),
    ],
)
def test_what_the_names_of_logs_have_in_common_is_proposed(stems: list[str], pattern: str | None) -> None:
    """And the pattern finds each of them, by its own number."""
    assert name_pattern(stems) == pattern
    for stem in stems if pattern else ():
        number = next(n for n in (1, 2, 9, 10) if re.search(rf"(Fahrt|TR|run |Lauf_)0?{n}(?!\d)", stem))
        wanted = expected_name(LogSection(file=f"{pattern}.csv"), f"Run {number}")
        assert wanted is not None
        assert [fits_name(f"{other}.csv", wanted) for other in stems] == [other == stem for other in stems]


@pytest.mark.parametrize(
    ("header", "cells", "line"),
    [
        ("Hallentemp. [°C]", ("20.5", "21"), 'temperature_C = "Hallentemp. [°C]"'),
        ("Dist. [mm]", ("40100", "40200"), 'distance_m = "Dist. [mm]"'),
        ("Payload mass [kg]", ("50", "100"), 'payload_kg = "Payload mass [kg]"'),
        ("End heading [°]", ("1.5", "2.5"), 'ref_theta_rad = "End heading [°]"'),
        ("Datum", ("2026-05-04", "2026-05-05"), 'session = "Datum"'),
        ("Payload", ("heavy", "light"), None),
        ("Speed", ("slow", "fast"), None),
    ],
)
def test_the_proposal_finds_columns_and_takes_no_text_for_a_number(
    header: str, cells: tuple[str, str], line: str | None, tmp_path: Path
) -> None:
    rows = [f"{number + 1};{cells[number % 2]};{number * 1.5}" for number in range(4)]
    (tmp_path / "runs.csv").write_text(f"Run;{header};x\n" + "\n".join(rows) + "\n")
    text = describe([tmp_path / "runs.csv"]).to_toml()
    if line is None:
        assert f'"{header}"' not in text
    else:
        assert line in text.splitlines(), text


def test_a_description_prints_what_stands_in_the_file(tmp_path: Path) -> None:
    """No example of a format in place of a cell."""
    (tmp_path / "log.csv").write_text("Zeit;links\n" + "".join(f"04.05.2026 10:15:{s:02},250;{s}\n" for s in range(50)))
    text = describe([tmp_path / "log.csv"]).to_toml()
    assert "04.05.2026 10:15:00,250" in text
    assert "30,250" not in text and "2026-05-04T" not in text


def test_other_kinds_of_logs_are_said(tmp_path: Path) -> None:
    """Files whose names do not say which belong together: what to do with them stands in the proposal."""
    (tmp_path / "enc_1.csv").write_text("t,enc_left,enc_right\n" + "".join(f"{k},{9 * k},{8 * k}\n" for k in range(50)))
    (tmp_path / "cam_2.csv").write_text("t,x,y,yaw\n" + "".join(f"{k},{9 * k}.5,{8 * k},0\n" for k in range(50)))
    text = describe([tmp_path / "enc_1.csv", tmp_path / "cam_2.csv"]).to_toml()
    assert "2 kinds of logs: those of a run are joined by files" in text


def _split(folder: Path, n_runs: int = 3) -> tuple[list[np.ndarray], Path]:
    """Write runs of three files each: one a wheel and a rangefinder, each with a clock of its own in nanoseconds."""
    epoch_ns, driven = 1_779_095_400_000_000_000, []
    (folder / "data").mkdir(parents=True)
    for run in range(1, n_runs + 1):
        time = np.arange(400) / 20
        left, right = 100.0 * np.arange(400) + run, 101.0 * np.arange(400)
        driven.append(right)
        start = epoch_ns + run * 600_000_000_000
        parts = {
            "enc_left": ("ticks", time, left % 2**16),
            # a node that begins 120 ms later
            "enc_right": ("ticks", time + 0.12, np.interp(time + 0.12, time, right, right=np.nan) % 2**16),
            "laser": ("dist_mm", time[::4], 2000.0 + 5.0 * np.arange(400)[::4]),
        }
        for name, (column, at, values) in parts.items():
            known = np.isfinite(values)
            rows = [f"{start + round(1e9 * t)},{x:.0f}\n" for t, x in zip(at[known], values[known], strict=True)]
            (folder / "data" / f"T{run:03}_{name}.csv").write_text(f"stamp_ns,{column}\n" + "".join(rows))
    rows = [f"T{run:03},{run}\n" for run in range(1, n_runs + 1)]
    (folder / "trials.csv").write_text("trial,mass on deck (kg)\n" + "".join(rows))
    return driven, folder


@pytest.mark.parametrize("with_table", [True, False])
def test_the_files_of_a_run_are_joined_by_time(with_table: bool, tmp_path: Path) -> None:
    """As proposed: counts of both wheels at the same times, distances from the start; with a run table or without."""
    driven, lab = _split(tmp_path / "lab")
    sources = [lab / "trials.csv", lab / "data"] if with_table else [lab / "data"]
    text = describe(sources).to_toml()
    assert 'enc_left = "T{n:03}_enc_left.csv"' in text and 'counts_right = "enc_right:ticks"' in text, text
    (tmp_path / "m.toml").write_text(text)
    made = ingest(sources, tmp_path / "c", mapping=tmp_path / "m.toml")
    assert made.n_logs == len(made.campaign.runs) == len(driven)
    assert {Path(name).name for name in made.sources} >= {"T001_enc_left.csv", "T001_enc_right.csv", "T001_laser.csv"}
    for run, right in enumerate(driven):
        log = made.campaign.logs.of(run)
        # samples before the right wheel's first are omitted
        counts = log["counts_right"] - log["counts_right"][0]
        assert len(right) - 5 < len(counts) < len(right)
        np.testing.assert_allclose(counts, right[3:][: len(counts)] - right[3], atol=1.01)
        np.testing.assert_allclose(np.diff(log["counts_left"]), 100.0)
        measured = log["range_m"][np.isfinite(log["range_m"])]
        np.testing.assert_allclose(np.diff(measured), 0.005, atol=1e-6)


def test_a_run_without_one_of_its_files_is_said(tmp_path: Path) -> None:
    _, lab = _split(tmp_path / "lab")
    (lab / "data" / "T002_laser.csv").unlink()
    sources = [lab / "trials.csv", lab / "data"]
    (tmp_path / "m.toml").write_text(describe(sources).to_toml())
    made = ingest(sources, tmp_path / "c", mapping=tmp_path / "m.toml")
    assert made.campaign.runs.excluded.tolist() == [False, True, False]
    assert any("no log T002_laser.csv was found" in note.text for note in made.notes)


@pytest.mark.parametrize("kind", ["xlsx", "csv"])
def test_runs_may_stand_in_columns(kind: str, tmp_path: Path) -> None:
    """A merged title, units in the second column, days merged over the runs of each: proposed, and read, as rows."""
    rows: list[list[object]] = [
        ["Campaign of AGV-7", None, None, None, None, None],
        ["Run", None, "R1", "R2", "R3", "R4"],
        ["Date", None, "2026-05-18", None, "2026-05-19", None],
        ["Direction", None, "forth", "back", "forth", "back"],
        ["Payload", "kg", 0, 50, 100, 150],
        ["Distance", "mm", 40865.1, 39666.5, 37316.6, 37319.9],
    ]
    path = tmp_path / f"protocol.{kind}"
    if kind == "xlsx":
        import openpyxl

        book = openpyxl.Workbook()
        for row in rows:
            book.active.append(row)
        for cells in ("A1:F1", "C3:D3", "E3:F3"):
            book.active.merge_cells(cells)
        book.save(path)
    else:
        rows[2] = ["Date", None, "2026-05-18", "2026-05-18", "2026-05-19", "2026-05-19"]
        path.write_text("\n".join(";".join("" if cell is None else str(cell) for cell in row) for row in rows) + "\n")
    text = describe([path]).to_toml()
    assert 'runs_in = "columns"' in text
    (tmp_path / "m.toml").write_text(text)
    runs = ingest([path], tmp_path / "c", mapping=tmp_path / "m.toml").campaign.runs
    assert runs.run_id.tolist() == ["R1", "R2", "R3", "R4"]
    assert runs.label("session").tolist() == ["2026-05-18"] * 2 + ["2026-05-19"] * 2
    assert runs.label("direction").tolist() == ["out", "back"] * 2
    assert runs.number("payload_kg").tolist() == [0.0, 50.0, 100.0, 150.0]
    np.testing.assert_allclose(runs.number("distance_m"), [40.8651, 39.6665, 37.3166, 37.3199])


def test_a_folder_may_hold_the_table_beside_a_folder_of_logs(tmp_path: Path) -> None:
    """The laboratory's folder alone is named; a campaign made inside it is no source."""
    driven, lab = _split(tmp_path / "lab")
    (lab / "old").mkdir()
    (lab / "old" / "campaign.toml").write_text('name = "old"\n')
    (lab / "old" / "runs.csv").write_text("run_id\na\n")
    description = describe([lab])
    assert description.table is not None and description.table.name.endswith("trials.csv")
    assert description.n_files == 1 + 3 * len(driven)
    (tmp_path / "m.toml").write_text(description.to_toml())
    made = ingest([lab], tmp_path / "c", mapping=tmp_path / "m.toml")
    assert made.campaign.runs.run_id.tolist() == ["T001", "T002", "T003"]
    assert made.campaign.runs.number("payload_kg").tolist() == [1.0, 2.0, 3.0]
    assert made.n_logs == len(driven)
