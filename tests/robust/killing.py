"""Commands in a forked process that is killed: before its n-th change of a name, or after some time."""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import io
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import calib.io
from calib.cli.main import run
from calib.fleet.store import SUMS

ROOT = Path(__file__).resolve().parents[2]
KILLED = -signal.SIGKILL
#: seconds after which a child that was not killed counts as hanging
LONGEST_S = 300.0
#: what computes without reading or writing a file of the user's, and takes nearly all of a command's time
COMPUTED = (
    ("calib.gap.diagnose", "diagnose_in_full"),
    ("calib.kinematics.estimate", "estimate_geometry"),
    ("calib.reporting.figures", "render"),
    ("calib.reporting.pages", "to_pdf"),
    ("calib.reporting.pages", "to_html"),
)


@contextlib.contextmanager
def computed_once(arguments: list[str], cwd: Path) -> Iterator[int]:
    """Run a command here, keep what it computed for its copies, and yield its status.

    A copy started inside gets each result at once, in the order of the calls: a random kill then falls into reading,
    checking and writing, where something can be lost, rather than into arithmetic.
    """
    plain = {(module, name): getattr(importlib.import_module(module), name) for module, name in COMPUTED}
    kept: dict[tuple[str, str], list[Any]] = {place: [] for place in plain}

    def keeping(place: tuple[str, str]) -> Callable[..., Any]:
        def call(*args: Any, **kwargs: Any) -> Any:
            kept[place].append(plain[place](*args, **kwargs))
            return kept[place][-1]

        return call

    def giving(results: Iterator[Any]) -> Callable[..., Any]:
        return lambda *_args, **_kwargs: next(results)

    def put(made: Callable[[tuple[str, str]], Callable[..., Any]]) -> None:
        for module, name in plain:
            setattr(importlib.import_module(module), name, made((module, name)))

    before = Path.cwd()
    os.chdir(cwd)
    try:
        put(keeping)
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            status = run(arguments)
        put(lambda place: giving(iter(kept[place])))
        yield status
    finally:
        put(lambda place: plain[place])
        os.chdir(before)


def _deadly(function: Callable[..., Any], left: list[int]) -> Callable[..., Any]:
    def call(*args: Any, **kwargs: Any) -> Any:
        left[0] -= 1
        if left[0] < 0:
            os.kill(os.getpid(), signal.SIGKILL)
        return function(*args, **kwargs)

    return call


def _child(arguments: list[str], cwd: Path, deadly_change: int | None) -> None:
    os.chdir(cwd)
    nowhere = os.open(os.devnull, os.O_RDWR)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    sys.stdout = open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    sys.stderr = open(2, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    if deadly_change is not None:
        left = [deadly_change]
        # every way in which calib gives a file or a folder its name
        for name in ("rename", "replace", "link"):
            setattr(os, name, _deadly(getattr(os, name), left))
        calib.io._swap = _deadly(calib.io._swap, left)
    os._exit(run(arguments))


def started(arguments: list[str], cwd: Path, *, deadly_change: int | None = None) -> int:
    """Start a command in a copy of this process, whose imports it need not pay for, and return the copy's number."""
    child = os.fork()
    if not child:
        try:
            _child(arguments, cwd, deadly_change)
        finally:
            os._exit(99)
    return child


def ended(child: int, within_s: float = LONGEST_S) -> int:
    """Wait for a child and return its status, as `subprocess` gives it; one that hangs is killed and is 98."""
    until = time.monotonic() + within_s
    while time.monotonic() < until:
        number, status = os.waitpid(child, os.WNOHANG)
        if number:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.002)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return 98


def killed_at_rename(number: int, arguments: list[str], cwd: Path) -> int:
    """Return the status of a command that is killed before its change of a name number `number`, from 0."""
    return ended(started(arguments, cwd, deadly_change=number))


def killed_after(seconds: float, arguments: list[str], cwd: Path) -> int:
    """Return the status of a command that is killed after so many seconds, if it has not ended before."""
    child = started(arguments, cwd)
    time.sleep(seconds)
    os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    return os.waitstatus_to_exitcode(status)


def content(place: Path) -> dict[str, str]:
    """Return the hash of every file below a folder, or of a file, by its path.

    A killed writer's leftovers are left aside, and a fleet's store, which grows line by line.
    """
    if place.is_file():
        return {"": hashlib.sha256(place.read_bytes()).hexdigest()}
    return {
        str(path.relative_to(place)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(place.rglob("*"))
        if path.is_file() and path.name != SUMS and not _is_leftover(path.relative_to(place))
    }


def _is_leftover(path: Path) -> bool:
    return any(part.startswith(".calib-") for part in path.parts)


def leftovers(folder: Path) -> list[str]:
    """Return what killed writers left below a folder."""
    return sorted(str(path.relative_to(folder)) for path in folder.rglob(".calib-*.tmp"))
