from __future__ import annotations

import json
from pathlib import Path

import pytest

from calib.cli.main import run


@pytest.fixture(scope="module")
def corridor(project_root: Path) -> str:
    return str(project_root / "sample_runs" / "corridor")


def test_the_table_needs_no_campaign(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--amplitude", "0.5", "--wavelength", "5", "--distance", "37.5"]
    assert run(["deviation", *arguments, "--json", "-"]) == 0
    (row,) = json.loads(capsys.readouterr().out)["table"]
    # printed digits of the recomputed Fig. 9
    assert row["excess_whole_periods"] == pytest.approx(0.09238355, abs=5e-9)
    assert row["excess_small_amplitude"] == pytest.approx(0.09869604, abs=5e-9)
    assert row["wheel_difference_m"] == pytest.approx(-0.78537, abs=5e-6)


def test_every_run_gets_a_verdict_and_an_amplitude(corridor: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["deviation", corridor, "--json", "-"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["passed"] is True
    assert {row["verdict"] for row in document["runs"]} == {"within"}
    for row in document["runs"]:
        # the runs were made with 6 to 22 mm and 7 to 14 m, and a second wave of 1 mm
        assert 0.005 < row["amplitude_m"] < 0.024
        assert 6.5 < row["wavelength_m"] < 15
        assert row["allowed_amplitude_m"] > row["amplitude_m"]


def test_a_tighter_tolerance_exits_1(corridor: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["deviation", corridor, "--tolerance", "1e-4"]) == 1
    out = capsys.readouterr().out
    assert "beyond" in out
    assert "repeat them" in out


def test_verdict_and_allowed_amplitude_agree(corridor: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["deviation", corridor, "--tolerance", "1e-4", "--json", "-"]) == 1
    rows = json.loads(capsys.readouterr().out)["runs"]
    agree = sum((row["amplitude_m"] <= row["allowed_amplitude_m"]) == (row["verdict"] == "within") for row in rows)
    # the second, smaller wave and the measured heading count for the verdict and not for the amplitude
    assert agree >= 0.85 * len(rows)


def test_steady_arc_of_unequal_wheels(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["deviation", "--radius-ratio", "1.01", "--distance", "15", "--json", "-"]) == 0
    arc = json.loads(capsys.readouterr().out)["arc"]
    # the paper's 15 m: about (E_r - 1) S^2 / 2b = 1.607 m, to the half per cent of the mean of both radii
    assert arc["offset_m"] == pytest.approx(1.60714, rel=0.006)


def test_people_see_the_figure(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["deviation"]) == 0
    out = capsys.readouterr().out
    assert "9.238355" in out
    assert "up to an amplitude of" in out


@pytest.mark.parametrize(
    "arguments",
    [
        ["--amplitude", "-1"],
        ["--wavelength", "0"],
        ["--distance", "nan"],
        ["--track", "-0.7"],
        ["--tolerance", "0"],
        ["--tolerance", "2"],
        ["--radius-ratio", "0"],
    ],
)
def test_impossible_numbers_are_one_line(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["deviation", *arguments]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert arguments[0] in err


def test_help_shows_an_example(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["deviation", "--help"]) == 0
    assert "calib deviation sample_runs/corridor" in " ".join(capsys.readouterr().out.split())
