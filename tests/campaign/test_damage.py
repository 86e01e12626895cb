"""Damaged campaigns end in one helpful line and exit status 2, or in a correct result."""

from __future__ import annotations

import itertools
import json
import shutil
import warnings
from pathlib import Path

import numpy as np
import pytest

from calib.campaign import write_campaign
from calib.cli.main import run
from tests.campaign.damage import DAMAGES
from tests.campaign.making import campaign
from tests.effort import EXPLORES

PER_BATCH = 24
#: each kind of damage four times, a dozen where more is asked for
NUMBER = len(DAMAGES) * (12 if EXPLORES else 4)


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_campaign(campaign(runs_per_load=2, rate_hz=2.0), tmp_path_factory.mktemp("sound") / "c")


def _spoil(sound: Path, target: Path, number: int) -> str:
    shutil.rmtree(target, ignore_errors=True)
    shutil.copytree(sound, target)
    names = list(DAMAGES)
    name = names[number % len(names)]
    DAMAGES[name](target, np.random.default_rng([20, number]))
    return name


@pytest.mark.parametrize("batch", range(NUMBER // PER_BATCH))
def test_a_damaged_campaign_ends_in_one_helpful_line_or_a_result(
    batch: int, sound: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    numbers = range(batch * PER_BATCH, (batch + 1) * PER_BATCH)
    for number, command in itertools.product(numbers, ("check", "fit")):
        if command == "check":
            name = _spoil(sound, tmp_path / "c", number)
        with warnings.catch_warnings():
            # a warning of a library on standard error would be a second line that nobody asked for
            warnings.simplefilter("error")
            status = run([command, str(tmp_path / "c"), "--json", "-"])
        out, err = capfd.readouterr()
        case = f"{command}, {name} ({number}): status {status}\n{err[:400]}"
        assert status in {0, 1, 2}, case
        assert "Traceback" not in err, case
        if status == 2:
            assert json.loads(out)["exit_status"] == 2, case
            assert err.count("\n") == 1, case
            assert err.startswith("calib: "), case
            # found, expected and a remedy, or a refusal that says what to do
            assert "; expected" in err or command != "check", case
            assert len(err) < 1000, case
        else:
            result = json.loads(out)
            if command == "check":
                assert result["sound"] == (status == 0), case


def test_the_damager_damages(sound: Path, tmp_path: Path) -> None:
    """Every kind of damage changes the campaign, and most are noticed."""
    noticed = 0
    for number in range(len(DAMAGES)):
        _spoil(sound, tmp_path / "c", number)
        status = run(["check", str(tmp_path / "c"), "--json", str(tmp_path / f"{number}.json")])
        result = json.loads((tmp_path / f"{number}.json").read_text()) if status != 2 else {}
        noticed += status != 0 or bool(result["suspicious"] or result["info"])
    assert noticed >= 0.7 * len(DAMAGES)
