"""From a campaign to a verdict: where the gap lies, which effect causes it, how far it shrinks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from calib.campaign.model import Campaign
from calib.campaign.settings import OdometryModel
from calib.errors import RefusedError
from calib.gap.data.from_campaign import observations_of
from calib.gap.data.observations import Observations
from calib.gap.effects.applied import with_effects
from calib.gap.effects.effect import Effect
from calib.gap.effects.encoder_gross import corrected
from calib.gap.effects.library import fault_before_search, library
from calib.gap.evidence.fit import Fitted, fit
from calib.gap.evidence.marginal import FLOOR_DOF
from calib.gap.evidence.noise import Noise, estimate_noise
from calib.gap.evidence.recalibration import judge_recalibration
from calib.gap.evidence.search import Search, Settings, search
from calib.gap.evidence.whitened import WhitenedSystem
from calib.gap.plan.next_runs import next_runs, undetectable
from calib.gap.predict.path import Path, predict
from calib.gap.predict.residuals import residuals
from calib.gap.verdict.closure import Closure, measure_closure
from calib.gap.verdict.decide import Judge
from calib.gap.verdict.result import Verdict
from calib.gap.verdict.sentence import sentence
from calib.gap.where.covariates import locate

if TYPE_CHECKING:
    from calib.coefficients.sections import EffectSection

__all__ = ["Diagnosis", "diagnose", "diagnose_in_full"]

#: by which factor at most what the fit leaves may enlarge the floor's variance
MOST_FLOOR: Final = 1.5
#: how often at most the floor is taken again once a large effect is known
PASSES: Final = 3


@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis:
    """A verdict with the arrays behind it, for figures.

    Parameters
    ----------
    verdict : Verdict
        The answer.
    situation : Observations
        Units and steps.
    noise : Noise
        Covariance of each unit.
    nominal : Path
        The model alone.
    fitted : Fitted
        The hypothesis that the verdict names, the recalibration free.
    closure : Closure
        The gap before and after on held-out runs.
    found : Search
        All hypotheses tried, and the forms of the library on this campaign.
    effects : tuple of Effect
        The library that it was judged by.
    """

    verdict: Verdict
    situation: Observations
    noise: Noise
    nominal: Path
    fitted: Fitted
    closure: Closure
    found: Search
    effects: tuple[Effect, ...]


def diagnose(
    campaign: Campaign,
    *,
    seed: int = 0,
    exclude: tuple[str, ...] = (),
    model: OdometryModel | None = None,
    applied: Sequence[EffectSection] = (),
    settings: Settings | None = None,
    plan: bool = True,
) -> Verdict:
    """Diagnose the gap of a campaign; see `diagnose_in_full`."""
    return diagnose_in_full(
        campaign, seed=seed, exclude=exclude, model=model, applied=applied, settings=settings, plan=plan
    ).verdict


def diagnose_in_full(
    campaign: Campaign,
    *,
    seed: int = 0,
    exclude: tuple[str, ...] = (),
    model: OdometryModel | None = None,
    applied: Sequence[EffectSection] = (),
    settings: Settings | None = None,
    plan: bool = True,
) -> Diagnosis:
    """Diagnose the gap of a campaign.

    Parameters
    ----------
    campaign : Campaign
        What was driven and measured.
    seed : int
        For the bootstrap of intervals.
    exclude : tuple of str
        Effects to leave out of the library.
    model : OdometryModel, optional
        What the simulator believes; the campaign's own by default.
    applied : sequence of EffectSection
        Effects that the simulator has already, from a coefficient file.
    settings : Settings, optional
        What the search takes for granted.
    plan : bool
        Look for the runs that would tell tied causes apart, where there are any.

    Returns
    -------
    Diagnosis

    Raises
    ------
    RefusedError
        Where no run has both counts and something measured.
    """
    settings = settings or Settings()
    declared = campaign.extra.get("effects", ())
    s = observations_of(campaign, model)
    if not s.usable.any():
        raise RefusedError(
            f"{campaign.name}: no run has a channel that can be compared with the simulation; an end pose needs "
            "ref_x_m and ref_y_m together and a log where the path bends, or give distance_m or ref_theta_rad"
        )
    notes: tuple[str, ...] = ()
    if applied:
        s, notes = with_effects(s, applied, declared=declared)
    nominal = predict(s)
    before = residuals(nominal, nominal)
    fault = fault_before_search(s, nominal, exclude)
    if fault is not None:
        s = corrected(s, fault)
        nominal = predict(s)
    effects = library(s, exclude=exclude, declared=declared)
    noise, base = _settle(nominal)
    found = search(nominal, noise, base, effects, settings)
    chosen = found.hypotheses[0]
    for _ in range(PASSES):
        # what a large effect leaves within conditions is no noise: take the floor again without it, and ask again
        again = estimate_noise(chosen.fitted.path, chosen.fitted.left) if chosen.effects else noise
        if again is noise or not _differ(noise, again):
            break
        noise, base = again, fit(nominal, again, start=base)
        found = search(nominal, noise, base, effects, settings)
        chosen = found.hypotheses[0]
    shifts = {effect.id: effect.shifts for effect in effects}
    recalibration = judge_recalibration(chosen.fitted, nominal, noise, settings, shifts)
    rng = np.random.default_rng(seed)
    # where no cause is missing, what is left is noise, and its size the better estimate of the floor
    n_rows = int(s.usable.sum())
    factor = (FLOOR_DOF + chosen.fitted.chi_square) / (FLOOR_DOF + n_rows)
    factor = 1.0 if chosen.unknown else min(factor, MOST_FLOOR)
    whole = not any(effect.per_session for effect in effects if effect.id in chosen.effects)
    closure = measure_closure(nominal, noise, chosen.fitted, rng, sessions=whole, floor_factor=factor)
    if fault is not None:
        closure = replace(closure, before=before)
    where = locate(s, nominal, noise, closure.before, rng=rng, campaign=campaign)
    judge = Judge(campaign, nominal, noise, effects, found, recalibration, closure, fault, settings)
    blind = undetectable(WhitenedSystem(base.path, nominal, noise), effects)
    verdict = judge.verdict(where, blind, notes)
    verdict = replace(verdict, sentence=sentence(verdict))
    if plan and verdict.indistinguishable:
        ties = verdict.indistinguishable
        wanted = next_runs(campaign, effects, noise, ties, chosen.fitted, model=model)
        verdict = replace(verdict, next_runs=tuple(wanted))
    return Diagnosis(verdict, s, noise, nominal, chosen.fitted, closure, found, tuple(effects))


def _differ(before: Noise, after: Noise) -> bool:
    """Return whether the typical floor of any channel changed by more than a quarter."""
    ratio = np.median(before.floor / after.floor, axis=0)
    return bool((np.abs(np.log(ratio)) > np.log(1.25)).any())


def _settle(nominal: Path) -> tuple[Noise, Fitted]:
    """Fit the recalibration and the noise in turn."""
    noise = estimate_noise(nominal, residuals(nominal, nominal))
    base = fit(nominal, noise)
    noise = estimate_noise(base.path, base.left)
    return noise, fit(nominal, noise, start=base)
