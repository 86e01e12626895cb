"""The command line: one file a command that parses, calls and shows, imported when it is called.

For all of them: inputs are never written.
"""

import importlib
import itertools
import os
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Final

import typer
from typer.core import TyperCommand

from calib.cli.terminal import FORCE, JSON_TARGET, Force, JsonTarget, refuse_outputs
from calib.errors import BadInputError, inputs_kept, refuse_special
from calib.io import refuse_empty

#: parameters that say where something is written; every other path is an input
OUTPUTS: Final = frozenset({"into", "output", "json", "figures", "apply", "html", "tum", "plot"})
#: commands with further outputs: what one makes, another reads, and the folder that it makes
ALSO: Final[dict[str, frozenset[str]]] = {"init": frozenset({"folder"}), "make": frozenset({"truth"})}


@cache
def _shared_options() -> list[Any]:
    application = typer.Typer(add_completion=False)

    @application.command()
    def shared(json: JsonTarget = None, force: Force = False) -> None:
        """Declare them."""

    return list(typer.main.get_command(application).params)


class Guarded(TyperCommand):
    """A command with ``--json`` and ``--force``, whose inputs are never written while it runs."""

    def __init__(self, *args: Any, params: list[Any] | None = None, **kwargs: Any) -> None:
        super().__init__(*args, params=[*(params or ()), *_shared_options()], **kwargs)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the words of a command line, none of whose paths may be empty."""
        _refuse_empty(self.params, args)
        return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Run the command with its inputs kept, where the JSON can be written."""
        import logging

        # where HOME cannot be written, the drawing library works without its cache and need not say so
        logging.getLogger("matplotlib").setLevel(logging.ERROR)
        _refuse_dash(ctx)
        paths = list(dict.fromkeys(_inputs(ctx.params, OUTPUTS | ALSO.get(str(ctx.info_name), frozenset()))))
        for path in paths:
            refuse_special(path)
        seed = ctx.params.get("seed")
        if isinstance(seed, int) and not 0 <= seed < 2**63:
            raise BadInputError(f"--seed: found {seed}; expected a whole number from 0 on; choose another")
        JSON_TARGET.set(ctx.params.pop("json"))
        FORCE.set(ctx.params.pop("force"))
        with inputs_kept(paths):
            refuse_outputs()
            return super().invoke(ctx)


def _refuse_empty(parameters: Sequence[Any], words: Sequence[str]) -> None:
    paths: set[str] = set()
    others: set[str] = set()
    for parameter in parameters:
        is_path = parameter.name in OUTPUTS or "Path" in str(parameter.type_descriptor.annotation)
        (paths if is_path else others).update(parameter.opts)
    named = " or ".join(str(one.metavar or one.name) for one in parameters if not one.opts[0].startswith("-"))
    for before, word in itertools.pairwise(["", *words]):
        option, equals, value = word.partition("=")
        if option in paths and equals:
            refuse_empty(value, option)
        elif before in paths or (before not in others and any(not name.startswith("-") for name in paths)):
            refuse_empty(word, before if before in paths else named)


def _refuse_dash(ctx: Any) -> None:
    takes = {"json", *(["output"] if ctx.info_name == "export" else [])}
    for parameter in ctx.command.params:
        if parameter.name in OUTPUTS - takes and str(ctx.params.get(parameter.name)) == "-":
            raise BadInputError(
                f"{parameter.opts[-1]}: found '-'; expected a file or folder, since standard output takes the JSON of "
                "--json - alone; name one"
            )


def _inputs(parameters: dict[str, object], outputs: frozenset[str]) -> Iterator[Path]:
    for name, value in parameters.items():
        if name in outputs:
            continue
        for part in value if isinstance(value, list | tuple) else [value]:
            if isinstance(part, Path) or (isinstance(part, str) and os.path.exists(part)):  # noqa: PTH110
                yield Path(part)


#: command or group -> its line in ``calib --help``, in this order, so that the list of commands imports none of them
SUMMARIES: Final = {
    "check": "Say what a campaign holds and what is wrong.",
    "init": "Make an empty campaign to fill in.",
    "ingest": "Make a campaign out of raw lab files.",
    "fit": "Fit each wheel's radius against its load.",
    "deviation": "Show what a woven path does to a radius.",
    "report": "Write the calibration report as PDF.",
    "export": "Write coefficients for vehicle or controller.",
    "loads": "Compute static wheel loads from a payload.",
    "simulate": "Simulate routes and loads; replay logged runs.",
    "simulate route": "Drive a route with radii other than believed.",
    "simulate journey": "Drive a route under a fitted law, load by load.",
    "simulate study": "Run a study of the paper's Section 7.",
    "simulate replay": "Replay a campaign's logged runs.",
    "geometry": "Estimate radii, track and sensor together.",
    "diagnose": "Say why the simulation differs from reality.",
    "effects": "List the causes that a diagnosis knows.",
    "plan": "Say which runs to drive next.",
    "challenge": "Check the diagnosis blind, on sealed cases.",
    "challenge make": "Make sealed cases.",
    "challenge own": "Say what your own data would find.",
    "challenge run": "Diagnose every case.",
    "challenge score": "Open the truth and score.",
    "fleet": "Calibrate many vehicles at once.",
    "fleet run": "Do a task for every vehicle of a folder.",
    "fleet simulate": "Make a fleet with known truth.",
}
#: group -> the example that its help shows
GROUPS: Final = {
    "simulate": "Example: calib simulate study corrected --law sample_runs/corridor --output section7",
    "challenge": "Example: calib challenge make --seeds tests/challenge/seeds/development.toml --into blind",
    "fleet": "Example: calib fleet vehicles --into fleet --workers 2",
}
#: commands, those of a group with the group's name before theirs
COMMANDS: Final = tuple(name for name in SUMMARIES if name not in GROUPS)


#: commands of one word that share a module, where each is the function that bears its name
TOGETHER: Final = {
    **dict.fromkeys(("check", "deviation", "fleet", "init", "ingest", "loads"), "campaigns"),
    **dict.fromkeys(("fit", "geometry", "export", "report"), "fit"),
    **dict.fromkeys(("effects", "plan"), "diagnose"),
    "challenge": "simulate",
}


def module_of(name: str) -> str:
    """Return the module of a command; the commands of a group share one."""
    first = name.split(maxsplit=1)[0]
    return f"calib.cli.{TOGETHER.get(first, first)}"


def function_of(name: str) -> Callable[..., Any]:
    """Return what a command calls: the function that bears its name, or ``run`` of a module of its own."""
    function = name.rpartition(" ")[2] if name in TOGETHER or " " in name else "run"
    called: Callable[..., Any] = getattr(importlib.import_module(module_of(name)), function)
    return called


def options_of(name: str) -> set[str]:
    """Return the options of a command, long and short."""
    application = typer.Typer(add_completion=False)
    application.command(name, cls=Guarded)(function_of(name))
    return {option for parameter in typer.main.get_command(application).params for option in parameter.opts}


def command_called(arguments: Sequence[str]) -> str | None:
    """Return the name of the command that a command line calls."""
    words = [word for word in arguments if not word.startswith("-")]
    return next((name for name in COMMANDS if words[: len(name.split())] == name.split()), None)


def with_default(arguments: Sequence[str]) -> list[str]:
    """Return the arguments with a group's default command: ``calib fleet FOLDER`` is ``calib fleet run FOLDER``."""
    words = list(arguments)
    if words[:1] == ["fleet"] and len(words) > 1 and words[1] not in {"run", "simulate", "-h", "--help"}:
        words.insert(1, "run")
    return words


def build(arguments: Sequence[str] | None = None) -> typer.Typer:
    """Return the application.

    With a command's name in `arguments` only that command is imported; without arguments every one.
    """
    application = typer.Typer(
        name="calib",
        no_args_is_help=True,
        add_completion=True,
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
        help="Calibrate a vehicle's wheel odometry, and find out why its simulation is wrong.",
    )

    @application.callback(invoke_without_command=True)
    def root(version: bool = typer.Option(False, "--version", "-V", help="Show the version and exit.")) -> None:
        if version:
            from calib import __version__

            typer.echo(f"calib {__version__}")
            raise typer.Exit

    words = None if arguments is None else [word for word in arguments if not word.startswith("-")]
    parents = {"": application}
    for name in COMMANDS:
        group, _, inner = name.rpartition(" ")
        if group not in parents:
            parents[group] = typer.Typer(rich_markup_mode=None, epilog=GROUPS[group])
            application.add_typer(parents[group], name=group, help=SUMMARIES[group])
        if words is None or words[: len(name.split())] == name.split():
            parents[group].command(inner, cls=Guarded)(function_of(name))
        else:
            parents[group].command(inner, cls=Guarded, help=SUMMARIES[name])(_not_imported)
    return application


def _not_imported() -> None:
    """Stand for a command that was not called."""
