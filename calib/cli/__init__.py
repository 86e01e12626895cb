"""The command line: one file a group of commands that parse, call and show, imported when one is called.

Here their list, shared options, and blocks on the terminal: as wide as it is, coloured only where it is one.
"""

import difflib
import importlib
import math
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from shutil import get_terminal_size
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from calib.errors import BadInputError
from calib.io import refuse_existing, write_bytes, write_json, write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from calib.reporting import Block, Section


#: command or group -> its line in ``calib --help``, in this order; the list imports none of them
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


#: commands of one word that share a module, each the function of its name
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
    """Return what a command calls: the function of its name, or ``run`` of its own module."""
    function = name.rpartition(" ")[2] if name in TOGETHER or " " in name else "run"
    called: Callable[..., Any] = getattr(importlib.import_module(module_of(name)), function)
    return called


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


#: what the command at work has written so far, for the line after an interruption
KEPT: Final[ContextVar[list[str]]] = ContextVar("kept")
#: whether the user has interrupted the command, also where a library took that for its own error
INTERRUPTED: Final[ContextVar[Callable[[], bool]]] = ContextVar("interrupted")

#: widest line, so that sentences can be read on a wide screen
MOST_COLUMNS: Final = 110
FEWEST_COLUMNS: Final = 40
USUAL_COLUMNS: Final = 80
#: columns of a progress bar; with the longest stage it fits into 80
BAR_COLUMNS: Final = 24
_STYLES: Final = {"heading": "bold", "caption": "bold", "dim": "dim", "good": "green", "note": "yellow", "bad": "red",
                  "simulated": "magenta"}  # fmt: skip
_ASCII: Final = str.maketrans(
    {"µ": "u", "±": "+-", "–": "-", "—": "-", "…": "...", "°": "deg ", "─": "-", "₀": "0", "ₒ": "_O", "²": "^2",
     "χ": "chi", "λ": "lambda", "π": "pi", "ν": "dof", "×": "x", "∞": "inf"}
)  # fmt: skip

#: C0 and C1 controls, the line's own end not among them; shown as escapes
_CONTROLS: Final = {code: f"\\x{code:02x}" for code in (*range(32), *range(127, 160))}
#: overrides of direction, line separators, invisible marks, half pairs of names that are no UTF-8
_STEERING: Final = re.compile("[\u200b\u200e\u200f\u2028-\u202e\u2060\u2066-\u2069\ufeff\ud800-\udfff]")


#: ``--json`` and ``--force`` of the command at work
JSON_TARGET: Final[ContextVar[str | None]] = ContextVar("json_target", default=None)
FORCE: Final[ContextVar[bool]] = ContextVar("force", default=False)
#: whether standard output has its JSON
WRITTEN: Final[ContextVar[bool]] = ContextVar("written", default=False)
#: whether nobody reads the output any more; the command goes on, for its files
CLOSED: Final[ContextVar[bool]] = ContextVar("closed", default=False)


def wants_stdout() -> bool:
    """Return whether standard output belongs to the JSON alone."""
    return JSON_TARGET.get() == "-"


def forced() -> bool:
    """Return whether existing output files are replaced."""
    return FORCE.get()


def _heed() -> None:
    if INTERRUPTED.get(bool)():
        raise KeyboardInterrupt


def refuse_options(how: str, options: Mapping[str, object]) -> None:
    """Refuse options that were given though nothing would use them; `how`: ``without --sweep``, or ``with``."""
    for name, value in options.items():
        if value is not None and value is not False and value != "":
            word, _, other = how.partition(" ")
            expected = f"{other} beside it" if word == "without" else "none, since it has no effect there"
            raise BadInputError(f"{name}: found {how}; expected {expected}; leave it out")


def refuse_outputs(*targets: Path | None, figures: Path | None = None, names: Iterable[str] = ()) -> None:
    """Refuse output files, that of ``--json`` too, before the work; see `calib.io.refuse_existing`.

    `figures`, `names`: folder of figures, if any, and their names.
    """
    drawn: list[Path] = []
    if figures is not None:
        from calib.reporting.figures import figure_paths

        drawn = figure_paths(figures, names)
    refuse_existing([JSON_TARGET.get(), *targets, *drawn], force=forced())


def emit_json(value: Any) -> None:
    """Write `value` as JSON where ``--json`` says; nothing without it."""
    from calib.documents import to_json

    target = JSON_TARGET.get()
    if target is None:
        return
    if target == "-":
        try:
            text = to_json(value)
        except ValueError as error:
            raise BadInputError(f"the result holds a number that JSON cannot say ({error})") from error
        WRITTEN.set(True)
        _put(sys.stdout, text, lambda: to_json(value, ascii_only=True))
    else:
        write_json(Path(target), value, force=forced())


def emit_text(text: str) -> None:
    """Write a file's text to standard output; nothing in it steers the terminal."""
    text = "\n".join(map(visible, text.split("\n")))
    encoding = getattr(sys.stdout, "encoding", None) or "utf-8"
    try:
        text.encode(encoding)
    except UnicodeEncodeError:
        import json

        # JSON's escapes, which YAML and TOML read as well
        text = "".join(sign if ord(sign) < 128 else json.dumps(sign)[1:-1] for sign in text)
    _put(sys.stdout, text)


def show(blocks: "Iterable[Block | Section]") -> None:
    """Print blocks for people; to standard error where standard output belongs to JSON."""
    from calib.reporting.formatting import text_lines

    _heed()
    stream = sys.stderr if wants_stdout() else sys.stdout
    lines = text_lines(blocks, min(max(get_terminal_size((USUAL_COLUMNS, 24)).columns, FEWEST_COLUMNS), MOST_COLUMNS))
    if stream.isatty() and "NO_COLOR" not in os.environ and os.environ.get("TERM") != "dumb":
        from rich.console import Console
        from rich.text import Text

        console = Console(file=stream, highlight=False, soft_wrap=True)
        for line in lines:
            console.print(Text(visible(line.text), style=_STYLES.get(line.style, "")))
        return
    for line in lines:
        _write(stream, line.text.rstrip())


def answer(document: Any, blocks: "Iterable[Block | Section]") -> None:
    """Write a result as JSON where asked for; print it unless standard output is the JSON's."""
    emit_json(document)
    if not wants_stdout():
        show(blocks)


def say(text: str) -> None:
    """Print a sentence for people over as many lines as it takes."""
    from calib.reporting import Text

    show([Text(text)] if text else [])


def then(step: str, *, aside: bool = False, **names: str | Path | Iterable[str | Path]) -> None:
    """Print what to do now (see `next_step`) as one line, so that its command can be copied.

    `aside`: always on standard error.
    """
    from calib.reporting import next_step

    if not CLOSED.get():
        _write(sys.stderr if aside or wants_stdout() else sys.stdout, next_step(step, **names))


def note(text: str) -> None:
    """Print a remark on standard error."""
    _write(sys.stderr, f"calib: note: {text}")


def wrote(paths: Iterable[Path | str], *, what: str = "") -> None:
    """Say which files were written, or `what` many are, and keep that for an interruption."""
    stream = sys.stderr if wants_stdout() else sys.stdout
    for text in [what] if what else [str(path) for path in paths]:
        _write(stream, f"wrote {text}")
        keep(text)


def save(path: Path | None, content: Any) -> None:
    """Write bytes, a text or what becomes JSON to a file, where one is named, and say so."""
    if path is not None:
        write = write_bytes if isinstance(content, bytes) else write_text if isinstance(content, str) else write_json
        wrote([write(path, content, force=forced())])


def draw(folder: Path | None, figures: "Callable[[], Mapping[str, Figure]]", *, simulated: bool = False) -> list[Path]:
    """Draw figures and write them into a folder, where one is named; return their files."""
    if folder is None:
        return []
    from calib.reporting.figures import write_figures

    with progress("drawing") as tick:
        written = write_figures(figures(), folder, simulated=simulated, force=forced(), progress=tick)
    wrote(written, what=f"{len(written)} figure files to {folder}" if written else "no figure")
    return written


def keep(text: str) -> None:
    """Note what stays if the command is interrupted from now on."""
    KEPT.get([]).append(text)


@contextmanager
def progress(what: str) -> Iterator[Callable[[int, int, str], None]]:
    """Give a function ``(done, total, stage)`` that shows progress on standard error, where that is a terminal.

    Before the first stage a sign of life alone is shown; a total of 0 means that nobody knows it.
    """
    if not sys.stderr.isatty():
        yield lambda _done, _total, _stage: _heed()
        _heed()
        return
    from rich import progress as bars
    from rich.console import Console

    columns = (
        bars.SpinnerColumn(),
        bars.TextColumn("{task.description}", markup=False),
        bars.BarColumn(bar_width=BAR_COLUMNS),
        bars.MofNCompleteColumn(),
        bars.TimeElapsedColumn(),
        bars.TimeRemainingColumn(compact=True),
    )
    with bars.Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=None)
        at: list[str] = [""]

        def tick(done: int, total: int, stage: str) -> None:
            _heed()
            if stage != at[0]:
                at[0] = stage
                bar.reset(task, description=f"{what}: {stage}", total=total or None, completed=done)
            bar.update(task, completed=done, total=total or None)

        yield tick
    _heed()


def visible(text: str) -> str:
    """Return a text whose controls, overrides of direction and half pairs are shown."""
    return _STEERING.sub(
        lambda match: match.group().encode("ascii", "backslashreplace").decode("ascii"), text
    ).translate(_CONTROLS)


def _write(stream: Any, text: str) -> None:
    text = visible(text) + "\n"
    _put(stream, text, lambda: text.translate(_ASCII).encode("ascii", "replace").decode("ascii"))


def _put(stream: Any, text: str, other: Callable[[], str] = str) -> None:
    try:
        try:
            stream.write(text)
        except UnicodeEncodeError:
            stream.write(other())
        stream.flush()
    except BrokenPipeError:
        drop(stream)


def drop(stream: Any) -> None:
    """Let a stream that nobody reads lead nowhere."""
    CLOSED.set(True)
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


#: of options that may be left away
Place = Path | None
Text = str | None
Texts = list[str] | None
Count = int | None
Number = float | None
Numbers = list[float] | None


def opt(metavar: str | None, text: str, *names: str, **limits: Any) -> Any:
    """Return an option; `metavar`: None for a switch, or what is called by its type."""
    return typer.Option(*names, metavar=metavar, help=text, **limits)


def arg(metavar: str | None, text: str) -> Any:
    """Return an argument."""
    return typer.Argument(metavar=metavar, help=text)


JsonTarget = Annotated[Text, opt("FILE", "Write the result as JSON to FILE; '-' is standard output.", "--json")]
MappingOption = Annotated[Place, opt("FILE", "TOML that maps a recording or table, read as if ingested.", "--mapping")]
CampaignOrRecording = Annotated[Path, arg("CAMPAIGN", "Folder with campaign.toml and runs.csv, or a recording.")]
Figures = Annotated[Place, opt("FOLDER", "Write the figures there as PNG, SVG and PDF.", "--figures")]
Date = Annotated[Text, opt("YYYY-MM-DD", "Date of issue; without it: today. Fixes the bytes of the PDF.", "--date")]
Force = Annotated[bool, opt(None, "Replace existing output files.", "--force")]
_ACCEPTED = "Pass on a law that is beyond the bounds of its vehicle; the reason is written into the file."
AcceptImplausible = Annotated[str, opt("REASON", _ACCEPTED, "--accept-implausible")]
Workers = Annotated[int, opt("N", "Processes of this machine.", "--workers", min=1)]
Seed = Annotated[int, opt("N", "Seed of the random numbers.", "--seed")]


def numbers(text: str, count: int | None, name: str) -> tuple[float, ...]:
    """Return the numbers of a text such as ``300,1100``, `count` of them; None: one or more."""
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if not values or (count is not None and len(values) != count) or not all(map(math.isfinite, values)):
        wanted = f"{count} numbers" if count else "numbers"
        raise BadInputError(f"{name}: found {text!r:.60}; expected {wanted} separated by commas; write them as 1.5,2")
    return values


def nearest(word: str, known: Iterable[str]) -> str:
    """Return ``; did you mean 'x'?`` for the known words that are near, else an empty text."""
    near = difflib.get_close_matches(word, list(known))
    return f"; did you mean {' or '.join(repr(name) for name in near)}?" if near else ""
