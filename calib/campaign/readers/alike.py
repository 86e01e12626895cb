"""Many small text tables with the same header, parsed as one: what a parser costs to begin is paid once."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from calib.arrays import FloatArray
from calib.campaign.readers.delimited import begins_with_its_header
from calib.campaign.readers.layout import of_one_width
from calib.campaign.readers.table import LARGEST, RawTable, Wanted, refuse_duplicates
from calib.errors import BadFileError

SUFFIX: Final = ".csv"
#: what takes a file out: quotes, other ends of lines, other separators, no text, and a zero with a sign, which is one
#: among decimals and none among whole numbers
_ODD: Final = (b'"', b"\r", b";", b"\t", b"\0")
_SIGNED_ZERO: Final = (b"-0,", b"-0\n")
#: whole numbers from here on are told apart only where they are read as such
_EXACT: Final = 2.0**53


@dataclass(frozen=True, slots=True)
class _Plain:
    """A file that can be read with others: its place among them, header, rows with their ends, and their number."""

    place: int
    header: bytes
    body: bytes
    rows: int


def read_alike(files: Sequence[tuple[Path, str]], wanted: Wanted) -> list[RawTable | None]:
    """Read the plain ones among some files; the same numbers as `calib.campaign.readers.read_table` gives for each.

    `files`: files and their names in messages; `wanted`: called with each column name; True keeps the column. One a
    file; None where it has to be read by itself, whatever the reason.
    """
    tables: list[RawTable | None] = [None] * len(files)
    alike: dict[bytes, list[_Plain]] = {}
    for place, (path, shown) in enumerate(files):
        plain = _plain(path, shown, place)
        if plain is not None:
            alike.setdefault(plain.header, []).append(plain)
    for header, group in alike.items():
        names = [name.strip() for name in header.decode("ascii").split(",")]
        keep = [name for name in names if name and wanted(name)]
        values = _values(group, names, keep) if keep else None
        if values is None:
            continue
        first = 0
        for plain in group:
            part = values[first : first + plain.rows]
            columns = {name: part[:, column] for column, name in enumerate(keep)}
            tables[plain.place] = RawTable(columns, np.arange(2, plain.rows + 2, dtype=np.int64))
            first += plain.rows
    return tables


def _plain(path: Path, shown: str, place: int) -> _Plain | None:
    """Return a file with commas between plain cells, as many in each row as in the header; else None."""
    if path.suffix.lower() != SUFFIX:
        return None
    try:
        data = path.read_bytes()
    except OSError:
        return None
    begin = data.find(b"\n") + 1
    if not 0 < begin < len(data) or not data.isascii() or any(odd in data for odd in _ODD):
        return None
    # one sign is found at the speed of memory, several are not
    if b"-" in data and any(zero in data for zero in _SIGNED_ZERO):
        return None
    if not data.endswith(b"\n"):
        data += b"\n"
    header = data[: begin - 1]
    rows = data.count(b"\n") - 1
    names = [name.strip() for name in header.decode("ascii").split(",")]
    body = data[begin:]
    if not of_one_width(body, len(names), ",") or not begins_with_its_header(data, shown):
        return None
    try:
        refuse_duplicates(names, shown)
    except BadFileError:
        return None
    return _Plain(place, header, body, rows)


def _values(group: Sequence[_Plain], names: Sequence[str], keep: Sequence[str]) -> FloatArray | None:
    """Return the numbers of all rows, shape (n_rows, n_kept); None where any cell is odd."""
    import pandas as pd

    positions = [names.index(name) for name in keep]
    try:
        frame = pd.read_csv(
            io.BytesIO(b"".join(plain.body for plain in group)),
            header=None,
            names=range(len(names)),
            usecols=positions,
            engine="c",
            index_col=False,
            quoting=csv.QUOTE_NONE,
            skip_blank_lines=False,
            low_memory=False,
            na_values=["-"],
        )
    except (ValueError, OverflowError):
        return None
    kinds = [dtype.kind for dtype in frame.dtypes]
    if len(frame) != sum(plain.rows for plain in group) or not set(kinds) <= set("iuf"):
        return None
    values = frame[positions].to_numpy(np.float64)
    low, high = np.fmin.reduce(values, axis=0), np.fmax.reduce(values, axis=0)
    if (low < -LARGEST).any() or (high > LARGEST).any():
        return None
    decimal = np.array([kind == "f" for kind in kinds])
    if (decimal & ((low <= -_EXACT) | (high >= _EXACT))).any():
        return None
    return np.asarray(values)
