"""What cannot be told apart: exact aliases at distance nothing, different causes far away."""

from __future__ import annotations

import numpy as np
import pytest

from calib.gap.effects.effect import Form
from calib.gap.effects.library import library
from calib.gap.evidence.fit import fit
from calib.gap.evidence.marginal import CALIBRATION_SD, Nuisance
from calib.gap.evidence.whitened import WhitenedSystem
from calib.gap.plan.separability import noise_at
from calib.gap.predict.path import predict
from calib.gap.verdict.alternatives import NEAR, aliases_of, distance
from tests.gap.effects.making import Run, rich_runs, situation

# a nuisance that is broad, not free, and a prior of ten times the largest plausible size keep a thousandth at most
NOTHING = 0.05


@pytest.fixture(scope="module")
def bench() -> WhitenedSystem:
    s = situation(rich_runs())
    nominal = predict(s)
    noise = noise_at(nominal, {})
    return WhitenedSystem(fit(nominal, noise).path, nominal, noise)


@pytest.fixture(scope="module")
def forms(bench: WhitenedSystem) -> dict[str, list[Form]]:
    s = bench.path.s
    return {effect.id: effect.forms(s) for effect in library(s)}


def done(bench: WhitenedSystem, form: Form, times: float = 2.0) -> np.ndarray:
    """What a form does at some times its typical size."""
    return bench.columns(form) @ np.full(len(form.parameters), times)


def front(bench: WhitenedSystem) -> Nuisance:
    """The front radius alone is free."""
    return Nuisance.of(bench.calibration[:, 3:])


@pytest.mark.parametrize("side", [0, 1])
def test_a_constant_share_of_lost_counts_is_that_wheels_radius(
    bench: WhitenedSystem, forms: dict[str, list[Form]], side: int
) -> None:
    """Both say that a wheel travels so much more than counted: 0.3 % of its radius lies on top of 0.3 % lost."""
    radius = bench.calibration[:, side] / CALIBRATION_SD[side] * 3e-3
    constant = [form for form in forms["lost_counts"] if "constant" in form.label]
    mine = next(form for form in constant if ("left", "right")[side] in form.label)
    other = next(form for form in constant if form is not mine)
    assert distance(bench, front(bench), radius, mine) < NOTHING
    assert distance(bench, front(bench), radius, other) > NEAR
    # counts are lost, never won: a wheel that travels less than counted is no counter's doing
    assert distance(bench, front(bench), -radius, mine) > NEAR


def test_the_scale_and_the_angle_of_a_laser_are_alike(bench: WhitenedSystem, forms: dict[str, list[Form]]) -> None:
    """A beam at an angle reads a share too much, as a wrong scale does."""
    nuisance = Nuisance.of(bench.calibration)
    beam = done(bench, forms["beam_misalignment"][0])
    assert distance(bench, nuisance, beam, forms["rangefinder_scale"][0]) < NOTHING
    offered = aliases_of(bench, nuisance, beam, forms, ("beam_misalignment",))
    assert offered["rangefinder_scale"] < NOTHING
    assert "beam_misalignment" not in offered


def test_load_and_track_lie_far_apart(bench: WhitenedSystem, forms: dict[str, list[Form]]) -> None:
    """Straight runs under many loads tell radii that follow the load from a track that acts in turns."""
    load = done(bench, forms["load_radius"][0])
    assert distance(bench, front(bench), load, forms["track_width"][0]) > 10 * NEAR
    assert "track_width" not in aliases_of(bench, front(bench), load, forms, ("load_radius",))


def test_an_effect_is_its_own_alias_and_sizes_are_bounded(bench: WhitenedSystem, forms: dict[str, list[Form]]) -> None:
    """At a plausible size it stands in for itself; for a hundred times that it would need an implausible one."""
    form = forms["temperature_radius"][0]
    assert distance(bench, front(bench), done(bench, form), form) < NOTHING
    assert distance(bench, front(bench), done(bench, form, 100.0), form) > NEAR


def test_one_load_in_each_session_makes_load_and_session_alike() -> None:
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
        made = WhitenedSystem(nominal, nominal, noise_at(nominal, {}))
        found = {effect.id: effect.forms(s) for effect in library(s)}
        load = made.columns(found["load_radius"][0]).sum(axis=1) * 2.0
        return min(distance(made, Nuisance.of(made.calibration), load, form) for form in found["session_step"])

    assert apart(crossed=False) < NOTHING * 4
    assert apart(crossed=True) > NEAR
