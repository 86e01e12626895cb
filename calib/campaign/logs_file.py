"""Read a log."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from calib.arrays import FloatArray, IntArray
from calib.campaign.columns import Recognised, converted, recognise, second_column
from calib.campaign.faults import Border
from calib.campaign.model import LOG_COLUMNS, WHEEL_SETS
from calib.campaign.readers import Layout, read_table
from calib.campaign.readers.table import RawTable, Wanted
from calib.errors import BadFileError

#: run number, run id, path, and its name in messages
LogFile = tuple[int, str, Path, str]

#: column as found -> name with unit that it stands for, and a factor
Renames = Mapping[str, tuple[str, float]]


def read_log(
    path: Path,
    shown: str,
    border: Border,
    renames: Renames | None = None,
    layout: Layout | None = None,
    raw: RawTable | None = None,
) -> dict[str, FloatArray]:
    """Read one log.

    Parameters
    ----------
    path : Path
        The file, of any format that a reader knows.
    shown : str
        Its name in messages.
    border : Border
        Takes notes.
    renames : mapping of str to (str, float), optional
        Column as found -> name that it stands for, with a unit (``t_ms``), and a factor.
    layout : Layout, optional
        Sheet and header row where they are known.
    raw : RawTable, optional
        The file's columns of `wanted_in_log` where they were read already.

    Returns
    -------
    dict of str to array of float, shape (n_samples,)
        Columns of `LOG_COLUMNS`, SI units, times from the run's start.

    Raises
    ------
    BadFileError
        Where a required column is missing or holds a gap, or a cell is no number.
    """
    names = renames or {}
    if raw is None:
        raw = read_table(path, shown, wanted_in_log(renames), layout)
    border.notes.extend(raw.notes)
    columns: dict[str, FloatArray] = {}
    for found, cells in raw.columns.items():
        match = log_column(names[found][0] if found in names else found)
        if match.name in columns:
            raise second_column(match, found, shown)
        if match.said:
            border.say(f"{shown}, column {found}", match.said, "unit" if match.factor != 1.0 else "name")
        factor = match.factor * (names[found][1] if found in names else 1.0)
        columns[match.name] = converted(cells, factor, match.offset)
    refuse_incomplete(columns, shown, raw.line)
    if not len(raw.line):
        raise BadFileError(shown, found="no rows", expected="one row a sample", remedy="export the log again")
    if abs(start := float(columns["t_s"][0])) > 1.0:
        border.say(shown, f"times count from the first sample, which stood at {start:.10g} s", "start_time")
        columns["t_s"] = columns["t_s"] - start
    return columns


def wanted_in_log(renames: Renames | None = None) -> Wanted:
    """Return what says of a column's name whether a log may hold it; see `read_log`."""
    names = renames or {}
    return lambda found: log_column(names[found][0] if found in names else found).name in LOG_COLUMNS


def log_column(name: str) -> Recognised:
    """Return what a column of a log is, by its whole name or, in a recording, by the part after its stream or group.

    `name`: as found: ``counts_left``, ``Encoder/counts_left`` or ``/wheels:counts_left``.
    """
    whole = recognise(name, LOG_COLUMNS, further=False)
    if whole.name in LOG_COLUMNS:
        return whole
    return replace(recognise(re.split(r"[:/]", name)[-1], LOG_COLUMNS, further=False), found=name)


def refuse_incomplete(columns: Mapping[str, FloatArray], shown: str, line: IntArray) -> None:
    """Refuse a log without time or wheels, or with gaps in them.

    `columns` (shape (n_samples,)); `line` (shape (n_samples,)): line of each sample in the file. Raises BadFileError:
    names the column that is missing, or the row of the empty cell.
    """
    wheels = max(WHEEL_SETS, key=lambda names: sum(name in columns for name in names) / len(names))
    for name in ("t_s", *wheels):
        if name not in columns:
            others = " or ".join(" and ".join(names) for names in WHEEL_SETS)
            raise BadFileError(
                shown,
                row=1,
                column=name,
                found="no such column",
                expected=f"t_s with {others}",
                remedy="name the columns so in the header line; a unit may differ if it is named (t_ms)",
            )
        # the sum of a column without a gap is a number: one pass
        if not np.isnan(columns[name].sum()):
            continue
        gaps = np.flatnonzero(np.isnan(columns[name]))
        if len(gaps):
            raise BadFileError(
                shown,
                row=int(line[gaps[0]]),
                column=name,
                found="an empty cell",
                expected="a number in every row",
                remedy="remove the row; a gap in time is found and said",
            )
