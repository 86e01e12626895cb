from __future__ import annotations

import pytest

from calib.cli.commands import COMMANDS, SUMMARIES
from calib.cli.main import run


def test_every_command_has_its_line_in_the_list(capsys: pytest.CaptureFixture[str]) -> None:
    assert set(COMMANDS) <= set(SUMMARIES)
    assert run(["--help"]) == 0
    out = capsys.readouterr().out
    for name in COMMANDS:
        assert f"{name.split()[0]} " in out
    assert "..." not in out.split("Commands:")[1]


def test_an_unknown_command_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["frobnicate"]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
