"""Hashes of logs known from an earlier reading, by the state that their files were in."""

from __future__ import annotations

import hashlib
import json
import os
import time
import zlib
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from calib.errors import CalibError
from calib.files import sha256_file, write_bytes

#: a file that changed less than this before its hash was taken may change again and bear the same times: not kept
SETTLED_NS: Final = 2_000_000_000


@dataclass(frozen=True, slots=True)
class FileState:
    """What the system says of a file without its being read: any writing to it moves the time of its last change."""

    #: which file, and its bytes
    device: int
    inode: int
    size: int
    #: time of its content, which programs may set, and of its last change, which the system alone sets
    modified_ns: int
    changed_ns: int

    @staticmethod
    def of(path: Path) -> FileState | None:
        """Return the state of a file, None where there is none."""
        try:
            status = path.stat()
        except OSError:
            return None
        return FileState(status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns)

    @property
    def key(self) -> str:
        """The state as text."""
        return f"{self.device}-{self.inode}-{self.size}-{self.modified_ns}-{self.changed_ns}"


@dataclass(frozen=True, slots=True)
class Content:
    """The hash of a file's bytes, empty where it cannot be read, and the state that the file was in before."""

    sha256: str
    state: FileState | None


@dataclass
class KnownHashes:
    """The hashes of the files of one folder; kept in a file of the cache, safe to delete at any time."""

    #: where they are kept; None keeps nothing
    place: Path | None
    #: SHA-256 by `FileState.key`, from before
    known: Mapping[str, str] = field(default_factory=dict)
    _seen: dict[str, str] = field(default_factory=dict)

    @staticmethod
    def read(cache: Path | None, folder: Path) -> KnownHashes:
        """Return what a cache knows of the files in a folder; nothing without a cache, or where it is damaged."""
        # times of change mean something where the system sets them
        if cache is None or os.name != "posix":
            return KnownHashes(None)
        name = hashlib.sha256(os.fsencode(folder.resolve())).hexdigest()
        place = cache / name[:2] / f"{name}.hashes"
        try:
            checksum, _, body = place.read_bytes().partition(b"\n")
            known = dict(json.loads(body)) if int(checksum) == zlib.crc32(body) else {}
        except (OSError, ValueError, TypeError):
            known = {}
        return KnownHashes(place, known)

    def content(self, path: Path) -> Content:
        """Return the hash of a file; its bytes are read where its state is not that of an earlier reading."""
        state = FileState.of(path)
        if state is None:
            return Content(_hash(path), None)
        sha256 = self.known.get(state.key, "")
        if not sha256:
            now = time.time_ns()
            sha256 = _hash(path)
            if max(state.modified_ns, state.changed_ns) > now - SETTLED_NS or FileState.of(path) != state:
                return Content(sha256, state)
        if sha256:
            self._seen[state.key] = sha256
        return Content(sha256, state)

    def keep(self) -> None:
        """Keep what was seen, where it is new; where that cannot be done the files are hashed again the next time."""
        if self.place is None or self._seen == self.known:
            return
        with suppress(CalibError, OSError):
            self.place.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            body = json.dumps(dict(sorted(self._seen.items()))).encode("ascii")
            write_bytes(self.place, b"%d\n%b" % (zlib.crc32(body), body), force=True)


def _hash(path: Path) -> str:
    with suppress(OSError):
        return sha256_file(path)
    return ""
