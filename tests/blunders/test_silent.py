"""Data that changes the answer is named: a few of the faults of `tests.blunders.silent`."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.blunders.changes import Fault
from tests.blunders.faults import faults
from tests.blunders.silent import CAMPAIGNS, ask, findings, inputs, outcome, spoiled

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
    "sigma_xy_m = 0.0001": "named",
    "reference_load_N = 450.0": "named",
    "poses turned by a right angle": "named",
}
#: what shows in few runs or few values: by every command, in the campaign of several routes
BY_ALL = (
    "sigma_xy_m = 0.0001",
    "reference_load_N = 450.0",
    "positions in single precision at 5.5e+06 m",
    "x and y exchanged",
)
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


@pytest.mark.parametrize("name", BY_ALL)
def test_every_command_names_it(name: str) -> None:
    """Where the fit's notes do, so does the diagnosis, which repeats them: it is made for the others alone."""
    assert set(outcome(BY_NAME[name], "yard", whole=False).values()) <= {"named", "named as by fit"}


def test_a_diagnosis_repeats_the_findings_of_the_fit(tmp_path: Path) -> None:
    """The table computes no diagnosis where the fit's notes on the data name the fault."""
    folder = spoiled(BY_NAME["distances in decimetres"], "yard", tmp_path)
    of_fit = findings(ask("fit", folder).document)
    assert of_fit
    assert of_fit <= findings(ask("diagnose", folder).document)


def test_parts_hold_each_input_once() -> None:
    whole = inputs()
    assert sorted((c, f.name) for n in (1, 2, 3) for c, f in inputs(f"{n}/3")) == sorted((c, f.name) for c, f in whole)
    assert {f.name for _, f in inputs(only="yard: t_s in *")} == {f.name for _, f in whole if f.name.startswith("t_s")}


def test_a_sound_campaign_is_unchanged() -> None:
    """The comparison finds nothing where nothing was done."""
    for campaign in CAMPAIGNS:
        assert outcome(Fault("nothing"), campaign, ("check", "fit")) == {"check": "unchanged", "fit": "unchanged"}
