"""A reference in other units or axes is a blunder: the verdict says what to correct and names no effect instead."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from calib.campaign.model import Campaign
from calib.campaign.read import read_campaign
from calib.coefficients.sections import EffectSection, Quantity
from calib.gap.decision.diagnosis import Diagnosis, VerdictKind
from calib.gap.diagnose import diagnose_in_full
from calib.plant.design import good_design
from calib.plant.make import make_campaign
from calib.reporting.topics.diagnosis import after_diagnosis
from calib.types import FloatArray
from tests.kinematics.campaigns import Truth, both_ways, campaign
from tests.kinematics.test_named_blunders import changed, in_map

Columns = dict[str, FloatArray]


def in_degrees(columns: Columns) -> Columns:
    return {"ref_theta_rad": np.degrees(columns["ref_theta_rad"])}


def clockwise(columns: Columns) -> Columns:
    return {"ref_theta_rad": -columns["ref_theta_rad"]}


def in_millimetres(columns: Columns) -> Columns:
    return {"ref_x_m": 1e3 * columns["ref_x_m"], "ref_y_m": 1e3 * columns["ref_y_m"]}


def exchanged(columns: Columns) -> Columns:
    return {"ref_x_m": columns["ref_y_m"], "ref_y_m": columns["ref_x_m"]}


def opposed(columns: Columns) -> Columns:
    return {"ref_x_m": -columns["ref_y_m"], "ref_y_m": -columns["ref_x_m"]}


def mirrored(columns: Columns) -> Columns:
    return {"ref_y_m": -columns["ref_y_m"]}


def struck(project_root: Path, mistake: Callable[[Columns], Columns], every: int = 4) -> Campaign:
    """Some runs of the yard, by a reference that makes a mistake."""
    campaign = read_campaign(project_root / "sample_runs" / "yard")
    campaign = campaign.select(np.arange(0, len(campaign.runs), every))
    numbers = {**campaign.runs.numbers, **mistake(dict(campaign.runs.numbers))}
    return replace(campaign, runs=replace(campaign.runs, numbers=numbers))


@pytest.mark.parametrize(
    ("mistake", "hint"),
    [
        (in_degrees, "are they in degrees?"),
        (clockwise, "is ref_theta_rad positive to the right?"),
        (in_millimetres, "are they in millimetres?"),
    ],
)
def test_a_reference_in_other_units_gets_no_cause(
    mistake: Callable[[Columns], Columns], hint: str, project_root: Path
) -> None:
    """Headings in degrees leave no noise that the rest could be held against."""
    verdict = diagnose_in_full(struck(project_root, mistake, every=7), plan=False)
    assert verdict.kind in {VerdictKind.UNKNOWN, VerdictKind.UNDECIDED}
    assert verdict.causes == ()
    assert verdict.sentence.startswith("Correct this first: ")
    assert hint in verdict.correct_first[0]


@pytest.mark.parametrize(
    ("mistake", "remark"),
    [
        (exchanged, "x and y are exchanged: correct"),
        (opposed, "x and y are exchanged, both with the other sign"),
        (mirrored, "change the sign of ref_y_m, then"),
    ],
)
def test_positions_in_mirrored_axes_are_named_and_the_cause_beside_them_is_found(
    mistake: Callable[[Columns], Columns], remark: str, project_root: Path
) -> None:
    """Headings that are right beside them are what tells the axes from swapped wheels."""
    verdict = diagnose_in_full(struck(project_root, mistake), plan=False)
    # the model is not what has to be corrected first
    assert after_diagnosis(verdict) == "diagnose wrong"
    axes, *causes = verdict.causes
    form = "x and y are exchanged" if "exchanged" in remark else "the axes are mirrored"
    assert (axes.effect, axes.form) == ("reference_yaw", form)
    assert remark in axes.remark
    assert [cause.effect for cause in causes] == ["temperature_radius"]


def test_axes_are_found_beside_a_model_that_has_effects(project_root: Path) -> None:
    """The temperature's effect is in the model then: the axes alone are left."""
    alpha = EffectSection(
        effect="temperature_radius",
        form="",
        settings={"centre": 18.7, "spread": 1.0},
        parameters={"alpha": Quantity(value=6.8e-5, unit="1/K")},
    )
    causes = diagnose_in_full(struck(project_root, exchanged), plan=False, applied=(alpha,)).causes
    assert [cause.effect for cause in causes] == ["reference_yaw"]


def exchanged_wheels(columns: Columns) -> Columns:
    return {f"counts_{side}": columns[f"counts_{other}"] for side, other in (("left", "right"), ("right", "left"))}


def test_a_mirrored_reference_is_told_from_swapped_wheels_by_radii_and_loads_that_differ(project_root: Path) -> None:
    """Of a vehicle that is the same on both sides the two are one to any data: the advice names both."""
    both = struck(project_root, lambda columns: {**mirrored(columns), **clockwise(columns)}, every=8)
    (axes,) = diagnose_in_full(both, plan=False).causes
    assert (axes.effect, axes.form) == ("reference_yaw", "y and headings are mirrored")
    assert "signs of ref_y_m and ref_theta_rad" in axes.remark
    swapped = struck(project_root, exchanged_wheels, every=8)
    swapped = replace(
        swapped,
        logs=replace(swapped.logs, columns={**swapped.logs.columns, **exchanged_wheels(dict(swapped.logs.columns))}),
    )
    (wheels,) = diagnose_in_full(swapped, plan=False).causes
    assert (wheels.effect, wheels.form) == ("encoder_gross", "swapped wheels")
    assert "y to the left" in wheels.remark


def test_missing_loads_are_not_to_be_corrected_before_what_takes_runs_so_far_off(project_root: Path) -> None:
    """No load makes runs end off by a share of their length that wheels cannot: here each has another run's end."""
    poses = ("ref_x_m", "ref_y_m", "ref_theta_rad")
    yard = struck(project_root, lambda columns: {name: np.roll(columns[name], 3) for name in poses}, every=10)
    none = np.full(len(yard.runs), np.nan)
    numbers = yard.runs.numbers | dict.fromkeys(("payload_kg", "load_left_N", "load_right_N"), none)
    verdict = diagnose_in_full(replace(yard, runs=replace(yard.runs, numbers=numbers)), plan=False)
    assert "of their length" in verdict.sentence and any("no wheel load" in note for note in verdict.notes)
    assert "no wheel load" not in verdict.sentence


@cache
def sound(seed: int, n_runs: int = 20) -> Campaign:
    """Return a campaign without a gap, made once; nobody changes it."""
    rng = np.random.default_rng(seed)
    return make_campaign(good_design(rng, n_runs=n_runs), {}, rng)


@cache
def verdict_on(seed: int, n_runs: int = 20) -> Diagnosis:
    """Return the diagnosis of a campaign without a gap, made once; nobody changes it."""
    return diagnose_in_full(sound(seed, n_runs), plan=False)


def with_numbers(campaign: Campaign, **numbers: FloatArray) -> Campaign:
    return replace(campaign, runs=replace(campaign.runs, numbers={**campaign.runs.numbers, **numbers}))


#: a last digit written otherwise: micrometres and microradians
LAST_DIGIT = 1e-6


@pytest.mark.parametrize("digit", [0.0, LAST_DIGIT])
def test_runs_recorded_twice_are_one_measurement(digit: float) -> None:
    """Under other names, a last digit written otherwise: the diagnosis is that of the runs once, noise included."""
    once = sound(0)
    n_runs = len(once.runs)
    both = once.select(np.tile(np.arange(n_runs), 2))
    numbers = {name: both.runs.numbers[name].copy() for name in ("ref_x_m", "ref_y_m", "ref_theta_rad")}
    for column in numbers.values():
        column[n_runs:] += digit
    names = np.array([*once.runs.run_id, *(f"again_{name}" for name in once.runs.run_id)])
    twice = with_numbers(both, **numbers)
    twice = replace(twice, runs=replace(twice.runs, labels={**twice.runs.labels, "run_id": names}))
    single, verdict = verdict_on(0), diagnose_in_full(twice, plan=False)
    assert single.kind is VerdictKind.NO_GAP
    assert verdict.probabilities == single.probabilities
    assert verdict.noise_level == single.noise_level
    assert "count once: again_r000, again_r001" in verdict.notes[0]


def test_runs_driven_alike_are_no_copies() -> None:
    """The same counts, as of a plan that is followed exactly, and readings of their own: repeats."""
    once = sound(0, 12)
    both = once.select(np.repeat(np.arange(len(once.runs)), 2))
    # half of the stated uncertainty to either side
    apart = 0.5 * once.reference.sigma_xy_m * np.tile([-1.0, 1.0], len(once.runs))
    names = np.array([f"r{row:03d}" for row in range(len(both.runs))])
    repeats = with_numbers(both, ref_x_m=both.runs.numbers["ref_x_m"] + apart)
    repeats = replace(repeats, runs=replace(repeats.runs, labels={**repeats.runs.labels, "run_id": names}))
    assert not any("count once" in note for note in diagnose_in_full(repeats, plan=False).notes)


def test_no_gap_beside_a_run_that_no_noise_takes_so_far_is_no_all_clear() -> None:
    """One end pose of 32 is mistyped by 0.1 m: the others show no gap, and that run is to be corrected first."""
    right = sound(1, 32)
    x_m = right.runs.numbers["ref_x_m"].copy()
    x_m[7] += 0.1
    verdict = diagnose_in_full(with_numbers(right, ref_x_m=x_m), plan=False)
    assert verdict.kind is VerdictKind.NO_GAP
    assert verdict.correct_first[0].startswith("r007 alone")
    assert after_diagnosis(verdict) == "diagnose wrong"
    clear = verdict_on(1, 32)
    assert (clear.kind, clear.correct_first) == (VerdictKind.NO_GAP, ())


def test_headings_of_the_other_sense_are_told_from_counters_that_run_backwards() -> None:
    """Closed squares end alike with either; the course along the way does not."""
    made = campaign(both_ways(4), Truth(), np.random.default_rng(1), along=True, samples=80)
    found = diagnose_in_full(changed(made, lambda log: log | clockwise(log)), plan=False)
    assert [text.partition(":")[0] for text in found.correct_first] == ["headings are clockwise"]


@pytest.mark.parametrize("longer", [1.0, 1.02])
def test_no_fix_is_recommended_beside_an_axis_that_is_too_long(longer: float) -> None:
    """No effect of the library says it: radii and track would take half of it each."""
    made = in_map(8, lambda log: log | {"ref_x_m": longer * log["ref_x_m"]}, samples=400)
    found = diagnose_in_full(made, plan=False)
    assert found.recommended is (longer == 1.0)
    named = ["ref_x_m: distances along this axis" in text for text in (*found.fix.why[:1], *found.correct_first)]
    assert named == [True, True] * (longer > 1.0)
    assert found.sentence.startswith("Correct this first: ref_x_m") is (longer > 1.0)
