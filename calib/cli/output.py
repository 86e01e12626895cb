"""What every command shares: where JSON goes, tables for people, progress only on a terminal."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import typer

from calib.errors import BadInputError
from calib.files import to_json, write_json

__all__ = ["FORCE", "JSON", "emit_json", "say", "say_wrapped", "table", "wants_stdout"]

JSON = typer.Option(None, "--json", metavar="FILE", help="Write the result as JSON to FILE; '-' is standard output.")
FORCE = typer.Option(False, "--force", help="Replace existing output files.")


def wants_stdout(target: str | None) -> bool:
    """Return whether standard output belongs to the JSON alone."""
    return target == "-"


def emit_json(value: Any, target: str | None, *, force: bool) -> None:
    """Write `value` as JSON where `target` says; nothing where it is None."""
    if target is None:
        return
    if target == "-":
        try:
            text = to_json(value)
        except ValueError as error:
            raise BadInputError(f"the result holds a number that JSON cannot say ({error})") from error
        sys.stdout.write(text)
        sys.stdout.flush()
    else:
        write_json(Path(target), value, force=force)


def say(text: str, *, target: str | None = None) -> None:
    """Print a line for people; to standard error where standard output belongs to JSON."""
    typer.echo(text, err=wants_stdout(target))


def say_wrapped(text: str, *, target: str | None = None, lead: str = "") -> None:
    """Print a sentence over as many lines as it takes, `lead` before the first and the others in line with it."""
    import textwrap
    from shutil import get_terminal_size

    width = min(max(get_terminal_size((120, 24)).columns, 60), 120)
    say(textwrap.fill(text, width, initial_indent=lead, subsequent_indent=" " * len(lead)), target=target)


def table(
    title: str,
    header: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    texts: Sequence[str] = (),
    target: str | None = None,
) -> None:
    """Print a table for people with rich; the first column left, the others right.

    Parameters
    ----------
    title : str
        Above the table.
    header : sequence of str
        Titles of the columns.
    rows : iterable of sequence of str
        Cells.
    texts : sequence of str
        Titles of further columns that stand left, since they hold words.
    target : str, optional
        Where the JSON goes; the table goes to standard error where that is standard output.
    """
    from rich import box
    from rich.console import Console
    from rich.table import Table

    made = Table(title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False)
    for number, name in enumerate(header):
        made.add_column(name, justify="left" if number == 0 or name in texts else "right", overflow="fold")
    for row in rows:
        made.add_row(*row)
    console = Console(stderr=wants_stdout(target), highlight=False)
    if not console.is_terminal:
        console = Console(stderr=wants_stdout(target), highlight=False, width=120)
    console.print(made)
