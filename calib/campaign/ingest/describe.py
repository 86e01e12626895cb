"""Describe files and propose a mapping for them, as commented TOML that ingest reads back."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from calib.campaign.ingest.contents import FileContents, described, file_contents, wrapped
from calib.campaign.ingest.guesses import guessed_log_column, guessed_table_column
from calib.campaign.ingest.proposal import mapping_lines
from calib.campaign.ingest.runs import listed_files
from calib.errors import BadInputError
from calib.result import plain

#: files of one kind that are read to the end; of more, the first and the last
_ALL_READ: Final = 40
#: rows of a run table to a log: means, remarks and runs without a log stand among them
MOST_ROWS_A_LOG: Final = 2


@dataclass(frozen=True, slots=True)
class Description:
    """The contents of files, and the mapping proposed for them."""

    #: every file looked into, the run table first
    files: tuple[FileContents, ...]
    #: number of all files; of many logs alike, some are looked into
    n_files: int
    #: the run table among them
    table: FileContents | None
    #: lines of the mapping
    mapping: tuple[str, ...]
    #: the sources as the command line takes them
    sources: str

    def to_toml(self) -> str:
        """Return the description as remarks and the proposed mapping beneath it: TOML that ingest takes."""
        lines = ["# Contents of the files, and a proposed mapping. Check every line, then:"]
        lines += wrapped(f"calib ingest {self.sources} --mapping THIS_FILE --into CAMPAIGN", "#   ", "")
        lines.append("#")
        groups: list[list[FileContents]] = []
        for file in self.files:
            # logs alike are described once
            logs = [] if file is self.table else [group for group in groups if group[0] is not self.table]
            alike = next((group for group in logs if group[0].alike(file)), None)
            if alike is None:
                groups.append([file])
            else:
                alike.append(file)
        for group in groups:
            lines += described(group, is_run_table=group[0] is self.table)
        return "\n".join([*lines, "", *self.mapping]) + "\n"

    def to_dict(self) -> dict[str, Any]:
        """Return the description for JSON."""
        table = None if self.table is None else self.table.name
        return {"n_files": self.n_files, "table": table, "files": plain(self.files), "mapping": self.to_toml()}


def describe(sources: Sequence[Path]) -> Description:
    """Describe files and propose a mapping.

    Raises BadInputError where a source cannot be read.
    """
    paths = listed_files([Path(source) for source in sources])
    if not paths:
        raise BadInputError(
            f"sources: found no file to read{_folders_inside(sources)}; expected tables, logs or recordings; name them,"
            " or the folder that holds them itself"
        )
    kinds: dict[str, list[Path]] = {}
    for path in paths:
        kinds.setdefault(f"{path.parent}/*{path.suffix.lower()}", []).append(path)
    chosen: list[Path] = []
    for members in kinds.values():
        chosen += members if len(members) <= _ALL_READ else [members[0], members[-1]]
    files = [file_contents(path) for path in chosen]
    table = _run_table(files, len(paths))
    logs = [file for file in files if file is not table]
    lines = mapping_lines(table, logs)
    # the table has to be named first, also where it was found in a folder
    given = [str(source) for source in sources]
    ordered = given if table is None else [table.name, *(source for source in given if source != table.name)]
    command = " ".join(f"'{source}'" if re.search(r"\s", source) else source for source in ordered)
    return Description((*([table] if table else ()), *logs), len(paths), table, tuple(lines), command)


def _folders_inside(sources: Sequence[Path]) -> str:
    """Return the folders in sources that hold no file to read, in words."""
    folders = [path for source in sources if source.is_dir() for path in sorted(source.iterdir()) if path.is_dir()]
    if not folders:
        return ""
    names = [path.name for path in folders[:3]] + ["..."] * (len(folders) > 3)
    return f" in {sources[0]}, which holds folders ({', '.join(names)})"


def _run_table(files: Sequence[FileContents], n_files: int) -> FileContents | None:
    """Return the file that names runs: a table with a column for their names, and more than a clock beside it.

    `n_files`: in all; where no name is known, the one table among logs with a row each is the run table.
    """
    best, best_score = None, 0
    for file in files:
        guesses = {guess[0] for column in file.columns if (guess := guessed_table_column(column.name))}
        timed = any((guess := guessed_log_column(column.name)) and guess[0] == "t_s" for column in file.columns)
        score = len(guesses) + 3 - 4 * timed
        if not file.recording and "run_id" in guesses and score > best_score:
            best, best_score = file, score
    if best is None:
        worded = [file for file in files if not file.recording and any(one.kind == "text" for one in file.columns)]
        if len(worded) == 1 and len(files) > 1 and n_files - 1 <= worded[0].n_rows <= MOST_ROWS_A_LOG * (n_files - 1):
            return worded[0]
    return best
