"""Identifiability: which effects some runs would detect, at which size, and separate from which others."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from calib.campaign.model import Campaign
from calib.documents import plain_fields
from calib.gap.effects import Effect, Form, matching_form
from calib.gap.effects.library import library
from calib.gap.inference.fit import CALIBRATION_SD, Fitted, signature_columns, whitened_rows
from calib.gap.inference.least_squares import WhitenedSystem
from calib.gap.inference.marginal_likelihood import Nuisance, project
from calib.gap.inference.noise import Noise
from calib.gap.inference.noise_components import COMPONENTS, kernels, masked, quantisation
from calib.gap.observations.from_campaign import observations_of
from calib.gap.predict import Path, predict
from calib.types import BoolArray, FloatArray, IntArray, Progress, silent, stepped

#: standard deviations within which signatures are confounded
SEPARATION_SD: Final = 3.0
#: an alternative's limit over its largest plausible size, which is a judgement
PLAUSIBLE_FACTOR: Final = 2.0
#: whitened norm at which an effect is detected among the whole library
DETECTION_SIGNAL: Final = 5.0
#: share left by a recalibration below which an effect is indistinguishable from it
ABSORBED_SHARE: Final = 1e-3
#: effects or pairs named for a run: one line
MOST_NAMED: Final = 3
#: twice the separation needed: a margin for other sizes
ENOUGH_SD: Final = 2.0 * SEPARATION_SD
#: separation worth no further run
CAP_SD: Final = 4.0 * SEPARATION_SD
#: smallest gain worth naming, in standard deviations
NOTEWORTHY_SD: Final = 0.05


#: how often each observation is made (n_obs,) -> causes that are named together, and how far each effect is
Apart = Callable[[FloatArray], Sequence[tuple[tuple[str, ...], dict[str, float]]]]
#: proportions of an effect's parameters, unless stated: no two alike
_PROPORTIONS: Final = (1.0, 0.7, -0.8, 0.9, -0.6, 0.5, -0.7, 0.8)


def distance(system: WhitenedSystem, nuisance: Nuisance, contribution: FloatArray, form: Form) -> float:
    """Return the distance of a contribution (n_rows,) from what a form plausibly can do, in standard deviations."""
    target = project(nuisance, contribution[:, None])[:, 0]
    columns = project(nuisance, system.columns(form))
    bound = np.array([p.largest / p.typical for p in form.parameters]) * PLAUSIBLE_FACTOR
    sizes = np.linalg.solve(columns.T @ columns + np.diag(1e-9 + 1.0 / (10 * bound) ** 2), columns.T @ target)
    sign, shift = np.array([(p.sign, p.shift) for p in form.parameters]).T
    if shift.any():
        bound = np.where(shift, bound * np.sqrt(np.mean(sizes[shift == 0] ** 2)), bound)
    sizes = np.clip(sizes, np.where(sign > 0, 0.0, -bound), np.where(sign < 0, 0.0, bound))
    return float(np.linalg.norm(target - columns @ sizes))


def aliases_of(
    system: WhitenedSystem,
    nuisance: Nuisance,
    contribution: FloatArray,
    forms: Mapping[str, Sequence[Form]],
    named: Sequence[str],
    within: float = SEPARATION_SD,
) -> dict[str, float]:
    """Return effects `within` so many standard deviations of a contribution, each with its distance.

    `system`, `nuisance`, `contribution`: see `distance`; `forms`: the library on this campaign; `named`: effects of the
    hypothesis, no alternatives.
    """
    nearest = {
        name: min((distance(system, nuisance, contribution, form) for form in offered), default=np.inf)
        for name, offered in forms.items()
        if name not in named
    }
    return {name: value for name, value in nearest.items() if value < within}


def noise_at(path: Path, scales: Mapping[str, float]) -> Noise:
    """Return the noise of observations; missing scales take their prior median."""
    scale = np.array([scales.get(name, median) for name, median, _ in COMPONENTS])
    covariance = np.tensordot(scale**2, kernels(path), axes=1) + quantisation(path)
    return Noise(masked(covariance, path.s.usable), dict(scales), float("inf"), np.ones(len(path.s)))


def sizes_on(offered: Mapping[str, Sequence[Form]], fitted: Fitted) -> list[tuple[Form, FloatArray]]:
    """Return the forms of a fit, as they are on other runs with forms on offer there, and their sizes."""
    sizes = []
    for form, theta, _ in fitted.each():
        forms = offered.get(form.effect, ())
        alike = [each for each in forms if len(each.parameters) == len(form.parameters)]
        if matching := matching_form(forms, form.label, form.settings) or next(iter(alike), None):
            known = {parameter.name: float(value) for parameter, value in zip(form.parameters, theta, strict=True)}
            sizes.append((matching, np.array([known.get(parameter.name, 0.0) for parameter in matching.parameters])))
    return sizes


class Signatures:
    """Whitened signatures of a library on observations, and their distances on any of these.

    `path`: about which to linearise. Effects have typical size, in the form of the strongest signal.
    """

    def __init__(self, path: Path, noise: Noise, effects: Sequence[Effect]) -> None:
        self.offered = {effect.id: effect.forms(path.s) for effect in effects}
        present = [effect for effect in effects if self.offered[effect.id]]
        self.names = [effect.id for effect in present]
        self.own_calibration = np.array([effect.calibration for effect in present], dtype=bool)
        every = [form for forms in self.offered.values() for form in forms]
        known = {id(form): columns for form, columns in zip(every, signature_columns(path, every), strict=True)}
        blocks, truths = [path.calibration * CALIBRATION_SD], []
        calibration = whitened_rows(path, noise, blocks[0])
        #: each form's effect number, first and last column
        self.forms: list[tuple[int, int, int]] = []
        self._places: dict[int, tuple[int, FloatArray]] = {}
        position = 4
        for number, effect in enumerate(present):
            trials: list[FloatArray] = []
            for form in self.offered[effect.id]:
                columns = known[id(form)]
                largest = np.array([p.largest / p.typical for p in form.parameters]) * PLAUSIBLE_FACTOR
                blocks.append(columns * largest)
                self._places[id(form)] = position, largest
                self.forms.append((number, position, position + columns.shape[2]))
                position += columns.shape[2]
                trials.append(columns @ np.resize(np.array(_PROPORTIONS), columns.shape[2]))
            free = calibration[:, 3:] if effect.calibration else calibration
            residual = project(Nuisance(free), whitened_rows(path, noise, np.stack(trials, axis=2)))
            truths.append(trials[int(np.argmax((residual**2).sum(axis=0)))])
        self.first_truth = position
        blocks.append(np.stack(truths, axis=2) if truths else np.zeros((len(path.s), 6, 0)))
        self.columns = whitened_rows(path, noise, np.concatenate(blocks, axis=2))
        self.unit = np.repeat(np.arange(len(path.s))[:, None], 6, axis=1)[path.s.usable]

    def of_form(self, form: Form) -> FloatArray:
        """Return whitened signatures of an `offered` form in typical sizes, (n_rows, n_parameters)."""
        first, largest = self._places[id(form)]
        return self.columns[:, first : first + len(largest)] / largest

    def gram(self, units: BoolArray) -> FloatArray:
        """Return scalar products of all columns over observations (n_units,)."""
        kept = self.columns[units[self.unit]]
        return kept.T @ kept

    def distances(self, gram: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return each effect's signal (..., n_truths) and distance from each other (..., n_effects).

        The signal is the whitened norm beside a recalibration (for its own three without), the distance that beside the
        other effect too; infinite from itself. `gram`: see `gram`.
        """
        numbers = np.arange(len(self.names))
        target = self.first_truth + numbers
        square = gram[..., target, target]
        signal = np.zeros(square.shape)
        distances = np.full((*square.shape, len(self.names)), np.inf)
        for calibration in (False, True):
            same = self.own_calibration[numbers] == calibration
            free = np.arange(3 if calibration else 0, 4)
            signal[..., same] = _left(gram, free, target[same], square[..., same])
            for number, first, last in self.forms:
                near = signal[..., same]
                if calibration or not self.own_calibration[number]:
                    beside = np.concatenate([free, np.arange(first, last)])
                    near = _left(gram, beside, target[same], square[..., same])
                distances[..., same, number] = np.minimum(distances[..., same, number], near)
        distances[..., np.arange(len(numbers)), numbers] = np.inf
        return signal, distances


def _left(gram: FloatArray, beside: IntArray, target: IntArray, square: FloatArray) -> FloatArray:
    inner = gram[..., beside[:, None], beside] + np.eye(len(beside))
    cross = gram[..., beside[:, None], target]
    return np.asarray(np.sqrt(np.maximum(square - (cross * np.linalg.solve(inner, cross)).sum(axis=-2), 0.0)))


@dataclass(frozen=True, slots=True)
class DetectionLimit:
    """The smallest size of an effect that some runs would show."""

    effect: str
    smallest: str  #: with its unit; where `never` any, why
    never: bool = False

    @property
    def sentence(self) -> str:
        """The size, or ``never`` and the reason."""
        return f"never: {self.smallest}" if self.never else self.smallest


@dataclass(frozen=True, slots=True, eq=False)
class Outlook:
    """What a set of runs can show."""

    effects: tuple[str, ...]  #: shape (n,): excited by the runs
    absent: tuple[str, ...]  #: nothing that they act through
    #: shape (n,), (n, n): at typical size, see `Signatures.distances`; row: effect at work
    signal: FloatArray
    distance: FloatArray
    smallest: dict[str, DetectionLimit]

    @property
    def told_apart(self) -> BoolArray:
        """Whether effects at typical size are separated from nothing and all others, shape (n,)."""
        return np.asarray((self.signal >= SEPARATION_SD) & (self.distance.min(axis=1) >= SEPARATION_SD))

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values; the diagonal is null."""
        apart = self.told_apart
        return plain_fields(
            self,
            smallest={name: limit.sentence for name, limit in self.smallest.items()},
            not_seen=[name for name, value in zip(self.effects, self.signal, strict=True) if value < SEPARATION_SD],
            told_apart=[name for name, yes in zip(self.effects, apart, strict=True) if yes],
            confused={
                name: [self.effects[k] for k in np.flatnonzero(self.distance[number] < SEPARATION_SD)]
                for number, name in enumerate(self.effects)
                if self.signal[number] >= SEPARATION_SD and not apart[number]
            },
        )


def outlook_of(campaign: Campaign, progress: Progress = silent) -> Outlook:
    """Return what a campaign's runs, driven or not, can show of the library."""
    observations = observations_of(campaign)
    path = predict(observations)
    noise = noise_at(path, {})
    effects = library(observations, declared=campaign.extra.get("effects", ()))
    signatures = Signatures(path, noise, effects)
    signal, distances = signatures.distances(signatures.gram(np.ones(len(observations), dtype=bool)))
    limits = _Limits(whitened_rows(path, noise, path.calibration * CALIBRATION_SD), signatures.of_form)
    return Outlook(
        effects=tuple(signatures.names),
        absent=tuple(name for name, forms in signatures.offered.items() if not forms),
        signal=signal,
        distance=distances,
        smallest={
            one.id: limits.of(one, signatures.offered[one.id])[1] for one in stepped(effects, progress, "effects")
        },
    )


def undetectable(
    system: WhitenedSystem, effects: Sequence[Effect], forms: Mapping[str, Sequence[Form]] | None = None
) -> tuple[DetectionLimit, ...]:
    """Return detection limits of effects that these runs would not show at typical size.

    `never` where the runs excite nothing, or a recalibration absorbs all. Known `forms` are not built again.
    """
    limits, results = _Limits(system.calibration, system.columns), []
    for effect in effects:
        offered = effect.forms(system.path.s) if forms is None or effect.calibration else forms.get(effect.id, ())
        results.append(limits.of(effect, offered))
    return tuple(limit for times, limit in results if times > 1.0)


class _Limits:
    def __init__(self, calibration: FloatArray, of_form: Callable[[Form], FloatArray]) -> None:
        self.recalibration, self.front_radius = Nuisance(calibration), Nuisance(calibration[:, 3:])
        self.of_form = of_form

    def of(self, effect: Effect, forms: Sequence[Form]) -> tuple[float, DetectionLimit]:
        """Return an effect's detection limit in typical sizes (infinite: `never`), and in words."""
        if not forms:
            why = "nothing that it acts through varies, or is used, in these runs"
            return np.inf, DetectionLimit(effect.id, why, never=True)
        nuisance = self.front_radius if effect.calibration else self.recalibration
        limit, best, moves = np.inf, None, False
        for form in forms:
            columns = self.of_form(form)
            signals = np.sqrt((project(nuisance, columns) ** 2).sum(axis=0))
            norms = np.sqrt((columns**2).sum(axis=0))
            moves = moves or bool(norms.any())
            for parameter, signal, norm in zip(form.parameters, signals, norms, strict=True):
                if signal > ABSORBED_SHARE * max(norm, 1e-12) and DETECTION_SIGNAL / signal < limit * (1.0 - 1e-9):
                    limit, best = DETECTION_SIGNAL / float(signal), parameter
        if best is None:
            through = all(form.acts_through for form in forms)
            none = "[model] has no slopes by load" if through else "it moves nothing measured here"
            why = "indistinguishable from a radius or track error" if moves else none
            return np.inf, DetectionLimit(effect.id, why, never=True)
        words = [best.name.replace("_", " ")] if best.name else []
        words += ["more than is plausible"] if limit * best.typical > best.largest else []
        unit, note = "" if best.unit == "1" else f" {best.unit}", f" ({', '.join(words)})" if words else ""
        return limit, DetectionLimit(effect.id, f"{limit * best.typical:.2g}{unit}{note}")


@dataclass(frozen=True)
class Task:
    """How far effects are apart with some of the runs, by number, beside those driven (-1)."""

    of: Callable[[Sequence[Sequence[int]]], FloatArray]  #: sets of runs -> shape (n_sets, n)
    names: Sequence[str]  #: shape (n,): pairs of confounded effects in words, or effects of the library
    tied: bool

    def told(self, chosen: Sequence[int]) -> tuple[int, int]:
        """Return how many are told apart, and how many surely."""
        (distances,) = self.of([chosen])
        return int((distances >= SEPARATION_SD).sum()), int((distances >= ENOUGH_SD).sum())

    def score(self, distances: FloatArray) -> tuple[float, float]:
        """Return the least distance, without pairs how many are separated, and all together."""
        capped = np.minimum(distances, CAP_SD)
        separated = float(np.minimum(distances / SEPARATION_SD, 1.0).sum())
        return round(float(capped.min()), 6) if self.tied else separated, float(capped.sum())

    def gains(self, before: FloatArray, after: FloatArray) -> list[int]:
        """Return what gains most."""
        order = np.argsort(-(np.minimum(after, CAP_SD) - np.minimum(before, CAP_SD)))[:MOST_NAMED]
        return [int(k) for k in order if after[k] > before[k] + NOTEWORTHY_SD]

    def why(self, before: FloatArray, after: FloatArray, distances: FloatArray) -> str:
        """Return what a run tells apart or shows, or begins to where the next go on to `distances`."""
        gains, parts = self.gains(before, after), list[str]()
        if not self.tied:
            new = [k for k in gains if before[k] < SEPARATION_SD]
            clear = [k for k in new if after[k] >= SEPARATION_SD]
            shown = f"shows {', '.join(self.names[k] for k in clear or new or gains)}{' better' * (not clear)}"
            return shown if gains else ""
        for k in (k for k in gains if distances[k] >= SEPARATION_SD):
            tells, surely = after[k] >= SEPARATION_SD, " more surely" * bool(before[k] >= SEPARATION_SD)
            parts.append(f"{'tells' if tells else 'begins to tell'} {self.names[k]}{surely}")
        return ", ".join(parts)


def tied(apart: Apart, number: IntArray, counts: IntArray, ties: Sequence[Sequence[str]]) -> Task:
    """Return the task of telling named causes from what they are confounded with; without pairs where none is named."""
    driven = (number < 0).astype(np.float64)
    named = {name for own, _ in apart(driven) for name in own}
    groups = [(named.intersection(tie), tie) for tie in ties]
    pairs = [(own, other) for own, tie in groups if own for other in tie if other not in own]

    def of(sets: Sequence[Sequence[int]]) -> FloatArray:
        every = [
            min((near[one] for group, near in each if one in near and own & {*group}), default=CAP_SD)
            for chosen in sets
            for each in [apart(driven + counts[number] * np.isin(number, chosen))]
            for own, one in pairs
        ]
        return np.reshape(every, (len(sets), len(pairs)))

    # grouped by their odds: what tells them comes on top
    before = of([()])
    beyond = np.where(before >= SEPARATION_SD, before, 0.0) ** 2
    names = [f"{' and '.join(sorted(own))} from {other}" for own, other in pairs]
    return Task(lambda sets: np.sqrt(np.maximum(of(sets) ** 2 - beyond, 0.0)), names, tied=True)


def untied(signatures: Signatures, number: IntArray, counts: IntArray) -> Task:
    """Return the task of showing all effects, each apart from its nearest neighbour."""
    grams = {n: signatures.gram(number == n) * (counts[n] if n >= 0 else 1) for n in set(number.tolist())}

    def of(sets: Sequence[Sequence[int]]) -> FloatArray:
        return np.stack([one(np.sum([grams[n] for n in (-1, *chosen) if n in grams], axis=0)) for chosen in sets])

    def one(gram: FloatArray) -> FloatArray:
        signal, distance = signatures.distances(gram)
        return np.asarray(np.minimum(signal, distance.min(axis=-1, initial=np.inf)))

    return Task(of, signatures.names, tied=False)
