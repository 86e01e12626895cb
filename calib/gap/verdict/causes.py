"""The named causes with their sizes, shares and probabilities."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np

from calib.arrays import FloatArray
from calib.gap.effects.calibration import DIRECTIONS, NAMES
from calib.gap.effects.effect import Form
from calib.gap.evidence.determined import said_of_undetermined, undetermined
from calib.gap.evidence.marginal import Nuisance
from calib.gap.verdict.evidence import Evidence
from calib.gap.verdict.rest import explained_share
from calib.gap.verdict.result import Cause, Quantity

#: within one of these classes of probability the order is by the signal
CLASSES: Final = (0.3, 0.6, 0.8)


@dataclass(frozen=True, slots=True, eq=False)
class _Sized:
    """A form at its fitted size: standard uncertainty, whitened columns per unit (n_rows, n_parameters), and signal."""

    form: Form
    theta: FloatArray
    sd: FloatArray
    columns: FloatArray
    signal: float

    @property
    def squares(self) -> float:
        """Squares of what it does, whitened."""
        contribution = self.columns @ self.theta
        return float(contribution @ contribution)

    def squares_sd(self, covariance: FloatArray) -> float:
        """Return the standard uncertainty of `squares` for normal errors of the size (n_parameters, n_parameters)."""
        gram = self.columns.T @ self.columns
        spread = gram @ covariance
        along = gram @ self.theta
        return float(np.sqrt(4.0 * along @ covariance @ along + 2.0 * np.trace(spread @ spread)))


def causes_of(
    evidence: Evidence,
    probabilities: Mapping[str, float],
    certain: Mapping[str, float],
    forms_open: Mapping[str, tuple[str, ...]],
) -> list[Cause]:
    """Return the causes of the best hypothesis and of the recalibration, most probable first.

    What stands in for a cause, another form of its family above all, takes nothing from its place.

    Parameters
    ----------
    evidence : Evidence
        What was measured.
    probabilities : mapping of str to float
        Of each effect, from `calib.gap.verdict.odds.effect_probabilities`.
    certain : mapping of str to float
        Of each named effect, the probability that it or what stands in for it is at work.
    forms_open : mapping of str to tuple of str
        For each named effect, others of its family that these runs cannot tell it from.
    """
    from scipy.special import stdtrit

    system, fitted = evidence.system, evidence.fitted
    coverage = float(stdtrit(max(evidence.noise.dof, 3.0), 0.975))
    free = max(len(system.gap) - len(fitted.parameters) - 4, 1)
    # beside a rest the spread has what is left in it already
    inflation = 1.0 if evidence.search.weighting.name else float(np.sqrt(max(1.0, fitted.chi_square / free)))
    every = _sized(evidence)
    shares, half_widths = _shares(evidence, every, inflation, coverage)
    causes = [
        replace(
            _cause(evidence, sized, inflation, coverage, probabilities.get(sized.form.effect, 0.0)),
            share=share,
            share_ci95=(max(share - half, 0.0), min(share + half, 1.0)),
            forms_open=forms_open.get(sized.form.effect, ()),
        )
        for sized, share, half in zip(every, shares, half_widths, strict=True)
    ]
    return sorted(causes, key=lambda cause: (-int(np.digitize(certain[cause.effect], CLASSES)), -cause.signal))


def _shares(
    evidence: Evidence, every: list[_Sized], inflation: float, coverage: float
) -> tuple[list[float], list[float]]:
    """Return what each cause carries of the gap beyond the floor, and half its 95 % interval.

    What the named causes explain together is divided by their squares; the errors of their sizes are propagated to
    that ratio to first order, those of different causes as independent.
    """
    explained, explained_sd = explained_share(evidence)
    squares = np.array([sized.squares for sized in every])
    sd = np.array([inflation**2 * sized.squares_sd(_scaled_covariance(evidence, sized)) for sized in every])
    total = max(float(squares.sum()), 1e-12)
    ratio = squares / total
    slopes = (np.eye(len(every)) - ratio[:, None]) / total
    half = coverage * np.sqrt(explained**2 * (slopes**2) @ sd**2 + (ratio * explained_sd) ** 2)
    return (explained * ratio).tolist(), half.tolist()


def _sized(evidence: Evidence) -> list[_Sized]:
    """Return the forms of the named effects, calibration parameters last."""
    system, fitted, recalibration = evidence.system, evidence.fitted, evidence.recalibration
    nuisance = Nuisance.of(system.calibration)
    cuts = np.cumsum([4, *(len(theta) for theta in fitted.theta)])
    deviation = np.sqrt(np.diag(fitted.covariance))
    spreads = [deviation[first:last] for first, last in pairwise(cuts)]
    sized = []
    for form, theta, sd in zip(fitted.forms, fitted.theta, spreads, strict=True):
        columns = system.columns(form) / form.typical
        whitened = (columns @ theta)[:, None]
        signal = float(np.sqrt(nuisance.scalar(whitened, whitened)[0, 0]))
        sized.append(_Sized(form, theta, sd, columns, signal))
    for name in evidence.calibration:
        k = NAMES.index(name)
        form = evidence.effects[name].forms(evidence.observations)[0]
        columns = (evidence.per_unit @ DIRECTIONS[k])[:, None]
        value, sd = recalibration.values[[k]], recalibration.sd[[k]]
        sized.append(_Sized(form, value, sd, columns, float(recalibration.signal[k])))
    return sized


def _cause(evidence: Evidence, sized: _Sized, inflation: float, coverage: float, probability: float) -> Cause:
    """Return a cause, its share aside."""
    form, effect = sized.form, evidence.effects[sized.form.effect]
    spread = sized.sd * inflation
    quantities = {
        parameter.name: Quantity(
            float(value), (float(value - coverage * sd), float(value + coverage * sd)), parameter.unit
        )
        for parameter, value, sd in zip(form.parameters, sized.theta, spread, strict=True)
    }
    sizes = zip(form.parameters, sized.theta, spread, strict=True)
    times = max((abs(value) - 2 * sd) / parameter.largest for parameter, value, sd in sizes)
    remark = f"{times:.2g} times what is physically plausible: suspect {effect.implausible}" if times > 1.0 else ""
    not_told = undetermined(form.parameters, sized.theta, coverage * spread)
    if not_told:
        covariance = inflation**2 * _scaled_covariance(evidence, sized)
        remark = said_of_undetermined(form.parameters, sized.theta, covariance, coverage) or remark
    return Cause(
        effect=effect.id,
        title=effect.title,
        form=form.label,
        probability=probability,
        share=0.0,
        signal=sized.signal,
        parameters=quantities,
        plausible=bool(times <= 1.0) and len(not_told) < len(form.parameters),
        remark=remark,
        undetermined=not_told,
        settings=form.settings,
        family=effect.family.value,
    )


def _scaled_covariance(evidence: Evidence, sized: _Sized) -> FloatArray:
    """Return the covariance of a form's parameters: correlated as in the fit, as uncertain as stated."""
    fitted, first = evidence.fitted, 4
    for form in fitted.forms:
        last = first + len(form.parameters)
        if form is sized.form:
            block = fitted.covariance[first:last, first:last]
            root = np.sqrt(np.diag(block))
            return np.asarray(block / np.outer(root, root) * np.outer(sized.sd, sized.sd))
        first = last
    return np.diag(sized.sd**2)
