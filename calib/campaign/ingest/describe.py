"""Describe files and propose a mapping for them, as commented TOML that ingest reads back."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from calib.campaign.columns import recognise
from calib.campaign.ingest.build import BLANK_SETTINGS
from calib.campaign.ingest.contents import (
    DIRECTION_WORDS,
    ColumnContents,
    FileContents,
    StreamContents,
    described,
    file_contents,
    guessed_log_column,
    guessed_table_column,
    plain_text,
    stem_and_unit,
    wrapped,
)
from calib.campaign.ingest.mapping import TABLE_COLUMNS
from calib.campaign.ingest.runs import listed_files, run_number
from calib.campaign.model import LOG_COLUMNS
from calib.campaign.settings_file import STATED
from calib.campaign.write import to_toml
from calib.errors import BadInputError
from calib.result import plain
from calib.units import SUFFIXES, split_suffix

#: files of one kind that are read to the end; of more, the first and the last
_ALL_READ: Final = 40
#: letters of a name that alone is no evidence of a wheel: l, r, li, re
_SHORT_NAME: Final = 2
#: characters of a remark that lists columns, and of one that lists units
_LISTED_COLUMNS: Final = 110
_LISTED_UNITS: Final = 40
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
#: part of the name of a joint's rate
_RATE: Final = ":velocity."
#: texts of TOML
_QUOTED: Final = json.JSONEncoder(ensure_ascii=False)
_ODOMETRY: Final = "nav_msgs/msg/Odometry"
#: sections whose keys only the laboratory knows
_STATED_SECTIONS: Final = ("vehicle", "encoder", "rangefinder")
#: keys of a vehicle without encoders on its rear wheels, by what is counted instead, and what it drives on
_OTHER_WHEELS: Final = {
    "counts_rear_left": (
        'drive = "mecanum"   # four wheels are counted',
        ("#half_length_plus_half_width_m =   # half the wheelbase plus half the track",),
        (),
    ),
    "counts_front": (
        'drive = "tricycle"   # no rear wheel is counted, the front wheel is',
        ("#front_wheel_radius_m =   # nominal",),
        ("#counts_per_rev_front =   # of the front wheel, where it differs",),
    ),
}


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
    table = _run_table(files)
    logs = [file for file in files if file is not table]
    lines = _mapping_lines(table, logs)
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


def _run_table(files: Sequence[FileContents]) -> FileContents | None:
    """Return the file that names runs: a table with a column for their names, and more than a clock beside it."""
    best, best_score = None, 0
    for file in files:
        guesses = {guess[0] for column in file.columns if (guess := guessed_table_column(column.name))}
        timed = any((guess := guessed_log_column(column.name)) and guess[0] == "t_s" for column in file.columns)
        score = len(guesses) + 3 - 4 * timed
        if not file.recording and "run_id" in guesses and score > best_score:
            best, best_score = file, score
    return best


def _mapping_lines(table: FileContents | None, logs: Sequence[FileContents]) -> list[str]:
    lines = [f"name = {_QUOTED.encode(Path((table or logs[0]).name).stem)}"]
    bits = next((column.wrap_bits for log in logs for column in log.columns if column.wrap_bits), None)
    log_lines = _log_lines(logs) if logs else []
    named = {recognise(column.name, LOG_COLUMNS).name for log in logs for column in log.columns}
    named |= {line.partition(" ")[0] for line in log_lines}
    lines += _settings_lines(bits, named)
    if table is not None:
        lines += ["", "[table]" + " " * 20 + "# calib's column = the table's column", *_table_lines(table)]
    if logs:
        lines += ["", "[log]" + " " * 22 + "# the same for logs and recordings", *_file_lines(table, logs)]
        lines += [*log_lines, *_missing_lines(named, logs)]
    if any(log.recording for log in logs) and (table is None or len(logs) == 1):
        lines += ["", "[cut]" + " " * 22 + "# one recording holds many runs", 'by = "stops"', "min_stop_s = 1.0"]
        lines += ['#by = "times"', '#times = [[0.0, 41.5], [60.0, 101.0]]   # or "length", "column"']
    return lines


def _settings_lines(bits: int | None, named: set[str]) -> list[str]:
    """Return the sections of vehicle and instruments, each key a remark, with those of wheels other than two rear ones.

    `bits`: the counters' width where it shows; `named`: calib's columns that the logs have.
    """
    wheels = next((name for name in _OTHER_WHEELS if name in named and "counts_left" not in named), "")
    drive, vehicle, encoder = _OTHER_WHEELS.get(wheels, ("", (), ()))
    lines: list[str] = []
    for section in _STATED_SECTIONS:
        remark = "" if lines else "   # state what you know; keys omitted are marked as assumed"
        lines += ["", f"[{section}]{remark}"]
        if section == "vehicle" and drive:
            lines.append(drive)
        for key in STATED[section]:
            if key == "track_m" and wheels == "counts_rear_left":
                lines += vehicle
                continue
            [meaning] = re.findall(rf"^#{key} .*# (.*)", BLANK_SETTINGS, re.MULTILINE)
            lines.append(f"#{key} =   # {meaning}")
            if key == "wheel_radius_m" and wheels == "counts_front":
                lines += vehicle
            elif key == "counts_per_rev":
                lines += encoder
        if section == "encoder" and bits:
            lines.append(f"wrap_bits = {bits}   # found in the jumps of the counters")
    return lines


def _missing_lines(named: set[str], logs: Sequence[FileContents]) -> list[str]:
    """Return remarks on what every log needs and no column looks like: wheels, and a clock."""
    lines = []
    clocked = any(stream.start_ns is not None for log in logs for stream in log.streams)
    timed = any(column.kind == "time" for log in logs for column in log.columns)
    if not clocked and not timed and "t_s" not in named:
        lines.append('#t_s = ""   # no column looks like times; every log needs them')
    if not any(name.startswith("counts_") for name in named):
        lines += [
            '#counts_left = ""   # no column looks like a wheel: name those of the encoders (unit = "rad/s", ...',
            '#counts_right = ""   # where it holds no counts); for one wheel in front counts_front and steer_rad',
        ]
    return lines


def _entry(name: str, column: ColumnContents, unit: str | None, further: dict[str, object] | None = None) -> str:
    """Return one line of a mapping; a plain text where the column's name says all."""
    parts: dict[str, object] = {"column": column.name}
    if unit is not None and "[" not in column.name and "(" not in column.name:
        parts["unit"] = unit
    parts |= further or {}
    if len(parts) == 1:
        return f"{name} = {_QUOTED.encode(column.name)}"
    return to_toml({name: [parts]}).strip().replace("[{", "{").replace("}]", "}")


def _unit_remark(suffix: str) -> str:
    """Return the remark on a column that names no unit: those that it may be in."""
    units = ", ".join(unit for unit, (target, _, _) in SUFFIXES.items() if target == suffix)
    return f"   # names no unit: {units[:_LISTED_UNITS]}"


def _table_lines(table: FileContents) -> list[str]:
    lines, taken, own, unused = [], set(), [], []
    for column in table.columns:
        guess = guessed_table_column(column.name)
        directions = {text: DIRECTION_WORDS.get(plain_text(text)) for text in column.texts}
        if directions and len(directions) <= 2 and all(directions.values()):
            guess = ("direction", None)
        if guess is None or guess[0] in taken or column.kind == "empty":
            unused.append(column.name)
            continue
        name, unit = guess
        taken.add(name)
        further: dict[str, object] = {}
        remark = ""
        if name == "direction" and set(column.texts) - {"out", "back"}:
            further["values"] = {text: meaning or "out" for text, meaning in directions.items()}
            remark = "" if all(directions.values()) else '   # "out" or "back"'
        if recognise(column.name, TABLE_COLUMNS).name == name and not further:
            own.append(column.name)
            continue
        needs = split_suffix(name)[1]
        if needs and stem_and_unit(column.name)[1] is None:
            unit, remark = needs, _unit_remark(needs)
        lines.append(_entry(name, column, unit, further) + remark)
    if "run_id" not in taken:
        lines.append('#run_id = ""   # the column that names the runs')
    if "kind" not in taken:
        lines.append('kind = {value = "corridor"}   # the route, where the table does not say')
    if own:
        lines.append(f"# recognised by their names: {', '.join(own)[:_LISTED_COLUMNS]}")
    if unused:
        lines.append(f"# not used, numbers kept as covariates: {', '.join(unused)[:_LISTED_COLUMNS]}")
    return lines


def _file_lines(table: FileContents | None, logs: Sequence[FileContents]) -> list[str]:
    """Return the pattern of the logs' names, where the runs' names do not say them."""
    if table is None or len(logs) < 2:
        return []
    column = next((part for part in table.columns if (guessed_table_column(part.name) or ("",))[0] == "run_id"), None)
    stems = [Path(log.name).stem for log in logs]
    run_ids = column.texts if column is not None and column.kind == "text" else ()
    if run_ids and run_ids[0] in stems:
        return []
    digits = [match for stem in stems if (match := re.search(r"\d+(?!.*\d)", stem))]
    if len(digits) < len(stems):
        return ['#file = "{run_id}.csv"   # the log of a run']
    widths = {len(match[0]) for match in digits}
    form = "{n}" if len(widths) > 1 else f"{{n:{widths.pop():02}}}"
    name = stems[0][: digits[0].start()] + form + stems[0][digits[0].end() :] + Path(logs[0].name).suffix
    lines = [f"file = {_QUOTED.encode(name)}"]
    if run_ids and run_number(run_ids[0], None) is not None:
        pattern = re.sub(r"\d+(?!.*\d)", "{n}", run_ids[0])
        lines.append(f"run = {_QUOTED.encode(pattern)}   # the number in a run's name")
    return lines


def _log_lines(logs: Sequence[FileContents]) -> list[str]:
    log = max(logs, key=lambda file: (file.recording, len(file.columns)))
    if log.recording:
        return _recording_lines(log)
    lines, taken = [], set()
    for column in log.columns:
        guess = guessed_log_column(column.name)
        if guess is None or guess[0] in taken or _is_only_a_letter(column, guess[0]):
            continue
        name, unit = guess
        taken.add(name)
        if recognise(column.name, LOG_COLUMNS).name == name:
            continue
        remark = ""
        needs = split_suffix(name)[1]
        if needs and stem_and_unit(column.name)[1] is None and column.kind != "time" and not name.startswith("counts_"):
            unit, remark = needs, _unit_remark(needs)
        lines.append(_entry(name, column, unit) + remark)
    return lines


def _is_only_a_letter(column: ColumnContents, target: str) -> bool:
    """Return whether a counter is guessed from a letter only: `r` may as well be a range."""
    is_short = len(stem_and_unit(column.name)[0]) <= _SHORT_NAME
    return target.startswith("counts_") and is_short and not column.whole


def _recording_lines(recording: FileContents) -> list[str]:
    lines, taken = [], set()
    columns = {column.name: column for column in recording.columns}
    clocked = any(stream.start_ns is not None for stream in recording.streams)
    kinds = {stream.kind: stream for stream in reversed(recording.streams)}
    reference = next((kinds[kind] for kind in (*_POSES, _ODOMETRY) if kind in kinds), None)
    for stream in recording.streams:
        # a joint's rate is taken where there is no position of it
        for name in sorted(stream.columns, key=lambda name: _RATE in name):
            column = columns[name]
            guess = guessed_log_column(name)
            if guess is None or guess[0] in taken or _is_other(stream, column, guess[0], reference, clocked):
                continue
            if guess[0] == "ref_x_m" and stream.kind == _ODOMETRY:
                lines.append("# wheel odometry is no reference: keep these lines only if it measures from outside")
            taken.add(guess[0])
            lines.append(_recording_line(stream, column, *guess))
    # times first
    return sorted(lines, key=lambda line: not line.startswith("t_s"))


def _is_other(
    stream: StreamContents, column: ColumnContents, target: str, reference: StreamContents | None, clocked: bool
) -> bool:
    """Return whether a stream's column is not what its name makes it look like."""
    name = column.name
    if ":effort." in name or ".velocity" in name or (_RATE in name and not target.startswith("counts_")):
        return True
    if not stream.kind.endswith("JointState") and _is_only_a_letter(column, target):
        return True
    if target.startswith("ref_") and stream is not reference and stream.kind not in _UNTYPED:
        return True
    return target == "t_s" and clocked


def _recording_line(stream: StreamContents, column: ColumnContents, target: str, unit: str | None) -> str:
    further: dict[str, object] = {}
    remark = ""
    if target.startswith("counts_"):
        if _RATE in column.name:
            further["unit"], remark = "rad/s", "   # a rate, in rad/s where the driver keeps ROS's units"
        elif stream.kind.endswith("JointState") and not column.whole:
            further["unit"] = "rad"
        if column.low == column.high:
            return f"#{_entry(target, column, None, further)}   # never changes"
        return _entry(target, column, None, further) + remark
    if target == "range_m":
        further["from_start"] = True
    elif target == "t_s" and stem_and_unit(column.name)[1] is None:
        unit, remark = "s", "   # names no unit: s, ms, us, ns"
    if unit is None and column.unit in SUFFIXES and column.unit != split_suffix(target)[1]:
        unit = column.unit
    return _entry(target, column, unit, further) + remark
