"""Say what files hold, and propose a commented mapping for them, as TOML that ingest reads back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from calib.campaign.ingest.found import ColumnFound, FileFound, look_into
from calib.campaign.ingest.log_files import listed_files
from calib.campaign.ingest.propose import Proposal, propose
from calib.campaign.ingest.words import guessed_log_column, guessed_table_column
from calib.errors import BadInputError

#: files of one kind that are read to the end; of more, the first and the last
_READ_TO_THE_END: Final = 40
_WIDTH: Final = 78


@dataclass(frozen=True, slots=True)
class Description:
    """What is in files, and the mapping proposed."""

    #: every file looked into
    files: tuple[FileFound, ...]
    #: files there are; of many logs alike, some are looked into
    n_files: int
    #: the run table among them
    table: FileFound | None
    proposal: Proposal

    def to_toml(self) -> str:
        """Return the description as remarks and the proposed mapping beneath it: TOML that ingest takes."""
        lines = ["# What was found, and a mapping to go by. Check every line, then:"]
        lines += _wrapped(f"calib ingest {self.proposal.sources} --mapping THIS_FILE --into CAMPAIGN", "#   ", "")
        lines.append("#")
        shown: list[list[FileFound]] = []
        for file in self.files:
            # logs alike are described once
            alike = next((group for group in shown if _alike(group[0], file) and file is not self.table), None)
            if alike is None or alike[0] is self.table:
                shown.append([file])
            else:
                alike.append(file)
        for group in shown:
            lines += _described(group, self)
        lines += ["", *self.proposal.lines]
        return "\n".join(lines) + "\n"

    def to_dict(self) -> dict[str, Any]:
        """Return it for JSON."""
        return {
            "n_files": self.n_files,
            "table": None if self.table is None else self.table.name,
            "files": [file.to_dict() for file in self.files],
            "mapping": self.to_toml(),
        }


def describe(sources: Sequence[Path]) -> Description:
    """Look into files and propose a mapping.

    Raises BadInputError where a source cannot be read.
    """
    paths = listed_files([Path(source) for source in sources])
    if not paths:
        raise BadInputError(
            f"sources: found no file to read{_inside(sources)}; expected tables, logs or recordings; name them, or the "
            "folder that holds them itself"
        )
    kinds: dict[str, list[Path]] = {}
    for path in paths:
        kinds.setdefault(f"{path.parent}/*{path.suffix.lower()}", []).append(path)
    chosen: list[Path] = []
    for members in kinds.values():
        chosen += members if len(members) <= _READ_TO_THE_END else [members[0], members[-1]]
    files = [look_into(path) for path in chosen]
    table = _run_table(files)
    if table is not None:
        files = [table, *(file for file in files if file is not table)]
    logs = [file for file in files if file is not table]
    return Description(tuple(files), len(paths), table, propose(table, logs, [str(source) for source in sources]))


def _inside(sources: Sequence[Path]) -> str:
    """Return what lies in folders that hold no file to read, in words."""
    folders = [path for source in sources if source.is_dir() for path in sorted(source.iterdir()) if path.is_dir()]
    if not folders:
        return ""
    names = [path.name for path in folders[:3]] + ["..."] * (len(folders) > 3)
    return f" in {sources[0]}, which holds folders ({', '.join(names)})"


def _alike(file: FileFound, other: FileFound) -> bool:
    return [column.name for column in file.columns] == [column.name for column in other.columns]


def _run_table(files: Sequence[FileFound]) -> FileFound | None:
    """Return the file that names runs: a table with a column for their names, and more than a clock beside it."""
    best, best_score = None, 0
    for file in files:
        if file.recording:
            continue
        guesses = {guess[0] for column in file.columns if (guess := guessed_table_column(column.name))}
        timed = any((guess := guessed_log_column(column.name)) and guess[0] == "t_s" for column in file.columns)
        score = len(guesses) + 3 * ("run_id" in guesses) - 4 * timed
        if "run_id" in guesses and score > best_score:
            best, best_score = file, score
    return best


def _wrapped(text: str, lead: str, after: str) -> list[str]:
    import textwrap

    return textwrap.wrap(
        text,
        _WIDTH,
        initial_indent=lead,
        subsequent_indent=lead + after,
        break_long_words=False,
        break_on_hyphens=False,
    )


def _described(group: Sequence[FileFound], description: Description) -> list[str]:
    file = group[0]
    title = file.name if len(group) == 1 else f"{file.name} .. {Path(group[-1].name).name}, {len(group)} files alike"
    what = "the run table" if file is description.table else "a recording" if file.recording else "a log"
    rows = [member.n_rows for member in group]
    count = f"{min(rows)}" if min(rows) == max(rows) else f"{min(rows)} to {max(rows)}"
    lines = _wrapped(f"{title}: {what}, {count} {'rows' if not file.recording else 'samples'}", "# ", "  ")
    for remark in dict.fromkeys(file.remarks):
        lines += _wrapped(remark, "#   ", "  ")
    for key, value in list(file.properties.items())[:12]:
        lines += _wrapped(f"{key} = {value}", "#   ", "  ")
    for stream in file.streams:
        text = f"{stream.name} ({stream.kind}): {stream.n_samples} samples"
        if stream.start_ns is not None:
            text += f" over {stream.span_s:.5g} s at {stream.rate_Hz:.4g} Hz, clock: {stream.clock}"
            if stream.n_gaps:
                text += f", {stream.n_gaps} gap(s) up to {stream.longest_gap_s:.3g} s"
        else:
            text += ", without a clock"
        lines += _wrapped(text, "#   ", "  ")
    for number, column in enumerate(file.columns):
        lines += _column_lines(column, [member.columns[number] for member in group])
    lines.append("#")
    return lines


def _column_lines(column: ColumnFound, alike: Sequence[ColumnFound]) -> list[str]:
    text = f"{column.name}: "
    if column.kind == "number":
        low, high = min(c.low for c in alike if c.low is not None), max(c.high for c in alike if c.high is not None)
        ends = dict.fromkeys((f"{low:.6g}", f"{high:.6g}"))
        text += " to ".join(ends) + (f" {column.unit}" if column.unit else "")
    elif column.kind == "time":
        spans = [c.high for c in alike if c.high]
        span = f", {min(spans):.4g} to {max(spans):.4g} s long" if spans else ""
        text += (column.form if column.texts else "times of the clock") + span
    elif column.kind == "text":
        text += ", ".join(column.texts)
    else:
        text += "empty"
    bits = next((c.wrap_bits for c in alike if c.wrap_bits), None)
    if bits:
        text += f"; a counter that overflows at {bits} bits"
    if column.n_empty and column.kind != "empty":
        text += f"; {column.n_empty} empty"
    return _wrapped(text, "#     ", "  ")
