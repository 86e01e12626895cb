from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest

from calib.campaign.ingest import ingest
from calib.campaign.read import read_campaign
from calib.errors import BadInputError

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
    made = ingest([lab / "export.csv", lab / "logs"], tmp_path / "c", mapping=lab / "map.toml")
    assert (made.n_runs, made.n_logs) == (2, 2)
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
    with pytest.raises(BadInputError, match="--force"):
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


def test_a_log_of_no_run_is_said(lab: Path, tmp_path: Path) -> None:
    (lab / "logs" / "lauf_9.csv").write_text("Zeit,L,R\n0,0,0\n")
    made = ingest([lab / "export.csv", lab / "logs"], tmp_path / "c", mapping=lab / "map.toml")
    assert "unused_source" in {note.code for note in made.notes}
