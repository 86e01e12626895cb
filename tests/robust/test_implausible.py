"""Absurd is refused: units and settings wrong by factors fail ``check`` and ``fit``, and are not passed on unasked."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from calib.campaign.check import implausible
from calib.campaign.read import read_campaign
from calib.cli.main import run
from calib.runtime import Coefficients
from tests.robust.spoilt import FAILED, ROOT, SAID, SILENT, Case, answered, answers, cases

CASES = {case.name: case for case in cases()}
#: one of each kind; the whole table is ``python -m tests.robust.spoilt``
SHOWN = [
    "counts per revolution times 4",
    "counts of the left wheel times 2",
    "distance in mm",
    "distances shifted by 1 row(s)",
    "all distances 40 m",
    "wheel loads in kN",
    "wheel loads in kg",
    "wheel loads in N, negative",
    "vehicle.track_m in mm",
    "temperature in Fahrenheit",
    "end headings in degrees, loops",
    "end headings in degrees, corridor",
    "payload in pounds",
    "wheel counts swapped, loops",
    "wheel counts swapped, corridor",
    "wheel loads swapped",
]


def test_the_table_is_as_long_as_promised() -> None:
    """At least 90 spoilt campaigns, and few of which it is said beforehand that nothing notices them."""
    assert len(CASES) >= 90
    assert sum(case.wanted == SILENT for case in CASES.values()) <= 2


@pytest.mark.parametrize("name", SHOWN)
def test_no_command_passes_on_what_cannot_be(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """``check`` and ``fit`` fail, ``export`` and ``report`` write nothing."""
    case: Case = CASES[name]
    assert answered(answers(case, tmp_path / "spoilt")) == FAILED
    assert not (tmp_path / "spoilt" / "c.json").exists()
    assert not (tmp_path / "spoilt" / "r.pdf").exists()
    capsys.readouterr()


def test_a_radius_off_beyond_wear_is_called_suspicious(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Yards for metres are 9 %: no vehicle is that far off, and some are; a person has to look."""
    given = answers(CASES["distance in yards"], tmp_path / "spoilt")
    assert answered(given) == SAID
    capsys.readouterr()


@pytest.mark.parametrize("name", ["corridor", "corridor_crossed", "yard"])
def test_sound_campaigns_are_within_all_bounds(name: str) -> None:
    assert not list(implausible(read_campaign(ROOT / "sample_runs" / name)))


def test_a_failed_check_of_the_law_goes_with_its_coefficients(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The yard's radii follow the temperature: each form of the law says so; the file of a sound one has no word."""
    for name, doubts in (("yard", ["left wheel, temperature", "right wheel, temperature"]), ("corridor", [])):
        master = tmp_path / f"{name}.json"
        assert run(["export", str(ROOT / "sample_runs" / name), "--to", "json", "--output", str(master)]) == 0
        assert [text.partition(":")[0] for text in Coefficients.read(master).failed_checks] == doubts
        assert ("failed_checks" in master.read_text(encoding="utf-8")) is bool(doubts)
        capsys.readouterr()
        for to in ("c", "csv", "ros2"):
            assert run(["export", str(master), "--to", to]) == 0
            assert ("left wheel, temperature" in capsys.readouterr().out) is bool(doubts), to


@pytest.mark.usefixtures("undrawn")
def test_the_likely_setting_is_named_and_a_reason_is_written_into_the_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "C"
    shutil.copytree(ROOT / "sample_runs" / "corridor", folder)
    CASES["counts per revolution times 4"].spoil(folder)
    arguments = ["export", str(folder), "--to", "json", "--output", str(tmp_path / "c.json")]
    assert run(arguments) == 1
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "times nominal: a quarter of the counts (single edges counted" in err
    assert run([*arguments, "--accept-implausible", "  "]) == 1
    assert run([*arguments, "--accept-implausible", "wheel of the test stand"]) == 0
    document = json.loads((tmp_path / "c.json").read_text(encoding="utf-8"))
    assert document["accepted_implausible"]["reason"] == "wheel of the test stand"
    assert "times nominal" in document["accepted_implausible"]["findings"][0]
    # the file that carries the reason may be turned into other forms
    capsys.readouterr()
    for to in ("c", "csv", "ros2"):
        assert run(["export", str(tmp_path / "c.json"), "--to", to]) == 0
        assert "wheel of the test stand" in capsys.readouterr().out, to
    report = ["report", str(folder), "--into", str(tmp_path / "r.pdf"), "--html", str(tmp_path / "r.html")]
    assert run([*report, "--accept-implausible", "wheel of the test stand"]) in {0, 1}
    assert "wheel of the test stand" in (tmp_path / "r.html").read_text(encoding="utf-8")
    capsys.readouterr()
