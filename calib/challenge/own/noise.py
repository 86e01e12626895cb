"""A campaign's own noise: what its own diagnosis leaves, drawn again among what was driven alike."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.arrays import BoolArray, FloatArray, IntArray
from calib.gap.data.observations import Observations

#: with fewer units to draw from, the draws repeat one another: the next wider circle is taken
ENOUGH: Final = 8


@dataclass(frozen=True, slots=True, eq=False)
class OwnNoise:
    """What is left of each unit after the diagnosis' fit, in its own standard deviations, and who may stand in for it.

    A unit's channels stay together, so that tails and correlations are the real ones. What the repeats of a condition
    have in common is no noise and is taken out; a unit that has no repeats keeps what is left of it, with either sign.
    """

    #: shape (n_units, 6): residuals of distance, along, lateral, heading, front, steering, whitened by the unit's own
    #: covariance
    whitened: FloatArray
    root: FloatArray  #: shape (n_units, 6, 6): cholesky factor of each unit's covariance
    group: IntArray  #: shape (n_units,): units of one number stand in for one another
    repeated: BoolArray  #: shape (n_units,): units that have repeats

    def draw(self, rng: np.random.Generator) -> FloatArray:
        """Return one draw, shape (n_units, 6), in metres and radians."""
        n_units = len(self.group)
        chosen = np.arange(n_units)
        for number in np.unique(self.group):
            members = np.flatnonzero(self.group == number)
            chosen[members] = rng.choice(members, len(members))
        sign = np.where(self.repeated[chosen], 1.0, rng.choice([-1.0, 1.0], n_units))
        drawn: FloatArray = np.einsum("uij,uj->ui", self.root, self.whitened[chosen] * sign[:, None])
        return drawn


def own_noise(observations: Observations, left: FloatArray, covariance: FloatArray) -> OwnNoise:
    """Return the noise of a campaign, of what its fit leaves (n_units, 6) under its covariance (n_units, 6, 6).

    Units of one condition stand in for one another, where there are enough of them; else those of one route, else those
    with the same channels.
    """
    channels = observations.usable @ (2 ** np.arange(6))
    circles = [_numbered(by, channels) for by in (observations.condition, observations.kind, np.zeros_like(channels))]
    group = circles[2] + circles[0].max() + circles[1].max() + 2
    for offset, circle in ((circles[0].max() + 1, circles[1]), (0, circles[0])):
        group = np.where(np.bincount(circle)[circle] >= ENOUGH, circle + offset, group)
    root = np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
    kept = np.where(observations.usable, left, 0.0)[:, :, None]
    whitened = np.asarray(np.linalg.solve(root, kept)[:, :, 0], dtype=np.float64)
    size = np.bincount(circles[0])[circles[0]]
    for number in np.flatnonzero(np.bincount(circles[0]) > 1):
        members = circles[0] == number
        n = int(members.sum())
        whitened[members] = (whitened[members] - whitened[members].mean(axis=0)) * np.sqrt(n / (n - 1))
    return OwnNoise(whitened, root, group, size > 1)


def _numbered(by: IntArray, channels: IntArray) -> IntArray:
    """Return a number for each unit, the same where both arrays (n_units,) agree."""
    numbers: IntArray = np.unique(by.astype(np.int64) * 64 + channels, return_inverse=True)[1]
    return numbers
