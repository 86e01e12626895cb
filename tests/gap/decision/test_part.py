"""A doubtful cause keeps itself out of a fix, not the sure ones; what is written is what was judged."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest

from calib.campaign.model import Campaign
from calib.campaign.read import read_campaign
from calib.gap.apply import applied_model
from calib.gap.decision import decide, part
from calib.gap.decision.causes import Finding, negligible
from calib.gap.decision.constancy import SizeDifference
from calib.gap.decision.diagnosis import Cause, Diagnosis, Fix, Quantity, Unexplained, VerdictKind
from calib.gap.decision.fix import needed
from calib.gap.decision.held_out import Improvement
from calib.gap.decision.part import _parted, is_named_beside, sure_part
from calib.gap.diagnose import diagnose_in_full
from calib.gap.inference import EVEN_PROBABILITY
from tests.gap import workshop
from tests.real import recordings
from tests.real.manipulations import POSES
from tests.real.plants import calibrated

#: ramps are a tenth of a corridor at most
RAMPS = 0.1
LEFT = Unexplained(share=0.2, signal=20.0, where=())


@pytest.fixture(scope="module")
def recording(shared_data: Path) -> tuple[Campaign, dict[str, Any]]:
    """A real recording judged against radii and track fitted to it, and its verdict; nobody changes either."""
    return calibrated(recordings.optiodom_differential(shared_data))[:2]


@pytest.fixture(scope="module")
def armed(tmp_path_factory: pytest.TempPathFactory) -> Diagnosis:
    """Of runs whose sensor stands 5 cm from where it is said to be; nobody changes it."""
    folder = tmp_path_factory.mktemp("armed") / "c"
    made = workshop.write(folder, "mixed", {"reference_lever_arm": 5e-2}, np.random.default_rng(6))
    return diagnose_in_full(read_campaign(made), plan=False)


def cause(name: str, low: float = 1.0, signal: float = 60.0, share: float = 0.5) -> Cause:
    return Cause(name, "", "", 0.9, share=share, signal=signal, parameters={"slope": Quantity(1.5, (low, 2.0), "")})


@pytest.mark.parametrize(
    ("weak", "certain", "words"),
    [
        (cause("wear", low=-1.0), 0.9, "the interval of wear holds zero"),
        (cause("wear", signal=30.0), 0.9, "a signal of 30 beside an unexplained residual of 20"),
        (cause("wear"), 0.4, "wear is at work with a probability of 0.40"),
    ],
)
def test_what_is_not_sure_is_dropped_with_its_reason(weak: Cause, certain: float, words: str) -> None:
    kept, dropped, by_odds = _parted(
        Finding([cause("load_radius"), weak], {"load_radius": 0.95, "wear": certain}, LEFT)
    )
    assert by_odds is (certain < EVEN_PROBABILITY)
    assert [one.effect for one in kept] == ["load_radius"]
    assert words in dropped["wear"]


def test_the_least_probable_causes_are_dropped_until_the_rest_is_probable_enough() -> None:
    """0.95 x 0.9 x 0.6 is 0.51, less than a fix needs; 0.95 x 0.9 alone is 0.86."""
    certain = {"a": 0.95, "b": 0.6, "c": 0.9}
    kept, dropped, by_odds = _parted(Finding([cause(name) for name in certain], certain))
    assert [one.effect for one in kept] == ["a", "c"] and set(dropped) == {"b"} and by_odds
    assert _parted(Finding([cause("a"), cause("c")], certain))[1:] == ({}, False)


def test_a_cause_weaker_than_one_whose_size_differs_may_be_a_part_of_that() -> None:
    """What differs between groups of runs acts as another effect, and that leaves traces elsewhere."""
    differing = {"floor_zone": SizeDifference("floor_zone", "session", "a", "b", 0.1, 0.2, 1e-4)}
    zone = cause("floor_zone", signal=27.0)
    kept, dropped, _ = _parted(
        Finding([zone, cause("wear", signal=9.0)], {"floor_zone": 0.95, "wear": 0.95}, None, differing)
    )
    assert kept == [] and "wear has a signal of 9 beside floor_zone with 27" in dropped["wear"]
    # nor is it stated beyond even odds, but for radii that are nearly certain
    causes = [zone, cause("wear", signal=9.0), cause("track_width", signal=9.0)]
    pairs = Finding(causes, {"wear": 0.95, "track_width": 0.95}, None, differing).parts()
    assert [(part.effect, whole.effect) for part, whole in pairs] == [("wear", "floor_zone")]
    kept, _, _ = _parted(
        Finding([zone, cause("wear", signal=34.0)], {"floor_zone": 0.95, "wear": 0.95}, None, differing)
    )
    assert [one.effect for one in kept] == ["wear"]


def test_a_step_of_each_session_keeps_itself_out_and_no_other_cause() -> None:
    """It says nothing of the next session; a zone of the floor, which looks like nearly anything, keeps others back."""
    certain = {"load_radius": 0.95, "session_step": 0.95, "floor_zone": 0.95}
    kept, dropped, by_odds = _parted(Finding([cause("load_radius"), cause("session_step")], certain))
    assert [one.effect for one in kept] == ["load_radius"] and not by_odds
    assert "calibrate in each" in dropped["session_step"]
    assert _parted(Finding([cause("load_radius"), cause("floor_zone")], certain))[1] == {}


def test_beside_the_fix_of_a_part_only_a_nearly_certain_cause_stays_named() -> None:
    fix = Fix(recommended=True, corrects=("a",))
    named = [
        one.effect
        for one in map(cause, "abc")
        if is_named_beside(one, fix, Finding((), {"a": 0.7, "b": 0.95, "c": 0.7}))
    ]
    assert named == ["a", "b"]


def test_what_odds_alone_leave_out_was_needed_where_the_rest_of_the_gap_certainly_stays() -> None:
    """The interval of what the probable causes close ends below the whole gap: one that was dropped is at work."""
    (why,) = needed(Improvement(1.08, 1.05, (0.004, 0.067), (0.05, 0.81)))
    assert "close 5 to 81 % of the gap" in why
    assert list(needed(Improvement(1.07, 1.01, (0.009, 0.116), (0.12, 1.53)))) == []


def test_the_verdict_is_of_what_the_delivered_fix_leaves(project_root: Path) -> None:
    """A fit with more parameters may leave less than the fix that is written."""
    diagnosis = diagnose_in_full(read_campaign(project_root / "sample_runs" / "yard"), plan=False)
    assert diagnosis.kind is VerdictKind.EXPLAINED and diagnosis.evidence is not None
    line = diagnosis.closure.channels[0]
    closures = (replace(diagnosis.closure, channels=(replace(line, after_rms=k * line.floor_rms),)) for k in (1.9, 2.6))
    kinds = []
    for closure in closures:
        with patch.object(decide, "as_delivered", lambda _, __, fix, own=closure: replace(fix, closure=own)):
            kinds.append(decide.decide(diagnosis.evidence).kind)
    assert kinds == [VerdictKind.EXPLAINED, VerdictKind.PARTLY_EXPLAINED]


def test_swapped_counters_alone_are_corrected(project_root: Path) -> None:
    """A blunder without a further cause has a fix, too, and nothing that speaks against it."""
    campaign = read_campaign(project_root / "sample_runs" / "yard")
    swap = {"counts_left": "counts_right", "counts_right": "counts_left"}
    numbers = {name: campaign.runs.numbers[swap.get(name, name)] for name in campaign.runs.numbers}
    columns = {name: campaign.logs.columns[swap.get(name, name)] for name in campaign.logs.columns}
    struck = replace(
        campaign,
        runs=replace(campaign.runs, numbers=numbers),
        logs=replace(campaign.logs, columns=columns),
    )
    diagnosis = diagnose_in_full(struck, plan=False)
    assert diagnosis.causes[0].effect == "encoder_gross"
    assert diagnosis.recommended and diagnosis.fix.why == ()


def test_a_real_recording_gets_the_fix_of_its_sure_cause_alone(recording: tuple[Campaign, dict[str, Any]]) -> None:
    """Swapped counters on a recording that scrubs by itself: the swap is corrected, the scrub left with its reason."""
    base, _ = recording
    (swapped,) = [one for one in POSES if one.name == "counters swapped"]
    campaign = swapped.change(base)
    diagnosis = diagnose_in_full(campaign, plan=False)
    assert diagnosis.causes[0].effect == "encoder_gross"
    # the swap is no section of the model: it is a cause before all others, in every fix
    assert diagnosis.recommended and diagnosis.fix.corrects == ()
    assert [words.partition(" ")[0] for words in diagnosis.fix.leaves] == [one.effect for one in diagnosis.causes[1:]]
    assert [section.effect for section in applied_model(diagnosis, campaign).effects] == ["encoder_gross"]


def test_a_real_recording_is_no_worse_with_its_law_and_track_than_it_was_by_itself(
    recording: tuple[Campaign, dict[str, Any]],
) -> None:
    """Loaded wheels 1.5 % smaller: the fix's load law is not found again, and nothing but the own rest is left."""
    base, own = recording
    (payload,) = [one for one in POSES if one.name == "payload, loaded wheels smaller"]
    campaign = payload.change(base)
    diagnosis = diagnose_in_full(campaign, plan=False)
    assert diagnosis.recommended and {one.effect for one in diagnosis.causes} == {"load_radius", "curve_scrub"}
    written = applied_model(diagnosis, campaign)
    model = replace(
        campaign.model,
        radius_left_m=written.law.left.radius_ref_m,
        radius_right_m=written.law.right.radius_ref_m,
        slope_left_m_per_N=written.law.left.slope_m_per_N,
        slope_right_m_per_N=written.law.right.slope_m_per_N,
        track_m=written.geometry.track_m,
        reference_load_N=written.law.left.reference_load_N,
    )
    again = diagnose_in_full(replace(campaign, model=model), plan=False)
    assert "load_radius" not in {one.effect for one in again.causes}
    assert again.closure.before_rms_m is not None
    # less is left than the recording has of its own, whose scrub the recalibration takes in part
    assert again.closure.before_rms_m < own["closure"]["before_rms_m"]


def test_a_radius_that_follows_the_speed_is_no_error_of_lost_counts(tmp_path: Path) -> None:
    """Counts that the other wheel loses too would explain it: that acts the other way, so it is a second cause."""
    sizes = {"lost_counts": 2e-3, "speed_radius": -3e-3}
    campaign = read_campaign(workshop.write(tmp_path / "c", "corridor", sizes, np.random.default_rng(5)))
    diagnosis = diagnose_in_full(campaign, plan=False)
    assert {one.effect for one in diagnosis.causes} == set(sizes) and diagnosis.recommended
    (by_speed,) = (one.parameters["per_mps"] for one in diagnosis.causes if one.effect == "speed_radius")
    # the world's radius follows the speed of the run, the effect's that of each step
    assert by_speed.value == pytest.approx(sizes["speed_radius"], rel=RAMPS)


def test_a_step_of_each_session_stays_named_beside_the_fix_of_another_cause() -> None:
    """It is excluded for what it is: unnamed, the closure that it makes would be ascribed to the others."""
    fix = Fix(recommended=True, corrects=("unequal_radii",))
    assert is_named_beside(cause("session_step"), fix, Finding((), {"session_step": 0.7}))


def test_a_fix_that_only_the_recalibration_keeps_back_is_judged_as_it_is_delivered(armed: Diagnosis) -> None:
    """Radii and track are no part of a fix that names neither: what they do to a route held out is no reason."""
    (arm,) = armed.causes
    kept_back = replace(armed.fix, recommended=False, corrects=None, why=("a route held out gets worse",))
    assert armed.evidence is not None
    fix = sure_part(armed.evidence, Finding([arm], {arm.effect: arm.probability}), kept_back)
    assert fix.recommended and fix.corrects == (arm.effect,) and fix.why == () and fix.leaves == ()


def test_the_closure_is_that_of_the_correction_as_delivered(armed: Diagnosis) -> None:
    """Not that of the fit with another recalibration beside it: what held-out runs leave by the one, and noise."""
    evidence, fitted = armed.evidence, armed.fix.fitted
    assert evidence is not None and fitted is not None and armed.fix.held_out is not None
    left = armed.closure.channels
    assert any(
        one.after_rms != other.after_rms for one, other in zip(left, evidence.held_out.closure.channels, strict=True)
    )
    # both say what held-out runs leave, over noise: channel by channel, and whitened
    ratio = np.sqrt(np.mean([(line.after_rms / line.floor_rms) ** 2 for line in left]))
    assert ratio == pytest.approx(armed.fix.held_out.after_rms, rel=0.2)


@pytest.mark.parametrize(("probability", "recommended"), [(0.38, True), (0.7, False)])
def test_a_track_that_is_rather_not_off_holds_no_others_back(
    armed: Diagnosis, probability: float, recommended: bool
) -> None:
    """A third cause of 0.38 and 5 % kept two of 0.96 back; what is rather off than not cannot be taken off a fit."""
    (arm,) = armed.causes
    track = replace(cause("track_width", signal=8.0, share=0.05), probability=probability)
    found = Finding([arm, track], {arm.effect: 0.96, "track_width": probability})
    whole = replace(armed.fix, recommended=False, corrects=None, why=("not all are probable",))
    assert armed.evidence is not None
    fix = sure_part(armed.evidence, found, whole)
    assert fix.recommended is recommended
    assert not recommended or (fix.corrects == (arm.effect,) and "0.38" in fix.leaves[0])


@pytest.mark.parametrize("off", [0.0, 5e-3], ids=["at zero", "off"])
def test_radii_and_track_that_move_by_nothing_beyond_noise_keep_no_fix_back(
    armed: Diagnosis, monkeypatch: pytest.MonkeyPatch, off: float
) -> None:
    """A part of the gap that is left without them is theirs only where they are not zero."""
    evidence = armed.evidence
    assert evidence is not None and armed.recommended
    fitted = replace(evidence.fitted, calibration=evidence.fitted.calibration + off * np.array([1.0, 1.0, 0.0, 0.0]))
    evidence = replace(evidence, search=replace(evidence.search, fitted=fitted))
    monkeypatch.setattr(part.rule, "remaining", lambda *_: iter(["a part is left"]))
    (arm,) = armed.causes
    whole = Fix(recommended=True)
    assert part.as_delivered(evidence, Finding([arm], {arm.effect: 1.0}), whole).recommended is (off == 0.0)


def test_a_part_that_puts_a_channel_off_is_not_recommended(armed: Diagnosis, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor is what is delivered without the rest of a fit: each is judged channel by channel."""
    (arm,) = armed.causes
    evidence = armed.evidence
    assert evidence is not None
    whole = replace(armed.fix, recommended=False, corrects=None, why=("not all are sure",))
    found = Finding([arm], {arm.effect: arm.probability})
    judged = []

    def opens(usable: Any, noise: Any, before: Any, after: Any) -> Any:
        judged.append(np.square(before).sum() > np.square(after).sum())
        return iter(["held out, steering gets worse"])

    monkeypatch.setattr(part.rule, "opened", opens)
    assert not sure_part(evidence, found, whole).recommended
    delivered = part.as_delivered(evidence, found, Fix(recommended=True))
    assert not delivered.recommended and "steering gets worse" in delivered.why[0]
    assert judged == [True, True]


@pytest.mark.parametrize("share", [0.2, 0.6])
def test_a_size_that_is_most_of_all_another_cause_s_is_not_written(
    armed: Diagnosis, monkeypatch: pytest.MonkeyPatch, share: float
) -> None:
    """An arm of 0.2 of its size beside what is not named: 80 % of what is written would be theirs; 40 % may be."""
    evidence = armed.evidence
    assert evidence is not None
    off = evidence.fitted.calibration + 5e-3 * np.array([1.0, 1.0, 0.0, 0.0])
    fitted = replace(evidence.fitted, calibration=off, theta=tuple(share * part for part in evidence.fitted.theta))
    evidence = replace(evidence, search=replace(evidence.search, fitted=fitted))
    monkeypatch.setattr(part.rule, "remaining", lambda *_: iter(()))
    (arm,) = armed.causes
    fix = part.as_delivered(evidence, Finding([arm], {arm.effect: 1.0}), Fix(recommended=True))
    assert fix.recommended is (share == 0.6)
    assert fix.recommended or "80 % of what it does by reference_lever_arm" in fix.why[0]


def test_a_weak_cause_beside_a_large_one_is_an_error_of_its_form() -> None:
    """Beside a law of 400 sigma a cause of 6 is too small, of 30 it is not; radii and track have no form that errs."""
    certain = {"load_radius": 0.96, "radius_scale": 0.96, "payload_position": 0.96}
    for largest, signal, small in (
        ("load_radius", 6.0, True),
        ("load_radius", 30.0, False),
        ("radius_scale", 6.0, False),
    ):
        causes = [cause(largest, signal=400.0), cause("payload_position", signal=signal, share=1e-3)]
        assert (negligible(causes, certain) == ("payload_position",)) is small
    # what radii or track may be instead has most of the gap, and little of it beside them
    most = cause("curve_scrub", signal=6.0, share=0.9)
    assert negligible([cause("load_radius", signal=400.0, share=0.1), most], {}) == ()


def test_a_fix_that_leads_one_session_further_off_is_none_though_the_others_gain() -> None:
    """A mean over sessions takes most from the one that is far off, and spoils those that were right."""
    session = np.repeat(["day1", "day2", "day3"], 4)
    before = np.repeat([[0.1], [15.0], [0.1]], 4, axis=0)
    evidence = SimpleNamespace(
        observations=SimpleNamespace(labels={"session": session}, usable=np.ones((12, 1), bool)),
        noise=SimpleNamespace(dof=9.0),
    )
    left_out = SimpleNamespace(squares=np.square)
    assert np.square(before - 5.0).sum() < np.square(before).sum()
    worse = part._worse_sessions(evidence, left_out, before, before - 5.0)  # type: ignore[arg-type]
    assert [text.split()[4] for text in worse] == ["day3", "day1"]
    assert not part._worse_sessions(evidence, left_out, before, before - 0.2)  # type: ignore[arg-type]


@pytest.mark.parametrize("stepping", [False, True])
def test_radii_that_a_fix_moves_beside_named_steps_have_intervals_that_hold_these(
    stepping: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Three sessions that scatter by 0.15 % tell the mean radius to 0.4 %, however well each knows its own."""
    steps = {"left_b": -3.0e-3, "right_b": -2.4e-3, "left_c": -1.4e-3, "right_c": 1.3e-3}
    sizes = {name: Quantity(value, (value, value), "1") for name, value in steps.items()}
    causes = [Cause("travel_direction", "", "", 0.96, 0.5, 30.0, {})]
    causes += [Cause("session_step", "", "", 0.96, 0.5, 30.0, sizes)] * stepping
    fitted = SimpleNamespace(calibration=np.array([3e-4, 1e-4, 0.0]), covariance=1e-10 * np.eye(3))
    evidence = SimpleNamespace(
        fitted=SimpleNamespace(at_end=lambda: fitted), noise=SimpleNamespace(dof=30.0), observations=None
    )
    monkeypatch.setattr(part, "session_steps", lambda _: [("b", None), ("c", None)])
    low, high = part.moved(evidence, Fix(), causes)["radius_scale"].ci95  # type: ignore[arg-type]
    # Student's t of two degrees of freedom, 4.303, times the scatter of the sessions' means over root 3; without steps
    # that of thirty, 2.042, times the standard uncertainty of the mean of two radii
    half = 4.303 * float(np.std([0.0, -2.7e-3, -5e-5], ddof=1)) / np.sqrt(3.0)
    assert 0.5 * (high - low) == pytest.approx(half if stepping else 2.042e-5 / np.sqrt(2.0), rel=1e-3)
    assert (low < 0.0) is stepping
