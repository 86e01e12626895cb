"""What stands around every command: its inputs are kept from being written over, and are files, no devices."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import typer
from typer.core import TyperCommand

from calib.arguments import inputs_kept, refuse_special
from calib.errors import BadInputError
from calib.io import refuse_empty, refuse_existing

#: parameters that say where something is written; every other path is an input
OUTPUTS: Final = frozenset({"into", "output", "json", "json_target", "figures", "apply", "html", "tum", "plot"})
#: commands with further outputs: what one makes, another reads
ALSO: Final[dict[str, frozenset[str]]] = {"make": frozenset({"truth"})}


class Guarded(TyperCommand):
    """A command whose path arguments are held sacred while it runs."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the words of a command line, none of whose paths may be empty."""
        _refuse_empty(self.params, args)
        return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Run the command with its inputs kept, where the JSON can be written."""
        _refuse_dash(ctx)
        paths = list(dict.fromkeys(_inputs(ctx.params, OUTPUTS | ALSO.get(str(ctx.info_name), frozenset()))))
        for path in paths:
            refuse_special(path)
        seed = ctx.params.get("seed")
        if isinstance(seed, int) and not 0 <= seed < 2**63:
            raise BadInputError(f"--seed: found {seed}; expected a whole number from 0 on; choose another")
        with inputs_kept(paths):
            # before the work, not after it
            refuse_existing([ctx.params.get("json")], force=bool(ctx.params.get("force")))
            return super().invoke(ctx)


def _refuse_empty(parameters: Sequence[Any], words: Sequence[str]) -> None:
    """Refuse an empty path, which `Path` would read as the working folder."""
    paths: set[str] = set()
    others: set[str] = set()
    for parameter in parameters:
        is_path = parameter.name in OUTPUTS or "Path" in str(parameter.type_descriptor.annotation)
        (paths if is_path else others).update(parameter.opts)
    for before, word in itertools.pairwise(["", *words]):
        option, equals, value = word.partition("=")
        if option in paths and equals:
            refuse_empty(value, option)
        elif before in paths or (before not in others and any(not name.startswith("-") for name in paths)):
            refuse_empty(word, before if before in paths else "argument")


def _refuse_dash(ctx: Any) -> None:
    """Refuse ``-`` where it would become a folder or a file of that name."""
    takes = {"json", "json_target"} | ({"output"} if ctx.info_name == "export" else set())
    for parameter in ctx.command.params:
        if parameter.name in OUTPUTS - takes and str(ctx.params.get(parameter.name)) == "-":
            raise BadInputError(
                f"{parameter.opts[-1]}: found '-'; expected a file or folder, since standard output takes the JSON of "
                "--json - alone; name one"
            )


class Application(typer.Typer):
    """A group whose commands are guarded, so that none has to think of it."""

    def command(self, *args: Any, **kwargs: Any) -> Any:
        """Add a command; see `typer.Typer.command`."""
        kwargs.setdefault("cls", Guarded)
        return super().command(*args, **kwargs)


def _inputs(parameters: dict[str, Any], outputs: frozenset[str]) -> Iterator[Path]:
    for name, value in parameters.items():
        if name in outputs:
            continue
        for part in value if isinstance(value, list | tuple) else [value]:
            if isinstance(part, Path) or (isinstance(part, str) and part and _exists(part)):
                yield Path(part)


def _exists(text: str) -> bool:
    try:
        return Path(text).exists()
    except (OSError, ValueError):
        return False
