"""Every command ends with one line that says what to do now, with the command."""

from __future__ import annotations

import ast
import shlex
from pathlib import Path
from types import SimpleNamespace

import pytest

from calib.cli.fit import _next_step
from calib.cli.main import run
from calib.gap.decision.diagnosis import Diagnosis, VerdictKind
from calib.gap.plan.planned_runs import PlannedRun
from calib.reporting import next_step
from calib.reporting.topics.diagnosis import after_diagnosis
from calib.reporting.topics.geometry import after_geometry

ROOT = Path(__file__).resolve().parents[2]
#: commands that take a moment; the others are seen by the test of their sources
QUICK = {
    "init": ["init", "OUT/campaign"],
    "check": ["check", "sample_runs/corridor"],
    "loads": ["loads", "--payload", "100", "--x", "0.5"],
    "weighed": ["loads", "--weighed", "300,400,400"],
    "deviation": ["deviation"],
    "deviation of runs": ["deviation", "sample_runs/corridor_crossed"],
    "route": ["simulate", "route", "corridor", "--real", "0.099,0.1"],
    "effects": ["effects", "track_width"],
    "describe": ["ingest", "--describe", "sample_runs/yard/runs.csv"],
}


@pytest.mark.parametrize("name", QUICK)
def test_the_last_line_names_a_command(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """On one line however long, so that the command can be copied; a mapping on standard output stays alone."""
    monkeypatch.chdir(ROOT)
    run([word.replace("OUT", str(tmp_path)) for word in QUICK[name]])
    captured = capsys.readouterr()
    said = captured.err if name == "describe" else captured.out
    last = said.rstrip("\n").splitlines()[-1]
    assert last.startswith("Next: ") and "'calib " in last
    assert last.endswith(".")
    assert said.count("Next: ") == 1
    assert name != "describe" or "Next: " not in captured.out


def test_every_command_says_what_follows() -> None:
    """Each module of a command, or a function that it calls there, prints a next step."""
    for path in sorted((ROOT / "calib" / "cli").glob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        commands = [
            node
            for node in tree.body
            if isinstance(node, ast.FunctionDef) and "Example: calib" in str(ast.get_docstring(node))
        ]
        functions = [node.func for node in ast.walk(tree) if isinstance(node, ast.Call)]
        called = {getattr(function, "attr", getattr(function, "id", "")) for function in functions}
        assert not commands or "then" in called, path.name


def test_lengths_alone_lead_to_no_geometry(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A corridor whose references are lengths: no advice to estimate a track, before and after."""
    header = "run_id,session,kind,distance_m,counts_left,counts_right,load_left_N,load_right_N\n"
    rows = (f"r{n},s{n % 2},corridor,40.0{n},26000{n},26000{n},{300 + 200 * (n % 3)},300\n" for n in range(6))
    (tmp_path / "runs.csv").write_text(header + "".join(rows), encoding="utf-8")
    (tmp_path / "campaign.toml").write_text('format = "calib-campaign/1"\nname = "lengths"\n', encoding="utf-8")
    run(["check", str(tmp_path)])
    assert "calib geometry" not in capsys.readouterr().out
    doubtful = SimpleNamespace(passed=False, why=("lengths of straight runs alone: they do not tell the wheels apart",))
    assert after_geometry(doubtful, None) == "geometry lengths"


@pytest.mark.parametrize(
    ("command", "follows"), [("geometry", "keep the nominal values; 'calib diagnose"), ("fit", "'calib diagnose")]
)
def test_what_is_not_of_the_calibration_leads_to_the_diagnosis(
    command: str, follows: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The yard's radii follow the temperature: no row of its table is wrong, and other radii gain nothing."""
    run([command, str(ROOT / "sample_runs" / "yard")])
    assert f"Next: {follows}" in capsys.readouterr().out


@pytest.mark.parametrize(("to", "named"), [("c", "calib_coefficients.h"), ("json", "coefficients.json")])
def test_an_export_into_a_folder_names_its_file(
    to: str, named: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = str(ROOT / "sample_runs" / "corridor_crossed")
    assert run(["export", source, "--to", to, "--output", str(tmp_path / "out")]) == 0
    assert str(tmp_path / "out" / named) in capsys.readouterr().out.splitlines()[-1]


def test_two_runs_on_a_corridor_lead_to_more_of_them() -> None:
    """A law cannot be fitted there, so that nothing says to fit one."""
    straight = SimpleNamespace(passed=False, why=("lengths of straight runs alone: they do not tell the wheels apart",))
    report = SimpleNamespace(diagnosis=None, geometry=straight)
    assert _next_step(report, None) == "fit lacks runs"  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("runs", "sessions", "named", "not_named"),
    [
        (2, 1, "drive the runs that are missing", "'calib fit"),
        (12, 1, "'calib plan", "geometry"),
        (12, 2, "'calib fit", "plan"),
    ],
)
def test_a_check_says_first_what_a_fit_would_fail_on(
    runs: int, sessions: int, named: str, not_named: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Too few runs, or one session: the fit refuses, or fails the design; no path is known, none corrected."""
    header = "run_id,session,kind,distance_m,counts_left,counts_right,load_left_N,load_right_N\n"
    loads = (300, 900, 500, 700)
    rows = (
        f"r{n:02d},s{n % sessions},corridor,40.0{n:02d},261{n:02d},260{n:02d},{loads[n % 4]},{loads[n % 4]}\n"
        for n in range(runs)
    )
    (tmp_path / "runs.csv").write_text(header + "".join(rows), encoding="utf-8")
    settings = 'format = "calib-campaign/1"\nname = "few"\n[encoder]\ncounts_per_rev = 4096\n'
    (tmp_path / "campaign.toml").write_text(settings, encoding="utf-8")
    run(["check", str(tmp_path)])
    last = capsys.readouterr().out.splitlines()[-1]
    assert named in last
    assert not_named not in last
    status = run(["fit", str(tmp_path)])
    said = capsys.readouterr()
    assert status == (2 if runs < 3 else 1 if sessions == 1 else 0)
    assert "accounts for the correlation" not in said.out or sessions > 1
    run(["deviation", str(tmp_path)])
    assert "corrects every radius" not in capsys.readouterr().out


def test_a_table_a_vehicle_is_not_sent_to_a_diagnosis(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(["fleet", "simulate", "--into", "made", "--vehicles", "2", "--runs", "6", "--months", "1"]) == 0
    run(["fleet", "run", "made", "--into", "fleet"])
    assert "--what diagnose --into" not in capsys.readouterr().out
    assert run(["fleet", "simulate", "--into", "made"]) == 2
    assert "--force" in capsys.readouterr().err
    for more in ("outliers", "drifting", "common"):
        assert run(["fleet", "simulate", "--into", "new", "--vehicles", "3", f"--{more}", "5"]) == 2
        assert f"--{more}: found 5" in capsys.readouterr().err


def test_a_folder_with_blanks_can_be_copied_out_of_the_quotes() -> None:
    """The shell reads the command between the single quotes as it stands."""
    line = next_step("fit lacks runs", c=Path("c/Hölle Süd 3"))
    command = line.split("'")[1]
    assert shlex.split(command) == ["calib", "plan", "c/Hölle Süd 3"]
    assert next_step("fit lacks runs", c=Path("c/A")).startswith("Next: 'calib plan c/A' names")


@pytest.mark.parametrize("word", ["a b", "it's", "$HOME x", 'a "b"', "a`b`", "back\\ slash", "plain"])
def test_every_name_is_quoted_for_a_shell(word: str) -> None:
    line = next_step("check wrong", c=word).removeprefix("Next: correct what is wrong above, then '").removesuffix("'.")
    assert shlex.split(line) == ["calib", "check", word]


@pytest.mark.parametrize(
    ("group", "runs", "step"),
    [
        (("unequal_radii", "lost_counts"), (PlannedRun("corridor"),), "diagnose"),
        (("unequal_radii", "lost_counts"), (), "plan nothing"),
        (("rangefinder_scale", "reference_scale"), (), "plan instruments"),
    ],
)
def test_a_diagnosis_promises_no_runs_where_the_plan_has_none(
    group: tuple[str, ...], runs: tuple[PlannedRun, ...], step: str
) -> None:
    """What no run tells apart, a length by other means may: of two instruments one is wrong."""
    found = Diagnosis(VerdictKind.AMBIGUOUS, "", groups=(group,), next_runs=runs)
    assert after_diagnosis(found) == step
