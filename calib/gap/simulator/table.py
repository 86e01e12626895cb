"""The table that a simulator writes: a row a run, with the end of each run as it simulates it."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from calib.types import FloatArray

#: what a simulator may predict, in the order of the channels: distance, x, y, heading
COLUMNS: Final = ("sim_distance_m", "sim_x_m", "sim_y_m", "sim_theta_rad")
#: a run that ends further off, in metres or radians, has diverged
LARGEST: Final = 1e6
#: of a table of 100 000 runs; what is larger is no table of end poses
MOST_BYTES: Final = 32 << 20


class BadTableError(ValueError):
    """What is wrong with a simulator's table, as ``found ...; expected ...``."""


def read_table(path: Path, run_ids: Sequence[str]) -> FloatArray:
    """Return the simulated (distance, x, y, heading) of each run, (n_runs, 4); NaN in a column that is not written.

    Rows of other runs are passed over. Raises BadTableError.
    """
    try:
        if path.stat().st_size > MOST_BYTES:
            raise BadTableError(f"found a table of {path.stat().st_size} bytes; expected {MOST_BYTES} at most")
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise BadTableError("found no output file; expected it to write the CSV at {out}") from None
    except (OSError, UnicodeDecodeError) as error:
        raise BadTableError(f"found an output file that cannot be read ({error}); expected CSV in UTF-8") from error
    try:
        rows = list(csv.reader(io.StringIO(text)))
    except csv.Error as error:
        raise BadTableError(f"found {error} in its CSV; expected a header and a row a run") from error
    header = [name.strip() for name in rows[0]] if rows else []
    columns = [name for name in COLUMNS if name in header]
    if "run_id" not in header or not columns or len(set(header)) < len(header):
        raise BadTableError(
            f"found the columns {', '.join(header)[:120] or 'none'}; expected run_id and some of {', '.join(COLUMNS)}"
        )
    wanted = {run_id: number for number, run_id in enumerate(run_ids)}
    values = np.full((len(run_ids), len(COLUMNS)), np.nan)
    seen: set[str] = set()
    for line, row in enumerate(rows[1:], start=2):
        if not row:
            continue
        if len(row) != len(header):
            raise BadTableError(f"found {len(row)} cells in row {line} of its CSV; expected {len(header)}")
        cells = dict(zip(header, row, strict=True))
        run_id = cells["run_id"].strip()
        if run_id in seen:
            raise BadTableError(f"found run {run_id[:60]} twice in its CSV; expected a row a run")
        seen.add(run_id)
        if run_id in wanted:
            for name in columns:
                values[wanted[run_id], COLUMNS.index(name)] = _number(cells[name], name, run_id)
    missing = [run_id for run_id in run_ids if run_id not in seen]
    if missing:
        raise BadTableError(
            f"found no row for {len(missing)} of {len(run_ids)} runs ({missing[0]} first); expected all"
        )
    return values


def _number(text: str, name: str, run_id: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not abs(value) <= LARGEST:
        raise BadTableError(
            f"found {name} = {text[:30]!r} in run {run_id}; expected a number between -{LARGEST:g} and {LARGEST:g}"
        )
    return value
