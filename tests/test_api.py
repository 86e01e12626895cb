"""The Python API gives what the commands give, lazily and by name."""

from __future__ import annotations

import inspect
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import calib
from calib import api
from calib.cli.main import run
from calib.errors import BadInputError
from calib.radius.result import Fit

pytestmark = pytest.mark.usefixtures("diagnosed_once")


@pytest.fixture(scope="module")
def campaign(project_root: Path) -> calib.Campaign:
    folder = project_root / "sample_runs" / "corridor_crossed"
    if not folder.is_dir():
        pytest.skip("the sample campaign is not here: sample_runs/corridor_crossed")
    return calib.read(folder)


@pytest.fixture(scope="module")
def fit(campaign: calib.Campaign) -> calib.Fit:
    return calib.fit(campaign)


@pytest.fixture
def diagnosis(campaign: calib.Campaign, diagnosed_once: None) -> calib.Diagnosis:
    return calib.diagnose(campaign)


def commanded(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, object]:
    run([*arguments, "--json", "-"])
    document: dict[str, object] = json.loads(capsys.readouterr().out)
    return document


def test_every_name_is_there_and_listed() -> None:
    """Editors list the same names as exist, and others are refused as Python refuses them."""
    functions = {
        name
        for name, what in vars(api).items()
        if inspect.isfunction(what) and what.__module__.startswith(api.__name__)
    }
    assert {name for name in functions if not name.startswith("_")} < set(calib.__all__) == set(dir(calib))
    assert all(getattr(calib, name) is not None for name in calib.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        calib.nothing  # noqa: B018


def test_importing_it_imports_nothing_of_the_scientific_stack() -> None:
    program = "import sys, calib; print(*{'numpy', 'pandas', 'scipy', 'matplotlib'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


def test_runs_are_a_table(campaign: calib.Campaign) -> None:
    """Every column of the run table stands in the pandas table, unchanged."""
    frame = campaign.frame()
    assert len(frame) == len(campaign.runs)
    np.testing.assert_array_equal(frame["distance_m"], campaign.runs.number("distance_m"))
    assert list(frame["run_id"]) == campaign.runs.run_id.tolist()
    assert len(repr(campaign).splitlines()) <= 8 and "runs" in repr(campaign.runs)
    assert "<table" in campaign.runs._repr_html_() and campaign.name in campaign._repr_html_()


def test_a_fit_is_that_of_the_command(
    campaign: calib.Campaign, fit: calib.Fit, capsys: pytest.CaptureFixture[str]
) -> None:
    """`calib.fit` computes what `calib fit --json` prints, and survives its own plain values."""
    printed = commanded(capsys, "fit", str(campaign.root))
    assert isinstance(fit, Fit)
    document = json.loads(json.dumps(fit.to_dict()))
    assert document["wheels"] == printed["wheels"] and document["runs"] == printed["runs"]
    assert Fit.from_dict(document).to_dict()["wheels"] == document["wheels"]
    assert len(fit.table) == fit.left.law.n_runs
    np.testing.assert_allclose(fit.table["residual_left_m"], fit.left.residual_m, rtol=0.0, atol=0.0)


def test_a_summary_is_what_the_command_prints(
    campaign: calib.Campaign, fit: calib.Fit, capsys: pytest.CaptureFixture[str]
) -> None:
    """One content: `summary()` line by line as on a terminal of 80 columns, but for the next step; `repr` a few."""
    run(["fit", str(campaign.root)])
    printed, _ = capsys.readouterr().out.split("\nNext: ")
    assert fit.summary().splitlines() == [line.rstrip() for line in printed.splitlines()]
    few = repr(fit).splitlines()
    assert 1 < len(few) <= 16 and set(few) <= set(fit.summary().splitlines())
    assert "half width of the 95 %" in fit._repr_html_() and "<table>" in fit._repr_html_()


@pytest.mark.parametrize("kind", ["regressions", "runs", "path_deviation", "residuals"])
def test_a_fit_draws_itself(fit: calib.Fit, kind: str) -> None:
    assert len(fit.plot(kind).axes) >= 2


def test_a_figure_that_there_is_not_is_refused_by_the_names_of_those_there_are(fit: calib.Fit) -> None:
    with pytest.raises(BadInputError, match="residuals"):
        fit.plot("pie")


def test_a_diagnosis_is_that_of_the_command(
    campaign: calib.Campaign, diagnosis: calib.Diagnosis, capsys: pytest.CaptureFixture[str]
) -> None:
    """`calib.diagnose` finds what `calib diagnose --json` prints, and shows it."""
    printed = commanded(capsys, "diagnose", str(campaign.root))
    document = json.loads(json.dumps(diagnosis.to_dict()))
    assert all(printed[key] == document[key] for key in document if key not in {"headline"})
    told = " ".join(diagnosis.summary().split())
    # what its title says already is said once
    assert str(document["sentence"]).removeprefix("The gap is explained by") in told
    assert repr(diagnosis) in diagnosis.summary()
    assert diagnosis.plot().axes and "notice" in diagnosis._repr_html_()
    parameters = [name for cause in document["causes"] for name in cause["parameters"]]
    assert list(diagnosis.table.get("parameter", [])) == parameters


@pytest.fixture(scope="module")
def plan(campaign: calib.Campaign, diagnosing: Callable[..., object]) -> calib.Plan:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("calib.gap.diagnose.diagnose_in_full", diagnosing)
        return calib.plan(campaign, most=2)


def test_a_plan_names_runs_with_their_reasons(plan: calib.Plan) -> None:
    # two, and the unladen run of their session
    assert 1 <= len(plan.runs) <= 2 + 1 and all(run.why for run in plan.runs)
    assert plan.plot().axes
    assert len(plan.table) == len(plan.runs) == len(plan.to_dict()["next_runs"])
    assert plan.diagnosis.to_dict()["verdict"] in plan.to_dict()["verdict"]


@pytest.mark.usefixtures("diagnosed_once")
def test_a_plan_promises_what_the_command_does(
    plan: calib.Plan, campaign: calib.Campaign, capsys: pytest.CaptureFixture[str]
) -> None:
    """The intervals of the geometry are in the JSON of both, and in the summary."""
    printed = commanded(capsys, "plan", str(campaign.root), "--most", "2")
    assert printed == json.loads(json.dumps(plan.to_dict()))
    assert plan.now is not None and "track_m" in printed["geometry"]["now"]["parameters"]
    assert "track_m" in plan.summary() and "Half widths" in plan.summary()


def test_a_simulation_under_a_fit_has_its_law(fit: calib.Fit) -> None:
    simulation = calib.simulate("corrected", law=fit, seed=1)
    assert simulation.law is not None and simulation.law.law.left.radius_ref_m == fit.left.law.radius_ref_m
    assert len(simulation.table) == sum(len(sweep.ends()) for sweep in simulation.sweeps.values())
    assert simulation.plot().axes and "True minus intended" in simulation.summary()


def test_an_export_is_what_the_vehicle_loads(fit: calib.Fit, tmp_path: Path) -> None:
    """The master read back has the fit's law."""
    from calib.coefficients.file import load_coefficients

    texts = calib.export(fit, "json", tmp_path / "vehicle.json")
    assert (tmp_path / "vehicle.json").read_text(encoding="utf-8") == next(iter(texts.values()))
    assert load_coefficients(tmp_path / "vehicle.json").law.left.radius_ref_m == fit.left.law.radius_ref_m
    calib.export(fit, "json", tmp_path / "clamping.json", outside="clamp")
    assert load_coefficients(tmp_path / "clamping.json").outside == "clamp"


def test_a_coefficient_file_stands_where_a_fit_does(campaign: calib.Campaign, fit: calib.Fit, tmp_path: Path) -> None:
    path = tmp_path / "vehicle.json"
    calib.export(fit, "json", path)
    assert calib.replay(campaign, path).to_dict() == calib.replay(campaign, fit).to_dict()
    simulation = calib.simulate("corrected", law=str(path))
    assert simulation.law is not None and simulation.law.law.left.radius_ref_m == fit.left.law.radius_ref_m
    assert calib.diagnose(campaign, model=path).judged_against == "vehicle.json"


@pytest.mark.usefixtures("undrawn")
def test_a_report_of_a_fit_is_that_of_its_campaign(campaign: calib.Campaign, fit: calib.Fit, tmp_path: Path) -> None:
    """With the same date of issue the bytes are the same."""
    first = calib.report(campaign, tmp_path / "a.pdf", date="2025-03-31")
    second = calib.report(fit, tmp_path / "b.pdf", date="2025-03-31")
    assert first.read_bytes()[:5] == b"%PDF-" and first.read_bytes() == second.read_bytes()
    with pytest.raises(BadInputError, match="needs"):
        calib.report(fit, tmp_path / "c.pdf", diagnosis=True)
