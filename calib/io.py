"""Files and folders written whole.

A file is written under a temporary name and renamed. A folder is made beside its target and swapped, or its entries are
made inside with a list of moves, which `settle` finishes after a crash.
"""

import errno
import os
import platform
import shutil
import stat
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from calib.documents import to_json
from calib.errors import BadFileError, BadInputError, refuse_input, would_overwrite

#: names of temporary files: .calib-<target's hash or "inside">-<host>-<process>-<random>.tmp
PREFIX: Final = ".calib-"
SUFFIX: Final = ".tmp"
#: in place of the target's hash where a folder is renewed from inside
INSIDE: Final = "inside"
#: folders of more other entries are renewed from inside: linking each takes too long
MOST_OTHERS: Final = 500
#: list of the moves that complete a folder renewed from inside
_MOVES: Final = ".ready.json"
_STANDARD_STREAMS: Final = frozenset({"/dev/stdout", "/dev/stderr"})


def write_bytes(path: Path, data: bytes, *, force: bool = False) -> Path:
    """Write `data` to `path` whole; its folder is made where missing; a device or a FIFO is never replaced.

    Raises BadInputError where the path is an input of the running command, the file exists and `force` is False, or
    the folder cannot be written.
    """
    refuse_empty(path)
    path = Path(path)
    try:
        refuse_input(path)
        if _is_stream(path):
            _append(path, data)
            return path
        refuse_existing([path], force=force)
        path.parent.mkdir(parents=True, exist_ok=True)
        sweep(path)
        temporary = _temporary_beside(path)
        try:
            with temporary.open("xb") as out:
                out.write(data)
            temporary.chmod(0o644)
            _rename(temporary, path, force=force)
        finally:
            temporary.unlink(missing_ok=True)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise BadInputError(f"{path}: found {reason}; expected a writable place; choose another path") from error
    return path


def write_text(path: Path, text: str, *, force: bool = False) -> Path:
    """Write UTF-8 `text` to `path` whole; see `write_bytes`."""
    return write_bytes(path, text.encode("utf-8", "backslashreplace"), force=force)


def write_json(path: Path, value: Any, *, force: bool = False) -> Path:
    """Write `value` as JSON to `path` whole; see `write_bytes`."""
    return write_text(path, to_json(value), force=force)


def refuse_empty(path: Path | str, name: str = "output path") -> None:
    """Raise BadInputError where a path is an empty text, which `Path` reads as the working folder."""
    if isinstance(path, str) and not path.strip():
        raise BadInputError(f"{name}: found {path!r}; expected the path of a file or folder; name one")


def refuse_existing(targets: Iterable[Path | str | None], *, force: bool = False) -> None:
    """Raise BadInputError where a target is an input, a folder, named twice, or exists and `force` is False."""
    seen: set[str] = set()
    for target in targets:
        if target is None or str(target) == "-":
            continue
        refuse_empty(target)
        path = Path(target)
        refuse_input(path)
        try:
            if (real := os.path.realpath(path)) in seen and not _is_stream(path):
                raise BadInputError(f"{path}: found it as two outputs; expected a file each; name another one")
            seen.add(real)
            os.lstat(path)
            if path.is_dir():
                raise BadInputError(f"{path}: found a folder; expected a file to write; name a file in it")
            if not force and not _is_stream(path):
                raise would_overwrite(path)
        except FileNotFoundError:
            continue
        except OSError as error:
            # a file in place of a folder, too long a name, no access
            fault = f"{path}: found {error.strerror}"
            raise BadInputError(f"{fault}; expected a place for a file; choose another path") from error
        except ValueError as error:
            raise BadInputError(f"{path}: found {error}; expected a path; correct it") from error


def _rename(temporary: Path, path: Path, *, force: bool) -> None:
    if not force:
        try:
            os.link(temporary, path)
        except FileExistsError:
            raise would_overwrite(path) from None
        except OSError:
            pass  # a file system without links
        else:
            return
    temporary.replace(path)


def _is_stream(path: Path) -> bool:
    if str(path) in _STANDARD_STREAMS or path.parent == Path("/dev/fd"):
        return True
    try:
        mode = path.stat().st_mode
    except OSError:
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))


def _append(path: Path, data: bytes) -> None:
    # a file behind /dev/stdout keeps its content
    with path.open("ab", buffering=0) as out:
        view = memoryview(data)
        while view:
            view = view[out.write(view) :]


def inside(
    root: Path, relative: str, *, named_in: Path | str, row: int | None = None, column: str | None = None
) -> Path:
    """Resolve a path `relative` to `root`, found in the file `named_in`; see `BadFileError`.

    That is raised where the path is absolute or leads out of `root`, symbolic links included.
    """
    top = root.resolve()
    try:
        path = (root / relative).resolve()
        ok = not Path(relative).is_absolute() and path.is_relative_to(top)
    except (OSError, ValueError, RuntimeError):  # RuntimeError: a loop of symbolic links
        ok = False
    if not ok:
        actual = f"the path {relative!r}{', a link' * os.path.islink(root / relative)}"  # noqa: PTH114 (takes any text)
        expected = "a relative path inside the campaign folder"
        remedy = "move the file into the folder and name it relative to it"
        raise BadFileError(named_in, actual, expected, remedy, row=row, column=column)
    return path


def sha256_file(path: Path) -> str:
    """Return the SHA-256 of a file as lower-case hexadecimal; OSError for a device or FIFO, which may have no end."""
    if _is_stream(Path(path)):
        raise OSError(errno.EINVAL, "a device, FIFO or stream; a regular file was expected", str(path))
    import hashlib

    with Path(path).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def write_files(folder: Path, files: Mapping[str, bytes], *, force: bool = False) -> list[Path]:
    """Write files (name in the folder -> content) into a folder, all of them or none; see `write_folder`."""

    def fill(fresh: Path) -> None:
        for name, data in files.items():
            (fresh / name).parent.mkdir(parents=True, exist_ok=True)
            (fresh / name).write_bytes(data)

    write_folder(folder, list(dict.fromkeys(Path(name).parts[0] for name in files)), fill, force=force)
    return [Path(folder) / name for name in files]


def write_folder(folder: Path, names: Sequence[str], fill: Callable[[Path], None], *, force: bool = False) -> Path:
    """Write the entries `names` of a folder all at once; other entries are kept.

    `folder`: made where missing; `names`: entries that belong together; `fill`: writes them into an empty folder.
    Raises BadInputError where an entry is an input of the running command, or exists and `force` is False, or the
    folder cannot be written; nothing has changed then.
    """
    refuse_empty(folder)
    folder = Path(folder)
    try:
        _refuse_entries(folder, names, force=force)
        target = folder.resolve()
        target.parent.mkdir(parents=True, exist_ok=True)
        sweep(target)
        if target.is_dir():
            settle(target)
        if _must_keep_identity(target, names):
            _renew_inside(target, names, fill)
        else:
            _renew_beside(target, names, fill, force=force)
    except (OSError, ValueError, RuntimeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise BadInputError(f"{folder}: found {reason}; expected a writable folder; choose another place") from error
    return folder


def settle(folder: Path) -> None:
    """Finish what a killed writer began in `folder`: a complete list of moves is done, the rest removed.

    Raises BadInputError where the folder needs it and cannot be written.
    """
    for leftover in _abandoned(Path(folder), INSIDE):
        if (leftover / _MOVES).is_file():
            try:
                _move_in(leftover, Path(folder))
            except (OSError, ValueError, KeyError, TypeError) as error:
                raise BadInputError(
                    f"{folder}: found an unfinished replacement ({leftover.name}); expected a whole folder; make the "
                    "folder writable and try again"
                ) from error
        _remove(leftover)


def _refuse_entries(folder: Path, names: Sequence[str], *, force: bool) -> None:
    if folder.exists() and not folder.is_dir():
        raise BadInputError(f"{folder}: found a file; expected a folder; choose another path")
    entries = [folder / name for name in names]
    for entry in entries:
        for path in (entry, *(entry.rglob("*") if entry.is_dir() else ())):
            refuse_input(path)
    for entry in entries:
        if os.path.lexists(entry) and not force:
            raise would_overwrite(entry)


def _must_keep_identity(target: Path, names: Sequence[str]) -> bool:
    if not target.is_dir():
        return False
    cwd = Path.cwd().resolve()
    if target in (cwd, *cwd.parents) or target.is_mount() or not os.access(target.parent, os.W_OK):
        return True
    others = 0
    for place, folders, files in os.walk(target):
        if Path(place) == target:
            folders[:] = [name for name in folders if name not in names]
            files = [name for name in files if name not in names]
        others += len(folders) + len(files)
        if others > MOST_OTHERS:
            return True
    return False


def _renew_beside(target: Path, names: Sequence[str], fill: Callable[[Path], None], *, force: bool) -> None:
    fresh = _temporary_beside(target)
    fresh.mkdir()
    try:
        fill(fresh)
        if not (target.is_dir() and any(target.iterdir())):
            with suppress(OSError):  # another writer was first
                fresh.rename(target)
                return
        _refuse_entries(target, names, force=force)
        for entry in target.iterdir():
            if entry.name in names or entry.name.startswith(PREFIX):
                continue
            if entry.is_dir() and not entry.is_symlink():
                shutil.copytree(entry, fresh / entry.name, symlinks=True, copy_function=_link)
            else:
                _link(str(entry), str(fresh / entry.name))
        shutil.copymode(target, fresh)
        if not _swap(fresh, target):
            _renew_inside(target, names, lambda inner: _move_all(fresh, inner, names))
        elif not force and any(os.path.lexists(fresh / name) for name in names):
            # another writer was first and gets its name back
            _swap(fresh, target)
            raise would_overwrite(target)
    finally:
        _remove(fresh)  # the incomplete new folder, or the old one after the swap


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
    fresh = _temporary_beside(target, target)
    fresh.mkdir()
    try:
        fill(fresh)
        moves = {"put": [name for name in names if os.path.lexists(fresh / name)], "names": list(names)}
        draft = fresh / f"{_MOVES}.draft"
        draft.write_text(to_json(moves), encoding="utf-8")
        draft.rename(fresh / _MOVES)
    except BaseException:
        _remove(fresh)
        raise
    _move_in(fresh, target)
    _remove(fresh)


def _move_in(fresh: Path, target: Path) -> None:
    import json

    moves = json.loads((fresh / _MOVES).read_text(encoding="utf-8"))
    for name in moves["names"]:
        new, old = fresh / name, target / name
        if name in moves["put"] and not os.path.lexists(new):
            continue  # moved before the kill
        if old.is_dir() and not old.is_symlink():
            _remove(fresh / f".old-{name}")
            old.rename(fresh / f".old-{name}")
        if name in moves["put"]:
            new.replace(old)
        else:
            old.unlink(missing_ok=True)


def _swap(first: Path, second: Path) -> bool:
    import ctypes

    names = os.fsencode(first), os.fsencode(second)
    try:
        library = ctypes.CDLL(None, use_errno=True)
        if sys.platform == "darwin":
            return bool(library.renamex_np(*names, 2) == 0)  # 2: RENAME_SWAP
        return bool(library.renameat2(-100, names[0], -100, names[1], 2) == 0)  # AT_FDCWD, RENAME_EXCHANGE
    except (AttributeError, OSError, TypeError):
        return False


def _temporary_beside(path: Path, where: Path | None = None) -> Path:
    mark = _mark(path.name) if where is None else INSIDE
    stem = f"{PREFIX}{mark}-{_mark(platform.node())}-{os.getpid()}-{os.urandom(3).hex()}{SUFFIX}"
    return (path.parent if where is None else where) / stem


def sweep(path: Path) -> None:
    """Remove the temporary files of `path` whose writers were killed."""
    for leftover in _abandoned(path.parent, _mark(path.name)):
        _remove(leftover)


def _abandoned(folder: Path, mark: str) -> list[Path]:
    return [path for path in folder.glob(f"{PREFIX}{mark}-{_mark(platform.node())}-*{SUFFIX}") if _is_dead(path)]


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink(missing_ok=True)


def _is_dead(path: Path) -> bool:
    try:
        os.kill(int(path.name.split("-")[3]), 0)
    except ProcessLookupError:
        return True
    except (OSError, ValueError, IndexError, OverflowError):
        return False  # another user's process, or a foreign name
    return False


def _mark(name: str) -> str:
    import hashlib

    return hashlib.sha256(os.fsencode(name)).hexdigest()[:8]
