"""Readers of tables and recordings; a new format is one function and one line here."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from calib.campaign.readers.table import Layout, RawTable, Wanted
from calib.errors import BadFileError

if TYPE_CHECKING:
    from calib.campaign.readers.recording import Recording

__all__ = [
    "READERS", "Layout", "RawTable", "Wanted", "holds_recording", "is_bag_folder", "read_recording", "read_table",
]  # fmt: skip

#: suffix -> module and function of this package: ``read…(path, shown, wanted, layout)`` returns a `RawTable`,
#: ``record…(path, shown, wanted)`` a `Recording`. `shown` is the file's name in messages
READERS: Final[dict[str, str]] = {
    ".csv": "delimited.read",
    ".tsv": "delimited.read",
    ".txt": "delimited.read",
    ".parquet": "workbook.read_parquet",
    ".xlsx": "workbook.read_sheet",
    ".tdms": "daq.record_tdms",
    ".bag": "ros.record",
    ".mcap": "ros.record",
    ".db3": "ros.record",
    ".mat": "daq.record_mat",
    ".tum": "recording.record",
}
BAG_METADATA: Final = "metadata.yaml"


def read_table(path: Path, shown: str, wanted: Wanted | None = None, layout: Layout | None = None) -> RawTable:
    """Read a table, or the joined streams of a recording, with its suffix's reader.

    `path`: a file, or a rosbag2 folder; `wanted`: whether to keep the column of a name, as numbers; None keeps all as
    read. Raises BadFileError where the file is missing, unknown or damaged, or an extra is not installed.
    """
    read = _reader(path, shown)
    try:
        if holds_recording(path):
            from calib.campaign.readers.recording import joined_table

            return joined_table(read(path, shown, wanted))
        table: RawTable = read(path, shown, wanted, layout or Layout())
    except OSError as error:
        raise _unreadable(shown, error) from error
    return table


def read_recording(path: Path, shown: str, wanted: Callable[[str], bool] | None = None) -> Recording:
    """Read a recording: a ROS bag, TDMS, ``.mat`` or trajectory file.

    See `read_table`; a `WantedColumns` lets whole topics be passed over. Raises BadFileError also of a table.
    """
    record = _reader(path, shown)
    if not holds_recording(path):
        raise BadFileError(shown, "a table", "a recording (bag, TDMS, .mat, .tum)", "read it as a table")
    try:
        recording: Recording = record(path, shown, wanted)
    except OSError as error:
        raise _unreadable(shown, error) from error
    return recording


def holds_recording(path: Path) -> bool:
    """Return whether a path's format holds streams."""
    return ".record" in _name(path)


def is_bag_folder(path: Path) -> bool:
    """Return whether a path is a rosbag2 folder."""
    return path.is_dir() and (path / BAG_METADATA).is_file()


def _name(path: Path) -> str:
    return READERS.get(".bag" if path.name == BAG_METADATA or is_bag_folder(path) else path.suffix.lower(), "")


def _reader(path: Path, shown: str) -> Callable[..., Any]:
    module, _, function = _name(path).partition(".")
    if not module:
        expected = f"one of {', '.join(READERS)}, or the folder of a rosbag2 recording"
        raise BadFileError(shown, f"the suffix {path.suffix!r}", expected, "export the table in one of these formats")
    if not path.is_file() and not is_bag_folder(path):
        found = "a folder or special file" if path.exists() else "no such file"
        raise BadFileError(shown, found, "a readable file", "correct the path or put the file there")
    reader: Callable[..., Any] = getattr(importlib.import_module(f"{__name__}.{module}"), function)
    return reader


def _unreadable(shown: str, error: OSError) -> BadFileError:
    return BadFileError(shown, error.strerror or "an unreadable file", "a readable file", "check its rights")
