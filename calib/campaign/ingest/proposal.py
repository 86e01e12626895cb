"""The mapping proposed for files, line by line, from their contents."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

from calib.campaign.ingest.build import BLANK_SETTINGS
from calib.campaign.ingest.contents import ColumnContents, FileContents, StreamContents
from calib.campaign.ingest.guesses import guessed_log_column, stem_and_unit
from calib.campaign.ingest.proposal_table import QUOTED, entry, file_lines, table_lines, unit_remark
from calib.campaign.ingest.wheels import Wheel, settled
from calib.campaign.model import LOG_COLUMNS
from calib.campaign.settings import recognise
from calib.campaign.settings_file import STATED
from calib.units import SUFFIXES, split_suffix

#: letters of a name that alone is no evidence of a wheel: l, r, li, re
_SHORT_NAME: Final = 2
#: characters of a remark that lists files
_LISTED_FILES: Final = 110
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
_ODOMETRY: Final = "nav_msgs/msg/Odometry"
#: sections whose keys only the laboratory knows
_STATED_SECTIONS: Final = ("vehicle", "encoder", "rangefinder")
#: numbers above it count from 1970 -> their unit, each thousand times the one before
_EPOCHS: Final = ((1e17, "ns"), (1e14, "us"), (1e11, "ms"), (1e8, "s"))
#: least step of times in whole numbers -> their unit; loggers sample at 1 Hz to 1 kHz
_STEPS: Final = ((1e6, "ns"), (1e3, "us"), (1.5, "ms"))
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
    "speed_rear_mps": (
        'drive = "ackermann"   # one speed of the rear axle; front wheels that steer',
        (),
        ('kind = "speed"   # in place of counts_per_rev: the logs have speeds',),
    ),
}


def mapping_lines(table: FileContents | None, logs: Sequence[FileContents]) -> list[str]:
    """Return the lines of the mapping; `table`: the run table, where there is one."""
    lines = [f"name = {QUOTED.encode(Path((table or logs[0]).name).stem)}"]
    bits = next((column.wrap_bits for log in logs for column in log.columns if column.wrap_bits), None)
    log_lines = _log_lines(logs) if logs else []
    named = {recognise(column.name, LOG_COLUMNS).name for log in logs for column in log.columns}
    named |= {line.partition(" ")[0] for line in log_lines}
    lines += _settings_lines(bits, named)
    if "ref_x_m" in named:
        lines += ["", "[reference]", "#sigma_xy_m =   # standard uncertainty of a position"]
        lines += ["#sigma_theta_rad =   # standard uncertainty of a heading"]
    if table is not None:
        lines += ["", "[table]" + " " * 20 + "# calib's column = the table's column", *table_lines(table)]
    if logs:
        lines += ["", "[log]" + " " * 22 + "# the same for logs and recordings", *file_lines(table, logs)]
        lines += [*log_lines, *_missing_lines(named, logs), *_kind_lines(logs)]
    recordings = [log for log in logs if log.recording]
    if len(recordings) > 1 and table is None:
        lines += ["", "#[cut]" + " " * 21 + "# each recording is a run; where one holds many: ", '#by = "stops"']
    elif recordings and (table is None or len(logs) == 1):
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
        if section == "vehicle":
            lines.append(drive or '#drive =   # "tricycle" (assumed), "differential", "mecanum", "ackermann", "skid"')
        for key in STATED[section]:
            if key == "track_m" and wheels == "counts_rear_left":
                lines += vehicle
                continue
            if key == "counts_per_rev" and wheels == "speed_rear_mps":
                lines += encoder
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
    if not any(name.startswith(("counts_", "speed_", "v_mps")) for name in named):
        lines += [
            '#counts_left = ""   # no column looks like a wheel: name those of the encoders (unit = "rad/s", ...',
            '#counts_right = ""   # where it holds no counts); for one wheel in front counts_front and steer_rad',
            "#   of speeds in m/s: speed_left_mps, speed_right_mps; speed_rear_mps, steer_rad; or v_mps, omega_radps",
        ]
    return lines


def _kind_lines(logs: Sequence[FileContents]) -> list[str]:
    """Return remarks on logs of other columns than the one mapped: a run's log is one file."""
    kinds = {tuple(column.name for column in log.columns): log for log in logs if not log.recording}
    if len(kinds) < 2:
        return []
    names = ", ".join(Path(log.name).name for log in kinds.values())[:_LISTED_FILES]
    return [
        f"# {len(kinds)} kinds of logs ({names}): one file a run is read.",
        "# Where each holds a part of a run, join them by time first, or record them in one bag, TDMS or .mat file:",
        "# the streams of a recording are joined on the wheels' times.",
    ]


def _log_lines(logs: Sequence[FileContents]) -> list[str]:
    log = max(logs, key=lambda file: (file.recording, len(file.columns)))
    if log.recording:
        return _recording_lines(log)
    alike = [other for other in logs if other.alike(log)]
    columns = [
        replace(column, wrap_bits=next((one.columns[at].wrap_bits for one in alike if one.columns[at].wrap_bits), None))
        for at, column in enumerate(log.columns)
    ]
    found: dict[str, tuple[ColumnContents, str | None]] = {}
    for column in columns:
        guess = guessed_log_column(column.name)
        if guess is None or guess[0] in found or _is_only_a_letter(column, guess[0]):
            continue
        if column.kind == "number" or (guess[0] == "t_s" and column.kind == "time"):
            found[guess[0]] = (column, guess[1])
    lines = []
    clock = next((column for column in columns if column.even and column.name not in _names(found)), None)
    if "t_s" not in found and clock is not None and not any(column.kind == "time" for column in columns):
        lines.append(entry("t_s", clock, _time_unit(clock)) + "   # rises in even steps; s, ms, us, ns")
        columns.remove(clock)
    for name, (column, unit) in found.items():
        if name.startswith("counts_") or recognise(column.name, LOG_COLUMNS).name == name:
            continue
        remark = ""
        needs = split_suffix(name)[1]
        if needs and stem_and_unit(column.name)[1] is None and column.kind != "time":
            unit, remark = needs, unit_remark(name)
            if name == "t_s":
                unit = _time_unit(column)
        lines.append(entry(name, column, unit) + remark)
    wheels, remarks = _settled(found, columns)
    for name, wheel in wheels.items():
        if recognise(wheel.column.name, LOG_COLUMNS).name != name or wheel.unit:
            lines.append(_wheel_line(name, wheel))
    return [*lines, *remarks]


def _names(found: dict[str, tuple[ColumnContents, str | None]]) -> set[str]:
    return {column.name for column, _ in found.values()}


def _settled(
    found: dict[str, tuple[ColumnContents, str | None]], columns: Sequence[ColumnContents]
) -> tuple[dict[str, Wheel], list[str]]:
    guessed = {name: column for name, (column, _) in found.items() if name.startswith("counts_")}
    taken = {column.name for name, (column, _) in found.items() if name not in guessed}
    return settled(guessed, columns, frozenset(taken))


def _wheel_line(name: str, wheel: Wheel, further: dict[str, object] | None = None) -> str:
    line = entry(name, wheel.column, wheel.unit or None, further)
    if wheel.column.kind == "number" and wheel.column.low == wheel.column.high:
        return f"#{line}   # never changes"
    return line + wheel.remark


def _time_unit(column: ColumnContents) -> str:
    """Return the unit of times that name none, by their size where they count from 1970, else by their steps."""
    for least, unit in _EPOCHS:
        if column.high is not None and column.high > least:
            return unit
    return next((unit for least, unit in _STEPS if column.whole and column.step > least), "s")


def _is_only_a_letter(column: ColumnContents, target: str) -> bool:
    """Return whether a counter is guessed from a letter only: `r` may as well be a range."""
    is_short = len(stem_and_unit(column.name)[0]) <= _SHORT_NAME
    return target.startswith("counts_") and is_short and not column.whole


def _recording_lines(recording: FileContents) -> list[str]:
    lines: list[str] = []
    columns = {column.name: column for column in recording.columns}
    clocked = any(stream.start_ns is not None for stream in recording.streams)
    kinds = {stream.kind: stream for stream in reversed(recording.streams)}
    reference = next((kinds[kind] for kind in (*_POSES, _ODOMETRY) if kind in kinds), None)
    found: dict[str, tuple[ColumnContents, str | None]] = {}
    streams: dict[str, StreamContents] = {}
    for stream in recording.streams:
        # a joint's rate is taken where there is no position of it
        for name in sorted(stream.columns, key=lambda name: _RATE in name):
            streams[name] = stream
            column = columns[name]
            guess = guessed_log_column(name)
            if guess is None or guess[0] in found or _is_other(stream, column, guess[0], reference, clocked):
                continue
            if guess[0] == "ref_x_m" and stream.kind == _ODOMETRY:
                lines.append("# wheel odometry is no reference: keep these lines only if it measures from outside")
            found[guess[0]] = (column, guess[1])
            if not guess[0].startswith("counts_"):
                lines.append(_recording_line(column, *guess))
    wheels, remarks = _settled(found, recording.columns)
    for name, wheel in wheels.items():
        lines.append(_wheel_line(name, _joint(wheel, streams[wheel.column.name])))
    # times first
    return sorted([*lines, *remarks], key=lambda line: not line.startswith("t_s"))


def _joint(wheel: Wheel, stream: StreamContents) -> Wheel:
    """Return a wheel with the unit that a joint's position or rate has in ROS."""
    if _RATE in wheel.column.name:
        remark = "   # a rate, in rad/s where the driver keeps ROS's units"
        return replace(wheel, unit="rad/s", remark=wheel.remark if "skid" in wheel.remark else remark)
    if stream.kind.endswith("JointState"):
        unit = "" if wheel.column.whole else "rad"
        return replace(wheel, unit=unit, remark=wheel.remark if "skid" in wheel.remark else "")
    return wheel


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


def _recording_line(column: ColumnContents, target: str, unit: str | None) -> str:
    further: dict[str, object] = {}
    remark = ""
    if target == "range_m":
        further["from_start"] = True
    elif target == "t_s" and stem_and_unit(column.name)[1] is None:
        unit, remark = _time_unit(column), "   # names no unit: s, ms, us, ns"
    if unit is None and column.unit in SUFFIXES and column.unit != split_suffix(target)[1]:
        unit = column.unit
    return entry(target, column, unit, further) + remark
