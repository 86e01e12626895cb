"""What calib returns and writes: results, plain values, JSON and CSV text, the checksum of its files.

The checksum is SHA-256 over a canonical form that survives re-indenting and re-ordering.
"""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from jinja2 import Environment
    from matplotlib.figure import Figure

#: of the program, as its documents name it
VERSION = "1.0.0"

CHECKSUM_KEY: Final = "checksum"


def to_json(value: Any, *, ascii_only: bool = False) -> str:
    """Return `value` as indented JSON with a final newline.

    `value`: plain values, numpy scalars included; `ascii_only`: escape all other characters, as where a text has no
    UTF-8 form. Raises ValueError where a number is NaN or infinite.
    """
    import json

    text = json.dumps(value, indent=2, ensure_ascii=ascii_only, allow_nan=False, default=_python_scalar) + "\n"
    try:
        text.encode("utf-8")
    except UnicodeEncodeError:
        return to_json(value, ascii_only=True)
    return text


def _python_scalar(value: Any) -> Any:
    if hasattr(value, "item"):
        return value.item()
    raise TypeError(f"{type(value).__name__} has no JSON form")


def csv_text(columns: Sequence[str], rows: Iterable[Iterable[Any]]) -> str:
    """Return a table for people and spreadsheets as CSV.

    None is an empty cell, and no cell is a formula (`spreadsheet_cell`).
    """
    import csv
    import io

    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([spreadsheet_cell(name) for name in columns])
    writer.writerows([spreadsheet_cell(cell) for cell in row] for row in rows)
    return text.getvalue()


def spreadsheet_cell(value: Any) -> Any:
    """Return a cell that a spreadsheet does not evaluate: a text that begins like a formula gets a leading quote.

    Numbers stay numbers, also those written as texts.
    """
    if not isinstance(value, str) or not value.startswith(("=", "+", "-", "@", "\t", "\r")):
        return value
    try:
        float(value)
    except ValueError:
        return f"'{value}"
    return value


def templates_of(package: str, *, markup: bool = False) -> "Environment":
    """Return the templates in a package's folder, in which a line that begins with ``%`` is a statement.

    `markup`: every text that they take is escaped; elsewhere the last line keeps its end.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    return Environment(
        loader=PackageLoader(package, "."), autoescape=markup, undefined=StrictUndefined,
        line_statement_prefix="%", keep_trailing_newline=not markup,
    )  # fmt: skip


def checksum(document: dict[str, object]) -> str:
    """Return ``sha256:`` and the hexadecimal SHA-256 of the canonical form of `document`.

    Without its checksum; keys sorted, no white space, ASCII only, every number the shortest decimal that reads back as
    the same double: 4096 and 4096.0 are one. Raises ValueError, OverflowError where one is not a finite double.
    """
    import hashlib
    import json

    body = {key: value for key, value in document.items() if key != CHECKSUM_KEY}
    text = json.dumps(_doubles(body), sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
    return "sha256:" + hashlib.sha256(text.encode("ascii")).hexdigest()


def _doubles(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _doubles(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_doubles(item) for item in value]
    if isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    return value


#: draws and words every result; by name, so that no stage imports what stands above it
PRESENTATION: Final = "calib.reporting.topics"
PAGES: Final = "calib.reporting.pages"
SENTENCES: Final = "calib.gap.decision.sentences"


class Result:
    """A result that a user holds: the base of what `calib.fit`, `calib.diagnose` and their kind return."""

    __slots__ = ()

    def summary(self) -> str:
        """Return what the command prints, as lines of text."""
        return str(in_words().summary(self))

    def plot(self, kind: str | None = None) -> "Figure":
        """Draw the result.

        Parameters
        ----------
        kind : str, optional
            Which of its figures; the first one by default. An unknown kind is answered with the list of those there
            are.

        Returns
        -------
        matplotlib.figure.Figure
            The figure; nothing is shown or written.

        Raises
        ------
        BadInputError
            Where the result has no figure of that kind.
        """
        figure: Figure = in_words().figure(self, kind)
        return figure

    def to_dict(self) -> dict[str, object]:
        """Return the result as plain values: the keys of the command's ``--json``."""
        return plain_fields(self)

    def __repr__(self) -> str:
        return str(in_words().brief(self))

    def _repr_html_(self) -> str:
        return str(in_words(PAGES).brief_html(self))


def in_words(module: str = PRESENTATION) -> Any:
    """Return the module that says a result in words."""
    from importlib import import_module

    return import_module(module)


def plain(value: Any) -> Any:
    """Return a value as JSON can hold it: the one serialiser of the project.

    Dataclasses become objects with a key a field, arrays lists, enumerations their values, paths text, numbers that are
    not finite null. ``metadata={"json": False}`` omits a field, ``metadata={"json": "name"}`` renames it; a ``to_dict``
    of its own is used.
    """
    if value is None or type(value) in {bool, int, str}:
        return value
    if isinstance(value, float):
        return float(value) if value - value == 0.0 else None
    # imported here, since `import calib` reads this file
    from dataclasses import is_dataclass
    from enum import Enum
    from pathlib import PurePath

    if isinstance(value, str):
        return str(value.value) if isinstance(value, Enum) else value
    if isinstance(value, int):
        return int(value)
    if isinstance(value, dict) or hasattr(value, "items"):
        return {str(plain(key)): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in value]
    if isinstance(value, PurePath):
        return value.as_posix()
    if hasattr(value, "tolist"):  # numpy arrays and scalars, without importing numpy
        return plain(value.tolist())
    if hasattr(value, "to_dict") and not (isinstance(value, Result) and type(value).to_dict is Result.to_dict):
        return value.to_dict()
    if is_dataclass(value):
        return plain_fields(value)
    if isinstance(value, Enum):
        return plain(value.value)
    raise TypeError(f"{type(value).__name__} has no form in JSON")


def plain_fields(value: Any, **changes: Any) -> dict[str, Any]:
    """Return a dataclass's fields as plain values, for a ``to_dict`` that changes some.

    `changes`: key of the JSON -> value, in place of the field's own or after the fields.
    """
    from dataclasses import fields

    document = {}
    for part in fields(value):
        key = part.metadata.get("json", part.name)
        if key is not False:
            document[str(key)] = None if key in changes else plain(getattr(value, part.name))
    return document | {key: plain(item) for key, item in changes.items()}
