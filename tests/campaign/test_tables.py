"""What a run table holds beside runs: summaries, remarks, headers mistyped, sessions that are times of day."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calib.campaign.check import check_campaign
from calib.campaign.model import Campaign
from calib.campaign.read import read_campaign
from calib.errors import BadFileError

TOML = 'format = "calib-campaign/1"\n[vehicle]\ntrack_m = 0.7\nwheel_radius_m = 0.1\n[encoder]\ncounts_per_rev = 4096\n'


def runs(n_runs: int = 30) -> pd.DataFrame:
    rng = np.random.default_rng(5)
    load = rng.choice([300.0, 500.0, 700.0, 1100.0], (2, n_runs))
    distance = rng.uniform(37.0, 42.0, n_runs)
    counts = [np.rint(distance / (0.2 * np.pi) * 4096 * (1 + 2e-6 * one)).astype(int) for one in load]
    return pd.DataFrame(
        {
            "run_id": [f"a{run:02}" for run in range(1, n_runs + 1)],
            "session": [f"day{1 + 3 * run // n_runs}" for run in range(n_runs)],
            "load_left_N": load[0],
            "load_right_N": load[1],
            "distance_m": np.round(distance, 4),
            "counts_left": counts[0],
            "counts_right": counts[1],
        }
    )


def read(tmp_path: Path, table: pd.DataFrame, *, end: str = "") -> Campaign:
    (tmp_path / "campaign.toml").write_text(TOML)
    (tmp_path / "runs.csv").write_text(table.to_csv(index=False) + end)
    return read_campaign(tmp_path, lenient=True)


@pytest.mark.parametrize("of", ["mean", "sum", "median", "std", "min", "max"])
def test_a_row_that_is_a_statistic_of_the_rows_above_is_no_run(tmp_path: Path, of: str) -> None:
    """In any language, and beside another such row."""
    table = runs()
    numbers = table.select_dtypes("number")
    rows = [{"run_id": "Gemiddelde", **numbers.mean().round(1)}, {"run_id": "x", **numbers.agg(of).round(2)}]
    made = read(tmp_path, pd.concat([table, pd.DataFrame(rows)]))
    assert made.runs.run_id[made.runs.excluded].tolist() == ["Gemiddelde", "x"]
    assert [note.code for note in made.notes if note.level == "suspicious"] == ["summary_row"] * 2


def test_means_of_each_session_among_the_rows_are_no_runs(tmp_path: Path) -> None:
    parts = []
    for day, of in runs().groupby("session"):
        mean = {"run_id": f"snitt {day}", "session": day, **of.select_dtypes("number").mean().round(1)}
        parts += [of, pd.DataFrame([mean])]
    made = read(tmp_path, pd.concat(parts))
    assert (made.runs.excluded == np.char.startswith(made.runs.run_id, "snitt")).all()


def test_runs_are_no_statistics_of_others(tmp_path: Path) -> None:
    """Neither a repeat, nor a table whose numbers hardly differ, nor names that differ."""
    table = runs()
    repeat = table.iloc[[int(table["counts_left"].argmin())]].assign(run_id="again")
    assert not read(tmp_path, pd.concat([table, repeat])).runs.excluded.any()
    alike = pd.DataFrame({"distance_m": 40.0, "counts_left": [100, 102, 101, 101], "counts_right": [99, 101, 100, 100]})
    alike.insert(0, "run_id", ["a", "b", "c", "last"])
    assert not read(tmp_path, alike).runs.excluded.any()
    assert not read(tmp_path, table.assign(run_id=[f"{'xyz'[at % 3]}{at}" for at in range(30)])).runs.excluded.any()


def test_a_row_without_name_may_sum_up_others(tmp_path: Path) -> None:
    with pytest.raises(BadFileError, match="remove the row"):
        read(tmp_path, runs(), end=",,600.0,650.0,39.5,260000,260000\n")


def test_a_remark_beneath_the_table_is_no_row(tmp_path: Path) -> None:
    assert len(read(tmp_path, runs(), end="# end, by Hans\n").runs) == 30


@pytest.mark.parametrize(
    ("typed", "meant"),
    [("distnace_m", "distance_m"), ("load_lef_N", "load_left_N"), ("counts_rihgt", "counts_right")],
)
def test_a_mistyped_header_of_a_needed_column_is_a_fault(tmp_path: Path, typed: str, meant: str) -> None:
    report = check_campaign(read(tmp_path, runs().rename(columns={meant: typed})))
    first, *unused = report.wrong
    assert first.where == f"runs.csv, column {typed}"
    assert {note.code for note in unused} <= {"missing_counts", "missing_distance"}
    assert f"rename it to {meant}" in report.wrong[0].text


def test_another_letter_is_another_column(tmp_path: Path) -> None:
    made = read(tmp_path, runs().assign(ref_z_m=0.1, payload_z_m=0.2, counts_front=5))
    assert "look_alike" not in {note.code for note in made.notes}


def test_a_row_of_units_may_repeat_those_of_the_names(tmp_path: Path) -> None:
    head, rows = runs().to_csv(index=False).split("\n", 1)
    (tmp_path / "campaign.toml").write_text(TOML)
    (tmp_path / "runs.csv").write_text(f"{head}\n,,N,N,m,1,1\n{rows}")
    assert np.isfinite(read_campaign(tmp_path).runs.number("distance_m")).all()


@pytest.mark.parametrize(
    "form", ["%Y-%m-%d %H:%M:%S", "%d.%m.%Y %H:%M", "%Y-%m-%dT%H:%M:%S.000Z"], ids=["iso", "german", "zone"]
)
def test_times_of_day_are_no_sessions(tmp_path: Path, form: str) -> None:
    times = pd.to_datetime("2026-05-04 09:07") + pd.to_timedelta(
        [24 * 60 * (at // 10) + 7 * at for at in range(30)], "min"
    )
    made = read(tmp_path, runs().assign(session=times.strftime(form)))
    assert len(set(made.runs.label("session").tolist())) == 3
    assert "session_days" in {note.code for note in made.notes}


def test_sessions_of_one_run_each_are_told(tmp_path: Path) -> None:
    alone, together = (
        read(tmp_path, runs().assign(session=labels)) for labels in ([f"s{at}" for at in range(30)], "s1")
    )
    assert any("session of its own" in note.text for note in alone.notes)
    assert not any("session of its own" in note.text for note in together.notes)
