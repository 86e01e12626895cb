"""The commands that README and site show are commands of this version, and what they show is what is printed."""

from __future__ import annotations

import importlib.util
import re
import shlex
from pathlib import Path
from types import ModuleType

import pytest

from calib.cli import COMMANDS
from calib.cli.main import run

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
TEST_LINE = 'python3 -m venv .venv && .venv/bin/pip install -q -e ".[test]" && .venv/bin/python -m pytest -n 2'
#: commands whose output is quick to make and does not hang on the last digits of a long computation
QUICK = ("check", "loads", "deviation", "simulate")


def _tour() -> ModuleType:
    spec = importlib.util.spec_from_file_location("tour", ROOT / "docs" / "tour.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


TOUR = _tour()
TEXTS = [page.read_text(encoding="utf-8") for page in TOUR.PAGES]
BLOCKS = list(dict.fromkeys(found.group(0) for text in TEXTS for found in TOUR.BLOCK.finditer(text)))
SHOWN = list(dict.fromkeys(command for block in BLOCKS for command in TOUR.commands_of(block)))
MOST_WORDS = 1500
NUMBER = re.compile(r"\d+(?:\.\d+)?")
#: three digits are shown: half of the last one, and rounding on another machine
LAST_DIGIT = 0.01


@pytest.mark.parametrize("command", SHOWN)
def test_a_command_shown_has_the_options_shown(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    words = shlex.split(command.split(" | ", maxsplit=1)[0])
    assert words[0] == "calib"
    command = next(name for name in COMMANDS if words[1 : 1 + len(name.split())] == name.split())
    assert run([*command.split(), "--help"]) == 0
    known = set(re.findall(r"--[a-z-]+", capsys.readouterr().out))
    assert {word for word in words if word.startswith("--")} <= known


@pytest.mark.parametrize("block", [b for b in BLOCKS if b.split()[2] in QUICK], ids=lambda b: b.splitlines()[0])
def test_what_is_shown_is_what_is_printed(block: str) -> None:
    commands = TOUR.commands_of(block)
    assert len(commands) == 1
    assert block == f"{TOUR.PROMPT}{commands[0]}\n{TOUR.output_of(commands[0])}\n"


def test_the_diagnosis_in_the_readme_is_what_is_printed() -> None:
    """Words and layout as they stand, figures but for the last digit of a long computation."""
    (block,) = [
        found.group(0) for found in TOUR.BLOCK.finditer(README) if found.group(0).startswith("$ calib diagnose")
    ]
    (command,) = TOUR.commands_of(block)
    printed = f"{TOUR.PROMPT}{command}\n{TOUR.output_of(command)}\n"
    assert NUMBER.sub("#", block) == NUMBER.sub("#", printed)
    assert [float(n) for n in NUMBER.findall(printed)] == pytest.approx(
        [float(n) for n in NUMBER.findall(block)], rel=LAST_DIGIT
    )


def test_the_line_that_tests_is_the_one_of_continuous_integration() -> None:
    assert TEST_LINE in README.splitlines()
    assert TEST_LINE in (ROOT / ".ci" / "run").read_text(encoding="utf-8").splitlines()


def test_the_readme_is_read_in_ten_minutes() -> None:
    """Fifteen hundred words; everything else is on the site."""
    assert len(README.split()) <= MOST_WORDS


def test_links_lead_to_files_of_the_project() -> None:
    pages = [page.relative_to(ROOT).as_posix() for page in (ROOT / "docs").rglob("*.md")]
    for name in ("README.md", "CONTRIBUTING.md", "reports/README.md", *pages):
        text = (ROOT / name).read_text(encoding="utf-8")
        targets = [one for one in re.findall(r"\]\(([^)#\s]+)", text) if "://" not in one]
        assert all((ROOT / name).parent.joinpath(one).exists() for one in targets), name


def test_files_named_in_the_documents_exist() -> None:
    for name in ("README.md", "CONTRIBUTING.md"):
        text = (ROOT / name).read_text(encoding="utf-8")
        for path in re.findall(r"`((?:calib|tests|sample_runs|docs)/[\w./-]+)`", text):
            assert (ROOT / path).exists(), f"{name}: {path}"
