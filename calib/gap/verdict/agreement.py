"""How far the corrections of causes that cannot be told apart differ, on the runs driven or on other journeys."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.arrays import FloatArray
from calib.gap.data.observations import Observations
from calib.gap.effects.applied import applied_pushes, section_of
from calib.gap.effects.calibration import DIRECTIONS, NAMES
from calib.gap.effects.effect import Form
from calib.gap.evidence.fit import calibration_pushes, hypothesis_path
from calib.gap.evidence.marginal import CALIBRATION_SD
from calib.gap.evidence.system import LinearSystem
from calib.gap.evidence.weighting import Weighting, prior_precision
from calib.gap.predict.path import Path, predict
from calib.gap.verdict.evidence import Evidence


@dataclass(frozen=True, slots=True, eq=False)
class _Correction:
    """A recalibration, shape (4,), and forms with their sizes."""

    calibration: FloatArray
    forms: Sequence[Form]
    theta: Sequence[FloatArray]

    def ends_as_driven(self, about: Path) -> FloatArray:
        """Return the end poses (n_units, 3) of the runs that it was fitted on."""
        return hypothesis_path(about.s, self.calibration, self.forms, self.theta, about).end

    def ends_on(self, journeys: Observations, declared: object) -> FloatArray:
        """Return the end poses (n_units, 3) of other runs; what has nothing to act on there does nothing."""
        sections = [section_of(form, sizes) for form, sizes in zip(self.forms, self.theta, strict=True)]
        pushes, _ = applied_pushes(journeys, sections, declared=declared)
        return predict(journeys, [*calibration_pushes(journeys, self.calibration, None), *pushes]).end


def agreement_m(evidence: Evidence, groups: Sequence[Sequence[str]]) -> float | None:
    """Return the root mean square distance of end positions under causes that stand in for one another, the largest.

    The ends are those of the journeys that the evidence asks about, else of the runs driven. An instrument that reads
    wrongly moves no vehicle: its correction and that of a radius lie as far apart as the radius moves the ends.

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
    fitted = evidence.fitted
    best = _Correction(fitted.calibration, fitted.forms, fitted.theta)
    apart = []
    for group in groups:
        own = [name for name in group if name in evidence.named]
        for other in group:
            exchanged = None if other in own else _exchanged(evidence, own, other)
            if exchanged is not None:
                apart.append(_distance_m(evidence, best, exchanged))
    return max(apart, default=None)


def _distance_m(evidence: Evidence, one: _Correction, other: _Correction) -> float:
    if evidence.journeys is None:
        # about the path of the fit, where the pushes of both were taken
        here, there = evidence.fitted.path.end, other.ends_as_driven(evidence.fitted.path)
    else:
        # beside the runs driven, so that what the two differ in varies
        to_come = ~np.isin(evidence.journeys.labels["run_id"], evidence.observations.labels["run_id"])
        here, there = (each.ends_on(evidence.journeys, evidence.declared)[to_come] for each in (one, other))
    return float(np.sqrt(np.mean(((there - here)[:, :2] ** 2).sum(axis=1))))


def _exchanged(evidence: Evidence, own: Sequence[str], other: str) -> _Correction | None:
    """Return the correction with some named causes exchanged for another, fitted anew; None where it has no form."""
    kept = [form for form in evidence.fitted.forms if form.effect not in own]
    if other in NAMES:
        candidates = [kept]
    else:
        candidates = [[*kept, form] for form in evidence.search.forms.get(other, ())]
    held = [NAMES.index(name) for name in own if name in NAMES]
    refitted = [_refitted(evidence, forms, held) for forms in candidates]
    return min(refitted, key=lambda tried: tried[0])[1] if refitted else None


def _refitted(evidence: Evidence, forms: Sequence[Form], held: Sequence[int]) -> tuple[float, _Correction]:
    """Return what forms leave in whitened squares, some directions of the calibration held at nought, and the fit."""
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
    return float(left @ left), _Correction(change, forms, theta)
