"""`calib challenge`: what a user sees."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from calib.challenge import truth_path
from calib.cli.main import run

SEEDS = """
format = "calib-challenge-seeds/1"
purpose = "test"
seed = 6
max_runs = 30
[cases]
empty = 1
"""


def test_make_prints_the_hash_and_score_wants_verdicts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("seeds.toml").write_text(SEEDS, encoding="utf-8")
    assert run(["challenge", "make", "--seeds", "seeds.toml", "--into", "blind", "--workers", "1", "--json", "-"]) == 0
    out, err = capsys.readouterr()
    made = json.loads(out)
    assert made["sha256"] in err
    assert made["cases"] == 1
    # no verdict yet: the case counts as missing and the board misses its targets
    assert run(["challenge", "score", "blind", "--json", "score.json"]) == 1
    assert json.loads(Path("score.json").read_text(encoding="utf-8"))["board"]["false alarms"]["hits"] == 1
    assert "MISSED" in capsys.readouterr().out
    Path("blind/verdicts").mkdir()
    Path("blind/verdicts/c0001.json").write_text('{"verdict": "no_gap", "causes": []}', encoding="utf-8")
    assert run(["challenge", "run", "blind", "--workers", "1"]) == 0
    assert "1 had a verdict already" in capsys.readouterr().out
    assert run(["challenge", "score", "blind", "--plot", "board.svg"]) == 0
    assert Path("board-confusion.svg").is_file()
    assert run(["challenge", "make", "--seeds", "seeds.toml", "--into", "blind"]) == 2
    assert "--force" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["run", "score"])
def test_a_folder_that_is_no_set_is_bad_input(command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["challenge", command, str(tmp_path)]) == 2
    err = capsys.readouterr().err
    assert "calib challenge make" in err
    assert err.count("\n") == 1


@pytest.mark.parametrize("command", ["make", "own", "run", "score"])
def test_help_has_an_example(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["challenge", command, "--help"]) == 0
    assert "Example: calib challenge" in capsys.readouterr().out


def test_own_refuses_what_it_cannot_plant(
    tmp_path: Path, project_root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A size that is none, or a folder that is no campaign, is bad input, in one line."""
    yard = str(project_root / "sample_runs" / "yard")
    for arguments, said in (([yard, "--sizes", "strong"], "10s"), ([str(tmp_path)], "campaign.toml")):
        assert run(["challenge", "own", *arguments]) == 2
        err = capsys.readouterr().err
        assert said in err
        assert err.count("\n") == 1


def test_own_says_what_a_campaign_would_find(
    project_root: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Track width at three times its typical size is found on the sample; the JSON has the fields of the contract."""
    monkeypatch.setattr("calib.challenge.own_runs.EMPTY_EACH", 1)
    yard = str(project_root / "sample_runs" / "yard")
    arguments = ["--effects", "track_width", "--sizes", "3x", "--planted", "1", "--workers", "1", "--json", "-"]
    assert run(["challenge", "own", yard, *arguments]) == 0
    out, err = capsys.readouterr()
    own = json.loads(out)
    row = own["effects"]["track_width"][0]
    assert {key: row[key] for key in ("size", "planted", "in_group", "wrong")} == {
        "size": 0.03,
        "planted": 1,
        "in_group": 1,
        "wrong": 0,
    }
    assert own["false_alarms"]["tried"] == 1
    assert "track_width" in err


def test_no_effects_and_a_folder_for_the_plot_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(["challenge", "own", ".", "--effects", " ,"]) == 2
    assert "expected effects with commas" in capsys.readouterr().err
    Path("seeds.toml").write_text(SEEDS, encoding="utf-8")
    assert run(["challenge", "make", "--seeds", "seeds.toml", "--into", "blind", "--workers", "1"]) == 0
    assert run(["challenge", "score", "blind", "--plot", "."]) == 2
    assert "Traceback" not in capsys.readouterr().err


def test_the_truth_of_the_current_folder_lies_beside_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "blind").mkdir()
    monkeypatch.chdir(tmp_path / "blind")
    assert truth_path(Path()) == tmp_path / "blind.truth.json"
    assert truth_path(Path("blind")) == Path("blind.truth.json")
