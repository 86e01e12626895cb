"""How many causes may be named before they pass for one that no library holds."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import pytest

from calib.gap.verdict.decide import IMITATION, Judge


def imitation(effects: int, calibration: int = 0) -> float:
    judge: Any = SimpleNamespace(chosen=SimpleNamespace(effects=("a",) * effects), calibration=("b",) * calibration)
    return Judge.imitation(judge)


def test_nothing_named_imitates_nothing() -> None:
    assert imitation(0) == 0.0


@pytest.mark.parametrize("calibration", [0, 1, 2])
def test_the_more_causes_are_named_the_likelier_is_one_outside_the_library(calibration: int) -> None:
    odds = [imitation(effects, calibration) for effects in range(5)]
    assert all(before <= after for before, after in pairwise(odds))
    assert odds[0] < odds[2]
    assert odds[-1] == IMITATION[1][-1]


def test_one_or_two_causes_are_believed_and_three_are_not() -> None:
    assert imitation(1) < imitation(2) < 0.5 < imitation(3)


def test_a_calibration_parameter_counts_half_a_cause() -> None:
    assert imitation(1, 2) == imitation(2)
