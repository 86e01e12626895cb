"""A reference in other units or axes is a blunder: no effect is named for it, and the verdict says where to look."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.campaign.read import read_campaign
from calib.gap.decision.diagnosis import VerdictKind
from calib.gap.diagnose import diagnose_in_full
from calib.types import FloatArray

Columns = dict[str, FloatArray]


def in_degrees(columns: Columns) -> Columns:
    return {"ref_theta_rad": np.degrees(columns["ref_theta_rad"])}


def clockwise(columns: Columns) -> Columns:
    return {"ref_theta_rad": -columns["ref_theta_rad"]}


def in_millimetres(columns: Columns) -> Columns:
    return {"ref_x_m": 1e3 * columns["ref_x_m"], "ref_y_m": 1e3 * columns["ref_y_m"]}


def exchanged(columns: Columns) -> Columns:
    return {"ref_x_m": columns["ref_y_m"], "ref_y_m": columns["ref_x_m"]}


@pytest.mark.parametrize(
    ("mistake", "every", "hint"),
    [
        (in_degrees, 3, "are they in degrees?"),
        (clockwise, 3, "is ref_theta_rad positive to the right?"),
        (in_millimetres, 3, "are they in millimetres?"),
        (exchanged, 2, "are x and y exchanged"),
    ],
)
def test_a_reference_in_other_units_or_axes_gets_no_cause(
    mistake: Callable[[Columns], Columns], every: int, hint: str, project_root: Path
) -> None:
    """On some runs of the yard; headings in degrees leave no noise that the rest could be held against."""
    campaign = read_campaign(project_root / "sample_runs" / "yard")
    campaign = campaign.select(np.arange(0, len(campaign.runs), every))
    numbers = {**campaign.runs.numbers, **mistake(dict(campaign.runs.numbers))}
    struck = replace(campaign, runs=replace(campaign.runs, numbers=numbers))
    verdict = diagnose_in_full(struck, plan=False)
    assert verdict.kind in {VerdictKind.UNKNOWN, VerdictKind.UNDECIDED}
    assert verdict.causes == ()
    assert verdict.sentence.startswith("Correct this first: ")
    assert hint in verdict.correct_first[0]


def test_a_mirrored_reference_may_be_swapped_wheels_and_is_said_to_be(project_root: Path) -> None:
    """The two are the same to any data of two wheels: the advice names both."""
    campaign = read_campaign(project_root / "sample_runs" / "yard")
    mirrored = {name: -campaign.runs.numbers[name] for name in ("ref_y_m", "ref_theta_rad")}
    struck = replace(campaign, runs=replace(campaign.runs, numbers={**campaign.runs.numbers, **mirrored}))
    cause = diagnose_in_full(struck, plan=False).causes[0]
    assert (cause.effect, cause.form) == ("encoder_gross", "swapped wheels")
    assert "y to the left" in cause.remark
