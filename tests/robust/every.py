"""Every command in every odd world: ``python -m tests.robust.every [WORLD...] [--only COMMAND]``.

Each command runs in a forked process of its own. The worlds: standard output that is closed, that nobody reads, that
is full, that takes ASCII alone; paths that are no UTF-8; JSON to a FIFO; FIFOs and devices in the place of each input;
each output aimed at each input, under four spellings; tables for spreadsheets out of hostile data; and those of
`tests.robust.hard_worlds`. It prints how many commands were started, so that it cannot silently test nothing.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import hashlib
import importlib
import io
import json
import os
import shutil
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from calib.cli import COMMANDS
from calib.cli.main import run
from calib.documents import spreadsheet_cell
from tests.fuzz.inputs import options
from tests.fuzz.sound import prepared
from tests.robust.ending import LONGEST_S, SOUND, TRIED, ended, forces, told, worded
from tests.robust.hard_worlds import HARD_WORLDS, HINDERING

#: names and labels that a spreadsheet, a terminal or an encoding could take for more than text
HOSTILE = ("=1+1", "@SUM(A1)", "+cmd|' /C calc'!A0", "-2+3", "[/red]", "中文", "Ωμέγα")


def made(base: Path) -> Path:
    """Make the sound inputs below `base`: those of the fuzz, a fleet of one vehicle, and a set of one sealed case."""
    prepared(base)
    shutil.copytree(base / "C", base / "fleet" / "v1")
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()), contextlib.chdir(base):
        run(["challenge", "make", "--seeds", "seeds.toml", "--into", "set", "--workers", "1"])
        run(["challenge", "run", "set", "--workers", "1"])
    (base / "out").mkdir()
    return base


def _fresh() -> None:
    shutil.rmtree("out", ignore_errors=True)
    Path("out").mkdir()


def closed(command: str, usual: int) -> Iterator[str]:
    """``>&-``: what it would be, or 141."""
    yield from told(command, ended(worded(command), closed=True), {usual, 0, 141})


def unread(command: str, usual: int) -> Iterator[str]:
    """A pipe whose reader has gone."""
    reading, writing = os.pipe()
    os.close(reading)
    yield from told(command, ended(worded(command), writing), {usual, 0, 141})
    os.close(writing)


def full(command: str, usual: int) -> Iterator[str]:
    """``/dev/full``: 2 and one line; what prints nothing is not hindered."""
    with Path("/dev/full").open("wb") as stream:
        yield from told(command, ended(worded(command), stream.fileno()), {2} if _prints(command) else {usual})


def _prints(command: str) -> bool:
    _fresh()
    return bool(ended(worded(command)).out)


def ascii_only(command: str, usual: int) -> Iterator[str]:
    """An output that takes ASCII alone, and names beyond it."""
    end = ended(worded(command), encoding="ascii")
    yield from told(command, end, {usual})
    if not end.out.isascii():
        yield f"{command}: bytes beyond ASCII"


def odd_names(command: str, usual: int) -> Iterator[str]:
    """Every path within a folder whose name is no UTF-8 and holds an escape sequence and a formula."""
    odd = Path(os.fsdecode(b"=h\xff \x1b[2J"))
    shutil.rmtree(odd, ignore_errors=True)
    odd.mkdir()
    for place in Path().iterdir():
        if place != odd:
            (shutil.copytree if place.is_dir() else shutil.copy)(place, odd / place.name)
    # the first word is the command, no matter what folder is called alike
    first, *further = worded(command)
    paths = [str(odd / word) if word.startswith("out/") or Path(word).exists() else word for word in further]
    end = ended([first, *paths])
    yield from told(command, end, {usual})
    if b"\x1b" in end.out or "\x1b" in end.error:
        yield f"{command}: an escape sequence was sent"
    shutil.rmtree(odd)


def json_to_a_fifo(command: str, usual: int) -> Iterator[str]:
    """It is written, and stays what it was."""
    os.mkfifo("out/fifo")
    read: list[bytes] = []
    reader = threading.Thread(target=lambda: read.append(Path("out/fifo").read_bytes()), daemon=True)
    reader.start()
    end = ended(worded(command, "--json", "out/fifo", "--force"))
    yield from told(command, end, {usual})
    reader.join(timeout=5.0)
    if not Path("out/fifo").is_fifo():
        yield f"{command}: the FIFO was replaced"
    try:
        json.loads(read[0])
    except (IndexError, ValueError) as error:
        yield f"{command}: no JSON in the FIFO ({error!r})"


def _inputs(command: str) -> list[Path]:
    """Return the files that the command's inputs are, or hold: of a folder one of each name, and one log."""
    given = SOUND[command].split()[len(command.split()) :]
    named = [Path(word) for word in given if Path(word).exists() and not word.startswith("out")]
    within: dict[str, Path] = {}
    for path in (path for place in named if place.is_dir() for path in sorted(place.rglob("*")) if path.is_file()):
        within.setdefault(path.suffix if path.parent.name == "logs" else path.name, path)
    return [place for place in named if place.is_file()] + list(within.values())


def no_files(command: str, usual: int) -> Iterator[str]:
    """A FIFO, an endless device or a socket's like in the place of an input: one line at once, or not looked at."""
    for path in _inputs(command):
        for kind in ("fifo", "/dev/zero"):
            kept = path.with_name(path.name + ".kept")
            path.rename(kept)
            os.mkfifo(path) if kind == "fifo" else path.symlink_to(kind)
            _fresh()
            end = ended(worded(command))
            path.unlink()
            kept.rename(path)
            yield from told(f"{command}, {path} a {kind}", end, {2, 1, usual})
            if end.seconds > LONGEST_S / 2:
                yield f"{command}, {path} a {kind}: {end.seconds:.0f} s"


def sacred(command: str, usual: int) -> Iterator[str]:
    """Each output aimed at each input with --force, as it is, by dots, by a symbolic and a hard link."""
    for option in (name for name, _, is_output in options(command) if is_output):
        for path in _inputs(command):
            for spelling in ("as it is", "dots", "symlink", "hard link"):
                _fresh()
                target = _spelt(path, spelling)
                before = _hashes()
                words = worded(command)
                if option in words:
                    at = words.index(option)
                    words[at : at + 2] = []
                end = ended([*words, option, str(target), *(["--force"] if forces(command) else [])])
                changed = {name for name, value in before.items() if _hashes().get(name) != value}
                if changed:
                    yield f"{command} {option} {target} ({spelling}): status {end.status}, changed {sorted(changed)}"
                if end.status not in {0, 1, 2} or not end.one_line:
                    yield f"{command} {option} {target}: status {end.status}: {end.error[-200:]!r}"


def _spelt(path: Path, spelling: str) -> Path:
    if spelling == "dots":
        return Path("C") / ".." / path
    if spelling == "symlink":
        (Path("out") / "soft").symlink_to(path.resolve())
        return Path("out/soft")
    if spelling == "hard link":
        os.link(path, "out/hard")
        return Path("out/hard")
    return path


def _hashes() -> dict[str, str]:
    """Return the hash of every input; results may be renewed where they stand."""
    return {
        str(path): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(Path().rglob("*"))
        if path.is_file() and not str(path).startswith("out") and path.parent.name != "verdicts"
    }


def formulas(command: str, usual: int) -> Iterator[str]:
    """No cell of a table that it writes begins like a formula, unless it is a number."""
    words = worded(command)
    for name, _, is_output in options(command):
        if is_output and name not in words and name not in {"--json", "--apply", "--html", "--truth", "--plot"}:
            words += [name, f"out/{name.strip('-')}"]
    end = ended(words)
    yield from told(command, end, {usual, 0, 1})
    tables = [*Path("out").rglob("*.csv")]
    if command == "export" and end.out:
        Path("out/export.csv").write_bytes(end.out)
        tables.append(Path("out/export.csv"))
    for table in tables:
        if (table.parent / "campaign.toml").exists() or table.parent.name == "logs":
            # a campaign's own tables hold what was given
            continue
        with table.open(newline="", encoding="utf-8") as stream:
            cells = [cell for row in csv.reader(stream) for cell in row]
        odd = [cell for cell in cells if spreadsheet_cell(cell) != cell]
        if odd:
            yield f"{command}: {table.name} holds {odd[0]!r}"


WORLDS: dict[str, Callable[[str, int], Iterator[str]]] = {
    "closed": closed,
    "unread": unread,
    "full": full,
    "ascii": ascii_only,
    "names": odd_names,
    "fifo": json_to_a_fifo,
    "no-files": no_files,
    "sacred": sacred,
    "formulas": formulas,
    **HARD_WORLDS,
}


def spoil_labels(folder: Path) -> None:
    """Give a campaign hostile ids, sessions and a name."""
    path = folder / "runs.csv"
    with path.open(newline="", encoding="utf-8") as stream:
        names, *rows = list(csv.reader(stream))
    for number, text in enumerate(HOSTILE):
        rows[number][0] = text
        rows[number][names.index("session")] = text
    with path.open("w", newline="", encoding="utf-8") as stream:
        csv.writer(stream).writerows([names, *rows])
    settings = folder / "campaign.toml"
    text = settings.read_text(encoding="utf-8")
    settings.write_text(text.replace('name = "', 'name = "=中文 ', 1), encoding="utf-8")


def faults_of(world: str, commands: list[str]) -> Iterator[str]:
    """Yield what is wrong with the answers of some commands in a world; the working folder is one that `made` made."""
    hindered = 0
    for command in commands:
        _fresh()
        usual = ended(worded(command)).status
        _fresh()
        before = len(TRIED)
        yield from WORLDS[world](command, usual)
        hindered += any(status != usual for status in TRIED[before:])
    if world in HINDERING and not hindered:
        yield f"{world}: no command was hindered, so the world does not work"


def main() -> int:
    """Go through worlds and commands, and print each fault; the status is 1 where there is one."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("worlds", nargs="*", choices=[*WORLDS, []], help="all by default")
    parser.add_argument("--only", action="append", choices=list(COMMANDS), help="a command; again for more")
    asked = parser.parse_args()
    commands, count = asked.only or list(SOUND), 0
    # a user without rights may not be able to read the interpreter's own folder
    for module in ("plistlib", "importlib.readers", "matplotlib.font_manager", "matplotlib.backends.backend_svg"):
        importlib.import_module(module)
    with tempfile.TemporaryDirectory() as folder:
        # others may read it, in the world without rights
        Path(folder).chmod(0o755)
        base = made(Path(folder) / "base")
        hostile = Path(folder) / "hostile"
        spoil_labels(shutil.copytree(base, hostile) / "C")
        with contextlib.chdir(hostile), contextlib.redirect_stdout(io.StringIO()):
            run(["fit", "C", "--into", "result", "--force"])
            shutil.rmtree("fleet")
            shutil.copytree("C", "fleet/v1")
        for world in asked.worlds or list(WORLDS):
            started = time.monotonic()
            with contextlib.chdir(hostile if world in {"ascii", "formulas"} else base):
                faults = list(faults_of(world, commands))
            count += len(faults)
            for fault in faults:
                sys.stdout.write(f"  {fault}\n")
            seconds = time.monotonic() - started
            runs, TRIED[:] = len(TRIED), []
            sys.stdout.write(
                f"{world}: {len(commands)} commands, {runs} starts, {len(faults)} faults, {seconds:.0f} s\n"
            )
            sys.stdout.flush()
    return int(count > 0)


if __name__ == "__main__":
    sys.exit(main())
