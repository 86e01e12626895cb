"""Which calibration parameters are off beside some effects: posterior probability of each subset of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Final

import numpy as np

from calib.gap.effects import Form
from calib.gap.effects.radii import DIRECTIONS, NAMES, OF_WHEELS, TYPICAL
from calib.gap.inference import EVEN_PROBABILITY
from calib.gap.inference.fit import CALIBRATION_SD, by_form
from calib.gap.inference.least_squares import LinearSystem, Weighting, prior_precision
from calib.gap.inference.local_search import TOLERANCE, SearchResult
from calib.gap.inference.marginal_likelihood import effect_scale, log_evidence_parts, log_marginal
from calib.gap.inference.scalar_products import FURTHER, SCALE_CHOICE_COST
from calib.types import FloatArray

#: prior odds of each being off by itself
PRIOR_SHIFT_ODDS: Final = 0.3
#: most that a shift of an effect's zero may have of its whitened size
ATTRIBUTED_SHIFT_SHARE: Final = 0.5
#: least prior standard deviation of a found effect's size, in typical sizes
MIN_EFFECT_SD: Final = 3.0
#: subsets of the relative calibration: both radii (0), their ratio (1), the track (2)
SUBSETS: Final = tuple(subset for count in range(4) for subset in combinations(range(3), count))
#: one wheel's radius, left (3) or right (4), alone or beside the track
_ONE_WHEEL: Final = ((3,), (4,), (2, 3), (2, 4))
#: half a 95 % interval, in standard deviations
_COVERAGE_SD: Final = 1.96
#: an alternative set is likely above this share of the best one's probability
ALTERNATIVE_ODDS: Final = 0.1
#: a less probable parameter is needless beside an alternative
NEEDLESS_PROBABILITY: Final = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class SubsetWeights:
    """Log weights beside some forms: of each of `SUBSETS`, (n_subsets,), and of a calibration left free."""

    each: FloatArray
    free: float

    @property
    def probabilities(self) -> FloatArray:
        """Of each subset, shape (n_subsets,)."""
        weight = np.exp(self.each - self.each.max())
        return np.asarray(weight / weight.sum())

    @property
    def over_free(self) -> float:
        """Log weight of all subsets over a calibration left free."""
        return float(np.logaddexp.reduce(self.each)) - self.free


def log_prior_of(count: int) -> float:
    """Return the log prior odds of one subset of so many parameters, over none being off.

    Every number is less likely than one fewer by the same odds; of so many all subsets are as likely.
    """
    if not count:
        return 0.0
    alike = sum(len(subset) == count for subset in SUBSETS + _ONE_WHEEL)
    return float(np.log(PRIOR_SHIFT_ODDS) + (count - 1) * np.log(FURTHER) - np.log(alike))


def without_unidentified(subset: tuple[int, ...], probabilities: FloatArray) -> tuple[int, ...]:
    """Return a subset without parameters that are no likelier for what was measured.

    Of what does not show only the prior is left, by which three may well be off together.

    `subset`: one of `SUBSETS`; `probabilities`: (n_subsets,).
    """
    prior = {own: np.exp(log_prior_of(len(own))) for own in SUBSETS}
    for way in _ONE_WHEEL:
        prior[_both_radii(way)] += np.exp(log_prior_of(len(way)))
    spoken = {own: float(p) / prior[own] for own, p in zip(SUBSETS, probabilities, strict=True)}
    while len(subset) > 1:
        best = max((tuple(k for k in subset if k != own) for own in subset), key=lambda fewer: spoken[fewer])
        if spoken[best] < spoken[subset]:
            break
        subset = best
    return subset


def _both_radii(way: tuple[int, ...]) -> tuple[int, ...]:
    return (0, 1, *way[:-1])


def free_estimates(
    system: LinearSystem, model: Sequence[int], weighting: Weighting
) -> tuple[list[FloatArray], FloatArray, FloatArray]:
    """Return each form's size in typical sizes, the relative calibration (3,), and the covariance, all free.

    It is that of left radius, right radius, track and front radius, relative, and the sizes.
    """
    columns = system.columns_of(model)
    estimates, covariance = weighting.solve(columns, prior_precision(columns.shape[1]))
    sizes = by_form([system.forms[k] for k in model], estimates)
    units = np.concatenate([CALIBRATION_SD, np.ones(len(estimates) - 4)])
    return sizes, OF_WHEELS @ (estimates[:3] * CALIBRATION_SD[:3]), covariance * np.outer(units, units)


def _reaches(form: Form, shift: FloatArray, size: float, value: float, covariance: FloatArray) -> bool:
    """Return whether another zero point of a one-parameter form can make a shift, by its 95 % interval.

    `shift`: of left radius, right radius and track, per unit; `covariance`: (4, 4), of the three and the size.
    """
    for end, side in zip(form.zero_within, (-1.0, 1.0), strict=True):
        if np.isfinite(end):
            slope = np.append(shift, end * form.typical)
            beyond = -side * np.sign(size) * (value + slope[-1] * size)
            if beyond > _COVERAGE_SD * np.sqrt(slope @ covariance @ slope):
                return False
    return True


def weigh_subsets(
    system: LinearSystem,
    model: Sequence[int],
    sizes: Sequence[FloatArray],
    values: FloatArray,
    covariance: FloatArray,
    shifts: Mapping[str, tuple[str, ...]],
    gains: FloatArray | float = 0.0,
) -> SubsetWeights:
    """Weigh the subsets of the calibration's parameters beside some forms.

    Parameters
    ----------
    system
    model
        Forms, by their numbers in the system.
    sizes
        Size of each, in typical sizes.
    values, covariance
        Relative size of each calibration parameter, all free, shape (3,); with front radius and sizes.
    shifts
        Calibration parameters that another zero point of each effect would look like.
    gains : shape (2, n_scales)
        Of log weights beside no effect where the noise's scales are open: as believed, and recalibrated.
    """
    directions = (system.calibration / CALIBRATION_SD) @ DIRECTIONS.T
    norm = np.maximum(np.sqrt((directions**2).sum(axis=0)), 1e-12)
    fixed = [system.calibration[:, 3:]]
    deviations = np.zeros((len(system.gap), len(model)))
    first = 4
    for place, (number, size) in enumerate(zip(model, sizes, strict=True)):
        form = system.forms[number]
        contribution = system.of(number) @ size
        fixed.append(system.of(number) * max(effect_scale(size, form), MIN_EFFECT_SD))
        deviations[:, place] = TOLERANCE * contribution
        looks_like = [NAMES.index(name) for name in shifts.get(form.effect, ())]
        joint = covariance[np.ix_([0, 1, 2, first], [0, 1, 2, first])]
        first += len(size)
        if looks_like and not _reaches(form, OF_WHEELS[looks_like[0]], size[0], values[looks_like[0]], joint):
            continue
        fixed.append((directions / norm)[:, looks_like] * (ATTRIBUTED_SHIFT_SHARE * np.sqrt((contribution**2).sum())))
    ways = np.concatenate([DIRECTIONS, np.eye(4)[:2]])
    typical = np.concatenate([TYPICAL, TYPICAL[:1], TYPICAL[:1]])
    times = np.concatenate([values, (values @ DIRECTIONS)[:2]]) / typical
    per_way = (system.calibration / CALIBRATION_SD) @ ways.T * typical
    columns = np.concatenate([per_way, system.calibration[:, :3]], axis=1)
    sums = system.sums_of(columns, np.concatenate(fixed, axis=1), deviations)

    held, free = np.broadcast_to(0.0 if len(model) else gains, (2, len(sums.log_prior)))

    def weight(picked: Sequence[int], scale: float) -> float:
        gram, right = sums.gram[:, picked][:, :, picked], sums.right[:, picked]
        log_det, gain = log_evidence_parts(gram, right, np.full(len(picked), scale**2))
        value = log_marginal(sums.square - gain, sums.log_det + log_det, sums.n_rows)
        return float(np.logaddexp.reduce(value + sums.log_prior + (free if len(picked) else held)))

    def of_subset(subset: tuple[int, ...]) -> float:
        if not subset:
            return weight([], 1.0)
        scale = float(np.clip(np.sqrt(np.mean(times[[*subset]] ** 2)), 0.1, 10.0))
        return weight([*subset], scale) + log_prior_of(len(subset)) - SCALE_CHOICE_COST

    weights = {subset: of_subset(subset) for subset in SUBSETS + _ONE_WHEEL}
    for subset in _ONE_WHEEL:
        both = _both_radii(subset)
        weights[both] = float(np.logaddexp(weights[both], weights[subset]))
    return SubsetWeights(np.array([weights[subset] for subset in SUBSETS]), weight([5, 6, 7], 1.0))


@dataclass(frozen=True, slots=True, eq=False)
class Recalibration:
    """Which calibration parameters are off."""

    subsets: tuple[tuple[str, ...], ...]  #: all of `NAMES`, best first
    probabilities: FloatArray  #: shape (n_subsets,)
    #: shape (3,): relative size of each, all free, and its standard uncertainty
    values: FloatArray
    sd: FloatArray
    signal: FloatArray  #: shape (3,): whitened norm of each
    instead: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  #: other likely effects that need it not off
    #: most probable subset, with likely substitutes of an effect; if empty, all likelier off than not, if the runs show
    #: them
    likeliest: tuple[str, ...] = ()
    #: the same where no effect is named and something has to be off
    needed: tuple[str, ...] = ()

    def probability(self, name: str) -> float:
        """Return the probability that a parameter is off."""
        return float(sum(p for s, p in zip(self.subsets, self.probabilities, strict=True) if name in s))


def judge_recalibration(search: SearchResult, shifts: Mapping[str, tuple[str, ...]]) -> Recalibration:
    """Weigh the subsets of the calibration's parameters, beside each likely set of effects that `search` has.

    For `shifts` see `weigh_subsets`.
    """
    fitted, gains = search.fitted, search.gains
    if fitted.path.s.calibration_held:
        held = np.zeros(len(NAMES))
        subsets = tuple(tuple(NAMES[k] for k in subset) for subset in SUBSETS)
        return Recalibration(subsets, np.eye(len(SUBSETS))[0], held, held, held)
    system = LinearSystem(fitted, search.system.nominal, search.system.noise, fitted.forms)
    own = [theta / form.typical for form, theta, _ in fitted.each()]
    values = OF_WHEELS @ fitted.calibration[:3]
    sd = np.sqrt(np.diag(OF_WHEELS @ fitted.covariance[:3, :3] @ OF_WHEELS.T))
    units = np.concatenate([np.ones(4), *(form.typical for form in fitted.forms)])
    covariance = fitted.covariance / np.outer(units, units)
    of_own = weigh_subsets(system, range(len(own)), own, values, covariance, shifts, gains)
    weighed = [(1.0, of_own.probabilities)]
    for model, weight in search.alternatives:
        free = free_estimates(search.system, model, search.weighting)
        weighed.append((weight, weigh_subsets(search.system, model, *free, shifts, gains).probabilities))
    instead = {name: _instead(k, search, weighed) for k, name in enumerate(NAMES)}
    total = sum(weight for weight, _ in weighed)
    probability = np.asarray(sum(weight * beside for weight, beside in weighed)) / total
    order = np.argsort(-probability, kind="stable")
    likeliest = needed = SUBSETS[int(order[0])]
    if own and not likeliest:
        likeliest = _with_substitutes(search, weighed, instead)
    if not likeliest:
        off = [float(sum(p for s, p in zip(SUBSETS, probability, strict=True) if k in s)) for k in range(3)]
        likeliest = needed = tuple(k for k in range(3) if off[k] > EVEN_PROBABILITY)
    if not likeliest:
        beside_own = int(np.argmax(weighed[0][1]))
        needed = SUBSETS[beside_own] if probability[beside_own] > ALTERNATIVE_ODDS else ()
        if not needed and probability[order[0]] < EVEN_PROBABILITY:
            needed = SUBSETS[int(order[1])]
    norm = np.sqrt((((system.calibration / CALIBRATION_SD) @ DIRECTIONS.T) ** 2).sum(axis=0))
    return Recalibration(
        subsets=tuple(tuple(NAMES[k] for k in SUBSETS[int(number)]) for number in order),
        probabilities=probability[order],
        values=values,
        sd=sd,
        signal=np.maximum(norm, 1e-12) * np.abs(values),
        instead=instead,
        likeliest=tuple(NAMES[k] for k in without_unidentified(likeliest, probability)),
        needed=tuple(NAMES[k] for k in without_unidentified(needed, probability)),
    )


def _with_substitutes(
    search: SearchResult, weighed: Sequence[tuple[float, FloatArray]], instead: Mapping[str, tuple[str, ...]]
) -> tuple[int, ...]:
    # each alias of a parameter takes a part of its probability
    own, beside_own = {*search.effects}, weighed[0][1]
    total, aliases = beside_own.copy(), own.union(*instead.values())
    for (model, weight), (_, probability) in zip(search.alternatives, weighed[1:], strict=True):
        effects = {search.system.forms[k].effect for k in model}
        total += weight * (beside_own if own <= effects <= aliases else probability)
    return SUBSETS[int(np.argmax(total))]


def _instead(parameter: int, search: SearchResult, weighed: Sequence[tuple[float, FloatArray]]) -> tuple[str, ...]:
    holds = np.array([parameter in subset for subset in SUBSETS])
    own, effects = {*search.effects}, dict[str, None]()
    for (model, weight), (_, probability) in zip(search.alternatives, weighed[1:], strict=True):
        extra = {search.system.forms[k].effect for k in model} - own
        if weight > ALTERNATIVE_ODDS and len(extra) == 1 and probability[holds].sum() < NEEDLESS_PROBABILITY:
            effects |= dict.fromkeys(extra)
    return tuple(effects)
