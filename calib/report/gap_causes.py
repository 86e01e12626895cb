"""The causes that a verdict names, as blocks: ranking, sizes, what cannot be told apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from calib.report.blocks import Block, Column, Items, Table, Text
from calib.report.numbers import MISSING, fixed, left, places, prose

__all__ = ["MOST", "apart_blocks", "cause_blocks", "effect_name", "finite", "percent", "plain_line"]

#: most rows of a table made from a verdict
MOST: Final = 24
#: how the verdict begins what it says of effects that no size would show
NEVER: Final = "never: "


def effect_name(effect: Any) -> str:
    """Return an effect's id as people read it."""
    return str(effect).replace("_", " ").replace(":", " ")


def finite(value: Any) -> float | None:
    """Return a finite number, else None."""
    return float(value) if isinstance(value, (int, float)) and np.isfinite(value) else None


def percent(value: Any) -> str:
    """Return a share in percent."""
    number = finite(value)
    return MISSING if number is None else f"{100 * number:.0f} %"


def plain_line(item: Any) -> str:
    """Return an entry of the verdict as a line, whatever fields it has."""
    if not isinstance(item, Mapping):
        return prose(str(item))
    parts = []
    for key, value in item.items():
        number = finite(value)
        shown = (
            f"{number:.4g}".replace("-", "−") if number is not None and not isinstance(value, bool) else _said(value)
        )
        parts.append(f"{effect_name(key)} {shown}")
    return ", ".join(parts)


def cause_blocks(verdict: Mapping[str, Any]) -> list[Block]:
    """Return the ranking of the named causes, their sizes, and remarks on these."""
    causes = [cause for cause in verdict.get("causes") or () if isinstance(cause, Mapping)]
    if not causes:
        return []
    ranking = Table(
        "Named causes, most probable first; the share is that of the gap above its floor.",
        (left("Cause", wide=True), left("Id"), Column("Probability"), Column("Share")),
        tuple(
            (
                str(cause.get("title") or effect_name(cause.get("effect"))),
                str(cause.get("effect")),
                percent(cause.get("probability")),
                percent(cause.get("share")),
            )
            for cause in causes[:MOST]
        ),
    )
    rows = [
        (str(cause.get("effect")), effect_name(name), str(found.get("unit") or "1"), *_interval(found))
        for cause in causes[:MOST]
        for name, found in (cause.get("parameters") or {}).items()
        if isinstance(found, Mapping)
    ]
    blocks: list[Block] = [ranking]
    if rows:
        blocks.append(
            Table(
                "Sizes of the causes with 95 % intervals.",
                (
                    left("Cause"),
                    left("Parameter"),
                    left("Unit"),
                    Column("Value"),
                    Column("from", group="95 % interval"),
                    Column("to", group="95 % interval"),
                ),
                tuple(rows),
            )
        )
    remarks = tuple(
        f"{effect_name(cause['effect'])}: {prose(str(cause['remark']))}" for cause in causes if cause.get("remark")
    )
    if remarks:
        blocks.append(Items(remarks))
    return blocks


def apart_blocks(verdict: Mapping[str, Any]) -> list[Block]:
    """Return what these runs cannot tell apart, and what they could not have shown."""
    blocks: list[Block] = []
    groups = [[effect_name(effect) for effect in group] for group in verdict.get("indistinguishable") or ()]
    if groups:
        blocks += [
            Text("These runs cannot tell apart, because each would leave the same traces in them:"),
            Items(tuple(" – ".join(group) for group in groups[:MOST])),
        ]
    credible = verdict.get("credible_sets") or ()
    sets = [" + ".join(effect_name(effect) for effect in group) or "none" for group in credible]
    if len(sets) > 1:
        blocks.append(Text(f"With 95 % probability the cause is one of: {'; '.join(sets[:MOST])}."))
    limits = verdict.get("undetectable") or {}
    never: dict[str, list[str]] = {}
    for name, size in limits.items():
        if str(size).startswith(NEVER):
            never.setdefault(str(size).removeprefix(NEVER), []).append(effect_name(name))
    unseen = [(name, size) for name, size in limits.items() if not str(size).startswith(NEVER)]
    if unseen:
        blocks.append(
            Table(
                "What these runs could not have shown: the smallest size that they would reveal.",
                (left("Effect"), left("Smallest size that would show", wide=True)),
                tuple((effect_name(name), plain_line(size)) for name, size in unseen[:MOST]),
            )
        )
    if never:
        blocks += [
            Text("What these runs could not have shown at any size:"),
            Items(tuple(f"{', '.join(names)}: {why}" for why, names in never.items())),
        ]
    return blocks


def _said(value: Any) -> str:
    if isinstance(value, Sequence) and not isinstance(value, str):
        return " to ".join(f"{part:.4g}" if isinstance(part, float) else str(part) for part in value)
    return prose(str(value))


def _interval(found: Mapping[str, Any]) -> tuple[str, str, str]:
    """Return value and interval to the place that two digits of its half width have."""
    value = finite(found.get("value"))
    ends = [finite(end) for end in (*(found.get("ci95") or ()), None, None)][:2]
    if value is None:
        return MISSING, MISSING, MISSING
    half = 0.5 * (ends[1] - ends[0]) if ends[0] is not None and ends[1] is not None else abs(value)
    if 0 < max(abs(value), half) < 1e-3:
        low, high = (MISSING if end is None else _scientific(end) for end in ends)
        return _scientific(value), low, high
    decimals = places(half)
    return fixed(value, decimals), fixed(ends[0], decimals), fixed(ends[1], decimals)


def _scientific(value: float) -> str:
    mantissa, exponent = f"{value:.2e}".split("e")
    raised = str(int(exponent)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return f"{mantissa} × 10{raised}".replace("-", "−")
