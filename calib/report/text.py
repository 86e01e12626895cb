"""Blocks as lines of plain text, for terminals, summaries and mails; each line with a word on how it may look."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

from calib.report.blocks import Block, Equation, Facts, Heading, Items, Notice, Picture, Section, Table, Text
from calib.report.text_table import table_lines

WIDTH: Final = 80
#: widest column of names in a list of facts
_NAME: Final = 26
_SIGNS: Final = str.maketrans({"−": "-", "\u2007": " ", "\u2008": " ", "\u200b": "", "\u00a0": " "})
EQUATIONS: Final = {
    "effective_radius": "r_e = S_O (1 + e) / (2 π n)",
    "law": "r_e(F) = r_0 + s (F - F_0)",
    "law_uncertainty": "u²(r_e) = u²(r_0) + 2 (F - F_0) u(r_0, s) + (F - F_0)² u²(s)",
}


@dataclass(frozen=True, slots=True)
class Line:
    """A line of text and its style: empty, ``heading``, ``caption``, ``dim``, ``good``, ``note``, ``bad``."""

    text: str
    style: str = ""


def plain(text: str) -> str:
    """Return a text with the minus sign and blanks that a terminal's users can copy and search for."""
    return text.translate(_SIGNS)


def to_text(blocks: Iterable[Block | Section], width: int = WIDTH) -> str:
    """Return blocks as plain text of at most `width` columns, with a final newline."""
    return "".join(f"{line.text.rstrip()}\n" for line in text_lines(blocks, width))


def text_lines(blocks: Iterable[Block | Section], width: int = WIDTH) -> list[Line]:
    """Return blocks as lines of at most `width` columns.

    `blocks`: what is said. Pictures are left out; columns of detail, too. `width`: columns; a single word longer than
    that is not broken.
    """
    lines: list[Line] = []
    for block in blocks:
        if isinstance(block, Section):
            inner = [Line(""), Line(plain(block.title), "heading"), *text_lines(block.blocks, width)]
        else:
            inner = _lines(block, width)
        apart = isinstance(block, (Heading, Table, Section))
        if lines and apart and lines[-1].text and inner and inner[0].text:
            lines.append(Line(""))
        lines += inner
    while lines and not lines[0].text:
        lines.pop(0)
    return lines


def _lines(block: Block, width: int) -> list[Line]:
    if isinstance(block, Heading):
        return [Line(plain(block.text), "heading")]
    if isinstance(block, Text):
        return _wrapped(block.text, width, style="dim" if block.small else "")
    if isinstance(block, Facts):
        return _facts(block.rows, width)
    if isinstance(block, Items):
        return [line for item in block.items for line in _wrapped(item, width, lead="- ", rest="  ")]
    if isinstance(block, Equation):
        return [Line(f"    {EQUATIONS[block.name]}")]
    if isinstance(block, Notice):
        words = f"{block.title}: {block.text}" if block.text else f"{block.title}."
        return _wrapped(words, width, style=block.level)
    if isinstance(block, Table):
        caption = [Line(text, "caption") for text in _words(plain(block.caption), width)]
        body = table_lines(block, width, plain)
        ruled = (Line(text, "dim" if set(text.strip()) <= {"─", " "} else "") for text in body)
        return [*caption, *ruled, Line("")]
    assert isinstance(block, Picture)
    return []


def _words(text: str, width: int, lead: str = "", rest: str = "") -> list[str]:
    return textwrap.wrap(
        text, width, initial_indent=lead, subsequent_indent=rest, break_long_words=False, break_on_hyphens=False
    )


def _wrapped(text: str, width: int, *, lead: str = "", rest: str = "", style: str = "") -> list[Line]:
    lines = _words(plain(text), width, lead, rest)
    return [Line(line, style) for line in lines]


def _facts(rows: Sequence[tuple[str, str]], width: int) -> list[Line]:
    room = min(max((len(name) for name, _ in rows), default=0), _NAME)
    lines: list[Line] = []
    for name, value in rows:
        lead = f"  {plain(name):<{room}}  "
        lines += _wrapped(value or " ", width, lead=lead, rest=" " * (room + 4)) or [Line(lead)]
    return lines
