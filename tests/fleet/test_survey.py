"""A task over a fleet names what its vehicles share, and goes on past those that fail."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from markupsafe import escape

from calib.campaign import write_campaign
from calib.campaign.read import read_campaign
from calib.errors import BadInputError, CalibError
from calib.fleet import VehicleResult, shared_causes
from calib.fleet import run as survey_module
from calib.fleet.run import Survey, survey_fleet
from calib.fleet.store import Member
from calib.kinematics.estimate import estimate_geometry
from calib.plant.make import FleetSize, make_posed_fleet
from calib.reporting.formatting import to_text
from calib.reporting.pages import write_fleet
from calib.reporting.topics.geometry import fleet_content
from tests.kinematics.campaigns import Truth, square
from tests.kinematics.unaided import Drive, Gyro, unaided

ROOT = Path(__file__).resolve().parents[2]
N_VEHICLES = 12


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Copies of the sample corridor without logs; in hall B the wheels are swapped, which the check sees."""
    folder = tmp_path_factory.mktemp("fleets") / "halls"
    runs = pd.read_csv(ROOT / "sample_runs" / "corridor_crossed" / "runs.csv").drop(columns=["log"])
    lines = ["vehicle,hall"]
    for number in range(N_VEHICLES):
        target = folder / f"v{number:02d}"
        target.mkdir(parents=True)
        shutil.copy(ROOT / "sample_runs" / "corridor_crossed" / "campaign.toml", target)
        table = runs.copy()
        in_b = number % 2 == 0
        if in_b:
            table["distance_m"] *= 2.0
        table.to_csv(target / "runs.csv", index=False)
        lines.append(f"v{number:02d},{'B' if in_b else 'A'}")
    (folder / "vehicles.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder


def test_what_the_vehicles_of_a_hall_share_is_said_of_the_hall(fleet: Path, tmp_path: Path) -> None:
    """Six of six vehicles of hall B have a finding that none of hall A has: Fisher's exact test lets it stand."""
    survey = survey_fleet(fleet, tmp_path / "out", "check")
    special = [cause for cause in survey.shared if cause.label]
    assert special
    assert {(cause.label, cause.value, cause.n_showing, cause.n_vehicles) for cause in special} == {("hall", "B", 6, 6)}


def test_a_vehicle_that_fails_is_listed_and_the_others_are_done(fleet: Path, tmp_path: Path) -> None:
    """One line for the vehicle whose table is no table."""
    folder = tmp_path / "fleet"
    shutil.copytree(fleet, folder)
    (folder / "v03" / "campaign.toml").write_text("no = [toml", encoding="utf-8")
    survey = survey_fleet(folder, tmp_path / "out", "check", workers=2)
    failed = [record for record in survey.records if record.status == "failed"]
    assert [record.name for record in failed] == ["v03"]
    assert "campaign.toml" in failed[0].why
    again = survey_fleet(folder, tmp_path / "out", "check")
    assert again.to_dict() == survey.to_dict()


def test_geometry_of_a_fleet_has_populations_and_what_a_hall_shares(
    fleet: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Estimates drawn about known means: hall B's track 2 mm wider is said of the hall, an odd vehicle is named."""
    rng = np.random.default_rng(8)

    def estimated(member: Member) -> dict[str, object]:
        number = int(member.vehicle[1:])
        track = 0.7 + (2e-3 if number % 2 == 0 else 0.0) + 1e-4 * rng.standard_normal()
        radius = 0.1 + 1e-5 * rng.standard_normal() + (1e-3 if number == 5 else 0.0)
        values = {"track_m": (track, 2e-5), "radius_left_m": (radius, 2e-6)}
        return {"estimates": {name: {"value": value, "sd": sd} for name, (value, sd) in values.items()}, "wrong": []}

    monkeypatch.setitem(survey_module.TASKS, "geometry", estimated)
    survey = survey_fleet(fleet, tmp_path / "out", "geometry")
    assert survey.quantities is not None
    assert [outlier.vehicle for outlier in survey.quantities.outliers] == ["v05"]
    # of two halls alone either is off the other
    (shared,) = survey.quantities.common
    assert (shared.label, shared.quantity) == ("hall", "track_m")
    assert abs(shared.difference.size) == pytest.approx(2e-3, abs=2e-4)
    low, high = survey.quantities.populations["radius_left_m"].mean_ci95
    assert low < 0.1 < high
    pages = write_fleet(survey, tmp_path / "out", name="halls", issued="2026-01-31")
    written = {path.name: path for path in pages}
    assert written["geometry.pdf"].read_bytes().startswith(b"%PDF")
    text = written["geometry.html"].read_text(encoding="utf-8")
    assert "v05, radius left" in text
    assert all(escape(difference.sentence) in text for difference in survey.quantities.common)


def test_the_geometry_of_a_vehicle_is_that_of_its_campaign(fleet: Path, tmp_path: Path) -> None:
    """One vehicle through the fleet, and its campaign alone: the same values."""
    shutil.copytree(ROOT / "sample_runs" / "corridor_crossed", tmp_path / "fleet" / "v1")
    record = survey_fleet(tmp_path / "fleet", tmp_path / "out", "geometry").records[0]
    try:
        alone = estimate_geometry(read_campaign(tmp_path / "fleet" / "v1"))
    except CalibError as error:
        assert record.why == " ".join(str(error).split())
        return
    assert record.values["estimates"] == alone.to_dict()["parameters"]


def test_a_fleet_with_poses_shows_its_odd_track(tmp_path: Path) -> None:
    """Three vehicles of the independent plant: every interval of the track holds the truth but one at most."""
    truth = make_posed_fleet(tmp_path / "fleet", np.random.default_rng(3), FleetSize(3, 12, n_outliers=1, n_common=0))
    survey = survey_fleet(tmp_path / "fleet", tmp_path / "out", "geometry")
    tracks = {record.name: record.values["estimates"]["track_m"] for record in survey.records}
    held = [tracks[name]["ci95"][0] <= track <= tracks[name]["ci95"][1] for name, track in truth.track_m.items()]
    assert sum(held) >= len(held) - 1
    low, high = tracks[truth.outliers[0]]["ci95"]
    assert all(not low <= tracks[name]["value"] <= high for name in tracks if name not in truth.outliers)


def test_a_zone_that_a_hall_shares_is_said_with_its_place() -> None:
    """Seven of eight vehicles of hall B name neighbouring cells of one zone; one of hall A names another place."""
    labels = {"hall": {f"v{k}": "B" if k < 8 else "A" for k in range(24)}}
    records = []
    for k in range(24):
        causes: list[dict[str, object]] = [{"effect": "track_width", "probability": 0.9}]
        if k < 7:
            causes.append({"effect": "floor_zone", "probability": 0.9, "x_m": (12.0, 12.0, 11.0)[k % 3], "size_m": 2.0})
        if k == 20:
            causes.append({"effect": "floor_zone", "probability": 0.9, "x_m": 4.0, "size_m": 2.0})
        records.append(VehicleResult(f"v{k}", "key", {"verdict": "explained", "causes": causes}))
    sentences = [cause.sentence for cause in shared_causes(records, labels)]
    assert "7 of 8 vehicles with hall B: floor zone at x = 12 m" in sentences
    assert "24 of 24 vehicles: track_width" in sentences
    assert not any("x = 4" in sentence for sentence in sentences)


def test_an_unknown_task_is_refused(fleet: Path, tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="diagnose"):
        survey_fleet(fleet, tmp_path / "out", "paint")


def test_what_each_vehicle_ended_with_is_shown() -> None:
    """`done` is no all-clear: a verdict with its causes, or a check with its findings, stands beside the vehicles."""
    found = {"verdict": "partly_explained", "causes": [{"effect": "floor_slope", "probability": 0.9}]}
    records = [VehicleResult(name, "", found) for name in ("v1", "v3")]
    records += [VehicleResult("v2", "", {"verdict": "wrong", "wrong": ["no_log"], "suspicious": []})]
    shown = to_text(fleet_content(Survey("diagnose", tuple(records), (), 3, 0)))
    assert re.search("partly_explained +floor_slope +2 +v1, v3", shown)
    assert re.search("wrong +no_log +1 +v2", shown)


def test_lengths_that_rest_on_the_nominal_mean_radius_are_no_figures_of_a_fleet(tmp_path: Path) -> None:
    """Of closed loops the ratios are, and they show the vehicle whose track is another."""
    loops = [Drive(f"square{sense}", square(2.0, sense), frozenset({"loop"})) for sense in (1, -1) * 3]
    for number in range(10):
        rng = np.random.default_rng([9, number])
        truth = Truth(
            0.05, 0.05 * (1.0 + 1e-3 * rng.normal()), 0.4 * (1.0 + 1e-3 * rng.normal() + 0.03 * (number == 4))
        )
        write_campaign(unaided(loops, truth, Gyro(), rng), tmp_path / "fleet" / f"v{number}")
    found = survey_fleet(tmp_path / "fleet", tmp_path / "out", "geometry").quantities
    assert found is not None
    assert found.populations.keys() == {"right_over_left", "track_over_radius"}
    assert [(outlier.vehicle, outlier.quantity) for outlier in found.outliers] == [("v4", "track_over_radius")]
