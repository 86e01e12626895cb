"""Causes whose sizes no reading checks: they are neither stated nor corrected as if one did."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import calib
from calib.gap.decision import constancy
from calib.gap.diagnose import diagnose_in_full
from calib.gap.localise import ON_THE_FLOOR, PlaceResult
from calib.gap.observations import Channel
from tests.gap import route_offsets

#: seed of `route_offsets` whose two routes' own offsets three causes meet within the noise
FITTED, N_ROUTES = 4, 2
CLOSED = ("corridor", "square_ccw", "square_cw")
OPEN = ("corridor", "square_ccw", "route_left", "route_right")
NO_OFFSET = (0.0, 0.0, 0.0)


def test_offsets_of_few_routes_are_no_causes_though_a_set_of_them_fits() -> None:
    """Four sizes meet the ends of two routes, by any cause: the next route is off by what they invent."""
    verdict = route_offsets.verdict_of(FITTED, N_ROUTES)
    assert verdict["closure"]["fraction"] > 0.9 and not verdict["recommended"]
    assert verdict["verdict"] == "partly_explained" and all(cause["probability"] <= 0.5 for cause in verdict["causes"])
    assert "sizes rest on" in " ".join(verdict["fix"]["why"])


def test_a_sensor_s_place_is_corrected_where_runs_that_turn_home_tell_it(tmp_path: Path) -> None:
    """Routes that end 7 degrees off show an eighth of an arm: one of 0.5 m is known, of 3 cm it may be anything."""
    known, hint = (
        diagnose_in_full(calib.read(_armed(tmp_path / f"{arm_m}", CLOSED, arm_m)), plan=False) for arm_m in (0.5, 0.03)
    )
    assert "times as much after a quarter turn" in " ".join(hint.fix.why)
    assert known.recommended and known.causes[0].effect == "reference_lever_arm"
    assert not hint.recommended
    elsewhere = diagnose_in_full(calib.read(_armed(tmp_path / "open", OPEN, 0.15)), plan=False)
    assert elsewhere.recommended and elsewhere.causes[0].effect == "reference_lever_arm"


def test_a_fix_by_ends_that_leads_the_recordings_further_off_is_not_recommended(tmp_path: Path) -> None:
    """The run table read a sensor ahead of the axle, the logs the axle itself: along the way the arm is an error."""
    alone = diagnose_in_full(calib.read(_armed(tmp_path / "ends", OPEN, 0.15)), plan=False)
    traced = diagnose_in_full(calib.read(_armed(tmp_path / "traced", OPEN, 0.15, traced=True)), plan=False)
    assert alone.recommended and not traced.recommended
    assert "windows of the recordings end" in traced.fix.why[0]


def _armed(folder: Path, kinds: tuple[str, ...], arm_m: float, *, traced: bool = False) -> Path:
    sizes = {"reference_lever_arm": arm_m}
    turned = 0.98 if kinds is CLOSED else 1.0
    return route_offsets.write(folder, kinds, [7, 1], offset_sd=NO_OFFSET, sizes=sizes, traced=traced, turned=turned)


def test_no_offsets_are_no_gap(tmp_path: Path) -> None:
    """The campaigns above without their offsets: nothing else is wrong with them."""
    made = route_offsets.write(tmp_path / "sound", OPEN, [7, 2], offset_sd=NO_OFFSET)
    assert diagnose_in_full(calib.read(made), plan=False).kind == "no_gap"


@pytest.mark.parametrize(
    ("opens_m", "counted", "named"),
    [
        (8.45e-3, ON_THE_FLOOR, ["radius_scale"]),
        (2e-3, ON_THE_FLOOR, []),
        (8.45e-3, "way from the start", []),  # one way: also what speeding up does
    ],
)
def test_a_gap_that_opens_at_one_place_out_and_back_is_no_radius(
    monkeypatch: pytest.MonkeyPatch, opens_m: float, counted: str, named: list[str]
) -> None:
    """A floor that took 8.4 mm of a corridor between 6 and 8.25 m was corrected as a radius of all routes."""
    place = PlaceResult(
        "zone", Channel.ALONG, opens_m, (opens_m, opens_m), "m", 1e-19, 20,
        route="corridor", place=(6.0, 8.25), coordinate=counted,
    )  # fmt: skip
    gap = np.zeros((4, 6))
    gap[:, Channel.ALONG] = 8.7e-3
    monkeypatch.setattr(constancy, "residuals", lambda *_: gap)
    observations = SimpleNamespace(labels={"kind": np.full(4, "corridor")}, usable=np.ones((4, 6), bool))
    evidence = SimpleNamespace(observations=observations, nominal=None, where=SimpleNamespace(places=[place]))
    found = constancy._at_a_place(evidence, ["radius_scale", "unequal_radii"])  # type: ignore[arg-type]
    assert [*found] == named and all("from 6.00 to 8.25 m" in text for text in found.values())
