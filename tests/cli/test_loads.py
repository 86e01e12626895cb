"""`calib loads`: numbers, figures, refusals and exit statuses as a user meets them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from calib.cli.main import run


def test_fig_3a_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    third = "0.2333333333333"
    sweep = ["--sweep", "y", "--from", f"-{third}", "--to", third, "--steps", "3"]
    assert run(["loads", "--cog-x", "0.4", "--payload", "100", "--x", "0.5", *sweep, "--json", "-"]) == 0
    document = json.loads(capsys.readouterr().out)
    # digits printed
    assert [row["left_N"] for row in document["loads"]] == pytest.approx([212.55, 539.55, 866.55], abs=0.005)
    assert [row["right_N"] for row in document["loads"]] == pytest.approx([866.55, 539.55, 212.55], abs=0.005)


def test_figures_are_written_in_three_formats_and_not_overwritten(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["loads", "--x", "0.1845", "--sweep", "payload", "--from", "0", "--to", "200", "--figures"]
    assert run([*arguments, str(tmp_path)]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fig3b.pdf", "fig3b.png", "fig3b.svg"]
    first = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert run([*arguments, str(tmp_path)]) == 2
    assert "--force" in capsys.readouterr().err
    assert run([*arguments, str(tmp_path), "--force"]) == 0
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == first


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--payload", "200", "--x", "0.2", "--y", "0.7"], "right wheel lifts off"),
        (["--payload", "200", "--x", "-0.5"], "front wheel lifts off"),
        (["--payload", "9000", "--x", "0.3"], "overload"),
        (["--payload", "-1"], "below 0"),
        (["--payload", "nan"], "payload"),
        (["--sweep", "z", "--from", "0", "--to", "1"], "payload, x or y"),
        (["--sweep", "y"], "--from and --to"),
        (["--sweep", "payload", "--from", "0", "--to", "9", "--payload", "7"], "--payload: found with --sweep payload"),
        (["--payload", "9", "--steps", "5"], "--steps: found without --sweep; expected --sweep beside it"),
        (["--weighed", "300,400,400", "--payload", "5"], "--payload: found with --weighed; expected none"),
        (["--sigma", "1"], "--sigma: found without --weighed"),
        (["--weighed", "1,2"], "3 numbers"),
        (["--weighed", "300,300,300"], "no payload"),
        (["--track", "0"], "track_m"),
        (["--vehicle", "nowhere.json"], "nowhere.json"),
    ],
)
def test_what_cannot_be_carried_or_read_is_refused_in_one_line(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["loads", *arguments]) == 2
    said = capsys.readouterr()
    assert words in said.err
    assert said.err.count("\n") == 1
    assert said.out == ""


def test_a_sweep_names_the_first_payload_that_tips(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["loads", "--payload", "200", "--x", "0.2", "--sweep", "y", "--from", "0", "--to", "1"]) == 2
    assert "payload 200 kg at x 0.2 m, y 0.4 m: the right wheel lifts off" in capsys.readouterr().err


def test_the_vehicle_of_a_fit_is_that_of_its_campaign(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = Path(__file__).resolve().parents[2] / "sample_runs" / "corridor"
    assert run(["fit", str(source), "--into", str(tmp_path / "fit")]) == 0
    capsys.readouterr()
    rows = []
    for vehicle in (source, tmp_path / "fit"):
        assert run(["loads", "--vehicle", str(vehicle), "--payload", "80", "--x", "0.3", "--json", "-"]) == 0
        rows.append(json.loads(capsys.readouterr().out)["loads"])
    assert rows[0] == rows[1]


def test_weighed_wheels_give_the_payload_back(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["loads", "--payload", "80", "--x", "0.3", "--y", "-0.1", "--json", "-"]) == 0
    row = json.loads(capsys.readouterr().out)["loads"][0]
    weighed = ",".join(repr(row[key]) for key in ("front_N", "left_N", "right_N"))
    assert run(["loads", "--weighed", weighed, "--sigma", "1", "--json", "-"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["payload_kg"], found["payload_x_m"], found["payload_y_m"]) == pytest.approx(
        (80.0, 0.3, -0.1), rel=1e-9
    )
    assert found["payload_std_kg"] == pytest.approx(3**0.5 / 9.81)


def test_tables_are_for_people(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["loads", "--payload", "50", "--x", "0.2"]) == 0
    assert "50  0.2000  0.0000" in capsys.readouterr().out
    assert run(["loads", "--weighed", "800,500,420"]) == 0
    assert "not given" in capsys.readouterr().out


@pytest.mark.parametrize("more", [[], ["--json", "-"]])
def test_a_mass_beyond_all_numbers_is_refused(more: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    """With and without JSON alike: a load that is no number is no answer."""
    assert run(["loads", "--mass", "1e308", *more]) == 2
    assert "wheel load that is not finite" in capsys.readouterr().err
