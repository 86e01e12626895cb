"""One linearisation of the search: moving between sets of effects that differ by one, by scalar products alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from calib.arrays import FloatArray
from calib.gap.effects.effect import Form
from calib.gap.evidence.fit import Fitted
from calib.gap.evidence.models import Columns, log_weights, model_sizes
from calib.gap.evidence.step import stepped
from calib.gap.evidence.system import LinearSystem, Sums
from calib.gap.evidence.weighting import Weighting

#: forms of an effect that are kept beside the best
_FORMS: Final = 2
#: moves of one pass
_MOVES: Final = 24
#: scales of the rest that are weighed while moving: those within so many nats of the best
_ACTIVE_NATS: Final = 9.0
#: a rest this small is left out while moving
_FINEST: Final = 0.3
#: scales of the rest beside which the forms of each effect are ranked
_RANKED_BY: Final = (3.0, 10.0)
#: models whose neighbours are weighed at the end
_CENTRES: Final = 4
#: other models that the recalibration is judged beside, and how probable they are at least, over the best
_RIVALS: Final = 4
_LEAST_RIVAL: Final = 0.05
#: shares of what effects may deviate by, the likeliest of which they are fitted beside: all, a tenth, nothing
_DEVIATIONS: Final = (1.0, 0.1, 0.0)
Model = tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Settings:
    """What the search takes for granted; fixed on development cases, never on scored ones.

    Parameters
    ----------
    further : float
        Prior odds of one effect more being at work than so many.
    prior_rest : float
        Prior odds of a rest that no effect of the library explains. The floor's own shape is estimated: at three times
        these odds a rest was two thirds of the false alarms, at these a third, and outside effects at a signal of 10
        still show.
    tolerance : float
        Share by which an effect may deviate from its assumed form, a condition.
    most_effects : int
        Effects named at once, at most.
    paired : int
        Effects of which all pairs are tried, since one may hide the other; of a larger library those likeliest alone.
    """

    further: float = 0.5
    prior_rest: float = 0.05
    tolerance: float = 0.15
    most_effects: int = 6
    paired: int = 60


class Climb:
    """One linearisation: the forms kept, the hypothesis at hand, and the sums under what its effects may deviate by."""

    def __init__(self, whole: LinearSystem, settings: Settings) -> None:
        self.settings, self.most = settings, np.inf
        fitted, every = whole.fitted, whole.forms
        held = [next(k for k, form in enumerate(every) if form is own) for own in fitted.forms]
        sizes = [theta / form.typical for form, theta in zip(fitted.forms, fitted.theta, strict=True)]
        kept = self._worth_offering(whole, held, sizes)
        self.system = whole.only(kept)
        self.columns = Columns.from_forms(self.system.forms, settings.further)
        self.current: Model = tuple(range(len(held)))
        self.sizes = dict(enumerate(sizes))
        self.sums = self._summed()
        self.offered = list(range(len(kept)))

    def _worth_offering(self, whole: LinearSystem, held: list[int], sizes: list[FloatArray]) -> list[int]:
        """Return the forms at hand, then of each effect the best few beside them."""
        columns = Columns.from_forms(whole.forms, self.settings.further)
        deviations = self._deviations(whole, dict(zip(held, sizes, strict=True)))
        sums = whole.sums(
            whole.columns,
            whole.calibration,
            deviations,
            prior_rest=self.settings.prior_rest,
            scales=_RANKED_BY,
            interactions=False,
        )
        models = []
        for number, form in enumerate(whole.forms):
            others = tuple(k for k in held if whole.forms[k].effect != form.effect)
            models.append((*others, number))
        value = _total(log_weights(sums, columns, models))
        kept, count = list(held), dict[str, int]()
        for number in np.argsort(-value, kind="stable"):
            name = whole.forms[int(number)].effect
            if int(number) not in held and count.get(name, 0) < _FORMS:
                count[name] = count.get(name, 0) + 1
                kept.append(int(number))
        return kept

    def _deviations(self, system: LinearSystem, sizes: Mapping[int, FloatArray]) -> FloatArray:
        """Return by what each condition may deviate from the forms at hand, shape (n_rows, n_forms)."""
        deviations = [self.settings.tolerance * (system.of(k) @ size) for k, size in sizes.items()]
        return np.stack(deviations, axis=1) if deviations else np.zeros((len(system.gap), 0))

    def _summed(self, share: float = 1.0) -> Sums:
        """Return the sums beside the hypothesis at hand, its effects deviating by a share of what they may."""
        at_hand = {k: self.sizes[k] for k in self.current}
        return self.system.sums(
            self.system.columns,
            self.system.calibration,
            share * self._deviations(self.system, at_hand),
            prior_rest=self.settings.prior_rest,
        )

    def forms_of(self, model: Model) -> tuple[Form, ...]:
        """Return the forms of a model."""
        return tuple(self.columns.forms[k] for k in model)

    def weigh(self, models: Sequence[Model], sums: Sums | None = None) -> FloatArray:
        """Return the log weights of models, shape (n_scales, n_models)."""
        return log_weights(sums or self.sums, self.columns, models)

    def active(self) -> Sums:
        """Return the sums at the scales that matter for the hypothesis at hand."""
        weight = self.weigh([self.current])[:, 0]
        common = np.array([kind.is_interaction for kind in self.system.kinds] + [False])[self.sums.kind]
        matters = (~common & (self.sums.scale != _FINEST)) | (weight > weight.max() - _ACTIVE_NATS)
        return self.sums.pick(matters & (self.sums.scale <= self.most))

    def evidence(self) -> float:
        """Return the log weight of the hypothesis at hand, all scales of the rest together."""
        return float(_total(self.weigh([self.current]))[0])

    def weighting(self) -> Weighting:
        """Return the most probable rest beside the hypothesis at hand, and deviation of its effects from their forms.

        Deviations that may be large but are not would leave a strong effect's size to chance.
        """
        most = self._deviations(self.system, {k: self.sizes[k] for k in self.current})
        weightings = []
        for share in _DEVIATIONS if self.current else (1.0,):
            sums = self.sums if share == 1.0 else self._summed(share)
            weight = self.weigh([self.current], sums)[:, 0]
            best = int(np.argmax(weight))
            weightings.append((float(weight[best]), int(sums.kind[best]), float(sums.scale[best]), share))
        _, kind, scale, share = max(weightings, key=lambda each: each[0])
        return Weighting.from_rest(self.system, kind, scale, share * most)

    def fitted(self) -> Fitted:
        """Return the hypothesis at hand, fitted beside the most probable scale of the rest, re-simulated."""
        return stepped(self.system, self.current, self.weighting())

    def neighbours(self, model: Model) -> list[Model]:
        """Return the models one effect more, one less or one exchanged away, this one first."""
        name = {k: self.columns.forms[k].effect for k in (*self.offered, *model)}
        held = {name[k] for k in model}
        made = [model]
        made += [tuple(j for j in model if j != k) for k in model]
        fresh = [k for k in self.offered if name[k] not in held]
        if len(model) < self.settings.most_effects:
            made += [(*model, k) for k in fresh]
        for own in model:
            rest = tuple(j for j in model if j != own)
            made += [(*rest, k) for k in self.offered if k != own and (name[k] not in held or name[k] == name[own])]
        return made

    def _pairs(self) -> list[Model]:
        """Return pairs of effects by their best forms, which neither shows alone."""
        best: dict[str, int] = {}
        for k in self.offered:
            best.setdefault(self.columns.forms[k].effect, k)
        numbers = [k for k in best.values() if len(self.columns.forms[k].parameters) <= 4]
        if len(numbers) > self.settings.paired:
            # their pairs would grow with the square of what is on offer
            alone = _total(self.weigh([(k,) for k in numbers]))
            numbers = [numbers[place] for place in np.sort(np.argsort(-alone, kind="stable")[: self.settings.paired])]
        return [(a, b) for i, a in enumerate(numbers) for b in numbers[i + 1 :]]

    def best_alone(self, count: int) -> Sequence[Model]:
        """Return so many effects on offer, the likeliest, each alone in its best form."""
        weight = _total(self.weigh([(number,) for number in self.offered]))
        forms: dict[str, int] = {}
        for place in np.argsort(-weight, kind="stable"):
            number = self.offered[int(place)]
            forms.setdefault(self.columns.forms[number].effect, number)
        return [(number,) for number in forms.values()][:count]

    def by_effects(self, models: Sequence[Model], probability: FloatArray) -> dict[tuple[str, ...], float]:
        """Return the probability of each set of effects, forms together, from that of each model, shape (n_models,)."""
        by_set: dict[tuple[str, ...], float] = {}
        for model, p in zip(models, probability, strict=True):
            key = tuple(sorted(self.columns.forms[f].effect for f in model))
            by_set[key] = by_set.get(key, 0.0) + float(p)
        return by_set

    @property
    def set_at_hand(self) -> tuple[str, ...]:
        """Effects of the model at hand, sorted."""
        return tuple(sorted(self.columns.forms[k].effect for k in self.current))

    def best_form(self, effects: tuple[str, ...], models: Sequence[Model], probability: FloatArray) -> Model:
        """Return the likeliest model of a set of effects."""
        total = probability.sum(axis=0)
        alike = [n for n, m in enumerate(models) if effects == tuple(sorted(self.columns.forms[k].effect for k in m))]
        return models[max(alike, key=lambda n: float(total[n]))]

    def with_only(self, model: Model) -> Climb:
        """Return this linearisation with another model at hand."""
        other = copy(self)
        other.sizes = dict(self.sizes)
        other.take(model)
        return other

    def climb(self) -> Model:
        """Move to the best neighbour until none is better; return the model reached.

        A move has to pay beside what the effects before it may deviate by, and beside what those after it may: else two
        hypotheses would take turns.
        """
        refused: set[frozenset[int]] = set()
        for _ in range(_MOVES):
            models = self.neighbours(self.current)
            if not self.current:
                models += self._pairs()
            models = [self.current, *(m for m in models[1:] if frozenset(m) not in refused)]
            value = _total(self.weigh(models, self.active()))
            best = int(np.argmax(value))
            if best == 0 or value[best] < value[0] + 1e-6:
                break
            before = self.current, dict(self.sizes), self.sums
            self.take(models[best])
            value = _total(self.weigh([self.current, before[0]], self.active()))
            if value[0] <= value[1]:
                refused.add(frozenset(self.current))
                self.current, self.sizes, self.sums = before
        return self.current

    def take(self, model: Model) -> None:
        """Take a model as the one at hand, new effects at the sizes that suit it."""
        active = self.active()
        weight = self.weigh([model], active)[:, 0]
        share = np.exp(weight - weight.max())
        sizes = model_sizes(active, self.columns, model, share / share.sum())
        cuts = np.cumsum([0, *(len(self.columns.forms[k].parameters) for k in model)])
        fresh = {k: sizes[first:last] for k, (first, last) in zip(model, pairwise(cuts), strict=True)}
        self.sizes = {**fresh, **{k: self.sizes[k] for k in self.current}}
        self.current = model
        self.sums = self._summed()

    def posterior(self) -> tuple[list[Model], FloatArray]:
        """Return the models about the best ones, and their log weights (n_scales, n_models)."""
        models = dict.fromkeys(tuple(sorted(m)) for m in self.neighbours(self.current))
        self.current = tuple(sorted(self.current))
        listed = list(models)
        value = _total(self.weigh(listed, self.active()))
        for place in np.argsort(-value)[1:_CENTRES]:
            models.update(dict.fromkeys(tuple(sorted(m)) for m in self.neighbours(listed[int(place)])))
        if () not in models:
            models[()] = None
        listed = list(models)
        return listed, self.weigh(listed)

    def rivals(self, models: Sequence[Model], probability: FloatArray) -> tuple[tuple[Model, float], ...]:
        """Return the best models beside the one at hand, each with its probability over that one's."""
        own = float(probability[models.index(self.current)])
        held = {self.columns.forms[k].effect for k in self.current}
        others = [
            (models[int(n)], float(probability[n]) / max(own, 1e-12))
            for n in np.argsort(-probability)
            if {self.columns.forms[k].effect for k in models[int(n)]} != held
        ]
        return tuple(one for one in others[:_RIVALS] if one[1] > _LEAST_RIVAL)


def _total(weight: FloatArray) -> FloatArray:
    """Return the log of the weights summed over the scales of the rest, shape (n_models,)."""
    top = weight.max(axis=0)
    top = np.where(np.isfinite(top), top, 0.0)
    with np.errstate(divide="ignore"):
        return np.asarray(top + np.log(np.exp(weight - top).sum(axis=0)))
