"""Inputs are sacred: no command writes over what it was given to read, with any flags, links or spelling."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from calib.cli.main import run

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    return Path(shutil.copytree(ROOT / "sample_runs" / "corridor", tmp_path / "C"))


def hashes(folder: Path) -> dict[str, str]:
    """Return the hash of every file below a folder."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def _symlink(path: Path, base: Path) -> Path:
    link = base / "soft.json"
    link.symlink_to(path)
    return link


def _hard_link(path: Path, base: Path) -> Path:
    link = base / "hard.json"
    os.link(path, link)
    return link


def _folder_link(path: Path, base: Path) -> Path:
    link = base / "L"
    link.symlink_to(path.parent)
    return link / path.name


SPELLINGS: dict[str, Callable[[Path, Path], Path]] = {
    "as given": lambda path, _: path,
    "dots": lambda path, _: path.parent / "." / ".." / path.parent.name / path.name,
    "symlink": _symlink,
    "hard link": _hard_link,
    "linked folder": _folder_link,
    "relative": lambda path, _: Path(os.path.relpath(path)),
}


@pytest.mark.parametrize("force", [True, False])
@pytest.mark.parametrize("name", ["campaign.toml", "runs.csv"])
@pytest.mark.parametrize("spelling", list(SPELLINGS))
def test_json_never_replaces_a_file_of_the_campaign(
    spelling: str, name: str, force: bool, campaign: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit 2, one line that does not advise --force, and every byte as before."""
    before = hashes(campaign)
    target = SPELLINGS[spelling](campaign / name, tmp_path)
    assert run(["check", str(campaign), "--json", str(target), *(["--force"] if force else [])]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "--force" not in err
    assert hashes(campaign) == before


@pytest.mark.parametrize("force", [True, False])
@pytest.mark.parametrize("given", ["C", "C/.", "C/../C", "link"])
def test_a_fit_never_goes_into_its_own_campaign(
    given: str, force: bool, campaign: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """``runs.csv`` of a result would replace the counts."""
    (tmp_path / "link").symlink_to(campaign)
    before = hashes(campaign)
    assert run(["fit", str(campaign), "--into", str(tmp_path / given), *(["--force"] if force else [])]) == 2
    assert "--force" not in capsys.readouterr().err
    assert hashes(campaign) == before


def test_every_command_that_writes_a_file_keeps_its_inputs(
    campaign: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The guard stands around all commands, not in each."""
    coefficients = tmp_path / "coefficients.json"
    assert run(["export", str(campaign), "--to", "json", "--output", str(coefficients)]) == 0
    result = tmp_path / "result"
    run(["fit", str(campaign), "--into", str(result)])
    table = tmp_path / "table.csv"
    shutil.copy(campaign / "runs.csv", table)
    before = hashes(tmp_path)
    for arguments in (
        ["export", coefficients, "--to", "ros2", "--output", coefficients],
        ["export", result, "--to", "json", "--output", result / "fit.json"],
        ["report", result, "--into", tmp_path / "r.pdf", "--json", result / "fit.json"],
        ["fit", campaign, "--model", coefficients, "--json", coefficients],
        ["ingest", table, "--into", tmp_path / "new", "--json", table],
        ["fit", result, "--into", result],
    ):
        assert run([str(word) for word in [*arguments, "--force"]]) == 2, arguments
        assert "--force" not in capsys.readouterr().err, arguments
    kept = hashes(tmp_path)
    assert {name: kept[name] for name in before} == before


def test_results_beside_and_inside_a_campaign_may_be_renewed(campaign: Path) -> None:
    """The guard is for inputs: a result that stands in the campaign's folder is none."""
    arguments = ["fit", str(campaign), "--into", str(campaign / "results"), "--json", str(campaign / "fit_copy.json")]
    first = run(arguments)
    assert run([*arguments, "--force"]) == first
