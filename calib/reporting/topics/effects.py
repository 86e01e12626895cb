"""Effects: the catalogue with what each leaves on runs, and which of them a plan of runs tells apart."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from calib.gap.effects.library import LIBRARY, Entry
from calib.gap.observations.arrays import Channel
from calib.reporting.blocks import Block, Facts, Heading, Text, items, table
from calib.reporting.formatting import MISSING, fixed, plural, prose, three_digits
from calib.reporting.topics.diagnosis import size_text

if TYPE_CHECKING:
    from calib.gap.plan.identifiability import Outlook

#: below this (m or rad) a channel counts as unchanged: no instrument resolves a micrometre
UNCHANGED: Final = 1e-6
_SIGNS: Final = {-1: "- ", 0: "± ", 1: ""}


def effects_content(entries: Sequence[Entry], runs: str) -> tuple[Block, ...]:
    """Return the catalogue as a table."""
    catalogue = table(
        f"{plural(len(entries), 'effect')}; typical size of the form that shows most on {runs}.",
        ("<Effect", "*What it is", "<Family", "<Typical size"),
        [(entry.effect.id, entry.effect.title, str(entry.effect.family), _typical(entry)) for entry in entries],
    )
    silent = items(f"{entry.effect.id}: {_why_no_form(entry)}" for entry in entries if entry.signature is None)
    elsewhere = items(f"{entry.effect.id}: from {entry.origin}" for entry in entries if entry.origin != LIBRARY)
    blocks: list[Block] = [catalogue]
    blocks += [Text(f"Without a form on {runs}:"), *silent] if silent else []
    blocks += [Text("Not from the library:"), *elsewhere] if elsewhere else []
    return tuple(blocks)


def effect_content(entry: Entry, runs: str) -> tuple[Block, ...]:
    """Return one effect in full: description, sizes, and its signature by kind of run."""
    effect = entry.effect
    facts = {
        "From": entry.origin,
        "Family": f"{effect.family}: {effect.family.words}",
        "Needs": effect.needs,
        "Separated from others by": effect.separates,
        "Beyond plausible, suspect": effect.implausible,
        "Shifts": ", ".join(effect.shifts),
    }
    known = Facts(tuple((name, value) for name, value in facts.items() if value))
    doc = (type(effect).__doc__ or "").strip().split("\n\n")[0]
    blocks: list[Block] = [Heading(f"{effect.id}: {effect.title}"), Text(" ".join(doc.split())), known]
    if entry.signature is None:
        return (*blocks, Text(f"Without a form on {runs}: {_why_no_form(entry)}."))
    form = entry.signature.form
    rows = [
        (
            one.name.replace("_", " "),
            _SIGNS[one.sign] + size_text(one.typical, one.unit),
            size_text(one.largest, one.unit),
        )
        for one in form.parameters
    ]
    label = f" ({form.label})" if form.label else ""
    sizes = table(f"Parameters{label}.", ("<Parameter", "<Typical size", "<Largest plausible"), rows)
    return (*blocks, sizes, *_signature(entry, runs))


def _signature(entry: Entry, runs: str) -> tuple[Block, ...]:
    """Return the change of each channel that moves, by kind of run."""
    moved = [c for c in Channel if any(np.nan_to_num(rms[c]) > UNCHANGED for rms in entry.changes.values())]
    if not moved:
        return (Text(f"At its typical size it changes nothing that is measured on {runs}."),)
    heads = ("<Kind of run", *(f"{channel.label} (m{channel.unit})" for channel in moved))
    rows = [
        (kind, *("0" if rms[c] < UNCHANGED else three_digits(1e3 * float(rms[c])) for c in moved))
        for kind, rms in entry.changes.items()
    ]
    return (table(f"Signature: root mean square change at the typical size on {runs}.", heads, rows),)


def _typical(entry: Entry) -> str:
    """Return the typical sizes of the form's parameters, each once."""
    if entry.signature is None:
        return MISSING
    sizes = dict.fromkeys(
        size_text(one.typical, one.unit).replace(f" per {getattr(entry.effect, 'column', '')}", " a unit")
        for one in entry.signature.form.parameters
    )
    return ", ".join(sizes)


def _why_no_form(entry: Entry) -> str:
    if entry.effect.found_before_search:
        return "found by trial, before the search"
    return f"needs {entry.effect.needs}" if entry.effect.needs else "shows on other runs only"


#: effects named in one cell
MAX_NAMED: Final = 4


def outlook_content(name: str, n_runs: int, outlook: Outlook) -> tuple[Block, ...]:
    """Return the detectability of each effect by a plan of runs."""
    document = outlook.to_dict()
    told_apart = set(document["told_apart"])
    rows = []
    for number, effect in enumerate(outlook.effects):
        others = document["confused"].get(effect, [])
        words = ", ".join(others[:MAX_NAMED]) or "not seen at its typical size"
        if len(others) > MAX_NAMED:
            words += f" and {len(others) - MAX_NAMED} more"
        words = "yes" if effect in told_apart else words
        rows.append((effect, fixed(float(outlook.signal[number]), 1), prose(outlook.smallest[effect].sentence), words))
    told = table(
        f"{name}, {n_runs} runs: {len(told_apart)} of {len(outlook.effects) + len(outlook.absent)} effects told apart. "
        "The signal is that at the effect's typical size, in standard deviations.",
        ("<Effect", "Signal", "*Smallest size seen", "*Told apart, or confused with"),
        rows,
    )
    absent = (f"{effect}: {prose(outlook.smallest[effect].sentence)}" for effect in outlook.absent)
    return (told, *items(absent))
