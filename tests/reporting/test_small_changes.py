"""What rounds to no change is not called one."""

from __future__ import annotations

import pytest

from calib.reporting.formatting import percent
from calib.reporting.topics.simulation import times


@pytest.mark.parametrize(
    ("share", "text"),
    [(0.004, "< 1 %"), (0.0, "0 %"), (0.006, "1 %"), (0.96, "96 %"), (-0.2, "−20 %"), (None, "–"), (float("nan"), "–")],
)
def test_a_small_share_is_not_printed_as_none(share: float | None, text: str) -> None:
    assert percent(share) == text


@pytest.mark.parametrize(
    ("ratio", "text"),
    [
        (3.14, "3.14 times smaller"),
        (1.04, "neither smaller nor larger (1.04 times)"),
        (0.97, "neither smaller nor larger (0.97 times)"),
        (0.5, "2 times larger"),
    ],
)
def test_an_error_is_not_one_time_smaller(ratio: float, text: str) -> None:
    assert times(ratio) == text
