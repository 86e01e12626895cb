"""All or nothing: a folder is of one generation, whenever its writer is killed, and leftovers go."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from calib.cli.main import run
from calib.errors import BadInputError
from calib.io import settle, write_bytes, write_files, write_folder
from tests.robust.killing import KILLED, ROOT, content, killed_at_rename, leftovers

CORRIDOR = ROOT / "sample_runs" / "corridor"
OLD = {"fit.json": b"old", "runs.csv": b"old", "logs/a.csv": b"old", "logs/b.csv": b"old"}
NEW = {"fit.json": b"new", "runs.csv": b"new", "logs/a.csv": b"new", "logs/c.csv": b"new"}


def texts(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_generation_goes_when_the_next_comes_and_the_rest_stays(tmp_path: Path) -> None:
    """Entries of the old generation that the new one lacks are gone; the user's own files are kept."""
    folder = tmp_path / "r"
    write_files(folder, OLD)
    (folder / "notes.txt").write_text("mine")
    with pytest.raises(BadInputError, match="existing file"):
        write_files(folder, NEW)
    assert texts(folder) == {**OLD, "notes.txt": b"mine"}
    write_files(folder, NEW, force=True)
    assert texts(folder) == {**NEW, "notes.txt": b"mine"}
    assert [path.name for path in tmp_path.iterdir()] == ["r"]


def test_the_working_folder_keeps_its_identity(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """``--into .`` renews the folder from inside: a shell that stands in it stays in it."""
    monkeypatch.chdir(tmp_path)
    number = tmp_path.stat().st_ino
    write_files(Path(), OLD)
    write_files(Path(), NEW, force=True)
    assert texts(tmp_path) == NEW
    assert tmp_path.stat().st_ino == number


def _fails(made: Path) -> None:
    (made / "fit.json").write_bytes(b"half")
    raise OSError(28, "No space left on device")


@pytest.mark.parametrize("inside", [True, False])
def test_a_full_disk_leaves_the_old_generation(inside: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "r"
    write_files(folder, OLD)
    if inside:
        monkeypatch.chdir(folder)
    with pytest.raises(BadInputError, match="No space left"):
        write_folder(folder, ["fit.json", "runs.csv", "logs"], _fails, force=True)
    assert texts(folder) == OLD
    assert not leftovers(tmp_path)


def test_a_full_disk_leaves_the_old_file(tmp_path: Path) -> None:
    """A limit on the size of files replaces the full disk."""
    (tmp_path / "out.json").write_bytes(b"old")
    code = (
        "import resource, sys; from pathlib import Path; from calib.io import write_bytes\n"
        "from calib.errors import BadInputError\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
        "try: write_bytes(Path('out.json'), bytes(5000), force=True)\n"
        "except BadInputError as error: sys.exit(0 if 'expected a writable place' in str(error) else 4)\n"
        "sys.exit(3)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], check=False, cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(ROOT)}
    )
    assert done.returncode == 0
    assert texts(tmp_path) == {"out.json": b"old"}


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write into folders that are read-only")
def test_a_read_only_folder_is_said(tmp_path: Path) -> None:
    folder = tmp_path / "r"
    write_files(folder, OLD)
    folder.chmod(0o500)
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(BadInputError, match="Permission denied"):
            write_files(folder, NEW, force=True)
        assert texts(folder) == OLD
    finally:
        tmp_path.chmod(0o700)
        folder.chmod(0o700)


@pytest.mark.parametrize("force", [True, False])
def test_two_writers_at_once_leave_one_generation(force: bool, tmp_path: Path) -> None:
    """Without --force one of them is refused; with it the last one wins; nothing is mixed."""
    folder = tmp_path / "r"
    outcomes: list[str] = []
    barrier = threading.Barrier(2)

    def write(files: dict[str, bytes]) -> None:
        def fill(made: Path) -> None:
            for name, data in files.items():
                (made / name).parent.mkdir(exist_ok=True)
                (made / name).write_bytes(data)
            barrier.wait(timeout=30)

        try:
            write_folder(folder, ["fit.json", "runs.csv", "logs"], fill, force=force)
            outcomes.append("written")
        except BadInputError:
            outcomes.append("refused")

    threads = [threading.Thread(target=write, args=(files,)) for files in (OLD, NEW)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(outcomes) in ([["refused", "written"]] if not force else [["written"] * 2])
    assert texts(folder) in (OLD, NEW)
    assert [path.name for path in tmp_path.iterdir()] == ["r"]


def test_a_new_file_of_two_writers_is_the_first_ones(tmp_path: Path) -> None:
    """Without --force a file that appeared meanwhile is kept."""
    target = tmp_path / "out.json"
    write_bytes(target, b"first")
    with pytest.raises(BadInputError, match="existing"):
        write_bytes(target, b"second")
    assert target.read_bytes() == b"first"


def _fitted(base: Path) -> tuple[list[str], Path]:
    shutil.copytree(CORRIDOR, base / "lab")
    return ["fit", "lab", "--into", "out", "--reference-load", "400", "--force"], base / "out"


def _exported(base: Path) -> tuple[list[str], Path]:
    shutil.copytree(CORRIDOR, base / "lab")
    return ["export", "lab", "--to", "c", "--output", "out", "--force"], base / "out"


JOBS: dict[str, Callable[[Path], tuple[list[str], Path]]] = {"fit": _fitted, "export": _exported}


@pytest.mark.parametrize("inside", [False, True])
@pytest.mark.parametrize("name", list(JOBS))
def test_killed_before_any_change_of_a_name_the_folder_is_old_or_new(
    name: str, inside: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Then the rerun succeeds and no leftovers stay."""
    arguments, out = JOBS[name](tmp_path)
    run(["fit", str(tmp_path / "lab"), "--into", str(out)])
    old = content(out)
    where = tmp_path
    if inside:
        where = out
        arguments = [word.replace("lab", "../lab") if word == "lab" else word for word in arguments]
        arguments = ["." if word == "out" else word for word in arguments]
    reference = tmp_path / "reference"
    shutil.copytree(out, reference)
    allowed = None
    for number in range(12):
        status = killed_at_rename(number, arguments, where)
        settle(out)
        after = content(out)
        if status != KILLED:
            allowed = after
            assert number > 0, "no change of a name was met"
            break
        assert after == old or set(after) >= set(old), f"torn before change {number}: {sorted(after)}"
        shutil.rmtree(out) if not inside else [path.unlink() for path in out.rglob("*") if path.is_file()]
        shutil.copytree(reference, out, dirs_exist_ok=True)
    assert allowed is not None
    assert allowed != old
    assert not leftovers(tmp_path)
    capsys.readouterr()
