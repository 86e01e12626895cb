"""Runs of unknown load are not taken as unladen where other runs' load is known."""

from __future__ import annotations

import numpy as np
import pytest

from calib.gap.diagnose import diagnose_in_full
from calib.gap.effects.load import LoadCreep
from calib.gap.observations.from_campaign import observations_of, with_known_loads
from tests.gap.observations.paths import Truth, campaign_of

N_RUNS = 12


def runs_of(**numbers: np.ndarray) -> dict:
    # readings of their own: equal ones would be a run recorded twice
    counts = Truth([(40.0, 0.0)]).counts()
    return {"logs": [counts] * N_RUNS, "numbers": {"distance_m": 40.0 + 1e-3 * np.arange(N_RUNS), **numbers}}


HALF = np.where(np.arange(N_RUNS) % 2, np.nan, 20.0 * np.arange(N_RUNS) + 100.0)


@pytest.mark.parametrize(
    ("numbers", "n_omitted"),
    [
        ({"load_left_N": 3.0 * HALF, "load_right_N": 3.0 * HALF}, 6),
        ({"load_left_N": 3.0 * HALF, "load_right_N": 3.0 * HALF, "payload_kg": np.nan_to_num(HALF)}, 0),
        ({"load_left_N": 300.0 + 0.0 * HALF, "load_right_N": 300.0 + 0.0 * HALF}, 0),  # all that is known is the same
        ({"payload_kg": HALF}, 0),  # none stated is none carried
        ({}, 0),  # no load at all: nothing tells that one matters
    ],
)
def test_runs_whose_load_alone_is_unknown_are_omitted(numbers: dict[str, np.ndarray], n_omitted: int) -> None:
    given = campaign_of(**runs_of(**numbers))
    campaign, said = with_known_loads(given)
    assert campaign.runs.excluded.sum() == n_omitted
    assert bool(said) == bool(n_omitted)
    assert not given.runs.excluded.any()


def test_a_diagnosis_says_which_it_omitted() -> None:
    found = diagnose_in_full(campaign_of(**runs_of(load_left_N=3.0 * HALF, load_right_N=3.0 * HALF)), plan=False)
    assert len(found.observations) == N_RUNS // 2
    assert "Omitted are 6 runs without wheel loads or a payload" in found.sentence


LADEN = np.arange(N_RUNS) % 3 > 0


@pytest.mark.parametrize("stated", ["payload", "weighed"])
def test_nothing_creeps_on_an_empty_vehicle(stated: str) -> None:
    """Its time under load need not be stated, in however many runs; a laden run's does."""
    minutes = np.where(LADEN, 5.0 * np.arange(N_RUNS), np.nan)
    own_N = campaign_of(**runs_of()).vehicle.unladen_load_N
    carried = {"payload_kg": 100.0 * LADEN} if stated == "payload" else {}
    if stated == "weighed":
        # a load cell reads one per cent more
        carried = {f"load_{side}_N": 1.01 * own_N + 400.0 * LADEN for side in ("left", "right")}
    found = observations_of(campaign_of(**runs_of(minutes_under_load=minutes, **carried)))
    np.testing.assert_array_equal(found.number("minutes_under_load"), np.where(LADEN, minutes, 0.0))
    assert LoadCreep().forms(found)
    unknown = observations_of(campaign_of(**runs_of(minutes_under_load=np.where(LADEN, np.nan, 5.0), **carried)))
    assert not LoadCreep().forms(unknown)
    assert any("minutes_under_load is missing or absurd in r" in note and "state it" in note for note in unknown.notes)
