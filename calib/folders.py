"""Writing whole folders: a folder is of one generation, the old one or the new one, whenever the writer is killed.

The new generation is made beside the folder and takes its name in one step. Where that cannot be done (a working
folder, a mount point, a folder full of other things, a file system that cannot exchange names) it is made inside the
folder, with a list of what is to be moved; `settle` finishes the moving after a crash, before anything is read.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final

from calib.errors import BadInputError, would_overwrite
from calib.inputs import refuse_input
from calib.leftovers import PREFIX, inside, remove, sweep, temporary_beside

#: other entries that are carried over beside the folder; a folder with more is renewed from inside
MOST_OTHERS: Final = 500
_LIST: Final = ".ready.json"
_EXCHANGE: Final = 2
_HERE: Final = -100


def write_files(folder: Path, files: Mapping[str, bytes], *, force: bool = False) -> list[Path]:
    """Write files of one generation into a folder, all of them or none; see `write_folder`.

    `folder`: made where missing; `files`: name in the folder -> content.
    """

    def fill(fresh: Path) -> None:
        for name, data in files.items():
            (fresh / name).parent.mkdir(parents=True, exist_ok=True)
            (fresh / name).write_bytes(data)

    write_folder(folder, list(dict.fromkeys(Path(name).parts[0] for name in files)), fill, force=force)
    return [Path(folder) / name for name in files]


def write_folder(folder: Path, names: Sequence[str], fill: Callable[[Path], None], *, force: bool = False) -> Path:
    """Write a folder all at once; what stands there under other names is kept.

    `folder`: the target; made where missing; `names`: entries of the folder that belong together: those of an earlier
    generation go when the new ones come; `fill`: called with an empty folder, into which it writes the entries. Raises
    BadInputError where an entry is an input of the command at work, or exists and `force` is False, or the folder
    cannot be written; nothing has changed then.
    """
    folder = Path(folder)
    try:
        _refuse(folder, names, force=force)
        target = folder.resolve()
        target.parent.mkdir(parents=True, exist_ok=True)
        sweep(target)
        if target.is_dir():
            settle(target)
        if _renewed_inside(target, names):
            _renew_inside(target, names, fill)
        else:
            _renew_beside(target, names, fill, force=force)
    except (OSError, ValueError, RuntimeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise BadInputError(f"{folder}: found {reason}; expected a writable folder; choose another place") from error
    return folder


def settle(folder: Path) -> None:
    """Finish what a killed writer began inside `folder`: a generation made ready is moved in, the rest removed.

    Raises BadInputError where the folder needs it and cannot be written.
    """
    for leftover in inside(Path(folder)):
        if (leftover / _LIST).is_file():
            try:
                _place(leftover, Path(folder))
            except (OSError, ValueError, KeyError, TypeError) as error:
                raise BadInputError(
                    f"{folder}: found an unfinished replacement ({leftover.name}); expected a whole folder; make the "
                    "folder writable and try again"
                ) from error
        remove(leftover)


def _refuse(folder: Path, names: Sequence[str], *, force: bool) -> None:
    if folder.exists() and not folder.is_dir():
        raise BadInputError(f"{folder}: found a file; expected a folder; choose another path")
    entries = [folder / name for name in names]
    for entry in entries:
        refuse_input(entry)
        if entry.is_dir():
            for path in entry.rglob("*"):
                refuse_input(path)
    for entry in entries:
        if os.path.lexists(entry) and not force:
            raise would_overwrite(entry)


def _renewed_inside(target: Path, names: Sequence[str]) -> bool:
    """Return whether a folder has to keep its identity, or holds too much else to be carried over."""
    if not target.is_dir():
        return False
    here = Path.cwd().resolve()
    if here == target or target in here.parents or target.is_mount() or not os.access(target.parent, os.W_OK):
        return True
    count = 0
    for _, folders, files in os.walk(target):
        count += len(folders) + len(files)
        if count > MOST_OTHERS + sum(1 for _ in names):
            return _others(target, names) > MOST_OTHERS
    return False


def _others(target: Path, names: Sequence[str]) -> int:
    count = 0
    for entry in target.iterdir():
        if entry.name in names:
            continue
        count += 1
        for _, folders, files in os.walk(entry):
            count += len(folders) + len(files)
            if count > MOST_OTHERS:
                return count
    return count


def _renew_beside(target: Path, names: Sequence[str], fill: Callable[[Path], None], *, force: bool) -> None:
    fresh = temporary_beside(target)
    fresh.mkdir()
    try:
        fill(fresh)
        if not (target.is_dir() and any(target.iterdir())):
            with suppress(OSError):
                # fails where another writer was first
                fresh.rename(target)
                return
        _refuse(target, names, force=force)
        _carry_over(target, fresh, names)
        shutil.copymode(target, fresh)
        if not _exchange(fresh, target):
            _renew_inside(target, names, lambda inner: _move_all(fresh, inner, names))
        elif not force and any(os.path.lexists(fresh / name) for name in names):
            # another writer was first by a hair: it gets its name back
            _exchange(fresh, target)
            raise would_overwrite(target)
    finally:
        # the unfinished new generation, or the old one whose name the new one took
        remove(fresh)


def _carry_over(target: Path, fresh: Path, names: Sequence[str]) -> None:
    for entry in target.iterdir():
        if entry.name in names or entry.name.startswith(PREFIX):
            continue
        if entry.is_dir() and not entry.is_symlink():
            shutil.copytree(entry, fresh / entry.name, symlinks=True, copy_function=_link)
        else:
            _link(str(entry), str(fresh / entry.name))


def _link(source: str, copy: str) -> str:
    try:
        os.link(source, copy, follow_symlinks=False)
    except OSError:
        shutil.copy2(source, copy, follow_symlinks=False)
    return copy


def _move_all(fresh: Path, inner: Path, names: Sequence[str]) -> None:
    for name in names:
        if os.path.lexists(fresh / name):
            (fresh / name).rename(inner / name)


def _renew_inside(target: Path, names: Sequence[str], fill: Callable[[Path], None]) -> None:
    fresh = temporary_beside(target, target)
    fresh.mkdir()
    try:
        fill(fresh)
        plan = {"put": [name for name in names if os.path.lexists(fresh / name)], "names": list(names)}
        draft = fresh / f"{_LIST}.draft"
        draft.write_text(json.dumps(plan), encoding="utf-8")
        draft.rename(fresh / _LIST)
    except BaseException:
        remove(fresh)
        raise
    _place(fresh, target)
    remove(fresh)


def _place(fresh: Path, target: Path) -> None:
    """Move a generation that is ready into its folder; may be called again where it was killed on the way."""
    plan = json.loads((fresh / _LIST).read_text(encoding="utf-8"))
    for name in plan["names"]:
        new, old = fresh / name, target / name
        if name in plan["put"] and not os.path.lexists(new):
            continue  # was moved before
        if old.is_dir() and not old.is_symlink():
            remove(fresh / f".old-{name}")
            old.rename(fresh / f".old-{name}")
        if name in plan["put"]:
            new.replace(old)
        else:
            old.unlink(missing_ok=True)


def _exchange(first: Path, second: Path) -> bool:
    """Swap the names of two folders in one step; False where the system cannot."""
    import ctypes

    try:
        library = ctypes.CDLL(None, use_errno=True)
        names = os.fsencode(first), os.fsencode(second)
        if sys.platform == "darwin":
            return bool(library.renamex_np(*names, _EXCHANGE) == 0)
        return bool(library.renameat2(_HERE, names[0], _HERE, names[1], _EXCHANGE) == 0)
    except (AttributeError, OSError, TypeError):
        return False
