"""Effects that no library has: an interaction, one speed only, left turns only, a hidden cause, a pull by the place."""

from __future__ import annotations

import numpy as np

from calib.plant.design import Design, conditions
from calib.plant.effects.floor import map_x_m, map_y_m
from calib.plant.effects.form import Form, Knobs, while_driving
from calib.plant.world import Moment, World, standardised
from calib.types import FloatArray


def _load_by_temperature(world: World, size: FloatArray, _knobs: Knobs) -> None:
    """Warm *and* loaded wheels shrink, cold and loaded ones grow; neither alone does anything."""
    crossed = standardised(world.mean_load_N) * standardised(world.design.temperature_C)
    world.enlarge(size * crossed)


@while_driving
def _one_speed(now: Moment, _world: World, size: FloatArray, knobs: Knobs) -> None:
    # a resonance: only about one middle speed
    near = size * np.exp(-(((now.v_mps - knobs["at_mps"]) / 0.04) ** 2))
    now.roll_more(near)


def _middle_speed(_rng: np.random.Generator, design: Design) -> dict[str, float]:
    speeds = np.unique(design.speed_mps)
    return {"at_mps": float(speeds[len(speeds) // 2])}


@while_driving
def _left_only(now: Moment, _world: World, size: FloatArray, _knobs: Knobs) -> None:
    """Only in left turns, and there in the tight ones: the vehicle turns less than its wheels say."""
    now.track += size * (now.curvature_per_m > 0.05)


def _hidden(world: World, size: FloatArray, knobs: Knobs) -> None:
    """Something nobody wrote down, another in each condition: the same in its repeats, without any order."""
    number = conditions(world.design)
    drawn = np.random.default_rng(int(knobs["seed"])).standard_normal((2, int(number.max()) + 1))
    drawn -= drawn.mean(axis=1, keepdims=True)
    world.enlarge(size * drawn[0, number], size * (0.7 * drawn[0, number] + 0.7 * drawn[1, number]))


def _seeded(rng: np.random.Generator, _design: Design) -> dict[str, float]:
    return {"seed": float(rng.integers(2**31))}


@while_driving
def _pull(now: Moment, world: World, size: FloatArray, knobs: Knobs) -> None:
    # a pull to the side that changes over the hall's floor; no wheel feels it
    wave = np.sin(2 * np.pi * map_x_m(world, now) / knobs["wave_x_m"] + knobs["phase_rad"])
    across = np.cos(2 * np.pi * map_y_m(world, now) / knobs["wave_y_m"])
    now.yaw_radps += size * now.v_mps * wave * across


def _pull_knobs(rng: np.random.Generator, _design: Design) -> dict[str, float]:
    return {
        "wave_x_m": float(rng.uniform(5.0, 9.0)),
        "wave_y_m": float(rng.uniform(6.0, 12.0)),
        "phase_rad": float(rng.uniform(-np.pi, np.pi)),
    }


_LOADS_AND_TEMPERATURES = frozenset({"loads", "temperatures"})

FORMS = (
    Form("outside:load_by_temperature", "plain", 8e-4, "1", _load_by_temperature, _LOADS_AND_TEMPERATURES),
    Form("outside:one_speed", "plain", 1.5e-3, "1", _one_speed, frozenset({"three_speeds"}), _middle_speed),
    Form("outside:left_only", "plain", 1e-2, "1", _left_only, frozenset({"turns", "bends", "poses"})),
    Form("outside:hidden", "plain", 6e-4, "1", _hidden, frozenset({"poses"}), _seeded),
    Form("outside:map_pull", "plain", 1.5e-3, "rad/m", _pull, frozenset({"poses", "turns", "directions"}), _pull_knobs),
)
