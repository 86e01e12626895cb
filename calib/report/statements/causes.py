"""The causes that a verdict names: ranking, sizes, what cannot be told apart, what could not have been seen."""

from __future__ import annotations

import math
from typing import Final

from calib.gap.verdict.result import Quantity, Verdict
from calib.report.blocks import Block, Column, Items, Table, Text, items
from calib.report.numbers import MISSING, fixed, left, number_columns, percent, places, prose, text_columns

#: most rows of a table made from a verdict
_MOST: Final = 24
#: sets that hold the cause, named in one sentence; the JSON has them all
_SETS: Final = 8


def effect_name(effect: str) -> str:
    """Return an effect's id as people read it."""
    return effect.replace("_", " ").replace(":", " ")


def cause_blocks(verdict: Verdict) -> list[Block]:
    """Return the ranking of the named causes, their sizes, and remarks on these."""
    if not verdict.causes:
        return []
    named = verdict.causes[:_MOST]
    doubtful = not all(cause.plausible for cause in named)
    ranking = Table(
        "Which: the named causes, most probable first; the share is that of the gap above its floor.",
        (
            left("Cause", wide=True),
            left("Id"),
            *number_columns("Probability", "Share"),
            *number_columns("from", "to", group="95 % interval"),
            *((left("Plausible"),) if doubtful else ()),
        ),
        tuple(
            (
                cause.title + (f" ({cause.form})" if cause.form else ""),
                cause.effect,
                percent(cause.probability),
                percent(cause.share),
                *(percent(end) for end in cause.share_ci95 or (None, None)),
                *(("yes" if cause.plausible else "NO",) if doubtful else ()),
            )
            for cause in named
        ),
    )
    rows = tuple(
        (cause.effect, effect_name(name), quantity.unit, *_interval(quantity))
        for cause in verdict.causes[:_MOST]
        for name, quantity in cause.parameters.items()
    )
    blocks: list[Block] = [ranking]
    if rows:
        columns = (
            *text_columns("Cause", "Parameter", "Unit"),
            Column("Value"),
            *number_columns("from", "to", group="95 % interval"),
        )
        blocks.append(Table("Sizes of the causes with 95 % intervals.", columns, rows))
    remarks = [f"{cause.effect}: {prose(cause.remark)}" for cause in verdict.causes if cause.remark]
    remarks += [
        f"{cause.effect}: these runs leave the form open; {', '.join(cause.forms_open)} would do as well"
        for cause in verdict.causes
        if cause.forms_open
    ]
    return [*blocks, *items(remarks)]


def apart_blocks(verdict: Verdict) -> list[Block]:
    """Return what these runs cannot tell apart, and the sets that hold the cause."""
    blocks: list[Block] = []
    if verdict.groups:
        groups = tuple(", ".join(group.effects) for group in verdict.groups[:_MOST])
        blocks += [
            Text("These runs cannot tell apart, because each would leave the same traces in them:"),
            Items(groups),
        ]
    sets = [" + ".join(names) or "none" for names in verdict.credible_sets]
    if len(sets) > 1:
        more = f"; and {len(sets) - _SETS} more" if len(sets) > _SETS else ""
        blocks.append(Text(f"With 95 % probability the cause is one of: {'; '.join(sets[:_SETS])}{more}."))
    return blocks


def limit_blocks(verdict: Verdict) -> list[Block]:
    """Return what these runs could not have shown, at its typical size or at any."""
    blocks: list[Block] = []
    unseen = [limit for limit in verdict.undetectable if not limit.never]
    if unseen:
        blocks.append(
            Table(
                "What these runs could not have shown at its typical size: the smallest that they would reveal.",
                (left("Effect"), left("Smallest size that would show", wide=True)),
                tuple((limit.effect, prose(limit.smallest)) for limit in unseen[:_MOST]),
            )
        )
    never: dict[str, list[str]] = {}
    for limit in verdict.undetectable:
        if limit.never:
            never.setdefault(limit.smallest, []).append(limit.effect)
    if never:
        blocks += [
            Text("What these runs could not have shown at any size:"),
            Items(tuple(f"{', '.join(names)}: {prose(why)}" for why, names in never.items())),
        ]
    return blocks


def _interval(quantity: Quantity) -> tuple[str, str, str]:
    """Return value and interval to the place that two digits of its half width have."""
    low, high = quantity.ci95
    value = quantity.value
    if not math.isfinite(value):
        return MISSING, MISSING, MISSING
    known = math.isfinite(low) and math.isfinite(high)
    half = 0.5 * (high - low) if known else abs(value)
    if 0 < max(abs(value), half) < 1e-3:
        return _scientific(value), _scientific(low), _scientific(high)
    decimals = places(half)
    return fixed(value, decimals), fixed(low, decimals), fixed(high, decimals)


def _scientific(value: float) -> str:
    if not math.isfinite(value):
        return MISSING
    mantissa, exponent = f"{value:.2e}".split("e")
    raised = str(int(exponent)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return f"{mantissa} × 10{raised}".replace("-", "−")
