"""Stepwise search about one linearisation, from set to set of effects by scalar products alone."""

from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from itertools import combinations
from typing import Any, Final

import numpy as np

from calib.gap.effects import Form
from calib.gap.effects.library import effect_class
from calib.gap.inference.fit import Fitted, by_form
from calib.gap.inference.least_squares import LinearSystem, Weighting, controlled_step
from calib.gap.inference.marginal_likelihood import ScaleEvidence, log_weights, model_sizes, prior_scale, ridge_solve
from calib.gap.inference.scalar_products import FormPriors, Sums
from calib.types import BoolArray, FloatArray

#: forms of an effect kept beside the best
_FORMS_PER_EFFECT: Final = 2
_MAX_STEPS: Final = 24
#: log-evidence window of scales of the lack of fit weighed while stepping
_ACTIVE_WINDOW: Final = 9.0
#: of a lack of fit, omitted while stepping
_SMALLEST_SCALE: Final = 0.3
#: of the lack of fit beside which an effect's forms are ranked
_RANKING_SCALES: Final = (3.0, 10.0)
#: models whose neighbours are weighed at the end
_EXPANDED_MODELS: Final = 4
#: models that the recalibration is judged beside, and least probability over the best
_MAX_ALTERNATIVES: Final = 4
_MIN_ALTERNATIVE_ODDS: Final = 0.05
#: shares of what effects may deviate by; the most probable counts
_DEVIATION_SHARES: Final = (1.0, 0.1, 0.0)
#: share by which an effect may deviate from its form in a condition, by development cases
TOLERANCE: Final = 0.15
#: effects named at most
MOST_EFFECTS: Final = 6
#: effects of which all pairs are tried: one may hide the other
PAIRED: Final = 60
#: cost of noise too small by 1.4 in a channel of a hundred runs: 30 degrees of freedom err no more
NOISE_WINDOW: Final = 14.0
#: of the sizes that choose a model's prior scale
_RIDGE: Final = 1e-2
Model = tuple[int, ...]


class LocalSearch:
    """One linearisation: forms kept, the hypothesis, and sums under its deviations."""

    def __init__(self, whole: LinearSystem) -> None:
        fitted, self.largest_scale = whole.fitted, np.inf
        held = whole.numbers(fitted.forms)
        sizes = [theta / form.typical for form, theta, _ in fitted.each()]
        kept = self._forms_to_offer(whole, held, sizes)
        self.system = whole.only(kept)
        self.columns = FormPriors.from_forms(self.system.forms)
        self.current: Model = tuple(range(len(held)))
        self.sizes = dict(enumerate(sizes))
        self.sums = self.system.sums(self.deviations)
        self.offered = list(range(len(kept)))

    def _forms_to_offer(self, whole: LinearSystem, held: list[int], sizes: list[FloatArray]) -> list[int]:
        columns = FormPriors.from_forms(whole.forms)
        deviations = self._deviations(whole, dict(zip(held, sizes, strict=True)))
        sums = whole.sums(deviations, scales=_RANKING_SCALES, interactions=False)
        models = [
            (*(k for k in held if whole.forms[k].effect != form.effect), number)
            for number, form in enumerate(whole.forms)
        ]
        value = _total(log_weights(sums, columns, models))
        kept, count = list(held), Counter[str]()
        for number in np.argsort(-value, kind="stable").tolist():
            name = whole.forms[number].effect
            if number not in held and count[name] < _FORMS_PER_EFFECT:
                count[name] += 1
                kept.append(number)
        return kept

    def _deviations(self, system: LinearSystem, sizes: Mapping[int, FloatArray]) -> FloatArray:
        own = {k: size * [not p.shift for p in system.forms[k].parameters] for k, size in sizes.items()}
        deviations = defaultdict[str, Any](float)
        for k, size in own.items():
            name = system.forms[k].effect
            deviations["law" if effect_class(name).is_load_law else name] += TOLERANCE * (system.of(k) @ size)
        return np.stack([*deviations.values()], axis=1) if deviations else np.zeros((len(system.gap), 0))

    @property
    def deviations(self) -> FloatArray:
        """Of each condition from the current forms, shape (n_rows, n)."""
        return self._deviations(self.system, {k: self.sizes[k] for k in self.current})

    def forms_of(self, model: Model) -> tuple[Form, ...]:
        """Return the forms of a model."""
        return tuple(self.columns.forms[k] for k in model)

    def weigh(self, models: Sequence[Model], sums: Sums | None = None) -> FloatArray:
        """Return the log weights of models, (n_scales, n_models); -inf for what nothing lets act."""
        weight = log_weights(sums or self.sums, self.columns, models)
        weight[:, [not self._acts(model) for model in models]] = -np.inf
        return weight

    def _acts(self, model: Model) -> bool:
        forms = self.forms_of(model)
        return all(any(o.effect in f.acts_through for o in forms) for f in forms if f.acts_through)

    @property
    def is_noise(self) -> BoolArray:
        """Scales without a lack of fit, shape (n_scales,): none, or what windows of a recording share."""
        return np.array([*(kind.is_scatter for kind in self.system.kinds), True])[self.sums.kind]

    def active(self) -> Sums:
        """Return the sums at the scales that matter for the current hypothesis."""
        weight = self.weigh([self.current])[:, 0]
        common = np.array([kind.is_interaction for kind in self.system.kinds] + [False])[self.sums.kind]
        matters = (~common & (self.sums.scale != _SMALLEST_SCALE)) | (weight > weight.max() - _ACTIVE_WINDOW)
        return self.sums.pick(matters & (self.sums.scale <= self.largest_scale))

    def evidence(self) -> float:
        """Return the current hypothesis' log weight over all scales."""
        return float(_total(self.weigh([self.current]))[0])

    def weighting(self) -> Weighting:
        """Return the most probable lack of fit and deviations beside the current hypothesis.

        Deviations larger than they are would leave a strong effect's size to chance.
        """
        full_deviations = self.deviations
        own, model = self.system.only(self.current), tuple(range(len(self.current)))
        priors = FormPriors.from_forms(own.forms)
        weightings = []
        for share in _DEVIATION_SHARES if self.current else (1.0,):
            sums = own.sums(share * full_deviations)
            weight = log_weights(sums, priors, [model])[:, 0]
            best = int(np.argmax(weight))
            weightings.append((float(weight[best]), int(sums.kind[best]), float(sums.scale[best]), share))
        _, kind, scale, share = max(weightings, key=lambda each: each[0])
        return Weighting(self.system, kind, scale, share * full_deviations)

    def fitted(self) -> Fitted:
        """Return the current hypothesis, fitted and re-simulated."""
        return controlled_step(self.system, self.current, self.weighting())

    def neighbours(self, model: Model) -> list[Model]:
        """Return this model, and those one effect more, less or exchanged away."""
        name = {k: self.columns.forms[k].effect for k in (*self.offered, *model)}
        held = {name[k] for k in model}
        models = [model, *(tuple(j for j in model if j != k) for k in model)]
        if len(model) < MOST_EFFECTS:
            models += [(*model, k) for k in self.offered if name[k] not in held]
        for own in model:
            others = tuple(j for j in model if j != own)
            models += [(*others, k) for k in self.offered if k != own and (name[k] not in held or name[k] == name[own])]
        return models

    def _pairs(self) -> list[Model]:
        best: dict[str, int] = {}
        for k in self.offered:
            best.setdefault(self.columns.forms[k].effect, k)
        numbers = [k for k in best.values() if len(self.columns.forms[k].parameters) <= 4]
        if len(numbers) > PAIRED:
            alone = _total(self.weigh([(k,) for k in numbers]))
            numbers = [numbers[place] for place in np.sort(np.argsort(-alone, kind="stable")[:PAIRED])]
        return list(combinations(numbers, 2))

    def best_single_effects(self, count: int) -> Sequence[Model]:
        """Return the most probable single effects on offer, each in its best form."""
        weight = _total(self.weigh([(number,) for number in self.offered]))
        forms: dict[str, int] = {}
        for place in np.argsort(-weight, kind="stable"):
            number = self.offered[int(place)]
            forms.setdefault(self.columns.forms[number].effect, number)
        return [(number,) for number in forms.values()][:count]

    def by_effects(self, models: Sequence[Model], probability: FloatArray) -> dict[tuple[str, ...], float]:
        """Return the probability of each set of effects from that of models (n_models,)."""
        by_set: dict[tuple[str, ...], float] = {}
        for model, p in zip(models, probability, strict=True):
            key = self._effects_of(model)
            by_set[key] = by_set.get(key, 0.0) + float(p)
        return by_set

    def _effects_of(self, model: Model) -> tuple[str, ...]:
        return tuple(sorted(form.effect for form in self.forms_of(model)))

    @property
    def current_effects(self) -> tuple[str, ...]:
        """Effects of the current model, sorted."""
        return self._effects_of(self.current)

    def best_form(self, effects: tuple[str, ...], models: Sequence[Model], probability: FloatArray) -> Model:
        """Return the most probable model of a set of effects."""
        total = probability.sum(axis=0)
        alike = [n for n, model in enumerate(models) if self._effects_of(model) == effects]
        return models[max(alike, key=lambda n: float(total[n]))]

    def with_current(self, model: Model) -> "LocalSearch":
        """Return this linearisation with another current model."""
        other = copy(self)
        other.sizes = dict(self.sizes)
        other.make_current(model)
        return other

    def greedy_search(self) -> Model:
        """Move to the best neighbour until none is better; return the model reached.

        A move pays beside the deviations before and after it, or two would alternate.
        """
        refused: set[frozenset[int]] = set()
        models, value = self._weighed_around(refused)
        for _ in range(_MAX_STEPS):
            best = int(np.argmax(value))
            if best == 0 or value[best] < value[0] + 1e-6:
                break
            before = self.current, dict(self.sizes), self.sums
            self.make_current(models[best])
            own, other = _total(self.weigh([self.current, before[0]], self.active()))
            if own > other:
                models, value = self._weighed_around(refused)
            else:
                refused.add(frozenset(self.current))
                self.current, self.sizes, self.sums = before
                value[best] = -np.inf
        return self.current

    def _weighed_around(self, refused: Collection[frozenset[int]]) -> tuple[list[Model], FloatArray]:
        models = self.neighbours(self.current) + ([] if self.current else self._pairs())
        models = [self.current, *(model for model in models[1:] if frozenset(model) not in refused)]
        return models, _total(self.weigh(models, self.active()))

    def make_current(self, model: Model) -> None:
        """Take a model as the current one."""
        active = self.active()
        weight = self.weigh([model], active)[:, 0]
        share = np.exp(weight - weight.max())
        sizes = model_sizes(active, self.columns, model, share / share.sum())
        fresh = zip(model, by_form(self.forms_of(model), np.concatenate([np.zeros(4), sizes])), strict=True)
        self.sizes = {**dict(fresh), **{k: self.sizes[k] for k in self.current}}
        self.current = model
        self.sums = self.system.sums(self.deviations)

    def posterior(self) -> tuple[list[Model], FloatArray]:
        """Return the models about the best, and their log weights (n_scales, n_models)."""
        models: dict[Model, None] = dict.fromkeys(tuple(sorted(m)) for m in self.neighbours(self.current))
        self.current = tuple(sorted(self.current))
        listed = list(models)
        for place in np.argsort(-_total(self.weigh(listed, self.active())))[1:_EXPANDED_MODELS]:
            models.update(dict.fromkeys(tuple(sorted(m)) for m in self.neighbours(listed[int(place)])))
        listed = list(models | {(): None})
        return listed, self.weigh(listed)

    def alternatives(self, models: Sequence[Model], probability: FloatArray) -> tuple[tuple[Model, float], ...]:
        """Return the best other models, each with its probability over the current one's."""
        own = float(probability[models.index(self.current)])
        others = [
            (models[n], float(probability[n]) / max(own, 1e-12))
            for n in np.argsort(-probability).tolist()
            if set(self._effects_of(models[n])) != set(self.current_effects)
        ]
        return tuple(one for one in others[:_MAX_ALTERNATIVES] if one[1] > _MIN_ALTERNATIVE_ODDS)

    def scale_gains(
        self, weight: FloatArray, likely: Iterable[int], models: Sequence[Model], window: float
    ) -> FloatArray:
        """Return the change of the log weights by the integral over the noise's scales, in the shape of `weight`.

        Parameters
        ----------
        weight : shape (n_scales, n_models)
            Log weights beside the noise as it was estimated.
        likely, models
            Models to integrate by their numbers; the gain of the others is the least of theirs.
        window
            Weights this far below the best are not integrated; that of noise alone is by `NOISE_WINDOW`.
        """
        evidence, gains = ScaleEvidence(self.system), np.full(weight.shape, np.nan)
        for n in likely:
            if self.columns.layout.wide in models[n]:
                continue
            for scale in {0, int(np.argmax(weight[:, n]))}:
                # what differs between runs without repeats is no noise estimated too small
                alone = not models[n] and self.system.noise.supported
                if weight[scale, n] > weight.max() - (NOISE_WINDOW if alone else window):
                    gains[scale, n] = evidence.gain(self._columns_beside(models[n], scale))
        if not np.isfinite(gains).any():
            return np.zeros(weight.shape)
        least = np.where(np.isfinite(gains), gains, np.inf).min(axis=0)
        return np.where(np.isfinite(gains), gains, np.where(np.isfinite(least), least, least.min()))

    def _columns_beside(self, model: Model, scale: int) -> FloatArray:
        system, sums = self.system, self.sums
        weighting = Weighting(system, int(sums.kind[scale]), float(sums.scale[scale]), self.deviations)
        parts = [system.calibration, weighting.common]
        if model:
            (place,), (owner,) = self.columns.index([model])
            sizes = ridge_solve(*sums.of_columns(scale, place), _RIDGE)
            most = prior_scale(sizes[None], owner[None], self.columns, place[None])[0]
            parts.append(np.concatenate([system.of(k) for k in model], axis=1) * most)
        for (_, places), own in zip(system.blocks.alike, weighting.own, strict=True):
            spread = np.zeros((len(system.gap), len(places), own.shape[2]))
            spread[places, np.arange(len(places))[:, None]] = own
            parts.append(spread.reshape(len(system.gap), -1))
        return np.concatenate(parts, axis=1)


def _total(weight: FloatArray) -> FloatArray:
    top = weight.max(axis=0)
    top = np.where(np.isfinite(top), top, 0.0)
    with np.errstate(divide="ignore"):
        return np.asarray(top + np.log(np.exp(weight - top).sum(axis=0)))


@dataclass(frozen=True, eq=False)
class SearchResult:
    """What was found."""

    fitted: Fitted  #: the best hypothesis, a recalibration free beside it
    base: Fitted
    alone: LinearSystem  #: about its path, with every form
    system: LinearSystem  #: about the best hypothesis' path, with the best forms
    forms: dict[str, list[Form]]
    models: tuple[tuple[str, ...], ...]  #: sets of effects, best first
    probabilities: FloatArray  #: shape (n_models,)
    alternatives: tuple[tuple[Model, float], ...]  #: best others, in forms of `system`, and odds over the best
    rest: float  #: probability of a lack of fit
    weighting: Weighting  #: beside the best hypothesis
    nothing: float  #: probability of neither an effect nor a lack of fit, recalibration free
    #: and of each set of calibration parameters off, (n_subsets,)
    beside_nothing: FloatArray
    gains: FloatArray  #: of no effect, see `weigh_subsets`

    @property
    def effects(self) -> tuple[str, ...]:
        """Effects of the best hypothesis, sorted."""
        return tuple(sorted(form.effect for form in self.fitted.forms))

    def inclusion(self) -> dict[str, float]:
        """Return the probability of each effect being at work."""
        by_effect: dict[str, float] = {}
        for model, p in zip(self.models, self.probabilities.tolist(), strict=True):
            for name in model:
                by_effect[name] = by_effect.get(name, 0.0) + p
        return by_effect
