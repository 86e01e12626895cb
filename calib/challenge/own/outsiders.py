"""Causes that no library holds, made of what a campaign has: columns, speeds, turns, conditions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from calib.challenge.own.replay import Replay
from calib.plant.world import Moment, World
from calib.types import FloatArray, IntArray

#: changes a world by a size
SizedAct = Callable[[World, float], None]

#: outside cause -> size at which it is tried first
OUTSIDERS: Final = {"interaction": 1e-3, "one_speed": 2e-3, "left_turns": 1e-2, "unlogged": 1e-3}

#: two columns nearer than this, as a correlation, are one column
ALIKE: Final = 0.9
#: width of the resonance, as a share of the speed it is at
NARROW: Final = 0.1
#: left turns tighter than this count
TIGHT_PER_M: Final = 0.05


def outsiders(replay: Replay, rng: np.random.Generator) -> dict[str, SizedAct | str]:
    """Return each outside cause, its hidden part drawn, or the reason why this campaign cannot have it."""
    columns = _two_columns(replay)
    speeds = np.unique(np.round(replay.design.speed_mps, 2))
    condition = replay.observations.condition
    n_repeated = int((np.bincount(condition) > 1).sum())
    drawn = rng.standard_normal((2, int(condition.max()) + 1))
    turns_left = bool((replay.observations.turn_rad > 0).any())
    return {
        "interaction": "no two columns vary apart" if columns is None else _interaction(*columns),
        "one_speed": "all runs have one speed" if len(speeds) < 2 else _one_speed(float(speeds[len(speeds) // 2])),
        "left_turns": _left_turns if turns_left else "nothing turns left",
        "unlogged": "fewer than three conditions have repeats" if n_repeated < 3 else _unlogged(drawn, condition),
    }


def column_act(values: FloatArray) -> SizedAct:
    """Return a column's pull on both radii, a size for each standard deviation of the column (n_units,)."""
    return _on_both_radii(_standard(values))


def _on_both_radii(share: FloatArray) -> SizedAct:
    return lambda world, size: world.enlarge(size * share)


def _standard(values: FloatArray) -> FloatArray:
    known = np.where(np.isfinite(values), values, np.nanmean(values))
    spread: FloatArray = (known - known.mean()) / max(float(known.std()), 1e-12)
    return spread


def _two_columns(replay: Replay) -> tuple[FloatArray, FloatArray] | None:
    """Return the first two columns that vary, and do not vary together."""
    design, observations = replay.design, replay.observations
    order = np.arange(len(observations), dtype=np.float64)
    candidates = [
        observations.number("load_left_N"),
        design.temperature_C,
        design.speed_mps,
        design.minutes_under_load,
        observations.length_m,
        order,
    ]
    varying = [v for v in candidates if np.isfinite(v).all() and np.std(v) > 1e-6 * (1e-3 + np.abs(np.mean(v)))]
    for number, column in enumerate(varying):
        for other in varying[number + 1 :]:
            if abs(float(np.corrcoef(column, other)[0, 1])) < ALIKE:
                return column, other
    return None


def _interaction(column: FloatArray, other: FloatArray) -> SizedAct:
    return _on_both_radii(_standard(column) * _standard(other))


def _one_speed(at_mps: float) -> SizedAct:
    def act(world: World, size: float) -> None:
        def during(now: Moment) -> None:
            near = size * np.exp(-(((np.abs(now.v_mps) - at_mps) / (NARROW * at_mps)) ** 2))
            now.roll_more(near)

        world.during.append(during)

    return act


def _left_turns(world: World, size: float) -> None:
    def during(now: Moment) -> None:
        now.track += size * (now.curvature_per_m * np.sign(now.v_mps) > TIGHT_PER_M)

    world.during.append(during)


def _unlogged(drawn: FloatArray, condition: IntArray) -> SizedAct:
    """Something nobody wrote down: another pull in each condition, the same in its repeats."""
    left, right = drawn[0, condition], 0.7 * (drawn[0, condition] + drawn[1, condition])
    return lambda world, size: world.enlarge(size * left, size * right)
