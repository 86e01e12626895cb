"""No combination of missing columns, runs or logs ends in anything but a verdict or a refusal in one line."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from calib.campaign.model import Campaign, Logs, RunTable
from calib.campaign.read import read_campaign
from calib.documents import to_json
from calib.errors import BadInputError, CalibError, RefusedError
from calib.gap.decision.diagnosis import VerdictKind
from calib.gap.diagnose import diagnose_in_full
from calib.gap.effects.radii import NAMES
from calib.plant.design import good_design
from calib.plant.make import make_campaign
from tests.blunders import plant
from tests.blunders.blunders import DIFFERENTIAL
from tests.effort import EXPLORES

RUNS = 24


@cache
def driven(kind: int) -> Campaign:
    rng = np.random.default_rng(kind)
    needs = ({"front"}, {"trace"}, {"no_logs"})[kind]
    truth = {"load_radius": float("nan")} if kind == 1 else {}
    return make_campaign(good_design(rng, n_runs=RUNS, needs=needs), truth, rng)


@cache
def loaded() -> Campaign:
    """Return runs of a law of the load, made once; nobody changes them."""
    rng = np.random.default_rng(0)
    return make_campaign(good_design(rng, n_runs=RUNS, needs={"loads"}), {"load_radius": 3e-6}, rng)


def without(campaign: Campaign, numbers: set[str], labels: set[str], logs: set[str]) -> Campaign:
    runs = campaign.runs
    table = RunTable(
        {name: column for name, column in runs.labels.items() if name not in labels or name == "run_id"},
        {name: column for name, column in runs.numbers.items() if name not in numbers},
        runs.excluded,
        runs.line,
    )
    left = {name: column for name, column in campaign.logs.columns.items() if name not in logs}
    return replace(campaign, runs=table, logs=Logs(campaign.logs.offsets, left))


def answered(campaign: Campaign) -> str:
    """Return the verdict, or ``refused``; anything else is an error of the test."""
    try:
        verdict = diagnose_in_full(campaign)
    except CalibError as error:
        assert "\n" not in str(error)
        return "refused"
    # NaN or infinity in the result would fail here
    to_json(verdict.to_dict())
    return verdict.kind.value


@st.composite
def crippled(draw: st.DrawFn) -> Campaign:
    campaign = driven(draw(st.integers(0, 2)))
    count = draw(st.sampled_from((1, 2, 3, 6, 12, RUNS)))
    first = draw(st.integers(0, RUNS - count))
    pick = np.arange(first, first + count)
    campaign = campaign.select(pick)
    numbers = draw(st.sets(st.sampled_from(sorted(campaign.runs.numbers))))
    labels = draw(st.sets(st.sampled_from(["session", "kind", "direction"])))
    logged = sorted(campaign.logs.columns)
    logs = draw(st.sets(st.sampled_from(logged))) if logged else set()
    campaign = without(campaign, numbers, labels, logs)
    kept = dict(campaign.runs.numbers)
    for name in draw(st.sets(st.sampled_from(sorted(kept) or ["none"]), max_size=3)):
        if name in kept:
            kept[name] = np.where(np.arange(count) % 2 == 0, np.nan, kept[name])
    return replace(campaign, runs=replace(campaign.runs, numbers=kept))


@settings(
    max_examples=25 if EXPLORES else 12,
    deadline=None,
    derandomize=True,
    suppress_health_check=list(HealthCheck),
    # shrinking would take minutes; the failing case is printed as drawn
    phases=[Phase.explicit, Phase.generate],
)
@given(crippled())
def test_any_part_of_a_campaign_gets_a_verdict_or_one_line(campaign: Campaign) -> None:
    answered(campaign)


def test_without_any_reference_it_is_refused_and_says_what_to_measure() -> None:
    measured = {"distance_m", "ref_x_m", "ref_y_m", "ref_theta_rad"}
    with pytest.raises(RefusedError, match="distance_m or ref_x_m"):
        diagnose_in_full(without(driven(2), measured, set(), set()), plan=False)


def test_without_counts_it_is_refused() -> None:
    counts = {"counts_left", "counts_right", "counts_front"}
    with pytest.raises(RefusedError, match="encoder counts"):
        diagnose_in_full(without(driven(0), counts, set(), counts), plan=False)


@pytest.mark.parametrize("count", [1, 3])
def test_very_few_runs_name_no_cause_but_a_recalibration(count: int) -> None:
    """The load law is at work, which runs under one load cannot tell from radii that are off."""
    verdict = diagnose_in_full(driven(1).select(np.arange(count)), plan=False)
    if verdict.kind is VerdictKind.EXPLAINED:
        assert {cause.effect for cause in verdict.causes} <= set(NAMES)


def test_one_load_never_names_the_load() -> None:
    """Runs under one load hold nothing that a load effect acts through."""
    campaign = driven(1)
    same = campaign.select(campaign.runs.number("payload_kg") == 0.0)
    assert len(same.runs) >= 3
    verdict = diagnose_in_full(same, plan=False)
    assert "load_radius" not in {cause.effect for cause in verdict.causes}


@pytest.mark.parametrize("radius_error", [0.0, 0.02])
def test_headings_computed_from_the_counts_are_refused(tmp_path: Path, radius_error: float) -> None:
    """By any radii: "no gap" of a vehicle that was never measured is an all-clear too many."""
    recording = plant.differential(np.random.default_rng(1))
    DIFFERENTIAL["reference by the vehicle's own odometry"](recording)
    for run in recording.runs:
        run.end[2] *= 1.0 + radius_error
    campaign = read_campaign(plant.write(recording, tmp_path / "own", along=False))
    with pytest.raises(BadInputError, match=r"on all 18 runs.*computed from the counts"):
        diagnose_in_full(campaign, plan=False)


def test_sizes_of_data_that_cannot_be_are_not_recommended() -> None:
    """Wheel loads written in kilograms make a law ten times too steep: it fits as well, and says nothing of wheels."""
    sound = loaded()
    numbers = {
        name: column / 9.80665 if name.startswith("load_") else column for name, column in sound.runs.numbers.items()
    }
    spoilt = replace(sound, runs=replace(sound.runs, numbers=numbers))
    verdict = diagnose_in_full(spoilt, plan=False)
    assert verdict.causes
    assert verdict.correct_first
    assert not verdict.recommended
    assert "correct this first" in verdict.fix.why[0]


def test_sizes_beside_loads_that_contradict_payloads_in_some_runs_are_not_recommended() -> None:
    """A session's loads in kilograms: vehicle and payload tell which runs, as they agree with all others."""
    sound = loaded()
    sessions = sound.runs.label("session")
    spoilt_rows = sessions == sessions[0]
    assert 0 < spoilt_rows.mean() < 0.5
    numbers = {
        name: np.where(spoilt_rows, column / 9.80665, column) if name.startswith("load_") else column
        for name, column in sound.runs.numbers.items()
    }
    verdict = diagnose_in_full(replace(sound, runs=replace(sound.runs, numbers=numbers)), plan=False)
    assert any("load" in cause.effect for cause in verdict.causes)
    (first,) = verdict.correct_first
    assert f"in {spoilt_rows.sum()} runs" in first and "are they in kg" in first
    assert not verdict.recommended
    assert not diagnose_in_full(sound.select(np.arange(0, RUNS, 2)), plan=False).correct_first
