"""The script of attacks knows every command, tries as many as the documentation says, and sees faults."""

from __future__ import annotations

import contextlib
import io
import os
import re
from pathlib import Path

import pytest

from calib.cli import COMMANDS
from tests.robust.attack import Attack, fault_of, made
from tests.robust.attacks import PARTS, chosen

ROOT = Path(__file__).resolve().parents[2]
#: processor seconds of a command here; none takes a tenth of it
SECONDS = 60.0


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        return made(tmp_path_factory.mktemp("attacks") / "base", sealed=False)


def test_as_many_are_tried_as_is_said() -> None:
    """The count in the documentation is that of the script, and every command is attacked by its options."""
    total = sum(len(list(part())) for part in PARTS.values())
    said = re.search(r"tests\.robust\.attacks` tries ([0-9,]+) attacks", (ROOT / "docs" / "robustness.md").read_text())
    assert said is not None
    assert int(said[1].replace(",", "")) == total
    words = [" ".join(attack.words) for attack in PARTS["choices"]()]
    assert all(any(line.startswith(f"{command} ") for line in words) for command in COMMANDS if command != "init")


def test_parts_hold_each_attack_once() -> None:
    whole = [attack.name for attack in chosen("settings")]
    assert sorted(name for n in (1, 2, 3) for name in (a.name for a in chosen("settings", f"{n}/3"))) == sorted(whole)
    assert {a.words[0] for a in chosen("choices", only="fit *")} == {"fit"}


# fleets end in a PDF, whose compiler's threads do not survive the fork of a process that has used it
@pytest.mark.parametrize("part", ["settings", "tables", "logs", "formats", "documents", "simulators"])
def test_an_attack_of_each_part_is_answered(part: str, base: Path) -> None:
    attacks = list(PARTS[part]())
    assert fault_of(attacks[len(attacks) // 2], base, SECONDS) == ""


def test_faults_are_seen(base: Path) -> None:
    """A command that ends the process, one that changes an input, one that takes too long, JSON that is none."""

    def killed() -> None:
        os._exit(7)

    def spinning() -> None:
        while True:
            pass

    def spoiling() -> None:
        Path("C/runs.csv").write_text("changed")

    def no_json() -> None:
        Path("out/x.json").write_text('{"a": NaN}')

    check = ("check", "C")
    assert "status 7" in fault_of(Attack("", check, hinder=killed), base, SECONDS)
    assert "status -" in fault_of(Attack("", check, hinder=spinning), base, 1.0)
    assert "changed" in fault_of(Attack("", check, hinder=spoiling), base, SECONDS)
    assert "NaN" in fault_of(Attack("", check, hinder=no_json), base, SECONDS)
