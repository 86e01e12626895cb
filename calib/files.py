"""Writing whole files, staying inside a folder, hashing."""

from __future__ import annotations

import hashlib
import json
import os
import stat
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final

from calib.errors import BadFileError, BadInputError, would_overwrite
from calib.inputs import refuse_input
from calib.leftovers import sweep, temporary_beside

_STREAMS: Final = frozenset({"/dev/stdout", "/dev/stderr"})


def write_bytes(path: Path, data: bytes, *, force: bool = False) -> Path:
    """Write `data` to `path` whole: to a temporary file beside it, then renamed.

    `path`: target; its folder is made where missing. Raises BadInputError where the path is an input of the command at
    work, the file exists and `force` is False, or the folder cannot be written. A device or a FIFO is written to and
    never replaced.
    """
    path = Path(path)
    try:
        refuse_input(path)
        if _is_stream(path):
            _pour(path, data)
            return path
        refuse_existing([path], force=force)
        path.parent.mkdir(parents=True, exist_ok=True)
        sweep(path)
        temporary = temporary_beside(path)
        try:
            with temporary.open("xb") as out:
                out.write(data)
            temporary.chmod(0o644)
            _put(temporary, path, force=force)
        finally:
            temporary.unlink(missing_ok=True)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise BadInputError(f"{path}: found {reason}; expected a writable place; choose another path") from error
    return path


def _put(temporary: Path, path: Path, *, force: bool) -> None:
    """Give a whole file its name; without `force` a file that another writer put there meanwhile is kept."""
    if force:
        temporary.replace(path)
        return
    try:
        os.link(temporary, path)
    except FileExistsError:
        raise would_overwrite(path) from None
    except OSError:
        # a file system without links
        temporary.replace(path)


def _is_stream(path: Path) -> bool:
    """Return whether a path is a device, a FIFO, or an open stream of this process, which is written to as it is."""
    if str(path) in _STREAMS or path.parent == Path("/dev/fd"):
        return True
    try:
        mode = path.stat().st_mode
    except OSError:
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))


def _pour(path: Path, data: bytes) -> None:
    # appended, so that a file behind /dev/stdout keeps what it holds
    with path.open("ab", buffering=0) as out:
        view = memoryview(data)
        while view:
            view = view[out.write(view) :]


def refuse_existing(targets: Iterable[Path | str | None], *, force: bool = False) -> None:
    """Refuse targets that cannot be written, before the work is done.

    `targets`: where files will go; None and ``-`` are no files. Raises BadInputError where a target is an input, or
    exists and `force` is False.
    """
    for target in targets:
        if target is None or str(target) == "-":
            continue
        path = Path(target)
        refuse_input(path)
        try:
            os.lstat(path)
            if path.is_dir():
                raise BadInputError(f"{path}: found a folder; expected a file to write; name a file in it")
            if not force and not _is_stream(path):
                raise would_overwrite(path)
        except FileNotFoundError:
            continue
        except OSError as error:
            # a file where a folder should be, a name that is too long, a folder that may not be looked into
            raise BadInputError(
                f"{path}: found {error.strerror}; expected a place for a file; choose another path"
            ) from error
        except ValueError as error:
            raise BadInputError(f"{path}: found {error}; expected a path; correct it") from error


def write_text(path: Path, text: str, *, force: bool = False) -> Path:
    """Write UTF-8 `text` to `path` whole; see `write_bytes`."""
    return write_bytes(path, text.encode("utf-8", "backslashreplace"), force=force)


def to_json(value: Any, *, ascii_only: bool = False) -> str:
    """Return `value` as indented JSON with a final newline; NaN and infinity are refused, never written.

    `value`: plain values, numpy's among them; `ascii_only`: write other characters as escapes, as is always done where
    one has no UTF-8 (half a pair).
    """
    text = json.dumps(value, indent=2, ensure_ascii=ascii_only, allow_nan=False, default=_plain) + "\n"
    try:
        text.encode("utf-8")
    except UnicodeEncodeError:
        return to_json(value, ascii_only=True)
    return text


def spreadsheet_cell(value: Any) -> Any:
    """Return a cell that a spreadsheet shows and never computes: a text that begins like a formula gets a quote.

    `value`: of a table meant for spreadsheets. Numbers stay numbers, also those written as texts.
    """
    if not isinstance(value, str) or not value.startswith(("=", "+", "-", "@", "\t", "\r")):
        return value
    try:
        float(value)
    except ValueError:
        return f"'{value}"
    return value


def csv_text(columns: Sequence[str], rows: Iterable[Iterable[Any]]) -> str:
    """Return a table for people and spreadsheets as CSV; every one that calib writes for them is written here.

    `columns`: names of the columns; `rows`: cells; None is an empty one, and no cell is a formula (`spreadsheet_cell`).
    """
    import csv
    import io

    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([spreadsheet_cell(name) for name in columns])
    writer.writerows([spreadsheet_cell(cell) for cell in row] for row in rows)
    return text.getvalue()


def _plain(value: Any) -> Any:
    """Return a numpy scalar (a bool or an integer of an array, say) as Python's own."""
    if hasattr(value, "item"):
        return value.item()
    raise TypeError(f"{type(value).__name__} has no JSON form")


def write_json(path: Path, value: Any, *, force: bool = False) -> Path:
    """Write `value` as JSON to `path` whole; see `write_bytes`."""
    return write_text(path, to_json(value), force=force)


def inside(
    root: Path, relative: str, *, named_in: Path | str, row: int | None = None, column: str | None = None
) -> Path:
    """Resolve a path found in a data file, which must stay inside `root`.

    Parameters
    ----------
    root : Path
        The folder.
    relative : str
        The path as found.
    named_in : Path or str
        The file that names it.
    row, column : optional
        Where in that file.

    Raises
    ------
    BadFileError
        Where the path is absolute or leads out of `root`, symbolic links included.
    """
    top = root.resolve()
    try:
        path = (root / relative).resolve()
        ok = not Path(relative).is_absolute() and path.is_relative_to(top)
    except (OSError, ValueError, RuntimeError):  # RuntimeError: a loop of symbolic links
        ok = False
    if not ok:
        expected = "a relative path inside the campaign folder"
        remedy = "move the file into the folder and name it relative to it"
        raise BadFileError(named_in, f"the path {relative!r}", expected, remedy, row=row, column=column)
    return path


def sha256_file(path: Path) -> str:
    """Return the SHA-256 of a file as lower-case hexadecimal."""
    digest = hashlib.sha256()
    with Path(path).open("rb") as stream:
        while block := stream.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()
