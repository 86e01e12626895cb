"""References without motion capture: turns by a gyro with their uncertainty, and closed loops, as folders give them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib.campaign.model import Campaign
from calib.campaign.read import GYRO_SIGMA, GYRO_TURN, rates_at_rest, read_campaign
from calib.errors import BadFileError
from tests.kinematics.campaigns import Truth, square
from tests.kinematics.unaided import Drive, Gyro, unaided

SETTINGS = """format = "calib-campaign/1"
[vehicle]
drive = "differential"
track_m = 0.4
wheel_radius_m = 0.05
wheelbase_m = 0.6
mass_kg = 10
cog_x_m = 0.1
[encoder]
counts_per_rev = 1000
"""


def turning(folder: Path, *, column: str = "gyro_z_radps", rest_s: float = 1.0, loop: str = "") -> Path:
    """Write a campaign of one run: at rest, a turn by half a radian in 1 s at 1 kHz, at rest; the gyro reads 0.1 more.

    The wheels of the nominal vehicle turn it by as much.
    """
    (folder / "logs").mkdir(parents=True)
    t = np.arange(0.0, 2.0 * rest_s + 1.0, 1e-3)
    turned = 0.5 * np.clip(t - rest_s, 0.0, 1.0)
    counts = turned * 0.2 / 0.05 * 1000 / (2.0 * np.pi)
    rate = 0.1 + 0.5 * ((t > rest_s) & (t <= rest_s + 1.0))
    unit = 180.0 / np.pi if column.endswith("degps") else 1.0
    rows = [f"{a:.4f},{-b:.4f},{b:.4f},{unit * c:.9f}" for a, b, c in zip(t, counts, rate, strict=True)]
    (folder / "logs" / "r1.csv").write_text("\n".join([f"t_s,counts_left,counts_right,{column}", *rows]) + "\n")
    (folder / "runs.csv").write_text(f"run_id,kind,loop\nr1,turn,{loop}\n")
    (folder / "campaign.toml").write_text(SETTINGS)
    return folder


@pytest.mark.parametrize("column", ["gyro_z_radps", "gyro_z_degps"])
def test_the_turn_is_the_integral_less_the_bias_at_rest(tmp_path: Path, column: str) -> None:
    """A constant bias of 0.1 rad/s disappears; half a radian remains, to a sample of the rate's edge."""
    campaign = read_campaign(turning(tmp_path / "c", column=column))
    assert campaign.runs.number(GYRO_TURN)[0] == pytest.approx(0.5, abs=1e-3)
    # no noise: nothing to doubt but the last digits of the file
    assert campaign.runs.number(GYRO_SIGMA)[0] < 1e-6
    assert "gyro" in {note.code for note in campaign.notes}


def test_without_a_standstill_the_gyro_is_not_used_and_that_is_said(tmp_path: Path) -> None:
    campaign = read_campaign(turning(tmp_path / "c", rest_s=0.2))
    assert np.isnan(campaign.runs.number(GYRO_TURN)).all()
    assert [note.level for note in campaign.notes if note.code == "gyro_bias"] == ["suspicious"]


def free(number: int, rng: np.random.Generator, *, by: str = "gyro") -> list[Drive]:
    return [
        Drive("free", [(rng.uniform(0.5, 1.5), rng.uniform(-1.5, 1.5)) for _ in range(8)], frozenset({by}))
        for _ in range(number)
    ]


def test_the_turn_is_off_by_as_much_as_is_stated() -> None:
    """Two hundred runs: errors over stated uncertainties have unit scatter, within four of its standard errors."""
    rng = np.random.default_rng(1)
    runs = free(200, rng)
    campaign = unaided(runs, Truth(), Gyro(), rng)
    true = np.array([sum(turn for _, turn in run.legs) for run in runs])
    error = (campaign.runs.number(GYRO_TURN) - true) / campaign.runs.number(GYRO_SIGMA)
    assert np.sqrt(np.mean(error**2)) == pytest.approx(1.0, abs=4.0 / np.sqrt(2.0 * 200))


def test_the_bias_is_that_of_the_standstills() -> None:
    campaign = unaided(free(1, np.random.default_rng(2)), Truth(), Gyro(bias_radps=0.02), np.random.default_rng(3))
    rates = rates_at_rest(campaign, 0)
    # 2 s at either end, less 0.1 s at each of their edges
    assert len(rates) == pytest.approx(3.6 * 50, abs=5)
    assert rates.std(ddof=1) == pytest.approx(0.002, rel=0.2)


def loops(sense: int) -> Campaign:
    rng = np.random.default_rng(4)
    runs = [Drive("square", square(2.0, sense), frozenset({"loop"})) for _ in range(3)]
    return unaided(runs, Truth(0.05, 0.05, 0.4), Gyro(), rng)


@pytest.mark.parametrize("sense", [1, -1])
def test_a_closed_loop_ends_where_it_began_after_whole_turns(sense: int) -> None:
    runs = loops(sense).runs
    assert np.all(runs.number("ref_x_m") == 0.0) and np.all(runs.number("ref_y_m") == 0.0)
    np.testing.assert_allclose(runs.number("ref_theta_rad"), 2.0 * np.pi * sense)


def test_a_loop_that_turns_by_no_whole_turn_is_said(tmp_path: Path) -> None:
    """Half a radian and back to the mark is no turn; two radians are."""
    campaign = read_campaign(turning(tmp_path / "c", loop="closed"))
    assert "closed_loop" in {note.code for note in campaign.notes}
    assert campaign.runs.number("ref_theta_rad")[0] == 0.0


def test_another_word_for_a_loop_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadFileError, match="closed"):
        read_campaign(turning(tmp_path / "c", loop="round"))


def looping(folder: Path, headings_deg: list[float], *, frame: str = "start") -> Path:
    """Write a campaign of loops, every other to the right, whose end headings are these."""
    (folder / "logs").mkdir(parents=True)
    rows = []
    for run, heading in enumerate(headings_deg):
        # 0.2 m of half the track over 0.05 m of radius: four turns of a wheel a turn of the vehicle
        half = 4000.0 * (1 if run % 2 == 0 else -1)
        rows.append(f"r{run},loop,{-half},{half},0,0,{heading}")
    table = ["run_id,kind,counts_left,counts_right,ref_x_m,ref_y_m,ref_theta_deg", *rows]
    (folder / "runs.csv").write_text("\n".join(table) + "\n")
    (folder / "campaign.toml").write_text(f'{SETTINGS}[reference]\nframe = "{frame}"\n')
    return folder


@pytest.mark.parametrize(
    ("stated_deg", "frame", "read_deg"),
    [
        ([0.4, 359.9, 359.8, 0.3], "start", [0.4, -0.1, -0.2, 0.3]),
        ([-0.03, 359.9, 359.8, 0.3], "start", [-0.03, -0.1, -0.2, 0.3]),
        ([360.4, -360.1, 359.8, -359.7], "start", [360.4, -360.1, 359.8, -359.7]),
        ([0.4, 359.9, 359.8, 0.3], "map", [0.4, 359.9, 359.8, 0.3]),
    ],
    ids=["0 to 360", "about 0", "turns counted", "on a map"],
)
def test_headings_of_0_to_360_degrees_beside_turns_both_ways_are_signed(
    tmp_path: Path, stated_deg: list[float], frame: str, read_deg: list[float]
) -> None:
    campaign = read_campaign(looping(tmp_path / "c", stated_deg, frame=frame))
    np.testing.assert_allclose(np.rad2deg(campaign.runs.number("ref_theta_rad")), read_deg, atol=1e-9)
    said = [note for note in campaign.notes if note.code == "headings_of_one_turn"]
    assert len(said) == (stated_deg != read_deg)


def test_loops_of_one_sense_keep_their_headings(tmp_path: Path) -> None:
    """Counters exchanged turn the wheels the other way, too: a turn to the left stays one."""
    folder = looping(tmp_path / "c", [359.9, 0.0, 359.8])
    rows = (folder / "runs.csv").read_text().splitlines()
    (folder / "runs.csv").write_text("\n".join([rows[0], rows[1], rows[3]]) + "\n")
    headings = np.rad2deg(read_campaign(folder).runs.number("ref_theta_rad"))
    np.testing.assert_allclose(headings, [359.9, 359.8], atol=1e-9)
