"""Changes of run tables, logs and settings that people make by mistake: of cells, columns, rows and names."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd

Change = Callable[[pd.DataFrame], pd.DataFrame]


@dataclass(frozen=True, slots=True)
class Fault:
    """What is done to a campaign: to its run table, to logs of some runs, to its settings."""

    name: str
    table: Change | None = None
    log: Change | None = None
    #: which runs' logs; all by default
    runs: tuple[int, ...] = ()
    settings: tuple[str, str] | None = None
    #: what the answer is held against, where the fault is another spelling of it: a change of the sound table
    beside: Change | None = None


def cells(column: str, change: Callable[[float], object], rows: slice = slice(None)) -> Change:
    """Return a change of some cells of a column; empty cells stay empty, and a table without the column as it is."""

    def changed(table: pd.DataFrame) -> pd.DataFrame:
        if column not in table:
            return table
        table = table.copy()
        old = table[column].tolist()
        new = [cell if cell == "" else str(change(float(cell))) for cell in old]
        table[column] = [new[n] if n in range(*rows.indices(len(old))) else cell for n, cell in enumerate(old)]
        return table

    return changed


def texts(column: str, change: Callable[[str], str], step: int = 2) -> Change:
    """Return a change of the text of every so many rows."""

    def changed(table: pd.DataFrame) -> pd.DataFrame:
        table = table.copy()
        table[column] = [change(cell) if n % step else cell for n, cell in enumerate(table[column])]
        return table

    return changed


def both(*changes: Change) -> Change:
    """Return changes one after the other."""

    def changed(table: pd.DataFrame) -> pd.DataFrame:
        for change in changes:
            table = change(table)
        return table

    return changed


def renamed(names: dict[str, str]) -> Change:
    """Return a change of column names."""
    return lambda table: table.rename(columns=names)


def weighed(unit: str, per_newton: float) -> Change:
    """Return loads as weighed (other than computed ones), in a unit of a scale."""
    left, right = (
        both(
            cells(f"load_{side}_N", lambda v, f=factor: v * f * per_newton),
            renamed({f"load_{side}_N": f"load_{side}{unit}"}),
        )
        for side, factor in (("left", 1.15), ("right", 0.9))
    )
    return both(left, right)


def summary(of: Callable[[pd.DataFrame], pd.Series], label: str) -> Change:
    """Return a further row that sums up the others."""

    def changed(table: pd.DataFrame) -> pd.DataFrame:
        numbers = table.apply(pd.to_numeric, errors="coerce")
        row = {name: "" if np.isnan(value) else str(value) for name, value in of(numbers).items()}
        row |= {"run_id": label, "kind": table["kind"].iloc[0], "session": table["session"].iloc[0]}
        return pd.concat([table, pd.DataFrame([row])], ignore_index=True).fillna("")

    return changed


def shifted(values: pd.DataFrame, columns: tuple[str, ...], by: float, kind: type = np.float64) -> pd.DataFrame:
    """Return a table with columns moved, in a precision."""
    for name in columns:
        if name in values:
            values = cells(name, lambda v: float(kind(v + by)))(values.astype(str))
    return values


def of_session(column: str, change: Callable[[float], float], number: int = 1) -> Change:
    """Return a change of the cells of one session."""

    def changed(table: pd.DataFrame) -> pd.DataFrame:
        if column not in table:
            return table
        session = list(dict.fromkeys(table["session"]))[number]
        new = [
            str(change(float(cell))) if label == session and cell != "" else cell
            for cell, label in zip(table[column], table["session"], strict=True)
        ]
        return table.assign(**{column: new})

    return changed


def moved(column: str, by: int = 1) -> Change:
    """Return a change that moves a column by so many rows."""
    return lambda table: table.assign(**{column: np.roll(table[column].to_numpy(), by)}) if column in table else table


def exchanged(first: str, second: str, rows: slice = slice(None)) -> Change:
    """Return an exchange of two columns in some rows."""

    def changed(table: pd.DataFrame) -> pd.DataFrame:
        one, other = table[first].to_list(), table[second].to_list()
        one[rows], other[rows] = other[rows], one[rows]
        return table.assign(**{first: one, second: other})

    return changed


def turned(angle_rad: float) -> Change:
    """Return end poses turned about the origin."""

    def changed(table: pd.DataFrame) -> pd.DataFrame:
        x, y, theta = (pd.to_numeric(table[f"ref_{name}"]) for name in ("x_m", "y_m", "theta_rad"))
        cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
        new = {"ref_x_m": cosine * x - sine * y, "ref_y_m": sine * x + cosine * y, "ref_theta_rad": theta + angle_rad}
        return table.assign(**{name: values.map(str) for name, values in new.items()})

    return changed
