"""Odd files, options and environments for every command: ``python -m tests.robust.attacks [PART...] [--seconds 60]``.

Each attack spoils a copy of sound inputs in one way and runs one command in a process of its own. A fault is: an exit
status other than 0, 1 or 2 (141 where nobody reads), a traceback, more than one line beside notes, a wait beyond the
limit, an input that has changed, JSON that is none. It prints how many were tried.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import json
import os
import resource
import shutil
import struct
import sys
import tempfile
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from calib.cli.main import run
from tests.fuzz.inputs import options
from tests.fuzz.sound import prepared
from tests.robust import ending
from tests.robust.ending import SOUND, ended, worded

Spoil = Callable[[], None]


@dataclass(frozen=True)
class Attack:
    """One command on inputs spoilt in one way; the working folder holds the inputs, ``out`` is for outputs."""

    name: str
    words: tuple[str, ...]
    spoil: Spoil = field(default=lambda: None)
    #: in the process of the command
    hinder: Spoil | None = None
    closed: bool = False


def _write(path: str, data: bytes | str) -> Spoil:
    def spoil() -> None:
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        Path(path).write_bytes(data if isinstance(data, bytes) else data.encode())

    return spoil


def _edit(path: str, change: Callable[[str], str]) -> Spoil:
    def spoil() -> None:
        text = Path(path).read_text(encoding="utf-8")
        Path(path).write_text(change(text), encoding="utf-8")

    return spoil


NUMBERS = ("nan", "inf", "-inf", "0", "-1", "1e308", "5e-324", '"x"', "[]", "{}", "true", "1" + "0" * 400, "1979-05-27")
KEYS = ("track_m", "wheel_radius_m", "counts_per_rev", "mass_kg", "wheelbase_m", "sigma_m", "reference_load_N")


def settings() -> Iterator[Attack]:
    """Yield numbers of every kind in the place of each setting, and settings that are none."""
    for number, key in enumerate(KEYS):
        for turn, value in enumerate(NUMBERS):
            command = ("check C", "fit C", "geometry C", "deviation C")[(number + turn) % 4]

            def change(text: str, key: str = key, value: str = value) -> str:
                lines = [f"{key} = {value}" if line.startswith(f"{key} =") else line for line in text.splitlines()]
                return "\n".join(lines) + "\n"

            yield Attack(f"{key} = {value[:12]}", tuple(command.split()), _edit("C/campaign.toml", change))
    whole = {
        "empty": b"",
        "no UTF-8": b"\xff\xfe\x00",
        "NUL": b"a = 1\x00\n",
        "a byte order mark": b"\xef\xbb\xbfformat = 'calib-campaign/1'\n",
        "10,000 brackets": b"a = " + b"[" * 10_000,
        "dotted keys": b"a." * 5_000 + b"b = 1\n",
        "a key twice": b"format = 'x'\nformat = 'y'\n",
        "tables as numbers": b"format = 'calib-campaign/1'\nvehicle = 3\nencoder = []\nmodel = 'm'\nreference = 1\n",
        "surrogates": b'name = "\\ud800"\n',
    }
    for name, data in whole.items():
        for command in ("check C", "fit C", "diagnose C"):
            yield Attack(f"campaign.toml: {name}", tuple(command.split()), _write("C/campaign.toml", data))


CELLS = ("nan", "inf", "-inf", "1e400", "-1e400", "1e308", "５００", "٣", "−5", "1_000", "0x10", "1,5", "1 000", "=1+1",
         "#DIV/0!", "\x1b[2J", "\u202e5", "'5", " ", "NULL", "True", "9" * 400)  # fmt: skip
COLUMNS = ("distance_m", "counts_left", "payload_kg", "load_left_N", "session", "run_id", "kind", "direction")


def tables() -> Iterator[Attack]:
    """Yield odd cells in each column, and run tables that are none."""
    for number, cell in enumerate(CELLS):
        for turn, column in enumerate(COLUMNS):
            if (number + turn) % 2:
                continue
            command = ("check C", "fit C --json out/j.json", "export C --to csv", "simulate replay C")[
                (number + turn) // 2 % 4
            ]

            def change(text: str, cell: str = cell, column: str = column) -> str:
                rows = [line.split(",") for line in text.splitlines()]
                if column not in rows[0]:
                    rows = [[*row, column if at == 0 else "1"] for at, row in enumerate(rows)]
                for row in rows[1 : 1 + 2 * (len(cell) % 3 + 1)]:
                    row[rows[0].index(column)] = f'"{cell}"' if "," in cell else cell
                return "\n".join(",".join(row) for row in rows) + "\n"

            yield Attack(f"{column} {cell[:10]!r}", tuple(command.split()), _edit("C/runs.csv", change))

    def rows(change: Callable[[list[str]], list[str]]) -> Spoil:
        return _edit("C/runs.csv", lambda text: "\n".join(change(text.splitlines())) + "\n")

    def coded(encoding: str) -> Spoil:
        def spoil() -> None:
            text = Path("C/runs.csv").read_text(encoding="utf-8").replace("corridor", "Flur-ä")
            Path("C/runs.csv").write_bytes(text.encode(encoding))

        return spoil

    whole: dict[str, Spoil] = {
        "empty": _write("C/runs.csv", b""),
        "line ends alone": _write("C/runs.csv", b"\n\r\n\r" * 50),
        "header alone": rows(lambda lines: lines[:1]),
        "one run": rows(lambda lines: lines[:2]),
        "no header": rows(lambda lines: lines[1:]),
        "columns twice": rows(lambda lines: [f"{line},{line}" for line in lines]),
        "ids twice": rows(lambda lines: [lines[0], *lines[1:3], *lines[1:]]),
        "a quote left open": rows(lambda lines: [*lines[:3], '"' + lines[3], *lines[4:]]),
        "too many cells": rows(lambda lines: [lines[0], lines[1] + ",1" * 3000, *lines[2:]]),
        "too few cells": rows(lambda lines: [lines[0], *(line[:4] for line in lines[1:])]),
        "semicolons": rows(lambda lines: [line.replace(",", ";") for line in lines]),
        "tabs": rows(lambda lines: [line.replace(",", "\t") for line in lines]),
        "carriage returns": _edit("C/runs.csv", lambda text: text.replace("\n", "\r")),
        "NUL in the middle": _edit("C/runs.csv", lambda text: text.replace("r000", "r\x000")),
        "a cell of 3 MB": rows(lambda lines: [lines[0], "x" * 3_000_000 + lines[1], *lines[2:]]),
        "6,000 columns": rows(lambda lines: [line + f",c{at}" * 6000 for at, line in enumerate(lines)]),
        "all the same": rows(lambda lines: [lines[0], *(f"q{at}," + lines[1].partition(",")[2] for at in range(40))]),
        "UTF-16": coded("utf-16"),
        "UTF-32": coded("utf-32"),
        "Latin-1": coded("latin-1"),
        "UTF-7": coded("utf-7"),
        "random bytes": _write("C/runs.csv", hashlib.sha512(b"x").digest() * 300),
        "a ZIP": _write("C/runs.csv", b"PK\x03\x04" + b"\x00" * 500),
        "a path as id": _edit("C/runs.csv", lambda text: text.replace("r000", "../../r000")),
        "a log outside": _edit("C/runs.csv", lambda text: text.replace("logs/r000.csv", "/etc/passwd")),
        "a log that is a folder": _edit("C/runs.csv", lambda text: text.replace("logs/r000.csv", "logs")),
    }
    for name, spoil in whole.items():
        for command in ("check C", "fit C", "geometry C"):
            yield Attack(f"runs.csv: {name}", tuple(command.split()), spoil)


def logs() -> Iterator[Attack]:
    """Yield logs that are damaged, endless, elsewhere or nonsense."""
    first = "C/logs/r000.csv"

    def column(name: str, value: Callable[[int, str], str]) -> Spoil:
        def change(text: str) -> str:
            rows = [line.split(",") for line in text.splitlines()]
            at = rows[0].index(name)
            for number, row in enumerate(rows[1:]):
                row[at] = value(number, row[at])
            return "\n".join(",".join(row) for row in rows) + "\n"

        return _edit(first, change)

    def replaced(make: Callable[[Path], object]) -> Spoil:
        def spoil() -> None:
            Path(first).unlink()
            make(Path(first))

        return spoil

    spoilt: dict[str, Spoil] = {
        "empty": _write(first, b""),
        "header alone": _edit(first, lambda text: text.splitlines()[0] + "\n"),
        "one row": _edit(first, lambda text: "\n".join(text.splitlines()[:2]) + "\n"),
        "time NaN": column("t_s", lambda *_: "nan"),
        "time backwards": column("t_s", lambda n, _: str(-n)),
        "time stands": column("t_s", lambda *_: "1.0"),
        "time 1e300": column("t_s", lambda n, _: f"{n}e300"),
        "counts NaN": column("counts_left", lambda *_: "nan"),
        "counts inf": column("counts_left", lambda n, _: "inf" if n == 1 else "0"),
        "counts 2^63": column("counts_left", lambda n, _: str(2**63 + n)),
        "counts 1e300": column("counts_right", lambda n, _: f"{n + 1}e300"),
        "counts alternate": column("counts_right", lambda n, _: str((-1) ** n * 10**12)),
        "text": column("counts_left", lambda *_: "many"),
        "a FIFO": replaced(os.mkfifo),
        "a loop of links": replaced(lambda path: path.symlink_to(path.name)),
        "a folder": replaced(lambda path: path.mkdir()),
        "a link outside": replaced(lambda path: path.symlink_to("/etc/hostname")),
        "a link to /dev/zero": replaced(lambda path: path.symlink_to("/dev/zero")),
        "gone": replaced(lambda path: path.with_suffix(".gone").touch()),
        "Parquet by name": replaced(lambda path: path.write_bytes(b"PAR1" + b"\xff" * 64 + b"PAR1")),
    }
    for name, spoil in spoilt.items():
        for command in ("check C", "geometry C", "simulate replay C", "ingest C --into out/new"):
            yield Attack(f"log: {name}", tuple(command.split()), spoil)


def _sheets(target: str, name: str, change: Callable[[bytes], bytes]) -> Spoil:
    def spoil() -> None:
        with zipfile.ZipFile("runs.xlsx") as source:
            entries = {entry: source.read(entry) for entry in source.namelist()}
        entries = {entry: change(data) if name in entry else data for entry, data in entries.items()}
        with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as made:
            for entry, data in entries.items():
                made.writestr(entry, data)

    return spoil


LAUGHS = b'<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a "aaaaaaaaaa">' + b"".join(
    b'<!ENTITY %c "%s">' % (98 + n, b"&%c;" % (97 + n) * 10) for n in range(9)
)


def formats() -> Iterator[Attack]:
    """Yield files of every format: nothing, texts, cut, bytes turned, and archives made to be large."""
    names = ("runs.xlsx", "runs.parquet", "log.mat", "log.tdms", "drive.bag", "drive.mcap", "drive.db3", "path.tum")

    def turned(name: str, change: Callable[[bytes], bytes]) -> Spoil:
        return lambda: Path(name).write_bytes(change(Path(name).read_bytes()))

    changes: dict[str, Callable[[bytes], bytes]] = {
        "empty": lambda _: b"",
        "a text": lambda _: b"run_id,distance_m\nr0,1\n",
        "cut in half": lambda data: data[: len(data) // 2],
        "its first 40 bytes": lambda data: data[:40],
        "a byte in 90 turned": lambda data: bytes(b ^ 255 if at % 90 == 60 else b for at, b in enumerate(data)),
        "its end zeroed": lambda data: data[:-200] + b"\x00" * 200,
        "lengths of 2^32": lambda data: data[:64] + struct.pack("<Q", 2**64 - 1) * 8 + data[128:],
        "twice": lambda data: data + data,
    }
    for number, name in enumerate(names):
        for turn, (what, change) in enumerate(changes.items()):
            command = ("ingest {0} --describe", "check {0}", "ingest {0} --into out/new")[(number + turn) % 3]
            yield Attack(f"{name}: {what}", tuple(command.format(name).split()), turned(name, change))
    books = {
        "entities": ("sheet1", lambda _: LAUGHS + b"]><worksheet>&j;</worksheet>"),
        "no worksheet": ("sheet1", lambda _: b"<other/>"),
        "broken XML": ("sheet1", lambda data: data[: len(data) // 3]),
        "a row of 10^9": ("sheet1", lambda data: data.replace(b'r="3"', b'r="1000000000"', 1)),
        "a column of ZZZZZZ": ("sheet1", lambda data: data.replace(b'r="A3"', b'r="ZZZZZZ3"', 1)),
        "20,000 sheets": ("xl/workbook.xml", _many_sheets),
        "no workbook": ("xl/workbook.xml", lambda _: b""),
        "300 MB of spaces": (
            "sheet1",
            lambda data: data.replace(b"</sheetData>", b" " * 300_000_000 + b"</sheetData>"),
        ),
    }
    for what, (entry, change) in books.items():
        for command in ("ingest w.xlsx --describe", "check w.xlsx"):
            yield Attack(f"workbook: {what}", tuple(command.split()), _sheets("w.xlsx", entry, change))


def _many_sheets(data: bytes) -> bytes:
    sheet = b'<sheet name="s%d" sheetId="%d" state="visible" r:id="rId1"/>'
    return data.replace(b"</sheets>", b"".join(sheet % (n, n) for n in range(2, 20_001)) + b"</sheets>")


VALUES = ("nan", "inf", "-inf", "-1", "0", "1e308", "１０", "", "ten", "9" * 400, "1,2,3,4,5", ",,", "--", "1e-320")
PATHS = ("", ".", "..", "/proc", "out", "C", "C/runs.csv", "/dev/null", "/dev/full", "/proc/self/mem", "out/a/../b",
         "no/where", "out/" + "n" * 300, "out/new\nline", "out/ü Ω/文", "out/ ", "loop", "C/runs.csv/x", "-", "~",
         "out/\udcff")  # fmt: skip
#: options that say what is read
READ = {"--law", "--model", "--mapping", "--from", "--candidates", "--seeds", "--journeys", "--simulator", "--campaign",
        "--vehicle", "--truth"}  # fmt: skip
#: what takes long however it ends is given fewer values
SLOW = {"challenge own", "challenge make", "diagnose", "report", "fleet run", "simulate study", "plan", "geometry"}

#: one figure in place of forty
DRAWN_ALONE = {"effects": ["track_width"]}


def choices() -> Iterator[Attack]:
    """Yield values of every kind for every option of every command."""

    def loop() -> None:
        Path("loop").symlink_to("loop")

    for number, command in enumerate(SOUND):
        for turn, (option, is_flag, is_output) in enumerate(sorted(options(command))):
            if is_flag:
                continue
            pool = PATHS if is_output or option in READ else VALUES
            step = 5 if command in SLOW else 2
            for at in range((number + turn) % step, len(pool), step):
                words = worded(command) + DRAWN_ALONE.get(command, [])
                if option in words:
                    place = words.index(option)
                    words[place : place + 2] = []
                value = pool[at]
                yield Attack(f"{command} {option} {value[:20]!r}", (*words, option, value), loop)


def fleets() -> Iterator[Attack]:
    """Yield folders of vehicles that hold something else, and result folders that are none."""
    both = ("fleet run fleet --into out/f", "fleet run fleet --into out/f --what check")
    spoilt: dict[str, Spoil] = {
        "no vehicle": lambda: shutil.rmtree("fleet/v1"),
        "a file": lambda: Path("fleet/v2").touch(),
        "a loop of links": lambda: Path("fleet/v2").symlink_to("v2"),
        "a link outside": lambda: Path("fleet/v2").symlink_to(Path("C").resolve()),
        "an id with a line end": lambda: _moved("fleet/v1", "fleet/v\n1"),
        "an id of no UTF-8": lambda: _moved("fleet/v1", "fleet/v\udcff"),
        "an id that is a formula": lambda: _moved("fleet/v1", "fleet/=1+1"),
        "labels empty": _write("fleet/vehicles.csv", b""),
        "labels without vehicle": _write("fleet/vehicles.csv", b"hall\nA\n"),
        "labels twice": _write("fleet/vehicles.csv", b"vehicle,hall\nv1,A\nv1,B\n"),
        "labels of bytes": _write("fleet/vehicles.csv", b"vehicle,hall\nv1,\xff\xfe\n"),
        "labels as a folder": lambda: Path("fleet/vehicles.csv").mkdir(),
        "labels as a FIFO": lambda: os.mkfifo("fleet/vehicles.csv"),
        "sums as a folder": lambda: Path("out/f/sums.jsonl").mkdir(parents=True),
        "sums as a FIFO": lambda: (Path("out/f").mkdir(), os.mkfifo("out/f/sums.jsonl"))[1],
        "sums of bytes": _write("out/f/sums.jsonl", b'\xff\xfe{}\n[1]\nnull\n{"name": 1}\n'),
        "sums of depth": _write("out/f/sums.jsonl", b"[" * 100_000),
        "checks of bytes": _write("out/f/check.jsonl", b'\xff\n{"seal": 3}\n'),
        "results as a file": _write("out/f", b""),
        "a dataset of no file": _write("fleet/campaign.toml", b"format = 'calib-campaign/1'\n"),
        "settings as a folder": lambda: (
            Path("fleet/v1/campaign.toml").unlink(),
            Path("fleet/v1/campaign.toml").mkdir(),
        )[1],
    }
    for name, spoil in spoilt.items():
        for command in both:
            yield Attack(f"fleet: {name}", tuple(command.split()), spoil)
    for into in ("fleet", "fleet/v1", "fleet/v1/logs", "", "/dev/null", "/proc/1", "C/runs.csv"):
        yield Attack(f"fleet run --into {into!r}", ("fleet", "run", "fleet", "--into", into))
    for scheduler in ("tcp://127.0.0.1:1", "tcp://x:99999", "http://x:1", "tcp://[::1]:1", "\n", "tcp://127.0.0.1:0"):
        words = ("fleet", "run", "fleet", "--into", "out/f", "--scheduler", scheduler)
        yield Attack(f"scheduler {scheduler!r}", words)


def _moved(source: str, target: str) -> None:
    shutil.move(source, target)


FILES = ("coefficients.json", "result/fit.json", "plan.toml", "route.toml", "seeds.toml", "mapping.toml")


def documents() -> Iterator[Attack]:
    """Yield calib's own files with other values, cut, empty, deep, and of other kinds."""
    readers = {
        "coefficients.json": ("export coefficients.json --to c", "fit C --model coefficients.json"),
        "result/fit.json": ("export result --to csv", "report result --into out/r.pdf"),
        "plan.toml": ("plan --from plan.toml",),
        "route.toml": ("simulate route route.toml --real 0.1,0.099",),
        "seeds.toml": ("challenge make --seeds seeds.toml --into out/made --workers 1",),
        "mapping.toml": ("ingest C/runs.csv --into out/i --mapping mapping.toml",),
    }
    texts: dict[str, Callable[[str], str]] = {
        "empty": lambda _: "",
        "null": lambda _: "null",
        "a list": lambda _: "[1, 2]",
        "100,000 brackets": lambda _: "[" * 100_000,
        "cut": lambda text: text[: 2 * len(text) // 3],
        "every number 0": lambda text: _numbers(text, "0"),
        "every number -1": lambda text: _numbers(text, "-1"),
        "every number 1e308": lambda text: _numbers(text, "1e308"),
        "numbers as texts": lambda text: _numbers(text, '"1"'),
        "NaN": lambda text: _numbers(text, "nan" if "=" in text[:200] else "NaN"),
        "keys twice": lambda text: text + text,
        "keys in capitals": lambda text: text.upper(),
    }
    for name in FILES:
        for number, (what, change) in enumerate(texts.items()):
            command = readers[name][number % len(readers[name])]
            yield Attack(f"{name}: {what}", tuple(command.split()), _edit(name, change))


def _numbers(text: str, value: str) -> str:
    import re

    return re.sub(r"(?<=[=:\[, ])-?\d+(\.\d+)?([eE][-+]?\d+)?(?=[,\n\]} ])", value, text)


SIMULATORS = {
    "none": '["no-such-program", "{campaign}", "{parameters}", "{out}"]',
    "one that fails": '["false", "{campaign}", "{parameters}", "{out}"]',
    "one that writes nothing": '["true", "{campaign}", "{parameters}", "{out}"]',
    "an empty command": "[]",
    "a folder": '["/", "{campaign}", "{parameters}", "{out}"]',
    "one that writes no table": '["sh", "-c", "head -c 3000 /dev/urandom > $2", "{campaign}", "{parameters}", "{out}"]',
    "one that never ends": '["sh", "-c", "sleep 600", "{campaign}", "{parameters}", "{out}"]',
    "one that floods": '["sh", "-c", "yes | head -c 50000000; exit 3", "{campaign}", "{parameters}", "{out}"]',
    "one with NaN": '["sh", "-c", "printf \'run_id,sim_distance_m\\\\nr000,nan\\\\n\' > $2", '
    '"{campaign}", "{parameters}", "{out}"]',
    "one that removes its inputs": '["sh", "-c", "rm -r $0 $1", "{campaign}", "{parameters}", "{out}"]',
    "one that is no text": '["sh", "-c", "printf \'\\\\377\\\\376\' >&2; exit 1", '
    '"{campaign}", "{parameters}", "{out}"]',
    "braces": '["sh", "-c", "echo {nothing} {0} {} > $2", "{campaign}", "{parameters}", "{out}"]',
}


def simulators() -> Iterator[Attack]:
    """Yield simulators of the user's that fail in every way."""
    for name, command in SIMULATORS.items():
        text = (
            f'command = {command}\ntimeout_s = 2\n[[parameter]]\nname = "r"\nnominal = 0.1\nstep = 0.001\n'
            'largest = 0.01\nunit = "m"\n'
        )
        words = ("diagnose", "C", "--simulator", "sim.toml", "--json", "out/j.json")
        yield Attack(f"simulator: {name}", words, _write("sim.toml", text))


def surroundings() -> Iterator[Attack]:
    """Yield variables of the environment and limits of the process, on a quick and on a drawing command."""
    variables = {
        "SOURCE_DATE_EPOCH": ("", "x", "-1", "1e9", "9" * 30, "253402300800"),
        "COLUMNS": ("0", "-5", "1", "x", "9" * 30),
        "HOME": ("", "/nowhere", "/dev/null"),
        "TMPDIR": ("/nowhere", "/dev/null"),
        "TZ": ("x/y/z", ":", "\udcff"),
        "LC_ALL": ("C", "xx_YY"),
        "PYTHONWARNINGS": ("error",),
        "OMP_NUM_THREADS": ("x", "-1", "100000"),
        "MPLCONFIGDIR": ("/dev/null", "/proc/1"),
        "MPLBACKEND": ("nonsense",),
        "TERM": ("dumb", ""),
        "FORCE_COLOR": ("1",),
        "XDG_CACHE_HOME": ("/dev/null", "\n"),
    }
    commands = ("check C", "fit C --figures out/figures", "report result --into out/r.pdf")
    for number, (name, values) in enumerate(variables.items()):
        for turn, value in enumerate(values):

            def hinder(name: str = name, value: str = value) -> None:
                os.environ[name] = value

            command = commands[(number + turn) % len(commands)]
            yield Attack(f"{name}={value[:12]!r}: {command}", tuple(command.split()), hinder=hinder)
    for kind, most in (("NOFILE", 12), ("NOFILE", 30), ("FSIZE", 100), ("STACK", 200_000), ("NPROC", 1)):

        def limit(kind: str = kind, most: int = most) -> None:
            import signal

            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            resource.setrlimit(getattr(resource, f"RLIMIT_{kind}"), (most, most))

        for command in ("check C", "fit C --json out/j.json", "ingest runs.xlsx --into out/new"):
            yield Attack(f"limit {kind} {most}: {command}", tuple(command.split()), hinder=limit)
    for command in SOUND:
        yield Attack(f"closed output: {command}", tuple(worded(command)), closed=True)


PARTS: dict[str, Callable[[], Iterator[Attack]]] = {
    "settings": settings,
    "tables": tables,
    "logs": logs,
    "formats": formats,
    "choices": choices,
    "fleets": fleets,
    "documents": documents,
    "simulators": simulators,
    "surroundings": surroundings,
}


def _state() -> dict[str, str]:
    """Return what the inputs are: the hash of each file, the target of each link."""
    state = {}
    for place, _, files in os.walk("."):
        if place == "./out" or place.startswith("./out/"):
            continue
        for name in files:
            path = Path(place, name)
            regular = path.is_file() and not path.is_symlink()
            state[str(path)] = hashlib.sha256(path.read_bytes()).hexdigest() if regular else "no file"
    return state


def made(base: Path, *, sealed: bool = True) -> Path:
    """Make the sound inputs below `base`: those of the fuzz, a fleet of one vehicle, and a set of one sealed case."""
    prepared(base)
    shutil.rmtree(base / "kept")
    shutil.copytree(base / "C", base / "fleet" / "v1")
    if not sealed:
        return base
    with contextlib.chdir(base):
        run(["challenge", "make", "--seeds", "seeds.toml", "--into", "set", "--workers", "1"])
        run(["challenge", "run", "set", "--workers", "1"])
    return base


def fault_of(attack: Attack, base: Path, seconds: float) -> str:
    """Run an attack on a copy of the inputs and return what is wrong with the answer; empty where nothing is."""
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        work = Path(shutil.copytree(base, Path(folder, "work")))
        with contextlib.chdir(work):
            Path("out").mkdir()
            attack.spoil()
            before = _state()

            def limited() -> None:
                resource.setrlimit(resource.RLIMIT_CPU, (int(seconds), int(seconds)))
                if attack.hinder is not None:
                    attack.hinder()

            end = ended(list(attack.words), closed=attack.closed, before=limited)
            after = _state()
            changed = sorted(name for name, value in before.items() if after.get(name) != value)
            # what a command adds beside inputs is told by its words, what it removes or changes by none
            if end.status not in {0, 1, 2} | ({141} if attack.closed else set()):
                return f"status {end.status} after {end.seconds:.1f} s: {end.error[-300:]!r}"
            if "Traceback" in end.error or "bug in calib" in end.error or (end.status == 2 and not end.one_line):
                return f"more than a line: {end.error[-400:]!r}"
            if end.status == 2 and not end.error.strip():
                return "no line"
            if changed and not attack.name.startswith("challenge run"):
                return f"status {end.status}, changed {changed[:5]}"
            for written in Path("out").glob("*.json"):
                try:
                    json.loads(written.read_bytes(), parse_constant=_no_number)
                except ValueError as error:
                    return f"{written}: {error}"
    return ""


def _no_number(text: str) -> float:
    raise ValueError(f"{text} in JSON")


def main() -> int:
    """Try the attacks of some parts, or all, and print each fault; the status is 1 where there is one."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], help="all by default")
    parser.add_argument("--seconds", type=float, default=60.0, help="processor time that a command may take")
    parser.add_argument("--each", type=int, default=1, help="only one attack of so many")
    asked = parser.parse_args()
    faults, ending.LONGEST_S = 0, 4 * asked.seconds
    with tempfile.TemporaryDirectory() as folder:
        with contextlib.redirect_stdout(sys.stderr):
            base = made(Path(folder) / "base")
        for part in asked.parts or PARTS:
            attacks = list(PARTS[part]())[:: asked.each]
            for attack in attacks:
                fault = fault_of(attack, base, asked.seconds)
                if fault:
                    faults += 1
                    sys.stdout.write(f"  {part}: {attack.name}: {' '.join(attack.words)[:120]!r}: {fault}\n")
                    sys.stdout.flush()
            sys.stdout.write(f"{part}: {len(attacks)} attacks\n")
            sys.stdout.flush()
    return int(faults > 0)


if __name__ == "__main__":
    sys.exit(main())
