"""The headline names the channels that moved, each against its own floor, and what they were judged against."""

from __future__ import annotations

import pytest

from calib.gap.data.channels import Channel
from calib.gap.verdict.outcome import ChannelClosure, Closure
from calib.gap.verdict.result import BY_SIMULATOR, Cause, Verdict, VerdictKind
from calib.gap.verdict.sentence import sentence

DISTANCE = ChannelClosure(Channel.DISTANCE, 0.0061, 0.0019, 0.0023, 0.98)
HEADING = ChannelClosure(Channel.HEADING, 0.012, 0.002, 0.002, 0.97)
STILL = ChannelClosure(Channel.LATERAL, 0.0101, 0.0101, 0.01, None)
CAUSE = Cause("track_width", "a wrong track", "", 0.98, 0.93, 20.0, {})


def said(kind: VerdictKind, *channels: ChannelClosure, named: bool = True, against: str = "model") -> str:
    causes = (CAUSE,) if named else ()
    return sentence(Verdict(kind, "", causes, closure=Closure(channels=channels), judged_against=against))


def test_the_channels_that_moved_come_first_furthest_above_their_floor() -> None:
    words = said(VerdictKind.EXPLAINED, DISTANCE, STILL, HEADING)
    lead = "Against the campaign's own model, on runs left out: heading 12 -> 2 mrad (floor 2); "
    assert words.startswith(lead + "distance 6.1 -> 1.9 mm (floor 2.3). The gap is explained by")
    assert "lateral" not in words


def test_where_no_channel_stands_out_alone_the_one_nearest_to_it_is_named() -> None:
    assert "lateral 10.1 -> 10.1 mm (floor 10)" in said(VerdictKind.EXPLAINED, STILL)


@pytest.mark.parametrize("against", [BY_SIMULATOR, "coefficients.json"])
def test_it_says_what_the_gap_was_judged_against(against: str) -> None:
    assert said(VerdictKind.EXPLAINED, DISTANCE, against=against).startswith(f"Against {against}, on runs left out: ")
    assert against in said(VerdictKind.NO_GAP, STILL, named=False, against=against)


def test_an_unknown_gap_has_a_size_but_nothing_after() -> None:
    """Nothing is named, so nothing was fitted that could shrink it."""
    words = said(VerdictKind.UNKNOWN, DISTANCE, named=False)
    assert words.startswith("Against the campaign's own model: distance 6.1 mm (floor 2.3). There is a gap")
    assert "nearest" not in words


def test_what_would_be_named_if_it_did_not_leave_most_is_said_to_come_nearest() -> None:
    """The reader sees where the search ended, and that it is no cause."""
    verdict = Verdict(
        VerdictKind.UNKNOWN,
        "",
        (),
        closure=Closure(channels=(DISTANCE,)),
        probabilities={"unknown": 0.99, "track_width": 0.9, "floor_zone": 0.6, "wear": 0.2},
    )
    assert sentence(verdict).endswith(
        "What comes nearest, a track other than believed (track_width) and a zone of the floor that shortens the way "
        "or turns the vehicle (floor_zone), leaves more than it explains."
    )


@pytest.mark.parametrize(("probability", "doubted"), [(0.44, True), (0.5, False), (0.99, False), (None, False)])
def test_a_gap_that_is_likelier_not_to_be_is_said_to_be_so(probability: float | None, doubted: bool) -> None:
    """It is reported, since looking again costs less than a gap not seen; but not as a matter of course."""
    closure = Closure(channels=(DISTANCE,))
    words = sentence(Verdict(VerdictKind.EXPLAINED, "", (CAUSE,), closure=closure, gap_probability=probability))
    assert ("A gap at all has a probability of 0.44; if there is one: The gap is" in words) is doubted
    assert ("probability" in words) is doubted
