"""Runs of a fit: figure by session, table of runs or of sessions, runs not used."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np

from calib.campaign.checks.design import listed
from calib.radius.result import Fit
from calib.reporting.blocks import Block, Column, Picture, Section, Table, Text, drawn
from calib.reporting.formatting import fixed, plural, text_column, text_columns
from calib.reporting.topics.law import static_table
from calib.types import FloatArray

if TYPE_CHECKING:
    from calib.reporting.source import Source

#: beyond this many runs the report's table is one of sessions
MOST_ROWS: Final = 200
#: runs named for one reason
MOST_NAMED: Final = 12


def left_out_table(fit: Fit) -> Table:
    """Return one row a reason, since a campaign of many routes has hundreds of runs that are not used.

    A dozen of them are named; the fit's JSON names them all.
    """
    by_reason: dict[str, list[str]] = {}
    for run in fit.radii.left_out:
        by_reason.setdefault(run.reason, []).append(run.run_id)
    rows = []
    for reason, names in list(by_reason.items())[:MOST_ROWS]:
        rows.append((reason, str(len(names)), listed(names, MOST_NAMED)))
    columns = (text_column("Reason", wide=True), Column("Number"), text_column("Runs", wide=True))
    return Table("Runs that were not used.", columns, tuple(rows), dense=True)


def runs_table(fit: Fit) -> Table:
    """Return every run: counts, distance, loads, radii, and residuals from the law."""
    radii = fit.radii
    counts = _counts(fit)
    columns = (
        *text_columns("Run", "Session", "Dir."),
        Column("Distance", "m", detail=True),
        *(Column(wheel, group="Counts", detail=True) for wheel in ("left", "right") if fit.setup is not None),
        *(
            Column(wheel, unit, group=group, detail=group == "Path")
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
            *(f"{count[k]:.0f}" for count in counts),
            fixed(float(radii.load_left_N[k]), 1),
            fixed(float(radii.load_right_N[k]), 1),
            fixed(1e3 * float(radii.radius_left_m[k]), 4),
            fixed(1e3 * float(radii.radius_right_m[k]), 4),
            fixed(1e6 * float(radii.path_left[k]), 0),
            fixed(1e6 * float(radii.path_right[k]), 0),
            fixed(1e6 * float(fit.left.residual_m[k]), 1),
            fixed(1e6 * float(fit.right.residual_m[k]), 1),
        )
        for k in range(len(radii))
    )
    return Table(
        "Runs: distance by the rangefinder, encoder counts, wheel loads, effective radii with the path correction "
        "contained in them, and residuals from the law.",
        columns,
        rows,
        dense=True,
    )


def _counts(fit: Fit) -> list[FloatArray]:
    """Return the counts of either wheel, from the radii: r = S (1 + e) / (2 pi n); none without an encoder."""
    if fit.setup is None:
        return []
    radii, encoder = fit.radii, fit.setup.encoder
    return [
        radii.distance_m * (1 + path) / (2 * np.pi * radius) * per_rev
        for path, radius, per_rev in (
            (radii.path_left, radii.radius_left_m, encoder.counts_per_rev_left),
            (radii.path_right, radii.radius_right_m, encoder.counts_per_rev_right),
        )
    ]


def sessions_table(fit: Fit) -> Table:
    """Return one row a session, for campaigns of many runs."""
    radii = fit.radii
    columns = (
        text_column("Session"),
        Column("Runs"),
        *(Column(wheel, "N", align="center", group="Loads") for wheel in ("left", "right")),
        *(Column(wheel, "µm", group=group) for group in ("Mean residual", "Scatter") for wheel in ("left", "right")),
    )
    rows = []
    for name in dict.fromkeys(radii.session.tolist()):
        on = radii.session == name
        pieces = [fit.left.residual_m[on], fit.right.residual_m[on]]
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
        + "; scatter is one standard deviation (k = 1). Every run is in runs.csv of the result folder.",
        columns,
        tuple(shown),
        dense=True,
    )


def runs_section(source: Source) -> Section:
    """Return the runs used, and those not used with the reason."""
    fit, radii = source.fit, source.fit.radii
    blocks: list[Block] = [
        Text(f"{plural(len(radii), 'run')} in {plural(len(set(radii.session.tolist())), 'session')} entered the fit."),
        runs_picture(fit),
        runs_table(fit) if len(radii) <= MOST_ROWS else sessions_table(fit),
    ]
    if radii.left_out:
        blocks.append(left_out_table(fit))
    else:
        blocks.append(Text("All runs were used.", small=True))
    if fit.static:
        blocks.append(static_table(fit))
    return Section("Runs", tuple(blocks))


def runs_picture(fit: Fit) -> Picture:
    """Return the radius of every run in the order driven."""
    parts = []
    for name, wheel in fit.wheels.items():
        low, high = 1e3 * float(wheel.radius_m.min()), 1e3 * float(wheel.radius_m.max())
        parts.append(f"{name} wheel {low:.3f} to {high:.3f} mm")
    return Picture(
        "runs-by-series",
        "Effective radius of each run in the order driven, coloured by wheel load, or by session where all loads are "
        "alike. Bars, where larger than the mark, are two standard uncertainties of the instruments.",
        f"Radius by run for both wheels, {len(fit.radii)} runs: " + "; ".join(parts),
        partial(drawn, "radius.runs_by_series", fit.radii),
    )
