"""Blocks of a page or a terminal's text: plain, immutable content without layout."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, fields
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class _Block:
    """Base of all blocks."""

    __slots__ = ()

    def to_dict(self) -> dict[str, Any]:
        """Return the block as plain values under the name of its kind; a drawing is in the file of its name."""
        values = {part.name: getattr(self, part.name) for part in fields(self) if part.name != "draw"}  # type: ignore[arg-type]
        return {"kind": type(self).__name__.lower()} | {name: _plain(value) for name, value in values.items()}


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_plain(part) for part in value]
    return asdict(value) if isinstance(value, Column) else value


@dataclass(frozen=True, slots=True)
class Heading(_Block):
    """A heading within a section."""

    text: str


@dataclass(frozen=True, slots=True)
class Text(_Block):
    """A paragraph; `small` for remarks."""

    text: str
    small: bool = False


@dataclass(frozen=True, slots=True)
class Facts(_Block):
    """Named facts, one a line: (name, value)."""

    rows: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class Items(_Block):
    """A list of sentences."""

    items: tuple[str, ...]


def items(sentences: Iterable[str]) -> tuple[Items, ...]:
    """Return sentences as a list; nothing where there are none."""
    listed = tuple(sentences)
    return (Items(listed),) if listed else ()


@dataclass(frozen=True, slots=True)
class Equation(_Block):
    """One of the page's own equations, by name."""

    name: str


@dataclass(frozen=True, slots=True)
class Notice(_Block):
    """A boxed statement: ``good``, ``note``, ``bad`` or ``simulated``."""

    level: str
    title: str
    text: str


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a table; numbers stand right, and all with one number of decimals, so that they align."""

    #: what it holds
    title: str
    #: unit of every number in it; empty for texts and pure numbers
    unit: str = ""
    #: ``left``, ``right`` or ``center``
    align: str = "right"
    #: takes the remaining width; for sentences
    wide: bool = False
    #: set in a typewriter face; for hashes
    mono: bool = False
    #: common title above neighbouring columns of the same group
    group: str = ""
    #: omitted on a terminal
    detail: bool = False


@dataclass(frozen=True, slots=True)
class Table(_Block):
    """A table with its caption; `dense` for long ones."""

    caption: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[str, ...], ...]
    dense: bool = False

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(f"table {self.caption!r}: {len(row)} cells in a row of {len(self.columns)} columns")


@dataclass(frozen=True, slots=True)
class Picture(_Block):
    """A figure: its name, caption, what it shows in words, and the function that draws it when it is needed."""

    name: str
    caption: str
    alt: str
    draw: Callable[[], Figure]

    def to_dict(self) -> dict[str, Any]:
        """Return the block as plain values; the drawing is in the file of that name."""
        return {"kind": "picture", "name": self.name, "caption": self.caption, "alt": self.alt}


Block = Heading | Text | Facts | Items | Equation | Notice | Table | Picture


@dataclass(frozen=True, slots=True)
class Section:
    """A numbered section: title and blocks."""

    title: str
    blocks: tuple[Block, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return the section as plain values."""
        return {"title": self.title, "blocks": [block.to_dict() for block in self.blocks]}


def drawn(figure: str, *values: Any, **options: Any) -> Figure:
    """Return a figure of `calib.reporting.figures` by ``module.function``: imported only where it is drawn."""
    module, _, name = figure.partition(".")
    made: Figure = getattr(import_module(f"calib.reporting.figures.{module}"), name)(*values, **options)
    return made


def simulated_notice() -> Notice:
    """Return the notice over every result of simulated data."""
    return Notice("simulated", "SIMULATED DATA", "These data are simulated; no vehicle was measured.")
