"""`calib simulate`: studies, laws, replay and trajectories as a user meets them."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from calib.cli.main import run
from calib.odometry.poses import read_tum


@pytest.fixture(scope="module")
def campaign(project_root_module: Path) -> Path:
    return project_root_module / "sample_runs" / "corridor_crossed"


@pytest.fixture(scope="module")
def project_root_module() -> Path:
    return Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def coefficients(campaign: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("coefficients") / "coefficients.json"
    assert run(["export", str(campaign), "--to", "json", "--output", str(path)]) == 0
    return path


def document(capsys: pytest.CaptureFixture[str]) -> dict:
    out = capsys.readouterr().out
    found = json.loads(out)
    assert isinstance(found, dict)
    return found


def test_symmetric_study_gives_fig_12(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["simulate", "study", "symmetric", "--json", "-"]) == 0
    row = document(capsys)["sweeps"][0]["cases"][0]
    got = (row["first_segment_m"], row["end_x_m"], row["end_y_m"], row["error_distance_m"])
    assert got == pytest.approx((4.9, 8.052432, 7.803350, 0.203520), abs=0.5e-6)  # digits printed


@pytest.mark.usefixtures("drawn_once")
def test_corrected_study_gives_fig_16_and_the_headline(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["simulate", "study", "corrected", "--output", str(tmp_path), "--json", "-"]) == 0
    found = document(capsys)
    right = next(line for line in found["headline"] if line["which"] == "right")
    assert (right["without_m"], right["corrected_m"]) == pytest.approx((1.24753, 0.07375), abs=0.5e-5)  # digits printed
    assert found["paper"]["ratio"] == right["ratio"]  # the same study, by the same function
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"corrected.json"} | {
        f"{stem}.{suffix}" for stem in ("fig16", "fig16_errors") for suffix in ("png", "svg", "pdf", "csv")
    }
    assert json.loads((tmp_path / "corrected.json").read_text())["headline"] == found["headline"]


@pytest.mark.usefixtures("drawn_once")
def test_table_1_and_fig_15_come_from_coefficients_or_campaign_alike(
    campaign: Path, coefficients: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    common = ["--draws", "100", "--seed", "4", "--json", "-"]
    assert run(["simulate", "study", "asymmetric", "--law", str(campaign), "--output", str(tmp_path), *common]) == 0
    by_campaign = document(capsys)
    assert run(["simulate", "study", "asymmetric", "--model", str(coefficients), *common]) == 0
    by_file = document(capsys)
    assert by_campaign["law"]["table"] == by_file["law"]["table"]
    assert by_campaign["law"]["journeys"] == by_file["law"]["journeys"]
    assert [row["load_N"] for row in by_file["law"]["table"]] == [100.0 * k for k in range(3, 12)]
    made = {path.name for path in tmp_path.iterdir()}
    assert {"table1.csv", "fig15.png", "fig15.svg", "fig15.pdf", "fig13.pdf", "fig14.svg"} <= made
    assert {"band.png", "band.csv", "errors.png", "errors.csv", "fig13_errors.csv", "fig14_errors.pdf"} <= made


def test_a_study_of_ones_own(capsys: pytest.CaptureFixture[str]) -> None:
    """Radii believed and real, on a square: both directions, real track another."""
    arguments = ["square_cw", "square_ccw", "--real", "0.099,0.1", "--believed", "0.1,0.1"]
    assert run(["simulate", "route", *arguments, "--real-track", "0.702", "--json", "-"]) == 0
    found = document(capsys)
    assert [sweep["route"] for sweep in found["sweeps"]] == ["square_cw", "square_ccw"]
    ends = [sweep["cases"][0]["error_distance_m"] for sweep in found["sweeps"]]
    assert min(ends) > 0.1
    assert ends[0] != ends[1]


@pytest.mark.usefixtures("files_alone")
def test_a_law_alone_makes_no_table_of_zeros(
    coefficients: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nor figures of what rounding leaves."""
    given = ["simulate", "journey", "straight15", "--law", str(coefficients), "--load", "500,500"]
    assert run([*given, "--output", str(tmp_path)]) == 0
    assert (tmp_path / "errors.png").exists() and not [*tmp_path.glob("route1*")]
    assert "given radii" not in capsys.readouterr().out
    assert run(["simulate", "route", "straight15", "--real", "0.1,0.1"]) == 0
    assert "given radii" in capsys.readouterr().out


def test_payload_and_wheel_loads_say_the_same(coefficients: Path, capsys: pytest.CaptureFixture[str]) -> None:
    common = ["simulate", "journey", "--law", str(coefficients), "--draws", "100", "--json", "-"]
    assert run([*common, "--payload", "100,0.5,0.1"]) == 0
    by_payload = document(capsys)["law"]["journeys"][0]
    loads = f"{by_payload['load_left_N']!r},{by_payload['load_right_N']!r}"
    assert run([*common, "--load", loads]) == 0
    assert document(capsys)["law"]["journeys"][0] == by_payload


@pytest.mark.usefixtures("files_alone")
def test_a_payload_put_on_the_way_and_taken_off_again(
    coefficients: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    common = ["simulate", "journey", "--law", str(coefficients), "--draws", "100"]
    changes = ["--payload-at", "10,0,0,0", "--payload-at", "5,100,0.5,0.1"]
    assert run([*common, *changes, "--output", str(tmp_path), "--json", "-"]) == 0
    path = document(capsys)["law"]["path"]
    assert [row["from_m"] for row in path["loading"]] == [0.0, 5.0, 10.0]
    unladen, laden, unloaded = ((row["load_left_N"], row["load_right_N"]) for row in path["loading"])
    assert unladen == unloaded != laden
    assert path["ratio"] == path["without"]["rms_m"] / path["corrected"]["rms_m"] > 1.0
    assert path["corrected"]["error_lateral_m"] == pytest.approx(0.0, abs=1e-9)
    rows = list(csv.DictReader((tmp_path / "errors.csv").open(encoding="utf-8")))
    assert float(rows[-1]["without_error_lateral_m"]) == path["without"]["error_lateral_m"]
    assert run([*common, *changes]) == 0
    said = capsys.readouterr().out
    assert "from 5 m" in said
    assert "that follow the load" in said


def test_trajectories_are_written_and_followed_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["simulate", "study", "symmetric", "--tum", str(tmp_path)]) == 0
    capsys.readouterr()
    t, poses = read_tum(tmp_path / "fig12_equal_0.98.tum")
    # a trajectory's times are read to a nanosecond
    assert float(t[-1]) == pytest.approx((10 + 1.5 * 3.141592653589793) / 0.5, rel=0, abs=5e-10)
    assert float(poses.x_m[-1]) == pytest.approx(8.052432, abs=0.5e-6)
    route = str(tmp_path / "fig12_route.tum")
    assert run(["simulate", "route", route, "--wheel", "equal", "--ratio", "0.98", "--json", "-"]) == 0
    row = document(capsys)["sweeps"][0]["cases"][0]
    assert (row["end_x_m"], row["end_y_m"]) == pytest.approx((8.052432, 7.803350), abs=0.5e-6)


def test_the_trajectories_of_a_journey_are_the_route_and_where_the_vehicle_really_went(
    coefficients: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Where a file ends is what the JSON says of it: the route's end and the error beside it."""
    common = ["simulate", "journey", "straight15", "--law", str(coefficients), "--draws", "100"]
    assert run([*common, "--load", "784,503", "--tum", str(tmp_path), "--json", "-"]) == 0
    path = document(capsys)["law"]["path"]
    names = ("route1_route.tum", "route1_without.tum", "route1_corrected.tum")
    assert sorted(file.name for file in tmp_path.iterdir()) == sorted(names)
    route, *real = (read_tum(tmp_path / name)[1][-1] for name in names)
    # rel, abs: every digit is written
    assert (float(route.x_m), float(route.y_m)) == pytest.approx((15.0, 0.0), abs=1e-9)
    for pose, key in zip(real, ("without", "corrected"), strict=True):
        off = (float(pose.x_m - route.x_m), float(pose.y_m - route.y_m), float(pose.theta_rad - route.theta_rad))
        stated = (path[key][f"error_{name}"] for name in ("global_x_m", "global_y_m", "heading_rad"))
        assert off == pytest.approx(tuple(stated), abs=1e-9)
    # the radii of the sample differ by a third of a per cent at these loads: decimetres after 15 m
    assert abs(float(real[0].y_m)) > 0.1


@pytest.mark.usefixtures("drawn_once")
def test_replay_shows_what_the_correction_is_worth(
    campaign: Path, coefficients: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["simulate", "replay", str(campaign), "--law", str(coefficients), "--output", str(tmp_path / "out")]
    assert run([*arguments, "--tum", str(tmp_path / "tum"), "--json", "-"]) == 0
    found = document(capsys)
    assert found["simulated"] is True
    assert found["ratio_ci95"][0] <= found["ratio"] <= found["ratio_ci95"][1]
    # the sample's radii change by a percent over the loads; without the correction that is metres after 40 m
    assert found["ratio"] > 5.0
    assert found["runtime"]["largest_difference_m"] < 1e-9
    assert found["runtime"]["faults"] == {}
    assert len(found["runs"]) == 60
    assert (tmp_path / "out" / "replay.png").exists()
    assert len(list((tmp_path / "tum").glob("*.tum"))) >= 60


def test_the_schemes_differ_in_replay_as_their_order_says(
    campaign: Path, coefficients: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ends = {}
    for scheme in ("exact", "mid_point", "end_point"):
        arguments = ["simulate", "replay", str(campaign), "--law", str(coefficients), "--scheme", scheme]
        assert run([*arguments, "--json", "-"]) == 0
        ends[scheme] = [row["corrected_lateral_m"] for row in document(capsys)["runs"]]
    gap = [max(abs(a - b) for a, b in zip(ends["exact"], ends[s], strict=True)) for s in ("mid_point", "end_point")]
    assert gap[0] < 1e-3 * gap[1]


def test_the_list_of_simulations_is_shown_in_one_line_where_none_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["simulate"]) == 2
    (shown,) = capsys.readouterr().err.splitlines()
    assert all(name in shown for name in ("route", "journey", "study", "replay"))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["sideways"], "sideways"),
        (["study", "symetric"], "did you mean 'symmetric'"),
        (["route"], "--real"),
        (["route", "--ratio", "0"], "ratio of radii"),
        (["route", "--ratio", "1", "--wheel", "front"], "which wheel"),
        (["route", "--ratio", "x"], "--ratio"),
        (["route", "--believed", "0.1,0.1"], "--real"),
        (["route", "--real", "0.1,0.1", "--wheel", "left"], "--wheel: found without --ratio"),
        (["study", "symmetric", "--draws", "5"], "--draws: found without --law"),
        (["route", "--real", "0.1,-0.1"], "radius of 0 or below"),
        (["study", "symmetric", "--route", "spiral"], "figure8"),
        (["study", "symmetric", "--load", "300,300"], "--law"),
        (["study", "symmetric", "--payload-at", "1,50,0,0"], "'calib simulate journey' has it"),
        (["replay", "nowhere", "--payload-at", "1,50,0,0"], "'calib simulate journey' has it"),
        (["journey"], "--law"),
        (["study", "symmetric", "--track", "-1"], "track"),
        (["study", "symmetric", "--speed", "0"], "--speed"),
        (["study", "symmetric", "--law", "nowhere"], "nowhere"),
        (["replay", "nowhere"], "nowhere"),
    ],
)
def test_impossible_requests_are_refused_in_one_line(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["simulate", *arguments]) == 2
    said = capsys.readouterr()
    assert words in said.err
    assert said.err.count("\n") == 1
    assert said.out == ""


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("99,50,0.3,0", "before the end"),
        ("-1,50,0.3,0", "below 0 m"),
        ("1,-5,0.3,0", "-5 kg"),
        ("1,50,0.3", "4 numbers"),
        ("1,50,0.3,0 --draws 0", "100 or more"),
        ("1,100,5,0", "payload 100 kg at x 5 m"),
    ],
)
def test_impossible_loads_on_the_way_are_refused_in_one_line(
    change: str, words: str, coefficients: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["simulate", "journey", "--law", str(coefficients), "--payload-at", *change.split()]) != 0
    said = capsys.readouterr()
    assert words in said.err
    assert said.err.count("\n") == 1


def test_the_same_seed_gives_the_same_text_and_another_one_other_draws(
    coefficients: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made = []
    for seed in ("9", "9", "10"):
        arguments = ["simulate", "study", "symmetric", "--law", str(coefficients), "--draws", "100", "--seed", seed]
        assert run([*arguments, "--json", "-"]) == 0
        made.append(capsys.readouterr().out)
    assert made[0] == made[1] != made[2]


def test_what_comes_from_a_simulated_law_says_so(
    project_root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Text, JSON and every figure; a study without a law is of no data."""
    law = str(project_root / "sample_runs" / "corridor_crossed")
    assert run(["simulate", "journey", "--law", law, "--load", "500,700", "--output", str(tmp_path / "o")]) == 0
    assert "SIMULATED DATA" in capsys.readouterr().out
    assert json.loads((tmp_path / "o" / "custom.json").read_text())["law"]["simulated"] is True
    figures = sorted((tmp_path / "o").glob("*.svg"))
    assert figures and all("SIMULATED DATA" in path.read_text() for path in figures)
    assert run(["simulate", "study", "symmetric", "--output", str(tmp_path / "s")]) == 0
    assert "SIMULATED" not in capsys.readouterr().out
    assert not any("SIMULATED DATA" in path.read_text() for path in (tmp_path / "s").glob("*.svg"))
