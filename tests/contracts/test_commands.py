"""What every command of the command line has in common."""

from __future__ import annotations

import importlib
import re
from pathlib import Path
from typing import get_type_hints

import pytest

from calib.cli.main import COMMANDS, SUMMARIES, run

CLI = Path(__file__).resolve().parents[2] / "calib" / "cli"
EVERY = [tuple(name.split()) for name in COMMANDS]


def _help(arguments: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> str:
    assert run([*arguments, "--help"]) == 0
    return capsys.readouterr().out


def test_every_file_of_a_command_is_registered() -> None:
    files = {
        ".".join(path.relative_to(CLI).with_suffix("").parts)
        for path in CLI.rglob("*.py")
        if "\nEPILOG = " in path.read_text(encoding="utf-8")
    }
    assert files == set(COMMANDS.values())


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_is_a_function_whose_options_all_say_what_they_are(name: str) -> None:
    """Nothing is nested: ``run`` can be called and followed from outside, and each parameter has its help."""
    function = importlib.import_module(f"calib.cli.{COMMANDS[name]}").run
    for parameter, hint in get_type_hints(function, include_extras=True).items():
        if parameter != "return":
            assert hint.__metadata__[0].help, parameter


def test_every_command_has_a_summary() -> None:
    assert set(COMMANDS) <= set(SUMMARIES)


@pytest.mark.parametrize("arguments", EVERY, ids=" ".join)
def test_help_shows_an_example(arguments: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    shown = " ".join(_help(arguments, capsys).split())
    assert re.search(r"Examples?: .*\bcalib " + " ".join(arguments), shown)


@pytest.mark.parametrize("arguments", EVERY, ids=" ".join)
def test_every_command_offers_json_and_never_overwrites_unasked(
    arguments: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    shown = _help(arguments, capsys)
    assert "--json" in shown
    assert "--force" in shown


@pytest.mark.parametrize("arguments", EVERY, ids=" ".join)
def test_an_unknown_option_is_one_line_and_status_2(
    arguments: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run([*arguments, "--no-such-option"]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)


@pytest.mark.parametrize("arguments", [one for one in EVERY if one != ("init",)], ids=" ".join)
def test_a_campaign_that_is_not_there_is_one_line_and_status_2(
    arguments: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Commands without a campaign refuse the argument; all but ``init``, which makes one, say that it is not there."""
    assert run([*arguments, str(tmp_path / "absent")]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
