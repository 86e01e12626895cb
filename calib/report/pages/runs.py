"""The runs: figure by series, and every run in a table."""

from __future__ import annotations

from functools import partial

from calib.report.blocks import Block, Picture, Section, Text
from calib.report.figures import radius as figures
from calib.report.numbers import plural
from calib.report.source import Source
from calib.report.statements.law import static_table
from calib.report.statements.runs import MOST_ROWS, left_out_table, runs_table, sessions_table

__all__ = ["section"]


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
        runs_table(fit) if len(radii) <= MOST_ROWS else sessions_table(fit),
    ]
    if radii.left_out:
        blocks.append(left_out_table(fit))
    else:
        blocks.append(Text("No run was left out.", small=True))
    if fit.static:
        blocks.append(static_table(fit))
    return Section("Runs", tuple(blocks))


def _alt(source: Source) -> str:
    parts = []
    for name, wheel in source.fit.wheels.items():
        low, high = 1e3 * float(wheel.radius_m.min()), 1e3 * float(wheel.radius_m.max())
        parts.append(f"{name} wheel {low:.3f} to {high:.3f} mm")
    return f"Radius by run for both wheels, {len(source.fit.radii)} runs: " + "; ".join(parts)
