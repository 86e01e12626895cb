"""Inputs are sacred: while a command runs, nothing is written over what it was given to read."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import Final

from calib.errors import BadInputError

#: what the command at work was given to read; empty for a program that uses calib as a library
_INPUTS: Final[ContextVar[tuple[Path, ...]]] = ContextVar("inputs", default=())
#: files that calib makes and never takes for measurements: inside an input folder they may be replaced
_MADE: Final = frozenset({".json", ".pdf", ".png", ".svg", ".html", ".h", ".yaml", ".yml"})
_FIT: Final = "fit.json"
#: entries of an input folder among which a second name of a file is looked for; with more, the file is refused
MOST_LOOKED_AT: Final = 200_000


@contextmanager
def inputs_kept(paths: Iterable[Path | str]) -> Iterator[None]:
    """Hold `paths` sacred inside the block: no writer of `calib.files` or `calib.folders` replaces them.

    `paths`: files, or folders whose data files are meant (campaigns, result folders, folders of logs).
    """
    token = _INPUTS.set((*_INPUTS.get(), *(Path(path) for path in paths)))
    try:
        yield
    finally:
        _INPUTS.reset(token)


def refuse_input(target: Path) -> None:
    """Refuse to write to `target` where it is an input, under whatever name: links, ``..``, another case.

    Raises BadInputError where it is one; the message never advises to force.
    """
    for given in _INPUTS.get():
        if _is_input(Path(target), given):
            raise BadInputError(
                f"{target}: found an input of this command ({given}); expected another place for the output, since "
                "inputs are never written over; choose another path"
            )


def refuse_special(path: Path) -> None:
    """Refuse to read what is no regular file and no folder: a device may be endless, a FIFO may never speak.

    Raises BadInputError where `path` is a device, a FIFO or a socket.
    """
    try:
        mode = Path(path).stat().st_mode
    except (OSError, ValueError):
        return
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise BadInputError(
            f"{path}: found a device, pipe or socket; expected a regular file or a folder; save the data to a file"
        )


def _is_input(target: Path, given: Path) -> bool:
    try:
        at, source = target.stat(), given.stat()
    except (OSError, ValueError, RuntimeError):
        # what does not exist cannot be written over
        return False
    if not stat.S_ISDIR(source.st_mode):
        return os.path.samestat(at, source) and stat.S_ISREG(at.st_mode)
    if stat.S_ISDIR(at.st_mode):
        return False
    if at.st_nlink > 1 and _linked_from(given, at):
        return True
    real = target.resolve()
    inner: list[Path] = []
    for parent in real.parents:
        if os.path.samestat(parent.stat(), source):
            return _is_data(real, inner)
        inner.append(parent)
    return False


def _is_data(path: Path, between: list[Path]) -> bool:
    """Return whether a file inside an input folder belongs to the input; `between` are the folders on the way."""
    if any((folder / _FIT).is_file() for folder in between):
        # a result that stands inside the campaign
        return False
    return path.suffix.lower() not in _MADE or (path.name == _FIT and not between)


def _linked_from(folder: Path, at: os.stat_result) -> bool:
    """Return whether a file has a second name among the data of a folder; True where that takes too long to tell."""
    seen = 0
    for place, _, names in os.walk(folder):
        seen += len(names) + 1
        if seen > MOST_LOOKED_AT:
            return True
        if not names:
            continue
        with suppress(OSError), os.scandir(place) as entries:
            if any(
                entry.inode() == at.st_ino
                and Path(entry.name).suffix.lower() not in _MADE
                and os.path.samestat(entry.stat(), at)
                for entry in entries
            ):
                return True
    return False
