"""Far from the calibration's path the search begins where the gap is linear, and goes no further than that holds."""

from __future__ import annotations

import numpy as np

from calib.gap.data.from_campaign import observations_of
from calib.gap.data.observations import Observations
from calib.gap.effects.effect import Form
from calib.gap.effects.library import library
from calib.gap.evidence.approach import approached, is_far
from calib.gap.evidence.climb import Climb, Settings
from calib.gap.evidence.fit import Fitted, fit
from calib.gap.evidence.noise import Noise, estimate_noise
from calib.gap.evidence.system import LinearSystem
from calib.gap.predict.path import Path, predict
from calib.gap.predict.residuals import residuals
from calib.plant.effects.registry import find
from calib.plant.make import make_campaign
from calib.plant.plans import good_design

#: relative error of a radius; ten times that of a tyre taken for another
OFF = 0.5


def _loaded(times: float) -> tuple[Observations, Path, Noise, Fitted]:
    """Radii that follow the load, so many times as strongly as is typical of a rubber wheel."""
    rng = np.random.default_rng(4)
    form = find("load_radius", "")
    campaign = make_campaign(good_design(rng, needs=form.needs), {"load_radius": times * form.typical}, rng)
    observations = observations_of(campaign)
    nominal = predict(observations)
    noise = estimate_noise(nominal, residuals(nominal, nominal))
    return observations, nominal, noise, fit(nominal, noise)


def _forms(observations: Observations, *names: str) -> list[Form]:
    return [form for e in library(observations) if e.id in names for form in e.forms(observations)[:2]]


def test_of_effects_that_bend_alike_the_one_whose_own_path_fits_is_begun_with() -> None:
    observations, nominal, noise, base = _loaded(3.0)
    forms = _forms(observations, "floor_slope", "curve_scrub", "load_radius", "temperature_radius")
    assert is_far(base)
    near = approached(nominal, noise, base, forms, 6)
    assert [form.effect for form in near.forms] == ["load_radius"]
    assert not is_far(near)


def test_where_little_is_left_the_search_begins_at_the_calibration() -> None:
    observations, nominal, noise, base = _loaded(0.02)
    assert approached(nominal, noise, base, _forms(observations, "load_radius"), 6) is base


def test_what_takes_less_than_half_away_is_not_begun_with() -> None:
    observations, nominal, noise, base = _loaded(3.0)
    assert approached(nominal, noise, base, _forms(observations, "rangefinder_offset"), 6) is base


def test_a_wrong_effect_about_a_path_far_off_turns_no_wheel_inside_out() -> None:
    """Fitted and linearised again and again, the calibration beside it stays one that a vehicle could have."""
    observations, nominal, noise, fitted = _loaded(3.0)
    forms = _forms(observations, "wheel_eccentricity")[:1]
    for _ in range(4):
        climb = Climb(LinearSystem(fitted, nominal, noise, forms), Settings())
        fitted = climb.with_only((0,)).fitted()
        assert np.all(np.abs(fitted.calibration[:2]) < OFF)
