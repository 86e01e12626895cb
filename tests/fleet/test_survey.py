"""A task over a fleet names what its vehicles share, and goes on past those that fail."""

from __future__ import annotations

import shutil
from pathlib import Path

import pandas as pd
import pytest

from calib.errors import BadInputError
from calib.fleet.survey import survey_fleet

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


def test_an_unknown_task_is_refused(fleet: Path, tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="diagnose"):
        survey_fleet(fleet, tmp_path / "out", "paint")
