"""What each effect leaves on given runs at its typical size: its signature."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.arrays import FloatArray
from calib.gap.effects.effect import Effect, Form
from calib.gap.predict.path import Path, predict, signature


@dataclass(frozen=True, slots=True, eq=False)
class EffectSignature:
    """What an effect does to the readings of given runs, to first order."""

    effect: Effect  #: the cause
    form: Form  #: of its forms the one that shows most
    #: shape (n_units, n_channels): change of each reading at the typical sizes of the form's parameters, NaN where a
    #: unit lacks the channel
    change: FloatArray
    enlarged: Path  #: the paths with the effect so much larger that it can be seen on a floor plan
    factor: float  #: by how much larger than typical


#: a path on a floor plan is drawn apart by about this share of its extent
SEEN: float = 0.12


def signature_of(effect: Effect, nominal: Path) -> EffectSignature | None:
    """Return the signature of an effect on the runs of a path; None where it has no form there."""
    observations = nominal.s
    best: tuple[float, Form, FloatArray] | None = None
    for form in effect.forms(observations):
        pushes = form.pushes(nominal)
        changes = [signature(nominal, push) * size for push, size in zip(pushes, form.typical, strict=True)]
        change = np.where(observations.usable, np.sum(changes, axis=0), np.nan)
        size = float(np.sqrt(np.nansum(change**2)))
        if best is None or size > best[0]:
            best = size, form, change
    if best is None:
        return None
    _, form, change = best
    away = float(np.nanmax(np.abs(change[:, 1:3]), initial=0.0))
    extent = float(np.max(np.hypot(nominal.x_m, nominal.y_m), initial=1.0))
    factor = float(np.clip(SEEN * extent / away, 1.0, 200.0)) if away > 0 else 1.0
    pushes = [push.scaled(factor * size) for push, size in zip(form.pushes(nominal), form.typical, strict=True)]
    return EffectSignature(effect, form, change, predict(observations, list(pushes)), factor)
