"""Damaged inputs for every file format and option, and what a command may answer to them."""

from __future__ import annotations

import contextlib
import io
import json
import random
import shutil
import signal
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from calib.cli.main import run

ROOT = Path(__file__).resolve().parents[2]
ALLOWED = {0, 1, 2, 130}
LONGEST_S = 10.0
#: pieces that have hurt programs before
NASTY = (
    b"", b"\x00", b"\xff\xfe", b"\xef\xbb\xbf", b"9" * 400, b"-1e308", b"1e400", b"nan", b"inf", b"-inf", b"1_000",
    b"0x1p-1074", b'"', b"'", b"\\", b"\n", b"\r", b"\r\n", b",", b";", b"\t", b"[", b"]", b"{", b"}", b"=", b"#",
    b"../../etc/passwd", b"/dev/zero", b"[/red]", b"[link=file:///]x[/link]", b"\x1b[2J", b"\xe2\x80\xae", b"=1+1",
    b"null", b"true", b"[[[[[[[[[[", b"a.b.c.d.e.f.g.h = 1\n", b"%s%n", b"1970-01-01", b"\xed\xa0\x80", b"1e-320",
)  # fmt: skip
OPTION_VALUES = (
    "-1", "0", "1e15", "1e300", "1e-300", "nan", "inf", "9" * 400, "", " ", "x" * 300, "[/red]", "\x1b[2J", "\u202e",
    "a\x00b", "../..", "/dev/null", "--help", "-", "300,", "300,300,300", "\udcff", "\u4e2d\u6587", "2025-02-30", "0.5",
)  # fmt: skip
OPTIONS: dict[str, tuple[str, ...]] = {
    "check": ("--json", "--strict"),
    "fit": ("--reference-load", "--model", "--json", "--into"),
    "export": ("--to", "--load", "--outside", "--date", "--output", "--accept-implausible", "--json"),
    "loads": ("--payload", "--payload-at", "--mass", "--cog-x", "--track", "--wheelbase", "--max-load", "--vehicle"),
    "deviation": ("--amplitude", "--wavelength", "--distance", "--json"),
    "report": ("--date", "--seed", "--into"),
    "diagnose": ("--seed", "--exclude", "--model"),
    "ingest": ("--mapping", "--into", "--json"),
}


@dataclass
class Outcome:
    """What a command answered."""

    arguments: list[str]
    status: int | str
    error: str
    seconds: float

    @property
    def fault(self) -> str:
        """What is wrong with the answer; empty where nothing is."""
        if self.status not in ALLOWED:
            return f"status {self.status}: {self.error[-300:]}"
        if "Traceback" in self.error or "bug in calib" in self.error:
            return f"no helpful line: {self.error[-300:]}"
        if self.status == 2 and not self.error.strip():
            return "no line at all"
        lines = [line for line in self.error.splitlines() if not line.startswith("calib: note:")]
        if self.status == 2 and len(lines) != 1 and "Usage" not in self.error:
            return f"{len(lines)} lines instead of one: {self.error[:300]!r}"
        return f"{self.seconds:.1f} s" if self.seconds > LONGEST_S else ""


def small_campaign(folder: Path) -> Path:
    """Make a campaign of a dozen runs, three of them with short logs, out of the samples."""
    source = ROOT / "sample_runs" / "corridor"
    folder.mkdir(parents=True)
    shutil.copy(source / "campaign.toml", folder)
    lines = (source / "runs.csv").read_text(encoding="utf-8").splitlines()
    kept = [lines[0]]
    (folder / "logs").mkdir()
    for number, line in enumerate(lines[1::5][:12]):
        cells = line.split(",")
        if number < 3:
            text = (source / cells[-1]).read_text(encoding="utf-8").splitlines()
            (folder / cells[-1]).write_text("\n".join([text[0], *text[1:-1:20], text[-1]]) + "\n", encoding="utf-8")
        else:
            cells[-1] = ""
        kept.append(",".join(cells))
    (folder / "runs.csv").write_text("\n".join(kept) + "\n", encoding="utf-8")
    return folder


def prepared(base: Path) -> Path:
    """Make the sound inputs of every format that the damage starts from."""
    campaign = small_campaign(base / "C")
    calls = [
        ["fit", str(campaign), "--into", str(base / "result")],
        ["export", str(campaign), "--to", "json", "--output", str(base / "coefficients.json")],
    ]
    for arguments in calls:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            run(arguments)
    (base / "mapping.toml").write_text(
        '[table]\nrun_id = "run_id"\ndistance_m = {column = "distance_m", factor = 1.0}\nsession = {value = "x"}\n'
        '[log]\nfile = "{run_id}.csv"\n',
        encoding="utf-8",
    )
    import pandas as pd

    table = pd.read_csv(campaign / "runs.csv")
    table.to_excel(base / "runs.xlsx", index=False)
    with contextlib.suppress(ImportError):
        table.to_parquet(base / "runs.parquet", index=False)
    return base


def damaged(data: bytes, rng: random.Random) -> bytes:
    """Return bytes with one to four damages: bits, cuts, doublings, nasty pieces, numbers put for numbers."""
    out = bytearray(data)
    for _ in range(rng.randint(1, 4)):
        at = rng.randrange(len(out) + 1)
        kind = rng.randrange(7)
        if kind == 0 and out:
            out[at % len(out)] ^= 1 << rng.randrange(8)
        elif kind == 1:
            del out[at : at + rng.choice((1, 3, 20, 400))]
        elif kind == 2:
            out[at:at] = out[at : at + rng.choice((1, 10, 200))]
        elif kind in (3, 4):
            out[at : at + rng.choice((0, 0, 1, 5))] = rng.choice(NASTY)
        elif kind == 5 and out:
            out[at % len(out)] = rng.randrange(256)
        else:
            _other_cell(out, rng)
    return bytes(out)


def _other_cell(out: bytearray, rng: random.Random) -> None:
    """Put a nasty piece in place of what stands between two separators."""
    marks = [index for index, byte in enumerate(out) if byte in b",=\n:"]
    if len(marks) > 1:
        number = rng.randrange(len(marks) - 1)
        out[marks[number] + 1 : marks[number + 1]] = rng.choice(NASTY)


def _file_case(base: Path, rng: random.Random) -> list[str]:
    work = base / "work"
    shutil.rmtree(work, ignore_errors=True)
    kind = rng.randrange(10)
    if kind < 6:
        shutil.copytree(base / "C", work)
        name = ("campaign.toml", "runs.csv", "logs/r000.csv")[(kind // 2) % 3]
        target = work / name
        if target.exists():
            target.write_bytes(damaged(target.read_bytes(), rng))
        return rng.choice([["check", str(work)], ["check", str(work), "--json", "-"], ["fit", str(work)]])
    work.mkdir()
    source = {6: "result/fit.json", 7: "coefficients.json", 8: "mapping.toml"}.get(kind, "")
    if kind == 9:
        source = rng.choice([name for name in ("runs.xlsx", "runs.parquet") if (base / name).exists()])
    target = work / Path(source).name
    data = damaged((base / source).read_bytes(), rng)
    if source.endswith("fit.json") and rng.random() < 0.7:
        data = _resealed(base / source, rng) or data
    target.write_bytes(data)
    if kind == 8:
        return ["ingest", str(base / "C" / "runs.csv"), "--into", str(work / "out"), "--mapping", str(target)]
    if kind == 9:
        return ["ingest", str(target), "--into", str(work / "out")]
    return ["export", str(target), "--to", rng.choice(["json", "c", "csv", "ros2"])]


def _resealed(path: Path, rng: random.Random) -> bytes | None:
    """Return a fit with a part of it changed and a checksum that fits, so that the damage passes the seal."""
    from calib.seal import checksum

    document = json.loads(path.read_text(encoding="utf-8"))
    _change(document, rng)
    document.pop("checksum", None)
    try:
        return json.dumps(document | {"checksum": checksum(document)}).encode()
    except (ValueError, OverflowError, TypeError):
        return None


def _change(value: Any, rng: random.Random) -> None:
    while isinstance(value, dict | list) and value:
        key = rng.choice(list(value)) if isinstance(value, dict) else rng.randrange(len(value))
        if not isinstance(value[key], dict | list) or not value[key] or rng.random() < 0.15:
            kind = rng.randrange(4)
            if kind == 0:
                del value[key]
            elif kind == 1 and isinstance(value, list):
                value.append(value[key])
            else:
                value[key] = rng.choice([None, "x", -1, 0, 1e308, -1e-308, [], {}, True, 10**400, "\x1b[2J"])
            return
        value = value[key]


def _option_case(base: Path, rng: random.Random) -> list[str]:
    command = rng.choice(list(OPTIONS))
    arguments = [command]
    if command in {"check", "fit", "export"}:
        arguments.append(rng.choice([str(base / "C"), str(base / "result"), rng.choice(OPTION_VALUES)]))
    elif command in {"report", "diagnose", "ingest"}:
        # these are slow where they succeed: the path is never a sound one
        arguments.append(str(base / rng.choice(["absent", "mapping.toml", "\x1b[2J", "n" * 300])))
    for _ in range(rng.randint(1, 3)):
        option = rng.choice(OPTIONS[command])
        value = rng.choice(OPTION_VALUES)
        if option in {"--json", "--into", "--output"}:
            # what is written stays in the work folder
            value = rng.choice(["-", str(base / "out" / ("n" * 300)), str(base / "C" / "runs.csv"), str(base / "C")])
        arguments += [option, value]
    if command == "export" and "--to" not in arguments:
        arguments += ["--to", "json"]
    return arguments


def outcome(arguments: list[str]) -> Outcome:
    """Run a command in this process, and no longer than the longest time allowed."""
    out, err = io.StringIO(), io.StringIO()
    # the processor's time: a busy machine is no fault of the code; a wait that never ends meets the alarm
    started = time.process_time()
    previous = signal.signal(signal.SIGALRM, _too_long)
    signal.setitimer(signal.ITIMER_REAL, 6 * LONGEST_S)
    status: int | str
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            status = run(arguments)
    except BaseException as error:
        status = f"{type(error).__name__}: {error}"
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, previous)
    return Outcome(arguments, status, err.getvalue(), time.process_time() - started)


def _too_long(*_: object) -> None:
    raise TimeoutError("hangs")


CASES: tuple[Callable[[Path, random.Random], list[str]], ...] = (_file_case, _file_case, _file_case, _option_case)


def outcomes(base: Path, count: int, seed: int) -> Iterator[tuple[int, Outcome]]:
    """Yield the number and the outcome of `count` damaged inputs; each number is one input, whatever came before."""
    for number in range(count):
        rng = random.Random(seed * 1_000_003 + number)
        yield number, outcome(rng.choice(CASES)(base, rng))
