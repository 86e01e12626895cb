"""Campaigns of the contact plant: what they hold, what they hide, and that nothing wrong means no gap."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from calib.campaign import write_campaign
from calib.campaign.model import Campaign
from calib.campaign.read import read_campaign
from calib.errors import BadInputError
from tests.plant.contact.baseline import Baseline, baseline, belief_of, dead_reckoning
from tests.plant.contact.campaign import CONDITIONS, Lengths, make_contact_campaign, order_of_runs
from tests.plant.contact.floor import noise_floor
from tests.plant.contact.variants import VARIANTS, sound_machine

pytest.importorskip("mujoco", reason="mujoco is not installed")

SHORT = Lengths(corridor_m=6.0, side_m=1.0)


@pytest.fixture(scope="module")
def sound() -> Baseline:
    return baseline(sound_machine())


def _campaign(variant: str, sound: Baseline, seed: int = 3, **settings: object) -> Campaign:
    given: dict[str, object] = {"runs": 4, "sessions": 1, "lengths": SHORT, "sound": sound, **settings}
    return make_contact_campaign(variant, np.random.default_rng(seed), **given)  # type: ignore[arg-type]


def _gaps(campaign: Campaign) -> np.ndarray:
    """Reference end pose less dead reckoning by the logged counts, shape (n_runs, 3)."""
    number, per_count, found = campaign.runs.number, 2 * np.pi / campaign.encoder.counts_per_rev_left, []
    for run in range(len(campaign.runs)):
        log = campaign.logs.of(run)
        belief = belief_of(campaign.model, number("load_left_N")[run], number("load_right_N")[run])
        end = np.array([number(name)[run] for name in ("ref_x_m", "ref_y_m", "ref_theta_rad")])
        found.append(end - dead_reckoning(log["counts_left"] * per_count, log["counts_right"] * per_count, belief))
    return np.array(found)


def test_with_nothing_wrong_the_gap_is_that_of_the_instruments(sound: Baseline) -> None:
    """Heading within 4 sigma of reference and counters together, for empty and laden vehicle alike."""
    campaign = _campaign("none", sound, runs=9)
    assert set(np.unique(campaign.runs.label("kind"))) >= {"corridor", "square_ccw", "route_left"}
    heading = _gaps(campaign)[:, 2]
    # reference 0.8 mrad; counters 0.15 mrad; what two lines and a track cannot say of the contacts, 0.3 mrad
    assert np.abs(heading).max() < 4 * np.sqrt(0.8**2 + 0.15**2 + 0.3**2) * 1e-3


@pytest.mark.parametrize(("variant", "sign"), [("unequal_wheels", -1.0), ("other_track", -1.0)])
def test_what_is_wrong_shows_with_the_sign_of_its_cause(variant: str, sign: float, sound: Baseline) -> None:
    """A smaller right wheel turns to the right; a wider track turns less than believed, here to the left."""
    campaign = _campaign(variant, sound, strength=4.0)
    gaps, kind = _gaps(campaign), campaign.runs.label("kind")
    shown = gaps[kind == ("corridor" if variant == "unequal_wheels" else "square_ccw"), 2]
    # at four times the size over 5 sigma of the reference
    assert np.all(sign * shown > 4e-3)


@pytest.fixture(scope="module")
def nothing_wrong(sound: Baseline) -> Campaign:
    return _campaign("none", sound)


def test_a_campaign_reads_back_as_written_and_says_that_it_is_simulated(
    tmp_path: Path, nothing_wrong: Campaign
) -> None:
    campaign = nothing_wrong
    write_campaign(campaign, tmp_path / "c")
    back = read_campaign(tmp_path / "c")
    assert back.simulated
    assert back.model == campaign.model
    np.testing.assert_array_equal(back.runs.number("counts_left"), campaign.runs.number("counts_left"))
    np.testing.assert_array_equal(back.logs.columns["ref_x_m"], campaign.logs.columns["ref_x_m"])
    assert [note for note in back.notes if note.level == "wrong"] == []


def test_no_file_names_the_variant(tmp_path: Path, nothing_wrong: Campaign, sound: Baseline) -> None:
    """Same columns and settings with and without an effect; only numbers differ."""
    write_campaign(nothing_wrong, tmp_path / "none")
    write_campaign(_campaign("slippery_zone", sound), tmp_path / "slippery_zone")
    heads = [(tmp_path / variant / "runs.csv").read_text().splitlines()[0] for variant in ("none", "slippery_zone")]
    assert heads[0] == heads[1]
    settings = [(tmp_path / variant / "campaign.toml").read_text() for variant in ("none", "slippery_zone")]
    assert settings[0] == settings[1]


def test_one_seed_gives_one_campaign_with_any_number_of_processes(sound: Baseline) -> None:
    alone, pool = (_campaign("slope", sound, runs=2, workers=workers) for workers in (1, 2))
    other = _campaign("slope", sound, runs=2, seed=4)
    for name, column in alone.runs.numbers.items():
        np.testing.assert_array_equal(column, pool.runs.numbers[name])
    assert not np.array_equal(alone.runs.number("ref_y_m"), other.runs.number("ref_y_m"))


@pytest.mark.parametrize(("runs", "sessions"), [(32, 2), (48, 2), (60, 3)])
def test_loads_and_sessions_are_crossed(runs: int, sessions: int) -> None:
    """Every session has every load, so that neither can pass for the other; no run is lost."""
    condition, session = order_of_runs(runs, sessions, np.random.default_rng(5))
    assert len(condition) == len(session) == runs
    for number in range(sessions):
        dealt = {CONDITIONS[c][2].mass_kg for c, s in zip(condition, session, strict=True) if s == number}
        assert dealt == {0.0, 100.0, 200.0}


def test_every_variant_states_its_truth_for_json() -> None:
    for name, variant in VARIANTS.items():
        truth = json.loads(json.dumps(variant.truth(0.5), allow_nan=False))
        assert bool(truth["effects"]) == (name != "none")
        assert truth["verdicts"] == ["no_gap"] if name == "none" else "explained" in truth["verdicts"]


def test_every_variant_builds_a_machine_that_differs_from_the_sound_one_or_is_wrong_elsewhere() -> None:
    for name, variant in VARIANTS.items():
        changed = variant.build(sound_machine(), 0.5) != sound_machine()
        assert changed or name == "none" or variant.rigid_model or variant.misplaced_m > 0.0


def test_an_unknown_variant_and_impossible_numbers_are_refused_in_words() -> None:
    rng = np.random.default_rng(1)
    with pytest.raises(BadInputError, match="expected one of none, payload_rolling"):
        make_contact_campaign("flat_tyre", rng)
    with pytest.raises(BadInputError, match="expected a session to have a run"):
        make_contact_campaign("none", rng, runs=1, sessions=2)


def test_the_floor_of_numerical_noise_lies_far_below_the_instruments() -> None:
    """Repeats and a halved step move the end by less than a tenth of the reference's 2 mm and 0.8 mrad."""
    floor = noise_floor(
        sound_machine(), np.random.default_rng(2), repeats=2, length_m=4.5, kinds=("corridor", "square_ccw")
    )
    assert floor.radius_step < 1e-7
    assert floor.radius_repeats < 1e-7
    assert floor.baseline.misfit_m < 1e-7
    for run in floor.runs:
        for triple in (run.repeats_exact, run.halved_step):
            assert np.all(np.abs(triple) < (2e-4, 2e-4, 8e-5))


def test_importing_the_plant_does_not_load_the_engine() -> None:
    code = "import sys, tests.plant.contact.campaign; sys.exit('mujoco' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
