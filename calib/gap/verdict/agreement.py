"""How far the corrections of causes that these runs cannot tell apart differ on the runs driven."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.arrays import FloatArray
from calib.gap.effects.calibration import DIRECTIONS, NAMES
from calib.gap.effects.effect import Form
from calib.gap.evidence.fit import hypothesis_path
from calib.gap.evidence.marginal import CALIBRATION_SD
from calib.gap.evidence.system import LinearSystem
from calib.gap.evidence.weighting import Weighting, prior_precision
from calib.gap.predict.path import Path
from calib.gap.verdict.evidence import Evidence

__all__ = ["agreement_m"]


def agreement_m(evidence: Evidence, groups: Sequence[Sequence[str]]) -> float | None:
    """Return the root mean square distance of end positions under causes that stand in for one another, the largest.

    An instrument that reads wrongly moves no vehicle: its correction and that of a radius lie as far apart as the
    radius moves the ends.

    Parameters
    ----------
    evidence : Evidence
        What was measured.
    groups : sequence of sequence of str
        Effects that cannot be told apart, the named one first.

    Returns
    -------
    float or None
        None where nothing is tied.
    """
    apart = []
    for group in groups:
        own = [name for name in group if name in evidence.named]
        for other in group:
            if other not in own:
                ends = _ends_under(evidence, own, other)
                if ends is not None:
                    apart.append(float(np.sqrt(np.mean(((ends - evidence.fitted.path.end)[:, :2] ** 2).sum(axis=1)))))
    return max(apart, default=None)


def _ends_under(evidence: Evidence, own: Sequence[str], other: str) -> FloatArray | None:
    """Return the end poses (n_units, 3) with some named causes exchanged for another; None where it has no form."""
    fitted = evidence.fitted
    kept = [form for form in fitted.forms if form.effect not in own]
    if other in NAMES:
        candidates = [kept]
    else:
        candidates = [[*kept, form] for form in evidence.search.forms.get(other, ())]
    held = [NAMES.index(name) for name in own if name in NAMES]
    best: tuple[float, FloatArray] | None = None
    for forms in candidates:
        left, path = _exchanged(evidence, forms, held)
        if best is None or left < best[0]:
            best = left, path.end
    return None if best is None else best[1]


def _exchanged(evidence: Evidence, forms: Sequence[Form], held: Sequence[int]) -> tuple[float, Path]:
    """Return the whitened squares that forms leave, some directions of the calibration held at nought, and the path."""
    fitted = evidence.fitted
    every = [*fitted.forms, *(form for form in forms if all(form is not own for own in fitted.forms))]
    system = LinearSystem(fitted, evidence.nominal, evidence.noise, every)
    numbers = [next(k for k, offered in enumerate(every) if offered is form) for form in forms]
    free = [k for k in range(len(NAMES)) if k not in held]
    directions = DIRECTIONS[free].T
    calibration = (system.calibration / CALIBRATION_SD) @ directions * CALIBRATION_SD[0]
    columns = np.concatenate([calibration, *(system.of(k) for k in numbers)], axis=1)
    weighting = Weighting.from_rest(system, -1, 0.0, np.zeros((len(system.gap), 0)))
    precision = np.concatenate([np.ones(len(free)), prior_precision(4 + columns.shape[1] - len(free))[4:]])
    sizes, _ = weighting.solve(columns, precision)
    left = system.gap - columns @ sizes
    change = directions @ sizes[: len(free)] * CALIBRATION_SD[0]
    cuts = np.cumsum([len(free), *(len(form.parameters) for form in forms)])
    theta = [sizes[a:b] * form.typical for a, b, form in zip(cuts[:-1], cuts[1:], forms, strict=True)]
    return float(left @ left), hypothesis_path(fitted.path.s, change, forms, theta, fitted.path)
