"""What each wheel's travel explains of the gap, beside the other wheel's."""

from __future__ import annotations

from typing import Final

import numpy as np

from calib.arrays import FloatArray
from calib.gap.data.channels import N_CHANNELS
from calib.gap.evidence.marginal import CALIBRATION_SD, rows
from calib.gap.evidence.noise import Noise
from calib.gap.predict.path import Path
from calib.gap.where.covariates import FEWEST_UNITS
from calib.gap.where.dependence import interval
from calib.gap.where.result import CovariateLine

BOOTSTRAPS: Final = 300
#: wheels whose travel is correlated by more cannot be asked beside each other
MOST_ALIKE: Final = 0.9999


def dependence_on_wheels(nominal: Path, noise: Noise, gap: FloatArray, rng: np.random.Generator) -> list[CovariateLine]:
    """Return what left and right wheel's travel explain of the gap (n_units, n_channels), one beside the other.

    Of all channels together; empty where the wheels cannot be told apart.
    """
    from scipy.special import fdtrc

    products, sizes = _products(nominal, noise, gap)
    whole = products.sum(axis=0)
    norm = np.sqrt(np.diag(whole)[:2])
    if sizes.sum() < FEWEST_UNITS or not (norm > 0).all() or abs(whole[0, 1]) > MOST_ALIKE * norm[0] * norm[1]:
        return []
    n_units, n = len(sizes), float(sizes.sum())
    draws = rng.multinomial(n_units, np.full(n_units, 1.0 / n_units), BOOTSTRAPS).astype(np.float64)
    lines = []
    for wheel, name in enumerate(("left wheel", "right wheel")):
        explained, rest = _beside(whole[None], wheel)
        residual = max(float(rest[0]) / max(n - 2.0, 1.0), 1.0)
        # without an intercept the test leans on the floor's own scale, known no better than repeats know it
        p = float(fdtrc(1.0, float(np.clip(noise.dof, 3.0, max(n - 2.0, 3.0))), float(explained[0]) / residual))
        share = float(_shares(whole[None], np.array([n]), wheel)[0])
        ci95 = interval(_shares(np.tensordot(draws, products, axes=1), draws @ sizes, wheel))
        lines.append(CovariateLine(name, None, share, ci95, p, significant=False, n_units=n_units))
    return lines


def _products(nominal: Path, noise: Noise, gap: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return whitened products of left travel, right travel and gap (n_units, 3, 3), and the rows of each unit."""
    usable = nominal.s.usable
    columns = np.concatenate([nominal.calibration[:, :, :2] * CALIBRATION_SD[:2], gap[:, :, None]], axis=2)
    white = rows(nominal, noise, columns)
    unit = np.repeat(np.arange(len(usable))[:, None], N_CHANNELS, axis=1)[usable]
    products = np.zeros((len(usable), 3, 3))
    np.add.at(products, unit, white[:, :, None] * white[:, None, :])
    return products, usable.sum(axis=1).astype(np.float64)


def _shares(moments: FloatArray, count: FloatArray, wheel: int) -> FloatArray:
    """Return the share beyond the floor that a wheel explains, of moments (n, 3, 3) of `count` rows (n,)."""
    explained, rest = _beside(moments, wheel)
    variance = np.maximum(rest / np.maximum(count - 2.0, 1.0), 1.0)
    beyond = moments[:, 2, 2] - count
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.clip(np.where(beyond > 0, (explained - variance) / beyond, 0.0), 0.0, 1.0)


def _beside(moments: FloatArray, wheel: int) -> tuple[FloatArray, FloatArray]:
    """Return what a wheel explains beside the other, and what both leave, of moments (n, 3, 3), each shape (n,)."""
    other = 1 - wheel
    with np.errstate(all="ignore"):
        ratio = moments[:, wheel, other] / moments[:, other, other]
        own = moments[:, wheel, wheel] - ratio * moments[:, other, wheel]
        right = moments[:, wheel, 2] - ratio * moments[:, other, 2]
        by_other = moments[:, other, 2] ** 2 / moments[:, other, other]
        explained = np.nan_to_num(right**2 / own)
    return explained, np.maximum(moments[:, 2, 2] - by_other - explained, 0.0)
