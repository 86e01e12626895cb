"""The AGV in MuJoCo: it rolls as wheels roll, and a hidden change is named, set and closes the gap."""

from __future__ import annotations

import importlib
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="MuJoCo is not installed")

from calib.campaign.read import read_campaign
from calib.cli.main import run
from calib.gap.simulator import read_settings

FOLDER = Path(__file__).resolve().parents[2] / "examples" / "mujoco_agv"
#: contacts creep and give way, by some 2 % of a turn: so far from where rigid wheels would take it the vehicle ends
CREEP_M, CREEP_RAD = 0.03, 0.02
#: of the root mean square of 24 readings over their noise: 1 within its scatter of 0.14, three times
NOISE = 1.45


@pytest.fixture(scope="module")
def example(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[ModuleType, ModuleType]]:
    """The modules of the example, imported as its scripts import each other."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(FOLDER))
        patch.setenv("CALIB_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield importlib.import_module("agv"), importlib.import_module("make_campaign")
    for name in ("agv", "make_campaign"):
        sys.modules.pop(name, None)


def test_the_vehicle_rolls_as_its_wheels_do(example: tuple[ModuleType, ModuleType]) -> None:
    """Against exact arcs of two rigid wheels, on a corridor and on a turn, to the left and to the right."""
    agv, making = example
    rad = 2 * np.pi / making.COUNTS
    for pieces in (making.ROUTES["corridor"], making.ROUTES["turn_left"], [(1.0, 0.0), (1.0, -0.8), (0.5, 0.0)]):
        log = making.log_of(pieces, 0.6, True)
        angles = log[:, 1:] * [rad, rad, 1.0]
        steps = np.diff(angles[:, :2], axis=0) * making.RADIUS_M
        turn = (steps[:, 1] - steps[:, 0]) / making.TRACK_M
        middle = np.cumsum(turn) - 0.5 * turn
        x, y = (float(steps.mean(axis=1) @ part) for part in (np.cos(middle), np.sin(middle)))
        end = agv.drive(agv.build(making.NOMINAL, 0.0, 0.4, 0.0), log[:, 0], angles, log[-1, 0])
        assert np.hypot(end[0] - x, end[1] - y) < CREEP_M
        assert abs(end[2] - turn.sum()) < CREEP_RAD


def test_a_wheel_under_load_gives_way_by_what_the_model_says(example: tuple[ModuleType, ModuleType]) -> None:
    """A payload on the left wheel alone shortens its way: the vehicle turns left on a straight."""
    agv, making = example
    rad = 2 * np.pi / making.COUNTS
    log = making.log_of([(2.0, 0.0)], 0.6, True)
    angles = log[:, 1:] * [rad, rad, 1.0]
    ends = [
        agv.drive(agv.build(making.NOMINAL, 300.0, 0.2, y), log[:, 0], angles, log[-1, 0])[2] for y in (-0.2, 0.0, 0.2)
    ]
    assert ends[0] < -1e-3 < 1e-3 < ends[2]
    assert abs(ends[1]) < 1e-4
    assert ends[0] == pytest.approx(-ends[2], rel=0.05)


def test_a_hidden_change_is_named_set_and_closes(
    example: tuple[ModuleType, ModuleType], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    agv, making = example
    hidden = 0.707
    making.main(tmp_path / "campaign", {"track": hidden}, (0.0,), ("square_ccw", "turn_left"))
    measured = read_campaign(tmp_path / "campaign").runs.numbers
    text = (FOLDER / "SIM.toml").read_text()
    # two of the six parameters, so that the test is short
    tables = text.split("[[parameter]]")
    text = "[[parameter]]".join([tables[0], tables[1], tables[3]])
    text = text.replace('"python", "agv.py"', f'"{sys.executable}", "{FOLDER / "agv.py"}"')
    (tmp_path / "SIM.toml").write_text(text.replace('"agv.xml"', f'"{FOLDER / "agv.xml"}"'))
    call = ["diagnose", str(tmp_path / "campaign"), "--simulator", str(tmp_path / "SIM.toml"), "--workers", "2"]
    target = tmp_path / "set.json"
    assert run([*call, "--apply", str(target), "--json", "-"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert [cause["effect"] for cause in document["causes"]] == ["simulator:track"]
    low, high = document["causes"][0]["parameters"]["track"]["ci95"]
    value = json.loads(target.read_text())["track"]
    assert abs(value - hidden) < 2 * (high - low)
    assert document["closure"]["held_out"] == "none"
    assert document["closure"]["fraction"] > 0.99

    # the simulator itself, with the value set, ends where the vehicle did, to the noise of the reference
    (tmp_path / "set.json").write_text(json.dumps({"track": value}))
    agv.main(tmp_path / "campaign", tmp_path / "set.json", tmp_path / "out.csv")
    ends = np.genfromtxt(tmp_path / "out.csv", delimiter=",", skip_header=1)[:, 1:]
    read = np.column_stack([measured[name] for name in ("ref_x_m", "ref_y_m", "ref_theta_rad")])
    noise = np.array([making.SIGMA_M, making.SIGMA_M, making.SIGMA_RAD])
    assert np.sqrt(np.mean(((ends - read) / noise) ** 2)) < NOISE


def test_all_that_the_settings_list_is_a_parameter_of_the_model(example: tuple[ModuleType, ModuleType]) -> None:
    nominal = read_settings(FOLDER / "SIM.toml").nominal
    assert nominal.items() <= example[0].NOMINAL.items()
    # what the hidden changes of the manual may be beyond them
    assert example[0].NOMINAL.keys() - nominal.keys() == {"friction", "reference_delay"}
