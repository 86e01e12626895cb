"""What `calib diagnose --apply` writes is taken by simulate, export and fit; what they leave out they name."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from calib.cli.main import run
from calib.coefficients.file import CoefficientFile, load_coefficients
from calib.coefficients.sections import EffectSection, Quantity
from calib.io import write_bytes


@pytest.fixture(scope="module")
def crossed(project_root: Path) -> Path:
    return project_root / "sample_runs" / "corridor_crossed"


@pytest.fixture(scope="module")
def applied(crossed: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("applied") / "model.json"
    assert run(["diagnose", str(crossed), "--apply", str(path)]) == 0
    return path


@pytest.fixture(scope="module")
def warm(applied: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The applied model with an effect that no radius law holds."""
    alpha = {"alpha": Quantity(value=5e-5, unit="1/K")}
    section = EffectSection(effect="temperature_radius", settings={"centre": 20.0}, parameters=alpha)
    made: CoefficientFile = load_coefficients(applied).changed(effects=[section])
    path = tmp_path_factory.mktemp("warm") / "model.json"
    path.write_bytes(made.to_bytes())
    return path


def _json(arguments: list[str], capsys: pytest.CaptureFixture[str], status: int = 0) -> dict[str, object]:
    assert run([*arguments, "--json", "-"]) == status
    found: dict[str, object] = json.loads(capsys.readouterr().out)
    return found


def test_a_journey_under_an_applied_load_effect_has_the_radii_of_its_line(
    applied: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """E_r, right over left, of radii over those at the 300 N that the uncorrected odometry uses."""
    document = _json(
        ["simulate", "study", "corrected", "--model", str(applied), "--load", "900,300", "--draws", "2000"], capsys
    )
    text = json.loads(applied.read_text(encoding="utf-8"))
    ratio = {}
    for side, load in (("left", 900.0), ("right", 300.0)):
        wheel = {key: one["value"] for key, one in text["wheels"][side].items() if "value" in one}
        laden, unladen = (wheel["radius_ref"] + wheel["slope"] * (at - wheel["reference_load"]) for at in (load, 300.0))
        ratio[side] = laden / unladen
    journey = document["law"]["journeys"][0]  # type: ignore[index]
    # rounding of a handful of products
    assert journey["radius_ratio"] == pytest.approx(ratio["right"] / ratio["left"], rel=1e-12)
    assert not any("not simulated" in note for note in document["notes"])  # type: ignore[attr-defined]


def test_replay_with_the_applied_model_leaves_a_small_part_of_the_end_error(
    crossed: Path, applied: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The model was wrong by metres; with the load in it the end error falls by more than the paper's factor of 17."""
    document = _json(["simulate", "replay", str(crossed), "--model", str(applied)], capsys)
    rms = document["rms_m"]
    assert rms["model"] / rms["corrected"] > 17  # type: ignore[index]


@pytest.mark.parametrize(
    "arguments", [["simulate", "study", "corrected"], ["simulate", "replay", "CROSSED"], ["fit", "CROSSED"]]
)
def test_an_effect_that_is_left_out_is_named_in_one_note(
    crossed: Path, warm: Path, arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    given = [str(crossed) if one == "CROSSED" else one for one in arguments]
    draws = ["--draws", "500"] if "corrected" in given else []
    document = _json([*given, "--model", str(warm), *draws], capsys)
    holder = document["model_comparison"] if given[0] == "fit" else document
    assert sum("temperature_radius" in note for note in holder["notes"]) == 1  # type: ignore[index]


def test_export_keeps_effects_in_the_master_and_names_them_elsewhere(
    warm: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["export", str(warm), "--to", "json"]) == 0
    out = capsys.readouterr().out
    assert out == warm.read_text(encoding="utf-8")
    assert json.loads(out)["effects"][0]["parameters"]["alpha"] == {"value": 5e-5, "unit": "1/K"}
    for to, mark in (("ros2", "# NOT in this file"), ("c", " * NOT in this header"), ("csv", "")):
        assert run(["export", str(warm), "--to", to]) == 0
        lines = [line for line in capsys.readouterr().out.splitlines() if "temperature_radius" in line]
        assert lines and all(line.startswith(mark) for line in lines)


BESIDE = "with radii and track alone a vehicle may err more"


@pytest.mark.parametrize(
    ("effect", "said"), [("temperature_radius", True), ("lost_counts", True), ("reference_yaw", False)]
)
def test_radii_beside_an_effect_of_the_vehicle_are_said_to_be_so(
    warm: Path, effect: str, said: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By every format of a vehicle, on standard error and in the file; a fault of an instrument is none of its own."""
    section = {"effect": effect, "parameters": {"size": {"value": 1e-3, "unit": "1"}}}
    path = write_bytes(tmp_path / "model.json", load_coefficients(warm).changed(effects=[section]).to_bytes())
    for to, in_file in (("ros2", said), ("c", said), ("csv", False)):
        assert run(["export", str(path), "--to", to]) == 0
        made = capsys.readouterr()
        assert f"not in {to}: {effect}" in made.err
        assert (BESIDE in made.err, BESIDE in made.out) == (said, in_file)


def test_a_written_model_with_effects_says_what_its_radii_are_for_a_vehicle(
    crossed: Path, warm: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """An effect that the diagnosed model had stays in it: its radii change by a thousandth, 20 degrees above zero."""
    alpha = {"alpha": {"value": 5e-5, "unit": "1/K"}}
    section = {"effect": "temperature_radius", "settings": {"centre": 0.0}, "parameters": alpha}
    path = write_bytes(tmp_path / "model.json", load_coefficients(warm).changed(effects=[section]).to_bytes())
    run(["diagnose", str(crossed), "--model", str(path), "--apply", str(tmp_path / "again.json")])
    said = capsys.readouterr().err
    assert "not in a vehicle's runtime, ros2, c and csv: temperature_radius" in said
    assert "end error of these runs: " in said and BESIDE not in said


def test_the_table_names_effects_in_a_column_that_is_there_only_with_effects(
    applied: Path, warm: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    headers = []
    for source in (applied, warm):
        assert run(["export", str(source), "--to", "csv"]) == 0
        headers.append(capsys.readouterr().out.splitlines()[0].split(","))
    assert headers[1] == [*headers[0], "effects_not_in_table"]


def test_the_fit_contains_the_model_that_was_diagnosed_from_the_same_runs(
    crossed: Path, applied: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two ways to the same slopes: regression of radii, and end poses and distances together."""
    document = _json(["fit", str(crossed), "--model", str(applied)], capsys)
    compared, wheels = document["model_comparison"], document["wheels"]
    for side in ("left", "right"):
        slope = compared["wheels"][side]["slope"]  # type: ignore[index]
        assert slope["model_inside"]
        low, high = wheels[side]["slope_ci95_m_per_N"]  # type: ignore[index]
        assert low <= slope["model_m_per_N"] <= high


def test_radii_are_compared_at_the_models_reference_load(
    crossed: Path, applied: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The same line centred elsewhere is the same model: its radius moves by slope times load."""
    text = json.loads(applied.read_text(encoding="utf-8"))
    for wheel in text["wheels"].values():
        wheel["radius_ref"]["value"] += 400.0 * wheel["slope"]["value"]
        wheel["reference_load"]["value"] += 400.0
    text.pop("checksum", None)
    moved = load_coefficients(applied).changed(wheels=text["wheels"])
    path = tmp_path / "moved.json"
    path.write_bytes(moved.to_bytes())
    document = _json(["fit", str(crossed), "--model", str(path)], capsys)
    compared = document["model_comparison"]
    assert compared["reference_load_N"] == 700.0  # type: ignore[index]
    assert document["wheels"]["left"]["reference_load_N"] == 700.0  # type: ignore[index]
    assert compared["wheels"]["left"]["radius_ref"]["model_m"] == pytest.approx(  # type: ignore[index]
        text["wheels"]["left"]["radius_ref"]["value"], rel=1e-12
    )


def test_a_model_that_is_wrong_lies_outside(
    crossed: Path, project_root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The other campaign's tyres grow with load, these shrink."""
    other = tmp_path / "other.json"
    assert run(["export", str(project_root / "sample_runs/corridor"), "--to", "json", "--output", str(other)]) == 0
    capsys.readouterr()
    assert run(["fit", str(crossed), "--model", str(other)]) == 0
    out = capsys.readouterr().out
    assert "OUTSIDE" in out and "inside" not in out.split("left: slope")[1].splitlines()[0]


def test_the_models_reference_load_leaves_no_room_for_another(
    crossed: Path, applied: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["fit", str(crossed), "--model", str(applied), "--reference-load", "500"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
