"""Which verdict it is, and whether its fix is recommended, on balances written down by hand: no campaign is needed."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import pytest

from calib.gap.verdict.decide import Balance, kind_of, recommended
from calib.gap.verdict.odds import IMITATION, imitation
from calib.gap.verdict.result import Cause, Closure, VerdictKind

#: one effect surely at work, whose fix closes the gap on runs left out
CLEAR = Balance(gap=1.0, unknown=0.05, n_effects=1, fraction=0.98, ci95=(0.95, 1.0))


def cause(probability: float = 0.9) -> Cause:
    return Cause("load_radius", "", "", probability, share=1.0, signal=30.0, parameters={})


def test_one_clear_effect_explains_the_gap() -> None:
    assert kind_of(CLEAR) is VerdictKind.EXPLAINED


def test_without_a_probable_gap_there_is_none_whatever_else_is_named() -> None:
    assert kind_of(replace(CLEAR, gap=0.5)) is VerdictKind.NO_GAP


def test_a_tied_effect_is_ambiguous() -> None:
    assert kind_of(replace(CLEAR, tied=True)) is VerdictKind.AMBIGUOUS


@pytest.mark.parametrize(
    "balance",
    [
        replace(CLEAR, rest=True),
        replace(CLEAR, denied=True),
        replace(CLEAR, fraction=0.8, ci95=(0.6, 0.95)),
        replace(CLEAR, fraction=0.5, ci95=(0.4, 0.6)),
        replace(CLEAR, n_effects=3),
        replace(CLEAR, n_effects=3, tied=True),
    ],
    ids=["a rest", "a cause denied", "closes 0.8", "closes 0.5", "three effects", "three effects, tied"],
)
def test_what_leaves_a_rest_explains_in_part(balance: Balance) -> None:
    """A rest, a closure below nine tenths, or so many causes that they imitate another: none of them explains."""
    assert kind_of(balance) is VerdictKind.PARTLY_EXPLAINED


@pytest.mark.parametrize(
    "balance",
    [
        replace(CLEAR, rest=True, fraction=0.1, ci95=(-0.2, 0.9)),
        replace(CLEAR, rest=True, fraction=None, ci95=None),
        replace(CLEAR, fraction=0.1, ci95=(-0.2, 0.4)),
        Balance(gap=1.0, unknown=0.95, n_effects=0),
        Balance(gap=1.0, unknown=0.1, n_effects=0, denied=True),
    ],
    ids=["rest, no closure", "rest, closure unmeasured", "no closure", "nothing named", "named cause denied"],
)
def test_what_closes_nothing_leaves_the_cause_unknown(balance: Balance) -> None:
    assert kind_of(balance) is VerdictKind.UNKNOWN


def test_an_unsure_unknown_alone_is_no_gap() -> None:
    """Nothing named, and an unknown cause less probable than the threshold: no gap is claimed."""
    assert kind_of(Balance(gap=0.8, unknown=0.8, n_effects=0)) is VerdictKind.NO_GAP


@pytest.mark.parametrize(
    ("kind", "causes", "closure", "expected"),
    [
        (VerdictKind.EXPLAINED, [cause()], Closure(fraction=0.98, ci95=(0.9, 1.0)), True),
        (VerdictKind.AMBIGUOUS, [cause()], Closure(fraction=0.98, ci95=(0.9, 1.0)), False),
        (VerdictKind.PARTLY_EXPLAINED, [cause()], Closure(fraction=0.98, ci95=(0.9, 1.0)), False),
        (VerdictKind.EXPLAINED, [cause(), cause(0.4)], Closure(fraction=0.98, ci95=(0.9, 1.0)), False),
        (VerdictKind.EXPLAINED, [cause()], Closure(fraction=0.6, ci95=(0.5, 0.9)), False),
        (VerdictKind.EXPLAINED, [cause()], Closure(fraction=0.98, ci95=(0.2, 1.0)), False),
        (VerdictKind.EXPLAINED, [cause()], Closure(), False),
    ],
    ids=["clear", "ambiguous", "in part", "a doubtful cause", "closes little", "wide interval", "no closure"],
)
def test_a_fix_is_recommended_where_its_cause_is_known_and_it_holds(
    kind: VerdictKind, causes: list[Cause], closure: Closure, expected: bool
) -> None:
    assert recommended(kind, causes, closure) is expected


def test_nothing_named_imitates_nothing() -> None:
    assert imitation(0, 0) == 0.0


@pytest.mark.parametrize("calibration", [0, 1, 2])
def test_the_more_causes_are_named_the_likelier_is_one_outside_the_library(calibration: int) -> None:
    odds = [imitation(effects, calibration) for effects in range(5)]
    assert all(before <= after for before, after in pairwise(odds))
    assert odds[0] < odds[2]
    assert odds[-1] == IMITATION[1][-1]


def test_one_or_two_causes_are_believed_and_three_are_not() -> None:
    assert imitation(1, 0) < imitation(2, 0) < 0.5 < imitation(3, 0)


def test_a_calibration_parameter_counts_half_a_cause() -> None:
    assert imitation(1, 2) == imitation(2, 0)
