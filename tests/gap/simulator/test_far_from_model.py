"""A simulator whose nominal vehicle is none of [model]: signatures are taken about its paths, not the model's."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path
from unittest.mock import patch

import pytest

from calib.campaign.read import read_campaign
from calib.gap.decision.diagnosis import BY_SIMULATOR, Diagnosis
from calib.gap.diagnose import diagnose_in_full
from calib.gap.simulator import read_settings
from calib.gap.simulator.diagnose import diagnose_simulator
from calib.gap.simulator.runner import SimulatorRunner
from tests.gap.simulator.made import NOMINAL, called, numpy_campaign, numpy_settings

#: standard deviations within which an estimate is of its truth: a chance of some 1 in 4000 of more
SPREAD = 3.7
#: a closed gap is at its noise within the scatter of a root mean square over some fifty readings
CLOSED = 1.3
RUNS_BESIDE_PARAMETERS = 3


@pytest.fixture(scope="module", autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory) -> object:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CALIB_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


def closes(diagnosis: Diagnosis) -> bool:
    after, floor = diagnosis.closure.after_rms_m, diagnosis.closure.floor_rms_m
    assert after is not None and floor is not None
    return after < CLOSED * floor


def far_campaign(folder: Path, hidden: dict[str, float]) -> Path:
    """Write a campaign whose [model] is none of the simulator's."""
    made = numpy_campaign(folder / "campaign", hidden)
    path = made / "campaign.toml"
    head, _, rest = re.split(r"(?ms)(^\[model\]\n.*?)(?=^\[|\Z)", path.read_text(), maxsplit=1)
    path.write_text(f"{head}[model]\nradius_left_m = 0.097\nradius_right_m = 0.101\ntrack_m = 0.67\n\n{rest}")
    return made


def test_columns_of_a_simulator_far_from_the_model_of_the_campaign(tmp_path: Path) -> None:
    """The same where the simulator was run before, and its ends stand in runs.csv."""
    from examples.numpy_simulator.simulator import main

    made = far_campaign(tmp_path, {"wheel_radius_left": 0.0994})
    (tmp_path / "p.json").write_text(json.dumps(NOMINAL))
    main(made, tmp_path / "p.json", tmp_path / "out.csv")
    table = made / "runs.csv"
    with table.open(newline="") as runs, (tmp_path / "out.csv").open(newline="") as ends:
        rows = [run | end for run, end in zip(csv.DictReader(runs), csv.DictReader(ends), strict=True)]
    with table.open("w", newline="") as runs:
        writer = csv.DictWriter(runs, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    diagnosis = diagnose_in_full(read_campaign(made), plan=False)
    assert diagnosis.judged_against == BY_SIMULATOR
    assert "unequal_radii" in {cause.effect for cause in diagnosis.causes}
    assert diagnosis.unexplained is None
    assert closes(diagnosis)


@pytest.mark.parametrize(("name", "value"), [("wheel_radius_left", 0.0994), ("track", 0.712)])
def test_a_simulator_far_from_the_model_of_the_campaign(tmp_path: Path, name: str, value: float) -> None:
    """What bends a path is taken about the simulator's; [model] is off by 3 % of the radii and 4 % of the track."""
    sim, made = numpy_settings(tmp_path), far_campaign(tmp_path, {name: value})
    with patch.object(SimulatorRunner, "_finished", called):
        done = diagnose_simulator(read_campaign(made), read_settings(sim), workers=2)
    assert [cause.effect for cause in done.diagnosis.causes] == [f"simulator:{name}"]
    low, high = done.diagnosis.causes[0].parameters[name].ci95
    assert abs(done.diagnosis.fix.parameters[name] - value) < SPREAD * (high - low) / (2 * 1.96)
    assert closes(done.diagnosis) and done.diagnosis.recommended
    assert done.runs.asked <= len(NOMINAL) + RUNS_BESIDE_PARAMETERS
