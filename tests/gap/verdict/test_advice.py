"""Why a fix is recommended or not is said in one sentence."""

from __future__ import annotations

from typing import Any

import pytest

from calib.gap.verdict.sentence import advice


def document(verdict: str, *causes: tuple[str, float], recommended: bool = False, tied: bool = False) -> dict[str, Any]:
    named = [{"effect": effect, "probability": probability} for effect, probability in causes]
    groups = [[effect for effect, _ in causes] + ["wear"]] if tied else []
    return {"verdict": verdict, "causes": named, "recommended": recommended, "indistinguishable": groups}


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (document("explained", ("load_radius", 0.9), recommended=True), "Recommended: the fix holds"),
        (document("ambiguous", ("load_radius", 0.5), tied=True), "other causes would explain"),
        (document("partly_explained", ("load_radius", 0.5)), "a rest of the gap is left"),
        (document("explained", ("load_radius", 0.9), ("wear", 0.4)), "too little speaks for wear (0.40)"),
        (document("explained", ("load_radius", 0.9)), "not shown to hold"),
    ],
)
def test_the_reason_fits_the_verdict(given: dict[str, Any], words: str) -> None:
    assert words in advice(given)
    assert advice(given).startswith("Recommended") == given["recommended"]


def test_without_a_cause_there_is_nothing_to_recommend() -> None:
    assert advice(document("no_gap")) == ""
