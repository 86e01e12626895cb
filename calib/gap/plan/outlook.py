"""What a plan of runs could show: before anything is driven, or beside what was."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from calib.arrays import BoolArray, FloatArray
from calib.campaign.model import Campaign
from calib.gap.data.from_campaign import observations_of
from calib.gap.effects.effect import Effect, Form
from calib.gap.effects.library import library
from calib.gap.evidence.marginal import CALIBRATION_SD, Nuisance, project, rows
from calib.gap.evidence.whitened import WhitenedSystem
from calib.gap.plan.separability import SEEN, Signatures, noise_at
from calib.gap.predict.path import predict
from calib.gap.verdict.alternatives import NEAR
from calib.gap.verdict.outcome import Detectable
from calib.progress import Progress, silent, stepped

#: an effect of which a recalibration leaves less than this share is hidden in it for good
HIDDEN: Final = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Outlook:
    """What a set of runs can show."""

    effects: tuple[str, ...]  #: effects that the runs vary anything for, shape (n,)
    absent: tuple[str, ...]  #: effects that have nothing to act on in these runs
    signal: FloatArray  #: shape (n,): whitened norm of each at its typical size, beside a free recalibration
    #: shape (n, n): row's effect at its typical size against all that the column's could do, in standard deviations;
    #: infinite on the diagonal
    distance: FloatArray
    smallest: dict[str, Detectable]  #: smallest size of each effect that would be seen

    @property
    def told_apart(self) -> BoolArray:
        """Which effects, at typical size, are seen and stand apart from every other, shape (n,)."""
        return np.asarray((self.signal >= NEAR) & (self.distance.min(axis=1) >= NEAR))

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values; the diagonal is null."""
        apart = self.told_apart
        return {
            "effects": list(self.effects),
            "absent": list(self.absent),
            "signal": [float(value) for value in self.signal],
            "distance": [[float(d) if np.isfinite(d) else None for d in row] for row in self.distance],
            "smallest": {name: limit.sentence for name, limit in self.smallest.items()},
            "not_seen": [name for name, value in zip(self.effects, self.signal, strict=True) if value < NEAR],
            "told_apart": [name for name, yes in zip(self.effects, apart, strict=True) if yes],
            "confused": {
                name: [self.effects[k] for k in np.flatnonzero(self.distance[number] < NEAR)]
                for number, name in enumerate(self.effects)
                if self.signal[number] >= NEAR and not apart[number]
            },
        }


def outlook_of(campaign: Campaign, progress: Progress = silent) -> Outlook:
    """Return what the runs of a campaign, driven or not, can show of the whole library."""
    observations = observations_of(campaign)
    path = predict(observations)
    noise = noise_at(path, {})
    effects = library(observations, declared=campaign.extra.get("effects", ()))
    signatures = Signatures(path, noise, effects)
    signal, distance = signatures.distances(signatures.gram(np.ones(len(observations), dtype=bool)))
    forms = signatures.offered
    shown = _Shown(rows(path, noise, path.calibration * CALIBRATION_SD), signatures.of_form)
    return Outlook(
        effects=tuple(signatures.names),
        absent=tuple(name for name, tried in forms.items() if not tried),
        signal=signal,
        distance=distance,
        smallest=_smallest(shown, effects, forms, only_blind=False, progress=progress),
    )


def undetectable(
    bench: WhitenedSystem, effects: Sequence[Effect], forms: Mapping[str, Sequence[Form]] | None = None
) -> tuple[Detectable, ...]:
    """Return the effects that these runs could not have shown at their typical size, with the smallest that they could.

    `never` where nothing in the runs varies what the effect acts through, or a recalibration hides it wholly. Forms
    that are known already need not be asked of the effects again.
    """
    known = forms or {}
    every = {effect.id: known.get(effect.id) or effect.forms(bench.path.s) for effect in effects}
    shown = _Shown(bench.calibration, bench.columns)
    return tuple(_smallest(shown, effects, every, only_blind=True).values())


@dataclass(frozen=True, slots=True, eq=False)
class _Shown:
    """What some runs show: whitened columns of a recalibration, (n_rows, 4), and of a form, (n_rows, n_parameters)."""

    calibration: FloatArray
    of_form: Callable[[Form], FloatArray]


def _smallest(
    shown: _Shown,
    effects: Sequence[Effect],
    offered: Mapping[str, Sequence[Form]],
    *,
    only_blind: bool,
    progress: Progress = silent,
) -> dict[str, Detectable]:
    recalibration = Nuisance.of(shown.calibration)
    own_left_out = Nuisance.of(shown.calibration[:, 3:])
    limits: dict[str, Detectable] = {}
    for effect in stepped(effects, progress, "effects"):
        forms = offered[effect.id]
        if not forms:
            why = "nothing that it acts through is measured, or varies, in these runs"
            limits[effect.id] = Detectable(effect.id, why, never=True)
            continue
        nuisance = own_left_out if effect.calibration else recalibration
        best: tuple[float, Form, int] | None = None
        raw_norm = 0.0
        for form in forms:
            columns = shown.of_form(form)
            # a single direction of the form is asked at a time, the recalibration free beside it
            left = np.sqrt((project(nuisance, columns) ** 2).sum(axis=0))
            raw = np.sqrt((columns**2).sum(axis=0))
            raw_norm = max(raw_norm, float(raw.max(initial=0.0)))
            for number, value in enumerate(left):
                if value > HIDDEN * max(float(raw[number]), 1e-12) and value > 0.0:
                    times = SEEN / float(value)
                    # of two that are alike but for rounding, the first
                    if best is None or times < best[0] * (1.0 - 1e-9):
                        best = (times, form, number)
        if best is None:
            why = "hidden in the calibration" if raw_norm > 0.0 else "it moves nothing measured here"
            limits[effect.id] = Detectable(effect.id, why, never=True)
            continue
        times, form, number = best
        if only_blind and times <= 1.0:
            continue
        parameter = form.parameters[number]
        unit = "" if parameter.unit == "1" else f" {parameter.unit}"
        words = [parameter.name.replace("_", " ")] if parameter.name else []
        words += ["more than is plausible"] if times * parameter.typical > parameter.largest else []
        size = f"{times * parameter.typical:.2g}{unit}" + (f" ({', '.join(words)})" if words else "")
        limits[effect.id] = Detectable(effect.id, size)
    return limits
