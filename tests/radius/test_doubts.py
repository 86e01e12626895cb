"""What a check finds of all runs' radii and loads is a doubt of the fit, and what it finds of other things is not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calib.campaign.model import Campaign
from calib.radius.fit import fit_campaign
from tests.campaign.making import campaign, with_numbers


def _spoilt(**by: float) -> Callable[[Campaign], Campaign]:
    return lambda made: with_numbers(made, **{name: made.runs.number(name) * one for name, one in by.items()})


def _speed_by_load(made: Campaign) -> Campaign:
    return with_numbers(made, speed_mps=0.7 - 2e-3 * made.runs.number("payload_kg"))


def _one_count_off(made: Campaign) -> Campaign:
    return replace(made, encoder=replace(made.encoder, counts_per_rev_left=made.encoder.counts_per_rev_left + 1.0))


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (_spoilt(counts_left=0.97, counts_right=0.97), "check counts_per_rev, a gear ratio"),
        (_spoilt(load_left_N=1.12), "check payload, its place and the weighing"),
        (_speed_by_load, "load and speed change together"),
        (_one_count_off, ""),
        (_spoilt(load_left_N=1.04), ""),
        (_spoilt(), ""),
    ],
)
def test_what_moves_a_law_and_shows_in_no_residual_is_a_doubt(spoil: Callable[[Campaign], Campaign], said: str) -> None:
    """Residuals are as small as those of the sound campaign; the reason is the check's, and a remark stays one."""
    fit = fit_campaign(spoil(campaign(logs=False)))
    assert fit.verdict == ("doubtful" if said else "fitted")
    doubts = [check.sentence for check in fit.left.checks if check.name == "data"]
    assert len(doubts) == bool(said)
    assert all(said in sentence for sentence in doubts)
    assert fit.failed == (("left wheel, data", "right wheel, data") if said else ())
    assert np.abs(fit.left.residual_m).max() < 2e-5
