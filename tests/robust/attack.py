"""One attack: a command in a process of its own, on a copy of sound inputs that is spoilt in one way."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import resource
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from calib.cli.main import run
from tests.fuzz.sound import prepared
from tests.robust.ending import ended

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


def write(path: str, data: bytes | str) -> Spoil:
    def spoil() -> None:
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        Path(path).write_bytes(data if isinstance(data, bytes) else data.encode())

    return spoil


def edit(path: str, change: Callable[[str], str]) -> Spoil:
    def spoil() -> None:
        text = Path(path).read_text(encoding="utf-8")
        Path(path).write_text(change(text), encoding="utf-8")

    return spoil


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


def _no_number(text: str) -> float:
    raise ValueError(f"{text} in JSON")
