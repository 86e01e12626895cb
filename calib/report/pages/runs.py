"""The runs: figure by series, and every run in a table."""

from __future__ import annotations

from calib.report.blocks import Block, Section, Text
from calib.report.numbers import plural
from calib.report.source import Source
from calib.report.statements.fit_pictures import runs_picture
from calib.report.statements.law import static_table
from calib.report.statements.runs import MOST_ROWS, left_out_table, runs_table, sessions_table


def section(source: Source) -> Section:
    """Return the runs used, and those left out with the reason."""
    fit, radii = source.fit, source.fit.radii
    blocks: list[Block] = [
        Text(f"{plural(len(radii), 'run')} in {plural(len(set(radii.session.tolist())), 'session')} entered the fit."),
        runs_picture(fit),
        runs_table(fit) if len(radii) <= MOST_ROWS else sessions_table(fit),
    ]
    if radii.left_out:
        blocks.append(left_out_table(fit))
    else:
        blocks.append(Text("No run was left out.", small=True))
    if fit.static:
        blocks.append(static_table(fit))
    return Section("Runs", tuple(blocks))
