"""Notes gathered for people: what is said alike of many files, rows or runs is said once."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import PurePath

from calib.campaign.model import Note

_NUMBER = re.compile(r"(?<![\w.])[+-]?\d+(?:\.\d+)?(?![\w.:-])")


def gathered(notes: Sequence[Note]) -> tuple[Note, ...]:
    """Return notes with those merged that differ in their file, row, run and numbers alone.

    In the order of the first of each kind; numbers that differ are given from the least to the largest.
    """
    groups: dict[tuple[str, str, str, str], list[Note]] = {}
    for note in notes:
        place, column = _place(note.where)
        kind = PurePath(place).suffix
        groups.setdefault((note.level, note.code, kind + column, _NUMBER.sub("#", note.text)), []).append(note)
    return tuple(_merged(group) for group in groups.values())


def _place(where: str) -> tuple[str, str]:
    """Return file and column of a place, without its row."""
    file, _, rest = where.partition(", ")
    column = re.search(r"column .*", rest)
    return file, column[0] if column else "" if rest.startswith("row") else rest


def _merged(group: Sequence[Note]) -> Note:
    first = group[0]
    if len(group) == 1:
        return first
    files = list(dict.fromkeys(_place(note.where)[0] for note in group))
    column = _place(first.where)[1]
    if len(files) > 1:
        where = f"{len(files)} files, {PurePath(files[0]).name} .. {PurePath(files[-1]).name}"
    else:
        rows = [match[1] for note in group if (match := re.search(r"row (\d+)", note.where))]
        where = files[0] + (f", rows {', '.join(rows[:8])}{' ...' if len(rows) > 8 else ''}" if rows else "")
    return Note(first.level, where + (f", {column}" if column else ""), _text(group), first.code)


def _text(group: Sequence[Note]) -> str:
    """Return the text of notes alike, with spans where their numbers differ."""
    found = [_NUMBER.findall(note.text) for note in group]
    spans = iter(zip(*found, strict=True))

    def span(match: re.Match[str]) -> str:
        texts = list(dict.fromkeys(next(spans)))
        if len(texts) == 1:
            return match[0]
        ordered = sorted(texts, key=float)
        return f"{ordered[0]} to {ordered[-1]}"

    return _NUMBER.sub(span, group[0].text)
