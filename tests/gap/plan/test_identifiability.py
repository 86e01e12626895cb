"""Confounded effects: exact aliases have distance zero, different causes are far apart."""

from __future__ import annotations

import numpy as np
import pytest

from calib.gap.effects import Form
from calib.gap.effects.library import library
from calib.gap.inference.fit import CALIBRATION_SD, fit
from calib.gap.inference.least_squares import WhitenedSystem
from calib.gap.inference.marginal_likelihood import Nuisance
from calib.gap.plan import SEPARATION_SD, aliases_of, distance, noise_at, undetectable
from calib.gap.predict import predict
from tests.gap.effects.making import SQUARE, Run, rich_runs, situation

# a nuisance that is broad, not free, and a prior of ten times the largest plausible size keep a thousandth at most
ZERO_SD = 0.05


@pytest.fixture(scope="module")
def system() -> WhitenedSystem:
    s = situation(rich_runs())
    nominal = predict(s)
    noise = noise_at(nominal, {})
    return WhitenedSystem(fit(nominal, noise).path, nominal, noise)


@pytest.fixture(scope="module")
def forms(system: WhitenedSystem) -> dict[str, list[Form]]:
    s = system.path.s
    return {effect.id: effect.forms(s) for effect in library(s)}


def contribution(system: WhitenedSystem, form: Form, times: float = 2.0) -> np.ndarray:
    """What a form does at some times its typical size."""
    return system.columns(form) @ np.full(len(form.parameters), times)


def front(system: WhitenedSystem) -> Nuisance:
    """Only the front radius is free."""
    return Nuisance(system.calibration[:, 3:])


@pytest.mark.parametrize("side", [0, 1])
def test_a_constant_share_of_lost_counts_is_that_wheels_radius(
    system: WhitenedSystem, forms: dict[str, list[Form]], side: int
) -> None:
    """Both say that a wheel travels so much more than counted: 0.3 % of its radius lies on top of 0.3 % lost."""
    radius = system.calibration[:, side] / CALIBRATION_SD[side] * 3e-3
    constant = [form for form in forms["lost_counts"] if "constant" in form.label]
    mine = next(form for form in constant if ("left", "right")[side] in form.label)
    other = next(form for form in constant if form is not mine)
    assert distance(system, front(system), radius, mine) < ZERO_SD
    assert distance(system, front(system), radius, other) > SEPARATION_SD
    # counts are lost, never won: a wheel that travels less than counted is no counter's doing
    assert distance(system, front(system), -radius, mine) > SEPARATION_SD


def test_the_scale_and_the_angle_of_a_laser_are_alike(system: WhitenedSystem, forms: dict[str, list[Form]]) -> None:
    """A beam at an angle reads a share too much, as a wrong scale does."""
    nuisance = Nuisance(system.calibration)
    beam = contribution(system, forms["beam_misalignment"][0])
    assert distance(system, nuisance, beam, forms["rangefinder_scale"][0]) < ZERO_SD
    offered = aliases_of(system, nuisance, beam, forms, ("beam_misalignment",))
    assert offered["rangefinder_scale"] < ZERO_SD
    assert "beam_misalignment" not in offered


def test_load_and_track_are_far_apart(system: WhitenedSystem, forms: dict[str, list[Form]]) -> None:
    """Straight runs under many loads tell radii that follow the load from a track that acts in turns."""
    load = contribution(system, forms["load_radius"][0])
    assert distance(system, front(system), load, forms["track_width"][0]) > 10 * SEPARATION_SD
    assert "track_width" not in aliases_of(system, front(system), load, forms, ("load_radius",))


def test_an_effect_is_its_own_alias_and_sizes_are_bounded(system: WhitenedSystem, forms: dict[str, list[Form]]) -> None:
    """At a plausible size it is confounded with itself; a hundred times that is not plausible."""
    form = forms["temperature_radius"][0]
    assert distance(system, front(system), contribution(system, form), form) < ZERO_SD
    assert distance(system, front(system), contribution(system, form, 100.0), form) > SEPARATION_SD


def test_one_load_in_each_session_confounds_load_and_session() -> None:
    """Two sessions, a load each: a step between them is what the load does; crossed, it is not."""

    def apart(crossed: bool) -> float:
        loads = [300.0, 600.0]
        runs = [
            Run([(10.0, 0.0)], session=f"s{n % 2}", load_left_N=load, load_right_N=load, front=False)
            for n in range(16)
            for load in [loads[n // 2 % 2 if crossed else n % 2]]
        ]
        s = situation(runs)
        nominal = predict(s)
        whitened = WhitenedSystem(nominal, nominal, noise_at(nominal, {}))
        forms = {effect.id: effect.forms(s) for effect in library(s)}
        load = whitened.columns(forms["load_radius"][0]).sum(axis=1) * 2.0
        nuisance = Nuisance(whitened.calibration)
        return min(distance(whitened, nuisance, load, form) for form in forms["session_step"])

    assert apart(crossed=False) < ZERO_SD * 4
    assert apart(crossed=True) > SEPARATION_SD


def test_payloads_move_nothing_where_the_model_has_no_slopes_by_load() -> None:
    """What a load moves is its radius' slope; what is missing is said, not that the payload does nothing."""
    runs = [Run(SQUARE, kind="square", numbers={"payload_kg": 100.0 * (k % 2)}) for k in range(8)]
    path = predict(situation(runs))
    limits = undetectable(WhitenedSystem(path, path, noise_at(path, {})), library(path.s))
    said = {limit.effect: limit.smallest for limit in limits}
    assert said["payload_mass"] == said["payload_position"] == "[model] has no slopes by load"
