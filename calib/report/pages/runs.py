"""The runs: figure by series, and every run in a table."""

from __future__ import annotations

from functools import partial
from typing import Final

import numpy as np

from calib.report.blocks import Block, Column, Picture, Section, Table, Text
from calib.report.figures import radius as figures
from calib.report.numbers import fixed, left, plural
from calib.report.source import Source

__all__ = ["section"]

#: beyond this many runs the table is one of sessions
MOST_ROWS: Final = 200


def section(source: Source) -> Section:
    """Return the runs used, and those left out with the reason."""
    fit, radii = source.fit, source.fit.radii
    blocks: list[Block] = [
        Text(f"{plural(len(radii), 'run')} in {plural(len(set(radii.session.tolist())), 'session')} entered the fit."),
        Picture(
            "runs-by-series",
            "Effective radius of each run in the order driven; colours are sessions. Bars, where larger than the mark, "
            "are two standard uncertainties of the instruments.",
            _alt(source),
            partial(figures.runs_by_series, radii),
        ),
        _table_of_runs(source) if len(radii) <= MOST_ROWS else _table_of_sessions(source),
    ]
    if radii.left_out:
        blocks.append(
            Table(
                "Runs that were not used.",
                (left("Reason", wide=True), Column("Number"), left("Runs", wide=True)),
                tuple(_left_out(source)),
                dense=True,
            )
        )
    else:
        blocks.append(Text("No run was left out.", small=True))
    if fit.static:
        blocks.append(_static(source))
    return Section("Runs", tuple(blocks))


def _left_out(source: Source) -> list[tuple[str, str, str]]:
    """Return one row a reason, since a campaign of many routes leaves dozens of runs out for the same."""
    by_reason: dict[str, list[str]] = {}
    for run in source.fit.radii.left_out:
        by_reason.setdefault(run.reason, []).append(run.run_id)
    rows = []
    for reason, names in list(by_reason.items())[:MOST_ROWS]:
        shown = ", ".join(names[:MOST_ROWS]) + (f" and {len(names) - MOST_ROWS} more" if len(names) > MOST_ROWS else "")
        rows.append((reason, str(len(names)), shown))
    return rows


def _alt(source: Source) -> str:
    parts = []
    for name, wheel in source.fit.wheels.items():
        low, high = 1e3 * float(wheel.radius_m.min()), 1e3 * float(wheel.radius_m.max())
        parts.append(f"{name} wheel {low:.3f} to {high:.3f} mm")
    return f"Radius by run for both wheels, {len(source.fit.radii)} runs: " + "; ".join(parts)


def _table_of_runs(source: Source) -> Table:
    radii = source.fit.radii
    columns = (
        left("Run"),
        left("Session"),
        left("Dir."),
        Column("Distance", "m"),
        *(
            Column(wheel, unit, group=group)
            for group, unit in (("Load", "N"), ("Radius", "mm"), ("Path", "ppm"), ("Residual", "µm"))
            for wheel in ("left", "right")
        ),
    )
    rows = tuple(
        (
            str(radii.run_id[k]),
            str(radii.session[k]),
            str(radii.direction[k]),
            fixed(float(radii.distance_m[k]), 4),
            fixed(float(radii.load_left_N[k]), 1),
            fixed(float(radii.load_right_N[k]), 1),
            fixed(1e3 * float(radii.radius_left_m[k]), 4),
            fixed(1e3 * float(radii.radius_right_m[k]), 4),
            fixed(1e6 * float(radii.path_left[k]), 0),
            fixed(1e6 * float(radii.path_right[k]), 0),
            fixed(1e6 * float(source.fit.left.residual_m[k]), 1),
            fixed(1e6 * float(source.fit.right.residual_m[k]), 1),
        )
        for k in range(len(radii))
    )
    return Table(
        "Runs: distance by the rangefinder, wheel loads, effective radii with the path correction contained in them, "
        "and residuals from the law.",
        columns,
        rows,
        dense=True,
    )


def _table_of_sessions(source: Source) -> Table:
    radii = source.fit.radii
    columns = (
        left("Session"),
        Column("Runs"),
        *(Column(wheel, "N", align="center", group="Loads") for wheel in ("left", "right")),
        *(Column(wheel, "µm", group=group) for group in ("Mean residual", "Scatter") for wheel in ("left", "right")),
    )
    rows = []
    for name in dict.fromkeys(radii.session.tolist()):
        on = radii.session == name
        pieces = [source.fit.left.residual_m[on], source.fit.right.residual_m[on]]
        scatter = [float(np.std(part, ddof=1)) if len(part) > 1 else float("nan") for part in pieces]
        rows.append(
            (
                str(name),
                str(int(on.sum())),
                *(f"{part[on].min():.0f}–{part[on].max():.0f}" for part in (radii.load_left_N, radii.load_right_N)),
                *(fixed(1e6 * float(part.mean()), 1) for part in pieces),
                *(fixed(1e6 * part, 1) for part in scatter),
            )
        )
    shown = rows[:MOST_ROWS]
    return Table(
        f"Sessions of the {len(radii)} runs"
        + ("" if len(shown) == len(rows) else f", the first {len(shown)} of {len(rows)}")
        + "; every single run stands in runs.csv of the result folder.",
        columns,
        tuple(shown),
        dense=True,
    )


def _static(source: Source) -> Table:
    from calib.report.law_text import law_columns, law_row

    return Table(
        "Static radius against load, the same regression on the standing wheel; for comparison only.",
        (Column("Wheel", align="left"), *law_columns()),
        tuple((name, *law_row(wheel)) for name, wheel in source.fit.static.items()),
    )
