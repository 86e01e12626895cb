"""Which of the three calibration parameters is really off, given the other effects that were found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np

from calib.arrays import FloatArray
from calib.gap.effects.calibration import DIRECTIONS, NAMES, TYPICAL
from calib.gap.evidence.fit import Fitted
from calib.gap.evidence.marginal import CALIBRATION_SD, Nuisance, log_marginal
from calib.gap.evidence.noise import Noise
from calib.gap.evidence.search import SCALE_COST, Settings, effect_scale
from calib.gap.evidence.whitened import WhitenedSystem
from calib.gap.predict.path import Path

__all__ = ["PRIOR", "Recalibration", "judge_recalibration"]

#: prior odds of each being off
PRIOR: Final = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Recalibration:
    """Which calibration parameters are off.

    Parameters
    ----------
    subsets : tuple of tuple of str
        All subsets of `NAMES`, best first.
    probabilities : array of float, shape (n_subsets,)
        Their posterior probabilities.
    values, sd : array of float, shape (3,)
        Relative size of each, all three free, and its standard uncertainty.
    signal : array of float, shape (3,)
        Whitened norm of each at its fitted size.
    """

    subsets: tuple[tuple[str, ...], ...]
    probabilities: FloatArray
    values: FloatArray
    sd: FloatArray
    signal: FloatArray

    def probability(self, name: str) -> float:
        """Return the probability that one of the three is off."""
        return float(sum(p for s, p in zip(self.subsets, self.probabilities, strict=True) if name in s))


def judge_recalibration(
    fitted: Fitted,
    nominal: Path,
    noise: Noise,
    settings: Settings,
    shifts: Mapping[str, tuple[str, ...]] | None = None,
    *,
    excuse: float = 0.5,
) -> Recalibration:
    """Weigh the subsets of the calibration's parameters against each other.

    A found effect may be centred elsewhere than assumed, or deviate from its form; a shift of the calibration up to
    `excuse` times the effect's own size counts as part of the effect.

    Parameters
    ----------
    fitted : Fitted
        Fit of the effects found, the recalibration free.
    nominal : Path
        The model alone.
    noise : Noise
        Covariance of each unit.
    settings : Settings
        What the search takes for granted.
    shifts : mapping of str to tuple of str, optional
        For each effect, the calibration parameters that another zero point of it would look like.
    excuse : float
        Share of an effect's whitened size that a calibration shift may have and still belong to it.

    Returns
    -------
    Recalibration
    """
    bench = WhitenedSystem(fitted.path, nominal, noise)
    per_unit = bench.calibration / CALIBRATION_SD
    y = bench.gap + per_unit @ fitted.calibration
    directions = per_unit @ DIRECTIONS.T
    norm = np.maximum(np.sqrt((directions**2).sum(axis=0)), 1e-12)
    fixed = [bench.calibration[:, 3:]]
    for form, theta in zip(fitted.forms, fitted.theta, strict=True):
        signature = bench.columns(form)
        sizes = theta / form.typical
        contribution = signature @ sizes
        y = y + contribution
        fixed += [
            signature * max(effect_scale(sizes, form), 3.0),
            settings.tolerance * bench.by_condition(contribution),
        ]
        looks_like = [NAMES.index(name) for name in (shifts or {}).get(form.effect, ())]
        fixed.append((directions / norm)[:, looks_like] * (excuse * np.sqrt((contribution**2).sum())))
    matrix = DIRECTIONS[:, :3].T
    values = np.linalg.solve(matrix, fitted.calibration[:3])
    inverse = np.linalg.inv(matrix)
    sd = np.sqrt(np.diag(inverse @ fitted.covariance[:3, :3] @ inverse.T))
    weights, subsets = [], []
    for size in range(4):
        for chosen in combinations(range(3), size):
            nuisance = Nuisance.of(
                np.concatenate(
                    [
                        *fixed,
                        *(
                            directions[:, [k]] * TYPICAL[k] * float(np.clip(abs(values[k]) / TYPICAL[k], 0.1, 10.0))
                            for k in chosen
                        ),
                    ],
                    axis=1,
                )
            )
            square = nuisance.scalar(y[:, None], y[:, None])[0, 0]
            value = float(log_marginal(square, nuisance.log_det, len(y))) - SCALE_COST * size
            weights.append(settings.temper * value + size * np.log(PRIOR))
            subsets.append(tuple(NAMES[k] for k in chosen))
    order = np.argsort(-np.array(weights))
    weight = np.exp(np.array(weights)[order] - max(weights))
    return Recalibration(
        subsets=tuple(subsets[int(k)] for k in order),
        probabilities=weight / weight.sum(),
        values=values,
        sd=sd,
        signal=norm * np.abs(values),
    )
