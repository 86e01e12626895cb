"""What the catalogue of effects says: a line for each, and of one all that is known of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from calib.gap.data.channels import Channel
from calib.gap.effects.catalogue import LIBRARY, Entry
from calib.gap.effects.effect import Parameter
from calib.report.blocks import Block, Column, Facts, Heading, Items, Table, Text
from calib.report.numbers import MISSING, left, plural, three_digits

#: below this (m or rad) a channel counts as still: no instrument sees a micrometre
STILL: Final = 1e-6
#: unit as effects give it -> (factor, unit) from the largest to the smallest, as people read it
_READ: Final = {
    "m": ((1.0, "m"), (1e3, "mm"), (1e6, "µm")),
    "rad": ((1.0, "rad"), (1e3, "mrad"), (1e6, "µrad")),
    "1": ((1e2, "%"), (1e6, "ppm")),
}


def size_text(value: float, unit: str) -> str:
    """Return a size with a unit that people read: ``1e-6`` of ``m/N`` as ``1 µm/N``, ``3e-3`` of ``1`` as ``0.3 %``."""
    above, slash, below = unit.partition(" per " if " per " in unit else "/")
    for factor, name in _READ.get(above, ((1.0, above),)):
        shown = factor * abs(value)
        if shown >= 0.095 or name in {"µm", "µrad", "ppm"}:
            return f"{factor * value:.3g} {name}{slash}{below}"
    return f"{value:.3g} {unit}"


def effects_content(entries: Sequence[Entry], runs: str) -> tuple[Block, ...]:
    """Return the catalogue as a table."""
    rows = tuple((entry.effect.id, entry.effect.title, str(entry.effect.family), _typical(entry)) for entry in entries)
    table = Table(
        f"{plural(len(entries), 'effect')}; typical size of the form that shows most on {runs}.",
        (left("Effect"), left("What it is", wide=True), left("Family"), left("Typical size")),
        rows,
    )
    silent = [entry for entry in entries if entry.signature is None]
    blocks: list[Block] = [table]
    if silent:
        blocks += [
            Text(f"Without a form on {runs}:"),
            Items(tuple(f"{entry.effect.id}: {_silence(entry)}" for entry in silent)),
        ]
    elsewhere = [entry for entry in entries if entry.origin != LIBRARY]
    if elsewhere:
        blocks += [
            Text("Not of the library:"),
            Items(tuple(f"{entry.effect.id}: from {entry.origin}" for entry in elsewhere)),
        ]
    return tuple(blocks)


def effect_content(entry: Entry, runs: str) -> tuple[Block, ...]:
    """Return all that is known of one effect: words, sizes, and its signature by kind of run."""
    effect = entry.effect
    facts = [
        ("From", entry.origin),
        ("Family", f"{effect.family}: {effect.family.words}"),
        ("Needs", effect.needs),
        ("Told from its like by", effect.separates),
        ("Beyond plausible, suspect", effect.implausible),
        ("Shifts", ", ".join(effect.shifts)),
    ]
    blocks: list[Block] = [
        Heading(f"{effect.id}: {effect.title}"),
        Text(_doc(entry)),
        Facts(tuple((name, value) for name, value in facts if value)),
    ]
    if entry.signature is None:
        return (*blocks, Text(f"Without a form on {runs}: {_silence(entry)}."))
    form = entry.signature.form
    rows = tuple(
        (one.name.replace("_", " "), _signed(one), size_text(one.largest, one.unit)) for one in form.parameters
    )
    label = f" ({form.label})" if form.label else ""
    columns = (left("Parameter"), left("Typical size"), left("Largest plausible"))
    return (*blocks, Table(f"Parameters{label}.", columns, rows), *_signature(entry, runs))


def _signature(entry: Entry, runs: str) -> tuple[Block, ...]:
    """Return the change of each channel that moves, by kind of run."""
    moved = [c for c in Channel if any(np.nan_to_num(rms[c]) > STILL for rms in entry.changes.values())]
    if not moved:
        return (Text(f"At its typical size it changes nothing that is measured on {runs}."),)
    columns = (
        left("Kind of run"),
        *(Column(channel.label, "mrad" if channel.unit == "rad" else "mm") for channel in moved),
    )
    rows = tuple(
        (kind, *(MISSING if not np.isfinite(rms[c]) else _milli(float(rms[c])) for c in moved))
        for kind, rms in entry.changes.items()
    )
    caption = f"Signature: root mean square change at the typical size on {runs}."
    return (Table(caption, columns, rows),)


def _milli(value: float) -> str:
    return "0" if value < STILL else three_digits(1e3 * value)


def _signed(parameter: Parameter) -> str:
    return {-1: "- ", 0: "± ", 1: ""}[parameter.sign] + size_text(parameter.typical, parameter.unit)


def _typical(entry: Entry) -> str:
    """Return the typical sizes of the form's parameters, each once."""
    if entry.signature is None:
        return MISSING
    sizes = dict.fromkeys(
        size_text(one.typical, one.unit).replace(f" per {getattr(entry.effect, 'column', '')}", " a unit")
        for one in entry.signature.form.parameters
    )
    return ", ".join(sizes)


def _silence(entry: Entry) -> str:
    if entry.effect.found_before_search:
        return "found by trial, before the search"
    return f"needs {entry.effect.needs}" if entry.effect.needs else "shows on other runs only"


def _doc(entry: Entry) -> str:
    text = (type(entry.effect).__doc__ or "").strip().split("\n\n")[0]
    return " ".join(text.split())
