"""Where a gap lies: by channel, by what it goes with, in which runs, at which places."""

from __future__ import annotations

from typing import Final

from calib.gap.where.result import PlaceLine, RunLine, Where
from calib.report.axis_names import in_words
from calib.report.blocks import Block, Column, Items, Table, Text
from calib.report.numbers import (
    MISSING,
    fixed,
    left,
    number_columns,
    probability,
    prose,
    readable,
    text_columns,
    three_digits,
)

#: most covariates, runs and places shown; the JSON has them all
_LINES: Final = 12
_RUNS: Final = 5
#: a run of a smaller gap, in floors, does not stand out
_OUT: Final = 4.0


def where_blocks(where: Where) -> list[Block]:
    """Return where the gap lies, as tables and sentences."""
    blocks: list[Block] = []
    if where.channels:
        blocks.append(_channels(where))
    if where.significant:
        blocks.append(_covariates(where))
    blocks += [Text(prose(_place(line))) for line in where.places[:_LINES]]
    runs = [line for line in where.runs if abs(line.z) > _OUT][:_RUNS]
    if runs:
        blocks += [Text("Runs where the gap stands out most:"), Items(tuple(prose(_run(line)) for line in runs))]
    return blocks


def _channels(where: Where) -> Table:
    rows = []
    for gap in where.channels:
        factor, unit = readable(gap.channel.unit, gap.rms)
        cells = (three_digits(factor * value) for value in (gap.rms, gap.floor))
        rows.append((gap.channel.label, unit, *cells, fixed(gap.ratio, 1)))
    return Table(
        "Where: the gap by channel, root mean square, against its floor.",
        (left("Channel"), left("Unit"), Column("Gap"), Column("Floor"), Column("Ratio")),
        tuple(rows),
    )


def _covariates(where: Where) -> Table:
    rows = tuple(
        (
            in_words(line.name),
            line.channel_label,
            f"{line.share:.2f}",
            MISSING if line.ci95 is None else f"{line.ci95[0]:.2f}",
            MISSING if line.ci95 is None else f"{line.ci95[1]:.2f}",
            probability(line.p_value),
        )
        for line in where.significant[:_LINES]
    )
    columns = (
        *text_columns("What it goes with", "Channel"),
        Column("Share"),
        *number_columns("from", "to", group="95 % interval"),
        Column("p"),
    )
    return Table(
        "What the gap goes with: share of its variance beyond the floor, and p corrected for the number of tests (the "
        "chance of any false line is 5 %).",
        columns,
        rows,
    )


def _run(line: RunLine) -> str:
    milli = 1e3 * line.value
    shown = ("+" if milli >= 0 else "−") + three_digits(abs(milli))
    return f"{line.run_id}: {line.channel.label} {shown} m{line.channel.unit}, {abs(line.z):.0f} times its floor"


def _place(line: PlaceLine) -> str:
    size = f"{1e3 * line.size:+.3g} m{line.unit}"
    spread = f"{1e3 * line.ci95[0]:.3g} to {1e3 * line.ci95[1]:.3g}"
    if line.place is None or line.place_ci95 is None:
        return f"It opens at {line.where}: {line.channel.label} {size} {line.what} (95 %: {spread})."
    (low, high), (first, last) = line.place, line.place_ci95
    route = f" on {line.route.replace('_', ' ')}" if line.route else ""
    return (
        f"It opens at a {line.where}{route}: {line.channel.label} {size} (95 %: {spread}) between {low:.2f} m "
        f"({first[0]:.2f} to {first[1]:.2f}) and {high:.2f} m ({last[0]:.2f} to {last[1]:.2f}), {line.coordinate}."
    )
