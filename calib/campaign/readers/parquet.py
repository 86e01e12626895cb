"""Parquet tables, with the ``parquet`` extra."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np

from calib.campaign.readers.table import NS_PER_S, Layout, RawTable, Wanted, check_header, numbers, object_array
from calib.errors import BadFileError, error_words, missing_reader

_MAX_ROWS: Final = 200_000_000
#: below this many rows threads cost more than they save
_THREADS_ROWS: Final = 100_000


def _filled(column: Any, empty: float) -> np.ndarray[Any, Any]:
    """Return a column of numbers of eight bytes, `empty` where it has none; Arrow's own conversion imports pandas."""
    whole = (column.fill_null(empty) if column.null_count else column).combine_chunks()
    dtype = np.dtype(str(whole.type).replace("double", "float64"))
    if not len(whole):
        return np.empty(0, dtype)
    return np.frombuffer(whole.buffers()[1], dtype, len(whole), whole.offset * dtype.itemsize).copy()


def _cells(column: Any) -> tuple[np.ndarray[Any, Any], int | None]:
    """Return a column's cells, and the epoch (ns) of one that holds moments."""
    import pyarrow as pa

    if column.type in (pa.float64(), pa.int64()) and not column.null_count:
        # without Arrow's functions, which take longer to import than a small table to read
        return _filled(column, np.nan).astype(np.float64, copy=False), None
    if pa.types.is_integer(column.type) or pa.types.is_floating(column.type):
        return _filled(column.cast(pa.float64(), safe=False), np.nan), None
    if pa.types.is_timestamp(column.type):
        # exact: nanoseconds as recorded, told from other integers by the note of their epoch
        moments = _filled(column.cast(pa.timestamp("ns")).cast(pa.int64()), np.iinfo(np.int64).min)
        epoch = int(moments[0]) if len(moments) else 0
        return (moments - epoch) / NS_PER_S, epoch
    if pa.types.is_string(column.type):
        return object_array(column.to_pylist()), None
    cells = (float(cell) if isinstance(cell, bool) else cell for cell in column.to_pylist())
    return object_array([cell if cell is None or isinstance(cell, float) else str(cell) for cell in cells]), None


def _damaged(shown: str, error: Exception, column: str | None = None) -> BadFileError:
    found = f"a damaged parquet file ({error_words(error)})"
    return BadFileError(shown, found, "a whole one", "write it again", column=column)


def read(path: Path, shown: str, wanted: Wanted | None, layout: Layout) -> RawTable:  # noqa: ARG001 - a reader's form
    """Read a parquet file; see `calib.campaign.readers.read_table`."""
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError as error:
        raise missing_reader(shown, "a parquet file", "pyarrow", "parquet") from error
    try:
        with pq.ParquetFile(path) as source:
            names = list(source.schema_arrow.names)
            rows = int(source.metadata.num_rows)
            check_header(names, shown)
            if not 0 <= rows <= _MAX_ROWS:
                raise BadFileError(shown, f"{rows} rows promised", f"at most {_MAX_ROWS}", "split the file")
            kept = [name for name in names if wanted is None or wanted(name)]
            table = source.read(columns=kept, use_threads=rows > _THREADS_ROWS)
    except (pa.ArrowException, OSError, ValueError, OverflowError) as error:
        raise _damaged(shown, error) from error
    line = np.arange(1, table.num_rows + 1, dtype=np.int64)
    columns: dict[str, np.ndarray[Any, Any]] = {}
    epochs: dict[str, int] = {}
    for name in kept:
        try:
            cells, epoch = _cells(table.column(name))
        except (pa.ArrowException, ValueError, OverflowError) as error:
            # bytes that are no text, dates beyond the calendar: found only where a column is looked into
            raise _damaged(shown, error, name) from error
        if epoch is not None:
            epochs[name] = epoch
        if wanted is not None:
            cells, _ = numbers(cells, shown=shown, column=name, line=line)
        columns[name] = cells
    return RawTable(columns, line, (), epochs)
