"""The entry point: parses, calls, and turns known errors into one line and an exit status."""

from __future__ import annotations

import logging
import os
import re
import sys
from collections.abc import Callable, Sequence
from typing import Any, Final

import typer

from calib.cli.commands import build, with_default
from calib.cli.failures import EXIT_FINE, failed, overflow_noted, pipe_closed
from calib.cli.failures import interrupted as interruption
from calib.cli.terminal import INTERRUPTED, KEPT, note

#: where the shell asks for completions, and the words typed so far
_COMPLETE, _COMPLETE_WORDS = "_CALIB_COMPLETE", ("_TYPER_COMPLETE_ARGS", "COMP_WORDS")


#: read by OpenMP, OpenBLAS and MKL when numpy is first imported
BLAS_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


#: seconds since 1970, before the year 10,000
_SECONDS: Final = re.compile(r"\d{1,12}")
LATEST_S: Final = 253_402_300_800


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit with its status: 0 fine, 1 a verdict failed, 2 bad input or usage."""
    sys.exit(run(arguments))


def run(
    arguments: list[str] | None = None, settle: Callable[[], bool] = bool, interrupted: Callable[[], bool] = bool
) -> int:
    """Run the command line and return its exit status.

    ``settle``, called before the last line is printed, and ``interrupted`` tell whether the user interrupted the
    command: libraries may turn an interruption into an error of their own, or let it pass.
    """
    if sys.stdout is None or sys.stderr is None:
        _reopen()
    # figures go to files only, no matter what window system the environment asks for
    os.environ["MPLBACKEND"] = "agg"
    # where HOME cannot be written, it works without its cache and need not say so
    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    _heed_date()
    # thousands of matrices of a few dozen rows: handing each to threads costs more than it saves
    for name in BLAS_THREADS:
        os.environ.setdefault(name, "1")
    kept: list[str] = []
    KEPT.set(kept)
    INTERRUPTED.set(interrupted)
    given = sys.argv[1:] if arguments is None else arguments
    try:
        with overflow_noted():
            status = _invoke(given)
        sys.stdout.flush()
        settle()
    except (typer.Abort, KeyboardInterrupt):
        settle()
        return interruption(kept)
    except SystemExit as error:
        # the printing libraries end the program with 1 where nobody reads on
        if isinstance(error.__context__, BrokenPipeError):
            return pipe_closed()
        raise
    except Exception as error:
        return interruption(kept) if settle() else failed(error, given)
    return status


def _heed_date() -> None:
    """Leave out a SOURCE_DATE_EPOCH that is no time, which the drawing library would stumble over, with a note."""
    given = os.environ.get("SOURCE_DATE_EPOCH")
    if given is None or (_SECONDS.fullmatch(given) and int(given) < LATEST_S):
        return
    del os.environ["SOURCE_DATE_EPOCH"]
    if given:
        note(f"SOURCE_DATE_EPOCH: found {given[:40]!r}; expected whole seconds since 1970; ignored")


def _reopen() -> None:
    """Replace streams that were closed at the start by the null device."""
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
    arguments = with_default(arguments)
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


if __name__ == "__main__":
    main()
