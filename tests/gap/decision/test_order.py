"""Radii that warm up from recording to recording: no recording is off by itself, and no constant corrects them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import kendalltau

from calib.campaign.model import Campaign
from calib.campaign.read import read_campaign
from calib.gap.decision import chance_of_order
from calib.gap.decision.sought import Sought, lone_recordings
from calib.gap.diagnose import diagnose_in_full
from calib.gap.inference import EVEN_PROBABILITY
from tests.gap import free_drives

#: relative growth of both radii over six recordings: of tyres that warm up, and as the same values are drawn otherwise
WARM = (0.0, 4.2e-3, 4.7e-3, 5.2e-3, 5.6e-3, 6e-3)
SHUFFLED = tuple(np.array(WARM)[[0, 4, 2, 5, 3, 1]])


def driven(folder: Path, radii: Sequence[float]) -> Campaign:
    """Return six recordings, of radii so much larger than nominal."""
    campaign = read_campaign(free_drives.write(folder / "free", "differential", {}, 1e-4, np.random.default_rng(4)))
    # of one day
    labels = campaign.runs.labels | {"session": np.full(len(radii), "d0")}
    columns = {name: values.copy() for name, values in campaign.logs.columns.items()}
    for number, off in enumerate(radii):
        mine = slice(campaign.logs.offsets[number], campaign.logs.offsets[number + 1])
        for name in ("counts_left", "counts_right"):
            columns[name][mine] = np.round(columns[name][mine] / (1.0 + off))
    runs, logs = replace(campaign.runs, labels=labels), replace(campaign.logs, columns=columns)
    return replace(campaign, runs=runs, logs=logs)


def test_the_chance_of_an_order_is_that_of_permutations() -> None:
    """Kendall's coefficient of all 720 orders of six values, counted."""
    values = np.array([0.1, 0.4, 0.3, 0.5, 0.9, 0.8])
    every = [abs(kendalltau(np.arange(6), order).statistic) for order in permutations(values)]
    counted = np.mean(np.array(every) >= kendalltau(np.arange(6), values).statistic - 1e-9)
    assert chance_of_order(values) == (pytest.approx(counted), True)
    assert chance_of_order(-values) == (pytest.approx(counted), False)
    assert chance_of_order(np.zeros(1))[0] == 1.0


@pytest.mark.parametrize(("radii", "omitted"), [(WARM, []), (SHUFFLED, ["rec0"])])
def test_a_cold_recording_before_others_that_warm_up_is_not_alone(
    tmp_path: Path, radii: Sequence[float], omitted: list[str]
) -> None:
    situation = Sought(None, (), ()).situation(driven(tmp_path, radii))
    assert [*lone_recordings(situation)] == omitted


def test_radii_that_follow_the_order_driven_are_no_constant(tmp_path: Path) -> None:
    """Their mean was recommended at 0.96, with an interval that held the radii of few recordings."""
    diagnosis = diagnose_in_full(driven(tmp_path, WARM), plan=False)
    assert not diagnosis.recommended
    assert max(cause.probability for cause in diagnosis.causes) <= EVEN_PROBABILITY
    assert any("drifts with the order driven" in text for text in diagnosis.fix.why)
