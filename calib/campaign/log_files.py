"""Which logs the runs of a campaign have."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, Final

from calib.campaign.faults import Border
from calib.campaign.logs_file import LogFile
from calib.campaign.model import RunTable
from calib.campaign.readers import READERS
from calib.errors import BadFileError
from calib.files import inside

_MAX_PATH: Final = 500


def log_files(folder: Path, runs: RunTable, shown: str, border: Border) -> list[LogFile]:
    """Return the logs that there are, in the order of the runs.

    `folder`: the campaign's; `runs`: names the logs, else they are ``logs/<run_id>.csv`` or of another format; `shown`:
    the run table's name in messages; `border`: takes what is missing or named twice as faults. Raises BadFileError
    where a path leads out of the folder, or, for a border that is not lenient, at the first fault.
    """
    plain = _plain_logs(folder)
    named = "log" in runs.labels
    files: list[LogFile] = []
    taken: dict[Path, int] = {}
    for index, (run_id, row) in enumerate(zip(map(str, runs.run_id), map(int, runs.line), strict=True)):
        if named:
            relative = str(runs.labels["log"][index])
        else:
            # a run id that is no plain file name has no log of that name
            candidates = [f"logs/{run_id}{suffix}" for suffix in READERS] if Path(run_id).name == run_id else []
            relative = next((name for name in candidates if name in plain or (folder / name).exists()), "")
        if not relative:
            continue
        place: dict[str, Any] = {"row": row, "column": "log"}
        if len(relative) > _MAX_PATH:
            length = f"a path of {len(relative)} characters"
            raise BadFileError(shown, length, f"at most {_MAX_PATH}", "correct the path", **place)
        path = plain.get(relative) or inside(folder, relative, named_in=shown, row=row, column="log")
        if path in taken:
            twice = f"{relative}, which row {taken[path]} names too"
            fault = BadFileError(shown, twice, "a log of its own for each run", "correct the path", **place)
            border.fault(fault, "shared_log", run_id)
        taken.setdefault(path, row)
        if relative not in plain and not _is_file(path):
            missing = f"{relative}, which is {'a folder' if path.is_dir() else 'not there'}"
            fault = BadFileError(shown, missing, "a log file", "put the file there, or leave the cell empty", **place)
            border.fault(fault, "missing_log", run_id)
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
