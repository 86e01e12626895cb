"""A reference of wrong scale is told from radii and track that are off alike by a second measure of length alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calib.campaign.model import Campaign
from calib.gap.decision.diagnosis import Diagnosis, VerdictKind
from tests.gap.effects.making import (
    DIFFERENTIAL,
    ROUTE,
    STRAIGHT,
    Motion,
    Run,
    Truth,
    campaign,
    end_pose,
    loaded,
    noisy,
    turned,
)

Diagnosing = Callable[..., Diagnosis]


def stretched(share: float, seed: int, *, track: float = 0.0) -> Truth:
    """A reference that reads every way longer by a share, beside a track that is off."""
    truth = noisy(lambda *_: None, seed)

    def both(run: Run, now: Motion) -> None:
        truth(run, now)
        now.track = track
        x, y = share * end_pose(now.ds_m, now.turn_rad)[:2]
        now.end_x_m, now.end_y_m = now.end_x_m + x, now.end_y_m + y

    return both


def without_laser(made: Campaign) -> Campaign:
    numbers = {**made.runs.numbers, "distance_m": np.full(len(made.runs), np.nan)}
    return replace(made, runs=replace(made.runs, numbers=numbers))


def test_a_reference_of_wrong_scale_is_not_three_causes_of_one_size(diagnosing: Diagnosing) -> None:
    """Radii, track and rangefinder off by the same share would leave as little."""
    verdict = diagnosing(campaign(loaded(), truth=stretched(5e-3, 12), vehicle=DIFFERENTIAL), plan=False)
    assert [cause.effect for cause in verdict.causes] == ["reference_scale"]
    assert not verdict.correction.calibration.any()


def test_a_counted_front_wheel_tells_it_where_no_laser_does(diagnosing: Diagnosing) -> None:
    """Of radii and track it would have to be a front wheel and a steering off by the same share, too."""
    routes = (ROUTE, turned(ROUTE), STRAIGHT)
    runs = [replace(run, pieces=routes[n % 3], front=True, steps=400, ramp=True) for n, run in enumerate(loaded())]
    verdict = diagnosing(without_laser(campaign(runs, truth=stretched(2.5e-3, 12))), plan=False)
    # a step's angle is logged at its end, where the next one begins
    scale, *others = verdict.causes
    assert {cause.effect for cause in others} <= {"steering_delay"}
    assert scale.effect == "reference_scale"
    (size,) = scale.parameters.values()
    assert size.ci95[0] < 2.5e-3 < size.ci95[1]


@pytest.mark.parametrize(
    ("track", "group"),
    [(0.0, ("radius_scale", "track_width", "reference_scale")), (5e-3, ("radius_scale", "reference_scale"))],
)
def test_radii_may_be_the_scale_of_a_reference_that_alone_measures(
    track: float, group: tuple[str, ...], diagnosing: Diagnosing
) -> None:
    """Longer ways by 0.5 % are radii and track 0.5 % larger; beside a track off by itself they are radii alone."""
    made = campaign(loaded(), truth=stretched(5e-3, 12, track=track), vehicle=DIFFERENTIAL)
    verdict = diagnosing(without_laser(made))
    assert {cause.effect for cause in verdict.causes} == {"radius_scale", "track_width"}
    assert not verdict.recommended and verdict.kind is VerdictKind.AMBIGUOUS
    assert group in [each[: len(group)] for each in verdict.groups]
    assert all(cause.probability <= 0.5 for cause in verdict.causes if cause.effect in group)
    assert "by tape or laser (distance_m)" in " ".join(verdict.fix.why)
    assert verdict.next_runs[0].tape
    if len(group) > 2:
        assert "(radius_scale) with a wrong track width (track_width)" in verdict.sentence
