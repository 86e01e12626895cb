"""A diagnosis by hand is JSON with the fields of the contract."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from calib.gap.decision import Trial
from calib.gap.decision.diagnosis import BY_MODEL, Cause, Diagnosis, Fix, Quantity, Unexplained, VerdictKind
from calib.gap.decision.held_out import ChannelClosure, Closure, Improvement
from calib.gap.decision.kind import with_left
from calib.gap.observations import Channel
from calib.gap.plan import DetectionLimit
from calib.gap.plan.planned_runs import PlannedRun

FULL = Diagnosis(
    kind=VerdictKind.PARTLY_EXPLAINED,
    sentence="The gap is partly explained.",
    causes=(
        Cause(
            "track_width",
            "a wrong track",
            "",
            0.98,
            0.93,
            float("inf"),
            {"relative": Quantity(3e-3, (2.9e-3, float("nan")), "1")},
            share_ci95=(0.9, 0.95),
            family="calibration",
            forms_open=("curve_scrub",),
        ),
    ),
    credible_sets=(("track_width",),),
    groups=(("track_width", "curve_scrub"),),
    undetectable=(
        DetectionLimit("wear", "indistinguishable from a radius or track error", never=True),
        DetectionLimit("side_slip", "0.06 s2/m (slip per acceleration)"),
    ),
    closure=Closure(
        0.061,
        0.004,
        0.004,
        0.99,
        (0.97, 1.0),
        "session",
        (ChannelClosure(Channel.HEADING, 0.02, 0.004, 0.003, 0.9), ChannelClosure(Channel.LATERAL, 0.01, 0.01, 0.01)),
    ),
    unexplained=Unexplained(0.04, 9.0, ("kind spin_left",)),
    fix=Fix(
        True,
        0.002,
        transfer=(Trial("kind", "square_cw", 0.07, 0.02),),
        held_out=Improvement(3.0, 1.1, (1.5, 2.2), (0.9, 1.0)),
    ),
    next_runs=(PlannedRun("square_ccw", why="tells them apart", payload_kg=0.0, speed_mps=0.3),),
)


def test_the_document_is_json_even_if_numbers_are_not_finite() -> None:
    document = FULL.to_dict()
    assert json.loads(json.dumps(document, allow_nan=False)) == document
    assert document["causes"][0]["signal"] is None
    assert document["causes"][0]["parameters"]["relative"] == {"value": 3e-3, "ci95": [2.9e-3, None], "unit": "1"}


def test_the_fields_are_those_of_the_contract() -> None:
    document = FULL.to_dict()
    assert document["verdict"] == "partly_explained"
    assert document["indistinguishable"] == [["track_width", "curve_scrub"]]
    assert document["undetectable"] == {
        "wear": "never: indistinguishable from a radius or track error",
        "side_slip": "0.06 s2/m (slip per acceleration)",
    }
    heading = {"before_rms": 0.02, "after_rms": 0.004, "floor_rms": 0.003, "unit": "rad", "fraction": 0.9}
    assert document["closure"]["channels"]["heading"] == heading
    assert document["closure"]["by_channel"] == {"heading": 0.9, "lateral": None}
    assert document["rest"] == {"share": 0.04, "signal": 9.0, "where": ["kind spin_left"]}
    assert document["fix"] == {
        "recommended": True,
        "agreement_m": 0.002,
        "agreement_on": "runs driven",
        "nothing_else": 1.0,
        "transfer": [{"left_out": "kind", "value": "square_cw", "before_rms_m": 0.07, "after_rms_m": 0.02}],
        "held_out": {
            "before_rms": 3.0,
            "after_rms": 1.1,
            "improvement_ci95": [1.5, 2.2],
            "closed_ci95": [0.9, 1.0],
        },
        "why": [],
        "parameters": {},
        "corrects": None,
        "leaves": [],
        "moves": {},
    }
    assert document["recommended"] is document["fix"]["recommended"]
    assert document["judged_against"] == BY_MODEL
    cause = document["causes"][0]
    assert (cause["share_ci95"], cause["family"], cause["forms_open"]) == ([0.9, 0.95], "calibration", ["curve_scrub"])


def test_what_is_not_known_of_a_planned_run_is_left_out() -> None:
    assert FULL.to_dict()["next_runs"] == [
        {"kind": "square_ccw", "payload_kg": 0.0, "speed_mps": 0.3, "why": "tells them apart"}
    ]


@pytest.mark.parametrize("kind", VerdictKind)
def test_a_bare_diagnosis_of_every_kind_is_a_document(kind: VerdictKind) -> None:
    document = Diagnosis(kind, "").to_dict()
    assert document["verdict"] == kind.value
    assert document["rest"] is None and document["fix"]["recommended"] is False


def test_what_held_out_runs_keep_of_a_gap_explained_in_part_is_the_rest() -> None:
    """Null where nothing is left; else the channel beyond twice its noise, and the route that the correction fails.

    The share is of the whole gap, in which that route may be small.
    """
    large = ChannelClosure(Channel.HEADING, 0.02, 0.009, 0.003, 0.8)
    sound = ChannelClosure(Channel.LATERAL, 0.02, 0.011, 0.01, 0.9)
    channels = [Closure(fraction=0.8, channels=(sound,)), Closure(fraction=0.8, channels=(large, sound))]
    failed = Trial("kind", "square_cw", 0.07, 0.05, 100.0, 60.0, 10.0, 20.0)
    kept = [
        Diagnosis(VerdictKind.PARTLY_EXPLAINED, "", FULL.causes, closure=closure, fix=Fix(transfer=transfer))
        for closure, transfer in zip((*channels, channels[0]), ((), (), (failed,)), strict=True)
    ]
    rests = [with_left(diagnosis).to_dict()["rest"] for diagnosis in kept]
    assert rests[0] is None
    assert rests[1]["where"] == ["heading: 3 times its noise level"]
    assert rests[1]["share"] == pytest.approx(0.2) and rests[1]["signal"] == pytest.approx(8.0**0.5)
    assert rests[2] == {"share": pytest.approx(0.2), "signal": pytest.approx(50.0**0.5), "where": rests[2]["where"]}
    assert rests[2]["where"] == ["kind square_cw, held out"]
    assert with_left(replace(kept[1], kind=VerdictKind.EXPLAINED)).to_dict()["rest"] is None
