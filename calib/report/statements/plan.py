"""What a plan of runs says: those to drive next, and what a plan could tell apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from calib.gap.plan.outlook import Outlook
from calib.report.blocks import Block, Column, Table, Text, items
from calib.report.numbers import MISSING, fixed, left, prose

#: effects named in one cell
_NAMED: Final = 4


def next_runs_table(runs: Sequence[Mapping[str, Any]]) -> Table | Text:
    """Return the runs to drive next, best first, each with what it tells apart."""
    if not runs:
        return Text("No run of the list would tell apart more than what was driven.")
    columns = (
        left("Run"),
        Column("Payload", "kg"),
        Column("at x, y", "m", detail=True),
        Column("Speed", "m/s"),
        Column("Hall", "°C"),
        Column("Loaded", "min"),
        left("What it tells", wide=True),
    )
    return Table(
        "Runs to drive next, best first; in one session that begins with a repeat of an unladen corridor run.",
        columns,
        tuple(_row(number, run) for number, run in enumerate(runs, start=1)),
    )


def _row(number: int, run: Mapping[str, Any]) -> tuple[str, ...]:
    extra = [f"{run['stops']} stops"] if run.get("stops") else []
    extra += ["read while rolling"] if run.get("read_rolling") else []
    what = " ".join([str(run["kind"]).replace("_", " "), str(run.get("direction", "")), *extra]).strip()

    def shown(key: str) -> str:
        return f"{run[key]:g}".replace("-", "−") if run.get(key) is not None else MISSING

    place = f"{run.get('payload_x_m', 0.0):g}, {run.get('payload_y_m', 0.0):g}" if run.get("payload_kg") else MISSING
    numbers = (shown("payload_kg"), place, shown("speed_mps"), shown("temperature_C"), shown("minutes_under_load"))
    return (f"{number}. {what}", *numbers, prose(str(run["why"])))


def outlook_content(name: str, n_runs: int, outlook: Outlook) -> tuple[Block, ...]:
    """Return what a plan of runs could show, effect by effect."""
    document = outlook.to_dict()
    told_apart = set(document["told_apart"])
    rows = []
    for number, effect in enumerate(outlook.effects):
        others = document["confused"].get(effect, [])
        words = (
            "yes"
            if effect in told_apart
            else ("not seen at its typical size" if not others else ", ".join(others[:_NAMED]))
        )
        if len(others) > _NAMED:
            words += f" and {len(others) - _NAMED} more"
        rows.append((effect, fixed(float(outlook.signal[number]), 1), prose(outlook.smallest[effect].sentence), words))
    table = Table(
        f"{name}, {n_runs} runs: {len(told_apart)} of {len(outlook.effects) + len(outlook.absent)} effects told apart. "
        "The signal is that at the effect's typical size, in standard deviations.",
        (
            left("Effect"),
            Column("Signal"),
            left("Smallest size seen", wide=True),
            left("Told apart, or confused with", wide=True),
        ),
        tuple(rows),
    )
    absent = (f"{effect}: {prose(outlook.smallest[effect].sentence)}" for effect in outlook.absent)
    return (table, *items(absent))
