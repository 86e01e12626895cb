"""Arguments of the Python functions, held against their annotations: what cannot be used is a `BadInputError`."""

from __future__ import annotations

import inspect
import operator
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import wraps
from os import PathLike, fspath
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Final, Literal, ParamSpec, TypeVar, Union, get_args, get_origin, get_type_hints

from calib.errors import BadInputError

Parameters = ParamSpec("Parameters")
Returned = TypeVar("Returned")

#: characters of a value that a message shows
SHOWN: Final = 40
#: what an argument shall be, in words
WORDS: Final[Mapping[Any, str]] = {
    str: "a text",
    int: "a whole number",
    float: "a number",
    bool: "True or False",
    Path: "a path",
    NoneType: "None",
}


def checked(function: Callable[Parameters, Returned]) -> Callable[Parameters, Returned]:
    """Return the function with its arguments held against their annotations.

    Whole numbers and numbers of numpy are taken; so are texts and path-like objects for paths. Raises BadInputError,
    which says which argument, what was found and what is expected.
    """

    @wraps(function)
    def called(*args: Parameters.args, **kwargs: Parameters.kwargs) -> Returned:
        bound = bind(function, args, kwargs)
        return function(*bound.args, **bound.kwargs)

    return called


def bind(function: Callable[..., Any], args: Sequence[Any], kwargs: Mapping[str, Any]) -> inspect.BoundArguments:
    """Return the arguments of a call as the function's annotations have them; raises BadInputError."""
    try:
        bound = inspect.signature(function).bind(*args, **kwargs)
    except TypeError as error:
        raise TypeError(f"{function.__name__}: {error}; see help(calib.{function.__name__})") from None
    hints = get_type_hints(function)
    for name, value in bound.arguments.items():
        try:
            bound.arguments[name] = _accepted(value, hints[name])
        except (TypeError, ValueError):
            text = repr(value)
            text = text if len(text) <= SHOWN else f"{text[: SHOWN - 3]}..."
            raise BadInputError(
                f"{function.__name__}: {name}: found {text} ({type(value).__name__}); expected "
                f"{_words(hints[name])}; see help(calib.{function.__name__})"
            ) from None
    return bound


def _accepted(value: Any, hint: Any) -> Any:
    origin, inner = get_origin(hint), get_args(hint)
    if origin is None:
        return _plain(value, hint)
    if origin in (Union, UnionType):
        # a text stays a text where either is taken
        for part in sorted(inner, key=lambda one: one is Path):
            with suppress(TypeError, ValueError):
                return _accepted(value, part)
    elif origin is Literal and isinstance(value, str) and value in inner:
        return value
    elif origin is tuple and isinstance(value, Sequence) and not isinstance(value, str | bytes):
        return tuple(_accepted(one, part) for one, part in zip(value, inner, strict=True))
    elif origin is Sequence and isinstance(value, Iterable) and not isinstance(value, str | bytes | Mapping):
        return tuple(_accepted(one, inner[0]) for one in value)
    raise TypeError


def _plain(value: Any, hint: Any) -> Any:
    if hint is Path and isinstance(value, str | PathLike) and isinstance(text := fspath(value), str):
        return Path(text)
    if hint is int and not isinstance(value, bool):
        return operator.index(value)
    if hint is float and not isinstance(value, bool | str | bytes):
        return float(value)
    if isinstance(value, hint):
        return value
    raise TypeError


def _words(hint: Any) -> str:
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        return " or ".join(dict.fromkeys(_words(part) for part in inner))
    if origin is Literal:
        return f"one of {', '.join(inner)}"
    if origin is tuple:
        return f"{len(inner)} values: {', '.join(_words(part) for part in inner)}"
    if origin is Sequence:
        return f"a list, each {_words(inner[0])}"
    return WORDS.get(hint, f"a {hint.__name__}")
