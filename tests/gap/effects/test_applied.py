"""An effect written down on one campaign acts on another as the same law, zero at the same value of its covariate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calib.coefficients.build import Header, from_law
from calib.coefficients.sections import Quantity
from calib.gap.effects import Form
from calib.gap.effects.encoder import Blunder
from calib.gap.effects.library import applied_perturbations, beyond_law, every_effect, section_of, with_effects
from calib.gap.observations import Observations
from calib.gap.observations.from_campaign import observations_of
from calib.gap.predict import predict, signature
from calib.io import write_bytes
from calib.radius.law import RadiusLaw, WheelLaw
from tests.gap.effects.making import STRAIGHT, Run, campaign, situation

#: rounding of a few sums and products
ROUNDING = 1e-12
BAR = np.array([2.0 + 0.1 * (n % 4) for n in range(12)])
DECLARED = {
    "id": "tyre",
    "title": "soft tyres",
    "column": "tyre_bar",
    "acts_on": "both",
    "typical": 1e-2,
    "largest": 1e-1,
}


def runs(higher: float) -> list[Run]:
    """Twelve straight runs on which every covariate lies higher by the same number."""
    return [
        Run(
            STRAIGHT,
            session=f"s{n // 6}",
            load_left_N=400.0 + 50.0 * (n % 3) + higher,
            load_right_N=400.0 + 80.0 * (n % 2) + higher,
            speed_mps=0.3 + 0.1 * (n % 3) + 0.1 * higher,
            numbers={
                "tyre_bar": BAR[n] + higher,
                "temperature_C": 20.0 + n % 5 + higher,
                "travelled_km": 0.5 * n + higher,
            },
        )
        for n in range(12)
    ]


def forms(s: Observations, effect: str, declared: object = ()) -> list[Form]:
    return every_effect(s, declared=declared)[effect].forms(s)


def radii(s: Observations, form: Form, declared: object = ()) -> tuple[np.ndarray, np.ndarray]:
    """What a form written down on other runs makes of the radii on these, at a size of 1 for each parameter."""
    section = section_of(form, np.ones(len(form.parameters)))
    perturbations, notes = applied_perturbations(s, [section], predict(s), declared=declared)
    assert notes == []
    sides = []
    for side in ("left", "right"):
        parts = [part for part in (getattr(perturbation, side) for perturbation in perturbations) if part is not None]
        sides.append(np.sum(parts, axis=0) if parts else np.zeros(len(s)))
    return sides[0], sides[1]


def test_a_declared_effect_of_a_hundredth_is_a_hundredth_one_unit_higher() -> None:
    """The radii were fitted with the effect zero at the first campaign's mean; a unit above it they are off by it."""
    here, there = situation(runs(0.0)), situation(runs(1.0))
    (form,) = forms(here, "tyre", [DECLARED])
    section = section_of(form, np.array([0.01]))
    (perturbation,), _ = applied_perturbations(there, [section], declared=[DECLARED])
    assert perturbation.left is not None
    np.testing.assert_allclose(perturbation.left, 0.01 * (BAR + 1.0 - BAR.mean()), rtol=0, atol=ROUNDING)
    assert perturbation.left.mean() == pytest.approx(0.01, abs=ROUNDING)


@pytest.mark.parametrize("acts_on", ["left", "track", "yaw", "distance"])
def test_whatever_a_declared_effect_acts_on_it_is_nought_at_the_same_value(acts_on: str) -> None:
    """The readings move by the size where the column is one unit above the first campaign's mean."""
    declared = [DECLARED | {"acts_on": acts_on}]
    here, there = situation(runs(0.0)), situation(runs(1.0))
    (form,) = forms(here, "tyre", declared)
    section = section_of(form, np.array([0.01]))
    path = predict(there)
    (moved,), _ = applied_perturbations(there, [section], path, declared=declared)
    exact = {
        "left": lambda: moved.left,
        "track": lambda: moved.track,
        "yaw": lambda: moved.heading_rad / there.path_m,
        "distance": lambda: moved.reading[:, 0],
    }[acts_on]()
    wanted = 0.01 * (BAR + 1.0 - BAR.mean())
    np.testing.assert_allclose(exact, wanted[there.unit] if acts_on == "yaw" else wanted, rtol=0, atol=ROUNDING)


LAWS: Mapping[str, Any] = {
    "temperature_radius": ("", lambda s: s.number("temperature_C")),
    "wear": ("per km", lambda s: s.number("travelled_km")),
}


@pytest.mark.parametrize("effect", LAWS)
def test_a_registered_covariate_is_nought_where_it_was_fitted(effect: str) -> None:
    label, values = LAWS[effect]
    here, there = situation(runs(0.0)), situation(runs(1.0))
    form = next(form for form in forms(here, effect) if form.label == label)
    for side in radii(there, form):
        np.testing.assert_allclose(side, values(there) - values(here).mean(), rtol=0, atol=ROUNDING)


def test_a_column_keeps_its_own_standard_deviation() -> None:
    """A size is per standard deviation of the campaign that it was fitted on."""
    here = situation(runs(0.0))
    wide = [Run(STRAIGHT, numbers={**run.numbers, "tyre_bar": 3.0 + 0.5 * (n % 4)}) for n, run in enumerate(runs(0.0))]
    there = situation(wide)
    form = next(form for form in forms(here, "covariate:tyre_bar") if form.label == "right radius")
    left, right = radii(there, form)
    np.testing.assert_allclose(right, (there.number("tyre_bar") - BAR.mean()) / BAR.std(), rtol=1e-12)
    assert not left.any()


def test_a_columns_effect_in_a_file_acts_where_the_column_is_declared_now() -> None:
    """The file was written before the declaration: it is no reason to leave the effect out."""
    s = situation(runs(0.0))
    form = forms(s, "covariate:tyre_bar")[0]
    assert np.abs(radii(s, form, declared=[DECLARED])[0]).max() > 0.0


def test_a_curved_law_keeps_the_load_at_which_it_is_nought() -> None:
    """The model has no reference load: the law is zero at the mean load it was fitted about."""
    here, there = situation(runs(0.0)), situation(runs(200.0))
    form = next(form for form in forms(here, "load_radius_nonlinear") if form.label == "quadratic")
    assert form.centre is not None
    reference = form.centre.mean
    left, _ = radii(there, form)
    load = there.number("load_left_N")
    wanted = reference * ((load / reference) ** 2 - 1.0) / 2.0 / there.radius_left_m
    np.testing.assert_allclose(left, wanted, rtol=1e-12, atol=ROUNDING)


def test_loads_outside_the_valid_range_of_a_model_are_said(tmp_path: Path) -> None:
    wheel = WheelLaw(300.0, 0.1, 1e-6, np.zeros((2, 2)), 9.0, 0.0, 280.0, 320.0, 4)
    made = campaign([Run(STRAIGHT), Run(STRAIGHT)])
    file = from_law(RadiusLaw(wheel, wheel), made.vehicle, made.encoder, Header("m", simulated=True, outside="refuse"))
    path = write_bytes(tmp_path / "m.json", file.to_bytes())
    s = observations_of(made)
    inside, beyond = (
        beyond_law(path, replace(s, numbers={**s.numbers, "load_left_N": np.full(len(s), load)}))
        for load in (320.0, 400.0)
    )
    assert inside == ()
    assert beyond == (
        "wheel loads lie outside the valid range of the model: its law is extended to them (on a vehicle: refuse)",
    )


def test_on_the_same_campaign_a_form_written_down_is_the_form() -> None:
    """Every form of the library with a centre, looked up again, perturbations as before."""
    s = situation(runs(0.0))
    path = predict(s)
    for effect in every_effect(s, declared=[DECLARED]).values():
        for form in effect.forms(s):
            if form.centre is None:
                continue
            sizes = form.typical
            again, _ = applied_perturbations(s, [section_of(form, sizes)], path, declared=[DECLARED])
            for perturbation, size, now in zip(form.perturbations(path), sizes, again, strict=True):
                np.testing.assert_allclose(
                    signature(path, now),
                    size * signature(path, perturbation),
                    rtol=1e-9,
                    atol=ROUNDING,
                    err_msg=form.label,
                )


def test_a_gross_fault_without_its_factors_is_said() -> None:
    s = situation(runs(0.0))
    fault = Blunder("the left wheel counts backwards", -1.0, 1.0)
    factors = {name: Quantity(value=value, unit="1") for name, value in fault.factors.items()}
    form = Form(fault.effect.id, fault.label, (), lambda _: [])
    whole = section_of(form, np.empty(0)).model_copy(update={"parameters": factors})
    turned, notes = with_effects(s, [whole])
    assert notes == ()
    np.testing.assert_array_equal(turned.roll_left_rad, -s.roll_left_rad)
    same, notes = with_effects(s, [whole.model_copy(update={"parameters": {}})])
    assert same is s
    assert "lacks its factors" in notes[0]
