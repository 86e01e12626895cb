"""A folder's vehicles with their files, and what was read of these, kept line by line."""

import hashlib
import json
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path
from typing import Any, Final, TypeVar

from calib.campaign.readers import READERS, read_table
from calib.documents import VERSION, plain
from calib.errors import BadFileError, BadInputError, CalibError
from calib.fleet.workers import Engine, Task
from calib.io import inside, sha256_file, write_text
from calib.types import Progress

SETTINGS: Final = "campaign.toml"
LABELS: Final = "vehicles.csv"
SUFFIX: Final = ".parquet"
_PARTITION: Final = re.compile(r"vehicle=(.+)")
_MONTH: Final = re.compile(r"month=(\d{4})-(\d{2})")


@dataclass(frozen=True)
class Part:
    """A file with journeys of one vehicle."""

    name: str
    path: Path
    settings: Path
    day: float | None = None
    why: str = ""
    whole: bool = False  #: all journeys of a vehicle, in a campaign folder


@dataclass(frozen=True)
class Member:
    """A vehicle: its id and the files of its journeys, in order."""

    vehicle: str
    parts: tuple[Part, ...]


def members_of(folder: Path) -> tuple[Member, ...]:
    """Return the vehicles of a fleet, by id.

    `folder`: one campaign folder a vehicle; or ``campaign.toml`` beside folders ``vehicle=ID`` (``month=YYYY-MM``
    within) of ``.parquet`` files with the columns of ``runs.csv``.
    """
    if not folder.is_dir():
        actual = "a file" if folder.exists() else "no such folder"
        expected = "a folder with one campaign folder a vehicle, or a dataset partitioned by vehicle"
        raise BadFileError(folder, actual, expected, "give the fleet's folder")
    folder = folder.resolve()
    members = _dataset(folder) if (folder / SETTINGS).is_file() else _campaigns(folder)
    if not members:
        expected = "campaign folders, or campaign.toml beside folders vehicle=ID of .parquet files"
        raise BadFileError(folder, "no vehicle", expected, "give the folder that holds them")
    return members


def _campaigns(folder: Path) -> tuple[Member, ...]:
    members = []
    for path in sorted(folder.iterdir()):
        try:
            table = next((f"runs{suffix}" for suffix in READERS if (path / f"runs{suffix}").exists()), "")
            if not table and not (path / SETTINGS).exists() and not (path / SETTINGS).is_symlink():
                continue
            part = replace(_part(folder, f"{path.name}/{table or 'runs.csv'}", path), whole=True)
        except OSError as error:
            part = Part(f"{path.name}/runs.csv", path / "runs.csv", path, why=one_line(error))
        members.append(Member(path.name, (part,)))
    return tuple(members)


def _part(folder: Path, name: str, settings: Path, day: float | None = None) -> Part:
    try:
        return Part(name, inside(folder, name, named_in=folder), settings, day)
    except CalibError as error:
        return Part(name, folder / name, settings, day, one_line(error))


def _dataset(folder: Path) -> tuple[Member, ...]:
    members = []
    with os.scandir(folder) as entries:
        of_vehicles = [entry for entry in entries if _PARTITION.fullmatch(entry.name) and entry.is_dir()]
    for entry in sorted(of_vehicles, key=lambda entry: entry.name):
        parts = []
        for name, partition, direct in sorted(_files_in(entry.path, entry.name, plain=not entry.is_symlink())):
            day = _day_of(partition)
            parts.append(Part(name, folder / name, folder, day) if direct else _part(folder, name, folder, day))
        members.append(Member(entry.name.partition("=")[2], tuple(parts)))
    return tuple(members)


def _files_in(folder: str, name: str, *, plain: bool) -> Iterator[tuple[str, str, bool]]:
    with os.scandir(folder) as entries:
        for entry in entries:
            below = f"{name}/{entry.name}"
            if entry.is_dir(follow_symlinks=False):
                yield from _files_in(entry.path, below, plain=plain)
            elif entry.name.endswith(SUFFIX):
                yield below, name.rpartition("/")[2], plain and not entry.is_symlink()


def _day_of(partition: str) -> float | None:
    month = _MONTH.fullmatch(partition)
    if month is None or not 1 <= int(month[2]) <= 12:
        return None
    return float((date(int(month[1]), int(month[2]), 15) - date(1970, 1, 1)).days)


def any_simulated(folder: Path) -> bool:
    """Return whether a program made any vehicle's data."""
    import tomllib

    for settings in {part.settings for member in members_of(folder) for part in member.parts}:
        path = settings / SETTINGS
        # a device or a pipe may have no end
        with suppress(OSError, ValueError):
            if path.is_file() and tomllib.loads(path.read_text(encoding="utf-8")).get("simulated") is True:
                return True
    return False


def labels_of(folder: Path, members: Sequence[Member]) -> dict[str, dict[str, str]]:
    """Return the labels of vehicles in ``vehicles.csv``: column -> vehicle -> label."""
    path = folder / LABELS
    if not path.is_file():
        return {}
    columns = dict(read_table(path, LABELS).columns)
    if "vehicle" not in columns:
        actual, remedy = f"the columns {', '.join(columns)[:80]}", "name the vehicles as their folders are named"
        raise BadFileError(LABELS, actual, "a column vehicle", remedy)
    ids = [str(cell) for cell in columns.pop("vehicle")]
    known = {member.vehicle for member in members}
    return {
        name: {one: str(cell) for one, cell in zip(ids, cells, strict=True) if one in known and cell not in (None, "")}
        for name, cells in columns.items()
    }


def one_line(error: Exception) -> str:
    """Return what an error says on one line."""
    text = str(error)
    if isinstance(error, OSError):
        why = str(error.strerror).lower()
        text = f"{error.filename}: found {why}; expected a file that can be read; add or allow it, or take it away"
    return " ".join(text.split())


SUMS: Final = "sums.jsonl"
Source = TypeVar("Source", Part, Member)
#: a digest of the line's other values
SEAL: Final = "seal"


@dataclass(frozen=True, slots=True)
class Kept:
    """A kept record: unique name, key of its source (empty: make anew), line."""

    name: str
    key: str
    line: str

    @staticmethod
    def of(record: Any) -> "Kept":
        """Return the line of a dataclass that has a `name` and a `key`."""
        values = plain(record)
        return Kept(record.name, record.key, json.dumps({**values, SEAL: _seal(values)}, ensure_ascii=False) + "\n")

    def values(self) -> dict[str, Any]:
        """Return the line's values; raises ValueError where it was changed."""
        values = dict(json.loads(self.line))
        if values.pop(SEAL, "") != _seal(values):
            raise ValueError("a kept line was changed")
        return values


def _seal(values: Mapping[str, Any]) -> str:
    return hashlib.blake2b(json.dumps(values, ensure_ascii=False).encode(), digest_size=8).hexdigest()


def renewed(
    path: Path,
    sources: Mapping[str, Source],
    opened: Engine,
    task: Task[Source, Kept],
    given_up: Callable[[Source, str], Kept],
    progress: Progress,
    stage: str,
    weigh: Callable[[Source], int] = lambda _source: 1,
) -> tuple[dict[str, Kept], int]:
    """Do a task for new or changed sources; return all records, and how many were done.

    `path`: of the sorted records; `sources`: by record name; for the others see `Engine.run`.
    """
    before, keys = _read(path), Keys()
    records = {name: before[name] for name, source in sources.items() if keys.hold(before.get(name), source)}
    todo = [source for name, source in sources.items() if name not in records]
    with path.open("ab") as stream:
        # an interruption may cut the last line
        if stream.tell():
            stream.write(b"\n")
        for number, record in enumerate(opened.run(task, todo, given_up, weigh), 1):
            stream.write(record.line.encode())
            stream.flush()
            records[record.name] = record
            progress(number, len(todo), stage)
    write_text(path, "".join(records[name].line for name in sorted(records)), force=True)
    return records, len(todo)


def _read(path: Path) -> dict[str, Kept]:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInputError(
            f"{path.parent}: found {error.strerror}; expected a folder that can be written; choose another"
        ) from error
    if path.exists() and not path.is_file():
        raise BadInputError(f"{path}: found no regular file; expected one, or none; take it away")
    kept: dict[str, Kept] = {}
    whole = sealed = False
    with suppress(FileNotFoundError), path.open(encoding="utf-8", errors="surrogateescape") as stream:
        for line in stream:
            whole, sealed = whole or line.endswith("\n"), sealed or f'"{SEAL}"' in line
            with suppress(ValueError, KeyError, TypeError, AttributeError, RecursionError):
                values = Kept("", "", line).values()
                kept[values["name"]] = Kept(values["name"], values["key"], line)
    if whole and not sealed:
        text = f"{path}: found no record of calib; expected those of an earlier run, or no file"
        raise BadInputError(f"{text}; choose another folder, or move the file away")
    return kept


DIGEST_BYTES: Final = 16


class Keys:
    """Makes keys of files' bytes and calib's version; shared settings are read once."""

    def __init__(self) -> None:
        self._settings: dict[Path, str] = {}

    def of(self, source: Part | Member) -> str:
        """Return the key of a file with settings and logs, or a vehicle."""
        if isinstance(source, Member):
            return "|".join(f"{part.name}:{self.of(part)}" for part in source.parts)
        if source.why:
            raise CalibError(source.why)
        digest = hashlib.blake2b(VERSION.encode(), digest_size=DIGEST_BYTES)
        if source.whole:
            for line in _lines(source.settings):
                digest.update(line.encode("utf-8", "surrogateescape"))
        else:
            if source.settings not in self._settings:
                self._settings[source.settings] = sha256_file(source.settings / SETTINGS)
            digest.update(f"{self._settings[source.settings]} {sha256_file(source.path)}".encode())
        return digest.hexdigest()

    def hold(self, kept: Kept | None, source: Part | Member) -> bool:
        """Return whether a record is there and its source is unchanged."""
        with suppress(CalibError, OSError):
            return kept is not None and kept.key != "" and kept.key == self.of(source)
        return False


def _lines(folder: Path) -> Iterator[str]:
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_symlink():
            yield f"{name} -> {path.readlink()}\n"
        elif path.is_file():
            yield f"{name} {sha256_file(path)}\n"
        elif not path.is_dir():
            yield f"{name} is no file\n"
