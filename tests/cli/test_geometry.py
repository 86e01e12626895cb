"""`calib geometry` from a folder to coefficients that the other commands take."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.campaign import write_campaign
from calib.cli.main import run
from calib.coefficients.file import load_coefficients
from tests.kinematics.campaigns import Truth, campaign, mixed


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("geometry") / "campaign"
    write_campaign(campaign(mixed(3), Truth(), np.random.default_rng(1)), path)
    return path


def test_json_has_what_the_contract_names(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Values with sd and ci95, covariance with its names, residuals, outliers, UMBmark; nothing else on stdout."""
    assert run(["geometry", str(folder), "--json", "-"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["drive"] == "differential" and told["n_runs"] == 15
    for name in ("radius_left_m", "radius_right_m", "track_m"):
        entry = told["parameters"][name]
        assert entry["ci95"][0] < entry["value"] < entry["ci95"][1] and entry["sd"] > 0
    assert np.shape(told["covariance"]["matrix"]) == (3, 3) and len(told["covariance"]["names"]) == 3
    assert set(told["residual_rms"]) == {"x_m", "y_m", "theta_rad"}
    assert told["umbmark"]["applies"] is True and told["mirrored_solution"] is False
    assert told["outliers"] == [] and told["undetermined"] == []


def test_its_coefficients_are_taken_by_export_diagnose_and_simulate(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One file from squares to the controller's parameters, to the model of a diagnosis, a journey and a replay."""
    coefficients = tmp_path / "coefficients.json"
    assert run(["geometry", str(folder), "--output", str(coefficients), "--figures", str(tmp_path / "figures")]) == 0
    assert (tmp_path / "figures" / "geometry_paths.svg").read_bytes().startswith(b"<?xml")
    assert run(["export", str(coefficients), "--to", "ros2", "--output", str(tmp_path / "ros2")]) == 0
    text = next((tmp_path / "ros2").iterdir()).read_text(encoding="utf-8")
    assert "# calibrated" in text and "pose_covariance_diagonal" in text
    capsys.readouterr()
    run(["diagnose", str(folder), "--model", str(coefficients), "--json", "-"])
    assert json.loads(capsys.readouterr().out)["verdict"] in {"no_gap", "undecided"}
    assert run(["simulate", "journey", "square_ccw", "--law", str(coefficients), "--json", "-"]) == 0
    capsys.readouterr()
    # no wheel was weighed: the law holds at any load, and a replay says what it took
    assert run(["simulate", "replay", str(folder), "--law", str(coefficients), "--json", "-"]) == 0
    replayed = json.loads(capsys.readouterr().out)
    assert replayed["rms_m"]["corrected"] < 0.2 * replayed["rms_m"]["model"]
    assert replayed["runtime"]["largest_difference_m"] < 1e-9 and "no wheel load" in " ".join(replayed["notes"])


def test_a_result_is_taken_whole_by_the_commands_that_take_coefficients(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its folder, geometry.json and what ``--json`` writes are each as good as the coefficient file."""
    files = [tmp_path / name for name in ("c.json", "j.json")]
    written = ["--output", str(files[0]), "--json", str(files[1]), "--into", str(tmp_path / "g")]
    assert run(["geometry", str(folder), *written]) == 0
    exported = []
    for source in (*files, tmp_path / "g", tmp_path / "g" / "geometry.json"):
        assert load_coefficients(source) == load_coefficients(files[0])
        capsys.readouterr()
        assert run(["export", str(source), "--to", "json"]) == 0
        exported.append(capsys.readouterr().out)
    assert len(set(exported)) == 1
    assert run(["simulate", "replay", str(folder), "--model", str(tmp_path / "g")]) == 0
    capsys.readouterr()
    run(["diagnose", str(folder), "--model", str(tmp_path / "g"), "--json", "-"])
    assert json.loads(capsys.readouterr().out)["judged_against"] == "g"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [(["--using", "window"], "end-poses, windows"), (["--kind", "rhombus"], "square_cw")],
)
def test_a_wrong_choice_is_one_line_that_names_the_right_ones(
    folder: Path, arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["geometry", str(folder), *arguments]) == 2
    line = capsys.readouterr().err
    assert words in line and line.count("\n") == 1


def test_what_nobody_stated_is_said_and_that_data_are_simulated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In the text and in the JSON of each command; the reference's uncertainty is assumed here."""
    made = replace(
        campaign(mixed(3), Truth(), np.random.default_rng(1)), simulated=True, assumed=("reference.sigma_xy_m",)
    )
    write_campaign(made, tmp_path / "c")
    for command in ("geometry", "diagnose"):
        run([command, str(tmp_path / "c"), "--json", str(tmp_path / f"{command}.json")])
        said = " ".join(capsys.readouterr().out.split())
        document = json.loads((tmp_path / f"{command}.json").read_text(encoding="utf-8"))
        assert "assumed, since nobody stated: reference.sigma_xy_m" in said and "SIMULATED DATA" in said
        assert any("reference.sigma_xy_m" in note for note in document["notes"]) and document["simulated"]
    assert run(["plan", str(tmp_path / "c"), "--json", str(tmp_path / "plan.json")]) == 0
    assert "SIMULATED DATA" in capsys.readouterr().out
    assert json.loads((tmp_path / "plan.json").read_text(encoding="utf-8"))["simulated"] is True


def test_half_a_track_is_status_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    wrong = campaign(mixed(2), Truth(), np.random.default_rng(2), nominal=(0.05, 0.05, 0.2))
    write_campaign(wrong, tmp_path / "c")
    assert run(["geometry", str(tmp_path / "c"), "--into", str(tmp_path / "g")]) == 1
    assert "twice the track" in " ".join(capsys.readouterr().out.split())
    # its numbers go on only where the geometry was accepted with a reason
    capsys.readouterr()
    assert run(["export", str(tmp_path / "g"), "--to", "json"]) == 1
    told = capsys.readouterr()
    assert not told.out and "twice the track" in told.err and "--accept-implausible" in told.err
    reason = ["--accept-implausible", "measured twice", "--into", str(tmp_path / "g"), "--force"]
    assert run(["geometry", str(tmp_path / "c"), *reason]) == 1
    assert load_coefficients(tmp_path / "g").accepted_implausible is not None


def test_standard_output_has_one_document_where_the_coefficients_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The result, which says why; that no file was written is said beside it."""
    wrong = campaign(mixed(2), Truth(), np.random.default_rng(2), nominal=(0.05, 0.05, 0.2))
    write_campaign(wrong, tmp_path / "c")
    target = tmp_path / "coefficients.json"
    assert run(["geometry", str(tmp_path / "c"), "--json", "-", "--output", str(target)]) == 1
    told = capsys.readouterr()
    assert json.loads(told.out)["verdict"] == "wrong" and "--accept-implausible" in told.err
    assert not target.exists()
    # a later command in the same process begins anew
    assert run(["geometry", str(tmp_path / "nowhere"), "--json", "-"]) == 2
    assert json.loads(capsys.readouterr().out)["exit_status"] == 2


def test_a_recording_with_a_mapping_gives_the_geometry_of_its_campaign(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One command from a CSV of wheel rates and poses to radii, track, sensor and delay: what was driven comes back."""
    truth = Truth(sensor=(0.1, -0.03, 0.2), delay_s=0.06)
    legs = [(1.0, turn) for turn in np.random.default_rng(5).uniform(-1.5, 1.5, 16)]
    made = campaign([("free", legs)], truth, np.random.default_rng(6), sigma=(5e-4, 3e-4), along=True, samples=800)
    log = made.logs.of(0)
    step = np.diff(log["t_s"], prepend=log["t_s"][0] - log["t_s"][1])
    # rates over the step before each sample
    rates = {
        side: np.diff(log[f"counts_{side}"], prepend=0.0) / 20000.0 * 2 * np.pi / step for side in ("left", "right")
    }
    columns = [log["t_s"], rates["left"], rates["right"], log["ref_x_m"], log["ref_y_m"], log["ref_theta_rad"]]
    np.savetxt(tmp_path / "run.csv", np.stack(columns, axis=1), delimiter=",", header="t,l,r,x,y,h", comments="")
    (tmp_path / "m.toml").write_text(
        '[vehicle]\ndrive = "differential"\ntrack_m = 0.4\nwheel_radius_m = 0.05\nwheelbase_m = 0.6\ncog_x_m = 0.1\n'
        "[encoder]\ncounts_per_rev = 20000\n"
        '[reference]\nframe = "start"\nsigma_xy_m = 0.0005\nsigma_theta_rad = 0.0003\n[log]\nt_s = "t"\n'
        'counts_left = {column = "l", unit = "rad/s"}\ncounts_right = {column = "r", unit = "rad/s"}\n'
        'ref_x_m = "x"\nref_y_m = "y"\nref_theta_rad = "h"\n'
    )
    assert run(["geometry", str(tmp_path / "run.csv"), "--mapping", str(tmp_path / "m.toml"), "--json", "-"]) == 0
    told = json.loads(capsys.readouterr().out)
    for name, value in (("radius_left_m", truth.radius_left_m), ("track_m", truth.track_m), ("sensor_yaw_rad", 0.2)):
        # rates are integrated between samples, half a step beside where they were measured
        assert told["parameters"][name]["value"] == pytest.approx(value, rel=5e-3), name
