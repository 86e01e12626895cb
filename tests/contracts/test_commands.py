"""What every command of the command line has in common."""

from __future__ import annotations

import re
from pathlib import Path
from typing import get_type_hints

import pytest

from calib.cli import COMMANDS, SUMMARIES, function_of, module_of
from calib.cli.main import run

CLI = Path(__file__).resolve().parents[2] / "calib" / "cli"
EVERY = [tuple(name.split()) for name in COMMANDS]


def _help(arguments: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> str:
    assert run([*arguments, "--help"]) == 0
    return capsys.readouterr().out


def test_every_file_of_a_command_is_registered() -> None:
    files = {f"calib.cli.{path.stem}" for path in CLI.glob("*.py") if "Example: calib" in path.read_text("utf-8")}
    assert files - {"calib.cli.__init__"} == {module_of(name) for name in COMMANDS}


def test_a_command_is_a_function_whose_options_all_say_what_they_are() -> None:
    """Nothing is nested: the function can be called and followed from outside, and each parameter has its help."""
    for name in COMMANDS:
        for parameter, hint in get_type_hints(function_of(name), include_extras=True).items():
            assert parameter == "return" or hint.__metadata__[0].help, f"{name}: {parameter}"


def test_every_command_has_a_summary() -> None:
    assert set(COMMANDS) <= set(SUMMARIES)


def test_help_shows_an_example(capsys: pytest.CaptureFixture[str]) -> None:
    for arguments in EVERY:
        shown = " ".join(_help(arguments, capsys).split())
        assert re.search(r"Examples?: .*\bcalib " + " ".join(arguments), shown), arguments


def test_every_command_offers_json_and_never_overwrites_unasked(capsys: pytest.CaptureFixture[str]) -> None:
    for arguments in EVERY:
        shown = _help(arguments, capsys)
        assert "--json" in shown, arguments
        assert "--force" in shown, arguments


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
