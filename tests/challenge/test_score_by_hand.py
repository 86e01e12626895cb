"""The judge and the score, on verdicts written by hand with answers worked out by hand."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from calib.campaign.settings import OdometryModel
from calib.challenge.cases import Recipe, Truth
from calib.challenge.judge import judge
from calib.challenge.score import clopper_pearson, score_of, wilson
from calib.documents import plain
from calib.plant import Cause, Noise

MODEL = OdometryModel(0.1, 0.1, 0.7, 300.0)


def truth(group: str, *effects: str, signal: float = 25.0, near: float = 9.0, **recipe: Any) -> Truth:
    return Truth(
        recipe=Recipe("c0001", 0, group, effects, tuple(signal for _ in effects), **recipe),
        seed=1,
        max_runs=160,
        redraw=0,
        causes=tuple(Cause(effect, 2e-3) for effect in effects),
        typical=tuple(1e-3 for _ in effects),
        signals=tuple(signal for _ in effects),
        beside=tuple(signal for _ in effects),
        rivals=(("curve_scrub", near),) if effects else (),
        noise=Noise(),
        model=MODEL,
        n_runs=60,
    )


def verdict(word: str, *causes: tuple[str, float], **more: Any) -> dict[str, Any]:
    return {
        "verdict": word,
        "causes": [{"effect": effect, "probability": p, "parameters": {}} for effect, p in causes],
        "credible_sets": [[effect] for effect, _ in causes],
        "indistinguishable": [],
        "recommended": False,
        **more,
    }


def test_an_empty_case_is_right_where_nothing_is_named() -> None:
    assert judge(truth("empty"), verdict("no_gap")).right
    alarm = judge(truth("empty"), verdict("explained", ("wear", 0.9), recommended=True))
    assert not alarm.right
    assert alarm.wrong_fix


def test_an_unknown_on_an_empty_case_is_a_false_alarm() -> None:
    assert not judge(truth("empty"), verdict("unknown")).right


def test_one_effect_has_to_be_named_first() -> None:
    assert judge(truth("single", "track_width"), verdict("explained", ("track_width", 0.9))).right
    second = judge(truth("single", "track_width"), verdict("ambiguous", ("curve_scrub", 0.6), ("track_width", 0.4)))
    assert not second.first
    assert second.in_group
    assert second.covered


def test_a_group_with_the_truth_counts_as_group_not_as_first() -> None:
    found = judge(
        truth("single", "track_width"),
        verdict("ambiguous", ("curve_scrub", 0.9), indistinguishable=[["curve_scrub", "track_width"]]),
    )
    assert (found.first, found.in_group, found.wrong_fix) == (False, True, False)


def test_a_pair_needs_both() -> None:
    both = truth("pair", "wear", "track_width")
    assert judge(both, verdict("explained", ("track_width", 1.0), ("wear", 1.0))).right
    half = judge(both, verdict("explained", ("wear", 1.0), recommended=True))
    assert not half.right
    assert not half.wrong_fix  # what is named is true; the other half is missing


def test_an_outside_effect_has_to_be_left_open() -> None:
    outside = truth("outside", "outside:one_speed")
    assert judge(outside, verdict("unknown")).right
    assert judge(outside, verdict("partly_explained", ("speed_radius", 0.7))).right
    forced = judge(outside, verdict("explained", ("speed_radius", 0.95), recommended=True))
    assert not forced.right
    assert forced.wrong_fix
    assert forced.covered is None


def test_a_deleted_effect_may_be_answered_by_one_that_nothing_can_tell_from_it() -> None:
    near = truth("deleted", "track_width", near=1.5, deleted="track_width")
    assert judge(near, verdict("explained", ("curve_scrub", 0.9))).right
    far = truth("deleted", "track_width", near=8.0, deleted="track_width")
    assert not judge(far, verdict("explained", ("curve_scrub", 0.9))).right
    assert judge(far, verdict("unknown")).right


def test_an_alias_is_right_only_as_a_group() -> None:
    alias = truth("alias", "beam_misalignment", aliases=("rangefinder_scale",))
    alone = judge(alias, verdict("explained", ("beam_misalignment", 0.9)))
    assert alone.first
    assert not alone.right
    group = [["rangefinder_scale", "beam_misalignment"]]
    assert judge(alias, verdict("ambiguous", ("rangefinder_scale", 0.5), indistinguishable=group)).right


def test_a_missing_verdict_is_a_miss_and_an_error_too() -> None:
    assert judge(truth("single", "wear"), None).verdict == "missing"
    assert not judge(truth("empty"), {"verdict": "error", "error": "ValueError: x"}).right


def test_intervals_are_held_against_the_size_that_was_true() -> None:
    one = verdict("explained", ("track_width", 0.9))
    one["causes"][0]["parameters"] = {"relative": {"value": 2.1e-3, "ci95": [1.9e-3, 2.3e-3]}}
    assert judge(truth("single", "track_width"), one).intervals == (("track_width.relative", 2e-3, 1.9e-3, 2.3e-3),)


def test_a_fix_that_makes_the_fresh_campaign_worse_is_harmful() -> None:
    tried = {"seconds": 1.0, "achieved": {"before_over_floor": 1.2, "after_over_floor": 1.5, "fraction": -0.3}}
    found = judge(truth("single", "wear"), verdict("explained", ("wear", 0.9), recommended=True, challenge=tried))
    assert found.harmful
    assert found.achieved == -0.3


def test_the_board_counts_by_hand() -> None:
    """Three singles at 10 and 25 (two first, one in its group), two empty (one alarm), one pair missed."""
    cases = [
        judge(truth("single", "track_width", signal=10.0), verdict("explained", ("track_width", 0.9))),
        judge(truth("single", "track_width", signal=25.0), verdict("explained", ("track_width", 0.7))),
        judge(
            truth("single", "track_width", signal=25.0, near=1.0),
            verdict("ambiguous", ("curve_scrub", 0.65), indistinguishable=[["curve_scrub", "track_width"]]),
        ),
        judge(truth("empty"), verdict("no_gap")),
        judge(truth("empty"), verdict("explained", ("wear", 0.95))),
        judge(truth("pair", "wear", "track_width"), verdict("explained", ("wear", 1.0))),
    ]
    found = score_of(cases)
    assert (found.board["first at signal >= 10"].hits, found.board["first at signal >= 10"].total) == (2, 3)
    apart = found.board["first at signal >= 10, where no other effect is nearer than 3 sigma"]
    assert (apart.hits, apart.total) == (2, 2)
    assert found.board["first or its group at signal >= 10"].hits == 3
    assert (found.board["false alarms"].hits, found.board["false alarms"].total) == (1, 2)
    assert found.board["both of a pair"].hits == 0
    assert found.meets("false alarms") is False
    assert found.meets("first or its group at signal >= 10") is True
    assert found.meets("first at signal 5") is None
    assert len(found.misses) == 3
    assert found.confusion["track_width"] == {"track_width": 2, "curve_scrub": 1}
    assert found.confusion["nothing"] == {"no_gap": 1, "wear": 1}
    by_bin = {round(one.low, 1): one for one in found.reliability}
    # 0.9 (true), 0.95 (false), 1.0 (true): two of three in the last bin
    assert (by_bin[0.9].true.hits, by_bin[0.9].true.total) == (2, 3)
    assert (by_bin[0.6].true.hits, by_bin[0.6].true.total) == (0, 1)


def test_intervals_of_shares_are_those_of_the_textbooks() -> None:
    """2 of 124: the exact upper bound is 5.7 % two-sided; Wilson's of 81 of 263 is Newcombe's 0.2553 to 0.3662."""
    # atol: Newcombe (1998), Table I, prints four digits
    assert wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=5e-5)
    assert clopper_pearson(81, 263) == pytest.approx((0.2527, 0.3676), abs=5e-5)
    assert clopper_pearson(0, 10) == pytest.approx((0.0, 1 - 0.025 ** (1 / 10)), abs=1e-12)  # closed form
    assert clopper_pearson(2, 124)[1] == pytest.approx(0.057, abs=5e-4)


def test_the_truth_survives_its_file() -> None:
    made = truth("single", "track_width")
    assert Truth.from_dict(plain(made)) == made
    heavy = replace(made, noise=Noise(tail=float("inf")))
    assert Truth.from_dict(plain(heavy)).noise.tail == float("inf")


def test_the_ceiling_stands_beside_the_hits_of_the_same_cases() -> None:
    """By hand: one hit of two cases whose ceilings are 0.9 and 0.7 behind the gate: 0.5 / 0.8; of one its own, 0.5."""
    own = ((0.6, 0.5), None)
    truths = [
        replace(truth("single", "wear", signal=5.0), ceiling=ceiling, own_ceiling=of_truth)
        for ceiling, of_truth in zip(((1.0, 0.9), (0.8, 0.7)), own, strict=True)
    ]
    answers = [verdict("explained", ("wear", 0.9)), verdict("no_gap")]
    row = score_of([judge(*each) for each in zip(truths, answers, strict=True)]).ceilings["5"]
    over_own = {"own_free": 0.6, "own_gated": 0.5, "hits_over_own_gated": 2.0}
    assert row == pytest.approx({"free": 0.9, "gated": 0.8, "hits_over_gated": 0.625} | over_own)


def test_what_crowded_cases_state_is_held_against_what_is_true() -> None:
    """By hand: 0.9 and 0.5 are stated, the first is true: 0.7 stated on average, 0.5 true."""
    case = judge(truth("crowded", "wear", "track_width"), verdict("explained", ("wear", 0.9), ("load_radius", 0.5)))
    assert score_of([case]).summary["crowded_stated_minus_true"] == pytest.approx(0.2)
