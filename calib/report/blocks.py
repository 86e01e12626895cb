"""What a page is made of: plain, immutable blocks that say what is said and nothing of how it looks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Block", "Column", "Equation", "Facts", "Heading", "Items", "Notice", "Picture", "Section", "Table", "Text"]


@dataclass(frozen=True, slots=True)
class Heading:
    """A heading within a section."""

    text: str

    def to_dict(self) -> dict[str, Any]:
        """Return the block as plain values."""
        return {"kind": "heading", "text": self.text}


@dataclass(frozen=True, slots=True)
class Text:
    """A paragraph; `small` for remarks."""

    text: str
    small: bool = False

    def to_dict(self) -> dict[str, Any]:
        """Return the block as plain values."""
        return {"kind": "text", "text": self.text, "small": self.small}


@dataclass(frozen=True, slots=True)
class Facts:
    """Named facts, one a line: (name, value)."""

    rows: tuple[tuple[str, str], ...]

    def to_dict(self) -> dict[str, Any]:
        """Return the block as plain values."""
        return {"kind": "facts", "rows": [list(row) for row in self.rows]}


@dataclass(frozen=True, slots=True)
class Items:
    """A list of sentences."""

    items: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return the block as plain values."""
        return {"kind": "items", "items": list(self.items)}


@dataclass(frozen=True, slots=True)
class Equation:
    """One of the page's own equations, by name."""

    name: str

    def to_dict(self) -> dict[str, Any]:
        """Return the block as plain values."""
        return {"kind": "equation", "name": self.name}


@dataclass(frozen=True, slots=True)
class Notice:
    """A boxed statement: ``good``, ``note``, ``bad`` or ``simulated``."""

    level: str
    title: str
    text: str

    def to_dict(self) -> dict[str, Any]:
        """Return the block as plain values."""
        return {"kind": "notice", "level": self.level, "title": self.title, "text": self.text}


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a table; numbers stand right, and all with one number of decimals, so that they align.

    Parameters
    ----------
    title : str
        What it holds.
    unit : str
        Unit of every number in it; empty for texts and pure numbers.
    align : str
        ``left``, ``right`` or ``center``.
    wide : bool
        Takes the room that the others leave; for sentences.
    mono : bool
        Set in a typewriter face; for hashes.
    group : str
        Common title above neighbouring columns of the same group.
    detail : bool
        Left out where there is little room, as on a terminal.
    """

    title: str
    unit: str = ""
    align: str = "right"
    wide: bool = False
    mono: bool = False
    group: str = ""
    detail: bool = False


@dataclass(frozen=True, slots=True)
class Table:
    """A table with its caption; `dense` for long ones."""

    caption: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[str, ...], ...]
    dense: bool = False

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(f"table {self.caption!r}: {len(row)} cells in a row of {len(self.columns)} columns")

    def to_dict(self) -> dict[str, Any]:
        """Return the block as plain values."""
        columns = [asdict(one) for one in self.columns]
        rows = [list(row) for row in self.rows]
        return {"kind": "table", "caption": self.caption, "columns": columns, "rows": rows, "dense": self.dense}


@dataclass(frozen=True, slots=True)
class Picture:
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
