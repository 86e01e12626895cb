"""Where runs stand: on sheets, by date and time, counted from 0, in files of a session, in sparse rows, by a column."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib.campaign.ingest.build import ingest
from calib.campaign.ingest.describe import describe
from calib.campaign.model import Campaign
from calib.errors import CalibError

N_SAMPLES = 160
TIME_S = np.arange(N_SAMPLES) / 20
#: metres of a run, standing first and last
PATH_M = np.cumsum(np.clip(np.minimum(TIME_S - 1, 6 - TIME_S), 0, 1)) / 20
DISTANCES_M = (5.0, 5.5, 6.0, 4.5, 5.2)


def _counts(run: int, per_m: float = 8000.0) -> np.ndarray:
    return np.rint(per_m * PATH_M * DISTANCES_M[run] / PATH_M[-1])


def _text(columns: dict[str, np.ndarray], mark: str = ",") -> str:
    rows = (mark.join(f"{cell:.14g}" for cell in row) for row in zip(*columns.values(), strict=True))
    return "\n".join([mark.join(columns), *rows]) + "\n"


def _log(run: int) -> dict[str, np.ndarray]:
    return {"Zeit [s]": TIME_S, "Geber links": _counts(run), "Geber rechts": _counts(run, 8100.0)}


def _proposed(tmp_path: Path, *sources: Path) -> tuple[str, Campaign]:
    text = describe(sources).to_toml()
    (tmp_path / "proposed.toml").write_text(text, encoding="utf-8")
    return text, ingest(sources, tmp_path / "c", mapping=tmp_path / "proposed.toml", dry_run=True).campaign


def _each_has_its_log(made: Campaign) -> None:
    """The law: what a run's log counts is what its row's distance says."""
    for run, distance_m in enumerate(made.runs.number("distance_m")):
        assert np.ptp(made.logs.of(run)["counts_left"]) == pytest.approx(8000 * distance_m, abs=1)


def _workbook(path: Path, sheet: str) -> Path:
    import openpyxl

    book = openpyxl.Workbook()
    overview = book.active
    overview.title = "Liste"
    overview.append(["Lauf", "Strecke [m]"])
    for run in (3, 0, 4, 1, 2):
        overview.append([run + 1, DISTANCES_M[run]])
        page = book.create_sheet(sheet.format(n=run + 1))
        page.append([*_log(run)])
        for row in zip(*_log(run).values(), strict=True):
            page.append([float(cell) for cell in row])
    book.save(path)
    return path


@pytest.mark.parametrize("sheet", ["Messung {n}", "M{n:02}"])
def test_a_sheet_a_run_is_its_log(sheet: str, tmp_path: Path) -> None:
    text, made = _proposed(tmp_path, _workbook(tmp_path / "hall.xlsx", sheet))
    assert f'sheet = "{sheet}"' in text
    assert made.logs.present.all()
    _each_has_its_log(made)


def test_a_log_section_without_a_log_is_said(tmp_path: Path) -> None:
    book = _workbook(tmp_path / "hall.xlsx", "Messung {n}")
    (tmp_path / "m.toml").write_text('[table]\nrun_id = "Lauf"\n[log]\nsheet = "Messung 1"\nt_s = "Zeit [s]"\n')
    notes = ingest([book], tmp_path / "c", mapping=tmp_path / "m.toml", dry_run=True).notes
    assert [note.level for note in notes if note.code == "no_logs"] == ["suspicious"]


@pytest.mark.parametrize(
    ("head", "row", "name"),
    [
        ("Tag;Uhr;Strecke [m]", "0{day}.05.2026;1{run}:05;{m}", "fahrt_2026-05-0{day}_1{run}-05-31.csv"),
        ("Beginn;Strecke [m]", "2026-05-0{day} 1{run}:05:31;{m}", "0{day}.05.2026 1{run}05 enc.csv"),
    ],
)
def test_logs_are_found_by_the_date_and_time_of_their_row(head: str, row: str, name: str, tmp_path: Path) -> None:
    """Rows out of order, and one run without a log: no run gets the log of another."""
    (tmp_path / "logs").mkdir()
    rows = [head]
    for run in (2, 0, 1, 4, 3):
        rows.append(row.format(day=1 + run // 3, run=run, m=DISTANCES_M[run]))
        if run != 4:
            path = tmp_path / "logs" / name.format(day=1 + run // 3, run=run)
            path.write_text(_text(_log(run), ";"))
    (tmp_path / "liste.csv").write_text("\n".join(rows) + "\n")
    text, made = _proposed(tmp_path, tmp_path / "liste.csv", tmp_path / "logs")
    assert "{date}" in text and "{time}" in text
    assert made.logs.present.tolist() == [True, True, True, False, True]
    for run in (0, 1, 2, 4):
        distance_m = made.runs.number("distance_m")[run]
        assert np.ptp(made.logs.of(run)["counts_left"]) == pytest.approx(8000 * distance_m, abs=1)


def test_a_log_in_a_format_that_is_not_read_is_named_with_those_that_are(tmp_path: Path) -> None:
    """The third of five lies beside the others as JSON."""
    (tmp_path / "logs").mkdir()
    rows = ["Lauf;Strecke [m]", *(f"F{run};{DISTANCES_M[run]}" for run in range(5))]
    for run in range(5):
        (tmp_path / "logs" / f"F{run}.{'json' if run == 2 else 'csv'}").write_text(_text(_log(run)))
    (tmp_path / "liste.csv").write_text("\n".join(rows) + "\n")
    _, made = _proposed(tmp_path, tmp_path / "liste.csv", tmp_path / "logs")
    (note,) = (note for note in made.notes if note.code == "no_log")
    assert "(F2.json is not read; .csv, .tsv, .txt" in note.text


def test_logs_counted_from_0_belong_to_runs_counted_from_1(tmp_path: Path) -> None:
    (tmp_path / "logs").mkdir()
    rows = ["Lauf;Strecke [m]"]
    for run in range(5):
        rows.append(f"{run + 1};{DISTANCES_M[run]}")
        (tmp_path / "logs" / f"messung{run}.csv").write_text(_text(_log(run)))
    (tmp_path / "liste.csv").write_text("\n".join(rows) + "\n")
    sources = [tmp_path / "liste.csv", tmp_path / "logs"]
    text, made = _proposed(tmp_path, *sources)
    assert 'file = "messung{n-1}.csv"' in text
    _each_has_its_log(made)
    # written without, the cure is named
    (tmp_path / "m.toml").write_text(text.replace("{n-1}", "{n}"))
    notes = ingest(sources, tmp_path / "c", mapping=tmp_path / "m.toml", dry_run=True).notes
    assert any("{n-1}" in note.text and note.level == "suspicious" for note in notes)


def _session(folder: Path) -> list[Path]:
    """Write five runs with standstills as one file of wheels and one of a camera, with a clock each."""
    total = np.concatenate([_counts(run) + sum(8000 * metres for metres in DISTANCES_M[:run]) for run in range(5)])
    time_ms = 50.0 * np.arange(len(total)) + 1.7e12
    wheels = {"stamp_ms": time_ms, "ticks_left": total, "ticks_right": np.rint(total * 1.01)}
    (folder / "wheels.csv").write_text(_text(wheels))
    at_ms = np.arange(time_ms[0] + 3, time_ms[-1], 40.0)
    camera = {"stamp_ms": at_ms, "cam_x_mm": np.interp(at_ms, time_ms, total) / 8, "cam_y_mm": 0.0 * at_ms}
    (folder / "camera.csv").write_text(_text(camera))
    return [folder / "camera.csv", folder / "wheels.csv"]


def test_files_of_a_session_are_joined_and_cut(tmp_path: Path) -> None:
    text, made = _proposed(tmp_path, *_session(tmp_path))
    assert 'files = {camera = "camera.csv", wheels = "wheels.csv"}' in text and 'by = "stops"' in text
    ends = [np.nanmax(made.logs.of(run)["ref_x_m"]) - made.logs.of(run)["ref_x_m"][0] for run in range(len(made.runs))]
    np.testing.assert_allclose(ends, DISTANCES_M, atol=0.005)
    # without a cut the names have to say which run they are of
    (tmp_path / "m.toml").write_text(text.partition("[cut]")[0])
    with pytest.raises(CalibError, match=r"files\.camera: found 'camera\.csv'.*or \[cut\]"):
        ingest(_session(tmp_path), tmp_path / "c", mapping=tmp_path / "m.toml")


def test_rows_without_a_value_of_each_column_give_what_they_have(tmp_path: Path) -> None:
    """One row a message, wheels as angles within a turn: the same path as with all cells filled."""
    angle = 40.0 * PATH_M
    at_s = TIME_S + 0.013
    x = np.interp(at_s, TIME_S, PATH_M)
    rows = [(t, f"{a % (2 * np.pi):.5f},{1.1 * a % (2 * np.pi):.5f},,") for t, a in zip(TIME_S, angle, strict=True)]
    rows += [(t, f",,{p:.5f},0") for t, p in zip(at_s, x, strict=True)]
    # one cell alone is lost
    rows[30] = (rows[30][0], rows[30][1].partition(",")[0] + ",,,")
    body = "\n".join(f"{t:.4f},{cells}" for t, cells in sorted(rows))
    (tmp_path / "a.csv").write_text(f"time_s,wheel_left_rad,wheel_right_rad,cam_x_m,cam_y_m\n{body}\n")
    (tmp_path / "m.toml").write_text(
        '[log]\nt_s = "time_s"\ncounts_left = "wheel_left_rad"\ncounts_right = "wheel_right_rad"\n'
        'ref_x_m = "cam_x_m"\nref_y_m = "cam_y_m"\n[encoder]\ncounts_per_rev = 10000\n'
    )
    made = ingest([tmp_path / "a.csv"], tmp_path / "c", mapping=tmp_path / "m.toml", dry_run=True)
    log = made.campaign.logs.of(0)
    assert len(log["t_s"]) >= N_SAMPLES - 1
    left = np.interp(log["t_s"], TIME_S, angle) / (2 * np.pi) * 10000
    np.testing.assert_allclose(log["counts_left"] - log["counts_left"][0], left, atol=2)
    np.testing.assert_allclose(log["counts_right"] - log["counts_right"][0], 1.1 * left, atol=100)
    np.testing.assert_allclose(log["ref_x_m"][5:-5], np.interp(log["t_s"], TIME_S, PATH_M)[5:-5], atol=0.002)
    assert any(note.code == "empty_cells" for note in made.notes)


def test_empty_increments_are_still_refused(tmp_path: Path) -> None:
    rows = "\n".join(f"{t:.2f},{'' if k == 9 else 5},5" for k, t in enumerate(TIME_S))
    (tmp_path / "a.csv").write_text(f"t_s,l,r\n{rows}\n")
    lines = "".join(f'counts_{side} = {{column = "{side[0]}", unit = "increments"}}\n' for side in ("left", "right"))
    (tmp_path / "m.toml").write_text("[log]\n" + lines)
    with pytest.raises(CalibError, match="an empty cell"):
        ingest([tmp_path / "a.csv"], tmp_path / "c", mapping=tmp_path / "m.toml")


@pytest.mark.parametrize("name", ["Runde", "lap_no", "run"])
def test_a_column_that_counts_laps_is_proposed_to_cut_by(name: str, tmp_path: Path) -> None:
    total = np.concatenate([_counts(run) + sum(8000 * metres for metres in DISTANCES_M[:run]) for run in range(5)])
    number = np.repeat(np.arange(1, 6), N_SAMPLES)
    columns = {"t_s": np.arange(len(total)) / 20, name: number, "ticks_left": total, "ticks_right": total}
    (tmp_path / "all.csv").write_text(_text(columns))
    text, made = _proposed(tmp_path, tmp_path / "all.csv")
    assert f'by = "column"\ncolumn = "{name}"' in text
    assert len(made.runs) == 5


def test_a_distance_counts_from_the_start(tmp_path: Path) -> None:
    """To a target ahead it falls; one behind, 0.45 m from the start, would make each run longer by that."""
    columns = {"t_s": TIME_S, "ticks_left": _counts(0), "ticks_right": _counts(0), "laser_m": 9.0 - PATH_M}
    (tmp_path / "a.csv").write_text(_text(columns))
    text, made = _proposed(tmp_path, tmp_path / "a.csv")
    assert 'range_m = {column = "laser_m", unit = "m", from_start = true}' in text
    assert made.logs.of(0)["range_m"][-1] == pytest.approx(PATH_M[-1], abs=1e-6)
    columns["laser_m"] = PATH_M + 0.45
    (tmp_path / "a.csv").write_text(_text(columns))
    _, made = _proposed(tmp_path, tmp_path / "a.csv")
    assert made.logs.of(0)["range_m"][-1] == pytest.approx(PATH_M[-1], abs=1e-6)


def test_times_of_the_clock_are_times_under_any_name(tmp_path: Path) -> None:
    rows = "\n".join(f"2026-05-04T10:15:{t:06.3f}Z,{c:g},{c:g}" for t, c in zip(TIME_S, _counts(0), strict=True))
    (tmp_path / "a.csv").write_text(f"gps_fix,ticks_left,ticks_right\n{rows}\n")
    text, made = _proposed(tmp_path, tmp_path / "a.csv")
    assert 't_s = "gps_fix"' in text
    np.testing.assert_allclose(made.logs.of(0)["t_s"], TIME_S, atol=1e-6)


@pytest.mark.parametrize(
    ("names", "texts"),
    [
        (("Hjullast V (N)", "Hjullast H (N)"), ("pulser_v", "pulser_h")),
        (("Forza S [N]", "Forza D [N]"), ("impulsi S", "impulsi D")),
    ],
)
def test_letters_of_sides(names: tuple[str, str], texts: tuple[str, str], tmp_path: Path) -> None:
    """Left first, as an alphabet of the language says it; no front wheel and nothing to be checked."""
    (tmp_path / "t.csv").write_text("\n".join([";".join(["No", *names]), *(f"{k};{300 + k};310" for k in range(1, 9))]))
    text = describe([tmp_path / "t.csv"]).to_toml()
    assert f'load_left_N = "{names[0]}"' in text and f'load_right_N = "{names[1]}"' in text
    (tmp_path / "a.csv").write_text(_text({"t_s": TIME_S, texts[0]: _counts(0), texts[1]: _counts(1)}))
    text = describe([tmp_path / "a.csv"]).to_toml()
    assert f'counts_left = "{texts[0]}"\ncounts_right = "{texts[1]}"' in text


@pytest.mark.parametrize(
    ("encoding", "name"), [("cp1250", "Długość [m]"), ("latin-1", "Länge m³ [m]"), ("cp1250", "Odległość [m]")]
)
def test_texts_of_central_europe_keep_their_letters(encoding: str, name: str, tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_bytes(f"Nr;{name}\n1;5,0\n2;6,0\n3;5,5\n".encode(encoding))
    assert name in describe([tmp_path / "t.csv"]).to_toml()


def test_of_two_bodies_the_one_that_moves_is_the_vehicle(tmp_path: Path) -> None:
    """A tracker's export names its bodies above the header; a station stands still beside the vehicle."""
    head = [
        "Format Version,1.23,Take Name,T,Export Frame Rate,20.000000,Length Units,Meters",
        "",
        ",Type," + ",".join(["Rigid Body"] * 6),
        ",Name," + ",".join(["Dock"] * 3 + ["Cart"] * 3),
        ",ID,1,1,1,2,2,2",
        ",," + ",".join(["Position"] * 6),
        "Frame,Time (Seconds),X,Y,Z,X,Y,Z",
    ]
    rows = [
        f"{k},{t:.4f},1.5,0.2,0.7,{0.1 + 1e-4 * k:.4f},0.3,{p:.4f}"
        for k, (t, p) in enumerate(zip(TIME_S, PATH_M, strict=True))
    ]
    (tmp_path / "r1_take.csv").write_text("\n".join([*head, *rows]) + "\n")
    (tmp_path / "r1_wheels.csv").write_text(_text({"t_s": TIME_S, "ticks_left": _counts(0), "ticks_right": _counts(0)}))
    text, made = _proposed(tmp_path, tmp_path / "r1_take.csv", tmp_path / "r1_wheels.csv")
    assert 'ref_x_m = "take:Cart:Position Z [m]"' in text and "bodies: take:Dock, take:Cart" in text
    np.testing.assert_allclose(made.logs.of(0)["ref_x_m"], PATH_M, atol=1e-4)


@pytest.mark.parametrize(
    ("column", "texts"),
    [
        ("Bemerkung", ("ungültig", "", "Tür offen")),
        ("valid", ("no", "yes", "yes")),
    ],
)
def test_remarks_that_void_a_run_are_offered_as_exclusions(column: str, texts: tuple[str, ...], tmp_path: Path) -> None:
    """Commented out, and taken by ingest where the user takes the mark away."""
    rows = [f"{k + 1};{10 + k}.5;{text}" for k, text in enumerate(texts)]
    (tmp_path / "t.csv").write_text("\n".join([f"Run;Distance [m];{column}", *rows]) + "\n")
    text = describe([tmp_path / "t.csv"]).to_toml()
    assert "#excluded = " in text
    (tmp_path / "m.toml").write_text(text.replace("#excluded", "excluded"))
    runs = ingest([tmp_path / "t.csv"], tmp_path / "c", mapping=tmp_path / "m.toml", dry_run=True).campaign.runs
    assert runs.excluded.tolist() == [True, False, False]


def test_a_heading_beside_east_and_north_may_be_a_compass(tmp_path: Path) -> None:
    own = {"t_s": TIME_S, "ticks_left": _counts(0), "ticks_right": _counts(0)}
    for names, hinted in ((("east_m", "north_m", "heading_deg"), True), (("cam_x_m", "cam_y_m", "cam_yaw_deg"), False)):
        (tmp_path / "a.csv").write_text(
            _text(own | dict(zip(names, (PATH_M, 2 * PATH_M, 0 * TIME_S + 30), strict=True)))
        )
        text = describe([tmp_path / "a.csv"]).to_toml()
        assert ("of a compass" in text) == hinted


@pytest.mark.parametrize("beside", [True, False])
def test_a_table_of_unknown_names_is_no_log(beside: bool, tmp_path: Path) -> None:
    """Texts, and no clock: rows of runs. Letters alone are no direction."""
    rows = [f"{k};{'AB'[k % 2]};{300 + k % 3},0;{310 + k % 4},0;{10 + k % 5},5" for k in range(1, 10)]
    (tmp_path / "t.csv").write_text(
        "Passo nr.;Squadra;Carico sx [N];Carico dx [N];Spazio [m]\n" + "\n".join(rows) + "\n"
    )
    sources = [tmp_path / "t.csv"]
    if beside:
        (tmp_path / "a.csv").write_text(_text({"t_s": TIME_S, "ticks_left": _counts(0), "ticks_right": _counts(0)}))
        sources.append(tmp_path / "a.csv")
    text = describe(sources).to_toml()
    assert "[table]" in text
    assert 'load_left_N = "Carico sx [N]"' in text and 'distance_m = "Spazio [m]"' in text
    assert "direction" not in text


def test_run_tables_in_several_folders_are_one_campaign_and_said_to_be(tmp_path: Path) -> None:
    """Of three vehicles by chance: nothing in the files says so, but where they lie."""
    for number in range(3):
        folder = tmp_path / "lab" / f"agv{number}"
        folder.mkdir(parents=True)
        rows = (f"agv{number}-{at},{40 + way},{way * 6500},{way * 6501}" for at, way in enumerate((0.3, 0.1, 0.8)))
        (folder / "runs.csv").write_text("\n".join(["run_id,distance_m,counts_left,counts_right", *rows]) + "\n")
    text, made = _proposed(tmp_path, tmp_path / "lab")
    assert "several" in text and "vehicles" in text
    assert len(made.runs) == 9
    assert [note.level for note in made.notes if note.code == "folders"] == ["suspicious"]


def test_rows_that_two_day_files_hold_are_taken_once(tmp_path: Path) -> None:
    """A day's sheet begins with the last runs of the day before; a like run of other cells stays."""
    rows = [f"r{at},{40 + way},{way * 6500},{way * 6501}" for at, way in enumerate((0.3, 0.1, 0.8, 0.4, 0.6))]
    (tmp_path / "lab").mkdir()
    for name, several in (("day1", rows[:3]), ("day2", [*rows[1:], rows[0].replace("r0", "r9")])):
        text = "\n".join(["run_id,distance_m,counts_left,counts_right", *several])
        (tmp_path / "lab" / f"{name}.csv").write_text(text + "\n")
    made = _proposed(tmp_path, tmp_path / "lab")[1]
    assert made.runs.run_id.tolist() == ["r0", "r1", "r2", "r3", "r4", "r9"]
    dropped = [note for note in made.notes if note.code == "repeated_row"]
    assert len(dropped) == 2
    assert all("day2.csv" in note.where and "day1.csv" in note.text for note in dropped)
