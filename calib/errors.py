"""The one family of errors that users see, how large an input may be, and that no input is written over.

A message says in one line where, what was found, what was expected and what to do. What is too large is refused first.
"""

import os
import re
import stat
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from functools import partial
from pathlib import Path
from typing import Any, Final


class CalibError(Exception):
    """Any failure that is the input's, not the program's; its text is one helpful line."""


class BadInputError(CalibError):
    """An argument or value that cannot be used."""


class BadFileError(BadInputError):
    """A file that cannot be used.

    `found`, `expected`, `remedy`: what stands there, what should, what to do; `row`: line of the file, from 1 on;
    `column`: name of the column or key.
    """

    def __init__(
        self,
        path: Path | str,
        found: str,
        expected: str,
        remedy: str,
        *,
        row: int | None = None,
        column: str | None = None,
    ) -> None:
        where = str(path)
        if row is not None:
            where += f", row {row}"
        if column is not None:
            where += f", column {column}"
        super().__init__(f"{where}: found {found}; expected {expected}; {remedy}")
        self.path, self.row, self.column = str(path), row, column
        self.found, self.expected, self.remedy = found, expected, remedy

    def below(self, folder: Path) -> "BadFileError":
        """Return the same error with the file named by its folder, too."""
        path, of = folder / self.path, {"row": self.row, "column": self.column}
        return BadFileError(path, self.found, self.expected, self.remedy, **of)  # type: ignore[arg-type]


class RefusedError(CalibError):
    """The question cannot be answered from these data; the text says why and what would answer it."""


class ImplausibleError(CalibError):
    """Numbers that cannot be: a check has failed, and what rests on them is refused.

    `findings`: what is beyond its bounds, each with the likely unit or setting.
    """

    def __init__(self, name: str, findings: Sequence[str]) -> None:
        suffix = f" (and {len(findings) - 1} more)" if len(findings) > 1 else ""
        super().__init__(f"{name}: FAILED: {findings[0].rstrip('.')}{suffix}; correct it, or accept it with a reason")
        self.findings = tuple(findings)


class MissingExtraError(CalibError):
    """Something that an optional part of the installation does.

    `what`: what was asked for; `package`: the package that is missing; `extra`: the extra of calib that installs it.
    """

    def __init__(self, what: str, package: str, extra: str) -> None:
        super().__init__(f"{what}: found no package {package}; expected it installed; pip install 'calib[{extra}]'")
        self.extra = extra


def would_overwrite(path: Path | str) -> BadInputError:
    """Return the error for an output that already exists."""
    return BadInputError(f"{path}: found an existing file; expected a new one; give force=True to replace it")


def refused_place(where: str, error: OSError) -> str:
    """Return what the file system refuses, and what to do."""
    found = f"{where}: found {error.strerror or error}; expected"
    if isinstance(error, PermissionError):
        return f"{found} a file or folder that this user may read, or write to; change its rights, or choose another"
    return f"{found} a place that works; choose another, or more room"


def missing_reader(shown: str, what: str, package: str, extra: str) -> BadFileError:
    """Return the error of a format whose package is not installed, with the command that installs it."""
    return BadFileError(
        shown, f"{what}, and no reader for it", package, f"install it with: pip install 'calib[{extra}]'"
    )


def error_words(error: Exception) -> str:
    """Return what a library says of damage on one line; else its kind of error."""
    return " ".join(str(error).split())[:100] or type(error).__name__


@contextmanager
def damage_named(shown: str, what: str, expected: str, remedy: str) -> Iterator[None]:
    """Turn a library's errors on damage into one error with its words.

    What memory, the file system or calib itself refuses is raised as it is.
    """
    try:
        yield
    except (BadFileError, MemoryError, OSError):
        raise
    except Exception as error:
        raise BadFileError(shown, f"{what} that is cut or damaged ({error_words(error)})", expected, remedy) from error


#: a settings file: campaign, mapping, plan, route, seeds (TOML)
SETTINGS_BYTES: Final = 4 << 20
#: parts of a dotted key, and sections or lists within one another
KEY_PARTS: Final = 32
KEY_CHARACTERS: Final = 200
#: a text of a settings file; a report's remark may be long
TEXT_CHARACTERS: Final = 20_000
#: a run id, session, kind, direction, log or reason in a run table, and the name of a campaign
LABEL_CHARACTERS: Final = 500
#: rows of a run table
RUNS: Final = 200_000
#: columns of any table
COLUMNS: Final = 5_000
#: further numeric columns that a diagnosis looks at, each an effect of its own
COVARIATES: Final = 200
#: a workbook: sheets, cells that hold something, empty places between them, bytes unpacked
SHEETS: Final = 200
SHEET_CELLS: Final = 4_000_000
SHEET_EMPTY: Final = 1_000_000
SHEET_UNPACKED_BYTES: Final = 512 << 20
#: a variable of a MATLAB file, unpacked
MATLAB_UNPACKED_BYTES: Final = 2 << 30
#: runs of a plan, or to choose from; samples of each log, slow or long ones at wider steps
PLANNED_RUNS: Final = 1000
PLANNED_SAMPLES: Final = 2000
#: points of a route: 10 km at the 0.05 m of a simulation; and those of all its vehicles
ROUTE_POINTS: Final = 200_000
SIMULATED_POSES: Final = 500_000
#: draws of a Monte Carlo; values of a sweep of loads
DRAWS: Final = 1_000_000
#: pieces of a route driven in a Monte Carlo, all journeys and draws together
DRAWN_PIECES: Final = 200_000_000
SWEEP_VALUES: Final = 10_000
#: a simulated fleet: runs of all vehicles, months; cases of a blind check; processes
FLEET_RUNS: Final = 20_000_000
FLEET_MONTHS: Final = 600
CASES: Final = 100_000
WORKERS: Final = 64

_PART: Final = r"""(?:[A-Za-z0-9_-]++|"[^"\n]*+"|'[^'\n]*+')"""
#: a key of too many parts; possessive, so that the search takes one pass
_DEEP: Final = re.compile(rf"(?<![A-Za-z0-9_.-]){_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{{KEY_PARTS}}}")


def refuse_beyond(
    count: int, most: int, *, shown: str, what: str, remedy: str, row: int | None = None, column: str | None = None
) -> None:
    """Refuse a `count` of `what` (``runs``) above `most`, in the file `shown`; see `BadFileError`."""
    if count > most:
        raise BadFileError(shown, f"{count} {what}", f"at most {most}", remedy, row=row, column=column)


def refuse_more(name: str, count: float, most: int, remedy: str) -> None:
    """Raise BadInputError where more of `name` (``draws``) is asked for than there may be, or no number."""
    if not count <= most:
        raise BadInputError(f"{name}: found {count:.15g}; expected at most {most}; {remedy}")


def refuse_workers(workers: int) -> None:
    """Refuse more processes than `WORKERS` and twice the processors of this machine: each takes memory of its own.

    Raises BadInputError where there are more.
    """
    refuse_more("workers", workers, max(WORKERS, 2 * (os.cpu_count() or 1)), "one a processor is enough")


def refuse_hostile_keys(text: str, shown: str) -> None:
    """Refuse TOML with too long a dotted key, whose parsing takes the square of its length.

    Raises BadFileError with the row.
    """
    if deep := _DEEP.search(text):
        actual, expected = f"a key of more than {KEY_PARTS} parts ({deep.group()[:20]}...)", f"at most {KEY_PARTS}"
        row = text.count("\n", 0, deep.start()) + 1
        raise BadFileError(shown, actual, expected, "correct the line", row=row)


def refuse_other_than_date(text: str, first_year: int = 1) -> None:
    """Raise BadInputError where a text is no date as YYYY-MM-DD, from a year on."""
    from datetime import date

    try:
        fine = len(text) == len("YYYY-MM-DD") and date.fromisoformat(text).year >= first_year
    except ValueError:
        fine = False
    if not fine:
        raise BadInputError(f"date: found {text!r}; expected a date as YYYY-MM-DD; for example 2025-03-31")


def refuse_hostile_document(document: dict[str, object], shown: str) -> None:
    """Refuse a settings document with keys, texts or a nesting beyond all use.

    Raises BadFileError with the key.
    """
    level: list[tuple[str, Any]] = list(document.items())
    for _ in range(KEY_PARTS):
        deeper: list[tuple[str, Any]] = []
        for key, value in level:
            refuse = partial(refuse_beyond, shown=shown, remedy="shorten it", column=key[-60:])
            refuse(len(key.rpartition(".")[2]), KEY_CHARACTERS, what="characters in a key")
            if isinstance(value, str):
                refuse(len(value), TEXT_CHARACTERS, what="characters")
            elif isinstance(value, dict):
                deeper += [(f"{key}.{inner}", entry) for inner, entry in value.items()]
            elif isinstance(value, list):
                deeper += [(key, entry) for entry in value]
        level = deeper
    if level:
        actual, expected = f"sections or lists more than {KEY_PARTS} deep", f"at most {KEY_PARTS}"
        raise BadFileError(shown, actual, expected, "correct the key", column=level[0][0][:60])


#: entries of an input folder searched for a hard link to the target; beyond, it is refused
MOST_SEARCHED: Final = 200_000
#: files that calib writes and never reads as measurements: replaced in an input folder, too
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
    for path in _INPUTS.get():
        if _is_input(Path(target), path):
            raise BadInputError(
                f"{target}: found an input of this command ({path}); expected another place for the output, since "
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


def _is_input(target: Path, path: Path) -> bool:
    try:
        at, source = target.stat(), path.stat()
    except (OSError, ValueError, RuntimeError):
        return False  # what does not exist cannot be overwritten
    if not stat.S_ISDIR(source.st_mode):
        return os.path.samestat(at, source) and stat.S_ISREG(at.st_mode)
    if stat.S_ISDIR(at.st_mode):
        return False
    if at.st_nlink > 1 and _is_linked_from(path, at):
        return True
    real = target.resolve()
    between: list[Path] = []
    for parent in real.parents:
        if os.path.samestat(parent.stat(), source):
            return _is_data(real, between)
        between.append(parent)
    return False


def _is_data(path: Path, between: list[Path]) -> bool:
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
