"""What a form of an effect is: a size, its knobs, and what it does to the world."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from calib.plant.design import Design
from calib.plant.world import Moment, World
from calib.types import FloatArray

Knobs = Mapping[str, float]


#: changes the world; the size has one value a run, 0 where the effect is absent
Act = Callable[[World, FloatArray, Knobs], None]
#: draws what else there is to choose of a form
Draw = Callable[[np.random.Generator, Design], dict[str, float]]


def drawn(**ranges: tuple[float, float]) -> Draw:
    """Return a draw of knobs, each evenly from its range, one after the other."""
    return lambda rng, _: {name: float(rng.uniform(low, high)) for name, (low, high) in ranges.items()}


_NO_KNOBS: Final = drawn()


def either_side(rng: np.random.Generator, _: Design) -> dict[str, float]:
    """Draw the side that an effect is on."""
    return {"right": float(rng.integers(2))}


def added(name: str) -> Act:
    """Return an act that adds its size to a field of the world."""
    return lambda world, size, _: setattr(world, name, getattr(world, name) + size)


def scaled(*names: str) -> Act:
    """Return an act that makes fields of the world larger by its size, a share."""

    def act(world: World, size: FloatArray, _: Knobs) -> None:
        for name in names:
            setattr(world, name, getattr(world, name) * (1 + size))

    return act


def while_driving(act: Callable[[Moment, World, FloatArray, Knobs], None]) -> Act:
    """Return the act of an effect that acts at each moment of the drive."""
    return lambda world, size, knobs: world.during.append(lambda now: act(now, world, size, knobs))


@dataclass(frozen=True, slots=True)
class Form:
    """One form of one effect."""

    effect: str  #: id of the effect; those outside any library begin with ``outside:``
    form: str  #: name of the form; ``plain`` is the textbook's
    typical: float  #: typical size
    unit: str  #: of the size
    act: Act
    #: what a design must have for the effect to be there at all: ``loads``, ``offsets``, ``turns``, ``speeds``,
    #: ``temperatures``, ``dwell``, ``sessions``, ``directions``, ``corridor``, ``laser``, ``poses``, ``front``,
    #: ``flying``, ``stops``, ``slope`` (truth and model share a load law), ``trace``, ``lanes``, ``lengths``,
    #: ``outside``, ``no_logs``, ``column:<name>``, ``bends`` (several radii of turn)
    needs: frozenset[str] = frozenset()
    knobs: Draw = _NO_KNOBS  #: what else there is to choose, once a case


@dataclass(frozen=True, slots=True)
class Cause:
    """An effect with its size, as it truly acts in a case."""

    effect: str
    size: float  #: in the form's unit
    form: str = "plain"
    knobs: Knobs = field(default_factory=dict)  #: what else was drawn
