"""Geometry: parameters, identifiability, residuals by route."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import TYPE_CHECKING, Final

from calib.kinematics.result import Estimate, RouteResidual, Transfer
from calib.reporting.blocks import Block, Column, Table, Text, items
from calib.reporting.formatting import text_column

if TYPE_CHECKING:
    from calib.kinematics.result import Geometry

_HEADER: Final = ("parameter", "nominal", "estimate", "sd", "95 % interval", "change")
_TRANSFER: Final = ("held out", "n", "before", "after")
_ROUTE: Final = (
    "route",
    "n",
    "before mm",
    "mrad",
    "after mm",
    "mrad",
    "mean residual: along mm",
    "across mm",
    "mrad",
)


def geometry_content(geometry: Geometry) -> tuple[Block, ...]:
    """Return the result as blocks."""
    blocks: list[Block] = [Text(_heading(geometry)), *items(verdict_sentences(geometry)), parameter_table(geometry)]
    blocks += items(geometry_sentences(geometry))
    return (*blocks, *route_tables(geometry))


def parameter_table(geometry: Geometry) -> Table:
    """Return the parameters with their intervals."""
    return _table("Parameters, with 95 % intervals.", _HEADER, [_cells(estimate) for estimate in geometry.estimates])


def route_tables(geometry: Geometry) -> tuple[Table, ...]:
    """Return the residuals by route, and those of held-out runs where there are any."""
    routes = [_route_cells(route) for route in geometry.routes]
    tables = [_table("Residuals by route: root mean square of position and heading.", _ROUTE, routes)]
    if geometry.transfer:
        rows = [_transfer_cells(row) for row in geometry.transfer]
        tables.append(_table("End position error of held-out runs, in mm.", _TRANSFER, rows))
    return tuple(tables)


def _table(caption: str, header: tuple[str, ...], rows: list[tuple[str, ...]]) -> Table:
    columns = (text_column(header[0]), *(Column(title) for title in header[1:]))
    return Table(caption, columns, tuple(rows), dense=True)


def _heading(geometry: Geometry) -> str:
    """Return the first line: drive, runs and clusters."""
    stretches = "end poses" if geometry.using == "end_poses" else f"{geometry.n_segments} windows"
    of, n = geometry.clusters
    runs = f"{geometry.n_runs} {'run' if geometry.n_runs == 1 else 'runs'}"
    return f"{geometry.name}: {geometry.drive}, {runs}, {stretches}; intervals from {n} {of}s" + (
        " - SIMULATED DATA" if geometry.simulated else ""
    )


def verdict_sentences(geometry: Geometry) -> list[str]:
    """Return the verdict with the residuals that it rests on, and what speaks against the estimates."""
    verdict = geometry.verdict.value.capitalize()
    if geometry.judgement is None:
        return [f"{verdict}: {text}." for text in geometry.why]
    errors = asdict(geometry.judgement.adequacy)
    parts = [
        f"{what} {before} before, {after} after, {held_out} on held-out runs; noise {noise}"
        for what, prefix, unit in (("position error", "", "m"), ("Heading error", "heading_", "rad"))
        if errors[f"{prefix}before_rms_{unit}"]
        for before, after, held_out, noise in [
            [f"{_milli(errors[f'{prefix}{at}_rms_{unit}'])} m{unit}" for at in ("before", "after", "held_out", "noise")]
        ]
    ]
    return [f"{verdict}: {'. '.join(parts)}.", *(f"{text[0].upper()}{text[1:]}." for text in geometry.why)]


def _milli(value: float) -> str:
    """Return a value in thousandths with three digits, never as a power of ten."""
    return f"{1e3 * value:.3g}" if value < 1.0 else f"{1e3 * value:.0f}"


def geometry_sentences(geometry: Geometry) -> list[str]:
    """Return the sentences beside the table of parameters."""
    lines = []
    if geometry.undetermined:
        lines.append(
            f"Not identifiable from these runs, kept at the nominal value: {', '.join(geometry.undetermined)}."
        )
    if geometry.outliers:
        lines.append(f"Outliers, down-weighted: {', '.join(geometry.outliers)}.")
    if geometry.delays:
        delays = ", ".join(f"{one.label} {one.value_s:.4f} s" for one in geometry.delays)
        lines.append(f"The reference has a delay of its own in each recording, corrected in each: {delays}.")
    umbmark = geometry.umbmark
    if umbmark.applies:
        driven = f"{umbmark.n_cw} clockwise, {umbmark.n_ccw} counter-clockwise squares of {umbmark.side_m:.3g} m"
        lines.append(
            f"UMBmark ({driven}): E_d {umbmark.E_d:.5f}, "
            f"E_b {umbmark.E_b:.5f}, c_L {umbmark.c_left:.5f}, c_R {umbmark.c_right:.5f}."
        )
    return [*lines, *geometry.notes]


def _cells(estimate: Estimate) -> tuple[str, ...]:
    """Return the cells of a parameter's row: the estimate with the digits that its uncertainty allows."""
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
    return min(max(1 - math.floor(math.log10(std)), 0), 12) if std > 0.0 and math.isfinite(std) else 6


def _route_cells(route: RouteResidual) -> tuple[str, ...]:
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


def _transfer_cells(row: Transfer) -> tuple[str, ...]:
    """Return the cells of a held-out group, in mm."""
    return row.left_out, str(row.n), f"{1e3 * row.before_rms_m:.1f}", f"{1e3 * row.after_rms_m:.1f}"


def geometry_brief(geometry: Geometry) -> tuple[Block, ...]:
    """Return what the interpreter shows of a geometry: runs and parameters."""
    return geometry_content(geometry)[:3]
