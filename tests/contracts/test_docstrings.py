"""What is public says what it is, and its parameters are the ones that it takes."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
from collections.abc import Iterator
from types import FunctionType, ModuleType

import calib
from calib.cli import COMMANDS, function_of, module_of

NAMES = sorted(
    found.name
    for found in pkgutil.walk_packages(calib.__path__, "calib.")
    if not found.name.endswith("__main__")  # importing it runs the command line
)
#: what the commands call
COMMAND_FUNCTIONS = {(module_of(name), function_of(name).__name__) for name in COMMANDS}
#: a function of this many parameters is not described by one sentence
MANY = 5
#: what stands in place of a section: the parameters are those of a function that is named
ELSEWHERE = re.compile(r"\b(?:see|those of) `[\w.]+`")


def _load(name: str) -> ModuleType:
    return importlib.import_module(name)


def _public(module: ModuleType) -> Iterator[tuple[str, object]]:
    """Yield what a module defines and offers, methods of its classes included."""
    for name in [name for name in vars(module) if not name.startswith("_")]:
        thing = getattr(module, name)
        if getattr(thing, "__module__", None) != module.__name__:
            continue
        yield name, thing
        if inspect.isclass(thing):
            for key, value in vars(thing).items():
                plain = value.fget if isinstance(value, property) else getattr(value, "__func__", value)
                if not key.startswith("_") and isinstance(plain, FunctionType):
                    yield f"{name}.{key}", getattr(thing, key)


def _functions(module: ModuleType) -> Iterator[tuple[str, FunctionType, list[str], str]]:
    for name, thing in _public(module):
        if isinstance(thing, FunctionType):
            taken = [one for one in inspect.signature(thing).parameters if one not in {"self", "cls"}]
            yield name, thing, taken, inspect.getdoc(thing) or ""


def _described(doc: str) -> list[str] | None:
    """Return the names of a numpydoc section on parameters; None where there is none."""
    section = re.search(r"^Parameters\n-+\n(.*?)(?=^\w[\w ]*\n-+\n|\Z)", doc, re.MULTILINE | re.DOTALL)
    if section is None:
        return None
    heads = re.findall(r"^(\S[^:\n]*?)(?: :.*)?$", section[1], re.MULTILINE)
    return [name.strip().lstrip("*") for head in heads for name in head.split(",")]


def test_every_module_says_what_it_holds() -> None:
    assert [name for name in NAMES if not (_load(name).__doc__ or "").strip()] == []


def test_everything_public_has_a_docstring_or_inherits_one() -> None:
    public = [(name, what, thing) for name in NAMES for what, thing in _public(_load(name))]
    assert [(name, what) for name, what, thing in public if callable(thing) and not inspect.getdoc(thing)] == []


def test_a_section_on_parameters_names_each_of_them_and_no_other() -> None:
    for name in NAMES:
        for what, _, taken, doc in _functions(_load(name)):
            described = _described(doc)
            assert described is None or sorted(described) == sorted(taken), f"{name}.{what}"


def test_a_function_of_many_parameters_describes_them() -> None:
    for name in NAMES:
        for what, _, taken, doc in _functions(_load(name)):
            command = (name, what) in COMMAND_FUNCTIONS  # its options carry their own help
            if len(taken) >= MANY and not ELSEWHERE.search(doc) and not command:
                assert _described(doc) is not None, f"{name}.{what}"
