"""What all results have in common: words, a figure and plain values."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from enum import Enum
from importlib import import_module
from pathlib import PurePath
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: draws and words every result; looked up by name at the first call, so that no stage imports what stands above it
PRESENTATION: Final = "calib.reporting.present"


class Result:
    """A result that a user holds: the base of what `calib.fit`, `calib.diagnose` and their kind return."""

    __slots__ = ()

    def summary(self) -> str:
        """Return what the command prints, as lines of text."""
        text: str = _presentation().summary(self)
        return text

    def plot(self, kind: str | None = None) -> Figure:
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
        figure: Figure = _presentation().figure(self, kind)
        return figure

    def to_dict(self) -> dict[str, object]:
        """Return the result as plain values: the keys of the command's ``--json``."""
        document: dict[str, object] = plain(self)
        return document

    def __repr__(self) -> str:
        text: str = _presentation().brief(self)
        return text

    def _repr_html_(self) -> str:
        text: str = _presentation().brief_html(self)
        return text


def _presentation() -> Any:
    return import_module(PRESENTATION)


def plain(value: Any) -> Any:
    """Return a value as JSON can hold it: the one serialiser of the project.

    Dataclasses become objects with a key a field, in the order of the fields; arrays become lists, enumerations their
    values, paths text. Numbers that are not finite become null, which is what JSON has for them. A field is omitted
    with ``metadata={"json": False}`` and renamed with ``metadata={"json": "name"}``; an object with a ``to_dict`` of
    its own is asked for it.
    """
    if value is None or isinstance(value, bool | str):
        return str(value.value) if isinstance(value, Enum) else value
    if isinstance(value, int):
        return int(value)
    if isinstance(value, float):
        return float(value) if value - value == 0.0 else None
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
    """Return a dataclass's fields as plain values, for a ``to_dict`` that adds to them or replaces some.

    `changes`: key of the JSON -> value, in place of the field's own or after the fields.
    """
    document = {}
    for part in fields(value):
        key = part.metadata.get("json", part.name)
        if key is not False:
            document[str(key)] = None if key in changes else plain(getattr(value, part.name))
    return document | {key: plain(item) for key, item in changes.items()}
