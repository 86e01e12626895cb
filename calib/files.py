"""Writing whole files, staying inside a folder, hashing."""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from pathlib import Path
from typing import Any

from calib.errors import BadFileError, BadInputError, would_overwrite

__all__ = ["inside", "sha256_file", "to_json", "write_bytes", "write_json", "write_text"]


def write_bytes(path: Path, data: bytes, *, force: bool = False) -> Path:
    """Write `data` to `path` whole: to a temporary file beside it, then renamed.

    Parameters
    ----------
    path : Path
        Target; its folder is made where missing.
    data : bytes
        The content.
    force : bool
        Replace an existing file.

    Returns
    -------
    Path
        `path`.

    Raises
    ------
    BadInputError
        Where the file exists and `force` is False, or the folder cannot be written.
    """
    path = Path(path)
    if path.exists() and not force:
        raise would_overwrite(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".tmp")
        try:
            with os.fdopen(handle, "wb") as out:
                out.write(data)
            Path(name).chmod(0o644)
            Path(name).replace(path)
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise
    except OSError as error:
        raise BadInputError(
            f"{path}: found {error.strerror}; expected a writable place; choose another path"
        ) from error
    return path


def write_text(path: Path, text: str, *, force: bool = False) -> Path:
    """Write UTF-8 `text` to `path` whole; see `write_bytes`."""
    return write_bytes(path, text.encode("utf-8"), force=force)


def to_json(value: Any) -> str:
    """Return `value` as indented JSON with a final newline; NaN and infinity are refused, never written."""
    return json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False, default=_plain) + "\n"


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
        raise BadFileError(
            named_in,
            row=row,
            column=column,
            found=f"the path {relative!r}",
            expected="a relative path inside the campaign folder",
            remedy="move the file into the folder and name it relative to it",
        )
    return path


def sha256_file(path: Path) -> str:
    """Return the SHA-256 of a file as lower-case hexadecimal."""
    digest = hashlib.sha256()
    with Path(path).open("rb") as stream:
        while block := stream.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()
