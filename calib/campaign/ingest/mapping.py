"""The mapping: a TOML file of a laboratory's columns and the names of its logs.

docs/ingest.md has an example of each line.
"""

import math
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from calib.campaign.model import LABEL_COLUMNS, LOG_COLUMNS, NUMERIC_COLUMNS, Campaign
from calib.campaign.readers import Layout
from calib.campaign.readers.sheets import COUNT_UNITS, unit_spelled
from calib.campaign.settings import bracketed
from calib.campaign.settings_file import load_toml
from calib.errors import BadFileError
from calib.io import inside
from calib.types import GRAVITY_MPS2, SUFFIXES, split_suffix, unit_named

#: column of the run table with the sheet's name
SHEET: Final = "sheet"
TABLE_COLUMNS: Final = (*LABEL_COLUMNS, *NUMERIC_COLUMNS, "excluded")

_COLUMN: Final = 'a column name, or {column = "...", unit = "...", factor = 1}'
_READINGS: Final = '{column = "...", minus = "..."}, two columns of the run table, without sheet and values'
_TIMES: Final = "pairs of start and end, as [[0, 41.5], [60, 101]]"
_LOG_FILE: Final = (
    "a name that holds {run_id}, {n}, {n-1} or its row's {date} and {time}, beside them * for any text, "
    'as "Run_{n:02}.csv" or "{date}_{time}_TR{n}.csv"'
)
_LOG_FILES: Final = (
    'names and patterns that hold {run_id} or {n}, as {left = "run{n}_left.csv", right = "run{n}_right.csv"}'
)
OF_A_RUN: Final = r"\{(run_id|n(-1)?(:0?\d+)?)\}"
_NOT_NEGATIVE: Final = "a number, not below 0"
_FRAME_RATE: Final = re.compile(r"(\d+(?:\.\d+)?)\s*(hz|fps)", re.IGNORECASE)


def units_for(name: str) -> tuple[str, ...]:
    """Return the units of calib's column `name`."""
    if name.startswith("counts_"):
        return tuple(COUNT_UNITS)
    suffix = split_suffix(name)[1]
    masses = name.startswith("load_") and suffix == "N"
    return tuple(unit for unit, (to, _, _) in SUFFIXES.items() if to == suffix or (masses and to == "kg"))


def _frames_per_s(unit: str | None) -> float:
    rate = _FRAME_RATE.fullmatch(unit or "")
    return float(rate[1]) if rate else 0.0


class _Model(BaseModel):
    model_config = ConfigDict(strict=True, frozen=True, extra="forbid")


class _UnfitError(ValueError):
    def __init__(self, key: str, actual: Any, expected: str) -> None:
        super().__init__(expected)
        self.key, self.found, self.expected = key, actual, expected


class MappedColumn(_Model):
    """A line of a mapping: the source of a column of calib's."""

    column: str = Field(default="", description=_COLUMN)
    value: bool | str | int | float | Annotated[list[bool | str | int | float], Field(min_length=1)] | None = Field(
        default=None, description="a text or a number, or a list of one a run"
    )
    minus: str = Field(default="", description="the name of a column of numbers (a constant is an offset)")
    #: column w of a quaternion about the vertical, `column` its z
    w: str = Field(default="", description="the name of a column of numbers")
    unit: str | None = Field(default=None, description="the name of a unit")
    sheet: str = Field(default="", description="the name of a sheet")
    by: str = Field(default="", description="the run table's column whose text is looked up")
    #: the sheet's column of these; empty: that of the same name, else the first
    key: str = Field(default="", description="the sheet's column that holds the texts looked up")
    fill_down: bool = Field(default=False, description="true or false")
    factor: float = Field(default=1.0, gt=-1e12, lt=1e12, description="a factor that is a number other than 0")
    #: in the line's unit, added to the factor's product
    offset: float = Field(default=0.0, gt=-1e12, lt=1e12, description="a number in the line's unit")
    values: dict[str, bool | str | int | float] = Field(
        default_factory=dict, description='texts and their meanings, as {hin = "out", zurueck = "back"}'
    )
    #: distance to a target, to become that from the run's start; None: as usual for the source
    from_start: bool | None = Field(default=None, description="true or false")
    lag_s: float = Field(default=0.0, gt=-1e12, lt=1e12, description="a number of seconds")

    @model_validator(mode="after")
    def _usable(self) -> "MappedColumn":
        if not self.column and self.value is None and "column" not in self.model_fields_set:
            raise _UnfitError("", None, _COLUMN)
        if bool(self.sheet) != bool(self.by):
            raise _UnfitError("", None, '{column = "...", sheet = "...", by = "..."}, by a column of the run table')
        if self.minus and (not self.column or self.sheet or self.values):
            raise _UnfitError("", self.minus, _READINGS)
        if self.factor == 0:
            raise _UnfitError("", 0, "a factor that is a number other than 0")
        return self

    @field_validator("unit")
    @classmethod
    def _as_calib_writes(cls, unit: str | None) -> str | None:
        return None if unit is None else unit_spelled(unit)

    @property
    def sources(self) -> tuple[str, ...]:
        """The columns of the source that are read."""
        return tuple(filter(None, (self.column, self.minus, self.w)))

    def unit_for(self, name: str) -> str | None:
        """Return the line's unit, or that in the source's name, for column `name`."""
        if self.unit is not None:
            # "rad/s" of wheels stays
            return self.unit if name.startswith("counts_") else unit_named(self.unit) or self.unit
        ending = split_suffix(self.column)[1] if abs(self.factor) == 1.0 else ""
        unit = unit_spelled(bracketed(self.column)[1] or ending or "")
        return unit if unit in units_for(name) or (name == "t_s" and _frames_per_s(unit)) else None

    def on_unit(self, name: str) -> str:
        """Return a note on a unit in brackets that column `name` cannot have; empty where the line states one."""
        stated = self.unit is not None or self.factor != 1.0 or self.values or self.unit_for(name)
        unit = "" if stated or split_suffix(name)[1] is None else bracketed(self.column)[1] or ""
        return unit and f"[{unit}] is no unit of {name}, whose values are taken as they stand; state unit or factor"

    @property
    def wheel_unit(self) -> str:
        """Unit of a wheel's column, of `COUNT_UNITS`."""
        return self.unit_for("counts_left") or "counts"

    def target(self, name: str) -> str:
        """Return calib's column `name` in the source's unit (``t_ms``)."""
        unit = self.unit_for(name)
        if unit not in SUFFIXES or name.startswith("counts_") or self._weighed(name):
            return name
        return f"{split_suffix(name)[0]}_{unit}"

    def scale(self, name: str) -> float:
        """Return the factor beside the unit; a load in kg is its weight in N."""
        unit = self.unit_for(name)
        if rate := _frames_per_s(unit):
            return self.factor / rate
        return self.factor * (GRAVITY_MPS2 * SUFFIXES[unit][1] if unit and self._weighed(name) else 1.0)

    def _weighed(self, name: str) -> bool:
        unit = self.unit_for(name)
        return name.startswith("load_") and unit in SUFFIXES and SUFFIXES[unit][0] == "kg"


def counts_per_unit(name: str, unit: str, settings: Campaign) -> float:
    """Return the counts in a unit of a wheel's column `name`, or in a rate's second.

    `unit`: of `COUNT_UNITS`; a length is rolled at the nominal radius.
    """
    kind, size, _ = COUNT_UNITS[unit]
    if kind == "length":
        vehicle = settings.vehicle
        size /= 2.0 * math.pi * (vehicle.front_radius_m if name == "counts_front" else vehicle.wheel_radius_m)
    return size * settings.encoder.per_rev(name) if kind in {"angle", "rate", "length"} else 1.0


class _Section(_Model):
    sheet: str | None = Field(default=None, description="the name of a sheet")
    header_row: int | None = Field(default=None, ge=1, description="the number of a row, counted from 1")
    units_row: int | None = Field(default=None, ge=1, description="the number of a row, counted from 1")
    skip_rows: list[Annotated[int, Field(ge=1)]] = Field(
        default_factory=list, description="numbers of rows, counted from 1, as [1, 2, 40]"
    )
    columns: dict[str, MappedColumn] = Field(default_factory=dict)

    @model_validator(mode="before")
    @classmethod
    def _gather_columns(cls, section: dict[str, object]) -> dict[str, object]:
        keys = set(cls.model_fields) - {"columns"}
        lines = {name: line for name, line in section.items() if name not in keys}
        columns = {name: {"column": line} if isinstance(line, str) else line for name, line in lines.items()}
        return {name: section[name] for name in keys & set(section)} | {"columns": columns}

    @model_validator(mode="after")
    def _units_fit(self) -> "_Section":
        for name, line in self.columns.items():
            if line.w and (name != "ref_theta_rad" or isinstance(self, TableSection) or line.unit or not line.column):
                raise _UnfitError(name, line.w, "w of a quaternion for ref_theta_rad in [log] alone, without a unit")
            _check_unit(name, line, name)
        return self

    @property
    def layout(self) -> Layout:
        """Sheet and rows, for the readers."""
        return Layout(self.sheet, self.header_row, self.units_row, tuple(self.skip_rows), lab=True)


def _check_unit(name: str, line: MappedColumn, key: str) -> None:
    units = units_for(name)
    unit = None if line.unit is None else line.unit_for(name)
    if unit not in {None, *units} and not (name == "t_s" and _frames_per_s(unit)):
        expected = f"one of {', '.join(units)}" if units else f"no unit, since {name} has none"
        expected += ', or the rate of frames counted, as "50 Hz"' * (name == "t_s")
        raise _UnfitError(key, line.unit, expected)


class TableSection(_Section):
    """``[table]``: the columns of the run table."""

    file: str | None = Field(default=None, description="the name of the run table, relative to the mapping")
    runs_in: Literal["rows", "columns"] = Field(default="rows", description='"rows" or "columns"')
    #: sheets of runs, one after another; a line may name the column `SHEET`
    sheets: list[str] = Field(default_factory=list, description='names of sheets, as ["empty", "200 kg"]')

    @property
    def layout(self) -> Layout:
        """Sheet, rows, and whether each run stands in a column."""
        return replace(super().layout, runs_in_columns=self.runs_in == "columns")


class LogSection(_Section):
    """``[log]``: the columns of logs and recordings, and how a run's log is found."""

    file: str | None = Field(default=None, pattern=OF_A_RUN + r"|\{time\}", description=_LOG_FILE)
    files: dict[Annotated[str, Field(pattern=r"^\w+$")], str] = Field(default_factory=dict, description=_LOG_FILES)
    #: name of these -> column of times other than `t_s`
    clocks: dict[str, str | MappedColumn] = Field(
        default_factory=dict, description='names of files and their times, as {camera = "Stamp [ms]"}'
    )
    run: str | None = Field(default=None, pattern=r"\{n\}", description='how a run is called, as "Run {n}"')
    lag: Literal["report", "remove"] = Field(default="report", description='"report" or "remove"')
    swapped: list[str] = Field(default_factory=list, description='names of runs, as ["Run 12"]')

    @model_validator(mode="after")
    def _clocks_fit(self) -> "LogSection":
        for tag in self.clocks:
            _check_unit("t_s", self.clock_of(tag), f"clocks.{tag}")
        return self

    @property
    def by_moment(self) -> bool:
        """Whether the date and time of its row name a run's log."""
        return self.file is not None and re.search(OF_A_RUN, self.file) is None

    @property
    def run_sheet(self) -> str | None:
        """Name of the sheet that is a run's log, as ``Run {n}``."""
        return self.sheet if self.sheet and re.search(OF_A_RUN, self.sheet) else None

    def clock_of(self, tag: str) -> MappedColumn:
        """Return the column of the times in a file of `files`, or in each."""
        line = self.clocks.get(tag, self.columns.get("t_s", "t_s"))
        return MappedColumn(column=line) if isinstance(line, str) else line

    @field_validator("columns")
    @classmethod
    def _known(cls, columns: dict[str, MappedColumn]) -> dict[str, MappedColumn]:
        for name, line in columns.items():
            if name not in LOG_COLUMNS:
                known = (*sorted(set(cls.model_fields) - {"columns"}), *LOG_COLUMNS)
                raise _UnfitError(name, name, f"one of {', '.join(known)}")
            if line.minus:
                raise _UnfitError(name, line.minus, "minus in [table] alone, where runs have two readings")
        return columns


class Segmentation(_Model):
    """``[cut]``: how a continuous recording is cut into runs."""

    by: Literal["stops", "length", "column", "times"] = Field(
        default="stops", description="one of stops, length, column, times"
    )
    min_stop_s: float = Field(default=1.0, ge=0, description=_NOT_NEGATIVE)
    min_length_m: float = Field(default=0.5, ge=0, description=_NOT_NEGATIVE)
    length_m: float = Field(default=0.0, ge=0, description=_NOT_NEGATIVE)
    length_s: float = Field(default=0.0, ge=0, description=_NOT_NEGATIVE)
    column: str = Field(default="", description="a text")
    times: list[Annotated[list[Any], Field(min_length=2, max_length=2)]] = Field(
        default_factory=list, description=_TIMES
    )
    start: str = Field(default="", description="a text")
    end: str = Field(default="", description="a text")
    run_id: str = Field(default="r{n:03}", description="a text")

    @model_validator(mode="after")
    def _complete(self) -> "Segmentation":
        if self.by == "length" and (self.length_m > 0) == (self.length_s > 0):
            raise _UnfitError("length_m", self.length_m, "a length, either length_m or length_s")
        if self.by == "column" and not self.column:
            raise _UnfitError("column", "", "the column whose value tells the runs")
        if self.by == "times" and not self.times and not (self.start and self.end):
            raise _UnfitError("times", [], "pairs of start and end, or the table's columns start and end")
        return self


@dataclass(frozen=True, slots=True)
class LabMapping:
    """A mapping as read."""

    shown: str
    table: TableSection
    log: LogSection
    #: None where each log is one run
    cut: Segmentation | None
    settings: dict[str, object]
    table_file: Path | None = None


def read_mapping(path: Path | None) -> LabMapping:
    """Read a mapping.

    `path`: TOML file; None: an empty one. Raises BadFileError where a line cannot be used.
    """
    shown = str(path) if path else "mapping"
    remedy = "give the path of the mapping, which 'calib ingest --describe' proposes"
    document = load_toml(path, shown, remedy=remedy) if path else {}
    table = parse_section(TableSection, document.pop("table", {}), shown, "table")
    log = parse_section(LogSection, document.pop("log", {}), shown, "log")
    for name, other in (("counts_left", "counts_right"), ("speed_left_mps", "speed_right_mps")):
        line = log.columns.get(name)
        if line and line.column and line == log.columns.get(other):
            raise bad_line(shown, "log", other, line.column, f"another column than that of {name}, a wheel each")
    cut = parse_section(Segmentation, document.pop("cut"), shown, "cut") if "cut" in document else None
    for tag, pattern in log.files.items() if cut is None else ():
        if not re.search(OF_A_RUN, pattern):
            raise bad_line(shown, "log", f"files.{tag}", pattern, f"{_LOG_FILES}; or [cut], for many runs")
    table_file = inside(path.parent, table.file, named_in=shown, column="table.file") if path and table.file else None
    return LabMapping(shown, table, log, cut, document, table_file)


_Parsed = TypeVar("_Parsed", bound=BaseModel)


def parse_section(model: type[_Parsed], section: object, shown: str, where: str) -> _Parsed:
    """Check one section of a mapping.

    `shown`, `where`: mapping and section in messages. Raises BadFileError at the first key that cannot be used, or
    where it is no section.
    """
    if not isinstance(section, dict):
        raise BadFileError(shown, repr(section)[:60], f"a section [{where}]", "correct the mapping", column=where)
    try:
        return model.model_validate(section)
    except ValidationError as error:
        first = error.errors()[0]
        path = [str(part) for part in first["loc"]]
        unfit = first.get("ctx", {}).get("error")
        fields: Any = model.model_fields
        if path and path[0] == "columns":
            path, fields = path[1:], MappedColumn.model_fields
        name = path[0] if path else ""
        if isinstance(unfit, _UnfitError):
            actual = first["input"] if unfit.found is None else unfit.found
            raise bad_line(shown, where, unfit.key or name, actual, unfit.expected) from error
        key = path[1] if fields is MappedColumn.model_fields and len(path) > 1 else name
        if first["type"] == "extra_forbidden":
            expected = f"the keys {', '.join(sorted(fields))}"
            raise bad_line(shown, where, name, key, expected) from error
        expected = (fields[key].description if key in fields else None) or _COLUMN
        raise bad_line(shown, where, name, first["input"], expected) from error


def bad_line(shown: str, where: str, name: str, actual: Any, expected: str) -> BadFileError:
    """Return the error for one line of a mapping; see `BadFileError`."""
    return BadFileError(shown, repr(actual)[:80], expected, "correct the mapping", column=f"{where}.{name}")
