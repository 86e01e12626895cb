"""MATLAB files of version 5 to 7.2: numeric arrays and structures of them; objects and cells are never loaded."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np

from calib.arrays import FloatArray
from calib.campaign.model import Note
from calib.campaign.readers.matlab_elements import damage
from calib.campaign.readers.recording import Recording, Stream, matrix_columns
from calib.errors import BadFileError

_NUMERIC: Final = frozenset(
    {"double", "single", "logical", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))}
)


def record(path: Path, shown: str, wanted: Callable[[str], bool] | None) -> Recording:
    """Read a ``.mat`` file; variables of one length are one stream; see `calib.campaign.readers.read_recording`."""
    import scipy.io

    notes: list[Note] = []
    # the reader is machine code that takes every tag for granted
    broken = damage(path.read_bytes())
    if broken:
        raise _damaged(shown, broken)
    try:
        listed = scipy.io.whosmat(str(path))
        kept = [name for name, _, kind in listed if kind in _NUMERIC or kind == "struct"]
        refused = [(name, kind) for name, _, kind in listed if name not in kept and kind not in {"char", "sparse"}]
        if refused and wanted is None and not kept:
            raise _objects(shown, refused)
        if refused and wanted is not None and any(wanted(name) for name, _ in refused):
            raise _objects(shown, [one for one in refused if wanted(one[0])])
        notes += [Note("info", f"{shown}, {name}", f"a {kind} was left out", "skipped") for name, kind in refused]
        loaded = scipy.io.loadmat(str(path), variable_names=kept, struct_as_record=True) if kept else {}
    except NotImplementedError as error:
        raise BadFileError(
            shown, "a MATLAB 7.3 file (HDF5)", "version 5 to 7.2", "save it in MATLAB with: save('file.mat', '-v7')"
        ) from error
    except (OSError, BadFileError, MemoryError):
        raise
    except Exception as error:
        # the library answers damage with errors of many kinds (values, types, zlib, its own)
        reason = " ".join(str(error).split())[:100] or type(error).__name__
        raise _damaged(shown, reason) from error
    columns: dict[str, FloatArray] = {}
    properties: dict[str, str] = {}
    for name in kept:
        _flatten(name, loaded.get(name), columns, properties, notes, shown)
    by_length: dict[int, dict[str, FloatArray]] = {}
    for name, values in columns.items():
        if wanted is None or wanted(name):
            by_length.setdefault(len(values), {})[name] = values
    streams = tuple(
        Stream("variables" if number == 0 else f"variables#{number + 1}", "variables", members, None, "none")
        for number, (_, members) in enumerate(sorted(by_length.items(), reverse=True))
    )
    return Recording(streams, tuple(notes), properties)


def _flatten(
    name: str,
    value: Any,
    columns: dict[str, FloatArray],
    properties: dict[str, str],
    notes: list[Note],
    shown: str,
) -> None:
    """Take an array as columns, a number as a property, a structure field by field."""
    if not isinstance(value, np.ndarray):
        return
    if value.dtype.names:
        if value.size == 1:
            for part in value.dtype.names:
                _flatten(f"{name}.{part}", value.flat[0][part], columns, properties, notes, shown)
        else:
            notes.append(Note("info", f"{shown}, {name}", "an array of structures was left out", "skipped"))
    elif value.dtype.kind in "iufb" and value.size == 1:
        properties[name] = repr(float(value.flat[0]))
    elif value.dtype.kind in "iufb" and value.size:
        columns.update(matrix_columns(name, value))
    elif value.dtype.kind == "O":
        notes.append(Note("info", f"{shown}, {name}", "an array of objects was left out", "skipped"))


def _damaged(shown: str, reason: str) -> BadFileError:
    expected = "a whole one of version 5 to 7.2"
    remedy = "save it again with: save('file.mat', '-v7')"
    return BadFileError(shown, f"a MATLAB file that is cut or damaged ({reason})", expected, remedy)


def _objects(shown: str, refused: list[tuple[str, str]]) -> BadFileError:
    names = ", ".join(f"{name} ({kind})" for name, kind in refused)
    remedy = "save the numbers themselves, as in: t = data{1}; save('file.mat', 't', '-v7')"
    return BadFileError(shown, f"arrays of objects: {names[:120]}", "numeric arrays", remedy)
