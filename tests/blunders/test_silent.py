"""Data that changes the answer is named: a few of the faults of `tests.blunders.silent`."""

from __future__ import annotations

import pytest

from tests.blunders.silent import CAMPAIGNS, Fault, faults, outcome

BY_NAME = {fault.name: fault for fault in faults()}
#: fault -> what the fit makes of it
OF_FIT = {
    "loads weighed_kg": "unchanged",
    "loads in load_l_N": "named",
    "sessions in full width": "named",
    "a row mean": "named",
    "counts of the table +7": "named",
    "counts_per_rev = 4178": "named",
    "t_s in milliseconds in 12 logs": "named",
    "distances in decimetres": "named",
    "distances 1 % longer in one session": "named",
    "counts exchanged in six runs": "named",
    "loads with the tare": "named",
    "sessions of the next run": "named",
    "poses of the next run": "named",
    "poses turned by 0.05 rad": "named",
}
#: fault -> what the diagnosis makes of it
OF_DIAGNOSIS = {"one temperature_C 999": "named", "heading of row 2 off by 1 turn": "named"}


def test_there_are_300_faults_and_more() -> None:
    assert len(BY_NAME) * len(CAMPAIGNS) >= 300


@pytest.mark.parametrize("name", OF_FIT)
def test_fit_names_what_changes_its_answer(name: str) -> None:
    assert outcome(BY_NAME[name], "corridor", ("fit",)) == {"fit": OF_FIT[name]}


@pytest.mark.parametrize("name", OF_DIAGNOSIS)
def test_diagnose_names_what_changes_its_answer(name: str) -> None:
    assert outcome(BY_NAME[name], "yard", ("diagnose",)) == {"diagnose": OF_DIAGNOSIS[name]}


def test_a_sound_campaign_is_unchanged() -> None:
    """The comparison finds nothing where nothing was done."""
    assert outcome(Fault("nothing"), "corridor", ("check", "fit")) == {"check": "unchanged", "fit": "unchanged"}
