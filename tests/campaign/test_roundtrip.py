from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis.extra.numpy import arrays

from calib.campaign import write_campaign
from calib.campaign.model import NUMERIC_COLUMNS, Campaign, Logs, RunTable
from calib.campaign.read import read_campaign
from calib.campaign.settings import Encoder, Odometry, Reference
from calib.errors import BadInputError
from calib.vehicle import Vehicle
from tests.campaign.making import campaign

TEXT = st.text(st.characters(blacklist_categories=("C", "Z")), min_size=1, max_size=12)
CELL = st.one_of(st.just(np.nan), st.floats(-1e6, 1e6), st.integers(-(2**52), 2**52).map(float))
# the load columns, counts and distance are filled where they are missing, so they are always given here
FULL = ("counts_left", "counts_right", "distance_m", "load_left_N", "load_right_N")
#: sessions that differ by more than case, width or form: those that do not are joined when they are read
SESSIONS = ("", "mon", "3", "früh; spät", '"quoted"', "\u65e5\u66dc")


@st.composite
def campaigns(draw: st.DrawFn) -> Campaign:
    n = draw(st.integers(1, 5))
    ids = draw(st.lists(TEXT, min_size=n, max_size=n, unique=True))
    numbers = {
        name: np.asarray(draw(st.lists(CELL, min_size=n, max_size=n)))
        for name in NUMERIC_COLUMNS
        if name not in FULL and draw(st.booleans())
    }
    # totals that no overflow of a 16-bit counter sets apart from the logs below
    numbers |= {name: np.asarray(draw(st.lists(st.floats(1, 5000), min_size=n, max_size=n))) for name in FULL}
    if draw(st.booleans()):
        numbers["humidity"] = np.asarray(draw(st.lists(CELL, min_size=n, max_size=n)))
    lengths = np.asarray(draw(st.lists(st.sampled_from([0, 2, 7]), min_size=n, max_size=n)))
    offsets = np.concatenate(([0], np.cumsum(lengths))).astype(np.int64)
    samples = int(offsets[-1])
    columns = {}
    if samples:
        columns["t_s"] = np.concatenate([np.arange(m) * draw(st.sampled_from([0.01, 1 / 3, 0.05])) for m in lengths])
        for name in ("counts_left", "counts_right"):
            # small enough to be taken for no overflow
            columns[name] = np.rint(draw(arrays(np.float64, samples, elements=st.floats(-1e4, 1e4))))
        columns["range_m"] = draw(arrays(np.float64, samples, elements=st.floats(-50, 50)))
    made = campaign(logs=False)
    return replace(
        made,
        name=draw(st.text(max_size=20).filter(lambda t: t.isprintable())),
        encoder=Encoder(
            draw(st.floats(1, 1e6)), draw(st.floats(1, 1e6)), counts_per_rev_front=draw(st.none() | st.floats(1, 1e6))
        ),
        vehicle=replace(
            draw(st.sampled_from([Vehicle(), Vehicle(drive="differential"), Vehicle(drive="mecanum")])),
            front_wheel_radius_m=draw(st.none() | st.floats(0.01, 1.0)),
            half_length_plus_half_width_m=draw(st.none() | st.floats(0.01, 9.0)),
        ),
        reference=Reference(
            sensor_x_m=draw(st.floats(-9, 9)),
            sensor_y_m=draw(st.sampled_from([0.0, -0.3])),
            sensor_yaw_rad=draw(st.floats(-6, 6)),
            frame=draw(st.sampled_from([None, "start", "map"])),
        ),
        odometry=Odometry(draw(st.sampled_from([None, "rear"]))),
        runs=RunTable(
            labels={
                "run_id": np.asarray(ids),
                "session": np.asarray(draw(st.lists(st.sampled_from(SESSIONS), min_size=n, max_size=n))),
                "exclusion_reason": np.asarray(draw(st.lists(TEXT, min_size=n, max_size=n))),
            },
            numbers=numbers,
            excluded=np.asarray(draw(st.lists(st.booleans(), min_size=n, max_size=n))),
            line=np.arange(n) + 2,
        ),
        logs=Logs(offsets, columns),
        extra={"effects": {"track_width": {"relative": 3e-3, "on": True}}, "site": "hall 3", "cells": [1, 2.5, "a"]},
    )


@given(campaigns())
@settings(max_examples=40, deadline=None)
def test_what_is_written_reads_back(made: Campaign) -> None:
    """Reading what was written gives the same settings, labels, numbers, flags and logs."""
    with tempfile.TemporaryDirectory() as folder:
        again = read_campaign(write_campaign(made, Path(folder) / "c"))
    for name in ("name", "simulated", "vehicle", "encoder", "model", "rangefinder", "reference", "odometry", "extra"):
        assert getattr(again, name) == getattr(made, name), name
    for name, column in made.runs.labels.items():
        assert again.runs.labels[name].tolist() == column.tolist()
    assert set(again.runs.numbers) == set(made.runs.numbers)
    for name, column in made.runs.numbers.items():
        np.testing.assert_array_equal(again.runs.numbers[name], column, err_msg=name)
    assert again.runs.excluded.tolist() == made.runs.excluded.tolist()
    assert again.logs.offsets.tolist() == made.logs.offsets.tolist()
    for name, column in made.logs.columns.items():
        # times are written to the nanosecond; older pandas parse decimals to within one unit in the last place
        np.testing.assert_allclose(again.logs.columns[name], column, rtol=3e-16, atol=6e-10 if name == "t_s" else 0.0)


def test_the_same_campaign_gives_the_same_bytes(tmp_path: Path) -> None:
    one, two = (write_campaign(campaign(), tmp_path / name) for name in ("one", "two"))
    files = sorted(path.relative_to(one) for path in one.rglob("*") if path.is_file())
    assert len(files) == 32
    assert all((one / name).read_bytes() == (two / name).read_bytes() for name in files)


def test_a_campaign_is_replaced_only_when_forced_and_other_files_stay(tmp_path: Path) -> None:
    folder = write_campaign(campaign(), tmp_path / "c")
    (folder / "notes.txt").write_text("mine")
    before = (folder / "runs.csv").read_bytes()
    with pytest.raises(BadInputError, match="force=True"):
        write_campaign(campaign(seed=6), folder)
    assert (folder / "runs.csv").read_bytes() == before
    write_campaign(campaign(seed=6, logs=False), folder, force=True)
    assert (folder / "runs.csv").read_bytes() != before
    assert (folder / "notes.txt").read_text() == "mine"
    # logs of the campaign that stood there do not survive beside the new table
    assert not (folder / "logs").exists()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["c"]


def test_log_decimals_keep_logs_compact(tmp_path: Path) -> None:
    made = campaign()
    ranged = replace(
        made, logs=replace(made.logs, columns={**made.logs.columns, "range_m": made.logs.columns["t_s"] / 3})
    )
    folder = write_campaign(ranged, tmp_path / "c", log_decimals={"range_m": 4, "t_s": 2})
    cells = [line.split(",") for line in (folder / "logs" / "r000.csv").read_text().splitlines()[1:]]
    assert max(len(row[3].partition(".")[2]) for row in cells) <= 4
    assert all(row[1].lstrip("-").isdigit() for row in cells)


def test_a_run_id_never_becomes_a_path(tmp_path: Path) -> None:
    made = campaign(runs_per_load=1)
    ids = np.asarray(["../evil", "a/b", "A_b", "a b", "..."])
    named = replace(made, runs=replace(made.runs, labels={**made.runs.labels, "run_id": ids}))
    folder = write_campaign(named, tmp_path / "c")
    assert len(list((folder / "logs").iterdir())) == 5
    assert sorted(path.name for path in tmp_path.iterdir()) == ["c"]
    assert read_campaign(folder).runs.run_id.tolist() == ids.tolist()
