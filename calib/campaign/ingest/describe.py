"""Describe files, propose a mapping as commented TOML; write a blank campaign."""

import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from calib.campaign import ingest
from calib.campaign.ingest import ColumnContents, FileContents, described, file_contents, listed_files, wrapped
from calib.campaign.ingest.guesses import guessed_log_column, guessed_table_column, shipped
from calib.campaign.ingest.mapping import MappedColumn
from calib.campaign.ingest.proposal_log import SKID_STEER, log_lines
from calib.campaign.ingest.proposal_table import file_lines, files_of_a_run, has_clock, run_column, table_lines
from calib.campaign.model import LOG_COLUMNS
from calib.campaign.readers.sheets import COUNT_UNITS
from calib.campaign.settings import recognise
from calib.campaign.settings_file import FORMAT, STATED, to_toml, toml_value
from calib.documents import plain
from calib.errors import BadInputError
from calib.io import refuse_existing, write_text
from calib.types import grouped

_MAX_FILES_READ: Final = 40
#: beside a column that no log has they show a run table without names
_RUN_TABLE_NUMBERS: Final = frozenset({"distance_m", "counts_left", "counts_right"})
_RUN_TABLE_COLUMNS: Final = frozenset(
    {"session", "direction", "kind", "payload_kg", "load_axle_N", "load_left_N", "load_right_N", "temperature_C"}
)
_SPEED_LINES: Final = {"counts_per_rev": ('kind = "speed"   # in place of counts_per_rev: the logs have speeds',)}
#: counted instead of two rear wheels -> key of the settings -> its lines, empty for the usual
_OTHER_WHEELS: Final[Mapping[str, Mapping[str, tuple[str, ...]]]] = {
    "counts_rear_left": {
        "drive": ('drive = "mecanum"   # four wheels are counted',),
        "track_m": ("#half_length_plus_half_width_m =   # half the wheelbase plus half the track",),
    },
    "counts_front": {
        "drive": ('drive = "tricycle"   # no rear wheel is counted, the front wheel is',),
        "wheel_radius_m": ("", "#front_wheel_radius_m =   # nominal"),
        "counts_per_rev": ("", "#counts_per_rev_front =   # of the front wheel, where it differs"),
    },
    "speed_left_mps": _SPEED_LINES,
    "v_mps": _SPEED_LINES,
    "speed_rear_mps": {
        "drive": ('drive = "ackermann"   # one speed of the rear axle; front wheels that steer',),
        **_SPEED_LINES,
    },
}

RUNS_HEADER: Final = (
    "run_id,session,kind,direction,payload_kg,payload_x_m,payload_y_m,speed_mps,distance_m,"
    "counts_left,counts_right,log,excluded,exclusion_reason"
)


@dataclass(frozen=True, slots=True)
class Description:
    """The contents of files, and the mapping proposed for them."""

    #: looked into, the run table first
    files: tuple[FileContents, ...]
    n_files: int
    table: FileContents | None
    mapping: tuple[str, ...]
    sources: tuple[str, ...]

    def to_toml(self) -> str:
        """Return remarks above the proposed mapping: TOML that ingest takes."""
        lines = ["# Contents of the files, and a proposed mapping. Check every line, then:"]
        sources = " ".join(f"'{source}'" if re.search(r"\s", source) else source for source in self.sources)
        lines += wrapped(f"calib ingest {sources} --mapping THIS_FILE --into CAMPAIGN", "#   ", "")
        lines.append("#")
        apart = any(not file.alike(self.files[0]) for file in self.files)
        for group in grouped(
            ((apart and file is self.table, *(one.name for one in file.columns)), file) for file in self.files
        ).values():
            lines += described(group, is_run_table=group[0] is self.table)
        return "\n".join([*lines, "", *self.mapping]) + "\n"

    def to_dict(self) -> dict[str, object]:
        """Return the description for JSON."""
        table = None if self.table is None else self.table.name
        return {"n_files": self.n_files, "table": table, "files": plain(self.files), "mapping": self.to_toml()}


def describe(sources: Sequence[Path]) -> Description:
    """Describe files and propose a mapping.

    Raises BadInputError where a source cannot be read.
    """
    paths = listed_files([Path(source) for source in sources])
    kinds = grouped((re.sub(r"\d+", "#", str(path)), path) for path in paths)
    if len(kinds) > _MAX_FILES_READ:
        kinds = grouped((f"{path.parent}/*{path.suffix.lower()}", path) for path in paths)
    files: list[FileContents] = []
    for members in kinds.values():
        read = members if len(members) <= _MAX_FILES_READ else [members[0], members[-1]]
        files += [replace(file_contents(read[0]), unread=len(members) - len(read)), *map(file_contents, read[1:])]
    if not any(file.n_rows for file in files):
        expected = "a row a run, or a row a sample"
        raise BadInputError(f"{files[0].name}: found a header and no rows; expected {expected}; export it again")
    table = _run_table(files)
    logs = [file for file in files if file is not table]
    alike = table is not None and not has_clock(table) and all(file.alike(table) for file in files)
    whole = replace(table, columns=ingest.together(files)) if table is not None and alike else table
    beside = [file for file in logs if table is not None and not alike and _joins(file, table)]
    if whole is not None:
        whole = replace(whole, others={**whole.others, **{Path(file.name).stem: file.columns for file in beside}})
    apart = [] if alike else [file for file in logs if file not in beside]
    lines = _mapping_lines(whole, apart or (_sheets_of_runs(table) if table is not None else []))
    if alike and (folders := ingest.folders_of(paths)):
        lines = wrapped(f"{folders}: {ingest.OF_FOLDERS}", "# ") + lines
    names = [str(source) for source in sources]
    ordered = names if table is None else [table.name, *(source for source in names if source != table.name)]
    return Description((*([table] if table else ()), *logs), len(paths), table, tuple(lines), tuple(ordered))


def _sheets_of_runs(table: FileContents) -> list[FileContents]:
    sheets = (FileContents(name, False, 0, columns, (), sheet=name) for name, columns in table.others.items())
    alike = grouped((tuple(column.name for column in sheet.columns), sheet) for sheet in sheets)
    return next((group for group in alike.values() if len(group) > 1 and has_clock(group[0])), [])


def _joins(file: FileContents, table: FileContents) -> bool:
    of_runs = run_column(table) is not None and run_column(file) is not None and file.n_rows >= table.n_rows
    return of_runs and not has_clock(file) and not table.name.endswith(ingest.WORKBOOK)


def _run_table(files: Sequence[FileContents]) -> FileContents | None:
    best, best_score = None, 0
    for file in files:
        guesses = {guessed_table_column(column.name) for column in file.columns} - {None}
        score = len(guesses) + 3 - 4 * any(guessed_log_column(column.name) == "t_s" for column in file.columns)
        runs = run_column(file)
        single = runs is not None and (runs.kind != "number" or 2 * runs.span + 2 > file.n_rows)
        named = single or (guesses >= _RUN_TABLE_NUMBERS and guesses & _RUN_TABLE_COLUMNS and not has_clock(file))
        if not file.recording and named and score > best_score:
            best, best_score = file, score
    if best is None:
        others = [file for file in files if not (file.recording or has_clock(file))]
        worded = [one for one in others if any(column.kind in {"text", "time"} for column in one.columns)]
        if len(worded) == 1 and (len(files) == 1 or any(map(has_clock, files))):
            return worded[0]
    return best


def _mapping_lines(table: FileContents | None, logs: Sequence[FileContents]) -> list[str]:
    named_by = Path((table or logs[0]).name)
    title = named_by.parent.name if table is None and len(logs) > 1 and named_by.parent.name else named_by.stem
    columns = [column for log in logs for column in log.columns]
    widths = (column.wrap_bits for column in columns if guessed_log_column(column.name) != "t_s")
    own = log_lines(logs) if logs else []
    named = {recognise(column.name, LOG_COLUMNS).name for column in columns} | {line.partition(" ")[0] for line in own}
    lines = [f"name = {toml_value(title)}", *_settings_lines(next(filter(None, widths), None), named, own)]
    if "ref_x_m" in named:
        lines += ["", "[reference]", "#sigma_xy_m =   # standard uncertainty of a position"]
        lines += ["#sigma_theta_rad =   # standard uncertainty of a heading"]
    if table is not None:
        lines += ["", f"{'[table]':27}# calib's column = the table's column", *table_lines(table, logs)]
    if logs:
        lines += ["", f"{'[log]':27}# the same for logs and recordings", *file_lines(table, logs), *own]
    recordings = [log for log in logs if log.recording]
    if len(recordings) > 1 and table is None:
        lines += ["", f"{'#[cut]':27}# each recording is a run; where one holds many:", '#by = "stops"']
    elif by_column := [column.name for log in logs[:1] for column in log.columns if _numbers_runs(column, logs)]:
        lines += ["", f"{'[cut]':27}# one log holds many runs", 'by = "column"', f"column = {toml_value(by_column[0])}"]
    elif (recordings and (table is None or len(logs) == 1)) or _holds_many_runs(logs):
        lines += ["", f"{'[cut]':27}# one recording holds many runs", 'by = "stops"', "min_stop_s = 1.0"]
        lines += ['#by = "times"', '#times = [[0.0, 41.5], [60.0, 101.0]]   # or "length", "column"']
    return lines


def _numbers_runs(column: ColumnContents, logs: Sequence[FileContents]) -> bool:
    few = len(logs) == 1 and column.whole and column.step == 1.0 and 0 < column.span < logs[0].n_rows / 20
    return few and guessed_table_column(column.name) == "run_id"


def _holds_many_runs(logs: Sequence[FileContents]) -> bool:
    patterns = [pattern for pattern, _ in files_of_a_run(logs).values()]
    return bool(patterns) and not any("{" in pattern for pattern in patterns)


def _settings_lines(bits: int | None, named: set[str], own: Sequence[str]) -> list[str]:
    turned = [line for line in own if line.startswith("counts_")]
    wheels = next((name for name in _OTHER_WHEELS if name in named and "counts_left" not in named), "")
    drives = '#drive =   # "tricycle" (assumed), "differential", "mecanum", "ackermann", "skid"'
    others = {"drive": (drives,), "counts_per_rev": ("",), **_OTHER_WHEELS.get(wheels, {})}
    if any(SKID_STEER in line for line in turned):
        others["drive"] = ('drive = "skid"   # both wheels of a side turn alike',)
    as_angles = bool(turned) and all(map(_without_counts, turned))
    if as_angles and wheels != "speed_rear_mps":
        resolution = "counts_per_rev = 4096   # no wheel gives counts: the resolution that they are kept in"
        others["counts_per_rev"] = (resolution,)
    if bits:
        others["counts_per_rev"] += (f"wrap_bits = {bits}   # found in the jumps of the counters",)
    lines: list[str] = []
    for section in ("vehicle", "encoder", "rangefinder"):
        remark = "" if lines else "   # state what you know; keys omitted are marked as assumed"
        lines += ["", f"[{section}]{remark}"]
        for key in (*(("drive",) if section == "vehicle" else ()), *STATED[section]):
            [meaning] = re.findall(rf"^#{key} .*# (.*)", shipped()["blank"], re.MULTILINE)
            lines += [line or f"#{key} =   # {meaning}" for line in others.get(key, ("",))]
    return lines


def _without_counts(line: str) -> bool:
    (source,) = tomllib.loads(line).values()
    column = MappedColumn.model_validate(source if isinstance(source, dict) else {"column": source})
    return COUNT_UNITS[column.wheel_unit][0] in {"angle", "rate", "length"}


def write_blank(folder: Path, *, force: bool) -> tuple[Path, ...]:
    """Write an empty campaign: ``campaign.toml`` with remarks, ``runs.csv`` with its header, and ``logs``.

    Raises BadInputError where a campaign exists there and `force` is False.
    """
    settings, runs, logs = (folder / name for name in ("campaign.toml", "runs.csv", "logs"))
    refuse_existing([settings, runs], force=force)
    write_text(settings, to_toml({"format": FORMAT, "name": folder.resolve().name}) + shipped()["blank"], force=force)
    write_text(runs, RUNS_HEADER + "\n", force=force)
    logs.mkdir(exist_ok=True)
    return settings, runs, logs
