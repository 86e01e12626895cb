"""What a customer gets: content, figures and the typeset page."""

import re
import shlex
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property, partial
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

from calib.documents import plain_fields

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@cache
def catalogue() -> dict[str, dict[str, str]]:
    """Return the sentences of ``words.toml`` with places to fill in, by section and name."""
    return tomllib.loads(Path(__file__).with_name("words.toml").read_text(encoding="utf-8"))


def paragraph(name: str, /, **values: object) -> str:
    """Return a paragraph, its places filled in; see `catalogue`."""
    return catalogue()["report"][name].format(**values)


def caption(name: str, /, **values: object) -> str:
    """Return the caption of a picture, or of ``table-NAME``; see `paragraph`."""
    return catalogue()["caption"][name].format(**values)


def _quoted(word: str) -> str:
    plain = shlex.quote(word) == word or set(word) & set('"$`\\!')
    return shlex.quote(word) if plain else f'"{word}"'


def next_step(step: str, **names: str | Path | Iterable[str | Path]) -> str:
    """Return the line after a step of ``words.toml``; ``runs`` is the campaign `c`, if it has runs to diagnose.

    Raw files of the lab make one first.
    """
    campaign, text = Path(str(names.get("c", ""))), catalogue()["next"][step]
    names["runs"] = campaign if (campaign / "campaign.toml").is_file() else "CAMPAIGN"
    of_files = step.startswith(("fit", "diagnose", "geometry")) and campaign.exists() and names["runs"] != campaign
    if of_files and any(f"{command} {{c}}" in text for command in ("plan", "report", "export")):
        names |= {"c": "CAMPAIGN", "files": campaign}
        text = "'calib ingest {files} --into CAMPAIGN', then " + text
    words = {name: [one] if isinstance(one, str | Path) else one for name, one in names.items()}
    quoted = {name: " ".join(map(_quoted, map(str, several))) for name, several in words.items()}
    return "Next: " + text.format(**quoted)


Drawings = Mapping[str, "Callable[[], Figure]"]


class Block:
    """Base of all blocks."""

    __slots__ = ()

    def to_dict(self) -> dict[str, Any]:
        """Return the block as plain values under its kind; a drawing is in its own file."""
        return {"kind": type(self).__name__.lower()} | plain_fields(self)


@dataclass(frozen=True, slots=True)
class Heading(Block):
    """A heading within a section."""

    text: str


@dataclass(frozen=True, slots=True)
class Text(Block):
    """A paragraph; `small` for remarks."""

    text: str
    small: bool = False


@dataclass(frozen=True, slots=True)
class Facts(Block):
    """Named facts, one a line: (name, value)."""

    rows: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class Items(Block):
    """A list of sentences."""

    sentences: tuple[str, ...] = field(metadata={"json": "items"})


def items(sentences: Iterable[str]) -> tuple[Items, ...]:
    """Return sentences as a list; nothing where there are none."""
    listed = tuple(sentences)
    return (Items(listed),) if listed else ()


@dataclass(frozen=True, slots=True)
class Equation(Block):
    """One of the page's own equations, by name."""

    name: str


@dataclass(frozen=True, slots=True)
class Notice(Block):
    """A boxed statement: ``good``, ``note``, ``bad`` or ``simulated``."""

    level: str
    title: str
    text: str


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a table; its numbers align."""

    title: str
    #: of its numbers
    unit: str = ""
    #: ``left``, ``right`` or ``center``
    align: str = "right"
    #: takes the remaining width; for sentences
    wide: bool = False
    #: set in a typewriter face; for hashes
    mono: bool = False
    #: common title above neighbours
    group: str = ""
    #: omitted on a terminal
    detail: bool = False


@dataclass(frozen=True, slots=True)
class Table(Block):
    """A table with its caption; `dense` for long ones."""

    caption: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[str, ...], ...]
    dense: bool = False

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(f"table {self.caption!r}: {len(row)} cells in a row of {len(self.columns)} columns")


@dataclass(frozen=True)
class Picture(Block):
    """A figure: name, caption, alternative text, and what draws it when needed."""

    name: str
    caption: str
    alt: str
    draw: "Callable[[], Figure]" = field(metadata={"json": False})

    @cached_property
    def svg(self) -> bytes:
        """SVG, drawn once for page and PDF."""
        return bytes(named("figures", "render")(self.draw(), "svg"))


@dataclass(frozen=True, slots=True)
class Section:
    """A numbered section: title and blocks."""

    title: str
    blocks: tuple[Block, ...]


def column(head: str) -> Column:
    """Return a column from its head, ``group | title (unit)`` after its signs.

    Signs: ``<`` texts; ``^`` centred; ``*`` sentences, which take the remaining width; ``=`` typewriter face; ``~``
    omitted on a terminal. Without a sign a column holds numbers.
    """
    words = head.lstrip("<^*=~")
    signs = head.removesuffix(words)
    group, _, words = words.rpartition(" | ")
    title, unit = re.fullmatch(r"(.*?)(?: \(([^()]*)\))?", words).groups("")  # type: ignore[union-attr]
    align = "center" if "^" in signs else "left" if signs.strip("~") else "right"
    return Column(title, unit, align, "*" in signs, "=" in signs, group, "~" in signs)


def table(caption: str, heads: Iterable[str], rows: Iterable[Sequence[str]], *, dense: bool = False) -> Table:
    """Return a table; `heads`: see `column`; `dense`: in small print."""
    return Table(caption, tuple(map(column, heads)), tuple(map(tuple, rows)), dense)


def picture(name: str, alt: str, figure: str, *values: Any, **options: Any) -> Picture:
    """Return a picture that ``module.function`` of `calib.reporting.figures` draws; see `Picture`."""
    return Picture(name, caption(name), alt, partial(drawn, figure, *values, **options))


def drawn(figure: str, *values: Any, **options: Any) -> "Figure":
    """Return a figure of `calib.reporting.figures` by ``module.function``."""
    picture: Figure = named("figures", figure)(*values, **options)
    return picture


def named(folder: str, name: str) -> Callable[..., Any]:
    """Return ``module.function`` of a folder of `calib.reporting`; its module is imported now."""
    function: Callable[..., Any] = resolve_name(f"calib.reporting.{folder}.{name}")
    return function


def simulated_notice() -> Notice:
    """Return the notice over every result of simulated data."""
    return Notice("simulated", "SIMULATED DATA", "These data are simulated; no vehicle was measured.")
