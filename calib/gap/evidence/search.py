"""Searching sets of effects: re-linearised about each better one until settled, with the probability of each."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.arrays import FloatArray
from calib.gap.effects.effect import Effect, Form
from calib.gap.evidence.approach import approached
from calib.gap.evidence.climb import Climb, Model, Settings
from calib.gap.evidence.fit import Fitted
from calib.gap.evidence.noise import Noise
from calib.gap.evidence.subsets import SUBSETS, sizes_beside, weigh_subsets
from calib.gap.evidence.system import LinearSystem
from calib.gap.evidence.weighting import Weighting
from calib.gap.predict.path import Path

#: passes: linearise, search, fit
_PASSES: Final = 7
#: a step below this share of the standard uncertainty ends the passes
_SETTLED: Final = 0.2
#: causes fitted alone, the likeliest about the path of the recalibration, of which the best is begun with
_ALONE: Final = 3
#: models weighed together with the calibration: so many at most, those within so many nats of the best
_LIKELY: Final = 12
_LIKELY_NATS: Final = 7.0
#: what is less probable than this is likelier not to be
EVEN: Final = 0.5
#: a gap less probable than this is not reported: looking at runs once more costs less than a gap not seen
GAP: Final = 0.4
#: sets that are taken at hand, one after the other
_TURNS: Final = 5
#: beside a larger rest, the search begins again from elsewhere
_SMALL_REST: Final = 1.0


@dataclass(frozen=True, eq=False)
class Search:
    """What was found.

    Parameters
    ----------
    fitted : Fitted
        The best hypothesis, a recalibration free beside it.
    base : Fitted
        The recalibration alone.
    alone : LinearSystem
        About its path, with every form.
    system : LinearSystem
        About the best hypothesis' path, with every effect's best forms.
    forms : mapping of str to list of Form
        Forms of each effect on this campaign.
    models : tuple of tuple of str
        Sets of effects weighed, best first.
    probabilities : array of float, shape (n_models,)
        Of each set.
    rivals : tuple of (tuple of int, float)
        The best other models, by their forms' numbers in `system`, each with its probability over the best one's.
    rest : float
        Probability of a rest beside whatever else is.
    weighting : Weighting
        The most probable rest beside the best hypothesis, and what its effects may deviate by.
    nothing : float
        Probability that neither an effect nor a rest is there, a recalibration left free.
    """

    fitted: Fitted
    base: Fitted
    alone: LinearSystem
    system: LinearSystem
    forms: dict[str, list[Form]]
    models: tuple[tuple[str, ...], ...]
    probabilities: FloatArray
    rivals: tuple[tuple[Model, float], ...]
    rest: float
    weighting: Weighting
    nothing: float

    @property
    def effects(self) -> tuple[str, ...]:
        """Effects of the best hypothesis, sorted."""
        return tuple(sorted(form.effect for form in self.fitted.forms))

    def inclusion(self) -> dict[str, float]:
        """Return the probability of each effect being at work."""
        by_effect: dict[str, float] = {}
        for model, p in zip(self.models, self.probabilities, strict=True):
            for name in model:
                by_effect[name] = by_effect.get(name, 0.0) + float(p)
        return by_effect


def search(
    nominal: Path,
    noise: Noise,
    base: Fitted,
    effects: Sequence[Effect],
    settings: Settings | None = None,
    start: Search | None = None,
    passed: Callable[[], None] | None = None,
) -> Search:
    """Search the library.

    Parameters
    ----------
    nominal : Path
        The model alone.
    noise : Noise
        Covariance of each unit.
    base : Fitted
        The recalibration alone.
    effects : sequence of Effect
        The library; the calibration's own three are left to the recalibration.
    settings : Settings, optional
        What is taken for granted.
    start : Search, optional
        Where to begin, beside another floor; the recalibration alone by default.
    passed : callable, optional
        Called before each pass.
    """
    settings = settings or Settings()
    shifts = {effect.id: effect.shifts for effect in effects}
    if start is None:
        forms = {e.id: e.forms(nominal.s) for e in effects if not e.calibration}
        forms = {name: made for name, made in forms.items() if made}
    else:
        forms = start.forms
    every = [form for made in forms.values() for form in made]
    alone = LinearSystem(base, nominal, noise, every)
    begun = Climb(alone, settings)
    near = _begin_at(start, nominal, noise, begun)
    first = copy(begun) if near is base else Climb(LinearSystem(near, nominal, noise, every), settings)
    room, fitted = _settle(first, noise, every, settings, passed)
    if room.weighting().scale > _SMALL_REST and begun.offered:
        # several causes together may leave little where each alone leaves a large rest, and about a path far off the
        # true one cause looks like several: begin once without a rest, and once with the best cause fitted alone
        starts = [begun.with_only(model) for model in begun.best_alone(_ALONE)]
        starts = [_settle(start, noise, every, settings, passed, climbs=False)[0] for start in starts]
        # one that grows beyond bounds when fitted alone has no evidence
        best = max(starts, key=lambda start: np.nan_to_num(start.evidence(), nan=-np.inf))
        for other, most in ((copy(begun), _SMALL_REST), (best, np.inf)):
            settled, settled_fitted = _settle(other, noise, every, settings, passed, most=most)
            if settled.evidence() > room.evidence():
                room, fitted = settled, settled_fitted
    of_base = _weighed(begun, settings, shifts)
    room, fitted, weighed = _likeliest(
        room,
        fitted,
        of_base.nothing * of_base.as_believed < 1.0 - GAP,
        lambda other: _settle(other, noise, every, settings, passed, climbs=False),
        lambda other: _weighed(other, settings, shifts),
    )
    by_model = weighed.probability.sum(axis=0)
    by_set = room.by_effects(weighed.models, by_model)
    order = sorted(by_set, key=lambda key: -by_set[key])
    return Search(
        fitted=fitted,
        base=base,
        alone=alone,
        system=room.system,
        forms=forms,
        models=tuple(order),
        probabilities=np.array([by_set[key] for key in order]),
        rivals=room.rivals(weighed.models, by_model),
        rest=float(weighed.probability[1:].sum()),
        weighting=room.weighting(),
        nothing=of_base.nothing,
    )


def _begin_at(start: Search | None, nominal: Path, noise: Noise, begun: Climb) -> Fitted:
    """Return the hypothesis about whose path the search begins."""
    if start is not None:
        return start.fitted
    on_offer = begun.forms_of(tuple(begun.offered))
    return approached(nominal, noise, begun.system.fitted, on_offer, begun.settings.most_effects)


@dataclass(frozen=True, slots=True, eq=False)
class _Weighed:
    """The models about the best ones of one linearisation, and how probable they are."""

    models: list[Model]
    probability: FloatArray  #: shape (n_scales, n_models)
    #: probability that the calibration is what it is believed to be, if no effect is at work; 1 where that is unlikely
    as_believed: float
    #: log weight of the model at hand, all scales of the rest and all of the calibration together
    at_hand: float

    @property
    def nothing(self) -> float:
        """Probability that neither an effect nor a rest is there, a recalibration left free."""
        return float(self.probability[0, self.models.index(())])


def _weighed(room: Climb, settings: Settings, shifts: Mapping[str, tuple[str, ...]]) -> _Weighed:
    """Weigh the models about the best ones.

    The moves leave the calibration free beside every model. What is likely at the end is weighed together with which of
    the calibration's parameters it needs to be off: an effect that explains their shift too needs none.
    """
    models, weight = room.posterior()
    total = np.logaddexp.reduce(weight, axis=0)
    likely = [int(n) for n in np.argsort(-total)[:_LIKELY] if total[n] > total.max() - _LIKELY_NATS]
    weighting, over_free, as_believed = room.weighting(), dict[int, float](), 1.0
    for n in {*likely, models.index(room.current)}:
        sizes, values = sizes_beside(room.system, models[n], weighting)
        subsets = weigh_subsets(room.system, models[n], sizes, values, settings, shifts)
        over_free[n] = subsets.over_free
        if not models[n]:
            as_believed = float(subsets.probabilities[SUBSETS.index(())])
    # what is hardly likely is taken to need the calibration off as much as the neediest of the likely
    weight = weight + np.array([over_free.get(n, min(over_free.values())) for n in range(len(models))])
    probability = np.exp(weight - weight.max())
    at_hand = float(np.logaddexp.reduce(weight[:, models.index(room.current)]))
    return _Weighed(models, probability / probability.sum(), as_believed, at_hand)


def _likeliest(
    room: Climb,
    fitted: Fitted,
    something: bool,
    settle: Callable[[Climb], tuple[Climb, Fitted]],
    weigh: Callable[[Climb], _Weighed],
) -> tuple[Climb, Fitted, _Weighed]:
    """Move to the likeliest set of effects until that at hand is the likeliest about its own path, too.

    Where sets take turns, each the likeliest about the other's path, that of the fewest effects; of as many, that which
    is the likeliest about its own.
    """
    visited: dict[tuple[str, ...], tuple[Climb, Fitted, _Weighed]] = {}
    for _ in range(_TURNS):
        weighed = weigh(room)
        by_set, own = room.by_effects(weighed.models, weighed.probability.sum(axis=0)), room.set_at_hand
        if something:
            # no effect then counts by a rest and by the calibration alone
            by_set[()] -= weighed.nothing * weighed.as_believed
        visited[own] = room, fitted, weighed
        likeliest = max(by_set, key=lambda key: by_set[key])
        if likeliest in visited:
            turns = list(visited)
            fewest_first = sorted(
                turns[turns.index(likeliest) :], key=lambda name: (len(name), -visited[name][2].at_hand)
            )
            return visited[fewest_first[0]]
        room, fitted = settle(room.with_only(room.best_form(likeliest, weighed.models, weighed.probability)))
    return list(visited.values())[-1]


def _settle(
    room: Climb,
    noise: Noise,
    every: Sequence[Form],
    settings: Settings,
    passed: Callable[[], None] | None,
    most: float = np.inf,
    climbs: bool = True,
) -> tuple[Climb, Fitted]:
    """Search (where it `climbs`), fit and linearise anew until settled; `most` is the largest rest while searching."""
    for number in range(_PASSES):
        if passed is not None:
            passed()
        # two hypotheses that are as good must not take turns for ever: the last passes keep the set
        if climbs and number < _PASSES - 2:
            room.most = most
            room.climb()
            room.most = np.inf
        before, fitted = room.system.fitted, room.fitted()
        if _step(before, fitted) < _SETTLED:
            break
        if number < _PASSES - 1:
            room = Climb(LinearSystem(fitted, room.system.nominal, noise, every), settings)
    return room, fitted


def _step(before: Fitted, after: Fitted) -> float:
    """Return the largest change in standard uncertainties; infinite where the forms differ."""
    if [id(form) for form in before.forms] != [id(form) for form in after.forms]:
        return np.inf
    change = np.concatenate(
        [
            after.calibration - before.calibration,
            *(new - old for new, old in zip(after.theta, before.theta, strict=True)),
        ]
    )
    return float(np.abs(change / np.sqrt(np.diag(after.covariance))).max())
