"""Which runs have a place on the floor where there is no map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.campaign.settings import Reference
from calib.gap.effects.floor import FloorSlope, FloorZone, placed
from calib.gap.observations.from_campaign import observations_of
from calib.gap.predict import predict
from tests.gap.effects.making import SQUARE, STRAIGHT, Run, campaign


@pytest.mark.parametrize("frame", [None, "start"])
def test_straight_runs_out_and_back_share_the_corridor(frame: str | None) -> None:
    """A corridor has places by the distance along it; squares beside it have none, and make no place of all of it."""
    back = [Run(STRAIGHT, direction=direction) for direction in ("out", "back")]
    runs = [*back * 6, *[Run(SQUARE, kind=kind, direction="") for kind in ("square_cw", "square_ccw")] * 6]
    made = campaign(runs)
    both = observations_of(replace(made, reference=Reference(frame=frame)))  # type: ignore[arg-type]
    assert placed(both).tolist() == [True] * 12 + [False] * 12
    assert FloorZone().forms(both) == []
    made = campaign([*back * 6, *[Run([(6.0, 0.0)], direction="out")] * 4, *runs[12:]])
    shorter = FloorZone().forms(observations_of(made))
    # a place that some cross and others do not: beyond the end of the short runs
    assert {form.settings["x_m"] >= 5.0 for form in shorter} == {True}
    for form in FloorSlope().forms(both):
        pushed = form.perturbations(predict(both))[0]
        given = next(part for part in (pushed.left, pushed.heading_rad, pushed.lateral_m) if part is not None)
        assert not given[np.isin(both.unit, np.arange(12, 24))].any() and given[both.unit < 12].any()
