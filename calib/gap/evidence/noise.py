"""The noise of each unit: its covariance over the channels, with scales taken from what was driven alike.

Heading noise along a path becomes lateral error at its end, so the channels of a unit are correlated, each unit in its
own way. The covariance is a sum of known shapes; their scales are found by restricted maximum likelihood from what
differs between units driven alike, after a mean in each channel and a calibration of each group's own are removed.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Final

import numpy as np

from calib.arrays import FloatArray
from calib.gap.data.channels import Channel
from calib.gap.evidence.floor_support import FEWEST_DOF, MOST_EXCESS, Basis, Support, bases
from calib.gap.evidence.noise_kernels import COMPONENTS, MEDIANS
from calib.gap.evidence.noise_scales import Grouped, NoiseShapes, ScaleLikelihood, most_likely, thinned_groups
from calib.gap.evidence.window_growth import Growth, window_growth
from calib.gap.predict.path import Path

#: fewest units for which stated sigmas alone are a floor
FEWEST_UNITS: Final = 4
#: a floor so many times the stated one is said first
FAR_ABOVE: Final = 4.0
#: a floor of windows about as large as the stated one needs no more support
AS_STATED: Final = 2.0
#: a larger one may exceed what grows as noise does by this factor
MOST_GROWTH: Final = 2.0


@dataclass(frozen=True, eq=False)
class Noise:
    """Covariance of every unit, and what it rests on.

    Parameters
    ----------
    covariance : array of float, shape (n_units, 6, 6)
        Over (distance, along, lateral, heading, front, steering); unit variance where a channel is missing.
    scales : mapping of str to float
        Scale of each component.
    dof : float
        Degrees of freedom that units driven alike give it; 0 where the stated instruments carry it.
    weight : array of float, shape (n_units,)
        1 for ordinary units, less for those far from their repeats.
    supported : bool
        Whether these runs support a floor at all.
    support : str
        What supports it, in words; where nothing does, why.
    excess : array of float, shape (6,)
        Floor over the floor by the stated sigmas and typical walks, the median over the units; NaN where no unit has
        the channel.
    """

    covariance: FloatArray
    scales: dict[str, float]
    dof: float
    weight: FloatArray
    supported: bool = True
    support: str = ""
    excess: FloatArray = field(default_factory=lambda: np.full(6, np.nan))

    @property
    def finding(self) -> str:
        """What to say first where the floor is far above the stated sigmas, a sentence; else an empty text."""
        most = int(np.nanargmax(self.excess)) if np.isfinite(self.excess).any() else 0
        if not (self.supported and self.excess[most] > FAR_ABOVE):
            return ""
        return (
            f"Runs driven alike scatter in the {Channel(most).label} channel {self.excess[most]:.0f} times as much as "
            "the stated sigmas and typical wheels would: the floor itself is a finding."
        )

    @cached_property
    def whitener(self) -> FloatArray:
        """Inverse Cholesky factor of each unit's covariance, shape (n_units, 6, 6)."""
        return np.linalg.inv(np.linalg.cholesky(self.covariance))

    @property
    def floor(self) -> FloatArray:
        """Standard deviation of each channel in each unit, shape (n_units, 6)."""
        deviation: FloatArray = np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))
        return deviation


def estimate_noise(path: Path, gap: FloatArray, *, start: Noise | None = None) -> Noise:
    """Estimate the noise from units driven alike.

    These are units of one cell where there are enough of them; else of one condition, with a trend on temperature,
    dwell, session and further columns removed; else neighbours in the order driven; else runs of one route with their
    loads and speeds as trends; at last the stated sigmas stand alone. Where the first of these supports no floor,
    repeats with fewer degrees of freedom do, if there are any.

    Parameters
    ----------
    path : Path
        Where the gap was taken.
    gap : array of float, shape (n_units, 6)
        Measured minus predicted.
    start : Noise, optional
        An estimate about another path, to begin at.

    Returns
    -------
    Noise
        Covariances and the scales behind them. Scales that repeats do not determine keep their prior, which is
        the instruments' stated uncertainty for the first three.
    """
    shapes = NoiseShapes.about(path)
    begin = np.log(MEDIANS)
    if start is not None:
        known = [start.scales.get(name, median) for name, median, _ in COMPONENTS]
        begin = np.log(np.maximum(known, 1e-300))
    first = None
    for support in bases(path):
        grouped = Grouped.by(support.labels)
        if len(grouped.units) == 0:
            continue
        whole = ScaleLikelihood(path, gap, shapes, grouped, support.trend)
        if whole.dof < support.dof:
            continue
        log_scale, weight = _scales(path, gap, shapes, grouped, support, whole, begin)
        noise = _noise(path, shapes, log_scale, weight, support.basis, whole.dof)
        if noise.supported and (first is None or support.basis is Basis.REPEATS):
            return noise
        # many units are worth nothing where what they differ by cannot be told from a gap: then repeats alone count
        first = first or noise
    return first or _noise(path, shapes, np.log(MEDIANS), np.ones(len(gap)), Basis.STATED, 0.0)


def _noise(
    path: Path, shapes: NoiseShapes, log_scale: FloatArray, weight: FloatArray, basis: Basis, dof: float
) -> Noise:
    """Return the noise of these scales, shape (n_components,), and weights (n_units,), and whether it is supported."""
    covariance = shapes.covariance(log_scale, weight)
    scales = {
        name: float(np.exp(v)) for (name, _, _), v, on in zip(COMPONENTS, log_scale, shapes.active, strict=True) if on
    }
    excess = _excess(shapes, covariance)
    supported, words = _support(path, covariance, basis, dof, excess)
    return Noise(covariance, scales, dof, weight, supported, words, excess)


def _scales(
    path: Path,
    gap: FloatArray,
    shapes: NoiseShapes,
    grouped: Grouped,
    support: Support,
    whole: ScaleLikelihood,
    begin: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return the logarithms of the most likely scales and the weights (n_units,), less far from their repeats."""
    some = thinned_groups(grouped)
    part = whole if some is grouped else ScaleLikelihood(path, gap, shapes, some, support.trend)
    if part.dof < FEWEST_DOF:
        part = whole
    best = most_likely(part, begin)
    weight = np.ones(len(gap))
    weight[grouped.units] = whole.weights(best)
    return best, weight


def _excess(shapes: NoiseShapes, covariance: FloatArray) -> FloatArray:
    """Return the floor over that of the stated sigmas, the median over the units, shape (6,)."""
    usable = shapes.usable
    stated = shapes.covariance(np.log(MEDIANS), np.ones(len(usable)))
    ratio = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2) / np.diagonal(stated, axis1=1, axis2=2))
    return np.array([float(np.median(ratio[on, k])) if (on := usable[:, k]).any() else np.nan for k in range(6)])


def _support(path: Path, covariance: FloatArray, basis: Basis, dof: float, excess: FloatArray) -> tuple[bool, str]:
    """Return whether a floor is supported, and by what or why not."""
    if basis is Basis.STATED:
        if path.s.sigmas_assumed:
            return False, str(Basis.NOTHING)
        if len(path.s) < FEWEST_UNITS:
            return False, f"nothing: {len(path.s)} runs, none driven twice"
        return True, str(basis)
    counted = f"{basis} ({dof:.0f} degrees of freedom)"
    if basis is Basis.REPEATS:
        return True, counted
    most = float(np.nanmax(excess))
    if most > MOST_EXCESS:
        return (
            False,
            f"nothing: {counted} scatter {most:.3g} times as much as the stated sigmas, and no repeats say why",
        )
    if most <= AS_STATED or basis is not Basis.WINDOWS:
        return True, counted
    return _by_growth(path, covariance, counted, window_growth(path))


def _by_growth(path: Path, covariance: FloatArray, counted: str, growth: Growth | None) -> tuple[bool, str]:
    """Return whether the floor of windows, above the stated one, grows with their length as noise does."""
    if growth is None:
        return False, f"nothing: {counted} scatter more than stated, and there are too few to see how that grows"
    # a walk of the heading leads the place astray by the length to the power of three halves: the heading alone tells
    heading = Channel.HEADING
    floor = float(np.sqrt(covariance[path.s.usable[:, heading], heading, heading].mean()))
    if floor > MOST_GROWTH * growth.noise_rms[2]:
        return False, f"nothing: what differs between {counted} grows in proportion to their length, as no noise does"
    return True, f"{counted}, of {growth.length_m[0]:.2g} to {growth.length_m[-1]:.2g} m"
