"""Arguments of the Python functions, held against their annotations: what cannot be used is a `BadInputError`."""

from __future__ import annotations

import inspect
import operator
import os
import stat
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
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


#: entries of an input folder searched for a hard link to the target; with more, the target is refused
MOST_SEARCHED: Final = 200_000
#: files that calib writes and never reads as measurements: inside an input folder they may be replaced
_OUTPUT_SUFFIXES: Final = frozenset({".json", ".pdf", ".png", ".svg", ".html", ".h", ".yaml", ".yml"})
_FIT: Final = "fit.json"
#: JSON that is read: a fit, and the cases of a sealed set
_READ: Final = frozenset({_FIT, "challenge.json"})
#: inputs of the running command; empty for a program that uses calib as a library
_INPUTS: Final[ContextVar[tuple[Path, ...]]] = ContextVar("inputs", default=())


@contextmanager
def inputs_kept(paths: Iterable[Path | str]) -> Iterator[None]:
    """Refuse to overwrite `paths` inside the block: files, or folders whose data files are meant."""
    token = _INPUTS.set((*_INPUTS.get(), *(Path(path) for path in paths)))
    try:
        yield
    finally:
        _INPUTS.reset(token)


def refuse_input(target: Path) -> None:
    """Raise BadInputError where `target` is an input, under any name: links, ``..``, another case."""
    for given in _INPUTS.get():
        if _is_input(Path(target), given):
            raise BadInputError(
                f"{target}: found an input of this command ({given}); expected another place for the output, since "
                "inputs are never written over; choose another path"
            )


def refuse_special(path: Path) -> None:
    """Raise BadInputError where `path`, to be read, is a device, a FIFO or a socket, which may never end."""
    with suppress(OSError, ValueError):
        mode = Path(path).stat().st_mode
        if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
            raise BadInputError(
                f"{path}: found a device, pipe or socket; expected a regular file or a folder; save the data to a file"
            )


def _is_input(target: Path, given: Path) -> bool:
    try:
        at, source = target.stat(), given.stat()
    except (OSError, ValueError, RuntimeError):
        return False  # what does not exist cannot be overwritten
    if not stat.S_ISDIR(source.st_mode):
        return os.path.samestat(at, source) and stat.S_ISREG(at.st_mode)
    if stat.S_ISDIR(at.st_mode):
        return False
    if at.st_nlink > 1 and _is_linked_from(given, at):
        return True
    real = target.resolve()
    between: list[Path] = []
    for parent in real.parents:
        if os.path.samestat(parent.stat(), source):
            return _is_data(real, between)
        between.append(parent)
    return False


def _is_data(path: Path, between: list[Path]) -> bool:
    """Return whether a file inside an input folder belongs to the input; `between`: the folders between them."""
    if any((folder / _FIT).is_file() for folder in between):
        return False  # a result inside the campaign's folder
    return path.suffix.lower() not in _OUTPUT_SUFFIXES or (path.name in _READ and not between)


def _is_linked_from(folder: Path, at: os.stat_result) -> bool:
    searched = 0
    for place, _, names in os.walk(folder):
        searched += len(names) + 1
        if searched > MOST_SEARCHED:
            return True
        with suppress(OSError):
            data = (Path(place, name) for name in names if Path(name).suffix.lower() not in _OUTPUT_SUFFIXES)
            if any(os.path.samestat(path.stat(), at) for path in data):
                return True
    return False
