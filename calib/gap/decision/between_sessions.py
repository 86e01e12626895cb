"""How much wider sizes are known where radii step from session to session, named or not.

Steps too small to name are a variance component (Searle, Casella, McCulloch, Variance Components, 1992): restricted
likelihood gives their scatter, Satterthwaite's degrees of freedom how well it is known.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from calib.gap.decision.diagnosis import Cause, Evidence
from calib.gap.decision.held_out import ADEQUATE_CLOSURE, MOST_SESSION_FOLDS, improvement_of, left_with_others
from calib.gap.effects.effect import Family
from calib.gap.effects.radii import DIRECTIONS, NAMES, SessionStep
from calib.gap.inference.fit import fit, whitened_rows
from calib.gap.inference.least_squares import HeldOutFit
from calib.types import FloatArray

#: relative step of a radius: unit of the scatter
_STEP: Final = 5e-4
#: prior precision of a step, in its unit: a thousand, left to the data
_STEP_PRECISION: Final = 1e-6
#: log variances searched, in squares of the unit: steps of 1e-6 to 1e-2
_LOG_VARIANCES: Final = (-12.4, 6.0)
_SIDES: Final = ("left", "right")
#: families of causes that follow what may go together with the sessions
SET_WITH_SESSIONS: Final = (Family.DRIFT, Family.LOAD, Family.SPEED)
#: chance that a true cause fails any test of constancy, or steps pass for one, the usual level
FALSE_REJECTION: Final = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class SessionScatter:
    """Covariance of the estimates, recalibration first, without and beside steps; `dof` of the steps' variance."""

    without: FloatArray  #: shape (p, p)
    beside: FloatArray  #: shape (p, p)
    dof: float

    def widening(self, weights: FloatArray, dof: float) -> FloatArray:
        """Return by how much intervals of combinations (p, k) are wider, (k,); `dof`: of the noise."""
        from scipy.special import stdtrit

        run = np.einsum("pk,pq,qk->k", weights, self.without, weights)
        session = np.maximum(np.einsum("pk,pq,qk->k", weights, self.beside, weights) - run, 0.0)
        joint = (run + session) ** 2 / (run**2 / dof + session**2 / self.dof)
        widening: FloatArray = stdtrit(joint, 0.975) / stdtrit(dof, 0.975) * np.sqrt(1.0 + session / run)
        return np.maximum(widening, 1.0)


def session_scatter(evidence: Evidence) -> SessionScatter | None:
    """Return what the radii's steps add to sizes; None without sessions or scatter, or with steps named."""
    fitted = evidence.fitted
    fit = HeldOutFit(fitted, evidence.nominal, evidence.noise, evidence.search.weighting)
    blocks = fit.weighting.system.blocks
    labels, session = np.unique(evidence.observations.labels["session"][blocks.unit], return_inverse=True)
    if len(labels) < 2 or any(form.effect == SessionStep.id for form in fitted.forms):
        return None
    radii = whitened_rows(fitted.path, evidence.noise, fitted.path.calibration[:, :, :2])[blocks.order] * _STEP
    inside = session[:, None] == np.arange(len(labels))
    steps = (radii[:, :, None] * inside[:, None, :]).reshape(len(radii), -1)
    columns, p = np.concatenate([fit.columns, steps], axis=1), fit.columns.shape[1]

    def solved(precision: float) -> tuple[FloatArray, FloatArray]:
        return fit.weighting.solve(columns, np.concatenate([fit.precision, np.full(steps.shape[1], precision)]))

    estimates, covariance = solved(_STEP_PRECISION)
    variance, dof = variance_component(estimates[p:], covariance[p:, p:])
    if not variance:
        return None
    without = fit.weighting.solve(fit.columns, fit.precision)[1]
    return SessionScatter(without, solved(1.0 / variance)[1][:p, :p], dof)


def variance_component(estimates: FloatArray, covariance: FloatArray) -> tuple[float, float]:
    """Return the variance beyond covariance (m, m) that estimates (m,) of mean zero scatter by, and its dof.

    0.0 where none is likelier; dof by the variance's Fisher information.
    """
    from scipy.optimize import minimize_scalar

    variances, axes = np.linalg.eigh(covariance)
    squares = (axes.T @ estimates) ** 2

    def misfit(log_variance: float) -> float:
        whole = variances + np.exp(log_variance)
        return float(np.sum(np.log(whole) + squares / whole))

    best = minimize_scalar(misfit, bounds=_LOG_VARIANCES, method="bounded", options={"xatol": 1e-6})
    if best.fun >= misfit(_LOG_VARIANCES[0]):
        return 0.0, 0.0
    variance = float(np.exp(best.x))
    return variance, float(np.sum((variance / (variances + variance)) ** 2))


def without_refuted(evidence: Evidence, groups: Sequence[Sequence[str]]) -> list[list[str]]:
    """Return groups of confounded effects, the named one first, without session steps that its predictions refute."""
    kept = []
    for named, *others in groups:
        lasting = [name for name in others if not (name in evidence.effects and evidence.effects[name].per_session)]
        kept.append([named, *(lasting if lasting != others and _is_predicted(evidence, named) else others)])
    return kept


def _is_predicted(evidence: Evidence, effect: str) -> bool:
    """Return whether a cause closes whole sessions held out, paired with the fit of the others alone.

    No session tells of another's step. By F, as what few sessions share may be chance. Not of what may have been set
    with the session, or follows their order as steps that last do.
    """
    from scipy.special import fdtrc

    improvement, family = evidence.held_out.improvement, evidence.effects[effect].family
    if family in SET_WITH_SESSIONS or improvement is None or improvement.closed_ci95[0] < ADEQUATE_CLOSURE:
        return False
    forms = [form for form in evidence.fitted.forms if form.effect != effect]
    along = DIRECTIONS[[name != effect for name in NAMES]]
    others = fit(evidence.nominal, evidence.noise, forms, along=along, start=evidence.fitted)
    known = (evidence.nominal, evidence.noise, evidence.search.weighting)
    left, by = left_with_others(HeldOutFit(others, *known, along), sessions=True)
    closed = improvement_of(HeldOutFit(evidence.fitted, *known), sessions=True, stated=left).closed_ci95[0]
    k = len(evidence.fitted.parameters) - sum(len(form.parameters) for form in forms) or 1
    free = min(len(np.unique(evidence.observations.labels["session"])), MOST_SESSION_FOLDS) - 1 - k
    ratio = max(closed, 0.0) / max(1.0 - closed, 1e-9) * free / k
    return by == evidence.held_out.closure.held_out == "session" and float(fdtrc(k, free, ratio)) < FALSE_REJECTION


def beside_named_steps(causes: Sequence[Cause], later: Sequence[str] = ()) -> Iterator[Cause]:
    """Yield causes; radii beside session steps with an interval that holds their scatter.

    They are means of the sessions driven, no promise for others. `later`: names of all but the first.
    """
    step = next((cause for cause in causes if cause.effect == SessionStep.id), None)
    steps = {} if step is None else step.parameters
    # the first session's is not stated: the others count from it
    by_session = [[0.0, *(size.value for name, size in steps.items() if name.startswith(side))] for side in _SIDES]
    if step is not None and step.form:
        before = 1 + later.index(next(iter(steps)).partition("_")[2])
        by_session = [[0.0] * before + [own[-1]] * (len(later) + 1 - before) for own in by_session]
    for cause in causes:
        if steps and cause.effect in SessionStep.shifts:
            direction = DIRECTIONS[NAMES.index(cause.effect), : len(_SIDES)]
            more = half_of_mean(direction @ np.array(by_session) / (direction @ direction))
            (name, size) = next(iter(cause.parameters.items()))
            half = float(np.hypot(more, 0.5 * (size.ci95[1] - size.ci95[0])))
            whole = replace(size, ci95=(size.value - half, size.value + half))
            text = f"the mean of {len(by_session[0])} sessions, and the interval holds their steps"
            cause = replace(cause, parameters={name: whole}, remark=cause.remark or text)
        yield cause


def half_of_mean(results: FloatArray) -> float:
    """Return half the 95 % interval of the mean of independent results (n,), Student's t."""
    from scipy.special import stdtrit

    n = len(results)
    return float(stdtrit(n - 1, 0.975) * np.std(results, ddof=1) / np.sqrt(n))
