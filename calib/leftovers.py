"""Names of what is half-written, so that it is recognised after a crash and removed."""

from __future__ import annotations

import hashlib
import os
import secrets
import shutil
import socket
from contextlib import suppress
from pathlib import Path
from typing import Final

PREFIX: Final = ".calib-"
SUFFIX: Final = ".tmp"
#: stands for the target's name where a folder is renewed from inside
INSIDE: Final = "inside"


def temporary_beside(path: Path, where: Path | None = None) -> Path:
    """Return a fresh name for what will become `path`: short, hidden, and telling whose it is.

    `where`: the folder for it; None: the target's own.
    """
    mark = _mark(path) if where is None else INSIDE
    stem = f"{PREFIX}{mark}-{_host()}-{os.getpid()}-{secrets.token_hex(3)}{SUFFIX}"
    return (path.parent if where is None else where) / stem


def sweep(path: Path) -> None:
    """Remove what earlier writers of `path` left beside it when they were killed; those at work are left alone."""
    for leftover in path.parent.glob(f"{PREFIX}{_mark(path)}-{_host()}-*{SUFFIX}"):
        if is_dead(leftover):
            remove(leftover)


def inside(folder: Path) -> list[Path]:
    """Return what killed writers left inside `folder` when they renewed it there."""
    return [path for path in folder.glob(f"{PREFIX}{INSIDE}-{_host()}-*{SUFFIX}") if is_dead(path)]


def remove(path: Path) -> None:
    """Remove a file or a folder with all that is in it; what cannot be removed stays for the next time."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink(missing_ok=True)


def is_dead(path: Path) -> bool:
    """Return whether the process that made a temporary file or folder is gone."""
    try:
        os.kill(int(path.name.split("-")[3]), 0)
    except ProcessLookupError:
        return True
    except (OSError, ValueError, IndexError, OverflowError):
        # another user's process, or a name that is none of ours
        return False
    return False


def _mark(path: Path) -> str:
    return hashlib.sha256(os.fsencode(path.name)).hexdigest()[:8]


def _host() -> str:
    return hashlib.sha256(socket.gethostname().encode()).hexdigest()[:6]
