"""Directions in which parameters err each for reasons of its own, and the degrees of freedom of what they make."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.arrays import FloatArray

#: a length that turns show only beside a radius -> these radii, of which the mean counts
_BESIDE: Final[Mapping[str, tuple[str, ...]]] = {
    "track_m": ("radius_left_m", "radius_right_m"),
    "wheelbase_m": ("front_radius_m",),
    "half_length_plus_half_width_m": ("wheel_radius_m",),
}
_WHEELS: Final = ("radius_left_m", "radius_right_m")


@dataclass(frozen=True, slots=True, eq=False)
class Freedom:
    """How well the standard deviations themselves are known."""

    #: rows: sums of parameters that err independently of one another, about, shape (n_parameters, n_parameters)
    directions: FloatArray
    #: standard deviation of each, shape (n_parameters,)
    std: FloatArray
    #: degrees of freedom of that standard deviation, shape (n_parameters,)
    dof: FloatArray

    def of(self, contrast: FloatArray) -> float:
        """Return the degrees of freedom of the variance of a sum of parameters (Welch and Satterthwaite)."""
        parts = np.square(np.linalg.solve(self.directions.T, contrast) * self.std)
        return float(parts.sum() ** 2 / max(float(np.sum(np.square(parts) / self.dof)), 1e-300))


def own_directions(names: Sequence[str], values: FloatArray) -> FloatArray:
    """Return what distances and turns show apart from one another: mean radius, ratios of radii and lengths.

    What turns show, they show by headings, whose errors follow another law along the way than those of distances.

    `values` (shape (n,)). Shape (n, n): a row a direction, of full rank.
    """
    at = {name: number for number, name in enumerate(names)}
    out = np.eye(len(names))
    for name, radii in _BESIDE.items():
        if name in at and all(radius in at for radius in radii):
            places = [at[radius] for radius in radii]
            out[at[name], places] = -values[at[name]] / values[places].sum()
    if all(name in at for name in _WHEELS):
        left, right = (at[name] for name in _WHEELS)
        out[left, [left, right]] = 0.5
        out[right, [left, right]] = -1.0 / values[left], 1.0 / values[right]
    return out
