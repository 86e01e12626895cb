"""What a form of an effect is: a size, its knobs, and what it does to the world."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from calib.arrays import FloatArray
from calib.plant.design import Design
from calib.plant.world import World

Knobs = Mapping[str, float]


def no_knobs(rng: np.random.Generator, design: Design) -> dict[str, float]:
    """Return the knobs of a form that has none."""
    del rng, design
    return {}


@dataclass(frozen=True, slots=True)
class Form:
    """One form of one effect."""

    effect: str  #: id of the effect; those outside any library begin with ``outside:``
    form: str  #: name of the form; ``plain`` is the textbook's
    typical: float  #: typical size
    unit: str  #: of the size
    #: ``act(world, size, knobs)`` changes the world; `size` has one value a run, 0 where the effect is absent
    act: Callable[[World, FloatArray, Knobs], None]
    #: what a design must have for the effect to be there at all: ``loads``, ``offsets``, ``turns``, ``speeds``,
    #: ``temperatures``, ``dwell``, ``sessions``, ``directions``, ``corridor``, ``laser``, ``poses``, ``front``,
    #: ``flying``, ``stops``, ``slope`` (truth and model share a load law), ``trace``, ``lanes``, ``lengths``,
    #: ``outside``, ``no_logs``, ``column:<name>``, ``bends`` (several radii of turn)
    needs: frozenset[str] = frozenset()
    #: ``knobs(rng, design)`` draws what else there is to choose, once a case
    knobs: Callable[[np.random.Generator, Design], dict[str, float]] = no_knobs


@dataclass(frozen=True, slots=True)
class Cause:
    """An effect with its size, as it truly acts in a case."""

    effect: str
    size: float  #: in the form's unit
    form: str = "plain"
    knobs: Knobs = field(default_factory=dict)  #: what else was drawn
