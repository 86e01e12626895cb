"""Find the logs of the runs and read one of them."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from calib.campaign.model import LOG_COLUMNS, WHEEL_SETS, Border, RunTable
from calib.campaign.readers import READERS, Layout, read_table
from calib.campaign.readers.table import RawTable, Wanted
from calib.campaign.settings import Recognised, converted, recognise, second_column
from calib.errors import BadFileError
from calib.io import inside
from calib.types import FloatArray, IntArray

_MAX_PATH: Final = 500


def log_files(folder: Path, runs: RunTable, shown: str, border: Border) -> list[LogFile]:
    """Return the logs that there are, in the order of the runs.

    `folder`: the campaign's; `runs`: names the logs, else they are ``logs/<run_id>.csv`` or of another format; `shown`:
    the run table's name in messages; `border`: takes what is missing or named twice as faults. Raises BadFileError
    where a path leads out of the folder, or, for a border that is not lenient, at the first fault.
    """
    plain = _plain_logs(folder)
    files: list[LogFile] = []
    taken: dict[Path, int] = {}

    def fault(found: str, expected: str, remedy: str, row: int) -> BadFileError:
        return BadFileError(shown, found, expected, remedy, row=row, column="log")

    for index, (run_id, row) in enumerate(zip(map(str, runs.run_id), map(int, runs.line), strict=True)):
        if "log" in runs.labels:
            relative = str(runs.labels["log"][index])
        else:
            # a run id that is no plain file name has no log of that name
            candidates = [f"logs/{run_id}{suffix}" for suffix in READERS] if Path(run_id).name == run_id else []
            relative = next((name for name in candidates if name in plain or (folder / name).exists()), "")
        if not relative:
            continue
        if len(relative) > _MAX_PATH:
            raise fault(f"a path of {len(relative)} characters", f"at most {_MAX_PATH}", "correct the path", row)
        path = plain.get(relative) or inside(folder, relative, named_in=shown, row=row, column="log")
        if path in taken:
            twice = f"{relative}, which row {taken[path]} names too"
            border.fault(fault(twice, "a log of its own for each run", "correct the path", row), "shared_log", run_id)
        taken.setdefault(path, row)
        if relative not in plain and not _is_file(path):
            missing = f"{relative}, which is {'a folder' if path.is_dir() else 'not there'}"
            remedy = "put the file there, or leave the cell empty"
            border.fault(fault(missing, "a log file", remedy, row), "missing_log", run_id)
            continue
        files.append((index, run_id, path, relative))
    return files


def _plain_logs(folder: Path) -> dict[str, Path]:
    """Return the files of the folder ``logs`` to which no link leads, by their names in a run table.

    They are found in one go; what is not among them is looked into one by one.
    """
    logs = folder.resolve() / "logs"
    try:
        if logs.is_symlink():
            return {}
        with os.scandir(logs) as entries:
            names = [entry.name for entry in entries if entry.is_file(follow_symlinks=False)]
    except OSError:
        return {}
    return {f"logs/{name}": logs / name for name in names}


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:
        # a name that the file system cannot hold
        return False


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
        raise BadFileError(shown, "no rows", "one row a sample", "export the log again")
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
            expected = f"t_s with {' or '.join(' and '.join(names) for names in WHEEL_SETS)}"
            remedy = "name the columns so in the header line; a unit may differ if it is named (t_ms)"
            raise BadFileError(shown, "no such column", expected, remedy, row=1, column=name)
        # the sum of a column without a gap is a number: one pass
        if np.isnan(columns[name].sum()) and len(gaps := np.flatnonzero(np.isnan(columns[name]))):
            remedy = "remove the row; a gap in time is found and said"
            row = int(line[gaps[0]])
            raise BadFileError(shown, "an empty cell", "a number in every row", remedy, row=row, column=name)
