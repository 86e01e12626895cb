"""Geometry: parameters, identifiability, residuals by route."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import TYPE_CHECKING, Final

from calib.kinematics.result import Estimate, RouteResidual
from calib.reporting.blocks import Block, Table, Text, items, table
from calib.reporting.formatting import plural

if TYPE_CHECKING:
    from calib.kinematics.result import Geometry

_ROUTE: Final = (
    "<route",
    "n",
    "before | position (mm)",
    "before | heading (mrad)",
    "after | position (mm)",
    "after | heading (mrad)",
    "mean residual | along (mm)",
    "mean residual | across (mm)",
    "mean residual | heading (mrad)",
)


def geometry_content(geometry: Geometry) -> tuple[Block, ...]:
    """Return the result as blocks."""
    blocks: list[Block] = [Text(_heading(geometry)), *items(verdict_sentences(geometry)), parameter_table(geometry)]
    blocks += items(geometry_sentences(geometry))
    return (*blocks, *route_tables(geometry))


def parameter_table(geometry: Geometry) -> Table:
    """Return the parameters with their intervals."""
    heads = ("<parameter", "nominal", "estimate", "sd", "95 % interval", "change")
    return table("Parameters, with 95 % intervals.", heads, map(_cells, geometry.estimates), dense=True)


def route_tables(geometry: Geometry) -> tuple[Table, ...]:
    """Return the residuals by route, and those of held-out runs where there are any."""
    caption = "Residuals by route: root mean square of position and heading."
    tables = [table(caption, _ROUTE, map(_route_cells, geometry.routes), dense=True)]
    if geometry.transfer:
        rows = [
            (row.left_out, str(row.n), f"{1e3 * row.before_rms_m:.1f}", f"{1e3 * row.after_rms_m:.1f}")
            for row in geometry.transfer
        ]
        heads = ("<held out", "n", "before (mm)", "after (mm)")
        tables.append(table("End position error of held-out runs.", heads, rows, dense=True))
    return tuple(tables)


def _heading(geometry: Geometry) -> str:
    """Return the first line: drive, runs and clusters."""
    stretches = "end poses" if geometry.using == "end_poses" else f"{geometry.n_segments} windows"
    of, n = geometry.clusters
    mark = " - SIMULATED DATA" if geometry.simulated else ""
    runs = plural(geometry.n_runs, "run")
    return f"{geometry.name}: {geometry.drive}, {runs}, {stretches}; intervals from {plural(n, of)}{mark}"


def verdict_sentences(geometry: Geometry) -> list[str]:
    """Return the verdict with the residuals that it rests on, and what speaks against the estimates."""
    verdict = geometry.verdict.value.capitalize()
    if geometry.judgement is None:
        return [f"{verdict}: {text}." for text in geometry.why]
    errors = asdict(geometry.judgement.adequacy)
    parts = []
    for what, prefix, unit in (("position error", "", "m"), ("Heading error", "heading_", "rad")):
        sizes = [errors[f"{prefix}{at}_rms_{unit}"] for at in ("before", "after", "held_out", "noise")]
        if sizes[0]:
            before, after, held_out, noise = (f"{_milli(size)} m{unit}" for size in sizes)
            parts.append(f"{what} {before} before, {after} after, {held_out} on held-out runs; noise {noise}")
    return [f"{verdict}: {'. '.join(parts)}.", *(f"{text[0].upper()}{text[1:]}." for text in geometry.why)]


def _milli(value: float) -> str:
    """Return a value in thousandths with three digits, never as a power of ten."""
    return f"{1e3 * value:.3g}" if value < 1.0 else f"{1e3 * value:.0f}"


def geometry_sentences(geometry: Geometry) -> list[str]:
    """Return the sentences beside the table of parameters."""
    lines = []
    if geometry.undetermined:
        kept = ", ".join(geometry.undetermined)
        lines.append(f"Not identifiable from these runs, kept at the nominal value: {kept}.")
    if geometry.outliers:
        lines.append(f"Outliers, down-weighted: {', '.join(geometry.outliers)}.")
    return [*lines, *geometry_remarks(geometry)]


def geometry_remarks(geometry: Geometry) -> list[str]:
    """Return delays, the UMBmark of squares, and notes."""
    lines = []
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
    known = estimate.std > 0.0 and math.isfinite(estimate.std)
    # two significant digits of the standard deviation
    digits = min(max(1 - math.floor(math.log10(estimate.std)), 0), 12) if known else 6
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


def _route_cells(route: RouteResidual) -> tuple[str, ...]:
    """Return the cells of a route's row, in mm and mrad."""
    errors = [
        f"{1e3 * size:.1f}"
        for along, across, heading in (route.before_rms, route.after_rms)
        for size in (math.hypot(along, across), heading)
    ]
    means = (f"{1e3 * mean:+.1f}" for mean in route.after_mean)
    return (route.kind or "(none)", str(route.n), *errors, *means)


def geometry_brief(geometry: Geometry) -> tuple[Block, ...]:
    """Return what the interpreter shows of a geometry: runs and parameters."""
    return geometry_content(geometry)[:3]
