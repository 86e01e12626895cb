"""Logs from the cache are the logs as read, no matter what becomes of the cache; threads change nothing."""

from __future__ import annotations

import errno
import os
import shutil
import subprocess
import sys
from copy import deepcopy
from pathlib import Path

import numpy as np
import pytest

from calib.campaign import log_reading, model, write_campaign
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


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache that small campaigns are worth."""
    monkeypatch.setattr(log_reading, "WORTH_BYTES", 0)
    monkeypatch.setattr(log_reading, "WORTH_LOG_BYTES", 0)
    monkeypatch.setenv(log_reading.CACHE, str(tmp_path / "cache"))
    return tmp_path / "cache"


def _same(first: Campaign, second: Campaign) -> None:
    assert first.notes == second.notes
    assert first.hashes == second.hashes
    assert list(first.logs.columns) == list(second.logs.columns)
    np.testing.assert_array_equal(first.logs.offsets, second.logs.offsets)
    for name, column in first.logs.columns.items():
        np.testing.assert_array_equal(column, second.logs.columns[name])


def _entries(cache: Path) -> list[Path]:
    return sorted(path for path in cache.rglob("*.log") if path.is_file())


def test_what_the_cache_gives_is_what_was_read(source: Path, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Columns to the bit, notes in their order, hashes; and the second time no log is parsed."""
    first = read_campaign(source)
    assert len(_entries(cache)) == N_RUNS
    assert any(note.code == "delimiter" or "separated" in note.text for note in first.notes)
    monkeypatch.setattr(log_reading, "read_log", None)
    _same(first, read_campaign(source))


def test_changed_bytes_are_another_log(source: Path, cache: Path, tmp_path: Path) -> None:
    """Content is the key: neither name nor a time that programs can set is believed."""
    folder = tmp_path / "c"
    shutil.copytree(source, folder)
    read_campaign(folder)
    log = sorted((folder / "logs").iterdir())[0]
    status = log.stat()
    log.write_bytes(log.read_bytes().replace(b"\n0.1,", b"\n0.2,", 1))
    os.utime(log, ns=(status.st_atime_ns, status.st_mtime_ns))
    assert read_campaign(folder).logs.columns["t_s"][1] == 0.2


@pytest.mark.parametrize("damage", ["cut", "flip", "empty"])
def test_a_damaged_cache_is_no_cache(source: Path, cache: Path, damage: str) -> None:
    """Every entry cut short, with a bit turned over, or empty: the logs are read anew and kept whole again."""
    first = read_campaign(source)
    whole = [path.read_bytes() for path in _entries(cache)]
    for path in _entries(cache):
        data = bytearray(path.read_bytes())
        data[-20] ^= 4
        path.write_bytes({"cut": bytes(data[: len(data) // 2]), "flip": bytes(data), "empty": b""}[damage])
    _same(first, read_campaign(source))
    assert [path.read_bytes() for path in _entries(cache)] == whole


def test_a_cache_may_be_deleted_or_be_impossible(source: Path, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without its files, and with a file where its folder should be."""
    first = read_campaign(source)
    shutil.rmtree(cache)
    _same(first, read_campaign(source))
    shutil.rmtree(cache)
    cache.write_text("not a folder")
    _same(first, read_campaign(source))
    monkeypatch.setenv(log_reading.CACHE, "off")
    _same(first, read_campaign(source))


def test_two_processes_at_once_leave_whole_entries(source: Path, cache: Path) -> None:
    """Both start with nothing and write the same places: both read the same, and nothing half-written stays."""
    program = (
        "import sys; from calib.campaign import log_reading\n"
        "log_reading.WORTH_BYTES = log_reading.WORTH_LOG_BYTES = 0\n"
        "from pathlib import Path; from calib.campaign.read import read_campaign\n"
        "import pandas; sys.stdin.readline()\n"
        "print(float(sum(column.sum() for column in read_campaign(Path(sys.argv[1])).logs.columns.values())))"
    )
    command = [sys.executable, "-c", program, str(source)]
    root = Path(__file__).resolve().parents[2]
    both = [
        subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=root) for _ in range(2)
    ]
    for process in both:
        assert process.stdin is not None
        process.stdin.write("go\n")
        process.stdin.flush()
    answers = {process.communicate()[0] for process in both}
    assert len(answers) == 1
    assert next(iter(answers)).strip()
    assert {path.suffix for path in cache.rglob("*") if path.is_file()} <= {".log", ".hashes"}
    assert len(_entries(cache)) == N_RUNS


def test_the_oldest_go_first(source: Path, cache: Path) -> None:
    """Trimmed to about half, it keeps the newer half."""
    read_campaign(source)
    for path in cache.rglob("*.hashes"):
        path.unlink()
    entries = _entries(cache)
    for age, path in enumerate(entries):
        os.utime(path, (1e9 - age, 1e9 - age))
    sizes = [path.stat().st_size for path in entries]
    log_reading.trim_cache(cache, sum(sizes[:5]))
    assert _entries(cache) == entries[:5]


@pytest.mark.parametrize("threads", [1, 4])
def test_the_first_fault_in_the_order_of_runs_is_named(
    source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, threads: int
) -> None:
    """Two bad logs: the earlier is raised however many threads read; lenient, both are noted in their order."""
    monkeypatch.setattr(log_reading, "_processors", lambda: threads)
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
