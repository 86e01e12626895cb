"""Attacks on files: settings, run tables, logs, files of every format, and calib's own documents."""

from __future__ import annotations

import hashlib
import os
import re
import struct
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

from tests.robust.attack import Attack, Spoil, edit, write

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

            yield Attack(f"{key} = {value[:12]}", tuple(command.split()), edit("C/campaign.toml", change))
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
            yield Attack(f"campaign.toml: {name}", tuple(command.split()), write("C/campaign.toml", data))


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

            yield Attack(f"{column} {cell[:10]!r}", tuple(command.split()), edit("C/runs.csv", change))

    def rows(change: Callable[[list[str]], list[str]]) -> Spoil:
        return edit("C/runs.csv", lambda text: "\n".join(change(text.splitlines())) + "\n")

    def coded(encoding: str) -> Spoil:
        def spoil() -> None:
            text = Path("C/runs.csv").read_text(encoding="utf-8").replace("corridor", "Flur-ä")
            Path("C/runs.csv").write_bytes(text.encode(encoding))

        return spoil

    whole: dict[str, Spoil] = {
        "empty": write("C/runs.csv", b""),
        "line ends alone": write("C/runs.csv", b"\n\r\n\r" * 50),
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
        "carriage returns": edit("C/runs.csv", lambda text: text.replace("\n", "\r")),
        "NUL in the middle": edit("C/runs.csv", lambda text: text.replace("r000", "r\x000")),
        "a cell of 3 MB": rows(lambda lines: [lines[0], "x" * 3_000_000 + lines[1], *lines[2:]]),
        "6,000 columns": rows(lambda lines: [line + f",c{at}" * 6000 for at, line in enumerate(lines)]),
        "all the same": rows(lambda lines: [lines[0], *(f"q{at}," + lines[1].partition(",")[2] for at in range(40))]),
        "UTF-16": coded("utf-16"),
        "UTF-32": coded("utf-32"),
        "Latin-1": coded("latin-1"),
        "UTF-7": coded("utf-7"),
        "random bytes": write("C/runs.csv", hashlib.sha512(b"x").digest() * 300),
        "a ZIP": write("C/runs.csv", b"PK\x03\x04" + b"\x00" * 500),
        "a path as id": edit("C/runs.csv", lambda text: text.replace("r000", "../../r000")),
        "a log outside": edit("C/runs.csv", lambda text: text.replace("logs/r000.csv", "/etc/passwd")),
        "a log that is a folder": edit("C/runs.csv", lambda text: text.replace("logs/r000.csv", "logs")),
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

        return edit(first, change)

    def replaced(make: Callable[[Path], object]) -> Spoil:
        def spoil() -> None:
            Path(first).unlink()
            make(Path(first))

        return spoil

    spoilt: dict[str, Spoil] = {
        "empty": write(first, b""),
        "header alone": edit(first, lambda text: text.splitlines()[0] + "\n"),
        "one row": edit(first, lambda text: "\n".join(text.splitlines()[:2]) + "\n"),
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
            yield Attack(f"{name}: {what}", tuple(command.split()), edit(name, change))


def _numbers(text: str, value: str) -> str:
    return re.sub(r"(?<=[=:\[, ])-?\d+(\.\d+)?([eE][-+]?\d+)?(?=[,\n\]} ])", value, text)
