"""A run table with one log a run becomes a campaign in SI units; a wrong mapping is named."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest

from calib.campaign.check import check_campaign
from calib.campaign.ingest import expected_name
from calib.campaign.ingest.build import ingest
from calib.campaign.ingest.mapping import LogSection
from calib.campaign.read import read_campaign
from calib.errors import BadInputError
from calib.reporting.topics.runs import after_check

TABLE = """Lauf;Strecke [mm];Zuladung;Bemerkung
1;40250,5;100;gut
2;41000,0;0;Regen
"""
MAPPING = """
name = "Halle 3"
[vehicle]
track_mm = 700
wheel_radius_m = 0.1
[encoder]
counts_per_rev = 4096
[table]
run_id = "Lauf"
distance_m = "Strecke [mm]"
payload_kg = {column = "Zuladung", unit = "kg"}
payload_x_m = {value = 0.3}
session = {value = "montag"}
[log]
file = "lauf_{run_id}.csv"
t_s = {column = "Zeit", unit = "ms"}
counts_left = {column = "L", factor = -1}
counts_right = "R"
"""


@pytest.fixture
def lab(tmp_path: Path) -> Path:
    lab = tmp_path / "lab"
    (lab / "logs").mkdir(parents=True)
    (lab / "export.csv").write_bytes(b"\xef\xbb\xbf" + TABLE.encode())
    (lab / "map.toml").write_text(MAPPING)
    for run in (1, 2):
        rows = "".join(f"{10 * i},{-i * 30},{i * 31}\n" for i in range(5 + run))
        (lab / "logs" / f"lauf_{run}.csv").write_text("Zeit,L,R\n" + rows)
    return lab


def _digests(folder: Path) -> dict[str, str]:
    return {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.rglob("*") if path.is_file()}


def test_lab_files_become_a_campaign_in_si_units(lab: Path, tmp_path: Path) -> None:
    ingested = ingest([lab / "export.csv", lab / "logs"], tmp_path / "c", mapping=lab / "map.toml")
    assert (ingested.n_runs, ingested.n_logs) == (2, 2)
    campaign = read_campaign(tmp_path / "c")
    assert campaign.name == "Halle 3"
    assert campaign.runs.run_id.tolist() == ["1", "2"]
    assert set(campaign.runs.label("session").tolist()) == {"montag"}
    np.testing.assert_allclose(campaign.runs.number("distance_m"), [40.2505, 41.0], rtol=1e-15)
    assert campaign.vehicle.track_m == pytest.approx(0.7, rel=1e-15)
    assert campaign.logs.of(0)["counts_left"].tolist() == [0, 30, 60, 90, 120, 150]
    np.testing.assert_allclose(campaign.logs.of(1)["t_s"], np.arange(7) * 0.01, rtol=1e-15)


def test_sources_are_hashed_and_left_untouched(lab: Path, tmp_path: Path) -> None:
    before = _digests(lab)
    ingest([lab / "export.csv", lab / "logs"], tmp_path / "c", mapping=lab / "map.toml")
    assert _digests(lab) == before
    record = json.loads((tmp_path / "c" / "ingest.json").read_text())
    assert {entry["path"]: entry["sha256"] for entry in record["sources"]} == before


def test_a_campaign_is_not_overwritten_unless_forced(lab: Path, tmp_path: Path) -> None:
    arguments = {"mapping": lab / "map.toml"}
    ingest([lab / "export.csv", lab / "logs"], tmp_path / "c", **arguments)
    before = _digests(tmp_path / "c")
    with pytest.raises(BadInputError, match="force=True"):
        ingest([lab / "export.csv"], tmp_path / "c", **arguments)
    assert _digests(tmp_path / "c") == before
    ingest([lab / "export.csv", lab / "logs"], tmp_path / "c", force=True, **arguments)
    assert _digests(tmp_path / "c") == before


def test_sources_inside_the_target_are_refused(lab: Path) -> None:
    with pytest.raises(BadInputError, match="inside the campaign"):
        ingest([lab / "export.csv"], lab, mapping=lab / "map.toml", force=True)


def test_xlsx_gives_what_csv_gives(lab: Path, tmp_path: Path) -> None:
    import openpyxl

    book = openpyxl.Workbook()
    book.active.append(["Lauf", "Strecke [mm]", "Zuladung", "Bemerkung"])
    book.active.append([1, 40250.5, 100, "gut"])
    book.active.append([2, 41000, 0, "Regen"])
    book.save(lab / "export.xlsx")
    ingest([lab / "export.csv", lab / "logs"], tmp_path / "one", mapping=lab / "map.toml")
    ingest([lab / "export.xlsx", lab / "logs"], tmp_path / "two", mapping=lab / "map.toml")
    assert (tmp_path / "one" / "runs.csv").read_bytes() == (tmp_path / "two" / "runs.csv").read_bytes()


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ('run_id = "Lauf"', 'run_id = "Run"', "row 1, column Run"),
        ('unit = "kg"', 'unit = "mm"', "table.payload_kg"),
        ("factor = -1", "factor = 0", "log.counts_left"),
        ('counts_right = "R"', 'counts_rihgt = "R"', "log.counts_rihgt"),
        ('"lauf_{run_id}.csv"', '"lauf.csv"', "log.file"),
        ("lauf_{run_id}", "fahrt_{run_id}", "row 2, column log"),
        ("[table]", "[[table]]", "column table"),
        ('counts_right = "R"', "counts_right = 3", "log.counts_right"),
        ('column = "Zeit"', 'column = "time"', "lauf_1.csv, row 1, column t_s"),
    ],
)
def test_a_wrong_mapping_is_named(lab: Path, tmp_path: Path, old: str, new: str, match: str) -> None:
    (lab / "map.toml").write_text(MAPPING.replace(old, new))
    with pytest.raises(BadInputError, match=match):
        ingest([lab / "export.csv", lab / "logs"], tmp_path / "c", mapping=lab / "map.toml")
    assert not (tmp_path / "c").exists()


def test_a_log_of_no_run_is_noted(lab: Path, tmp_path: Path) -> None:
    (lab / "logs" / "lauf_9.csv").write_text("Zeit,L,R\n0,0,0\n")
    ingested = ingest([lab / "export.csv", lab / "logs"], tmp_path / "c", mapping=lab / "map.toml")
    assert "unused_source" in {note.code for note in ingested.notes}


def test_a_direction_that_is_not_mapped_is_an_error(lab: Path, tmp_path: Path) -> None:
    """Neither ``out`` nor ``back``: never checks that are silently omitted."""
    (lab / "export.csv").write_text(
        TABLE.replace("Bemerkung", "Richtung").replace("gut", "hin").replace("Regen", "her")
    )
    mapping = lab / "map.toml"
    mapping.write_text(MAPPING.replace("[log]", 'direction = "Richtung"\n[log]'))
    with pytest.raises(BadInputError, match=r"row 2, column direction: found 'hin'; expected out or back"):
        ingest([lab / "export.csv", lab / "logs"], tmp_path / "c", mapping=mapping)
    mapping.write_text(MAPPING.replace("[log]", 'direction = {column = "Richtung", values = {hin = "out"}}\n[log]'))
    with pytest.raises(BadInputError, match=r"table.direction.values.*'her'.*row 3"):
        ingest([lab / "export.csv", lab / "logs"], tmp_path / "c", mapping=mapping)
    mapping.write_text(
        MAPPING.replace("[log]", 'direction = {column = "Richtung", values = {hin = "out", her = "back"}}\n[log]')
    )
    ingested = ingest([lab / "export.csv", lab / "logs"], tmp_path / "c", mapping=mapping)
    assert ingested.campaign.runs.label("direction").tolist() == ["out", "back"]


def test_numbers_are_written_as_short_decimals(tmp_path: Path) -> None:
    """0.4348 kN are 434.8 N, which floating point alone would write as 434.79999999999995."""
    table = tmp_path / "t.csv"
    table.write_text("run_id,load_left_kN,load_right_kN,distance_mm\na,0.4348,0.4346,40250.1\n")
    ingest([table], tmp_path / "c")
    row = (tmp_path / "c" / "runs.csv").read_text().splitlines()[1].split(",")
    assert row == ["a", "434.8", "434.6", "40.2501"]


@pytest.mark.parametrize(
    ("file", "run", "run_id", "name"),
    [
        ("Lauf_{n:02}.csv", None, "Lauf 1", "Lauf_01.csv"),
        ("Lauf_{n:02}.csv", "Lauf {n}", "lauf 12", "Lauf_12.csv"),
        ("{n}.csv", "Day 3, run {n}", "Day 3, run 7", "7.csv"),
        ("run_{run_id}.csv", None, "a1", "run_a1.csv"),
        ("Lauf_{n:02}.csv", "Lauf {n}", "Fahrt 1", None),
    ],
)
def test_the_name_of_a_log_follows_the_pattern(file: str, run: str | None, run_id: str, name: str | None) -> None:
    assert expected_name(LogSection(file=file, run=run), run_id) == name


def test_rates_angles_and_increments_become_counts(tmp_path: Path) -> None:
    """Five units of the same wheel: 2 turns at constant rate are 2 x 4096 counts, also where rows are written twice."""
    time = np.linspace(0.0, 4.0, 41)
    angle = np.pi * time
    columns = {
        "rad": np.mod(angle + np.pi, 2 * np.pi) - np.pi,
        "rad/s": np.full(41, np.pi),
        "rpm": np.full(41, 30.0),
        "turns": angle / (2 * np.pi),
        "counts/sample": np.concatenate(([0.0], np.full(40, 4096 * 2 / 40))),
    }
    for unit, values in columns.items():
        folder = tmp_path / unit.replace("/", "_")
        folder.mkdir()
        rows = [f"{t:.3f},{v!r},{v!r}\n" for t, v in zip(time, map(float, values), strict=True)]
        again = [row for number, row in enumerate(rows) for _ in range(1 + (number % 3 == 1))]
        (folder / "a.csv").write_text("t_s,left,right\n" + "".join(again))
        (folder / "m.toml").write_text(
            f'[log]\ncounts_left = {{column = "left", unit = "{unit}"}}\n'
            f'counts_right = {{column = "right", unit = "{unit}"}}\n'
            "[encoder]\ncounts_per_rev = 4096\n"
        )
        ingested = ingest([folder / "a.csv"], folder / "c", mapping=folder / "m.toml")
        counts = ingested.campaign.logs.of(0)["counts_left"]
        assert counts[-1] - counts[0] == pytest.approx(8192, rel=1e-12), unit


def test_front_wheel_and_mecanum_logs_pass_through(tmp_path: Path) -> None:
    for name, drive, columns in (
        ("front", "tricycle", ("counts_front", "steer_rad")),
        ("mecanum", "mecanum", ("counts_front_left", "counts_front_right", "counts_rear_left", "counts_rear_right")),
    ):
        folder = tmp_path / name
        folder.mkdir()
        rows = "".join(
            f"{0.1 * i:.1f}," + ",".join(str(0.01 * i * (k + 1)) for k in range(len(columns))) + "\n" for i in range(30)
        )
        (folder / "a.csv").write_text(",".join(("t_s", *columns)) + "\n" + rows)
        (folder / "m.toml").write_text(f'[vehicle]\ndrive = "{drive}"\n')
        ingest([folder / "a.csv"], folder / "c", mapping=folder / "m.toml")
        campaign = read_campaign(folder / "c")
        assert set(campaign.logs.of(0)) == {"t_s", *columns}
        check_campaign(campaign)


def test_radii_are_stated_at_the_mean_load_measured_where_nobody_states_a_mass(tmp_path: Path) -> None:
    """The load of an assumed mass is nobody's reference; nor is the load that an unknown vehicle permits a limit."""
    rows = [f"r{k},{5000 + 3000 * (k % 3)},{5000 + 3000 * (k % 3)},20,9000,9000" for k in range(9)]
    (tmp_path / "runs.csv").write_text(
        "\n".join(["run_id,load_left_N,load_right_N,distance_m,counts_left,counts_right", *rows]) + "\n"
    )
    into = tmp_path / "c"
    ingest([tmp_path / "runs.csv"], into)
    made = read_campaign(into)
    assert made.model.reference_load_N == 8000.0
    found = [note for note in check_campaign(made).suspicious if note.code == "excess_load"]
    assert len(found) == 1 and "nobody stated" in found[0].text


def test_poses_that_are_exactly_zero_are_lost_frames(tmp_path: Path) -> None:
    """A tracker writes zeros where it sees nothing; standing at the origin before the first motion is a pose."""
    x = np.concatenate([np.zeros(5), 1.0 + 0.05 * np.arange(19.0)])
    x[12:15] = 0.0
    rows = [f"{0.1 * k:.1f},{100 * k},{100 * k},{v},0,0" for k, v in enumerate(x)]
    (tmp_path / "r1.csv").write_text(
        "\n".join(["t_s,counts_left,counts_right,ref_x_m,ref_y_m,ref_theta_rad", *rows]) + "\n"
    )
    (tmp_path / "runs.csv").write_text("run_id,log\nr1,r1.csv\n")
    made = ingest([tmp_path / "runs.csv", tmp_path / "r1.csv"], tmp_path / "c").campaign
    for one in (made, read_campaign(tmp_path / "c")):
        lost = np.isnan(one.log("r1")["ref_x_m"])
        assert np.flatnonzero(lost).tolist() == [12, 13, 14]


def test_a_folder_without_a_readable_file_says_what_it_holds(tmp_path: Path) -> None:
    (tmp_path / "run0.jsonl").write_text("{}\n")
    with pytest.raises(BadInputError, match=r"no file to read in .*, which holds \*\.jsonl; expected .*\.parquet"):
        ingest([tmp_path], tmp_path / "c")


def test_files_of_other_clocks_say_how_they_are_joined(tmp_path: Path) -> None:
    """The lag that the note names joins files that began together."""
    (lab := tmp_path / "lab").mkdir()
    t = np.linspace(0.0, 10.0, 101)
    for name, columns in (("enc_1", (t + 80.0, t, t)), ("cam_1", (t, t, t))):
        rows = [",".join(map(str, row)) for row in zip(*columns, strict=True)]
        (lab / f"{name}.csv").write_text("\n".join(["t_s,a,b", *rows]) + "\n")
    lines = '[log]\nfiles = {enc = "enc_{n}.csv", cam = "cam_{n}.csv"}\n'
    lines += 'counts_left = "enc:a"\ncounts_right = "enc:b"\n'
    for into, lag in (("apart", ""), ("joined", ", lag_s = -80")):
        poses = "".join(
            f'ref_{axis}_m = {{column = "cam:{axis_of}"{lag}}}\n' for axis, axis_of in zip("xy", "ab", strict=True)
        )
        (tmp_path / "m.toml").write_text(lines + poses)
        made = ingest([lab], tmp_path / into, mapping=tmp_path / "m.toml")
        assert any("lag_s = -80 in each of its lines" in note.text for note in made.notes)
        assert ("ref_x_m" in made.campaign.log("1")) == bool(lag)


def test_a_time_zone_is_told_from_what_began_later(tmp_path: Path) -> None:
    """A camera that began 0.1 s later on a clock two hours behind: its latency is not taken away with the zone."""
    (lab := tmp_path / "lab").mkdir()
    t = np.linspace(0.0, 10.0, 101)
    for name, columns in (("enc_1", (t + 7200.0, t, t)), ("cam_1", (t + 0.1, t, t))):
        rows = [",".join(map(str, row)) for row in zip(*columns, strict=True)]
        (lab / f"{name}.csv").write_text("\n".join(["t_s,a,b", *rows]) + "\n")
    (tmp_path / "m.toml").write_text(
        '[log]\nfiles = {enc = "enc_{n}.csv", cam = "cam_{n}.csv"}\n'
        'counts_left = "enc:a"\ncounts_right = "enc:b"\nref_x_m = "cam:a"\nref_y_m = "cam:b"\n'
    )
    made = ingest([lab], tmp_path / "c", mapping=tmp_path / "m.toml")
    assert any("another time zone: lag_s = -7200 in each of its lines" in note.text for note in made.notes)


def test_a_front_wheel_alone_needs_no_counts_of_the_others(tmp_path: Path) -> None:
    (tmp_path / "m.toml").write_text(
        "[vehicle]\ntrack_m = 0.7\nwheel_radius_m = 0.1\n[encoder]\ncounts_per_rev_front = 8192\n"
    )
    rows = [f"{0.1 * k:.1f},{100 * k},0.1" for k in range(30)]
    (tmp_path / "r1.csv").write_text("\n".join(["t_s,counts_front,steer_rad", *rows]) + "\n")
    (tmp_path / "runs.csv").write_text("run_id,distance_m,log\nr1,5.0,r1.csv\n")
    made = ingest([tmp_path / "runs.csv", tmp_path / "r1.csv"], tmp_path / "c", mapping=tmp_path / "m.toml")
    assert not any("every radius" in note.text for note in made.notes)
    report = check_campaign(made.campaign)
    assert not any("counts_per_rev" in note.text for note in report.suspicious)
    # a law of the load needs two wheels on an axle
    assert after_check(report, ["distance_m", "counts_front"]) == "check without distances"
