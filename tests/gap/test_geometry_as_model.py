"""A geometry is taken whole as the model: with the sensor's place and delay nothing of it is named again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.campaign.model import Campaign
from calib.campaign.read import read_campaign
from calib.coefficients.build import from_geometry
from calib.gap.diagnose import diagnose_in_full
from calib.gap.effects.library import model_of, with_mounting_of
from calib.kinematics.estimate import estimate_geometry
from tests.kinematics.campaigns import Truth, campaign, mixed

#: by which the geometry is off in what it estimates, twice
SIGMAS = 4.0
TRUTH = Truth(sensor=(0.11, -0.04, 0.0), delay_s=0.12)


@pytest.fixture(scope="module")
def driven() -> Campaign:
    made = campaign(mixed(3), TRUTH, np.random.default_rng(3), sigma=(5e-4, 3e-4), along=True)
    return replace(made, reference=replace(made.reference, frame="start"))


def test_what_a_geometry_found_is_not_named_again(driven: Campaign, tmp_path: Path) -> None:
    found = estimate_geometry(driven, using="windows")
    for name in ("sensor_x_m", "sensor_y_m", "delay_s"):
        wanted = dict(zip(("sensor_x_m", "sensor_y_m"), TRUTH.sensor, strict=False)).get(name, TRUTH.delay_s)
        assert abs(found[name].value - wanted) < SIGMAS * found[name].std
    path = tmp_path / "geometry.json"
    path.write_bytes(from_geometry(found, driven, accept="a test").to_bytes())
    model, effects = model_of(path, driven)
    assert [effect.effect for effect in effects] == ["reference_latency"]
    there = with_mounting_of(path, driven)[0]
    assert there.reference.sensor_x_m == found["sensor_x_m"].value
    without = diagnose_in_full(driven, plan=False)
    assert {"reference_lever_arm", "reference_latency"} & {cause.effect for cause in without.causes}
    whole = diagnose_in_full(there, model=model, applied=effects, plan=False)
    assert not {"reference_lever_arm", "reference_latency", "track_width"} & {cause.effect for cause in whole.causes}
    assert whole.closure.before_rms_m is not None and without.closure.before_rms_m is not None
    assert whole.closure.before_rms_m < 0.2 * without.closure.before_rms_m


def test_a_file_without_a_geometry_leaves_the_sensor_as_stated(
    driven: Campaign, project_root: Path, tmp_path: Path
) -> None:
    from calib.coefficients.build import coefficients_of

    crossed = project_root / "sample_runs" / "corridor_crossed"
    path = tmp_path / "law.json"
    path.write_bytes(coefficients_of(crossed).file.to_bytes())
    assert with_mounting_of(path, driven)[0].reference == driven.reference
    assert model_of(path, read_campaign(crossed))[1] == ()
