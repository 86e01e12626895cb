"""The mapping: a TOML file, written once for a laboratory's export, that says which source column is which.

::

    name = "hall 3, spring"            # any key or section of campaign.toml: vehicle, encoder, model, ...
    [vehicle]
    track_mm = 700

    [table]                            # calib column = column of the laboratory's run table
    file = "runs.xlsx"                 # beside the mapping, where no table is among the sources
    sheet = "Runs"                     # sheet and header_row are found where they are not named
    run_id = "Run no."
    distance_m = {column = "Distance", unit = "mm"}
    counts_left = {column = "Enc L", factor = -1}
    direction = {column = "Way", values = {hin = "out", zurueck = "back"}}
    session = {value = "monday"}       # the same for every run; a list holds one value a run

    [log]                              # the same for logs and recordings, and the file that holds a run's log
    file = "run_{n:02}.csv"            # {run_id}, or {n}: the number in the run's name, as run = "Run {n}" reads it
    swapped = ["Run 12"]               # runs whose left and right encoder were exchanged
    t_s = {column = "time", unit = "ms"}
    counts_left = "EncL"
    counts_right = {column = "/joints:position.right", unit = "rad"}
    range_m = {column = "/range:range", from_start = true}

    [cut]                              # how a recording is cut into runs
    by = "stops"                       # "stops", "length", "column" or "times"

Columns that already carry calib's names, with any known unit, need no line.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from calib.campaign.columns import spelled
from calib.campaign.ingest.cut import Cut, parse_cut
from calib.campaign.model import LABEL_COLUMNS, LOG_COLUMNS, NUMERIC_COLUMNS
from calib.campaign.readers import Layout
from calib.campaign.settings_file import load_toml
from calib.errors import BadFileError
from calib.files import inside
from calib.units import SUFFIXES, split_suffix

TABLE_COLUMNS: Final = (*LABEL_COLUMNS, *NUMERIC_COLUMNS, "excluded")

#: what a wheel's column may hold instead of counts -> what it is, and how many turns one of its units makes
COUNT_UNITS: Final[Mapping[str, tuple[str, float]]] = {
    "counts": ("counts", 1.0),
    "counts/sample": ("increments", 1.0),
    "counts/s": ("count_rate", 1.0),
    "turns": ("angle", 1.0),
    "rad": ("angle", 1.0 / 6.283185307179586),
    "deg": ("angle", 1.0 / 360.0),
    "turns/s": ("rate", 1.0),
    "rad/s": ("rate", 1.0 / 6.283185307179586),
    "deg/s": ("rate", 1.0 / 360.0),
    "rpm": ("rate", 1.0 / 60.0),
    "rad/min": ("rate", 1.0 / (60.0 * 6.283185307179586)),
}
_LINE_KEYS: Final = frozenset({"column", "unit", "factor", "value", "values", "from_start", "lag_s"})
_FILE_KEYS: Final = frozenset({"file", "run", "sheet", "header_row", "lag", "swapped"})


@dataclass(frozen=True, slots=True)
class Line:
    """One line of a mapping."""

    #: calib's column
    name: str
    #: the source's column; empty where `value` stands for it
    column: str = ""
    #: what holds for every run, or one value a run
    value: str | float | tuple[str | float, ...] | None = None
    #: the source's unit
    unit: str | None = None
    #: what the source's numbers are multiplied by
    factor: float = 1.0
    #: texts of the source and what they stand for
    values: Mapping[str, str] = field(default_factory=dict)
    #: a distance to a target, to be turned into the distance from the start of the run; None: as usual for the source
    from_start: bool | None = None
    #: time that the column lags behind the wheels, to be taken off
    lag_s: float = 0.0

    @property
    def target(self) -> str:
        """Calib's column in the source's unit (``t_ms``), as the recognition of columns reads it."""
        unit = self.unit
        if unit is None and ("[" in self.column or "(" in self.column):
            # the source names its own unit: Distance [mm]
            _, unit = split_suffix(spelled(self.column))
            _stem, suffix = split_suffix(self.name)
            if unit is not None and SUFFIXES[unit][0] != suffix:
                unit = None
        if unit is None or self.name.startswith("counts_"):
            return self.name
        return f"{split_suffix(self.name)[0]}_{unit}"


@dataclass(frozen=True, slots=True)
class LogFiles:
    """How a run's log is found: a name with ``{run_id}`` or ``{n}``, and how ``{n}`` is read from the run's name."""

    file: str | None = None
    run: str | None = None
    layout: Layout = field(default_factory=Layout)
    remove_lag: bool = False
    swapped: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class MappingFile:
    """A mapping as read: lines of the run table, lines of the logs, the cut, and what goes into ``campaign.toml``."""

    shown: str
    table: tuple[Line, ...]
    table_layout: Layout
    log: tuple[Line, ...]
    log_files: LogFiles
    cut: Cut | None
    settings: dict[str, Any]
    table_file: Path | None = None


def read_mapping(path: Path | None) -> MappingFile:
    """Read a mapping.

    `path`: TOML file as this module's text shows; None stands for an empty one. Raises BadFileError where a line cannot
    be used.
    """
    shown = str(path) if path else "mapping"
    document = load_toml(path, shown) if path else {}
    table, log = _section(document, "table", shown), _section(document, "log", shown)
    cut = parse_cut(_section(document, "cut", shown), shown) if "cut" in document else None
    layout = _layout(table, shown, "table")
    table_file = _table_file(table.pop("file", None), path, shown)
    files = _log_files(log, shown)
    known_logs = LOG_COLUMNS
    return MappingFile(
        shown=shown,
        table=tuple(_line(name, entry, shown, "table", None) for name, entry in table.items()),
        table_layout=layout,
        log=tuple(_line(name, entry, shown, "log", known_logs) for name, entry in log.items()),
        log_files=files,
        cut=cut,
        settings=document,
        table_file=table_file,
    )


def bad_line(shown: str, where: str, name: str, found: Any, expected: str) -> BadFileError:
    """Return the error for one line of a mapping.

    Parameters
    ----------
    shown, where, name : str
        The mapping, its section, the line's key.
    found : object
        What the line says.
    expected : str
        What it should say.
    """
    return BadFileError(shown, repr(found)[:80], expected, "correct the mapping", column=f"{where}.{name}")


def _section(document: dict[str, Any], name: str, shown: str) -> dict[str, Any]:
    section = document.pop(name, {})
    if not isinstance(section, dict):
        raise BadFileError(shown, repr(section)[:60], f"a section [{name}]", "correct the mapping", column=name)
    return dict(section)


def _layout(section: dict[str, Any], shown: str, where: str) -> Layout:
    sheet, row = section.pop("sheet", None), section.pop("header_row", None)
    if sheet is not None and not isinstance(sheet, str):
        raise bad_line(shown, where, "sheet", sheet, "the name of a sheet")
    if row is not None and (isinstance(row, bool) or not isinstance(row, int) or row < 1):
        raise bad_line(shown, where, "header_row", row, "the number of a row, counted from 1")
    return Layout(sheet, row)


def _table_file(name: Any, mapping: Path | None, shown: str) -> Path | None:
    if name is None or mapping is None:
        return None
    if not isinstance(name, str):
        raise bad_line(shown, "table", "file", name, "the name of the run table, relative to the mapping")
    return inside(mapping.parent, name, named_in=shown, column="table.file")


def _log_files(section: dict[str, Any], shown: str) -> LogFiles:
    layout = _layout(section, shown, "log")
    file, run, lag = section.pop("file", None), section.pop("run", None), section.pop("lag", "report")
    if file is not None and not (isinstance(file, str) and re.search(r"\{(run_id|n(:0?\d+)?)\}", file)):
        raise bad_line(
            shown, "log", "file", file, 'a name that holds {run_id} or {n}, as "run_{run_id}.csv" or "Run_{n:02}.csv"'
        )
    if run is not None and not (isinstance(run, str) and "{n}" in run):
        raise bad_line(shown, "log", "run", run, 'how a run is called, as "Run {n}"')
    if lag not in {"report", "remove"}:
        raise bad_line(shown, "log", "lag", lag, '"report" or "remove"')
    swapped = section.pop("swapped", [])
    if not isinstance(swapped, list) or not all(isinstance(run_id, str) for run_id in swapped):
        raise bad_line(shown, "log", "swapped", swapped, 'names of runs, as ["Run 12"]')
    return LogFiles(file, run, layout, lag == "remove", tuple(swapped))


def _line(name: str, entry: Any, shown: str, where: str, known: Sequence[str] | None) -> Line:
    line = {"column": entry} if isinstance(entry, str) else entry
    if not isinstance(line, dict) or ("value" not in line and not isinstance(line.get("column"), str)):
        raise bad_line(shown, where, name, entry, 'a column name, or {column = "...", unit = "...", factor = 1}')
    if known is not None and name not in known:
        raise bad_line(shown, where, name, name, f"one of {', '.join(sorted(_FILE_KEYS))}, {', '.join(known)}")
    if strange := sorted(set(line) - _LINE_KEYS):
        raise bad_line(shown, where, name, strange, f"the keys {', '.join(sorted(_LINE_KEYS))}")
    value = line.get("value")
    if isinstance(value, bool):
        value = "true" if value else "false"
    if isinstance(value, list) and value and all(isinstance(cell, str | int | float) for cell in value):
        value = tuple(value)
    if value is not None and not isinstance(value, str | int | float | tuple):
        raise bad_line(shown, where, name, value, "a text or a number, or a list of one a run")
    for key, expected in (("factor", "a factor that is a number other than 0"), ("lag_s", "a number of seconds")):
        number = line.get(key, 1.0)
        usable = isinstance(number, int | float) and not isinstance(number, bool) and abs(number) < 1e12
        if not usable or (key == "factor" and number == 0):
            raise bad_line(shown, where, name, number, expected)
    values = line.get("values", {})
    if not isinstance(values, dict) or not all(isinstance(text, str | int | float) for text in values.values()):
        raise bad_line(shown, where, name, values, 'texts and what they stand for, as {hin = "out", zurueck = "back"}')
    unit = line.get("unit")
    if unit is not None and not _fits(name, unit):
        kind = f"one of {', '.join(COUNT_UNITS)}" if name.startswith("counts_") else "a unit of the same kind"
        raise bad_line(shown, where, name, unit, f"{kind} as {name} is in")
    from_start = line.get("from_start")
    if from_start is not None and not isinstance(from_start, bool):
        raise bad_line(shown, where, name, from_start, "true or false")
    return Line(
        name=name,
        column=line.get("column", ""),
        value=value,
        unit=unit,
        factor=float(line.get("factor", 1.0)),
        values={str(found): str(meant) for found, meant in values.items()},
        from_start=from_start,
        lag_s=float(line.get("lag_s", 0.0)),
    )


def _fits(name: str, unit: Any) -> bool:
    if not isinstance(unit, str):
        return False
    if name.startswith("counts_"):
        return unit in COUNT_UNITS
    suffix = split_suffix(name)[1]
    return suffix is not None and unit in SUFFIXES and SUFFIXES[unit][0] == suffix
