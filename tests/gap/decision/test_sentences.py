"""The sentences: the channels above the noise level, the cause, the advice, and the paper's figures beside them."""

from __future__ import annotations

from dataclasses import replace

import pytest

from calib.gap.decision.decide import tied_with
from calib.gap.decision.diagnosis import BY_SIMULATOR, Cause, Diagnosis, Fix, NoiseSummary, Quantity, VerdictKind
from calib.gap.decision.held_out import ChannelClosure, Closure
from calib.gap.decision.sentences import advice, headline, nothing_to_apply, sentence
from calib.gap.localise import PlaceResult
from calib.gap.localise.locate import GapLocation
from calib.gap.observations import Channel

DISTANCE = ChannelClosure(Channel.DISTANCE, 0.0061, 0.0019, 0.0023, 0.98)
HEADING = ChannelClosure(Channel.HEADING, 0.012, 0.002, 0.002, 0.97)
STILL = ChannelClosure(Channel.LATERAL, 0.0101, 0.0101, 0.01, None)
CAUSE = Cause("track_width", "a wrong track", "", 0.98, 0.93, 20.0, {})
CLOSED = Closure(0.09, 0.002, 0.002, 0.99, (0.9, 1.0))
#: more than runs can confound and still identify a cause
SEVEN = ("track_width", "curve_scrub", "lost_counts", "wear", "side_slip", "braking_skid", "reference_latency")


def words(kind: VerdictKind, *channels: ChannelClosure, named: bool = True, against: str = "model") -> str:
    causes = (CAUSE,) if named else ()
    return sentence(Diagnosis(kind, "", causes, closure=Closure(channels=channels), judged_against=against))


def diagnosis(kind: str, *causes: tuple[str, float], recommended: bool = False, tied: bool = False) -> Diagnosis:
    named = tuple(Cause(effect, effect, "", probability, 1.0, 10.0, {}) for effect, probability in causes)
    groups = ((*(effect for effect, _ in causes), "wear"),) if tied else ()
    return Diagnosis(VerdictKind(kind), "", causes=named, groups=groups, fix=Fix(recommended=recommended))


def test_the_cause_leads_and_the_channels_above_the_noise_level_follow_the_largest_ratio_first() -> None:
    text = words(VerdictKind.EXPLAINED, DISTANCE, STILL, HEADING)
    channels = "Against the campaign's own model, on held-out runs: heading 12 -> 2 mrad (noise level 2); "
    assert text.startswith("The gap is explained by")
    assert text.endswith(channels + "distance 6.1 -> 1.9 mm (noise level 2.3).")
    assert "lateral" not in text


def test_an_explanation_of_a_doubtful_size_says_so() -> None:
    times = replace(CAUSE, plausible=False, remark="1.9 times what is physically plausible: suspect a gear ratio")
    text = sentence(Diagnosis(VerdictKind.EXPLAINED, "", (times,), closure=Closure(channels=(DISTANCE,))))
    assert "explained by a wrong track (track_width), of a doubtful size. " in text
    assert "doubtful" not in words(VerdictKind.EXPLAINED, DISTANCE)


def test_a_recalibration_that_is_not_recommended_is_not_said_to_close_the_gap() -> None:
    alone = Diagnosis(VerdictKind.EXPLAINED, "", (CAUSE,), closure=Closure(channels=(DISTANCE,)))
    assert "A plain recalibration of the track" in sentence(alone)
    assert "recalibration" not in sentence(replace(alone, fix=Fix(why=("it closes 13 to 53 % of the gap",))))


@pytest.mark.parametrize(
    ("kind", "probability", "supported", "words"),
    [
        (VerdictKind.NO_GAP, 0.04, True, ("0.04, below the 0.3", "10.1 mm (noise level 10)", "other loads")),
        (VerdictKind.UNDECIDED, 0.1, False, ("is 0.10 by a noise level that rests on one run", "drive one route")),
        (VerdictKind.UNKNOWN, 0.99, True, ("is 0.99; against", "runs.csv")),
        (VerdictKind.UNKNOWN, 0.4, True, ("is 0.40; against", "drive one route several times")),
    ],
)
def test_where_nothing_is_named_figures_and_runs_say_why_there_is_no_fix(
    kind: VerdictKind, probability: float, supported: bool, words: tuple[str, ...]
) -> None:
    noise = NoiseSummary(supported=supported, support="one run")
    closure = Closure(channels=(STILL,))
    text = nothing_to_apply(Diagnosis(kind, "", closure=closure, noise_level=noise, gap_probability=probability))
    assert all(each in text for each in words), text


def test_where_no_channel_is_above_the_noise_level_the_nearest_to_it_is_named() -> None:
    assert "lateral 10.1 -> 10.1 mm (noise level 10)" in words(VerdictKind.EXPLAINED, STILL)


def test_where_no_channel_is_above_the_noise_level_causes_are_shown_by_the_one_that_they_lower() -> None:
    """An explanation beside a channel that it leaves as it was, or makes worse, contradicts itself."""
    lowered = ChannelClosure(Channel.HEADING, 0.00312, 0.0027, 0.00274, None)
    worse = ChannelClosure(Channel.LATERAL, 0.0161, 0.0165, 0.0141, None)
    assert "heading 3.12 -> 2.7 mrad" in words(VerdictKind.EXPLAINED, lowered, worse)
    assert "lateral 16.1 mm" in words(VerdictKind.UNKNOWN, lowered, worse, named=False)


@pytest.mark.parametrize("against", [BY_SIMULATOR, "coefficients.json"])
def test_the_sentence_names_what_the_gap_is_judged_against(against: str) -> None:
    assert words(VerdictKind.EXPLAINED, DISTANCE, against=against).count(f" Against {against}, on held-out runs: ") == 1
    assert against in words(VerdictKind.NO_GAP, STILL, named=False, against=against)


def test_an_unknown_gap_has_a_size_but_none_after_a_correction() -> None:
    """Nothing is named, so nothing was fitted that could shrink it."""
    text = words(VerdictKind.UNKNOWN, DISTANCE, named=False)
    assert text.startswith("There is a gap, but no effect of the library explains it. Against the campaign's own ")
    assert "model: distance 6.1 mm (noise level 2.3). " in text
    assert "Closest" not in text


def test_probable_effects_that_leave_most_of_the_gap_are_the_closest() -> None:
    """The reader sees where the search ended, and that it is no cause."""
    unknown = Diagnosis(
        VerdictKind.UNKNOWN,
        "",
        closure=Closure(0.09, 0.08, 0.002, 0.2, (0.0, 0.4), channels=(DISTANCE,)),
        probabilities={"unknown": 0.99, "track_width": 0.9, "floor_zone": 0.6, "wear": 0.2},
    )
    closest = sentence(unknown).partition(" Closest: ")[2]
    assert "(track_width) and " in closest and "(floor_zone); more than half of the gap remains." in closest
    # what remains is said as the closure has it
    for ci95, said in (((0.85, 1.0), "closes 85 to 100 % of the gap on held-out runs"), ((0.2, 0.9), "not certain to")):
        text = sentence(replace(unknown, closure=replace(unknown.closure, ci95=ci95)))
        assert said in text and "remains" not in text


@pytest.mark.parametrize(("probability", "doubted"), [(0.44, True), (0.5, False), (0.99, False), (None, False)])
def test_an_improbable_gap_is_stated_with_its_probability(probability: float | None, doubted: bool) -> None:
    """It is reported, since another look costs less than a gap not seen; but not as a matter of course."""
    closure = Closure(channels=(DISTANCE,))
    text = sentence(Diagnosis(VerdictKind.EXPLAINED, "", (CAUSE,), closure=closure, gap_probability=probability))
    assert ("The probability of a gap is 0.44 only; if there is one: the gap is" in text) is doubted
    assert ("probability" in text) is doubted
    unknown = sentence(Diagnosis(VerdictKind.UNKNOWN, "", closure=closure, gap_probability=probability))
    assert ("if there is one no effect" in unknown) is ("More repeats decide it." in unknown) is doubted


@pytest.mark.parametrize("kind", [VerdictKind.AMBIGUOUS, VerdictKind.PARTLY_EXPLAINED])
def test_confounded_effects_are_named_unless_they_are_too_many_to_identify_the_cause(kind: VerdictKind) -> None:
    closure = Closure(channels=(DISTANCE,))
    two, seven = (sentence(Diagnosis(kind, "", (CAUSE,), groups=(g,), closure=closure)) for g in (SEVEN[:2], SEVEN))
    assert "(curve_scrub)" in two and "cannot tell" in two
    assert "(curve_scrub)" not in seven and "7 effects explain it equally well" in seven


def test_what_a_cause_cannot_be_told_from_is_said_of_that_cause() -> None:
    """Of two causes, not of the last one in the list."""
    named = diagnosis("partly_explained", ("unequal_radii", 0.9), ("reference_lever_arm", 0.8)).causes
    groups = (("unequal_radii", "lost_counts"), ("reference_lever_arm", "floor_slope"))
    one, both = (
        sentence(Diagnosis(VerdictKind.PARTLY_EXPLAINED, "", named, groups=groups[:n], closure=CLOSED)) for n in (1, 2)
    )
    assert "; these runs cannot tell unequal_radii from counts lost by one encoder (lost_counts);" in one
    assert "(lost_counts), nor reference_lever_arm from " in both and "(floor_slope);" in both


@pytest.mark.parametrize("kind", [VerdictKind.AMBIGUOUS, VerdictKind.PARTLY_EXPLAINED])
def test_what_one_cause_of_two_is_not_told_from_leaves_the_other_identified(kind: VerdictKind) -> None:
    named = diagnosis("ambiguous", ("track_width", 0.7), ("load_radius", 0.96)).causes
    text = sentence(Diagnosis(kind, "", named, groups=(SEVEN,), closure=CLOSED))
    assert "6 other effects" in text and "identify" not in text
    assert tied_with(named[:1], [SEVEN]) == [SEVEN] and tied_with(named[1:], [SEVEN]) == []
    # what is too small to be named looks like nearly anything, the named ones among it
    assert tied_with(named[:1], [("steering_backlash", *SEVEN)]) == []


@pytest.mark.parametrize(
    ("given", "text"),
    [
        (diagnosis("explained", ("load_radius", 0.9), recommended=True), "Recommended: the fix holds"),
        (diagnosis("ambiguous", ("load_radius", 0.5), recommended=True, tied=True), "apply the fix in either case"),
        (
            replace(diagnosis("explained", ("load_radius", 0.9)), fix=Fix(why=("it closes 20 %", "wear may be it"))),
            "Not recommended: It closes 20 %. Wear may be it.",
        ),
    ],
)
def test_the_advice_gives_the_reasons(given: Diagnosis, text: str) -> None:
    assert text in advice(given)
    assert advice(given).startswith("Recommended") == given.recommended


def test_what_the_fix_changes_of_the_calibration_beyond_chance_is_said_with_its_size() -> None:
    moves = {
        "radius_scale": Quantity(1e-5, (-2e-5, 4e-5), "1"),
        "track_width": Quantity(-0.0028, (-0.0031, -0.0025), "1"),
    }
    known = diagnosis("explained", ("load_dependent_track", 0.96), ("speed_radius", 0.96), recommended=True)
    said = advice(replace(known, fix=replace(known.fix, moves=moves)))
    assert said.endswith(
        " The fix changes the track width by -0.28 % (-0.31 to -0.25 %), too: these runs do not tell that from "
        "another zero point of load_dependent_track."
    )
    assert "The fix changes" not in advice(known)
    slide = diagnosis("explained", ("braking_skid", 0.96), recommended=True)
    moves = {"radius_scale": Quantity(2.1e-3, (1.6e-3, 2.6e-3), "1")}
    # without a stop it is nothing: it has no other zero point
    assert advice(replace(slide, fix=replace(slide.fix, moves=moves))).endswith("(+0.16 to +0.26 %), too.")


@pytest.mark.parametrize(("route", "said"), [("corridor", "(x on the floor, corridor)"), ("", "(x on the floor)")])
def test_a_place_is_said_with_its_route_where_routes_have_names(route: str, said: str) -> None:
    zone = PlaceResult("zone", Channel.ALONG, 0.01, (0.008, 0.012), "m", 1e-4, 12)
    zone = replace(zone, route=route, coordinate="x on the floor", place=(6.0, 8.0))
    where = GapLocation((), (), (), places=(zone,))
    assert f"between 6.0 and 8.0 m {said}" in sentence(Diagnosis(VerdictKind.UNKNOWN, "", where=where))


def test_without_a_cause_there_is_nothing_to_recommend() -> None:
    assert advice(diagnosis("no_gap")) == ""


def _load(effect: str, *, group: tuple[str, ...] = (), before: float | None = 2.2, after: float = 0.1) -> Diagnosis:
    cause = Cause(effect, "", "", probability=0.9, share=1.0, signal=30.0, parameters={})
    return Diagnosis(
        kind=VerdictKind.AMBIGUOUS if group else VerdictKind.EXPLAINED,
        sentence="",
        causes=(cause,),
        groups=(group,) if group else (),
        closure=Closure() if before is None else Closure(before_rms_m=before, after_rms_m=after),
        fix=Fix(recommended=True),
    )


@pytest.mark.parametrize("effect", ["load_radius", "load_radius_nonlinear"])
def test_a_load_effect_has_the_papers_figures_beside_it(effect: str) -> None:
    """1.1 m to 0.06 m are those of the paper's Section 7; 2.2 m to 0.1 m is 22 times."""
    beside = headline(_load(effect))
    assert beside is not None
    assert (beside.paper.before_m, beside.paper.after_m) == (1.1, 0.06)
    # the paper's study at its track gives 1.24753 m and 0.07375 m; the quotient of what it prints, 18, is rounded
    assert beside.paper.ratio == pytest.approx(1.24753 / 0.07375, rel=1e-4)
    assert "about 17 times smaller before rounding" in beside.sentence
    assert beside.campaign.ratio == pytest.approx(22.0, rel=1e-12)  # a quotient of two doubles
    assert beside.sole_candidate
    assert "1.1 m to 0.06 m as printed" in beside.sentence and "2.20 m to 0.1 m" in beside.sentence


def test_the_headline_of_a_confounded_load_effect_is_conditional() -> None:
    beside = headline(_load("load_radius", group=("load_radius", "session_step")))
    assert beside is not None and not beside.sole_candidate
    assert "if the load is the cause" in beside.sentence


def test_the_headline_names_what_is_corrected_beside_the_load() -> None:
    verdict = _load("load_radius")
    beside = headline(replace(verdict, causes=(*verdict.causes, replace(verdict.causes[0], effect="track_width"))))
    assert beside is not None and "22 times smaller, with track_width." in beside.sentence


def test_the_headline_is_part_of_the_plain_values() -> None:
    """What `calib diagnose --json` writes, as the library gives it."""
    stated = _load("load_radius").to_dict()["headline"]
    assert (stated["effect"], stated["paper"]["before_m"]) == ("load_radius", 1.1)
    assert _load("temperature_radius").to_dict()["headline"] is None


def test_other_causes_and_diagnoses_without_closure_have_no_headline() -> None:
    assert headline(_load("temperature_radius")) is None
    assert headline(_load("load_radius", before=None)) is None
    assert headline(replace(_load("load_radius"), causes=())) is None


def test_a_gap_that_vanishes_has_no_ratio() -> None:
    beside = headline(_load("load_radius", after=0.0))
    assert beside is not None and beside.campaign.ratio is None
