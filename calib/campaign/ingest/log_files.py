"""Which file holds which run's log: by a column of the table, by a pattern, or by the run's name."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from calib.campaign.faults import Border
from calib.campaign.ingest.mapping import LogFiles
from calib.campaign.model import RunTable
from calib.campaign.readers import READERS, is_bag_folder
from calib.errors import BadFileError, BadInputError
from calib.files import sha256_file


def listed_files(sources: Sequence[Path]) -> list[Path]:
    """Return the files that sources stand for: themselves, rosbag2 folders, and what lies in other folders.

    Raises BadInputError where a source is not there.
    """
    files: list[Path] = []
    for source in sources:
        if is_bag_folder(source) or source.is_file():
            files.append(source)
        elif source.is_dir():
            files += sorted(
                path
                for path in source.iterdir()
                if is_bag_folder(path) or (path.is_file() and path.suffix.lower() in READERS)
            )
        else:
            raise BadInputError(f"{source}: found no such file; expected a log or a folder of logs; correct the path")
    return files


def run_number(run_id: str, pattern: str | None) -> int | None:
    """Return the number in a run's name, as a pattern (``Run {n}``) reads it, or the last number in it.

    `pattern`: text with ``{n}`` where the number stands.
    """
    if pattern is None:
        numbers = re.findall(r"\d+", run_id)
        return int(numbers[-1]) if numbers else None
    before, _, after = pattern.partition("{n}")
    match = re.fullmatch(re.escape(before) + r"\s*0*(\d+)\s*" + re.escape(after), run_id.strip(), re.IGNORECASE)
    return int(match[1]) if match else None


def expected_name(files: LogFiles, run_id: str) -> str | None:
    """Return the name of a run's log by the pattern; None where there is no pattern, or no number in the run's name."""
    if files.file is None:
        return None
    name = files.file.replace("{run_id}", run_id)
    if "{n" not in name:
        return name
    number = run_number(run_id, files.run)
    if number is None:
        return None
    return re.sub(r"\{n(?::0?(\d+))?\}", lambda match: str(number).zfill(int(match[1] or 0)), name)


def match_logs(
    runs: RunTable, files: Sequence[Path], pattern: LogFiles, shown: str, border: Border
) -> tuple[dict[int, Path], dict[int, str]]:
    """Find the log of each run.

    Parameters
    ----------
    runs : RunTable
        The runs.
    files : sequence of Path
        Logs there are.
    pattern : LogFiles
        How they are named.
    shown : str
        The table's name in messages.
    border : Border
        Takes notes.

    Returns
    -------
    matched : dict of int to Path
        Number of a run -> its log.
    missing : dict of int to str
        Number of a run whose log was expected and is not there -> the name that was looked for.

    Raises
    ------
    BadFileError
        Where no run finds its log although there are files, or a run finds two.
    """
    named = runs.labels.get("log")
    matched: dict[int, Path] = {}
    missing: dict[int, str] = {}
    for index, run_id in enumerate(map(str, runs.run_id)):
        if named is not None:
            wanted: str | None = str(named[index])
            if not wanted:
                continue
        else:
            wanted = expected_name(pattern, run_id)
        if wanted:
            name = wanted.replace("\\", "/").rpartition("/")[2].lower()
            fitting = [path for path in files if path.name.lower() == name]
        else:
            fitting = [path for path in files if path.stem == run_id]
        if len(fitting) > 1:
            raise _unmatched(shown, runs, index, f"{len(fitting)} source files named {wanted or run_id!r}")
        if fitting:
            matched[index] = fitting[0]
        elif wanted or files:
            missing[index] = wanted or f"{run_id}.*"
    if files and missing and not matched:
        index = next(iter(missing))
        raise _unmatched(shown, runs, index, f"no source file named {missing[index]!r}, nor any of the other runs'")
    _say_unused(set(matched.values()), files, border)
    return matched, missing


def _unmatched(shown: str, runs: RunTable, index: int, found: str) -> BadFileError:
    remedy = "name the file or its folder among the sources, or correct log.file of the mapping"
    return BadFileError(shown, found, "one log for the run", remedy, row=int(runs.line[index]), column="log")


def _say_unused(taken: set[Path], files: Sequence[Path], border: Border) -> None:
    left = [path for path in files if path not in taken]
    digests = {sha256_file(path): path for path in taken if path.is_file()} if left else {}
    for path in left:
        twin = digests.get(sha256_file(path)) if path.is_file() else None
        if twin is not None:
            border.say(str(path), f"holds the same bytes as {twin.name} and was left out", "repeated_log")
        else:
            border.say(str(path), "belongs to no run of the table and was left out", "unused_source")
