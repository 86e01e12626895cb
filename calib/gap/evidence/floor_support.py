"""What a floor can rest on: repeats, one route with its trends taken out, neighbours, windows, or stated sigmas."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np

from calib.arrays import FloatArray, IntArray
from calib.gap.evidence.trends import driven, interactions, session_steps, surroundings
from calib.gap.predict.path import Path

#: repeats with fewer degrees of freedom for each channel are joined with coarser ones
ENOUGH_PER_CHANNEL: Final = 15.0
#: and in all
ENOUGH_DOF: Final = 30.0
#: with fewer than this nothing was learnt
FEWEST_DOF: Final = 8.0
#: units of a neighbourhood, driven one after the other
NEIGHBOURHOOD: Final = 3
#: windows of a neighbourhood: enough to be compared where each has a shape of its own
WINDOWS_TOGETHER: Final = 5
#: a floor that no repeats give is believed up to so many times the stated one
MOST_EXCESS: Final = 5.0


class Basis(StrEnum):
    """What a floor rests on."""

    REPEATS = "repeats"
    ROUTE = "runs of one route, with loads and speeds taken out as trends"
    NEIGHBOURS = "differences of neighbouring runs"
    WINDOWS = "windows of recordings, each against its neighbours"
    STATED = "the stated sigmas alone, for nothing was driven twice"
    NOTHING = "nothing: nothing was driven twice, and the sigmas were assumed"


@dataclass(frozen=True, slots=True, eq=False)
class Support:
    """One way to find a floor.

    Parameters
    ----------
    basis : Basis
        What it rests on.
    labels : array of int, shape (n_units,)
        Units that are compared with each other share a number.
    trend : array of float, shape (n_units, 6, k), optional
        What may differ between them and is no noise.
    dof : float
        Degrees of freedom from which on it is taken.
    """

    basis: Basis
    labels: IntArray
    trend: FloatArray | None
    dof: float


def bases(path: Path) -> Iterator[Support]:
    """Yield the ways to find a floor, the best first, each with the degrees of freedom that make it good enough.

    Pooling all units is none of them: it would turn motion that no wheel sees into noise.

    Parameters
    ----------
    path : Path
        Where the gap is taken.
    """
    observations = path.s
    enough = max(ENOUGH_DOF, ENOUGH_PER_CHANNEL * float(observations.usable.any(axis=0).sum()))
    alike = Basis.WINDOWS if observations.windowed else Basis.REPEATS
    trend = np.concatenate([surroundings(path), *interactions(path)], axis=2)
    yield Support(alike, observations.cell, None, enough)
    yield Support(alike, observations.condition, trend, enough)
    near = Basis.WINDOWS if observations.windowed else Basis.NEIGHBOURS
    beside = neighbours(observations.condition, NEIGHBOURHOOD)
    # neighbours are alike in all but this: a session may end between them
    yield Support(near, beside, session_steps(path), enough)
    yield Support(near, beside, None, enough)
    yield Support(alike, observations.condition, trend, FEWEST_DOF)
    yield Support(alike, observations.cell, None, FEWEST_DOF)
    yield Support(near, beside, None, FEWEST_DOF)
    if observations.windowed:
        yield Support(near, neighbours(observations.run, WINDOWS_TOGETHER), None, FEWEST_DOF)
    else:
        with_loads = np.concatenate([driven(path), trend], axis=2)
        yield Support(Basis.ROUTE, observations.kind, with_loads, FEWEST_DOF)
        yield Support(Basis.ROUTE, observations.kind, driven(path), FEWEST_DOF)


def neighbours(labels: IntArray, together: int) -> IntArray:
    """Return a number for each neighbourhood of units of one label, in the order driven, shape (n_units,).

    Parameters
    ----------
    labels : array of int, shape (n_units,)
        Only units of one label are neighbours.
    together : int
        Units of a neighbourhood; what is left over joins the last.
    """
    number = np.zeros(len(labels), dtype=np.int64)
    used = 0
    for label in np.unique(labels):
        units = np.flatnonzero(labels == label)
        place = np.minimum(np.arange(len(units)) // together, max(len(units) // together - 1, 0))
        number[units] = used + place
        used += int(place[-1]) + 1
    return number
