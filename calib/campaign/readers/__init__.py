"""Readers: one file a format, tables and recordings alike; a new format is one file and one line here."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any, Final, Protocol, cast

from calib.campaign.readers.layout import Layout
from calib.campaign.readers.recording import Recording, joined_table
from calib.campaign.readers.table import RawTable, Wanted
from calib.errors import BadFileError

__all__ = [
    "READERS",
    "Layout",
    "RawTable",
    "Reader",
    "Recorder",
    "Recording",
    "Wanted",
    "holds_recording",
    "is_bag_folder",
    "read_recording",
    "read_table",
]

#: suffix -> module of this package that holds ``read`` (tables) or ``record`` (recordings); imported when first needed
READERS: Final[dict[str, str]] = {
    ".csv": "delimited",
    ".tsv": "delimited",
    ".txt": "delimited",
    ".parquet": "parquet",
    ".xlsx": "spreadsheet",
    ".tdms": "tdms",
    ".bag": "ros",
    ".mcap": "ros",
    ".db3": "ros",
    ".mat": "matlab",
    ".tum": "tum",
}
#: a rosbag2 recording is a folder with this file
BAG_METADATA: Final = "metadata.yaml"


class Reader(Protocol):
    """What a module for tables offers as ``read``."""

    def __call__(self, path: Path, shown: str, wanted: Wanted | None, layout: Layout) -> RawTable:
        """Read `path` (called `shown` in messages); `wanted` picks and makes numeric, None keeps everything as read."""


class Recorder(Protocol):
    """What a module for recordings offers as ``record``."""

    def __call__(self, path: Path, shown: str, wanted: Callable[[str], bool] | None) -> Recording:
        """Read the streams of `path` that hold a column for which `wanted` is true; None keeps everything."""


def read_table(path: Path, shown: str, wanted: Wanted | None = None, layout: Layout | None = None) -> RawTable:
    """Read a table with the reader that its suffix names; the streams of a recording are joined to one.

    `path`: the file, or the folder of a rosbag2 recording. `wanted`: called with each column name as found; True keeps
    the column and makes it numeric. Without it every column is kept as read, text included. `layout`: sheet and header
    row where they are known; else they are looked for. Columns under the names found in the file. Raises BadFileError
    where the file is missing, of an unknown format or damaged, or a reader's extra is not installed.
    """
    module = _module(path, shown)
    try:
        if hasattr(module, "record"):
            return joined_table(cast(Recorder, module.record)(path, shown, wanted))
        return cast(Reader, module.read)(path, shown, wanted, layout or Layout())
    except OSError as error:
        raise _unreadable(shown, error) from error


def read_recording(path: Path, shown: str, wanted: Callable[[str], bool] | None = None) -> Recording:
    """Read a recording: a ROS bag, TDMS, ``.mat`` or trajectory file.

    `path`: the file, or the folder of a rosbag2 recording. `wanted`: called with each column name; True keeps the
    column. A `WantedColumns` lets whole topics be passed over. Raises BadFileError as `read_table`; and where the file
    is a table.
    """
    module = _module(path, shown)
    if not hasattr(module, "record"):
        raise BadFileError(shown, "a table", "a recording (bag, TDMS, .mat, .tum)", "read it as a table")
    try:
        return cast(Recorder, module.record)(path, shown, wanted)
    except OSError as error:
        raise _unreadable(shown, error) from error


def holds_recording(path: Path) -> bool:
    """Return whether a path is of a format that holds streams rather than one table."""
    name = _module_name(path)
    return name is not None and hasattr(importlib.import_module(f"{__name__}.{name}"), "record")


def is_bag_folder(path: Path) -> bool:
    """Return whether a path is the folder of a rosbag2 recording."""
    return path.is_dir() and (path / BAG_METADATA).is_file()


def _module_name(path: Path) -> str | None:
    if path.name == BAG_METADATA or is_bag_folder(path):
        return "ros"
    return READERS.get(path.suffix.lower())


def _module(path: Path, shown: str) -> ModuleType | Any:
    name = _module_name(path)
    if name is None:
        expected = f"one of {', '.join(READERS)}, or the folder of a rosbag2 recording"
        raise BadFileError(shown, f"the suffix {path.suffix!r}", expected, "export the table in one of these formats")
    if not path.is_file() and not is_bag_folder(path):
        remedy = "correct the path or put the file there"
        raise BadFileError(
            shown, "a folder or special file" if path.exists() else "no such file", "a readable file", remedy
        )
    return importlib.import_module(f"{__name__}.{name}")


def _unreadable(shown: str, error: OSError) -> BadFileError:
    return BadFileError(shown, error.strerror or "an unreadable file", "a readable file", "check its rights")
