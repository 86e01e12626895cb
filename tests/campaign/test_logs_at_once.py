"""Threads change nothing of the logs read, nor does where their columns are held."""

from __future__ import annotations

import errno
import os
import shutil
from copy import deepcopy
from pathlib import Path

import numpy as np
import pytest

from calib.campaign import logs as reading
from calib.campaign import model, write_campaign
from calib.campaign.model import Campaign
from calib.campaign.read import read_campaign
from calib.errors import BadFileError
from tests.campaign.making import campaign

N_RUNS = 10


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten runs, two of whose logs are written otherwise, so that something is said of them."""
    folder = write_campaign(campaign(runs_per_load=2, rate_hz=10.0), tmp_path_factory.mktemp("cached") / "c")
    logs = sorted((folder / "logs").iterdir())
    assert len(logs) == N_RUNS
    logs[3].write_text(logs[3].read_text().replace(",", ";"))
    logs[7].write_text(logs[7].read_text().replace(",", "\t"))
    return folder


def _same(first: Campaign, second: Campaign) -> None:
    assert first.notes == second.notes
    assert first.hashes == second.hashes
    assert list(first.logs.columns) == list(second.logs.columns)
    np.testing.assert_array_equal(first.logs.offsets, second.logs.offsets)
    for name, column in first.logs.columns.items():
        np.testing.assert_array_equal(column, second.logs.columns[name])


@pytest.mark.parametrize("threads", [1, 4])
def test_the_first_fault_in_the_order_of_runs_is_named(
    source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, threads: int
) -> None:
    """Two bad logs: the earlier is raised however many threads read; lenient, both are noted in their order."""
    monkeypatch.setattr(reading, "_processors", lambda: threads)
    folder = tmp_path / "c"
    shutil.copytree(source, folder)
    logs = sorted((folder / "logs").iterdir())
    # the later is small and would be done first
    logs[8].write_text("t_s,counts_left,counts_right\n0,x,0\n")
    logs[2].write_text(logs[2].read_text() + "end\n")
    with pytest.raises(BadFileError, match=logs[2].name):
        read_campaign(folder)
    notes = read_campaign(folder, lenient=True).notes
    assert [note.where.split(",")[0] for note in notes if note.code == "unreadable_log"] == [
        f"logs/{logs[2].name}",
        f"logs/{logs[8].name}",
    ]
    _same(read_campaign(source), read_campaign(source))


@pytest.mark.parametrize("world", ["all in the file", "the disk fills up", "nowhere to write"])
def test_columns_in_a_file_are_the_columns(source: Path, monkeypatch: pytest.MonkeyPatch, world: str) -> None:
    """What is asked for is the same, of all runs, of one, of some, and of a copy; held where it must be."""
    expected, write = read_campaign(source), os.pwrite

    def pwrite(file: int, data: bytes, place: int) -> int:
        if world == "the disk fills up" and place:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        # a call may write less than it is asked to
        return write(file, data[:1000], place)

    def nowhere() -> None:
        raise FileNotFoundError(errno.ENOENT, "no usable temporary directory")

    monkeypatch.setattr(model, "HELD_BYTES", 0)
    monkeypatch.setattr(os, "pwrite", pwrite)
    if world == "nowhere to write":
        monkeypatch.setattr(model, "TemporaryFile", nowhere)
    found = read_campaign(source)
    _same(found, expected)
    _same(deepcopy(found), expected)
    _same(found.select([1, 2, 7]), expected.select([1, 2, 7]))
    for run in range(N_RUNS):
        ours, theirs = found.logs.of(run), expected.logs.of(run)
        assert list(ours) == list(theirs)
        for name, column in ours.items():
            np.testing.assert_array_equal(column, theirs[name])
    columns = found.logs.columns
    held = [np.shares_memory(columns[name], columns[name]) for name in columns]
    assert any(held) == (world != "all in the file")


def test_a_log_of_one_sample_is_no_log(source: Path, tmp_path: Path) -> None:
    """Cut short by its logger: its run would be one without a path, and nobody would know."""
    folder = tmp_path / "c"
    shutil.copytree(source, folder)
    log = sorted((folder / "logs").iterdir())[0]
    log.write_text("\n".join(log.read_text().splitlines()[:2]) + "\n")
    with pytest.raises(BadFileError, match="found one row; expected one row a sample, two or more"):
        read_campaign(folder)
