"""Lines proposed for logs and recordings: clock, wheels (both sides or neither), reference, rangefinder."""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Final

from calib.campaign.ingest import ColumnContents, FileContents, guesses
from calib.campaign.ingest.guesses import BEHAVIOURS, count_unit, guessed_log_column, side_of, stem_and_unit
from calib.campaign.ingest.mapping import MappedColumn
from calib.campaign.ingest.proposal_table import entry, files_of_a_run, unit_remark
from calib.campaign.model import LOG_COLUMNS
from calib.campaign.readers.recording import StreamContents
from calib.campaign.readers.sheets import COUNT_UNITS, UNNAMED
from calib.campaign.settings import recognise
from calib.campaign.settings_file import toml_value
from calib.types import split_suffix, unit_named

#: no evidence of a wheel alone: l, r, li, re
_SHORT_NAME: Final = 2
#: message types with poses from outside, best first; wheel odometry is no reference
_POSES: Final = (
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
    "poses",
    "tf2_msgs/msg/TFMessage",
    "tf/msg/tfMessage",
)
_ODOMETRY: Final = "nav_msgs/msg/Odometry"
_UNTYPED: Final = ("channels", "variables")
_VELOCITY: Final = ":velocity."
#: numbers above it count from 1970 -> unit
_EPOCHS: Final = ((1e17, "ns"), (1e14, "us"), (1e11, "ms"), (1e8, "s"))
#: days since 1900, as spreadsheets keep times: of 1954 to 2064; and a step of 4 s
_DAY_NUMBERS: Final = (2e4, 6e4)
_DAY_STEP: Final = 5e-5
#: least step of whole-number times -> unit; loggers sample at 1 Hz to 1 kHz
_UNIT_STEPS: Final = ((1e6, "ns"), (1e3, "us"), (1.5, "ms"))
_PAIR: Final = ("counts_left", "counts_right")
_CORNERS: Final = {
    "counts_left": ("counts_front_left", "counts_rear_left"),
    "counts_right": ("counts_front_right", "counts_rear_right"),
}
#: of its span, by which coupled wheels of a side differ: they slip, but do not steer
_COUPLED_SHARE: Final = 0.02
_VERTICAL_SHARE: Final = 0.1
_SPEEDS: Final = ("speed_left_mps", "speed_right_mps")
_TWIST: Final = ("v_mps", "omega_radps")
_OF_QUATERNION: Final = re.compile(r"(orientation|quat(ernion)?|q)[._]?z$", re.IGNORECASE)
#: stem of a pose without a tracker's name
_NO_TRACKER: Final = re.compile(r"((robot|base)_)?(pose?|pos(ition)?)?_?(x|y|theta|yaw|heading)")
_BEARING: Final = "   # beside x and y: the reference's heading, counter-clockwise?"
_COMPASS: Final = "   # clockwise, of a compass? x = north; factor = -1 here and for y = east"
SKID_STEER: Final = "   # both wheels of this side turn alike: skid steer; of a mecanum drive name all four"


def log_lines(logs: Sequence[FileContents]) -> list[str]:
    """Return lines for the recording or widest log, and what is missing."""
    if several := {tag: part for tag, (_, part) in files_of_a_run(logs).items()}:
        return _lines_of_several(several, logs)
    log = max(logs, key=lambda file: (file.recording, len(file.columns)))
    lines, chosen = _column_lines(log, _with_bits(log, [other for other in logs if other.alike(log)]))
    lines += _missing(lines, chosen, logs)
    kinds = {tuple(column.name for column in log.columns) for log in logs if not log.recording}
    if len(kinds) > 1:
        lines.append(f"# {len(kinds)} kinds of logs: those of a run are joined by files = {{...}}")
    return lines


def _lines_of_several(parts: Mapping[str, FileContents], logs: Sequence[FileContents]) -> list[str]:
    columns: list[ColumnContents] = []
    streams: list[StreamContents] = []
    times: dict[str, ColumnContents] = {}
    labels: dict[str, str] = {}
    for tag, part in parts.items():
        alike = [log for log in logs if re.sub(r"\d+", "#", log.name) == re.sub(r"\d+", "#", part.name)]
        of_part = _with_bits(part, alike)
        clocks = [c for c in of_part if guessed_log_column(c.name) == "t_s"]
        clocks.sort(key=lambda c: not c.name.endswith("stamp"))
        time = next(iter([*clocks, *(c for c in of_part if c.even or c.kind == "time")]), None)
        times |= {tag: time} if time is not None else {}
        own = [c for c in of_part if c is not time and c not in clocks and c.kind == "number"]
        own = [replace(c, name=f"{tag}:{c.name}") for c in own]
        labels |= {f"{tag}:{name}": label for name, label in _joints(of_part)}
        streams.append(StreamContents(tag, _UNTYPED[0], part.n_rows, "", tuple(c.name for c in own)))
        columns += own
    log = FileContents(", ".join(parts), True, 0, tuple(columns), (), tuple(streams))
    lines, chosen = _column_lines(log, columns, labels)
    own_times = {tag: _line("t_s", time).partition("   #")[0].removeprefix("t_s = ") for tag, time in times.items()}
    if times:
        chosen["t_s"] = next(iter(times.values()))
        one_clock = len({*own_times.values()}) == 1
        each = ", ".join(f"{tag} = {line}" for tag, line in own_times.items())
        several = f"clocks = {{{each}}}   # the times of each file" + "; state ? Hz" * ("?" in each)
        lines.insert(0, _line("t_s", chosen["t_s"]) if one_clock else several)
    return [*lines, *_missing(lines, chosen, logs)]


def _joints(columns: Sequence[ColumnContents]) -> Iterator[tuple[str, str]]:
    # of "rostopic echo -p": name0 says what position0 is of
    for column in columns:
        match = re.fullmatch(r"(.*)name(\d+)", column.name)
        if match and len(column.texts) == 1:
            yield f"{match[1]}position{match[2]}", f"{column.texts[0]} position"


def _with_bits(log: FileContents, alike: Sequence[FileContents]) -> list[ColumnContents]:
    widths = [[one.columns[at].wrap_bits for one in alike] for at in range(len(log.columns))]
    turns = [any(BEHAVIOURS.get(one.columns[at].does) == "deg" for one in alike) for at in range(len(log.columns))]
    return [
        replace(c, wrap_bits=next(filter(None, w), None), unit=c.unit or "deg" * turned)
        for c, w, turned in zip(log.columns, widths, turns, strict=True)
    ]


def _column_lines(
    log: FileContents, columns: list[ColumnContents], labels: Mapping[str, str] = MappingProxyType({})
) -> tuple[list[str], dict[str, ColumnContents]]:
    streams = {name: stream for stream in log.streams for name in stream.columns}
    kinds = {stream.kind: stream for stream in reversed(log.streams)}
    reference = next((kinds[kind] for kind in (*_POSES, _ODOMETRY) if kind in kinds), None)
    columns, lines = _of_one_body(columns)
    chosen: dict[str, ColumnContents] = {}
    for column in sorted(columns, key=_preference):
        target = guessed_log_column(labels.get(column.name, column.name))
        if target and target not in chosen and _plausible(target, column, streams.get(column.name), reference):
            chosen[target] = column
    _to_ground(chosen, columns)
    bearing = _one_source(chosen, streams)
    names, others = ({column.name for column in of} for of in (chosen.values(), columns))
    free = sorted((column for column in columns if column.name not in names), key=lambda column: column.kind != "time")
    clock = next((column for column in free if column.even or column.kind == "time"), None)
    if "t_s" not in chosen and clock is not None and not log.recording:
        unit, remark = _time_unit(clock) if clock.even else (None, "")
        lines.append(entry("t_s", clock, unit) + remark.replace("names no unit", "rises in even steps"))
        columns.remove(clock)
    x = chosen.get("ref_x_m")
    eastward = x is not None and re.match("(.*_)?(ost|este?|east)", stem_and_unit(x.name)[0]) is not None
    for target, column in chosen.items():
        # beside the wheels a pose of no named tracker may be the vehicle's own
        own = not log.recording and _NO_TRACKER.fullmatch(stem_and_unit(column.name)[0]) is not None
        own = own or "odom" in column.name.lower() or "pose.pose" in column.name
        if target == "ref_x_m" and (own or (reference and reference.kind == _ODOMETRY)):
            lines.append("# wheel odometry is no reference: keep these lines only if it measures from outside")
        if not target.startswith("counts_") and (log.recording or recognise(column.name, LOG_COLUMNS).name != target):
            compass = _COMPASS if eastward and target == "ref_theta_rad" else ""
            lines.append(_line(target, column) + (compass or (_BEARING if column is bearing else "")))
        if target == "ref_theta_rad" and (
            _OF_QUATERNION.search(column.name) or _quaternion_w(column) in others - {column.name}
        ):
            lines[-1] = _quaternion_line(column, columns)
    lines += _wheel_lines(chosen, columns, streams)
    return sorted(lines, key=lambda line: not line.startswith("t_s")), chosen


def _of_one_body(columns: list[ColumnContents]) -> tuple[list[ColumnContents], list[str]]:
    # of several tracked bodies the one that moves
    spans: dict[str, float] = {}
    for column in columns:
        body, _, what = column.name.rpartition(":")
        if what.startswith("Position "):
            spans[body] = max(spans.get(body, 0.0), column.span)
    still = [f"{body}:" for body in spans if spans[body] < max(spans.values())]
    lines = [f"# bodies: {', '.join(spans)}; the one that moves most is taken"] if still else []
    return [column for column in columns if not column.name.startswith(tuple(still))], lines


def _preference(column: ColumnContents) -> tuple[bool, bool, bool]:
    no_tracker = _NO_TRACKER.fullmatch(stem_and_unit(column.name)[0]) is not None or "odom" in column.name.lower()
    return _VELOCITY in column.name, no_tracker, not guesses.by_rangefinder(column.name)


def _one_source(chosen: dict[str, ColumnContents], streams: Mapping[str, StreamContents]) -> ColumnContents | None:
    # speeds beside counts, or one of two, are dropped; returned is a bearing as heading
    known = any(name.startswith("counts_") for name in chosen)
    if not known and _TWIST[0] in chosen and _TWIST[1] not in chosen and "gyro_z_radps" in chosen:
        chosen[_TWIST[1]] = chosen.pop("gyro_z_radps")
    for pair in (_SPEEDS, _TWIST):
        for name in pair if known or not {*pair} <= set(chosen) else ():
            chosen.pop(name, None)
        known = known or pair[0] in chosen
    bearing = chosen.pop("bearing_rad", None)
    steers = "counts_front" in chosen and "steer_rad" not in chosen
    if bearing is None or not {"ref_x_m", "ref_y_m"} <= set(chosen) or "ref_theta_rad" in chosen or steers:
        return None
    typed = bearing.name in streams and streams[bearing.name].kind not in _UNTYPED
    return None if typed else chosen.setdefault("ref_theta_rad", bearing)


def _quaternion_w(of_axis: ColumnContents) -> str:
    axis = of_axis.name[-1]
    return of_axis.name[:-1] + ("W" if axis in "XYZ" else "w" if axis in "xyz" else axis)


def _to_ground(chosen: dict[str, ColumnContents], columns: Sequence[ColumnContents]) -> None:
    named = {column.name: column for column in columns}
    x = chosen["ref_x_m"].name if "ref_x_m" in chosen else ""
    at_x = len(x.partition(" [")[0]) - 1  # a unit may follow
    names = [x[:at_x] + chr(ord(x[at_x]) + axis) + x[at_x + 1 :] for axis in range(3)] if x and x[at_x] in "xX" else []
    axes = [named[name] for name in names if name in named]
    if len(axes) < 3 or chosen.get("ref_y_m") is not axes[1]:
        return
    spans = [axis.span for axis in axes]
    up = spans.index(min(spans))
    up = up if spans[up] < _VERTICAL_SHARE * sorted(spans)[1] else 2
    chosen["ref_x_m"], chosen["ref_y_m"] = axes[(up + 1) % 3], axes[(up + 2) % 3]
    turns = [column for column in columns if column.name[-1].lower() == "xyz"[up] and _quaternion_w(column) in named]
    if turns and (up != 2 or "ref_theta_rad" not in chosen):
        chosen["ref_theta_rad"] = turns[0]


def _quaternion_line(z: ColumnContents, columns: Sequence[ColumnContents]) -> str:
    if (w := _quaternion_w(z)) in {column.name for column in columns}:
        return entry("ref_theta_rad", z, None, {"w": w}) + "   # of a turn about the vertical alone"
    return f"#ref_theta_rad = {{column = {toml_value(z.name)}, w = }}}}   # z of a quaternion: its w is needed too"


def _plausible(
    target: str, column: ColumnContents, stream: StreamContents | None, reference: StreamContents | None
) -> bool:
    joint = stream is not None and stream.kind.endswith("JointState")
    is_wheel = target.startswith("counts_")
    if is_wheel and not joint and len(stem_and_unit(column.name)[0]) <= _SHORT_NAME and not column.whole:
        return False
    if stream is None:
        return column.kind == "number" or (target == "t_s" and column.kind == "time")
    name = column.name
    if ":effort." in name or ".velocity" in name or (_VELOCITY in name and not is_wheel):
        return False
    if target.startswith("ref_") and stream is not reference and stream.kind not in _UNTYPED:
        return False
    return target != "t_s" or stream.start_ns is None


def _line(target: str, column: ColumnContents) -> str:
    needs, own, remark = split_suffix(target)[1], unit_named(column.unit), ""
    unit = stem_and_unit(column.name)[1] or (own if own != needs else None)
    if needs and unit is None and own != needs and column.kind != "time":
        unit, remark = _time_unit(column) if target == "t_s" else (needs, unit_remark(target))
    return entry(target, column, unit, {"from_start": True} if target == "range_m" else None) + remark


def _time_unit(column: ColumnContents) -> tuple[str | None, str]:
    low, high = column.low or 0.0, column.high or 0.0
    if MappedColumn(column=column.name).unit_for("t_s"):
        return None, ""
    if column.whole and column.even and column.step == 1.0:
        return "? Hz", '   # counts frames: state how many a second, as "50 Hz"'
    unit = next((unit for least, unit in _EPOCHS if high > least), "s")
    if _DAY_NUMBERS[0] < low <= high < _DAY_NUMBERS[1] and column.step < _DAY_STEP:
        unit = "day"
    elif unit == "s" and column.whole:
        # milliseconds may exceed the seconds since 1970
        unit = next((one for least, one in _UNIT_STEPS if column.step > least), unit)
    return unit, unit_remark("t_s")


def _wheel_lines(
    chosen: dict[str, ColumnContents], columns: Sequence[ColumnContents], streams: dict[str, StreamContents]
) -> list[str]:
    taken = {column.name for name, column in chosen.items() if not name.startswith("counts_")}
    corners = [name for pair in _CORNERS.values() for name in pair if name in chosen]
    own = any(recognise(chosen[name].name, LOG_COLUMNS).name == name for name in corners)
    remark, lines = "", []
    if corners and not own and not set(_PAIR) & set(chosen):
        remark = _as_one_axle(chosen, corners)
    elif len(set(_PAIR) & set(chosen)) < 2 and not {"counts_front", *corners, *_SPEEDS} & set(chosen):
        remark = _by_behaviour(chosen, [column for column in columns if column.name not in taken])
    for name, other in (_PAIR, _PAIR[::-1]):
        if name not in chosen or other in chosen or "counts_front" in chosen:
            continue
        lines.append(f'#{name} = "{chosen.pop(name).name}"   # looks like a wheel, but no column looks like {other}')
    wheels = [name for name in LOG_COLUMNS if name.startswith("counts_") and name in chosen]
    units = {name: _wheel_unit(chosen[name], streams.get(chosen[name].name)) for name in wheels}
    # angles may vary as rates do: all wheels are alike
    angle = next((each for each in units.values() if each[0] == "rad" and each[1]), None)
    for wheel in wheels:
        column, stream = chosen[wheel], streams.get(chosen[wheel].name)
        unit, why = angle if angle and units[wheel][0] == "rad/s" and _VELOCITY not in column.name else units[wheel]
        line = entry(wheel, column, unit or None)
        if column.kind == "number" and column.low == column.high:
            lines.append(f"#{line}   # never changes")
        elif stream is not None or unit or recognise(column.name, LOG_COLUMNS).name != wheel:
            lines.append(line + (why if stream is not None and remark != SKID_STEER and why else remark or why))
    return lines


def _as_one_axle(chosen: dict[str, ColumnContents], corners: Sequence[str]) -> str:
    for axle in (0, 1):
        names = [pair[axle] for pair in _CORNERS.values()]
        if sorted(corners) == sorted(names):
            for side, name in zip(_PAIR, names, strict=True):
                chosen[side] = chosen.pop(name)
            return ""
    if len(corners) == 4 and all(_coupled(*(chosen[name] for name in pair)) for pair in _CORNERS.values()):
        for side, (front, rear) in _CORNERS.items():
            chosen[side] = chosen.pop(front)
            del chosen[rear]
        return SKID_STEER
    return ""


def _coupled(front: ColumnContents, rear: ColumnContents) -> bool:
    span = max(front.span, rear.span)
    return max(abs((front.low or 0.0) - (rear.low or 0.0)), abs(front.span - rear.span)) <= _COUPLED_SHARE * span


def _by_behaviour(chosen: dict[str, ColumnContents], columns: Sequence[ColumnContents]) -> str:
    rising = [column for column in columns if column.does == guesses.RISES]
    kinds = {
        "overflows": [column for column in columns if column.whole and column.wrap_bits],
        "rises in whole numbers": [column for column in rising if column.whole and not column.even],
        "rises": [c for c in rising if c.whole or c.span > 2.0 * math.pi]
        if all(UNNAMED.fullmatch(column.name) for column in columns)
        else [],
    }
    what, counters = next(((what, of) for what, of in kinds.items() if of), ("", []))
    if len(counters) != 2:
        return ""
    sides = [side_of(column.name) for column in counters]
    exchanged = sides in (["right", "left"], ["right", None], [None, "left"])
    chosen |= dict(zip(_PAIR, counters[::-1] if exchanged else counters, strict=True))
    unclear = None in sides or sides[0] == sides[1]
    return f"   # {what}, as a counter does; which side it is on is not said: check" if unclear else ""


def _wheel_unit(column: ColumnContents, stream: StreamContents | None) -> tuple[str, str]:
    if _VELOCITY in column.name:
        return "rad/s", "   # a rate, in rad/s where the driver keeps ROS's units"
    if stream is not None and stream.kind.endswith("JointState"):
        return "" if column.whole else "rad", ""
    unit = BEHAVIOURS.get(column.does, "")
    if COUNT_UNITS.get(column.unit, ("",))[0] == "length":
        return "", "   # what the wheel rolled: wheel_radius_m is to be the radius it was computed by"
    named, counted = MappedColumn(column=column.name).unit_for("counts_left"), count_unit(column.name)
    if named not in {None, "counts"} or (column.unit == "counts" and unit != "counts/sample"):
        return "", ""
    if counted not in {None, "counts"}:
        return str(counted), ""
    if unit:
        return unit, f"   # {column.does}"
    if column.kind != "number" or column.whole or column.wrap_bits:
        return "", ""
    if column.does or "position" in column.name:
        return "rad", "   # no whole numbers: an angle; rad, deg or turns"
    return "rad/s", "   # neither whole nor rising: a rate; or rad, an angle"


def _missing(lines: Sequence[str], chosen: dict[str, ColumnContents], logs: Sequence[FileContents]) -> list[str]:
    named = {line.partition(" ")[0] for line in lines} | set(chosen)
    named |= {recognise(column.name, LOG_COLUMNS).name for log in logs for column in log.columns}
    clocked = any(stream.start_ns is not None for log in logs for stream in log.streams)
    timed = clocked or "t_s" in named or any(column.kind == "time" for log in logs for column in log.columns)
    out = [] if timed else ['#t_s = ""   # no column looks like times; every log needs them']
    if not any(name.startswith(("counts_", "speed_", "v_mps")) for name in named):
        out += [
            '#counts_left = ""   # no column looks like a wheel: name the encoders, with unit = "rad/s", ...',
            '#counts_right = ""   # where they count nothing; of one wheel in front counts_front, steer_rad;',
            "#   of speeds speed_left_mps, speed_right_mps; speed_rear_mps, steer_rad; or v_mps, omega_radps",
        ]
    return out
