"""The source's columns that a mapping names: with or without their unit, looked up on another sheet, filled down."""

from __future__ import annotations

import re
from collections.abc import Iterable
from collections.abc import Mapping as MappingType
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from calib.campaign.ingest.mapping import MappedColumn, Mapping
from calib.campaign.model import Border
from calib.campaign.readers import Layout, RawTable, read_table
from calib.campaign.readers.table import filled_cells, object_array
from calib.errors import BadFileError

_UNIT: Final = re.compile(r"\s*[\[(][^\[\]()]*[\])]\s*$")
#: labels and rows that a message lists
_LISTED: Final = 8


def without_unit(name: str) -> str:
    """Return a column's name without a unit in brackets."""
    return _UNIT.sub("", name).strip()


def resolved(lines: MappingType[str, MappedColumn], names: Iterable[str]) -> dict[str, MappedColumn]:
    """Return lines with the columns' whole names, where a line names one without the unit that the file gives it."""
    short: dict[str, list[str]] = {}
    for name in names:
        short.setdefault(without_unit(name), []).append(name)
    known = {name for group in short.values() for name in group}
    out = {}
    for target, line in lines.items():
        group = short.get(line.column.strip(), [])
        whole = line.column and line.column not in known and len(group) == 1
        out[target] = line.model_copy(update={"column": group[0]}) if whole else line
    return out


def with_lookups(raw: RawTable, mapping: Mapping, path: Path, border: Border) -> tuple[RawTable, Mapping]:
    """Return the run table with columns looked up on other sheets and empty cells filled, and the mapping's lines.

    `path`: the workbook. Raises BadFileError where a sheet, column or label is not there.
    """
    shown = str(path)
    lines = dict(mapping.table.columns)
    lines |= resolved({target: line for target, line in lines.items() if not line.sheet}, raw.columns)
    columns = dict(raw.columns)
    sheets: dict[str, RawTable] = {}
    for target, line in lines.items():
        if line.sheet:
            if line.sheet not in sheets:
                sheets[line.sheet] = read_table(path, shown, None, Layout(sheet=line.sheet, lab=True))
            sheet = sheets[line.sheet]
            whole = resolved({target: line}, sheet.columns)[target]
            name = whole.column if whole.column not in raw.columns else f"{line.sheet}: {whole.column}"
            columns[name] = _looked_up(
                raw, sheet, whole, f"{shown}, sheet {line.sheet!r}", f"{mapping.shown}, {target}"
            )
            lines[target] = whole.model_copy(
                update={"column": name, "sheet": "", "by": "", "unit": whole.unit_for(target)}
            )
        elif line.fill_down and line.column in columns:
            columns[line.column] = _filled_down(columns[line.column])
    session = lines["session"].column if "session" in lines else "session"
    _note_empty("session", columns.get(session), raw, shown, border)
    table = mapping.table.model_copy(update={"columns": lines})
    return replace(raw, columns=columns), replace(mapping, table=table)


def _looked_up(raw: RawTable, sheet: RawTable, line: MappedColumn, shown: str, where: str) -> npt.NDArray[Any]:
    """Return the sheet's cell for each row of the run table, by the text of the column that the line names."""

    def refused(column: str, found: str, expected: str) -> BadFileError:
        return BadFileError(shown, found, expected, f"correct {where}, or complete the sheet", column=column)

    def whole(name: str, table: RawTable) -> str:
        return resolved({"": MappedColumn(column=name)}, table.columns)[""].column

    by = whole(line.by, raw)
    if by not in raw.columns:
        raise refused(line.by, f"only {', '.join(raw.columns)[:200]} in the run table", "the column that `by` names")
    alike = [name for name in sheet.columns if without_unit(name) == without_unit(by)]
    key = whole(line.key or next(iter(alike), next(iter(sheet.columns))), sheet)
    for name in (key, line.column):
        if name not in sheet.columns:
            raise refused(name, f"only {', '.join(sheet.columns)[:200]}", "the column that the mapping names")
    values = {_label(cell): value for cell, value in zip(sheet.columns[key], sheet.columns[line.column], strict=True)}
    out = []
    for cell, row in zip(raw.columns[by], raw.line, strict=True):
        label = _label(cell)
        if label and label not in values:
            known = ", ".join(str(cell).strip() for cell in sheet.columns[key][:_LISTED])
            raise refused(key, f"no label {label!r:.40}, which row {int(row)} of the run table has", f"one of {known}")
        out.append(values.get(label) if label else None)
    return object_array(out)


def _label(cell: Any) -> str:
    if isinstance(cell, float) and cell.is_integer():
        return str(int(cell))
    return "" if cell is None else " ".join(str(cell).split()).lower()


def _filled_down(cells: npt.NDArray[Any]) -> npt.NDArray[Any]:
    out, last = [], None
    for cell in cells:
        last = cell if filled_cells([cell]) else last
        out.append(last)
    return object_array(out)


def _note_empty(target: str, cells: npt.NDArray[Any] | None, raw: RawTable, shown: str, border: Border) -> None:
    """Note the rows that name no session where others do."""
    if cells is None:
        return
    empty = np.asarray([not filled_cells([cell]) for cell in cells], dtype=np.bool_)
    if not empty.any() or empty.all():
        return
    rows = ", ".join(str(int(row)) for row in raw.line[empty][:_LISTED]) + (" ..." if empty.sum() > _LISTED else "")
    text = (
        f"{int(empty.sum())} of {len(empty)} rows name no {target}; they count as one of their own: name it, or write "
        f'{target} = {{column = "...", fill_down = true}} where an empty cell means the one above'
    )
    border.say(f"{shown}, rows {rows}", text, f"no_{target}", level="suspicious")
