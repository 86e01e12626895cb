"""Propose a mapping from what was found: guesses by name and unit, and remarks where only the laboratory knows."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from calib.campaign.columns import recognise
from calib.campaign.ingest.found import ColumnFound, FileFound, StreamFound
from calib.campaign.ingest.log_files import run_number
from calib.campaign.ingest.mapping import TABLE_COLUMNS
from calib.campaign.ingest.unstated import missing_lines, settings_lines, with_other_wheels
from calib.campaign.ingest.words import DIRECTION_WORDS, guessed_log_column, guessed_table_column, plain, stem_and_unit
from calib.campaign.model import LOG_COLUMNS
from calib.campaign.toml_text import to_toml
from calib.units import SUFFIXES, split_suffix

#: message types whose poses measure from outside, best first; wheel odometry is no reference
_POSES: Final = (
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
    "poses",
    "tf2_msgs/msg/TFMessage",
    "tf/msg/tfMessage",
)
#: streams whose kind does not say what they measure: only names do
_UNTYPED: Final = ("channels", "variables")
_ODOMETRY: Final = "nav_msgs/msg/Odometry"


@dataclass(frozen=True, slots=True)
class Proposal:
    """A mapping proposed: its lines, and the sources as the command line takes them."""

    lines: tuple[str, ...]
    sources: str


def propose(table: FileFound | None, logs: Sequence[FileFound], sources: Sequence[str]) -> Proposal:
    """Propose a mapping.

    `logs`: logs and recordings; `sources`: paths as given; the table's comes first in the command.
    """
    lines = [f"name = {_text(_name(table, logs))}"]
    bits = next((column.wrap_bits for log in logs for column in log.columns if column.wrap_bits), None)
    lines += settings_lines(bits)
    if table is not None:
        lines += ["", "[table]" + " " * 20 + "# calib's column = the table's column"]
        lines += _table_lines(table)
    if logs:
        lines += ["", "[log]" + " " * 22 + "# the same for logs and recordings"]
        lines += _file_lines(table, logs)
        proposed = _log_lines(logs)
        lines += proposed
        lines += missing_lines(proposed, logs)
        lines = with_other_wheels(lines, proposed, logs)
    recordings = [log for log in logs if log.recording]
    if recordings and (table is None or len(logs) == 1):
        lines += ["", "[cut]" + " " * 22 + "# one recording holds many runs", 'by = "stops"', "min_stop_s = 1.0"]
        lines += ['#by = "times"', '#times = [[0.0, 41.5], [60.0, 101.0]]   # or "length", "column"']
    ordered = [source for source in sources if table is not None and source == table.name]
    ordered += [source for source in sources if source not in ordered]
    if table is not None and table.name not in ordered:
        # the table was found in a folder: it has to be named first
        ordered.insert(0, table.name)
    return Proposal(tuple(lines), " ".join(f"'{source}'" if re.search(r"\s", source) else source for source in ordered))


def _name(table: FileFound | None, logs: Sequence[FileFound]) -> str:
    return Path((table or logs[0]).name).stem


def _text(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)


def _entry(name: str, column: ColumnFound, unit: str | None, further: dict[str, object] | None = None) -> str:
    """Return one line of a mapping; a plain text where the column's name says all."""
    parts: dict[str, object] = {"column": column.name}
    in_brackets = "[" in column.name or "(" in column.name
    if unit is not None and not in_brackets:
        parts["unit"] = unit
    parts |= further or {}
    if len(parts) == 1:
        return f"{name} = {_text(column.name)}"
    return to_toml({name: [parts]}).strip().replace("[{", "{").replace("}]", "}")


def _table_lines(table: FileFound) -> list[str]:
    lines, taken, own, left = [], set(), [], []
    for column in table.columns:
        guess = guessed_table_column(column.name)
        if column.texts and all(plain(text) in DIRECTION_WORDS for text in column.texts) and len(column.texts) <= 2:
            guess = ("direction", None)
        if guess is None or guess[0] in taken or column.kind == "empty":
            left.append(column.name)
            continue
        name, unit = guess
        taken.add(name)
        further: dict[str, object] = {}
        remark = ""
        if name == "direction" and set(column.texts) - {"out", "back"}:
            further["values"] = {text: DIRECTION_WORDS.get(plain(text), "out") for text in column.texts}
            if any(plain(text) not in DIRECTION_WORDS for text in column.texts):
                remark = '   # "out" or "back"'
        if recognise(column.name, TABLE_COLUMNS).name == name and not further:
            own.append(column.name)
            continue
        needs = split_suffix(name)[1]
        if needs and stem_and_unit(column.name)[1] is None:
            unit, remark = needs, f"   # names no unit: {_units_of(needs)}"
        lines.append(_entry(name, column, unit, further) + remark)
    if "run_id" not in taken:
        lines.append('#run_id = ""   # the column that names the runs')
    if "kind" not in taken:
        lines.append('kind = {value = "corridor"}   # the route, where the table does not say')
    if own:
        lines.append(f"# recognised by their names: {', '.join(own)[:110]}")
    if left:
        lines.append(f"# not used, numbers kept as covariates: {', '.join(left)[:110]}")
    return lines


def _units_of(suffix: str) -> str:
    return ", ".join(unit for unit, (target, _, _) in SUFFIXES.items() if target == suffix)[:40]


def _file_lines(table: FileFound | None, logs: Sequence[FileFound]) -> list[str]:
    """Return the pattern of the logs' names, where the runs' names do not say them."""
    if table is None or len(logs) < 2:
        return []
    column = next((part for part in table.columns if (guessed_table_column(part.name) or ("",))[0] == "run_id"), None)
    stems = [Path(log.name).stem for log in logs]
    ids = column.texts if column is not None and column.kind == "text" else ()
    if ids and ids[0] in stems:
        return []
    digits = [re.search(r"\d+(?!.*\d)", stem) for stem in stems]
    if not all(digits):
        return ['#file = "{run_id}.csv"   # the log of a run']
    first = digits[0]
    if first is None:
        return []
    widths = {len(match[0]) for match in digits if match}
    form = "{n}" if len(widths) > 1 else f"{{n:{widths.pop():02}}}"
    path = Path(logs[0].name)
    name = path.stem[: first.start()] + form + path.stem[first.end() :] + path.suffix
    lines = [f"file = {_text(name)}"]
    if ids and run_number(ids[0], None) is not None:
        pattern = re.sub(r"\d+(?!.*\d)", "{n}", ids[0])
        lines.append(f"run = {_text(pattern)}   # where the number stands in a run's name")
    return lines


def _log_lines(logs: Sequence[FileFound]) -> list[str]:
    log = max(logs, key=lambda file: (file.recording, len(file.columns)))
    if log.recording:
        return _recording_lines(log)
    lines, taken = [], set()
    for column in log.columns:
        guess = guessed_log_column(column.name)
        if guess is None or guess[0] in taken or _only_a_letter(column, guess[0]):
            continue
        name, unit = guess
        taken.add(name)
        if recognise(column.name, LOG_COLUMNS).name == name:
            continue
        remark = ""
        needs = split_suffix(name)[1]
        if needs and stem_and_unit(column.name)[1] is None and column.kind != "time" and not name.startswith("counts_"):
            unit, remark = needs, f"   # names no unit: {_units_of(needs)}"
        lines.append(_entry(name, column, unit) + remark)
    return lines


def _only_a_letter(column: ColumnFound, target: str) -> bool:
    """Return whether nothing but a letter speaks for a counter: `r` may as well be a range."""
    return target.startswith("counts_") and len(stem_and_unit(column.name)[0]) <= len("re") and not column.whole


def _is_rate(name: str) -> bool:
    return ":velocity." in name


def _passed_over(
    stream: StreamFound, column: ColumnFound, target: str, reference: StreamFound | None, clocked: bool
) -> bool:
    """Return whether a stream's column is not what its name makes it look like."""
    name = column.name
    if ":effort." in name or ".velocity" in name or (_is_rate(name) and not target.startswith("counts_")):
        return True
    if not stream.kind.endswith("JointState") and _only_a_letter(column, target):
        return True
    if target.startswith("ref_") and stream is not reference and stream.kind not in _UNTYPED:
        return True
    return target == "t_s" and clocked


def _recording_lines(recording: FileFound) -> list[str]:
    lines, taken = [], set()
    by_name = {column.name: column for column in recording.columns}
    kinds = {stream.name: stream for stream in recording.streams}
    clocked = any(stream.start_ns is not None for stream in recording.streams)
    reference = next(
        (stream for kind in _POSES for stream in recording.streams if stream.kind == kind),
        next((stream for stream in recording.streams if stream.kind == _ODOMETRY), None),
    )
    for stream in kinds.values():
        # a joint's rate stands in where there is no position of it
        for name in sorted(stream.columns, key=_is_rate):
            column = by_name[name]
            guess = guessed_log_column(name)
            if guess is None or guess[0] in taken or _passed_over(stream, column, guess[0], reference, clocked):
                continue
            target, unit = guess
            further: dict[str, object] = {}
            remark = ""
            if target.startswith("counts_"):
                angle = stream.kind.endswith("JointState") and not column.whole
                if _is_rate(name):
                    further["unit"], remark = "rad/s", "   # a rate, in rad/s where the driver keeps ROS's units"
                elif angle:
                    further["unit"] = "rad"
                if column.low == column.high:
                    remark = "   # never changes"
                unit = None
            elif target == "range_m":
                further["from_start"] = True
            elif target == "t_s" and stem_and_unit(name)[1] is None:
                unit, remark = "s", "   # names no unit: s, ms, us, ns"
            if column.unit in SUFFIXES and unit is None and not target.startswith("counts_"):
                unit = None if column.unit == split_suffix(target)[1] else column.unit
            if target == "ref_x_m" and stream.kind == _ODOMETRY:
                lines.append("# wheel odometry is no reference: keep these lines only if it measures from outside")
            taken.add(target)
            entry = _entry(target, column, unit, further) + remark
            lines.append(f"#{entry}" if "never changes" in remark else entry)
    # a four-wheel vehicle's names may have been taken for others; times first
    return sorted(lines, key=lambda line: 0 if line.startswith("t_s") else 1)
