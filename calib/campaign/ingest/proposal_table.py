"""Lines proposed for a run table: its columns, other sheets', and names of logs."""

import re
from collections.abc import Sequence
from os.path import commonprefix
from pathlib import Path
from typing import Final

from calib.campaign.ingest import ColumnContents, FileContents, guesses, moment_of, names_moment, run_in, run_number
from calib.campaign.ingest.guesses import direction_of, guessed_table_column, plain_text, stem_and_unit
from calib.campaign.ingest.mapping import SHEET, TABLE_COLUMNS, units_for
from calib.campaign.model import LABEL_COLUMNS
from calib.campaign.readers.sheets import SECTION
from calib.campaign.readers.table import is_number
from calib.campaign.settings import WHEEL_LOADS, bracketed, recognise
from calib.campaign.settings_file import toml_value
from calib.types import SUFFIXES, grouped, split_suffix


def entry(name: str, column: ColumnContents, unit: str | None, further: dict[str, object] | None = None) -> str:
    """Return a line of a mapping; plain text where the column's name says all."""
    parts: dict[str, object] = {"column": column.name}
    if unit is not None and not (re.search(r"[\[(]", column.name) and stem_and_unit(column.name)[1] == unit):
        parts["unit"] = unit
    parts |= further or {}
    return f"{name} = {toml_value(column.name if len(parts) == 1 else parts)}"


def unit_remark(name: str) -> str:
    """Return the remark on a column without unit."""
    return f"   # names no unit: {', '.join(units_for(name))[:40]}"


_LONGEST_M: Final = 3.0
#: smaller loads are as likely in kg as of a robot of 30 kg
_LIGHT_N: Final = 150.0
#: times further apart are of runs, not samples
_SHORTEST_RUN_S: Final = 5.0
_AXLE: Final = "load_axle_N"
#: date and time in a file's name -> how a mapping writes them
_MOMENTS: Final = (
    (
        re.compile(r"(?<!\d)(19|20)\d{2}[-_.]?\d{2}[-_.]?\d{2}(?!\d)|(?<!\d)\d{2}[-_.]\d{2}[-_.](19|20)\d{2}(?!\d)"),
        "{date}",
    ),
    (re.compile(r"(?<=\{date\}[T_ \-])\d{2}[-_.:h]?\d{2}([-_.:m]?\d{2})?s?(?!\d)"), "{time}"),
)


def table_lines(table: FileContents, logs: Sequence[FileContents]) -> list[str]:
    """Return the run table's lines; runs without `logs` may be nameless."""
    lines = _place_lines(table)
    left: dict[str, list[str]] = {"recognised by their names": [], "kept as covariates": [], "not used": []}
    targets = _targets(table)
    targets |= {one.name: "log" for one in table.columns if targets[one.name] != "run_id" and _names_logs(one, logs)}

    def of(target: str) -> list[ColumnContents]:
        return [column for column in table.columns if targets[column.name] == target]

    dates = [one for one in of("session") if stem_and_unit(one.name)[0] in {"datum", "date", "messdatum"}]
    passed_over = dates if len(of("session")) > len(dates) else []
    passed_over += of(_AXLE) if set(WHEEL_LOADS) & set(targets.values()) else []
    unmeasured = [one for one in of("distance_m") if not guesses.by_rangefinder(one.name)]
    passed_over += unmeasured if len(of("distance_m")) > len(unmeasured) else []
    readings = _reading_lines(table.columns)
    lines += readings.values()
    named = {*readings}
    for column in table.columns:
        if (guesses.reading_of(column.name) or ("", ""))[0] in readings:
            continue
        directions = [direction_of(text) for text in column.texts]
        letters = {*map(plain_text, column.texts)} <= {"a", "b"} and targets[column.name] != "direction"
        is_direction = (
            0 < len(directions) <= 2 and all(directions) and targets[column.name] not in {"session", "run_id"}
        ) and not letters
        name = "direction" if is_direction else targets[column.name]
        if name == "ref_theta_rad" and column.kind == "text" and len(directions) == 2:
            name = "direction"
        words = column.kind == "text" and not any(map(is_number, column.texts))
        if name == "distance_m" and words and "kind" not in targets.values():
            # `Strecke` is a distance or the route; numbers are no routes
            name = "kind"
        if column in passed_over or name is None or name in named or not _may_be(name, column, table.n_rows):
            left["kept as covariates" if column.kind == "number" else "not used"].append(column.name)
            continue
        named |= {name, *(WHEEL_LOADS if name == _AXLE else ())}
        if name == _AXLE:
            halves = (_column_line(column, wheel, {"factor": 0.5}) for wheel in WHEEL_LOADS)
            lines += [f"{line}   # half of the axle's" for line in halves]
        elif line := _column_line(column, name):
            lines.append(line)
        else:
            left["recognised by their names"].append(column.name)
    lines += _lookup_lines(table, named)
    if table.alike_sheets and not _sheets_of_sides(table):
        lines += _sheet_lines(table.alike_sheets, named)
    if "run_id" not in named:
        number = 'run_id = {value = "r{n:03}"}   # no column names the runs: they are numbered'
        unnamed = bool(logs) and not by_time(table, logs)
        lines.append('#run_id = ""   # the column that names the runs' if unnamed else number)
    if "kind" not in named:
        lines.append('kind = {value = "corridor"}   # the route, where the table does not say')
    lines += _exclusion_lines(table, named)
    for what, names in left.items():
        lines += [f"# {what}: {', '.join(names)[:110]}"] if names else []
    return lines


def _exclusion_lines(table: FileContents, named: set[str]) -> list[str]:
    out = []
    for column in table.columns if "excluded" not in named else ():
        valid = re.search("gueltig|valid|^ok", stem_and_unit(column.name)[0]) is not None
        values = {text: guesses.excludes(text, valid) for text in column.texts}
        if any(values.values()):
            out.append(f"#{entry('excluded', column, None, {'values': values})}   # leaves these runs out")
            out.append(f"#{entry('exclusion_reason', column, None)}")
    return out


def _names_logs(column: ColumnContents, logs: Sequence[FileContents]) -> bool:
    names = {name.lower() for log in logs for name in (Path(log.name).name, Path(log.name).stem)}
    matches = [text.replace("\\", "/").rpartition("/")[2].lower() in names for text in column.texts]
    return 2 * sum(matches) > len(matches)


def _targets(table: FileContents) -> dict[str, str | None]:
    targets = {column.name: guessed_table_column(column.name) for column in table.columns}
    known = set(targets.values())
    if {"payload_kg", "distance_m"} <= known and not set(WHEEL_LOADS) & known:
        targets |= {one.name: targets[one.name] or _place(one) for one in table.columns}
    if _sheets_of_sides(table):
        targets |= {one.name: _of_wheel(one, "left") or targets[one.name] for one in table.columns}
    days = table.columns[0].texts if SECTION in targets else ()
    if days and "session" not in known and guessed_table_column(re.sub(r"\W*\d+", "", days[0])) == "session":
        targets[SECTION] = "session"
    return targets


def _place(column: ColumnContents) -> str | None:
    stem, unit = stem_and_unit(column.name)
    far_m = max(abs(column.low or 0.0), abs(column.high or 0.0)) * SUFFIXES[unit or "m"][1]
    return f"payload_{stem}_m" if stem in {"x", "y"} and far_m < _LONGEST_M else None


def _place_lines(table: FileContents) -> list[str]:
    lines, sides = [], _sheets_of_sides(table)
    if table.alike_sheets and not sides:
        lines.append(f"sheets = {toml_value(list(table.alike_sheets))}   # runs on several sheets, one after another")
    elif table.sheet or sides:
        lines.append(f"sheet = {toml_value(sides.get('left', table.sheet))}")
    if table.runs_in_columns:
        lines.append('runs_in = "columns"')
    return lines


def _sheets_of_sides(table: FileContents) -> dict[str, str]:
    sides = {guesses.side_of(sheet) or "": sheet for sheet in table.alike_sheets}
    return sides if set(sides) == {"left", "right"} and len(table.alike_sheets) == len(sides) else {}


def _of_wheel(column: ColumnContents, side: str | None) -> str | None:
    name, unit = bracketed(column.name)
    target = guessed_table_column(f"{name} {side}" + (f" [{unit}]" if unit else ""))
    return target if target and side and side in target else None


def has_clock(file: FileContents) -> bool:
    """Return whether a file has times as a log has."""
    return any(
        (column.even and not (column.whole and _numbers_rows(column)))
        or (column.kind == "time" and column.step < _SHORTEST_RUN_S)
        for column in file.columns
    )


def _numbers_rows(column: ColumnContents) -> bool:
    numbers = column.step == 1.0 or guessed_table_column(column.name) == "run_id"
    return numbers and guesses.guessed_log_column(column.name) != "t_s"


def run_column(table: FileContents) -> ColumnContents | None:
    """Return the column that names the runs."""
    return next((column for column in table.columns if guessed_table_column(column.name) == "run_id"), None)


def _sheet_lines(sheets: Sequence[str], named: set[str]) -> list[str]:
    free = not {"payload_kg", "load_left_N"} & named
    for unit, columns in (("kg", ("payload_kg",)), ("N", WHEEL_LOADS)) if free else ():
        loads = [guesses.load_of(sheet, unit) for sheet in sheets]
        if None not in loads:
            named |= set(columns)
            values = toml_value({"column": SHEET, "values": dict(zip(sheets, loads, strict=True))})
            remark = "   # of each wheel, or of both?" if unit == "N" else ""
            return [f"{name} = {values}{remark}" for name in columns]
    return [f'#session = "{SHEET}"   # where each sheet holds a session of its own']


def _reading_lines(columns: Sequence[ColumnContents]) -> dict[str, str]:
    readings: dict[str, dict[str, ColumnContents]] = {}
    for column in columns:
        if (reading := guesses.reading_of(column.name)) and column.kind == "number":
            readings.setdefault(reading[0], {}).setdefault(reading[1], column)
    lines = {}
    for target, ends in readings.items():
        if len(ends) < 2:
            continue
        last, first = ends["end"], ends["start"]
        # to a target ahead the distance falls
        if target == "distance_m" and (last.high or 0.0) < (first.high or 0.0):
            last, first = first, last
        lines[target] = _column_line(last, target, {"minus": first.name})
    return lines


def _column_line(column: ColumnContents, name: str, further: dict[str, object] | None = None) -> str:
    further = dict(further or {})
    remark = ""
    if name == "direction" and set(column.texts) - {"out", "back"}:
        meanings = {text: direction_of(text) for text in column.texts}
        free = iter([way for way in ("out", "back") if way not in meanings.values()])
        further["values"] = {text: meaning or next(free, "out") for text, meaning in meanings.items()}
        remark = "" if all(meanings.values()) else '   # "out" or "back"'
    if name == "session" and column.n_empty:
        further["fill_down"] = True
        remark = "   # an empty cell means the one above"
    if recognise(column.name, TABLE_COLUMNS).name == name and not further:
        return ""
    needs, unit = split_suffix(name)[1], stem_and_unit(column.name)[1]
    if name.startswith("counts_"):
        unit = guesses.count_unit(column.name)
        if unit is None and not column.whole:
            unit, remark = "turns", "   # not whole: turns, rad, deg; or counts with thousands points: factor = 1000"
    elif needs and unit is None:
        unit, remark = needs, unit_remark(name)
        if name.startswith("load_") and (column.high or 0.0) < _LIGHT_N:
            return f"#{entry(name, column, unit, further)}{remark}: state it"
    return entry(name, column, unit, further) + remark


def _may_be(target: str, column: ColumnContents, n_rows: int = 0) -> bool:
    if target == "run_id" and column.kind == "number" and column.span + 1 < n_rows:
        return False
    if column.kind == "empty" or (target == "session" and column.form.startswith("times of day")):
        return False
    return column.kind == "number" or target in {*LABEL_COLUMNS, "excluded"}


def _lookup_lines(table: FileContents, named: set[str]) -> list[str]:
    lines = []
    for sheet, columns in table.others.items():
        pairs = ((by, key) for by in table.columns for key in columns if _same_labels(by, key))
        if (sheet in table.alike_sheets and not _sheets_of_sides(table)) or (pair := next(pairs, None)) is None:
            continue
        by, key = pair
        looked_up: dict[str, object] = {"sheet": sheet, "by": by.name}
        if stem_and_unit(key.name)[0] != stem_and_unit(by.name)[0]:
            looked_up["key"] = key.name
        for column in (column for column in columns if column is not key):
            name = _of_wheel(column, guesses.side_of(sheet)) or guessed_table_column(column.name)
            if name and name not in {*named, *LABEL_COLUMNS} and _may_be(name, column):
                named.add(name)
                lines.append(_column_line(column, name, looked_up))
    return lines


def _same_labels(by: ColumnContents, key: ColumnContents) -> bool:
    shared = set(map(plain_text, by.texts)) & set(map(plain_text, key.texts))
    if guessed_table_column(by.name) == guessed_table_column(key.name) == "run_id":
        return True
    return by.kind == key.kind == "text" and len(shared) >= min(2, len(by.texts)) > 0


def files_of_a_run(logs: Sequence[FileContents]) -> dict[str, tuple[str, FileContents]]:
    """Return the files of a run's log: a name for each -> its pattern and first such file."""
    if any(log.recording for log in logs):
        return {}
    groups = list(grouped((re.sub(r"\d+", "#", Path(log.name).name), log) for log in logs).values())
    one = all(len(group) == 1 for group in groups)
    patterns = [name_pattern(stems) or stems[0] * one for stems in ([Path(o.name).stem for o in g] for g in groups)]
    whole = [pattern for pattern in patterns if pattern]
    wheels = sum("counts_left" in {guesses.guessed_log_column(c.name) for c in group[0].columns} for group in groups)
    if not 1 < len(groups) == len(whole) or wheels > 1:
        return {}
    pairs = zip(whole, groups, strict=True)
    runs = set.intersection(*({run_in(Path(log.name).stem, pattern) for log in group} for pattern, group in pairs))
    if not runs or (runs == {None} and not all(has_clock(group[0]) for group in groups)):
        return {}
    words = [re.findall(r"[^\W_]+", re.sub(r"\{.*?\}", " ", pattern)) for pattern in whole]
    tags = ["_".join(word for word in own if not all(word in other for other in words)) for own in words]
    if len({*tags, ""}) != len(tags) + 1:
        tags = [f"file{number}" for number in range(1, len(tags) + 1)]
    firsts = [group[0] for group in groups]
    return {tag: (pattern + Path(log.name).suffix, log) for tag, pattern, log in zip(tags, whole, firsts, strict=True)}


def file_lines(table: FileContents | None, logs: Sequence[FileContents]) -> list[str]:
    """Return patterns of the logs' names, unless the runs' names give them."""
    column = run_column(table) if table else None
    run_ids = column.texts if column is not None and column.kind == "text" else ()
    stems = [Path(log.name).stem for log in logs]
    if several := files_of_a_run(logs):
        files = {tag: pattern for tag, (pattern, _) in several.items()}
        lines = [f"files = {toml_value(files)}   # the files of a run, joined by time"]
    elif table is not None and logs[0].sheet:
        lines = [f"sheet = {toml_value(name_pattern(stems) or '{run_id}')}   # a sheet a run"]
    elif table is None or len(logs) < 2 or any(_names_logs(column, logs) for column in table.columns):
        return []
    elif pattern := name_pattern(stems):
        numbers = {int(run_in(stem, pattern) or 0) for stem in stems}
        first = run_number(run_ids[0], None) if run_ids else column.low if column is not None else None
        from_0 = first == 1 and (min(numbers), max(numbers)) == (0, table.n_rows - 1)
        pattern = pattern.replace("{n", "{n-1") if from_0 else pattern
        remark = "   # the logs count from 0, the runs from 1" if from_0 else ""
        lines = [f"file = {toml_value(pattern + Path(logs[0].name).suffix)}{remark}"]
    elif timed := by_time(table, logs):
        return [f"file = {toml_value(timed)}   # the date and time of a run's row"]
    else:
        return ['#file = "{run_id}.csv"   # the log of a run']
    if run_ids and run_number(run_ids[0], None) is not None:
        pattern = re.sub(r"\d+(?!.*\d)", "{n}", run_ids[0])
        lines.append(f"run = {toml_value(pattern)}   # the number in a run's name")
    return lines


def by_time(table: FileContents, logs: Sequence[FileContents]) -> str | None:
    """Return the pattern of logs named by a run's date and time, else None."""
    moment = moment_of(column.texts[0] for column in table.columns if column.texts)
    pattern, *others = dict.fromkeys(_with_moment([Path(log.name).name for log in logs])) or ("",)
    fits = not others and "{time}" in pattern and any(names_moment(Path(log.name).name, moment) for log in logs)
    return pattern if fits else None


def _with_moment(names: Sequence[str]) -> Sequence[str]:
    for form, sign in _MOMENTS:
        if all(form.search(name) for name in names):
            names = [form.sub(sign, name, count=1) for name in names]
    return names


def name_pattern(stems: Sequence[str]) -> str | None:
    """Return the pattern of logs' names: a run's number, dates and times, text that differs."""
    parts = [re.split(r"(\d+)", stem) for stem in _with_moment(stems)]
    if len({len(part) for part in parts}) > 1 or len(parts[0]) < 2:
        return None
    columns = [[part[at] for part in parts] for at in range(len(parts[0]))]
    numbers = [at for at in range(1, len(columns), 2) if len({int(cell) for cell in columns[at]}) == len(stems)]
    # a run's number is small, beside serial numbers and times
    best = min(numbers, key=lambda at: (max(int(cell) for cell in columns[at]), -at), default=None)
    if best is None:
        return None
    out = ""
    for at, cells in enumerate(columns):
        widths = {len(cell) for cell in cells}
        if at == best:
            out += f"{{n:{widths.pop():02}}}" if len(widths) == 1 and next(iter(widths)) > 1 else "{n}"
        else:
            text = commonprefix(cells)  # noqa: RUF071 - of texts, not of paths
            out += cells[0] if len(set(cells)) == 1 else "*" if at % 2 else f"{text}*"
    return out
