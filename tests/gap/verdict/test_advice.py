"""Why a fix is recommended or not is said in one sentence."""

from __future__ import annotations

from dataclasses import replace

import pytest

from calib.gap.verdict.outcome import Closure, Fix, Group
from calib.gap.verdict.result import Cause, Verdict, VerdictKind
from calib.gap.verdict.sentence import advice

CLOSED = Closure(0.09, 0.002, 0.002, 0.99, (0.9, 1.0))


def verdict(kind: str, *causes: tuple[str, float], recommended: bool = False, tied: bool = False) -> Verdict:
    named = tuple(Cause(effect, effect, "", probability, 1.0, 10.0, {}) for effect, probability in causes)
    groups = (Group((*(effect for effect, _ in causes), "wear")),) if tied else ()
    return Verdict(VerdictKind(kind), "", causes=named, groups=groups, fix=Fix(recommended=recommended))


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (verdict("explained", ("load_radius", 0.9), recommended=True), "Recommended: the fix holds"),
        (verdict("ambiguous", ("load_radius", 0.5), recommended=True, tied=True), "either way, apply this"),
        (verdict("ambiguous", ("load_radius", 0.5), tied=True), "other causes would explain"),
        (verdict("partly_explained", ("load_radius", 0.5)), "a rest of the gap is left"),
        (verdict("explained", ("load_radius", 0.9), ("wear", 0.4)), "too little speaks for wear (0.40)"),
        (verdict("explained", ("load_radius", 0.9)), "not shown to hold"),
        (verdict("explained", ("session_step", 0.9)), "calibrate in each"),
        (verdict("explained", ("load_radius", 0.9), ("floor_zone", 0.9)), "at a place of the floor is mended there"),
    ],
)
def test_the_reason_fits_the_verdict(given: Verdict, words: str) -> None:
    assert words in advice(given)
    assert advice(given).startswith("Recommended") == given.recommended


def test_without_a_cause_there_is_nothing_to_recommend() -> None:
    assert advice(verdict("no_gap")) == ""


def test_where_runs_tell_nothing_of_the_cause_alike_corrections_are_no_fix() -> None:
    """Seven effects would do as well: what they do on other routes these runs cannot say, however alike on these."""
    seven = ("track_width", "curve_scrub", "lost_counts", "wear", "side_slip", "braking_skid", "reference_latency")
    given = replace(
        verdict("ambiguous", ("track_width", 0.5)), groups=(Group(seven),), fix=Fix(agreement_m=0.0), closure=CLOSED
    )
    assert "other causes would explain" in advice(given)
    assert "other causes would explain" not in advice(replace(given, groups=(Group(seven[:2]),)))
