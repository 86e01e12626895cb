"""The run table of a laboratory under calib's names: columns renamed, texts translated, repeated rows dropped."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from calib.campaign.columns import converted, recognise
from calib.campaign.faults import Border
from calib.campaign.ingest.mapping import TABLE_COLUMNS, Line, MappingFile, bad_line
from calib.campaign.model import RunTable
from calib.campaign.readers import RawTable
from calib.campaign.readers.table import objects
from calib.campaign.runs_file import run_table
from calib.errors import BadFileError


def names_runs(raw: RawTable, mapping: MappingFile) -> bool:
    """Return whether a table names runs, by the mapping or by calib's own name."""
    if any(line.name == "run_id" and line.column in raw.columns for line in mapping.table):
        return True
    return any(recognise(name, TABLE_COLUMNS).name == "run_id" for name in raw.columns)


def mapped_runs(raw: RawTable, mapping: MappingFile, shown: str, border: Border) -> RunTable:
    """Return the run table that a laboratory's table and a mapping give.

    `mapping`: its lines for the table. Raises BadFileError where the mapping names a column or a text that is not
    there, or the table cannot be used.
    """
    raw = without_repeats(raw, shown, border)
    factors: dict[str, float] = {}
    columns: dict[str, npt.NDArray[Any]] = {}
    for line in mapping.table:
        if line.column:
            columns[line.target] = _cells(raw, line, mapping, shown)
            if line.factor != 1.0:
                factors[recognise(line.target, TABLE_COLUMNS).name] = line.factor
    given = {line.column for line in mapping.table if line.column}
    names = {line.name for line in mapping.table}
    for name, cells in raw.columns.items():
        # a column that the mapping has given is not taken a second time under its own name
        if name not in given and recognise(name, TABLE_COLUMNS).name not in names:
            columns.setdefault(name, cells)
    for line in mapping.table:
        if line.value is not None and line.name not in columns:
            columns[line.name] = _given(line, len(raw.line), mapping)
    runs = run_table(RawTable(columns, raw.line, raw.notes), shown, border)
    return replace(runs, numbers=_scaled(runs.numbers, factors))


def _cells(raw: RawTable, line: Line, mapping: MappingFile, shown: str) -> npt.NDArray[Any]:
    if line.column not in raw.columns:
        raise BadFileError(
            shown,
            row=1 if not len(raw.line) else max(1, int(raw.line[0]) - 1),
            column=line.column,
            found=f"only {', '.join(raw.columns)[:200]}",
            expected="the column that the mapping names",
            remedy=f"correct table.{line.name} in {mapping.shown}",
        )
    cells = raw.columns[line.column]
    if not line.values:
        return cells
    meant = {found.strip().lower(): text for found, text in line.values.items()}
    texts: list[str | None] = []
    for index, cell in enumerate(cells):
        text = "" if cell is None else _text(cell)
        if text.lower() not in meant and text and text not in line.values.values():
            raise bad_line(
                mapping.shown,
                "table",
                f"{line.name}.values",
                list(line.values),
                f"a line for {text!r:.40} too, which stands in {shown}, row {int(raw.line[index])}",
            )
        texts.append(meant.get(text.lower(), text) or None)
    return objects(texts)


def _given(line: Line, n_runs: int, mapping: MappingFile) -> npt.NDArray[Any]:
    """Return a column of one value for all runs, or of one value a run."""
    values = line.value if isinstance(line.value, tuple) else (line.value,) * n_runs
    if len(values) != n_runs:
        raise bad_line(
            mapping.shown, "table", line.name, f"{len(values)} values", f"one value for each of {n_runs} runs"
        )
    return objects(values)


def _text(cell: Any) -> str:
    if isinstance(cell, float) and cell.is_integer():
        return str(int(cell))
    return str(cell).strip()


def _scaled(numbers: Mapping[str, Any], factors: Mapping[str, float]) -> dict[str, Any]:
    return {name: converted(column, factors.get(name, 1.0)) for name, column in numbers.items()}


def without_repeats(raw: RawTable, shown: str, border: Border) -> RawTable:
    """Return the table without rows that repeat an earlier one cell by cell, and without rows that are empty.

    `border`: takes a note on each row dropped.
    """
    first: dict[tuple[str, ...], int] = {}
    keep = np.ones(len(raw.line), dtype=np.bool_)
    for index, row in enumerate(zip(*raw.columns.values(), strict=True)):
        key = tuple("" if cell is None else str(cell).strip() for cell in row)
        if key in first:
            keep[index] = False
            text = f"repeats row {first[key]} in every cell and was dropped"
            border.say(f"{shown}, row {int(raw.line[index])}", text, "repeated_row")
        first.setdefault(key, int(raw.line[index]))
    if keep.all():
        return raw
    return replace(raw, columns={name: cells[keep] for name, cells in raw.columns.items()}, line=raw.line[keep])
