"""A fleet's result is the same however it is made, and no vehicle's bad data stop it."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from calib.campaign.read import read_campaign
from calib.documents import to_json
from calib.fleet import run
from calib.fleet.run import Fleet, fit_fleet
from calib.fleet.store import SUMS, one_line
from calib.fleet.workers import Engine, engine
from calib.plant.make import FleetSize, FleetTruth, make_fleet
from calib.radius.fit import fit_campaign
from calib.radius.result import Fit
from calib.reporting.formatting import to_text
from calib.reporting.topics.geometry import fleet_content

ROOT = Path(__file__).resolve().parents[2]
SAMPLE = ROOT / "sample_runs" / "corridor_crossed"
UNCERTAINTY = """
[uncertainty]
rangefinder = { scale = { std = 1e-4 }, offset_m = { half_width = 1e-3, distribution = "rectangular" } }
path = { apart_m = { std = 2e-3, dof = 5 } }
weighing = { scale = { std = 1e-2 } }
"""


def _figures(value: dict[str, Any], side: str) -> list[float]:
    quantities = (f"radius_{side}_m", f"slope_{side}_m_per_N")
    ends = (f"radius_{side}_ci95_m", f"slope_{side}_ci95_m_per_N")
    return [*(value[name] for name in quantities), *(end for name in ends for end in value[name])]


def _of_fit(fit: Fit, side: str) -> list[float]:
    wheel = fit.to_dict()["wheels"][side]
    return [
        *(wheel[name] for name in ("radius_ref_m", "slope_m_per_N")),
        *(end for name in ("radius_ref_ci95_m", "slope_ci95_m_per_N") for end in wheel[name]),
    ]


def _bytes(fleet: Fleet) -> str:
    return to_json(fleet.to_dict())


def test_a_vehicle_of_a_fleet_has_the_figures_that_fit_gives(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With logs and without, with declared uncertainty, by a link, and wherever the command runs; bad ones are named.

    One vehicle scatters with the load (HC3), one has too few runs, one a single load.
    """
    fleet = tmp_path / "fleet"
    runs = pd.read_csv(SAMPLE / "runs.csv").drop(columns=["log"])
    rng = np.random.default_rng(3)
    heavy = 5e-6 * rng.choice((-1.0, 1.0), len(runs)) * (runs["load_left_N"] - 300.0)
    tables = {"declared": runs, "plain": runs, "uneven": runs.assign(distance_m=runs["distance_m"] * (1.0 + heavy)),
              "few": runs[:2], "one_load": runs.assign(load_left_N=700.0, load_right_N=700.0)}  # fmt: skip
    shutil.copytree(SAMPLE, fleet / "logs")
    for name, table in tables.items():
        (fleet / name).mkdir()
        stated = UNCERTAINTY if name == "declared" else ""
        (fleet / name / "campaign.toml").write_text((SAMPLE / "campaign.toml").read_text() + stated)
        table.to_csv(fleet / name / "runs.csv", index=False)
    (fleet / "link").symlink_to("logs")
    absolute = fit_fleet(fleet, tmp_path / "out")
    monkeypatch.chdir(tmp_path)
    relative = fit_fleet(Path("fleet"), tmp_path / "other")
    assert _bytes(relative) == _bytes(absolute)
    values = {one["id"]: one for one in absolute.to_dict()["vehicles"]}
    assert "found 2 usable runs" in values.pop("few")["why"]
    assert "two loads or more" in values.pop("one_load")["why"]
    for name, value in values.items():
        fit = fit_campaign(read_campaign(fleet / name))
        assert tuple(value["failed_checks"]) == fit.failed
        for side in ("left", "right"):
            assert _figures(value, side) == pytest.approx(_of_fit(fit, side), rel=1e-9)
    assert fit_campaign(read_campaign(fleet / "uneven")).left.estimate.hc3


def test_a_table_of_a_dataset_has_the_figures_that_fit_gives(tmp_path: Path) -> None:
    """Sums lose nothing, of what ``[uncertainty]`` declares either."""
    runs = pd.read_csv(SAMPLE / "runs.csv").drop(columns=["log"])
    folders = [tmp_path / "one", tmp_path / "fleet" / "vehicle=v1"]
    for folder, settings in zip(folders, (folders[0], tmp_path / "fleet"), strict=True):
        folder.mkdir(parents=True)
        (settings / "campaign.toml").write_text((SAMPLE / "campaign.toml").read_text() + UNCERTAINTY)
    runs.to_csv(folders[0] / "runs.csv", index=False)
    runs.to_parquet(folders[1] / "runs.parquet")
    [value] = fit_fleet(tmp_path / "fleet", tmp_path / "out").to_dict()["vehicles"]
    fit = fit_campaign(read_campaign(folders[0]))
    for side in ("left", "right"):
        assert _figures(value, side) == pytest.approx(_of_fit(fit, side), rel=1e-8)


@pytest.fixture(scope="module")
def alone(small: tuple[Path, FleetTruth], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Fleet]:
    """The fleet fitted by one process, and the folder of its sums; nobody changes either."""
    folder = tmp_path_factory.mktemp("alone") / "out"
    return folder, fit_fleet(small[0], folder)


def test_workers_and_order_change_nothing(
    small: tuple[Path, FleetTruth], alone: tuple[Path, Fleet], tmp_path: Path
) -> None:
    """The same bytes from one process and from two, in the result and in the kept sums."""
    assert _bytes(fit_fleet(small[0], tmp_path / "two", workers=2)) == _bytes(alone[1])
    assert (tmp_path / "two" / SUMS).read_bytes() == (alone[0] / SUMS).read_bytes()


def test_partitions_shuffled_give_the_same_bytes(
    small: tuple[Path, FleetTruth], alone: tuple[Path, Fleet], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Files handed out in any order: result and kept sums are those of the order of names."""

    class Shuffled:
        """Hands items out in a drawn order."""

        def run(self, task: Any, items: Sequence[Any], given_up: Any, _weigh: Any = None) -> Iterator[Any]:
            order = np.random.default_rng(6).permutation(len(items))
            return Engine().run(task, [items[k] for k in order], given_up)

    monkeypatch.setattr(run, "engine", lambda *_: nullcontext(Shuffled()))
    assert _bytes(fit_fleet(small[0], tmp_path / "shuffled")) == _bytes(alone[1])
    assert (tmp_path / "shuffled" / SUMS).read_bytes() == (alone[0] / SUMS).read_bytes()


def test_an_interrupted_run_goes_on_where_it_was(
    small: tuple[Path, FleetTruth], alone: tuple[Path, Fleet], tmp_path: Path
) -> None:
    """Half of the kept lines, the last one cut short: the rest is read, and the result is the same."""
    whole = alone[1]
    sums = shutil.copytree(alone[0], tmp_path / "out") / SUMS
    data = sums.read_bytes()
    sums.write_bytes(data[: len(data) // 2])
    again = fit_fleet(small[0], tmp_path / "out")
    assert 0 < again.n_read < len(whole.records) * 2
    assert again.n_read + again.n_kept == whole.n_read
    assert _bytes(again) == _bytes(whole)
    assert sums.read_bytes() == data


def test_new_journeys_alone_are_read(small: tuple[Path, FleetTruth], alone: tuple[Path, Fleet], tmp_path: Path) -> None:
    """A month that comes adds its sums; nothing else is read again, and the result is that of all months at once."""
    folder = tmp_path / "fleet"
    shutil.copytree(small[0], folder)
    last = sorted(folder.glob("vehicle=*/month=2025-02"))
    for month in last:
        shutil.move(month, tmp_path / f"{month.parent.name}-later")
    fit_fleet(folder, tmp_path / "out")
    for month in last:
        shutil.move(tmp_path / f"{month.parent.name}-later", month)
    grown = fit_fleet(folder, tmp_path / "out")
    assert (grown.n_read, grown.n_kept) == (len(last), len(last))
    assert _bytes(grown) == _bytes(alone[1])


def test_a_fleet_is_made_in_a_folder_whose_name_is_no_utf_8(tmp_path: Path) -> None:
    """Nor is a name taken for the address of a store."""
    folder = tmp_path / os.fsdecode(b"s3:h\xff")
    make_fleet(folder, np.random.default_rng(1), FleetSize(2, 12, 1, 0, 0, 0))
    assert len(list(folder.rglob("runs.parquet"))) == 2


def test_bad_data_of_one_vehicle_stop_nobody(small: tuple[Path, FleetTruth], tmp_path: Path) -> None:
    """A damaged file, and a vehicle without one, are listed with their one line."""
    folder = tmp_path / "fleet"
    shutil.copytree(small[0], folder)
    damaged = next(folder.glob("vehicle=v00003/*/runs.parquet"))
    damaged.write_bytes(damaged.read_bytes()[:100])
    (folder / "vehicle=empty").mkdir()
    fleet = fit_fleet(folder, tmp_path / "out", workers=2)
    failed = {record.vehicle: record.why for record in fleet.records if record.status == "failed"}
    assert set(failed) == {"v00003", "empty"}
    assert "parquet" in failed["v00003"]
    assert fleet.view.n_fitted == len(fleet.records) - 2


def test_a_law_that_fit_calls_doubtful_is_named_and_a_file_that_is_not_there(tmp_path: Path) -> None:
    """The second vehicle's radii bend by 0.2 mm between the smallest and the largest load; a link leads nowhere."""
    for name in ("sound", "bent", "gone"):
        shutil.copytree(ROOT / "sample_runs" / "corridor_crossed", tmp_path / "fleet" / name)
    table = tmp_path / "fleet" / "bent" / "runs.csv"
    runs = pd.read_csv(table)
    runs["distance_m"] *= 1.0 + 2e-3 * (1.0 - ((runs["load_left_N"] - 700.0) / 400.0) ** 2)
    runs.drop(columns=["log"]).to_csv(table, index=False)
    settings = tmp_path / "fleet" / "gone" / "campaign.toml"
    settings.unlink()
    settings.symlink_to(tmp_path / "nowhere")
    fleet = fit_fleet(tmp_path / "fleet", tmp_path / "out")
    records = {record.vehicle: record for record in fleet.records}
    assert records["sound"].doubtful == ()
    assert records["bent"].status == "fitted"
    assert records["bent"].doubtful == fit_campaign(read_campaign(tmp_path / "fleet" / "bent")).failed
    assert "left wheel, curvature" in records["bent"].doubtful
    missing = one_line(FileNotFoundError(2, "No such file or directory", "v1/runs.csv"))
    assert missing.startswith("v1/runs.csv: found no such file or directory; expected a file that can be read; add")
    assert "; expected" in records["gone"].why
    shown = to_text(fleet_content(fleet))
    assert "Doubtful laws" in shown
    assert "bent: left wheel" in shown


def test_the_result_names_what_was_planted(small: tuple[Path, FleetTruth], alone: tuple[Path, Fleet]) -> None:
    """All four odd vehicles, and nobody else."""
    assert {outlier.vehicle for outlier in alone[1].view.outliers} == set(small[1].outliers)


def _dies_at_seven(batch: list[int]) -> list[int]:
    for item in batch:
        if item == 7:
            os._exit(1)
    return [item * item for item in batch]


def test_a_worker_that_dies_costs_its_own_task_only() -> None:
    """The item that kills its worker is given up after two tries; every other has its result."""
    with engine(2) as opened:
        results = list(opened.run(_dies_at_seven, list(range(40)), lambda item, why: -item))
    assert sorted(results) == sorted([*(k * k for k in range(40) if k != 7), -7])


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """A real scheduler with two worker processes, started here; a task may take a single worker down."""
    distributed = pytest.importorskip("distributed", reason="the extra fleet is not installed")
    from dask import config

    with (
        config.set({"distributed.scheduler.allowed-failures": 0}),
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, host="127.0.0.1"
        ) as cluster,
    ):
        yield cluster.scheduler_address


def test_a_dask_scheduler_gives_the_same_bytes(
    small: tuple[Path, FleetTruth], alone: tuple[Path, Fleet], tmp_path: Path, scheduler: str
) -> None:
    assert _bytes(fit_fleet(small[0], tmp_path / "dask", scheduler=scheduler)) == _bytes(alone[1])


def test_a_dask_worker_that_dies_costs_its_own_task_only(scheduler: str) -> None:
    """The item that kills its worker is given up; every other of its task has its result from another worker."""
    with engine(scheduler=scheduler) as opened:
        results = list(opened.run(_dies_at_seven, list(range(40)), lambda item, why: -item))
    assert sorted(results) == sorted([*(k * k for k in range(40) if k != 7), -7])


def test_a_vehicle_whose_settings_are_missing_is_named(tmp_path: Path) -> None:
    folder, kept = tmp_path / "fleet", tmp_path / "kept"
    for name in ("a", "b"):
        shutil.copytree(ROOT / "sample_runs" / "corridor_crossed", folder / name)
    (folder / "b" / "campaign.toml").unlink()
    (folder / "notes").mkdir()
    by_name = {record.vehicle: record for record in fit_fleet(folder, kept).records}
    assert sorted(by_name) == ["a", "b"] and by_name["a"].status == "fitted"
    assert "campaign.toml: found no such file" in by_name["b"].why
