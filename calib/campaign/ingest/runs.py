"""The run table under calib's names, and which file is the log of which run."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from itertools import accumulate
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from calib.campaign import ingest, run_table
from calib.campaign.ingest import moment_of
from calib.campaign.ingest.mapping import TABLE_COLUMNS, LabMapping, LogSection, MappedColumn, bad_line, counts_per_unit
from calib.campaign.model import Border, Campaign, RunTable
from calib.campaign.readers import READERS, Layout, RawTable, read_table
from calib.campaign.readers.sheets import COUNT_UNITS
from calib.campaign.readers.table import comma_evidence, is_filled, numbers, object_array
from calib.campaign.settings import bracketed, converted, recognise
from calib.errors import BadFileError
from calib.io import sha256_file

_LISTED: Final = 8


def without_unit(name: str) -> str:
    """Return a column's name without a unit in brackets."""
    return bracketed(name)[0]


def whole_name(column: str, names: Collection[str]) -> str:
    """Return the file's name of a column that a mapping gives without its unit, else `column`."""
    alike = [name for name in names if without_unit(name) == column.strip()]
    return alike[0] if len(alike) == 1 and column not in names else column


def resolved(lines: Mapping[str, MappedColumn], names: Collection[str]) -> dict[str, MappedColumn]:
    """Return lines with the columns' names in the file, units included."""

    def whole(line: MappedColumn) -> MappedColumn:
        update = {key: whole_name(name, names) for key in ("column", "minus", "w") if (name := getattr(line, key))}
        return line.model_copy(update=update)

    return {target: whole(line) for target, line in lines.items()}


def with_lookups(
    raw: RawTable, mapping: LabMapping, path: Path, border: Border, beside: Mapping[str, Path]
) -> tuple[RawTable, LabMapping]:
    """Return the run table with looked-up columns and filled cells, and the mapping's lines.

    `path`: of the run table; `beside`: see `files_of_sheets`. Raises BadFileError where a sheet, column or label is
    missing.
    """
    lines, columns = dict(mapping.table.columns), dict(raw.columns)
    lines |= resolved({target: line for target, line in lines.items() if not line.sheet}, raw.columns)
    wanted = {line.sheet: beside.get(line.sheet, path) for line in lines.values() if line.sheet}
    sheets = {name: read_table(file, str(file), None, Layout(sheet=name, lab=True)) for name, file in wanted.items()}
    for target, line in lines.items():
        if line.sheet:
            sheet = sheets[line.sheet]
            column = whole_name(line.column, sheet.columns)
            line = line.model_copy(update={"column": column})
            name = column if column not in columns else f"{line.sheet}: {column}"
            shown_sheet, where = f"{wanted[line.sheet]}, sheet {line.sheet!r}", f"{mapping.shown}, {target}"
            columns[name] = _looked_up(raw, sheet, line, shown_sheet, where)
            plain = {"column": name, "sheet": "", "by": "", "unit": line.unit_for(target)}
            lines[target] = line.model_copy(update=plain)
        elif line.fill_down and line.column in columns:
            columns[line.column] = object_array(list(accumulate([None, *columns[line.column]], _cell_above))[1:])
    session = lines["session"].column if "session" in lines else "session"
    if session in columns:
        _note_empty_sessions(columns[session], raw, str(path), border)
    return replace(raw, columns=columns), replace(mapping, table=mapping.table.model_copy(update={"columns": lines}))


def files_of_sheets(mapping: LabMapping, path: Path, files: Sequence[Path], hashes: dict[str, str]) -> dict[str, Path]:
    """Return the files that sheets name where `path` is no workbook; add their hashes."""
    by_sheet: dict[str, Path] = {}
    for target, line in mapping.table.columns.items():
        if line.sheet and path.suffix.lower() != ingest.WORKBOOK:
            named = [file for file in files if line.sheet in {file.name, file.stem}]
            if len(named) != 1:
                expected = f"the name of one further source, as {path.name} has no sheets"
                raise bad_line(mapping.shown, "table", f"{target}.sheet", line.sheet, expected)
            by_sheet[line.sheet] = named[0]
            hashes[str(named[0])] = sha256_file(named[0])
    return by_sheet


def _looked_up(raw: RawTable, sheet: RawTable, line: MappedColumn, shown: str, where: str) -> npt.NDArray[Any]:
    def refused(column: str, actual: str, expected: str) -> BadFileError:
        return BadFileError(shown, actual, expected, f"correct {where}, or complete the sheet", column=column)

    by = whole_name(line.by, raw.columns)
    if by not in raw.columns:
        raise refused(line.by, f"only {', '.join(raw.columns)[:200]} in the run table", "the column that `by` names")
    alike = [name for name in sheet.columns if without_unit(name) == without_unit(by)]
    key = whole_name(line.key, sheet.columns) if line.key else [*alike, *sheet.columns][0]
    for name in (key, line.column):
        if name not in sheet.columns:
            raise refused(name, f"only {', '.join(sheet.columns)[:200]}", "the column that the mapping names")
    labels = [_label(cell) for cell in raw.columns[by]]
    values = dict(zip(map(_label, sheet.columns[key]), sheet.columns[line.column], strict=True))
    for label, row in zip(labels, raw.line, strict=True):
        if label and label not in values:
            known = ", ".join(str(cell).strip() for cell in sheet.columns[key][:_LISTED])
            raise refused(key, f"no label {label!r:.40}, which row {int(row)} of the run table has", f"one of {known}")
    return object_array([values.get(label) if label else None for label in labels])


def _label(cell: Any) -> str:
    if isinstance(cell, float) and cell.is_integer():
        return str(int(cell))
    return "" if cell is None else " ".join(str(cell).split()).lower()


def _cell_above(above: Any, cell: Any) -> Any:
    return cell if is_filled(cell) else above


def _note_empty_sessions(cells: npt.NDArray[Any], raw: RawTable, shown: str, border: Border) -> None:
    rows = [str(int(row)) for cell, row in zip(cells, raw.line, strict=True) if not is_filled(cell)]
    if 0 < len(rows) < len(cells):
        text = f"""{len(rows)} of {len(cells)} rows name no session; they count as one of their own: name it, or write
            session = {{column = "...", fill_down = true}} where an empty cell means the one above"""
        listed = ", ".join(rows[:_LISTED]) + (" ..." if len(rows) > _LISTED else "")
        border.say(f"{shown}, rows {listed}", text, "no_session", level="suspicious")


def names_runs(raw: RawTable, mapping: LabMapping) -> bool:
    """Return whether a table names runs, or has all columns of the mapping."""
    lines = mapping.table.columns
    line, sources = lines.get("run_id"), {source for each in lines.values() for source in each.sources}
    own = any(recognise(name, TABLE_COLUMNS).name == "run_id" for name in raw.columns)
    return own or (line is not None and line.column in raw.columns) or (bool(sources) and sources <= {*raw.columns})


Rows = dict[tuple[str, ...], tuple[str, int]]


def mapped_runs(
    raw: RawTable, mapping: LabMapping, settings: Campaign, shown: str, border: Border, known: Rows | None = None
) -> RunTable:
    """Return the run table of a laboratory's; see `run_table`. `known`: rows of tables before, which grow.

    Raises BadFileError where a column or text of the mapping is missing, or the table cannot be used.
    """
    lines = resolved(mapping.table.columns, raw.columns)
    raw = _without_repeats(_without_end(raw, lines, shown, border), shown, border, {} if known is None else known)
    factors: dict[str, float] = {}
    columns: dict[str, npt.NDArray[Any]] = {}
    for name, line in lines.items():
        if line.column:
            if text := line.on_unit(name):
                border.say(f"{shown}, column {line.column}", text, "unit")
            columns[line.target(name)] = _cells(raw, name, line, mapping, shown)
            factor = line.scale(name)
            if name.startswith("counts_"):
                if COUNT_UNITS[line.wheel_unit][0] not in {"counts", "angle", "length"}:
                    expected = "counts, a length, turns, rad or deg of a run"
                    raise bad_line(mapping.shown, "table", f"{name}.unit", line.wheel_unit, expected)
                factor *= counts_per_unit(name, line.wheel_unit, settings)
            factors[recognise(line.target(name), TABLE_COLUMNS).name] = factor
    used = {name for line in lines.values() for name in line.sources}
    for name, cells in raw.columns.items():
        if name not in used and recognise(name, TABLE_COLUMNS).name not in lines:
            columns.setdefault(name, cells)
    for name, line in lines.items():
        if line.value is not None and name not in columns:
            columns[name] = _constant(name, line, len(raw.line), mapping)
    runs = run_table(RawTable(columns, raw.line, raw.notes), shown, border)
    scaled = {name: converted(column, factors.get(name, 1.0)) for name, column in runs.numbers.items()}
    return replace(runs, numbers=scaled)


def _without_end(raw: RawTable, lines: Mapping[str, MappedColumn], shown: str, border: Border) -> RawTable:
    names = raw.columns.get(lines["run_id"].column if "run_id" in lines else "run_id", ())
    end = max((at for at, cell in enumerate(names, start=1) if is_filled(cell)), default=len(raw.line))
    for row in raw.line[end:]:
        border.say(f"{shown}, row {int(row)}", "names no run, at the end of the table; omitted", "remark")
    return raw.select(slice(0, end))


def _cells(raw: RawTable, name: str, line: MappedColumn, mapping: LabMapping, shown: str) -> npt.NDArray[Any]:
    for column in (column for column in line.sources if column not in raw.columns):
        actual, remedy = f"only {', '.join(raw.columns)[:200]}", f"correct table.{name} in {mapping.shown}"
        row = max(1, int(raw.line[0]) - 1) if len(raw.line) else 1
        raise BadFileError(shown, actual, "the column that the mapping names", remedy, row=row, column=column)
    if line.minus or line.offset:
        comma = comma_evidence(list(raw.columns.values()))
        end, *start = (numbers(raw.columns[column], shown, column, raw.line, comma)[0] for column in line.sources)
        return end - sum(start) + line.offset / line.factor
    cells = raw.columns[line.column]
    if not line.values:
        return cells
    meanings = {_label(label): str(meaning) for label, meaning in line.values.items()}
    texts: list[str | None] = []
    for cell, row in zip(cells, raw.line, strict=True):
        text = _label(cell)
        if text and text not in meanings and str(cell).strip() not in meanings.values():
            expected = f"a line for {str(cell).strip()!r:.40} too, found in {shown}, row {int(row)}"
            raise bad_line(mapping.shown, "table", f"{name}.values", list(line.values), expected)
        texts.append(meanings.get(text, str(cell).strip()) if text else None)
    return object_array(texts)


def _constant(name: str, line: MappedColumn, n_runs: int, mapping: LabMapping) -> npt.NDArray[Any]:
    value = str(line.value).lower() if isinstance(line.value, bool) else line.value
    if name == "run_id" and isinstance(value, str) and "{n" in value:
        return object_array([ingest.with_number(value, number) for number in range(1, n_runs + 1)])
    values = value if isinstance(value, list) else [value] * n_runs
    if len(values) != n_runs:
        raise bad_line(mapping.shown, "table", name, f"{len(values)} values", f"one value for each of {n_runs} runs")
    return object_array(values)


def _without_repeats(raw: RawTable, shown: str, border: Border, known: Rows) -> RawTable:
    keep = np.ones(len(raw.line), dtype=np.bool_)
    for index, (line, *row) in enumerate(zip(raw.line.tolist(), *raw.columns.values(), strict=True)):
        place = known.setdefault(tuple("" if cell is None else str(cell).strip() for cell in row), (shown, line))
        if place != (shown, line):
            keep[index] = False
            earlier = f"{place[1]} of {place[0]}".removesuffix(f" of {shown}")
            border.say(f"{shown}, row {line}", f"repeats row {earlier} in every cell and was dropped", "repeated_row")
    return raw.select(keep)


def match_logs(
    runs: RunTable, files: Sequence[Path], log: LogSection, shown: str, border: Border, table: RawTable | None
) -> tuple[dict[int, dict[str, Path]], dict[int, str]]:
    """Return each run's files by ``log.files``, a single one under an empty name; and missing logs' names.

    Raises BadFileError where no run finds its log, or two; see `mapped_runs`.
    """

    def unmatched(index: int, actual: str) -> BadFileError:
        remedy = "name the file or its folder, or correct log.file of the mapping"
        return BadFileError(shown, actual, "one log for the run", remedy, row=int(runs.line[index]), column="log")

    named = runs.labels.get("log")
    matched: dict[int, dict[str, Path]] = {}
    missing: dict[int, str] = {}
    patterns: dict[str, str | None] = {**log.files} or {"": log.file or log.run_sheet}
    moments: dict[int, tuple[str, ...]] = {}
    if table is not None and log.by_moment:
        moments = dict(zip(table.line.tolist(), map(moment_of, zip(*table.columns.values(), strict=True)), strict=True))
    if log.columns and not files:
        border.say(shown, 'no log for [log]: name the files, or sheet = "Run {n}"', "no_logs", level="suspicious")
    for index, run_id in enumerate(map(str, runs.run_id)):
        by_tag: dict[str, Path] = {}
        moment = moments.get(int(runs.line[index]))
        for tag, pattern in patterns.items():
            wanted = (ingest.expected_name(log, run_id, pattern) or "") if named is None else str(named[index])
            if not wanted and named is not None:
                continue
            names = [wanted] if named is None else [wanted, f"{wanted}.*"]
            fitting = [
                path
                for path in files
                if (any(ingest.fits_name(path.name, name) for name in names) if wanted else path.stem == run_id)
                and (moment is None or ingest.names_moment(path.name, moment))
            ]
            if len(fitting) > 1 and "/" in wanted:
                fitting = [path for path in fitting if ingest.in_its_folder(path, wanted)]
            if len(fitting) > 1:
                raise unmatched(index, f"{len(fitting)} source files named {wanted or run_id!r}")
            if fitting:
                by_tag[tag] = fitting[0]
            elif wanted or files:
                missing.setdefault(index, wanted or f"{run_id}.*")
        if by_tag and index not in missing:
            matched[index] = by_tag
    if files and missing and not matched:
        index, name = next(iter(missing.items()))
        raise unmatched(index, f"no source file named {name!r}, nor any of the other runs'")
    _note_unused({path for by_tag in matched.values() for path in by_tag.values()}, files, log, border)
    unread = _unread(files) if missing else {}
    return matched, {index: name + unread.get(Path(name).stem, "") for index, name in missing.items()}


def _unread(files: Sequence[Path]) -> dict[str, str]:
    beside = [path for folder in {one.parent for one in files} if folder.is_dir() for path in folder.iterdir()]
    read = ", ".join(READERS)
    other = [path for path in beside if path.is_file() and path.suffix.lower() not in READERS]
    return {path.stem: f" ({path.name} is not read; {read} are)" for path in other}


def sheet_of(path: Path) -> tuple[Path, str | None]:
    """Return a log's file, and its sheet in a workbook: ``book.xlsx/Run 1``."""
    book = path.parent
    return (book, path.name) if book.suffix.lower() == ingest.WORKBOOK and book.is_file() else (path, None)


def _note_unused(used: set[Path], files: Sequence[Path], log: LogSection, border: Border) -> None:
    unused = [path for path in files if path not in used]
    digests = {sha256_file(path): path.name for path in used if path.is_file()} if unused else {}
    for path in unused:
        twin = digests.get(sha256_file(path)) if path.is_file() else None
        text, code = "belongs to no run of the table", "unused_source"
        if twin is not None:
            text, code = f"holds the same bytes as {twin}", "repeated_log"
        from_0 = log.file is not None and ingest.run_in(path.name, log.file) == "0"
        text += " and was omitted" + "; where logs count from 0, write {n-1} in log.file" * from_0
        border.say(str(path), text, code, level="suspicious" if from_0 else "info")


def files_of_runs(files: Sequence[Path], log: LogSection) -> dict[str, dict[str, Path]]:
    """Return runs by the patterns of ``log.files``, in order, with their files.

    Raises BadFileError where a run would have two files of one name.
    """
    by_run: dict[str, dict[str, Path]] = {}
    for tag, pattern in log.files.items():
        for path in (path for path in files if ingest.in_its_folder(path, pattern)):
            of_run = by_run.setdefault(ingest.run_in(ingest.with_folder(path, pattern), pattern) or "", {})
            if tag in of_run:
                remedy = f"write {{n}} or {{run_id}} in log.files.{tag} where names or folders of runs differ"
                raise BadFileError(path, f"a second file for {tag} beside {of_run[tag]}", "one for each run", remedy)
            of_run[tag] = path
    return dict(sorted(by_run.items(), key=lambda run: (ingest.run_number(run[0], None) or 0, run[0])))
