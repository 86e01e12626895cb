"""Searching the hypotheses: single effects, pairs, triples, each beside a free recalibration, and "unknown"."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from calib.arrays import FloatArray
from calib.gap.effects.effect import Effect, Form
from calib.gap.evidence.fit import Fitted, fit
from calib.gap.evidence.marginal import (
    CALIBRATION_SD,
    Nuisance,
    log_evidence,
    log_marginal,
    project,
    ridge_solve,
)
from calib.gap.evidence.noise import Noise
from calib.gap.evidence.whitened import WhitenedSystem
from calib.gap.predict.path import Path

__all__ = ["Hypothesis", "Search", "Settings", "search"]


@dataclass(frozen=True, slots=True)
class Settings:
    """What the search takes for granted; fixed on development cases, never on scored ones.

    Parameters
    ----------
    prior_effect : float
        Prior odds of any one effect being at work.
    prior_unknown : float
        Prior odds of a cause outside the library.
    tolerance : float
        Share by which an effect may deviate from its assumed form, a condition.
    temper : float
        Power of the evidence; below 1 because the noise is never quite the one assumed.
    singles, pairs, triples : int
        How many of the best hypotheses of a size are re-simulated and fitted.
    extended : int
        How many of the fitted singles are extended to pairs about their own path.
    beside_unknown : int
        Beside how many of the best hypotheses a rest of unknown cause is weighed.
    """

    prior_effect: float = 0.02
    prior_unknown: float = 0.08
    tolerance: float = 0.15
    temper: float = 0.9
    singles: int = 8
    pairs: int = 8
    triples: int = 4
    extended: int = 5
    beside_unknown: int = 6


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """A hypothesis with its evidence.

    Parameters
    ----------
    effects : tuple of str
        Ids of its effects, sorted; empty is "a recalibration at most".
    unknown : bool
        Whether a rest of unknown cause is part of it.
    fitted : Fitted
        Its fit (that of the named effects).
    log_evidence : float
        Natural logarithm of the evidence, tempered.
    log_prior : float
        Natural logarithm of its prior odds.
    """

    effects: tuple[str, ...]
    unknown: bool
    fitted: Fitted
    log_evidence: float
    log_prior: float

    @property
    def log_weight(self) -> float:
        """Logarithm of evidence times prior."""
        return self.log_evidence + self.log_prior


@dataclass(frozen=True, eq=False)
class Search:
    """All that was tried.

    Parameters
    ----------
    hypotheses : tuple of Hypothesis
        Best first.
    base : Fitted
        The recalibration alone.
    nominal : Path
        The model alone.
    noise : Noise
        Noise of the units.
    forms : mapping of str to list of Form
        Forms of each effect on this campaign.
    signal : mapping of str to float
        Whitened norm of each effect's best single fit after projection.
    """

    hypotheses: tuple[Hypothesis, ...]
    base: Fitted
    nominal: Path
    noise: Noise
    forms: dict[str, list[Form]]
    signal: dict[str, float] = field(default_factory=dict)

    def probabilities(self) -> FloatArray:
        """Posterior probability of each hypothesis, shape (n_hypotheses,)."""
        weight = np.array([h.log_weight for h in self.hypotheses])
        weight = np.exp(weight - weight.max())
        made: FloatArray = weight / weight.sum()
        return made


def _marginal(columns: FloatArray, y: FloatArray) -> float:
    """Return the log evidence of y under I + X X^T, both times a factor that is hardly known."""
    nuisance = Nuisance.of(columns)
    square = nuisance.scalar(y[:, None], y[:, None])[0, 0]
    return float(log_marginal(square, nuisance.log_det, len(y)))


UNKNOWN_SCALES: Final = (0.3, 0.7, 1.5, 3.0, 7.0, 15.0, 40.0, 120.0)


def effect_scale(sizes: FloatArray, form: Form) -> float:
    """Return the prior scale of a form in typical sizes: its fitted size, from a tenth to what is plausible at most."""
    size = float(np.sqrt(np.mean(sizes**2))) if len(sizes) else 1.0
    most = max([3.0, *(p.largest / p.typical for p in form.parameters)])
    return float(np.clip(size, 0.1, most))


def wrong_sign(form: Form, sizes: FloatArray) -> bool:
    """Return whether a parameter that can only have one sign came out with the other."""
    return any(p.sign * size < 0 for p, size in zip(form.parameters, sizes, strict=True))


#: what choosing the prior's scale by the fitted size costs, in nats
SCALE_COST: Final = float(np.log(4.0))


def evaluate(
    fitted: Fitted, nominal: Path, noise: Noise, settings: Settings, *, unknown: bool = False
) -> tuple[float, float]:
    """Return the log evidence of a fitted hypothesis without and with a rest of unknown cause.

    The second is minus infinity unless `unknown` asks for it.
    """
    bench = WhitenedSystem(fitted.path, nominal, noise)
    y = bench.gap + bench.calibration @ (fitted.calibration / CALIBRATION_SD)
    columns = [bench.calibration]
    cost = 0.0
    for form, theta in zip(fitted.forms, fitted.theta, strict=True):
        signature = bench.columns(form)
        sizes = theta / form.typical
        contribution = signature @ sizes
        y = y + contribution
        columns += [signature * effect_scale(sizes, form), settings.tolerance * bench.by_condition(contribution)]
        # half of the prior lies on the sign that a parameter cannot have
        cost += SCALE_COST - np.log(2.0) * sum(p.sign != 0 for p in form.parameters)
    base = np.concatenate(columns, axis=1)
    plain = _marginal(base, y) - cost
    if not unknown:
        return plain, -np.inf
    return plain, _unknown_evidence(bench, base, y) - cost


def _unknown_evidence(bench: WhitenedSystem, base: FloatArray, y: FloatArray) -> float:
    """Return the evidence with offsets by condition added, averaged over their kind and scale."""
    found = []
    nuisance = Nuisance.of(base)
    square = nuisance.scalar(y[:, None], y[:, None])[0, 0]
    for columns in bench.unknown_columns():
        gram = nuisance.scalar(columns, columns)
        right = nuisance.scalar(columns, y[:, None])[:, 0]
        eigen, vectors = np.linalg.eigh(gram)
        turned = (vectors.T @ right) ** 2
        eigen = np.maximum(eigen, 0.0)
        for scale in UNKNOWN_SCALES:
            variance = scale**2
            left = square - (turned * variance / (1.0 + variance * eigen)).sum()
            found.append(float(log_marginal(left, nuisance.log_det + np.log1p(variance * eigen).sum(), len(y))))
    if not found:
        # nothing was driven twice, nothing varied: an unknown cause could not be told from noise
        return -np.inf
    top = max(found)
    return float(top + np.log(np.mean(np.exp(np.array(found) - top))))


def search(
    nominal: Path, noise: Noise, base: Fitted, effects: Sequence[Effect], settings: Settings | None = None
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

    Returns
    -------
    Search
    """
    settings = settings or Settings()
    s = nominal.s
    forms = {e.id: e.forms(s) for e in effects if not e.calibration}
    forms = {name: made for name, made in forms.items() if made}
    bench = WhitenedSystem(base.path, nominal, noise)
    start = Nuisance.of(bench.calibration)
    ranking, signal = _screen(bench, start, forms, ())
    hypotheses: dict[tuple[str, ...], Hypothesis] = {}

    def add(chosen: tuple[Form, ...], begin: Fitted) -> Fitted:
        fitted = fit(nominal, noise, chosen, start=begin) if chosen else base
        if any(wrong_sign(form, theta) for form, theta in zip(fitted.forms, fitted.theta, strict=True)):
            return fitted
        key = _key(chosen)
        value, _ = evaluate(fitted, nominal, noise, settings)
        prior = float(sum(np.log(settings.prior_effect / f.tries) for f in chosen))
        made = Hypothesis(key, False, fitted, settings.temper * value, prior)
        have = hypotheses.get(key)
        if have is None or made.log_weight > have.log_weight:
            hypotheses[key] = made
        return fitted

    add((), base)
    singles = _best(ranking, settings.singles)
    fitted_singles = [(chosen, add(chosen, base)) for chosen in singles]
    fitted_singles = [item for item in fitted_singles if _key(item[0]) in hypotheses]
    fitted_singles.sort(key=lambda item: -hypotheses[_key(item[0])].log_weight)
    pairs = _extend(fitted_singles[: settings.extended], nominal, noise, forms, settings, settings.pairs)
    pairs += _blind_pairs(bench, start, forms, ranking, settings, base)
    fitted_pairs = [(chosen, add(chosen, begin)) for chosen, begin in _distinct(pairs, hypotheses)]
    fitted_pairs = [item for item in fitted_pairs if _key(item[0]) in hypotheses]
    fitted_pairs.sort(key=lambda item: -hypotheses[_key(item[0])].log_weight)
    triples = _extend(fitted_pairs[:3], nominal, noise, forms, settings, settings.triples)
    for chosen, begin in _distinct(triples, hypotheses):
        add(chosen, begin)
    ordered = sorted(hypotheses.values(), key=lambda h: -h.log_weight)
    # a rest of unknown cause is weighed beside the best of them, and beside a mere recalibration
    beside = ordered[: settings.beside_unknown]
    beside += [h for h in ordered[settings.beside_unknown :] if not h.effects]
    for h in beside:
        value = evaluate(h.fitted, nominal, noise, settings, unknown=True)[1]
        prior = h.log_prior + float(np.log(settings.prior_unknown))
        ordered.append(Hypothesis(h.effects, True, h.fitted, settings.temper * value, prior))
    ordered.sort(key=lambda h: -h.log_weight)
    return Search(tuple(ordered), base, nominal, noise, forms, signal)


def _key(chosen: Sequence[Form]) -> tuple[str, ...]:
    return tuple(sorted(form.effect for form in chosen))


Ranking = list[tuple[float, tuple[Form, ...]]]


def _screen(
    bench: WhitenedSystem, nuisance: Nuisance, forms: dict[str, list[Form]], held: tuple[str, ...]
) -> tuple[Ranking, dict[str, float]]:
    """Rank all forms by their evidence beside a nuisance, best first, and say each effect's projected signal."""
    ranking: Ranking = []
    signal: dict[str, float] = {}
    gap = project(nuisance, bench.gap[:, None])[:, 0]
    for name, made in forms.items():
        if name in held:
            continue
        for form in made:
            columns = project(nuisance, bench.columns(form))
            gram, right = columns.T @ columns, columns.T @ gap
            sizes = ridge_solve(gram, right, 1e-2)
            if wrong_sign(form, sizes):
                continue
            scale = effect_scale(sizes, form)
            value = float(log_evidence(gram, right, np.full(len(gram), scale**2)))
            ranking.append((value - SCALE_COST - np.log(form.tries), (form,)))
            signal[name] = max(signal.get(name, 0.0), float(np.sqrt(max(float(sizes @ gram @ sizes), 0.0))))
    ranking.sort(key=lambda item: -item[0])
    return ranking, signal


def _best(ranking: Ranking, count: int) -> list[tuple[Form, ...]]:
    """Return the best form of each of the `count` best effects."""
    seen: dict[str, tuple[Form, ...]] = {}
    for _, chosen in ranking:
        seen.setdefault(chosen[0].effect, chosen)
        if len(seen) == count:
            break
    return list(seen.values())


def _extend(
    fitted: Sequence[tuple[tuple[Form, ...], Fitted]],
    nominal: Path,
    noise: Noise,
    forms: dict[str, list[Form]],
    settings: Settings,
    count: int,
) -> list[tuple[float, tuple[Form, ...], Fitted]]:
    """Rank what could be added to fitted hypotheses, each about its own re-simulated path."""
    found: list[tuple[float, tuple[Form, ...], Fitted]] = []
    for chosen, begin in fitted:
        bench = WhitenedSystem(begin.path, nominal, noise)
        columns = [bench.calibration]
        for form, theta in zip(begin.forms, begin.theta, strict=True):
            signature = bench.columns(form)
            sizes = theta / form.typical
            columns += [3.0 * signature, settings.tolerance * bench.by_condition(signature @ sizes)]
        nuisance = Nuisance.of(np.concatenate(columns, axis=1))
        ranking, _ = _screen(bench, nuisance, forms, tuple(f.effect for f in chosen))
        base = -0.5 * nuisance.scalar(bench.gap[:, None], bench.gap[:, None])[0, 0] - 0.5 * nuisance.log_det
        names: set[str] = set()
        for value, extra in ranking:
            if extra[0].effect in names:
                continue
            names.add(extra[0].effect)
            found.append((base + value, chosen + extra, begin))
            if len(names) == count:
                break
    found.sort(key=lambda item: -item[0])
    return found[: 2 * count]


def _blind_pairs(
    bench: WhitenedSystem,
    nuisance: Nuisance,
    forms: dict[str, list[Form]],
    ranking: Ranking,
    settings: Settings,
    base: Fitted,
) -> list[tuple[float, tuple[Form, ...], Fitted]]:
    """Rank all pairs of effects (each by its best forms) about the recalibrated path, found by neither alone."""
    best = [chosen[0] for chosen in _best(ranking, len(forms))]
    kept = [form for form in best if len(form.parameters) <= 4]
    gap = project(nuisance, bench.gap[:, None])[:, 0]
    columns = [project(nuisance, bench.columns(form)) for form in kept]
    cuts = np.cumsum([0, *(c.shape[1] for c in columns)])
    whole = np.concatenate(columns, axis=1) if columns else np.zeros((len(gap), 0))
    gram, right = whole.T @ whole, whole.T @ gap
    width = 8
    pairs = [(a, b) for a in range(len(kept)) for b in range(a + 1, len(kept))]
    if not pairs:
        return []
    index = np.full((len(pairs), width), -1)
    for number, (a, b) in enumerate(pairs):
        both = np.concatenate([np.arange(cuts[a], cuts[a + 1]), np.arange(cuts[b], cuts[b + 1])])
        index[number, : len(both)] = both
    there = index >= 0
    small = gram[index[:, :, None], index[:, None, :]] * (there[:, :, None] & there[:, None, :])
    small = small + np.eye(width) * np.where(there, 0.0, 1.0)[:, None, :]
    rhs = right[index] * there
    sizes = ridge_solve(small, rhs, 1e-2)
    variance = np.where(there, np.clip(sizes**2, 0.01, 100.0), 1e-12)
    value = log_evidence(small, rhs, variance)
    order = np.argsort(-value)[: settings.pairs]
    chosen = [pairs[int(number)] for number in order]
    return [(float(value[n]), (kept[a], kept[b]), base) for n, (a, b) in zip(order, chosen, strict=True)]


def _distinct(
    found: list[tuple[float, tuple[Form, ...], Fitted]], have: dict[tuple[str, ...], Hypothesis]
) -> list[tuple[tuple[Form, ...], Fitted]]:
    """Leave out hypotheses that were fitted already or that are listed twice."""
    seen = set(have)
    made = []
    for _, chosen, begin in found:
        key = _key(chosen)
        if key not in seen:
            seen.add(key)
            made.append((chosen, begin))
    return made
