"""The door: builds the command line, and turns known errors into one line and an exit status."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Sequence
from typing import Final

import typer

from calib.errors import CalibError

__all__ = ["app", "main"]

EXIT_FINE: Final = 0
EXIT_BAD_INPUT: Final = 2
EXIT_BUG: Final = 3

#: command -> module under ``calib.cli``; adding a command means adding one file and one line here
COMMANDS: Final[dict[str, str]] = {
    "export": "export",
    "check": "check",
    "ingest": "ingest",
    "fit": "fit",
    "deviation": "deviation",
    "report": "report",
    "loads": "loads",
    "challenge": "challenge",
    "simulate": "simulate",
    "diagnose": "diagnose",
    "plan": "plan",
}

#: command -> its line in ``calib --help``, so that the list of commands imports none of them
SUMMARIES: Final[dict[str, str]] = {
    "check": "Say what a campaign holds and what is wrong.",
    "ingest": "Make a campaign out of raw lab files.",
    "fit": "Fit each wheel's radius against its load.",
    "deviation": "Show what a woven path does to a radius.",
    "report": "Write the calibration report as PDF.",
    "export": "Write coefficients for vehicle or controller.",
    "loads": "Compute static wheel loads from a payload.",
    "simulate": "Simulate a route on odometry, load by load.",
    "geometry": "Estimate radii and track from end poses.",
    "diagnose": "Say why the simulation differs from reality.",
    "plan": "Say which runs to drive next.",
    "challenge": "Check the diagnosis blind, on sealed cases.",
    "fleet": "Calibrate many vehicles at once.",
}


def build(arguments: Sequence[str] | None = None) -> typer.Typer:
    """Return the application.

    Parameters
    ----------
    arguments : sequence of str, optional
        With a command's name in it, only that command is imported; with none, names and summaries alone. Without
        arguments every command is there in full. A command's heavy imports happen inside its body.
    """
    application = typer.Typer(
        name="calib",
        no_args_is_help=True,
        add_completion=False,
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
        help="Calibrate a vehicle's wheel odometry, and find out why its simulation is wrong.",
    )

    @application.callback(invoke_without_command=True)
    def root(version: bool = typer.Option(False, "--version", help="Show the version and exit.")) -> None:
        if version:
            from calib import __version__

            typer.echo(f"calib {__version__}")
            raise typer.Exit

    asked = next((one for one in arguments or () if not one.startswith("-")), None)
    order = [*(name for name in SUMMARIES if name in COMMANDS), *(name for name in COMMANDS if name not in SUMMARIES)]
    for name in order:
        if arguments is not None and asked != name and name in SUMMARIES:
            application.command(name, help=SUMMARIES[name])(_elsewhere)
        else:
            importlib.import_module(f"calib.cli.{COMMANDS[name]}").register(application, name)
    return application


def _elsewhere() -> None:
    """Stand in the list of commands for one that was not asked for."""


def app() -> typer.Typer:
    """Return the application (for documentation tools and tests)."""
    return build()


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit with its status: 0 fine, 1 a verdict failed, 2 bad input or usage."""
    sys.exit(run(arguments))


def run(arguments: list[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    try:
        given = sys.argv[1:] if arguments is None else arguments
        result = build(given)(args=given, prog_name="calib", standalone_mode=False)
    except CalibError as error:
        return _complain(str(error))
    except typer.TyperException as error:
        if type(error).__name__ == "NoArgsIsHelpError":
            sys.stderr.write(_message(error) + "\n")
            return EXIT_BAD_INPUT
        context = getattr(error, "ctx", None)
        return _complain(_message(error) + (f" (see '{context.command_path} --help')" if context else ""))
    except (typer.Abort, KeyboardInterrupt):
        return _complain("interrupted; nothing half-written was left behind")
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_FINE
    except MemoryError:
        return _complain("out of memory; expected a campaign that fits; give fewer runs or shorter logs")
    except Exception as error:
        if os.environ.get("CALIB_TRACEBACK"):
            raise
        _complain(f"bug in calib, please report: {type(error).__name__}: {error} (CALIB_TRACEBACK=1 shows where)")
        return EXIT_BUG
    return result if isinstance(result, int) else EXIT_FINE


def _message(error: Exception) -> str:
    formatted = getattr(error, "format_message", None)
    return str(formatted()) if formatted else str(error)


def _complain(message: str) -> int:
    sys.stderr.write("calib: " + " ".join(message.split()) + "\n")
    return EXIT_BAD_INPUT


if __name__ == "__main__":
    main()
