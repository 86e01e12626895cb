"""The entry point: parses, calls, and turns known errors into one line and an exit status.

For all commands: inputs are never written.
"""

import errno
import itertools
import logging
import os
import re
import signal
import sys
import warnings
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any, Final

import typer
from typer.core import TyperCommand

from calib import cli
from calib.cli import COMMANDS, SUMMARIES, command_called, note, with_default
from calib.documents import to_json
from calib.errors import BadInputError, CalibError, ImplausibleError, inputs_kept, refuse_special, refused_place
from calib.io import refuse_empty

EXIT_FINE: Final = 0
EXIT_FAILED: Final = 1
EXIT_BAD_INPUT: Final = 2
EXIT_BUG: Final = 3
EXIT_INTERRUPTED: Final = 128 + signal.SIGINT
EXIT_PIPE_CLOSED: Final = 141
#: characters of the line about an error, which may quote data
LONGEST_LINE: Final = 2000

#: parameters that say where something is written; every other path is an input
OUTPUTS: Final = frozenset({"into", "output", "json", "figures", "apply", "html", "tum", "plot"})
#: commands with further outputs
ALSO: Final[dict[str, frozenset[str]]] = {"init": frozenset({"folder"}), "make": frozenset({"truth"})}


@cache
def _shared_options() -> list[Any]:
    application = typer.Typer(add_completion=False)

    @application.command()
    def shared(json: cli.JsonTarget = None, force: cli.Force = False) -> None:
        """Declare them."""

    return list(typer.main.get_command(application).params)


class Guarded(TyperCommand):
    """A command with ``--json`` and ``--force``, whose inputs are never written."""

    def __init__(self, *args: Any, params: list[Any] | None = None, **kwargs: Any) -> None:
        super().__init__(*args, params=[*(params or ()), *_shared_options()], **kwargs)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the words of a command line, none of whose paths may be empty."""
        _refuse_empty(self.params, args)
        return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Run the command with its inputs kept, where the JSON can be written."""
        # the drawing library works without a cache
        logging.getLogger("matplotlib").setLevel(logging.ERROR)
        _refuse_dash(ctx)
        paths = list(dict.fromkeys(_inputs(ctx.params, OUTPUTS | ALSO.get(str(ctx.info_name), frozenset()))))
        for path in paths:
            refuse_special(path)
        seed = ctx.params.get("seed")
        if isinstance(seed, int) and not 0 <= seed < 2**63:
            raise BadInputError(f"--seed: found {seed}; expected a whole number from 0 on; choose another")
        cli.JSON_TARGET.set(ctx.params.pop("json"))
        cli.FORCE.set(ctx.params.pop("force"))
        with inputs_kept(paths):
            cli.refuse_outputs()
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


def options_of(name: str) -> set[str]:
    """Return the options of a command, long and short."""
    application = typer.Typer(add_completion=False)
    application.command(name, cls=Guarded)(cli.function_of(name))
    return {option for parameter in typer.main.get_command(application).params for option in parameter.opts}


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
            parents[group] = typer.Typer(rich_markup_mode=None, epilog=cli.GROUPS[group])
            application.add_typer(parents[group], name=group, help=SUMMARIES[group])
        if words is None or words[: len(name.split())] == name.split():
            parents[group].command(inner, cls=Guarded)(cli.function_of(name))
        else:  # not called, and not imported
            parents[group].command(inner, cls=Guarded, help=SUMMARIES[name])(lambda: None)
    return application


def interruption(kept: list[str]) -> int:
    """Print what an interrupted command has kept, and return the exit status for it."""
    held = f"kept: {'; '.join(kept)}" if kept else "nothing was written"
    return _complain(f"interrupted; {held}, and nothing half-written is left", EXIT_INTERRUPTED)


def failed(error: Exception, words: list[str]) -> int:
    """Print in one line what went wrong, and return the exit status for it.

    Where standard output belongs to JSON, and has none yet, it gets ``{"error": ..., "exit_status": ...}``.
    """
    if isinstance(error, BrokenPipeError):
        return _pipe_closed()
    if type(error).__name__ == "NoArgsIsHelpError":
        sys.stderr.write(_message(error) + "\n")
        return EXIT_BAD_INPUT
    message, status = _explained(error, words)
    if ("--json=-" in words or ("--json", "-") in itertools.pairwise(words)) and not cli.WRITTEN.get():
        with suppress(OSError, ValueError):
            sys.stdout.write(to_json({"error": " ".join(message.split()), "exit_status": status}))
            sys.stdout.flush()
    return _complain(message, status)


def _explained(error: Exception, words: list[str]) -> tuple[str, int]:
    if isinstance(error, ImplausibleError):
        return f"{error} ('calib geometry', 'export' and 'report' take --accept-implausible REASON)", EXIT_FAILED
    if isinstance(error, CalibError):
        name = command_called(with_default(words))
        message = as_typed(str(error), options_of(name) if name else ())
        return message + _nearest_path(str(error), words), EXIT_BAD_INPUT
    if isinstance(error, typer.TyperException):
        return _usage(error), EXIT_BAD_INPUT
    if os.environ.get("CALIB_TRACEBACK"):
        raise error
    refused = _machine_refused(error)
    if refused:
        return refused, EXIT_BAD_INPUT
    return f"bug in calib, please report: {type(error).__name__}: {error} (CALIB_TRACEBACK=1 shows where)", EXIT_BUG


def _nearest_path(message: str, words: list[str]) -> str:
    for word in words:
        path = Path(word)
        with suppress(OSError, ValueError):
            absent = path.parent.is_dir() and not path.exists()
            if path.name and absent and message.startswith(f"{path}: found no such"):
                if path.is_symlink():
                    return "; this is a symbolic link that leads nowhere"
                return cli.nearest(path.name, (beside.name for beside in path.parent.iterdir()))
    return ""


def _machine_refused(error: Exception) -> str:
    if isinstance(error, UnicodeEncodeError):
        lacking = f"found characters that the encoding {error.encoding} lacks"
        return f"output: {lacking}; expected UTF-8; set PYTHONUTF8=1"
    if isinstance(error, OverflowError | RecursionError):
        beyond = f"found a number or a nesting beyond all bounds ({error})"
        return f"{beyond}; expected numbers of ordinary size; correct the input"
    if type(error).__name__ == "LinAlgError":
        beyond = f"found numbers that differ too much in size to compute with ({error})"
        return f"{beyond}; expected numbers of ordinary size; hold the campaign against 'calib check'"
    if isinstance(error, OSError) and error.errno != errno.ENOMEM:
        named = isinstance(error.filename, str | bytes)
        return refused_place(os.fsdecode(error.filename) if named else "standard output, or a temporary file", error)
    if isinstance(error, MemoryError | OSError):
        return "out of memory; expected a campaign that fits; give fewer or shorter runs, or allow more (ulimit -v)"
    if isinstance(error, ImportError) and _NO_ROOM.search(str(error)):
        why = str(error).rpartition("Original error was: ")[2].strip().partition("\n")[0]
        return f"out of memory; found no room for a library ({why}); allow more address space (ulimit -v)"
    return ""


def _usage(error: Exception) -> str:
    message, context = _message(error), getattr(error, "ctx", None)
    if context is None:
        return message
    if message == "Missing command.":
        message = f"Missing command: one of {', '.join(context.command.list_commands(context))}"
    words = context.command_path.split()
    option = getattr(error, "option_name", "")
    own = " ".join(words[1:])
    beside = [name for name in COMMANDS if len(words) == 3 and name.startswith(f"{words[1]} ") and name != own]
    takers = [f"'calib {name}'" for name in beside if option and option in options_of(name)]
    message += f"; {' and '.join(takers)} {'has' if len(takers) == 1 else 'have'} it" if takers else ""
    return f"{message} (see '{context.command_path} --help')"


def _pipe_closed() -> int:
    cli.drop(sys.stdout)
    return EXIT_PIPE_CLOSED


def _message(error: Exception) -> str:
    formatted = getattr(error, "format_message", None)
    return str(formatted()) if formatted else str(error)


def _complain(message: str, status: int = EXIT_BAD_INPUT) -> int:
    text = cli.visible("calib: " + " ".join(message.split()))
    if len(text) > LONGEST_LINE:
        text = f"{text[: LONGEST_LINE - 4]} ..."
    with suppress(OSError, AttributeError):
        encoding = sys.stderr.encoding or "utf-8"
        sys.stderr.write(text.encode(encoding, "backslashreplace").decode(encoding) + "\n")
    return status


#: what a loader says where address space is short
_NO_ROOM: Final = re.compile(r"failed to map segment|[Cc]annot allocate memory|cannot apply additional memory")
_LEADING = re.compile(r"^([a-z][a-z_]*)(?=: )")
_FLAG = re.compile(r"\bforce=True\b")


def as_typed(message: str, options: Collection[str]) -> str:
    """Return a message of the library (``draws: found 0; ...``) with the option as typed."""
    named = _LEADING.match(message)
    if named and f"--{named[1].replace('_', '-')}" in options:
        message = f"--{named[1].replace('_', '-')}{message[named.end() :]}"
    return _FLAG.sub("--force", message)


@contextmanager
def overflow_noted() -> Iterator[None]:
    """Print one note on numeric overflow in place of a library's warnings."""
    overflows: list[str] = []
    with warnings.catch_warnings():
        before = warnings.showwarning

        def kept(message: Warning | str, category: type[Warning], *where: Any, **extra: Any) -> None:
            if issubclass(category, RuntimeWarning) or category.__module__.startswith("statsmodels"):
                overflows.append(str(message))
            else:
                before(message, category, *where, **extra)

        warnings.showwarning = kept
        yield
    if overflows:
        what = ", ".join(dict.fromkeys(text.partition(" encountered")[0] for text in overflows))
        note(f"some numbers are too large, too small or missing to compute with ({what:.100})")


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

    ``settle``, called before the last line is printed, and ``interrupted`` tell whether the user interrupted: libraries
    may turn that into an error of their own, or let it pass.
    """
    _reopen()
    # figures go to files only, in any environment
    os.environ["MPLBACKEND"] = "agg"
    _heed_date()
    # thousands of small matrices: threads cost more than they save
    for name in BLAS_THREADS:
        os.environ.setdefault(name, "1")
    kept: list[str] = []
    cli.KEPT.set(kept)
    cli.INTERRUPTED.set(interrupted)
    cli.CLOSED.set(False)
    cli.WRITTEN.set(False)
    words = sys.argv[1:] if arguments is None else arguments
    try:
        with overflow_noted():
            status = _invoke(words)
        sys.stdout.flush()
        settle()
    except (typer.Abort, KeyboardInterrupt):
        settle()
        return interruption(kept)
    except SystemExit as error:
        # the printing libraries end the program with 1 where nobody reads on
        if isinstance(error.__context__, BrokenPipeError):
            return _pipe_closed()
        raise
    except Exception as error:
        return interruption(kept) if settle() else failed(error, words)
    return EXIT_PIPE_CLOSED if cli.CLOSED.get() else status


def _heed_date() -> None:
    text = os.environ.get("SOURCE_DATE_EPOCH")
    if text is None or (_SECONDS.fullmatch(text) and int(text) < LATEST_S):
        return
    del os.environ["SOURCE_DATE_EPOCH"]
    if text:
        note(f"SOURCE_DATE_EPOCH: found {text[:40]!r}; expected whole seconds since 1970; ignored")


def _reopen() -> None:
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_WRONLY), "w", encoding="utf-8"))


def _invoke(arguments: list[str]) -> int:
    if _COMPLETE in os.environ:
        typed = next((os.environ[name].split() for name in _COMPLETE_WORDS if name in os.environ), [])
        build(typed[1:])(args=arguments, prog_name="calib", standalone_mode=False)
        return EXIT_FINE
    arguments = with_default(arguments)
    command = command_of(arguments)
    try:
        with command.make_context("calib", arguments) as context:
            result = command.invoke(context)
    except typer.Exit as ended:
        return ended.exit_code
    return result if isinstance(result, int) else EXIT_FINE


def command_of(arguments: Sequence[str]) -> Any:
    """Return the parser of a command line, with what is to be called."""
    return typer.main.get_command(build(arguments))


if __name__ == "__main__":
    main()
