"""Logs as read before: one file of plain columns a log, under the hash of its content; safe to delete at any time."""

from __future__ import annotations

import hashlib
import json
import os
import zlib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import astuple, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from calib.arrays import FloatArray
from calib.campaign.model import Note
from calib.errors import CalibError
from calib.files import write_bytes

#: environment variable: a folder for the cache, or ``off``
CACHE: Final = "CALIB_CACHE"
#: smaller campaigns are read in less time than it takes to ask
WORTH_BYTES: Final = 16 << 20
#: the oldest files go where all together are larger than this
MOST_BYTES: Final = 8 << 30
#: what reads a log, whose change makes what was kept worthless
_READ_BY: Final = ("columns.py", "log_cache.py", "logs_file.py", "readers/*.py")
_MAGIC: Final = b"calib-log-cache\n"


@dataclass(frozen=True, slots=True)
class ReadLog:
    """A log as read: its columns by calib's names (read-only where they come from the cache), and what was said."""

    columns: Mapping[str, FloatArray]
    notes: tuple[Note, ...]


@dataclass(frozen=True, slots=True)
class LogCache:
    """A folder of logs as read.

    A file is written under another name first and then renamed, so that a reader, this process or another, sees it
    whole or not at all; one that is damaged is as good as none.
    """

    folder: Path

    def path_of(self, sha256: str, asked: Sequence[Any]) -> Path:
        """Return the place of a log.

        `sha256`: of the file's bytes; `asked`: what else the answer depends on: the file's name in messages, columns
        renamed.
        """
        what = json.dumps([_read_by(), sha256, *asked], sort_keys=True)
        name = hashlib.sha256(what.encode("utf-8", "backslashreplace")).hexdigest()
        return self.folder / name[:2] / f"{name}.log"

    def get(self, path: Path) -> ReadLog | None:
        """Return what is kept at `path` (of `path_of`); None where there is nothing, or nothing whole."""
        try:
            data = path.read_bytes()
            head_end = data.index(b"\n", len(_MAGIC))
            if not data.startswith(_MAGIC):
                return None
            head = json.loads(data[len(_MAGIC) : head_end])
            body = memoryview(data)[head_end + 1 :]
            if zlib.crc32(body) != head["crc32"]:
                return None
            values = np.frombuffer(body, dtype="<f8").reshape(len(head["columns"]), -1)
            notes = tuple(Note(*map(str, note)) for note in head["notes"])
            columns = {str(name): row for name, row in zip(head["columns"], values, strict=True)}
        except (OSError, ValueError, KeyError, TypeError):
            return None
        return ReadLog(columns, notes)

    def put(self, path: Path, log: ReadLog) -> None:
        """Keep a log at `path`; where that cannot be done it is read again the next time."""
        values = np.ascontiguousarray(np.stack(list(log.columns.values())), dtype="<f8")
        body = values.data.cast("B")
        head = {"columns": list(log.columns), "notes": [astuple(note) for note in log.notes], "crc32": zlib.crc32(body)}
        data = b"".join((_MAGIC, json.dumps(head).encode("utf-8"), b"\n", body))
        with suppress(CalibError, OSError):
            path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            write_bytes(path, data, force=True)

    def trim(self, most_bytes: int = MOST_BYTES) -> None:
        """Remove the oldest files until all together are at most `most_bytes`."""
        files = []
        for path in self.folder.glob("*/*"):
            with suppress(OSError):
                status = path.stat()
                files.append((status.st_mtime_ns, status.st_size, path))
        total = sum(size for _, size, _ in files)
        for _, size, path in sorted(files):
            if total <= most_bytes:
                break
            with suppress(OSError):
                path.unlink()
            total -= size


def log_cache(n_bytes: int) -> LogCache | None:
    """Return the cache for a campaign's logs, or None where they are few bytes or the environment says ``off``."""
    chosen = os.environ.get(CACHE, "")
    if chosen == "off" or n_bytes < WORTH_BYTES:
        return None
    if chosen:
        return LogCache(Path(chosen))
    base = os.environ.get("XDG_CACHE_HOME", "")
    if not Path(base).is_absolute():
        try:
            base = str(Path.home() / ".cache")
        except RuntimeError:
            return None
    return LogCache(Path(base) / "calib" / "logs")


@lru_cache(maxsize=1)
def _read_by() -> str:
    """Return a digest of the code by which logs are read, the parser's version included."""
    from importlib.metadata import version

    here = Path(__file__).parent
    digest = hashlib.sha256(version("pandas").encode())
    for pattern in _READ_BY:
        for path in sorted(here.glob(pattern)):
            digest.update(path.read_bytes())
    return digest.hexdigest()
