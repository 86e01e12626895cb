"""Which of the three calibration parameters is really off, given the other effects that were found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from calib.arrays import FloatArray
from calib.gap.effects.calibration import DIRECTIONS, NAMES
from calib.gap.evidence.climb import Settings
from calib.gap.evidence.fit import Fitted
from calib.gap.evidence.marginal import CALIBRATION_SD
from calib.gap.evidence.noise import Noise
from calib.gap.evidence.search import EVEN, Search
from calib.gap.evidence.subsets import SUBSETS, sizes_beside, weigh_subsets, without_idle
from calib.gap.evidence.system import LinearSystem
from calib.gap.predict.path import Path


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
    instead : mapping of str to tuple of str
        For each, effects of other likely sets beside which it is hardly off.
    likeliest : tuple of str
        The likeliest subset, or where that is empty all that is likelier off than not, without what the runs say
        nothing of.
    needed : tuple of str
        The same where something of it has to be off, because no effect is named: where none is the likeliest, what is
        beside the best hypothesis alone or, where one is likelier off than not, the next.
    """

    subsets: tuple[tuple[str, ...], ...]
    probabilities: FloatArray
    values: FloatArray
    sd: FloatArray
    signal: FloatArray
    instead: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    likeliest: tuple[str, ...] = ()
    needed: tuple[str, ...] = ()

    def probability(self, name: str) -> float:
        """Return the probability that one of the three is off."""
        return float(sum(p for s, p in zip(self.subsets, self.probabilities, strict=True) if name in s))


#: a rival set is as likely as the best where it has more than this share of its probability
LIKELY: Final = 0.1
#: a calibration parameter less probable than this beside a rival set is needless there
NEEDLESS: Final = 0.2


def judge_recalibration(
    fitted: Fitted,
    nominal: Path,
    noise: Noise,
    settings: Settings,
    shifts: Mapping[str, tuple[str, ...]] | None = None,
    search: Search | None = None,
) -> Recalibration:
    """Weigh the subsets of the calibration's parameters against each other.

    Where other sets of effects are likely too, the calibration is judged beside each of them.

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
    search : Search, optional
        Has the other sets of effects.

    Returns
    -------
    Recalibration
    """
    system = LinearSystem(fitted, nominal, noise, fitted.forms)
    own = [theta / form.typical for form, theta in zip(fitted.forms, fitted.theta, strict=True)]
    matrix = DIRECTIONS[:, :3].T
    values = np.linalg.solve(matrix, fitted.calibration[:3])
    inverse = np.linalg.inv(matrix)
    sd = np.sqrt(np.diag(inverse @ fitted.covariance[:3, :3] @ inverse.T))
    shifts = shifts or {}
    weighed = [(1.0, weigh_subsets(system, range(len(own)), own, values, settings, shifts).probabilities)]
    for model, weight in search.rivals if search is not None else ():
        assert search is not None
        whole = search.system
        sizes, theirs = sizes_beside(whole, model, search.weighting)
        weighed.append((weight, weigh_subsets(whole, model, sizes, theirs, settings, shifts).probabilities))
    instead = {name: _instead(k, fitted, search, weighed) for k, name in enumerate(NAMES)}
    total = sum(weight for weight, _ in weighed)
    probability = np.asarray(sum(weight * beside for weight, beside in weighed)) / total
    order = np.argsort(-probability, kind="stable")
    likeliest = needed = SUBSETS[int(order[0])]
    if not likeliest:
        # what is likelier off than not may be divided among sets with parameters that the runs say nothing of
        off = [float(sum(p for s, p in zip(SUBSETS, probability, strict=True) if k in s)) for k in range(3)]
        likeliest = needed = tuple(k for k in range(3) if off[k] > EVEN)
    if not likeliest:
        beside_own = int(np.argmax(weighed[0][1]))
        # needless beside another cause, which is not the one at hand
        needed = SUBSETS[beside_own] if probability[beside_own] > LIKELY else ()
        if not needed and probability[order[0]] < EVEN:
            needed = SUBSETS[int(order[1])]
    norm = np.sqrt((((system.calibration / CALIBRATION_SD) @ DIRECTIONS.T) ** 2).sum(axis=0))
    return Recalibration(
        subsets=tuple(tuple(NAMES[k] for k in SUBSETS[int(number)]) for number in order),
        probabilities=probability[order],
        values=values,
        sd=sd,
        signal=np.maximum(norm, 1e-12) * np.abs(values),
        instead=instead,
        likeliest=tuple(NAMES[k] for k in without_idle(likeliest, probability, settings)),
        needed=tuple(NAMES[k] for k in without_idle(needed, probability, settings)),
    )


def _instead(
    parameter: int, fitted: Fitted, search: Search | None, weighed: Sequence[tuple[float, FloatArray]]
) -> tuple[str, ...]:
    """Return single effects of likely rivals that make a calibration parameter needless."""
    if search is None:
        return ()
    holds = np.array([parameter in subset for subset in SUBSETS])
    own = {form.effect for form in fitted.forms}
    effects: list[str] = []
    for (model, weight), (_, probability) in zip(search.rivals, weighed[1:], strict=True):
        extra = {search.system.forms[k].effect for k in model} - own
        if weight > LIKELY and len(extra) == 1 and probability[holds].sum() < NEEDLESS:
            effects += extra
    return tuple(dict.fromkeys(effects))
