"""Inputs are never overwritten: while a command runs, no writer replaces what it reads."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import Final

from calib.errors import BadInputError

#: entries of an input folder searched for a hard link to the target; with more, the target is refused
MOST_SEARCHED: Final = 200_000
#: files that calib writes and never reads as measurements: inside an input folder they may be replaced
_OUTPUT_SUFFIXES: Final = frozenset({".json", ".pdf", ".png", ".svg", ".html", ".h", ".yaml", ".yml"})
_FIT: Final = "fit.json"
#: inputs of the running command; empty for a program that uses calib as a library
_INPUTS: Final[ContextVar[tuple[Path, ...]]] = ContextVar("inputs", default=())


@contextmanager
def inputs_kept(paths: Iterable[Path | str]) -> Iterator[None]:
    """Refuse to overwrite `paths` inside the block: files, or folders whose data files are meant."""
    token = _INPUTS.set((*_INPUTS.get(), *(Path(path) for path in paths)))
    try:
        yield
    finally:
        _INPUTS.reset(token)


def refuse_input(target: Path) -> None:
    """Raise BadInputError where `target` is an input, under any name: links, ``..``, another case."""
    for given in _INPUTS.get():
        if _is_input(Path(target), given):
            raise BadInputError(
                f"{target}: found an input of this command ({given}); expected another place for the output, since "
                "inputs are never written over; choose another path"
            )


def refuse_special(path: Path) -> None:
    """Raise BadInputError where `path`, to be read, is a device, a FIFO or a socket, which may never end."""
    with suppress(OSError, ValueError):
        mode = Path(path).stat().st_mode
        if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
            raise BadInputError(
                f"{path}: found a device, pipe or socket; expected a regular file or a folder; save the data to a file"
            )


def _is_input(target: Path, given: Path) -> bool:
    try:
        at, source = target.stat(), given.stat()
    except (OSError, ValueError, RuntimeError):
        return False  # what does not exist cannot be overwritten
    if not stat.S_ISDIR(source.st_mode):
        return os.path.samestat(at, source) and stat.S_ISREG(at.st_mode)
    if stat.S_ISDIR(at.st_mode):
        return False
    if at.st_nlink > 1 and _is_linked_from(given, at):
        return True
    real = target.resolve()
    between: list[Path] = []
    for parent in real.parents:
        if os.path.samestat(parent.stat(), source):
            return _is_data(real, between)
        between.append(parent)
    return False


def _is_data(path: Path, between: list[Path]) -> bool:
    """Return whether a file inside an input folder belongs to the input; `between`: the folders between them."""
    if any((folder / _FIT).is_file() for folder in between):
        return False  # a result inside the campaign's folder
    return path.suffix.lower() not in _OUTPUT_SUFFIXES or (path.name == _FIT and not between)


def _is_linked_from(folder: Path, at: os.stat_result) -> bool:
    """Return whether a data file of a folder is a hard link to `at`; True where the folder is too large to search."""
    searched = 0
    for place, _, names in os.walk(folder):
        searched += len(names) + 1
        if searched > MOST_SEARCHED:
            return True
        with suppress(OSError):
            for name in names:
                if Path(name).suffix.lower() not in _OUTPUT_SUFFIXES and os.path.samestat(
                    (Path(place) / name).stat(), at
                ):
                    return True
    return False
