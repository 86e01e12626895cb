"""Worlds that hinder a command itself: memory, files, rights, disks, no home, clocks, signals, kills, two writers.

Each has its own effect shown, so that a world that hinders nothing is a fault of the world.
"""

from __future__ import annotations

import itertools
import os
import resource
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from calib.fleet.store import SUMS
from tests.robust.ending import ended, forced, told, worded

#: address space beyond what the process has when the command begins
LITTLE_MEMORY_B = 48 * 2**20
#: largest file that may be written
SMALL_FILE_B = 600
NOBODY = 65534
#: after which a signal is sent, as shares of what the command takes
MOMENTS = (0.02, 0.3, 0.7)
HOUR_S = 3600.0


def _address_space() -> int:
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()


def little_memory(command: str, usual: int) -> Iterator[str]:
    """``ulimit -v``: what it would be, or one line and 2."""

    def limit() -> None:
        most = _address_space() + LITTLE_MEMORY_B
        resource.setrlimit(resource.RLIMIT_AS, (most, most))

    yield from told(command, ended(worded(command), before=limit), {usual, 2})


def small_files(command: str, usual: int) -> Iterator[str]:
    """``ulimit -f``: what writes more than that is told in one line; nothing half-written stays."""

    def limit() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (SMALL_FILE_B, SMALL_FILE_B))

    end = ended(worded(command), before=limit, piped=True)
    yield from told(command, end, {usual, 2})
    yield from _left_behind(command)
    # the lines of a fleet's store are sealed one by one: what was cut off is read again
    yield from told(f"{command}, again", ended(forced(command)), {usual})


def no_rights(command: str, usual: int) -> Iterator[str]:
    """As a user who may read everything and write nothing."""

    def become_nobody() -> None:
        os.setgroups([])
        os.setgid(NOBODY)
        os.setuid(NOBODY)

    yield from told(command, ended(worded(command), before=become_nobody), {usual, 2})
    if any(Path("out").rglob("*")):
        yield f"{command}: wrote without the right to"


def bare_environment(command: str, usual: int) -> Iterator[str]:
    """No HOME, no locale, TERM=dumb, 20 columns: what it would be, in plain text."""

    def strip() -> None:
        os.environ.clear()
        os.environ.update({"PATH": "/usr/bin:/bin", "TERM": "dumb", "COLUMNS": "20", "LC_ALL": "C"})

    end = ended(worded(command), before=strip)
    yield from told(command, end, {usual})
    if b"\x1b" in end.out:
        yield f"{command}: an escape sequence to a dumb terminal"


def clock_goes_back(command: str, usual: int) -> Iterator[str]:
    """Every look at the clock is an hour before the last one."""

    def turn_back() -> None:
        looks = itertools.count(1)
        once, once_ns = time.time(), time.time_ns()
        time.time = lambda: once - HOUR_S * next(looks)
        time.time_ns = lambda: once_ns - int(1e9 * HOUR_S) * next(looks)

    yield from told(command, ended(worded(command), before=turn_back), {usual})


def signals(command: str, usual: int) -> Iterator[str]:
    """An interrupt, a hang-up and a request to end, early, in the middle and late."""
    whole = ended(forced(command)).seconds
    for number, answers in ((signal.SIGINT, {130}), (signal.SIGTERM, {143, -15}), (signal.SIGHUP, {129, -1})):
        for share in MOMENTS:
            end = ended(forced(command), signalled=(number, share * whole))
            yield from told(f"{command}, {number.name} at {share:g}", end, {usual, 0, *answers})
    yield from told(f"{command}, after signals", ended(forced(command)), {usual})


def killed(command: str, usual: int) -> Iterator[str]:
    """SIGKILL early, in the middle and late: the next call ends as usual, and nothing unfinished stays."""
    whole = ended(forced(command)).seconds
    for share in MOMENTS:
        end = ended(forced(command), signalled=(signal.SIGKILL, share * whole))
        yield from told(f"{command}, killed at {share:g}", end, {usual, -9})
    yield from told(f"{command}, after kills", ended(forced(command)), {usual})
    yield from _unfinished(command)


def full_disk(command: str, usual: int) -> Iterator[str]:
    """The disk of the outputs has room for a page: what it would be, or one line and 2, nothing unfinished."""
    with _disk("size=4k"):
        yield from told(command, ended(forced(command)), {usual, 2})
        yield from _unfinished(command)


def read_only_disk(command: str, usual: int) -> Iterator[str]:
    """The disk of the outputs is mounted read-only: what it would be, or one line and 2."""
    with _disk("ro"):
        yield from told(command, ended(forced(command)), {usual, 2})


@contextmanager
def _disk(options: str) -> Iterator[None]:
    """Mount a disk in memory over the folder of the outputs; needs the right to mount."""
    subprocess.run(["mount", "-t", "tmpfs", "-o", options, "none", "out"], check=True)
    try:
        yield
    finally:
        subprocess.run(["umount", "out"], check=True)


def _unfinished(command: str) -> Iterator[str]:
    left = [str(path) for path in Path("out").rglob(".calib-*")]
    if left:
        yield f"{command}: {left[:3]} were left"


def two_writers(command: str, usual: int) -> Iterator[str]:
    """The same command twice at once, with leave to replace: both end as usual, and what stands is whole."""
    if "--force" not in (words := forced(command)):
        return
    alone = ended(words)
    before = _names()
    first = ended(words, beside=words)
    yield from told(f"{command}, first of two", first, {usual})
    second = first.beside
    assert second is not None
    yield from told(f"{command}, second of two", second, {usual})
    if _names() != before:
        yield f"{command}: two writers left {sorted(_names() ^ before)}"
    assert alone.status == usual


def _names() -> set[str]:
    return {str(path) for path in Path("out").rglob("*")}


def _left_behind(command: str) -> Iterator[str]:
    for path in Path("out").rglob("*"):
        if path.is_file() and path.name != SUMS and path.stat().st_size == SMALL_FILE_B:
            yield f"{command}: half of {path} was left"


HARD_WORLDS: dict[str, Callable[[str, int], Iterator[str]]] = {
    "memory": little_memory,
    "small-files": small_files,
    "no-rights": no_rights,
    "bare": bare_environment,
    "clock": clock_goes_back,
    "signals": signals,
    "killed": killed,
    "full-disk": full_disk,
    "read-only-disk": read_only_disk,
    "two-writers": two_writers,
}
#: worlds in which at least one command must have been hindered: otherwise the world itself does not work
HINDERING = {"memory", "small-files", "no-rights", "signals", "killed", "full-disk", "read-only-disk"}
