"""The options that commands share, and lists of numbers as users write them."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer

from calib.errors import BadInputError

JsonTarget = Annotated[
    str | None, typer.Option("--json", metavar="FILE", help="Write the result as JSON to FILE; '-' is standard output.")
]
MappingOption = Annotated[
    Path | None,
    typer.Option("--mapping", metavar="FILE", help="TOML that maps a recording or table, read as if ingested."),
]
CampaignOrRecording = Annotated[
    Path, typer.Argument(metavar="CAMPAIGN", help="Folder with campaign.toml and runs.csv, or a recording.")
]
Figures = Annotated[
    Path | None, typer.Option("--figures", metavar="FOLDER", help="Write the figures there as PNG, SVG and PDF.")
]
Date = Annotated[
    str | None,
    typer.Option("--date", metavar="YYYY-MM-DD", help="Date of issue; without it: today. Fixes the bytes of the PDF."),
]
Force = Annotated[bool, typer.Option("--force", help="Replace existing output files.")]
AcceptImplausible = Annotated[
    str,
    typer.Option(
        "--accept-implausible",
        metavar="REASON",
        help="Pass on a law that is beyond the bounds of its vehicle; the reason is written into the file.",
    ),
]
Seed = Annotated[int, typer.Option("--seed", metavar="N", help="Seed of everything that is drawn.")]


def numbers(text: str, count: int | None, name: str) -> tuple[float, ...]:
    """Return the numbers of a text such as ``300,1100``.

    `count`: how many are expected; None: one or more. Raises BadInputError where the text holds something else.
    """
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if not values or (count is not None and len(values) != count) or not all(map(math.isfinite, values)):
        wanted = f"{count} numbers" if count else "numbers"
        raise BadInputError(f"{name}: found {text!r:.60}; expected {wanted} separated by commas; write them as 1.5,2")
    return values


def pairs(texts: Iterable[str] | None, name: str) -> list[tuple[float, float]]:
    """Return the pairs of numbers of texts such as ``300,1100``; `name` is the option, for the message."""
    return [(left, right) for left, right in (numbers(text, 2, name) for text in texts or ())]


def nearest(word: str, known: Iterable[str]) -> str:
    """Return ``; did you mean 'x'?`` for the known words that are near, else an empty text."""
    near = difflib.get_close_matches(word, list(known), n=3, cutoff=0.5)
    return f"; did you mean {' or '.join(repr(name) for name in near)}?" if near else ""
