"""What was read of a fleet, kept by content, line by line: an interrupted run goes on, only new journeys are read."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Generic, Protocol, TypeVar

from calib.documents import VERSION
from calib.errors import BadInputError, CalibError
from calib.fleet.members import SETTINGS, Member, Part
from calib.io import sha256_file, write_text
from calib.result import plain

SUMS: Final = "sums.jsonl"
#: key of a line's seal: a digest of its other values, so that a damaged line is read anew
SEAL: Final = "seal"


class Kept(Protocol):
    """What can be kept: a dataclass with a name of its own and a key by which its source is known again."""

    @property
    def name(self) -> str:
        """Name, unique in the store."""

    @property
    def key(self) -> str:
        """Key of the source's state; empty where it shall be done anew."""


@dataclass(frozen=True, slots=True)
class VehicleResult:
    """Result of a task for one vehicle: its id, the key of its files, plain JSON values; `why` it failed, one line."""

    name: str
    key: str
    values: Mapping[str, Any] = field(default_factory=dict)
    why: str = ""

    @property
    def status(self) -> str:
        """``done`` or ``failed``."""
        return "failed" if self.why else "done"


Record = TypeVar("Record", bound=Kept)


class Store(Generic[Record]):
    """A file of records in a fleet's result folder, which it makes: one line each, appended as they come.

    `from_dict` makes a record of its kept values.
    """

    def __init__(self, path: Path, from_dict: Callable[[Mapping[str, Any]], Record]) -> None:
        self.path, self.from_dict = Path(path), from_dict
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise BadInputError(
                f"{self.path.parent}: found {error.strerror}; expected a folder that can be written; choose another"
            ) from error
        if self.path.exists() and not self.path.is_file():
            raise BadInputError(f"{self.path}: found no regular file; expected one, or none; take it away")

    def read(self) -> dict[str, Record]:
        """Return what is kept, by name; a line cut short by an interruption, or changed since, is dropped."""
        kept: dict[str, Record] = {}
        if not self.path.is_file():
            return kept
        # bytes that are no UTF-8 break the seal of their line, and of no other
        with self.path.open(encoding="utf-8", errors="surrogateescape") as stream:
            for line in stream:
                try:
                    record = self.from_dict(unsealed(line))
                except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
                    continue
                kept[record.name] = record
        return kept

    @contextmanager
    def adding(self) -> Iterator[Callable[[Mapping[str, str]], None]]:
        """Give a function that adds lines (see `line_of`), by their names, each of them whole."""
        with self.path.open("ab") as stream:
            # after an interruption the last line may lack its end
            if stream.tell() and not _ends_whole(self.path):
                stream.write(b"\n")

            def add(lines: Mapping[str, str]) -> None:
                stream.write("".join(lines.values()).encode())
                stream.flush()

            yield add

    def rewrite(self, lines: Mapping[str, str]) -> None:
        """Put all lines in order of their names, each once; the same bytes in any order of arrival."""
        write_text(self.path, "".join(lines[name] for name in sorted(lines)), force=True)


def line_of(record: Kept) -> str:
    """Return the line that is kept of a record, with its seal."""
    values = plain(record)
    return json.dumps({**values, SEAL: _seal(values)}, ensure_ascii=False) + "\n"


def unsealed(line: str) -> dict[str, Any]:
    """Return the values of a kept line; raises ValueError where they are not what was written."""
    values: dict[str, Any] = json.loads(line)
    if values.pop(SEAL, "") != _seal(values):
        raise ValueError("a kept line was changed")
    return values


def _seal(values: Mapping[str, Any]) -> str:
    return hashlib.blake2b(json.dumps(values, ensure_ascii=False).encode(), digest_size=8).hexdigest()


def _ends_whole(path: Path) -> bool:
    with path.open("rb") as stream:
        stream.seek(-1, os.SEEK_END)
        return stream.read(1) == b"\n"


#: bytes of a digest in a key: chance makes two alike in no fleet
DIGEST_BYTES: Final = 16


class Keys:
    """Makes keys of files; settings that several files share are read once.

    A key is that of the bytes which a result follows from, never of a file's time: copied, restored and corrected files
    are told apart. A result of another version of calib is not kept.
    """

    def __init__(self) -> None:
        self._settings: dict[Path, str] = {}

    def of(self, part: Part) -> str:
        """Return the key of a file of journeys with its settings and logs.

        Raises OSError where it cannot be read, CalibError where it may not be.
        """
        if part.why:
            raise CalibError(part.why)
        digest = hashlib.blake2b(VERSION.encode(), digest_size=DIGEST_BYTES)
        if part.path.parent == part.settings:
            for line in _lines(part.settings):
                digest.update(line.encode("utf-8", "surrogateescape"))
        else:
            if part.settings not in self._settings:
                self._settings[part.settings] = sha256_file(part.settings / SETTINGS)
            digest.update(f"{self._settings[part.settings]} {sha256_file(part.path)}".encode())
        return digest.hexdigest()

    def of_member(self, member: Member) -> str:
        """Return the key of all files of a vehicle."""
        return "|".join(f"{part.name}:{self.of(part)}" for part in member.parts)

    def hold(self, kept: Kept | None, source: Part | Member) -> bool:
        """Return whether a record is there and its source is unchanged."""
        with suppress(CalibError, OSError):
            key = self.of(source) if isinstance(source, Part) else self.of_member(source)
            return kept is not None and kept.key != "" and kept.key == key
        return False


def _lines(folder: Path) -> Iterator[str]:
    """Yield a line for each file of a campaign folder: its name and its content, or what stands in its place."""
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_symlink():
            # what it leads to within the folder has a line of its own
            yield f"{name} -> {path.readlink()}\n"
        elif path.is_file():
            yield f"{name} {sha256_file(path)}\n"
        elif not path.is_dir():
            yield f"{name} is no file\n"
