from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.campaign import write_campaign
from calib.campaign.read import read_campaign
from calib.cli.main import run
from calib.radius.result import read_result
from calib.reporting.content import compose
from calib.reporting.source import source_of
from calib.reporting.topics.fit import FIT_PICTURES
from tests.campaign.making import campaign, with_numbers


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_campaign(campaign(), tmp_path_factory.mktemp("fit") / "c")


@pytest.fixture(scope="module")
def corridor(project_root: Path) -> Path:
    return project_root / "sample_runs" / "corridor"


def test_radii_and_slopes_of_the_truth_come_back(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The campaign was made with 0.0990 m + 1.3e-6 m/N left, 0.0993 m + 1.2e-6 m/N right."""
    assert run(["fit", str(folder), "--json", "-"]) == 0
    wheels = json.loads(capsys.readouterr().out)["wheels"]
    for side, radius, slope in (("left", 0.0990, 1.3e-6), ("right", 0.0993, 1.2e-6)):
        low, high = wheels[side]["radius_ref_ci95_m"]
        # the 95 % interval doubled: a fixed seed, and 4 intervals
        margin = 0.5 * (high - low)
        assert low - margin <= radius <= high + margin
        low, high = wheels[side]["slope_ci95_m_per_N"]
        margin = 0.5 * (high - low)
        assert low - margin <= slope <= high + margin


@pytest.mark.parametrize(("name", "sign"), [("corridor", 1), ("corridor_crossed", -1)])
def test_the_sign_of_the_slope_is_that_of_the_data(
    project_root: Path, name: str, sign: int, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["fit", str(project_root / "sample_runs" / name), "--json", "-"]) == 0
    wheels = json.loads(capsys.readouterr().out)["wheels"]
    truth = {1: {"left": 1.4862e-6, "right": 1.2996e-6}, -1: {"left": -1.4688e-6, "right": -1.2863e-6}}[sign]
    for side in ("left", "right"):
        low, high = wheels[side]["slope_ci95_m_per_N"]
        assert low < truth[side] < high
        assert low * high > 0


def test_people_get_intervals_checks_and_budget(corridor: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["fit", str(corridor), "--runs"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    for word in (
        "SIMULATED",
        "F₀ = 300 N",
        "95 %",
        "a drift from session to session looks like load",
        "rangefinder",
        "r059",
    ):
        assert word in " ".join(out.split())  # a narrow terminal breaks sentences elsewhere


def test_json_has_standard_output_for_itself(corridor: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["fit", str(corridor), "--json", "-"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["simulated"] is True
    assert len(document["runs"]) == 60
    assert set(document["provenance"]["inputs"]) >= {"campaign.toml", "runs.csv", "logs/r000.csv"}


def test_result_folder_says_what_json_says(corridor: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    into = tmp_path / "result"
    assert run(["fit", str(corridor), "--into", str(into), "--json", "-"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert read_result(into).to_dict() == document
    assert run(["fit", str(corridor), "--into", str(into)]) == 2
    assert "--force" in capsys.readouterr().err
    assert run(["fit", str(corridor), "--into", str(into), "--force"]) == 0


def test_reference_load_can_be_chosen(corridor: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["fit", str(corridor), "--reference-load", "700", "--json", "-"]) == 0
    left = json.loads(capsys.readouterr().out)["wheels"]["left"]
    assert left["reference_load_N"] == 700.0
    # a line: 400 N further at 1.4862e-6 m/N, within the interval's micrometres
    assert left["radius_ref_m"] == pytest.approx(0.1 * (1 + 0.8e-4) + 400 * 1.4862e-6, abs=2e-5)


def test_a_law_that_does_not_hold_exits_1(corridor: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One distance misread by a metre."""
    bad = tmp_path / "bad"
    shutil.copytree(corridor, bad)
    lines = (bad / "runs.csv").read_text(encoding="utf-8").splitlines()
    column = lines[0].split(",").index("distance_m")
    cells = lines[11].split(",")
    cells[column] = str(float(cells[column]) + 1.0)
    lines[11] = ",".join(cells)
    (bad / "runs.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    assert run(["fit", str(bad)]) == 1
    out = capsys.readouterr().out
    assert "FAILED" in out
    assert cells[0] in out


def test_too_few_runs_are_refused_in_one_line(
    corridor: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    few = tmp_path / "few"
    shutil.copytree(corridor, few)
    lines = (few / "runs.csv").read_text(encoding="utf-8").splitlines()[:3]
    (few / "runs.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    assert run(["fit", str(few)]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert "three or more" in err


def test_help_shows_an_example(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["fit", "--help"]) == 0
    assert "calib fit sample_runs/corridor" in capsys.readouterr().out


def test_the_figures_are_those_of_the_report(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Every picture of the report's pages, no other; existing ones are refused before anything is fitted."""
    # how a figure becomes bytes has its own tests
    monkeypatch.setattr(
        "calib.reporting.figures.render_all", lambda _figure, forms: {form: form.encode() for form in forms}
    )
    assert run(["fit", str(folder), "--figures", str(tmp_path / "f")]) == 0
    shown = compose(source_of(read_campaign(folder), issued="2026-01-01")).pictures
    assert {path.stem for path in (tmp_path / "f").iterdir()} == {picture.name for picture in shown}
    assert tuple(picture.name for picture in shown) == FIT_PICTURES
    capsys.readouterr()
    assert run(["fit", str(folder), "--figures", str(tmp_path / "f")]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("existing file")) == ("", 1)


def test_what_a_failed_check_names_comes_before_runs_that_are_missing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A run far off is to be looked at; further runs are proposed where nothing but the plan of runs fails."""
    made = campaign(logs=False)
    distance = made.runs.number("distance_m").copy()
    distance[7] *= 1.01
    assert run(["fit", str(write_campaign(with_numbers(made, distance_m=distance), tmp_path / "outlier"))]) == 1
    out = capsys.readouterr().out
    assert (
        "influence" in out and "Next: correct in runs.csv, or exclude there, what failed above, then 'calib fit" in out
    )
    one = np.full(len(made.runs), "s1")
    alone = replace(made, runs=replace(made.runs, labels={**made.runs.labels, "session": one}))
    assert run(["fit", str(write_campaign(alone, tmp_path / "one_session"))]) == 1
    assert "Next: 'calib plan" in capsys.readouterr().out


def test_after_raw_files_a_campaign_is_made_first(
    project_root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Report and export take a campaign: of a table alone the next step makes one."""
    shutil.copytree(project_root / "sample_runs" / "corridor_crossed", tmp_path / "c")
    (tmp_path / "c" / "campaign.toml").rename(tmp_path / "kept.toml")
    run(["fit", str(tmp_path / "c" / "runs.csv")])
    last = capsys.readouterr().out.splitlines()[-1]
    assert last.startswith("Next: 'calib ingest ") and "--into CAMPAIGN', then " in last
    (tmp_path / "kept.toml").rename(tmp_path / "c" / "campaign.toml")
    assert run(["fit", str(tmp_path / "c")]) == 0
    assert "ingest" not in capsys.readouterr().out.splitlines()[-1]
