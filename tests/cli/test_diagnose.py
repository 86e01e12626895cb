"""`calib diagnose` on the two campaigns whose outcome is known by hand, and on bad input."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from calib.campaign import write_campaign
from calib.cli.main import run
from calib.gap.decision.diagnosis import VerdictKind
from tests.campaign.making import campaign, with_log_columns, with_numbers

FIELDS = {
    "verdict",
    "causes",
    "credible_sets",
    "indistinguishable",
    "undetectable",
    "where",
    "closure",
    "recommended",
    "next_runs",
}


def test_one_load_a_session_is_ambiguous_and_the_run_that_splits_is_named(
    project_root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Load and session go together in the paper's design; a laden run in the session of an unladen one splits them."""
    assert run(["diagnose", str(project_root / "sample_runs/corridor"), "--json", "-"]) == 1
    captured = capsys.readouterr()
    document = json.loads(captured.out)
    assert document.keys() >= FIELDS
    assert document["verdict"] == "ambiguous"
    assert any({"load_radius", "session_step"} <= set(group) for group in document["indistinguishable"])
    assert not document["recommended"]
    assert document["next_runs"][0]["payload_kg"] > 0
    assert "load_radius from session_step" in document["next_runs"][0]["why"]
    assert "cannot tell" in captured.err


def test_crossed_loads_explain_the_gap_with_the_slopes_of_the_fit(
    project_root: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """The slopes lie within the intervals that the regression gives; with them in the model no gap is left."""
    campaign = str(project_root / "sample_runs/corridor_crossed")
    model = tmp_path / "model.json"
    assert run(["diagnose", campaign, "--json", "-", "--apply", str(model)]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["verdict"] == "explained"
    assert [cause["effect"] for cause in document["causes"]] == ["load_radius"]
    assert document["closure"]["fraction"] > 0.9
    assert document["recommended"]
    run(["fit", campaign, "--json", "-"])
    wheels = json.loads(capsys.readouterr().out)["wheels"]
    for side in ("left", "right"):
        low, high = wheels[side]["slope_ci95_m_per_N"]
        assert low <= document["causes"][0]["parameters"][f"slope_{side}"]["value"] <= high
    again = ["diagnose", campaign, "--model", str(model), "--json", "-"]
    # nothing is left to write, which is no bad input, and the result is there
    assert run([*again, "--apply", str(tmp_path / "again.json")]) == 0
    assert not (tmp_path / "again.json").exists()
    assert json.loads(capsys.readouterr().out)["verdict"] == "no_gap"


@pytest.mark.usefixtures("drawn_once")
def test_pictures_and_result_are_written_and_not_overwritten(
    project_root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    campaign = str(project_root / "sample_runs/corridor")
    into, figures = tmp_path / "result", tmp_path / "figures"
    assert run(["diagnose", campaign, "--into", str(into), "--figures", str(figures)]) == 1
    capsys.readouterr()
    assert json.loads((into / "diagnosis.json").read_text())["verdict"] == "ambiguous"
    for name in ("gap-map", "before-after", "gap-by-covariate-distance"):
        assert (figures / f"{name}.svg").read_bytes().startswith(b"<?xml")
        assert {(figures / f"{name}.{form}").read_bytes() for form in ("png", "pdf")} == {b"png", b"pdf"}
    assert run(["diagnose", campaign, "--into", str(into)]) == 2
    assert "--force" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nowhere"], "campaign.toml"),
        (["CORRIDOR", "--exclude", "gremlins"], "gremlins"),
        (["CORRIDOR", "--model", "nowhere.json"], "nowhere.json"),
    ],
)
def test_bad_input_is_one_line(
    project_root: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], said: str
) -> None:
    given = [str(project_root / "sample_runs/corridor") if one == "CORRIDOR" else one for one in arguments]
    assert run(["diagnose", *given]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


def test_an_excluded_effect_is_not_named(project_root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    campaign = str(project_root / "sample_runs/corridor")
    run(["diagnose", campaign, "--exclude", "session_step", "--json", "-"])
    document = json.loads(capsys.readouterr().out)
    assert "session_step" not in {one for group in document["indistinguishable"] for one in group}


def test_an_existing_figure_is_refused_before_the_work(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Not even the campaign is looked at: there is none."""
    (tmp_path / "gap-by-covariate-along.png").touch()
    assert run(["diagnose", str(tmp_path / "absent"), "--figures", str(tmp_path)]) == 2
    assert "existing file" in capsys.readouterr().err


def test_counters_that_were_reset_are_named_where_no_fix_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Runs that end far off are those whose counters jumped: the line after the verdict sends there first."""
    made = campaign(runs_per_load=2, rate_hz=5.0)
    columns = {name: made.logs.columns[name].copy() for name in ("counts_left", "counts_right")}
    for run_number in (3, 7):
        part = slice(made.logs.offsets[run_number], made.logs.offsets[run_number + 1])
        for counts in columns.values():
            half = counts[part][len(counts[part]) // 2]
            counts[part] -= half * (np.arange(part.stop - part.start) >= (part.stop - part.start) // 2)
    reset = with_log_columns(made, **columns)
    totals = {name: columns[name][made.logs.offsets[1:] - 1] for name in columns}
    folder = write_campaign(with_numbers(reset, **totals), tmp_path / "reset")
    assert run(["diagnose", str(folder)]) == 1
    last = capsys.readouterr().out.splitlines()[-1]
    assert "correct or exclude r003 r007 by 'calib check" in last


@pytest.mark.parametrize("kind", ["unknown", "undecided"])
def test_nothing_is_applied_where_nothing_is_named(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Said, and status 1 as without it: the input is not at fault."""
    verdict = SimpleNamespace(kind=VerdictKind(kind), causes=(), correction=None, campaign="c", to_dict=dict)
    monkeypatch.setattr("calib.gap.diagnose.diagnosed", lambda *_, **__: (verdict, ()))
    monkeypatch.setattr("calib.reporting.topics.diagnosis.diagnosis_full", lambda _: ())
    monkeypatch.setattr("calib.reporting.topics.diagnosis.after_diagnosis", lambda *_, **__: "diagnose simulator lacks")
    target = tmp_path / "applied.json"
    write_campaign(campaign(runs_per_load=1, logs=False), tmp_path / "c")
    assert run(["diagnose", str(tmp_path / "c"), "--apply", str(target)]) == 1
    assert "is not written" in " ".join(capsys.readouterr().out.split())
    assert not target.exists()
