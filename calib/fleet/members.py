"""Which vehicles a folder holds, and which files each vehicle's journeys stand in."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Final

from calib.campaign.readers import READERS, read_table
from calib.errors import BadFileError, CalibError
from calib.io import inside

SETTINGS: Final = "campaign.toml"
LABELS: Final = "vehicles.csv"
SUFFIX: Final = ".parquet"
_PARTITION: Final = re.compile(r"vehicle=(.+)")
_MONTH: Final = re.compile(r"month=(\d{4})-(\d{2})")


@dataclass(frozen=True)
class Part:
    """A file with journeys of one vehicle.

    Parameters
    ----------
    name : str
        Path relative to the fleet's folder; names the part in results.
    path : Path
        Where it is.
    settings : Path
        Folder of its ``campaign.toml``.
    day : float or None
        Day of its journeys since 1970-01-01 where the partition says a month (its fifteenth); None where only the
        column ``day`` can.
    why : str
        Why the file may not be read, on one line; empty where it may.
    """

    name: str
    path: Path
    settings: Path
    day: float | None = None
    why: str = ""


@dataclass(frozen=True)
class Member:
    """A vehicle: its id and the files of its journeys, in order."""

    vehicle: str
    parts: tuple[Part, ...]


def members_of(folder: Path) -> tuple[Member, ...]:
    """Return the vehicles of a fleet, by id.

    `folder`: either one campaign folder a vehicle, or a Parquet dataset: ``campaign.toml``, which holds for all, beside
    folders ``vehicle=ID`` (with or without ``month=YYYY-MM`` within) of ``.parquet`` files whose columns are those of
    ``runs.csv``. Raises BadFileError where the folder holds no vehicle.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise BadFileError(
            folder,
            found="a file" if folder.exists() else "no such folder",
            expected="a folder with one campaign folder a vehicle, or a dataset partitioned by vehicle",
            remedy="give the fleet's folder",
        )
    found = _dataset(folder) if (folder / SETTINGS).is_file() else _campaigns(folder)
    if not found:
        raise BadFileError(
            folder,
            found="no vehicle",
            expected="campaign folders, or campaign.toml beside folders vehicle=ID of .parquet files",
            remedy="give the folder that holds them",
        )
    return found


def _campaigns(folder: Path) -> tuple[Member, ...]:
    members = []
    for path in sorted(folder.iterdir()):
        try:
            if not (path / SETTINGS).exists() and not (path / SETTINGS).is_symlink():
                continue
        except OSError as error:
            why = f"{path.name}: found {error.strerror}; expected a folder that can be read; allow it, or take it away"
            members.append(Member(path.name, (Part(f"{path.name}/runs.csv", path / "runs.csv", path, why=why),)))
            continue
        tables = (path / f"runs{suffix}" for suffix in READERS)
        table = next((one for one in tables if one.exists()), path / "runs.csv")
        members.append(Member(path.name, (_part(folder, f"{path.name}/{table.name}", path),)))
    return tuple(members)


def _part(folder: Path, name: str, settings: Path, day: float | None = None) -> Part:
    """Return a file of journeys; one that leads out of the fleet says so, and leaves the others alone."""
    try:
        return Part(name, inside(folder, name, named_in=folder), settings, day)
    except CalibError as error:
        return Part(name, folder / name, settings, day, one_line(error))


def _dataset(folder: Path) -> tuple[Member, ...]:
    members = []
    top = folder.resolve()
    with os.scandir(folder) as entries:
        of_vehicles = [entry for entry in entries if _PARTITION.fullmatch(entry.name) and entry.is_dir()]
    for entry in sorted(of_vehicles, key=lambda entry: entry.name):
        # a million files: paths are put together as text, and only what may lead elsewhere is resolved one by one
        parts = tuple(
            Part(name, top / name, folder, _day_of(partition))
            if plain
            else _part(folder, name, folder, _day_of(partition))
            for name, partition, plain in sorted(_files_in(entry.path, entry.name, plain=not entry.is_symlink()))
        )
        members.append(Member(entry.name.partition("=")[2], parts))
    return tuple(members)


def _files_in(folder: str, name: str, *, plain: bool) -> Iterator[tuple[str, str, bool]]:
    """Yield the Parquet files below a folder: name within the fleet, last folder, whether no link leads there."""
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
    """Return whether the settings of any vehicle of a fleet say that a program made its data."""
    import tomllib

    for settings in {part.settings for member in members_of(folder) for part in member.parts}:
        try:
            with (settings / SETTINGS).open("rb") as stream:
                if tomllib.load(stream).get("simulated") is True:
                    return True
        except (OSError, ValueError):
            # a vehicle whose settings cannot be read is listed as failed
            continue
    return False


def labels_of(folder: Path, members: Sequence[Member]) -> dict[str, dict[str, str]]:
    """Return what is known of vehicles beside their journeys (hall, type, ...): column -> label of each that has one.

    `folder`: may hold ``vehicles.csv``, a column ``vehicle`` and further columns of labels.
    """
    path = Path(folder) / LABELS
    if not path.is_file():
        return {}
    columns = dict(read_table(path, LABELS).columns)
    if "vehicle" not in columns:
        raise BadFileError(
            LABELS,
            found=f"the columns {', '.join(columns)[:80]}",
            expected="a column vehicle",
            remedy="name the vehicles as their folders are named",
        )
    ids = [str(cell) for cell in columns.pop("vehicle")]
    known = {member.vehicle for member in members}
    return {
        name: {
            vehicle: str(cell)
            for vehicle, cell in zip(ids, cells, strict=True)
            if vehicle in known and cell not in (None, "")
        }
        for name, cells in columns.items()
    }


def one_line(error: Exception) -> str:
    """Return what an error says on one line."""
    return " ".join(str(error).split())
