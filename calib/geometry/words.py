"""Rows and columns of a geometry's result: as cells, as lines of text, as HTML."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Final

from calib.geometry.parts import Estimate, RouteResidual, Transfer

__all__ = [
    "HEADER",
    "ROUTE_HEADER",
    "TRANSFER_HEADER",
    "cells",
    "columns",
    "html_table",
    "route_cells",
    "transfer_cells",
]

HEADER: Final = ("parameter", "nominal", "estimate", "sd", "95 % interval", "change")
TRANSFER_HEADER: Final = ("left out", "n", "before", "after")
ROUTE_HEADER: Final = (
    "route",
    "n",
    "before mm",
    "mrad",
    "after mm",
    "mrad",
    "left on average: along mm",
    "across mm",
    "mrad",
)


def cells(estimate: Estimate) -> tuple[str, ...]:
    """Return the cells of a parameter's row: the estimate with as many digits as its uncertainty bears."""
    digits = _digits(estimate.std)
    low, high = (f"{value:.{digits}f}" for value in estimate.ci95)
    change = f"{100.0 * (estimate.value / estimate.nominal - 1.0):+.2f} %" if estimate.nominal else ""
    return (
        estimate.name,
        f"{estimate.nominal:.6g}",
        f"{estimate.value:.{digits}f}",
        f"{estimate.std:.2g}",
        f"{low} to {high}",
        change,
    )


def _digits(std: float) -> int:
    """Return the decimals that two significant digits of `std` need."""
    from math import floor, isfinite, log10

    return min(max(1 - floor(log10(std)), 0), 12) if std > 0.0 and isfinite(std) else 6


def route_cells(route: RouteResidual) -> tuple[str, ...]:
    """Return the cells of a route's row, in mm and mrad."""

    def position(triple: tuple[float, float, float]) -> str:
        return f"{1e3 * (triple[0] ** 2 + triple[1] ** 2) ** 0.5:.1f}"

    return (
        route.kind or "(none)",
        str(route.n),
        position(route.before_rms),
        f"{1e3 * route.before_rms[2]:.1f}",
        position(route.after_rms),
        f"{1e3 * route.after_rms[2]:.1f}",
        f"{1e3 * route.after_mean[0]:+.1f}",
        f"{1e3 * route.after_mean[1]:+.1f}",
        f"{1e3 * route.after_mean[2]:+.1f}",
    )


def columns(rows: Sequence[tuple[str, ...]]) -> list[str]:
    """Return rows as lines of text, the first column left, the others right."""
    widths = [max(len(row[at]) for row in rows) for at in range(len(rows[0]))]
    lines = []
    for row in rows:
        padded = [cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True)]
        lines.append("  ".join([row[0].ljust(widths[0]), *padded]))
    return lines


def transfer_cells(row: Transfer) -> tuple[str, ...]:
    """Return the cells of what was left out, in mm."""
    return row.left_out, str(row.n), f"{1e3 * row.before_rms_m:.1f}", f"{1e3 * row.after_rms_m:.1f}"


def html_table(rows: Sequence[tuple[str, ...]]) -> str:
    """Return rows, the first one the header, as an HTML table."""
    head = "".join(f"<th>{escape(cell)}</th>" for cell in rows[0])
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows[1:])
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
