"""The entry point: builds the command line, and turns known errors into one line and an exit status."""

from __future__ import annotations

import importlib
import os
import signal
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import typer

from calib.cli.guard import Application
from calib.cli.options import nearest
from calib.cli.respell import respelled
from calib.cli.terminal import INTERRUPTED, KEPT, visible
from calib.cli.typed import as_typed
from calib.cli.warned import numbers_beyond_said
from calib.errors import CalibError, ImplausibleError

EXIT_FINE: Final = 0
EXIT_FAILED: Final = 1
#: characters of the one line about an error; a message that quotes data may hold much of it
LONGEST_LINE: Final = 2000
EXIT_BAD_INPUT: Final = 2
EXIT_BUG: Final = 3
EXIT_INTERRUPTED: Final = 128 + signal.SIGINT
EXIT_PIPE_CLOSED: Final = 141

#: command or group -> its line in ``calib --help``, in this order, so that the list of commands imports none of them
SUMMARIES: Final[dict[str, str]] = {
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
EXAMPLES: Final[dict[str, str]] = {
    "simulate": "Example: calib simulate study corrected --law sample_runs/corridor --output section7",
    "challenge": "Example: calib challenge make --seeds calib/challenge/seeds/ci.toml --into blind",
    "fleet": "Example: calib fleet vehicles --into fleet --workers 2",
}

#: command -> module under ``calib.cli`` with ``run`` and ``EPILOG``; a name of two words is a command of a group
COMMANDS: Final = {name: name.replace(" ", ".") for name in SUMMARIES if name not in EXAMPLES}

#: where the shell asks for completions, and the words typed so far
_COMPLETE, _COMPLETE_WORDS = "_CALIB_COMPLETE", ("_TYPER_COMPLETE_ARGS", "COMP_WORDS")


def build(arguments: Sequence[str] | None = None) -> typer.Typer:
    """Return the application.

    `arguments`: with a command's name in it, only that command is imported; with none, names and summaries alone.
    Without arguments every command is there in full. A command's heavy imports happen inside its body.
    """
    application = Application(
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
    groups: dict[str, Application] = {}
    for name, module in COMMANDS.items():
        group, _, inner = name.rpartition(" ")
        parent: typer.Typer = application
        if group:
            if group not in groups:
                groups[group] = _group(group)
                application.add_typer(groups[group], name=group)
            parent = groups[group]
        if words is None or words[: len(name.split())] == name.split():
            command = importlib.import_module(f"calib.cli.{module}")
            parent.command(inner, epilog=command.EPILOG)(command.run)
        else:
            parent.command(inner, help=SUMMARIES[name])(_elsewhere)
    return application


def _group(name: str) -> Application:
    return Application(no_args_is_help=True, rich_markup_mode=None, help=SUMMARIES[name], epilog=EXAMPLES[name])


def _elsewhere() -> None:
    """Stand in the list of commands for one that was not asked for."""


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit with its status: 0 fine, 1 a verdict failed, 2 bad input or usage."""
    sys.exit(run(arguments))


def run(
    arguments: list[str] | None = None, settle: Callable[[], bool] = bool, interrupted: Callable[[], bool] = bool
) -> int:
    """Run the command line and return its exit status.

    ``settle``, called before the last line is said, and ``interrupted`` say whether the user interrupted the command:
    libraries may turn an interruption into an error of their own, or let it pass.
    """
    if sys.stdout is None or sys.stderr is None:
        _reopen()
    # figures go to files only, whatever window system the environment asks for
    os.environ["MPLBACKEND"] = "agg"
    kept: list[str] = []
    KEPT.set(kept)
    INTERRUPTED.set(interrupted)
    given = sys.argv[1:] if arguments is None else arguments
    try:
        with numbers_beyond_said():
            status = _invoke(given)
        sys.stdout.flush()
        settle()
    except (typer.Abort, KeyboardInterrupt):
        settle()
        return _told_of_interruption(kept)
    except SystemExit as error:
        # the printing libraries end the program with 1 where nobody reads on
        if isinstance(error.__context__, BrokenPipeError):
            return _pipe_closed()
        raise
    except Exception as error:
        return _told_of_interruption(kept) if settle() else _told(error, given)
    return status


def _told_of_interruption(kept: list[str]) -> int:
    held = f"kept: {'; '.join(kept)}" if kept else "nothing was written"
    return _complain(f"interrupted; {held}, and nothing half-written is left", EXIT_INTERRUPTED)


def _told(error: Exception, given: list[str]) -> int:
    """Say in one line what went wrong, and return the status for it."""
    if isinstance(error, ImplausibleError):
        return _complain(f"{error} ('calib export' and 'calib report' take --accept-implausible REASON)", EXIT_FAILED)
    if isinstance(error, CalibError):
        return _complain(as_typed(str(error), _options_typed(given)) + _meant(str(error), given))
    if isinstance(error, typer.TyperException):
        if type(error).__name__ == "NoArgsIsHelpError":
            sys.stderr.write(_message(error) + "\n")
            return EXIT_BAD_INPUT
        return _complain(_usage(error))
    if isinstance(error, BrokenPipeError):
        return _pipe_closed()
    return _told_of_the_world(error)


def _meant(message: str, given: list[str]) -> str:
    """Return ``; did you mean 'x'?`` where the message speaks of a path that is not there and one beside it is near."""
    for word in given:
        path = Path(word)
        with suppress(OSError, ValueError):
            if path.name and message.startswith(f"{path}: found no") and path.parent.is_dir() and not path.exists():
                if path.is_symlink():
                    return "; this is a symbolic link that leads nowhere"
                return nearest(path.name, (beside.name for beside in path.parent.iterdir()))
    return ""


def _told_of_the_world(error: Exception) -> int:
    """Say what the machine or the size of a number refused; what is left is a bug."""
    if os.environ.get("CALIB_TRACEBACK"):
        raise error
    if isinstance(error, UnicodeEncodeError):
        lacking = f"found characters that the encoding {error.encoding} lacks"
        return _complain(f"output: {lacking}; expected UTF-8; set PYTHONUTF8=1")
    if isinstance(error, OverflowError | RecursionError):
        beyond = f"found a number or a nesting beyond all bounds ({error})"
        return _complain(f"{beyond}; expected numbers of ordinary size; correct the input")
    if type(error).__name__ == "LinAlgError":
        beyond = f"found numbers that differ too much in size to compute with ({error})"
        return _complain(f"{beyond}; expected numbers of ordinary size; hold the campaign against 'calib check'")
    if isinstance(error, OSError):
        where = os.fsdecode(error.filename) if isinstance(error.filename, str | bytes) else "output"
        return _complain(f"{where}: found {error.strerror or error}; expected a place that works; choose another")
    if isinstance(error, MemoryError):
        return _complain("out of memory; expected a campaign that fits; give fewer runs or shorter logs")
    message = f"bug in calib, please report: {type(error).__name__}: {error} (CALIB_TRACEBACK=1 shows where)"
    return _complain(message, EXIT_BUG)


def _reopen() -> None:
    """Give a program that was started with closed streams streams that lead nowhere."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            # open for as long as the program runs
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_WRONLY), "w", encoding="utf-8"))


def _invoke(arguments: list[str]) -> int:
    """Parse and call."""
    if _COMPLETE in os.environ:
        typed = next((os.environ[name].split() for name in _COMPLETE_WORDS if name in os.environ), [])
        build(typed[1:])(args=arguments, prog_name="calib", standalone_mode=False)
        return EXIT_FINE
    arguments = respelled(arguments)
    command = command_of(arguments)
    try:
        with command.make_context("calib", list(arguments)) as context:
            result = command.invoke(context)
    except typer.Exit as ended:
        return ended.exit_code
    return result if isinstance(result, int) else EXIT_FINE


def command_of(arguments: Sequence[str]) -> Any:
    """Return the parser of a command line, with what is to be called."""
    return typer.main.get_command(build(arguments))


def _pipe_closed() -> int:
    # what is still buffered has nowhere to go
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return EXIT_PIPE_CLOSED


def _usage(error: Exception) -> str:
    """Return what is wrong with the words typed, and which command of the same group would take them."""
    message, context = _message(error), getattr(error, "ctx", None)
    if context is None:
        return message
    words = context.command_path.split()
    option = getattr(error, "option_name", "")
    others = [
        name for name in COMMANDS if len(words) == 3 and name.split()[0] == words[1] and name.split()[1] != words[2]
    ]
    takers = [f"'calib {name}'" for name in others if option and option in options_of(name)]
    message += f"; {' and '.join(takers)} {'has' if len(takers) == 1 else 'have'} it" if takers else ""
    return f"{message} (see '{context.command_path} --help')"


def _options_typed(arguments: Sequence[str]) -> set[str]:
    """Return the options of the command that was called."""
    words = [word for word in respelled(arguments) if not word.startswith("-")]
    name = next((name for name in COMMANDS if words[: len(name.split())] == name.split()), None)
    return set() if name is None else options_of(name)


def options_of(name: str) -> set[str]:
    """Return the options of a command, long and short."""
    application = Application(add_completion=False)
    application.command(name)(importlib.import_module(f"calib.cli.{COMMANDS[name]}").run)
    return {option for parameter in typer.main.get_command(application).params for option in parameter.opts}


def _message(error: Exception) -> str:
    formatted = getattr(error, "format_message", None)
    return str(formatted()) if formatted else str(error)


def _complain(message: str, status: int = EXIT_BAD_INPUT) -> int:
    text = visible("calib: " + " ".join(message.split()))
    if len(text) > LONGEST_LINE:
        text = f"{text[: LONGEST_LINE - 4]} ..."
    with suppress(OSError, AttributeError):
        # a closed or full standard error has nobody to tell
        encoding = sys.stderr.encoding or "utf-8"
        sys.stderr.write(text.encode(encoding, "backslashreplace").decode(encoding) + "\n")
    return status


if __name__ == "__main__":
    main()
