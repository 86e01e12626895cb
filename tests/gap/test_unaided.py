"""Diagnosis without motion capture: a gyro's scale and the track are told apart by closed loops alone."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from calib.campaign import write_campaign
from calib.campaign.model import Campaign
from calib.cli.main import run as calib
from calib.gap.diagnose import diagnose_in_full
from calib.kinematics.drives import GYRO_SCALE_STD
from calib.kinematics.estimate import estimate_geometry
from tests.kinematics.campaigns import Truth, square
from tests.kinematics.unaided import Drive, Gyro, unaided

#: nothing is wrong with the wheels
EXACT = Truth(0.05, 0.05, 0.4)
SEED = 3


def campaign(truth: Truth, gyro: Gyro, *, loops: int, seed: int = SEED) -> Campaign:
    """Twelve free routes with a gyro, six straights along a tape, and closed squares both ways."""
    rng = np.random.default_rng(seed)
    runs = [
        Drive("free", [(rng.uniform(0.5, 1.5), rng.uniform(-1.5, 1.5)) for _ in range(8)], frozenset({"gyro"}))
        for _ in range(12)
    ]
    runs += [Drive("corridor", [(8.0, 0.0)], frozenset({"gyro", "tape"})) for _ in range(6)]
    runs += [
        Drive(f"square{sense}", square(2.0, sense), frozenset({"loop"})) for sense in (1, -1) for _ in range(loops)
    ]
    return unaided(runs, truth, gyro, rng)


#: a track 1 % too narrow, and a gyro that reads 1 % too much: the same to the turns of free routes
CAUSES = {"track_width": (Truth(0.05, 0.05, 0.404), Gyro()), "gyro_scale": (EXACT, Gyro(scale=1.01))}


@pytest.mark.parametrize("cause", CAUSES)
def test_without_a_loop_track_and_gyro_are_one_group(cause: str) -> None:
    found = diagnose_in_full(campaign(*CAUSES[cause], loops=0), plan=False).to_dict()
    assert found["verdict"] == "ambiguous" and not found["recommended"]
    assert any({"track_width", "gyro_scale"} <= set(group) for group in found["indistinguishable"])


@pytest.mark.parametrize("cause", CAUSES)
def test_closed_loops_tell_them_apart(cause: str) -> None:
    found = diagnose_in_full(campaign(*CAUSES[cause], loops=4), plan=False).to_dict()
    assert [one["effect"] for one in found["causes"]] == [cause]
    low, high = found["causes"][0]["parameters"]["relative"]["ci95"]
    assert low < 0.01 < high


def test_nothing_wrong_is_no_gap() -> None:
    assert diagnose_in_full(campaign(EXACT, Gyro(), loops=4), plan=False).to_dict()["verdict"] == "no_gap"


def test_geometry_holds_what_a_gyro_leaves_open() -> None:
    """Of the gyro alone its scale is named as undetermined and 1 % of the track is in doubt; loops determine both."""
    truth, gyro = CAUSES["gyro_scale"]
    alone, told = (estimate_geometry(campaign(truth, gyro, loops=loops)) for loops in (0, 4))
    assert alone.passed and told.passed
    assert "gyro_scale" in alone.undetermined and any("closed loop" in note for note in alone.notes)
    assert alone["track_m"].std >= 0.99 * GYRO_SCALE_STD * alone["track_m"].value
    assert abs(told["track_m"].value - 0.4) < 4.0 * told["track_m"].std < 4e-3
    assert abs(told["gyro_scale"].value - 1.01) < 4.0 * told["gyro_scale"].std < 0.02


def test_lengths_alone_give_no_radii_that_look_like_a_result() -> None:
    """Straights by a tape, nothing else: doubtful, and said why; a gyro beside the tape tells the wheels apart."""
    rng = np.random.default_rng(SEED)
    for by, passed in ((frozenset({"tape"}), False), (frozenset({"tape", "gyro"}), True)):
        runs = [Drive("straight", [(length, 0.0)], by) for length in (1.0, 1.5, 2.0, 8.0) for _ in range(4)]
        found = estimate_geometry(unaided(runs, Truth(0.047, 0.047, 0.4), Gyro(), rng))
        assert found.passed is passed
        assert any("wheels apart" in sentence for sentence in found.why) is not passed


def test_the_plan_proposes_a_mark_on_the_floor(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """No pose reference is asked for: the run that tells the two apart is a loop that closes."""
    folder = write_campaign(campaign(*CAUSES["track_width"], loops=0), tmp_path / "c")
    calib(["plan", str(folder), "--json", "-"])
    first = json.loads(capsys.readouterr().out)["next_runs"][0]
    assert first["loop"] == "closed" and "gyro_scale" in first["why"]


@pytest.mark.parametrize("truth", [Truth(0.0495, 0.0495, 0.4), Truth(0.05, 0.05, 0.404)])
def test_closed_loops_alone_group_radius_scale_and_track(truth: Truth) -> None:
    """Both radii 1 % too small, or a track 1 % too wide: a path that closes looks alike, an open one does not."""
    rng = np.random.default_rng(SEED)
    runs = [Drive(f"square{sense}", square(2.0, sense), frozenset({"loop"})) for sense in (1, -1) for _ in range(8)]
    found = diagnose_in_full(unaided(runs, truth, Gyro(), rng), plan=False).to_dict()
    assert found["verdict"] == "ambiguous" and not found["recommended"]
    assert any({"radius_scale", "track_width"} <= set(group) for group in found["indistinguishable"])
