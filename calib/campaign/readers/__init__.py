"""Readers: one file a format, all returning the same `RawTable`; a new format is one file and one line here."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Final, Protocol, cast

from calib.campaign.readers.table import RawTable, Wanted
from calib.errors import BadFileError

__all__ = ["READERS", "RawTable", "Reader", "Wanted", "read_table"]

#: suffix -> module of this package that holds ``read(path, shown, wanted)``; imported when first needed
READERS: Final[dict[str, str]] = {
    ".csv": "delimited",
    ".tsv": "delimited",
    ".txt": "delimited",
    ".parquet": "parquet",
    ".xlsx": "spreadsheet",
}


class Reader(Protocol):
    """What a module of this package offers as ``read``."""

    def __call__(self, path: Path, shown: str, wanted: Wanted | None) -> RawTable:
        """Read `path` (called `shown` in messages); `wanted` picks and makes numeric, None keeps everything as read."""


def read_table(path: Path, shown: str, wanted: Wanted | None = None) -> RawTable:
    """Read a table with the reader that its suffix names.

    Parameters
    ----------
    path : Path
        The file.
    shown : str
        Its name in messages.
    wanted : callable, optional
        Called with each column name as found; True keeps the column and makes it numeric. Without it every column is
        kept as read, text included.

    Returns
    -------
    RawTable
        Columns under the names found in the file.

    Raises
    ------
    BadFileError
        Where the file is missing, of an unknown format or damaged, or a reader's extra is not installed.
    """
    module = READERS.get(path.suffix.lower())
    if module is None:
        raise BadFileError(
            shown,
            found=f"the suffix {path.suffix!r}",
            expected=f"one of {', '.join(READERS)}",
            remedy="export the table in one of these formats",
        )
    if not path.is_file():
        raise BadFileError(
            shown,
            found="a folder or special file" if path.exists() else "no such file",
            expected="a readable file",
            remedy="correct the path or put the file there",
        )
    reader = cast(Reader, importlib.import_module(f"calib.campaign.readers.{module}").read)
    try:
        return reader(path, shown, wanted)
    except OSError as error:
        raise BadFileError(
            shown, found=error.strerror or "an unreadable file", expected="a readable file", remedy="check its rights"
        ) from error
