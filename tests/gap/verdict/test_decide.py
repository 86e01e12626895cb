"""Which verdict it is, and whether its fix is recommended, on balances written down by hand: no campaign is needed."""

from __future__ import annotations

from dataclasses import replace

import pytest

from calib.gap.verdict.decide import Balance, kind_of, recommended
from calib.gap.verdict.outcome import Closure, Rest
from calib.gap.verdict.rest import faint_beside
from calib.gap.verdict.result import Cause, VerdictKind
from calib.gap.verdict.transfer import Trial

#: one effect surely at work, whose fix closes the gap on runs left out
CLEAR = Balance(gap=1.0, n_named=1, fraction=0.98, ci95=(0.95, 1.0))
CLOSED = Closure(fraction=0.98, ci95=(0.9, 1.0), floor_rms_m=0.004)


def cause(probability: float = 0.9) -> Cause:
    return Cause("load_radius", "", "", probability, share=1.0, signal=30.0, parameters={})


def trial(after: float, growth: float = -5.0, before: float = 500.0) -> Trial:
    """A value left out whose thirty readings would square up to thirty by noise alone, to 70 one time in a hundred."""
    return Trial("kind", "square_cw", 0.05, 0.01, before=before, after=after, floor=30.0, chance=70.0, growth=growth)


def test_one_clear_effect_explains_the_gap() -> None:
    assert kind_of(CLEAR) is VerdictKind.EXPLAINED


def test_without_a_probable_gap_there_is_none_whatever_else_is_named() -> None:
    assert kind_of(replace(CLEAR, gap=0.3)) is VerdictKind.NO_GAP


def test_without_a_floor_nothing_is_decided_however_sure_the_rest() -> None:
    assert kind_of(replace(CLEAR, supported=False)) is VerdictKind.UNDECIDED
    assert kind_of(replace(CLEAR, gap=0.0, supported=False)) is VerdictKind.UNDECIDED


def test_a_tied_effect_is_ambiguous() -> None:
    assert kind_of(replace(CLEAR, tied=True)) is VerdictKind.AMBIGUOUS


def test_several_causes_beside_a_small_rest_explain() -> None:
    """Real robots have several small imperfections at once, and a rest that carries next to nothing."""
    assert kind_of(replace(CLEAR, n_named=5, rest=0.02)) is VerdictKind.EXPLAINED


@pytest.mark.parametrize(
    "balance",
    [
        replace(CLEAR, rest=0.3),
        replace(CLEAR, denied=True),
        replace(CLEAR, carries=False),
        replace(CLEAR, fraction=0.8, ci95=(0.6, 0.88)),
        replace(CLEAR, fraction=0.5, ci95=(0.4, 0.6)),
        replace(CLEAR, rest=0.3, tied=True),
        replace(CLEAR, rest=0.9, sure=True, fraction=0.1, ci95=(-0.2, 0.9)),
    ],
    ids=["a rest", "a cause denied", "not carried over", "closes 0.8", "closes 0.5", "a rest, tied", "a large rest"],
)
def test_what_leaves_a_rest_explains_in_part(balance: Balance) -> None:
    assert kind_of(balance) is VerdictKind.PARTLY_EXPLAINED


@pytest.mark.parametrize(
    "balance",
    [
        replace(CLEAR, rest=0.9, fraction=0.1, ci95=(-0.2, 0.9)),
        replace(CLEAR, rest=0.9, fraction=None, ci95=None),
        replace(CLEAR, fraction=0.1, ci95=(-0.2, 0.4)),
        Balance(gap=1.0, n_named=0, rest=1.0),
        replace(CLEAR, off=0.2),
        replace(CLEAR, gap=0.1, off=0.2),
        # however probable: an effect that is in no library is imitated by those that are
        replace(CLEAR, rest=0.6, sure=True, fraction=0.3, ci95=(0.1, 0.45)),
    ],
    ids=[
        "rest, no closure",
        "rest, closure unmeasured",
        "no closure",
        "nothing named",
        "gross",
        "gross beside a gross floor",
        "surely less than half",
    ],
)
def test_what_closes_nothing_leaves_the_cause_unknown(balance: Balance) -> None:
    assert kind_of(balance) is VerdictKind.UNKNOWN


def test_a_rest_that_the_runs_do_not_show_is_none() -> None:
    """A closure of 0.8 whose interval holds 1 is what a sound fix of a small gap shows on few runs."""
    assert kind_of(replace(CLEAR, fraction=0.8, ci95=(0.5, 1.0))) is VerdictKind.EXPLAINED


def test_a_probable_gap_without_any_cause_is_no_all_clear() -> None:
    """Nothing named, however probable a rest is: that there is a gap is what matters."""
    assert kind_of(Balance(gap=0.8, n_named=0)) is VerdictKind.UNKNOWN
    assert kind_of(Balance(gap=0.2, n_named=0)) is VerdictKind.NO_GAP


@pytest.mark.parametrize(
    ("certain", "closure", "expected"),
    [
        ([0.9], CLOSED, True),
        ([0.9, 0.4], CLOSED, False),
        ([0.8, 0.8, 0.8], CLOSED, False),
        ([0.9], replace(CLOSED, fraction=0.6, ci95=(0.5, 0.9)), False),
        ([0.9], replace(CLOSED, ci95=(0.2, 1.0)), False),
        ([0.9], Closure(), False),
    ],
    ids=["clear", "a doubtful cause", "three likely ones", "closes little", "wide interval", "no closure"],
)
def test_a_fix_is_recommended_where_its_causes_are_sure_and_it_holds(
    certain: list[float], closure: Closure, expected: bool
) -> None:
    assert recommended([cause()] * len(certain), certain, closure) is expected


@pytest.mark.parametrize(
    ("tried", "expected"),
    [
        ([trial(40.0)], True),
        ([trial(40.0), trial(400.0)], False),
        ([trial(40.0), trial(66.0, before=69.0)], True),
        ([trial(40.0), trial(36.0, before=33.0, growth=0.5)], True),
        ([trial(40.0), trial(90.0, before=33.0, growth=4.0)], False),
    ],
    ids=["closes", "leaves most of one kind's gap", "within chance", "no gap there, hardly touched", "makes one"],
)
def test_a_fix_has_to_help_everywhere_it_is_tried(tried: list[Trial], expected: bool) -> None:
    assert recommended([cause()], [0.9], CLOSED, tried) is expected


def test_corrections_of_tied_causes_decide_whether_it_matters_which() -> None:
    """Nearer than the floor: either way, apply it. Further: find out first."""
    assert recommended([cause()], [0.9], CLOSED, (), 0.002)
    assert not recommended([cause()], [0.9], CLOSED, (), 0.020)


@pytest.mark.parametrize(
    ("rest", "expected"),
    [
        (None, True),
        (Rest(share=0.2, signal=4.0), True),
        (Rest(share=0.2, signal=6.0), False),
        (Rest(share=0.01, signal=6.0), True),
    ],
)
def test_beside_a_rest_that_shows_half_as_strongly_a_cause_is_no_fix(rest: Rest | None, expected: bool) -> None:
    """What leaves much behind may itself be an imitation of it; a rest that carries little does not matter."""
    named = replace(cause(), share=0.8, signal=10.0)
    assert recommended([named], [0.9], CLOSED, (), None, rest) is expected


@pytest.mark.parametrize(("nothing_else", "expected"), [(0.9, True), (0.5, False)])
def test_where_something_else_may_be_at_work_what_is_named_is_no_fix(nothing_else: float, expected: bool) -> None:
    """Each cause may be sure while it is not that they are all: what carries over is the whole."""
    assert recommended([cause()], [0.9], CLOSED, (), None, None, nothing_else) is expected


@pytest.mark.parametrize(
    ("share", "signal", "expected"),
    [(0.4, 60.0, 0.5), (0.4, 29.0, 0.9), (0.04, 60.0, 0.9)],
    ids=["fainter than the rest", "stronger than the rest", "a rest that carries next to nothing"],
)
def test_a_cause_fainter_than_a_rest_beside_it_has_even_odds_at_most(
    share: float, signal: float, expected: float
) -> None:
    """What left so much that nothing explains may have left that little, too; the cause shows by 30."""
    assert [each.probability for each in faint_beside(Rest(share, signal), [cause()])] == [expected]


def test_even_odds_raise_no_probability() -> None:
    assert faint_beside(Rest(0.4, 60.0), [cause(0.3)])[0].probability == 0.3


def test_without_a_rest_the_causes_stay_as_they_are() -> None:
    assert faint_beside(None, [cause()]) == [cause()]
