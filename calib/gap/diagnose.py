"""From a campaign to a verdict: where the gap lies, which effect causes it, how far it shrinks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import count
from typing import TYPE_CHECKING, Final

import numpy as np

from calib.arrays import FloatArray
from calib.campaign.model import Campaign
from calib.campaign.settings import OdometryModel
from calib.errors import BadInputError, RefusedError
from calib.gap.data.from_campaign import observations_of
from calib.gap.data.observations import Observations
from calib.gap.diagnosis import Diagnosis
from calib.gap.effects.applied import with_effects
from calib.gap.effects.effect import Effect
from calib.gap.effects.encoder_gross import GrossFault, corrected
from calib.gap.effects.library import fault_before_search, library, turned_before_search
from calib.gap.effects.turned_reference import TurnedReference
from calib.gap.evidence.climb import Settings
from calib.gap.evidence.fit import Fitted, fit
from calib.gap.evidence.left_out import LeftOut
from calib.gap.evidence.marginal import FLOOR_DOF
from calib.gap.evidence.noise import Noise, estimate_noise
from calib.gap.evidence.recalibration import judge_recalibration
from calib.gap.evidence.search import Search, search
from calib.gap.evidence.whitened import WhitenedSystem
from calib.gap.plan.next_runs import next_runs
from calib.gap.plan.outlook import undetectable
from calib.gap.plan.planned_runs import joined
from calib.gap.predict.path import Path, predict
from calib.gap.predict.residuals import residuals
from calib.gap.verdict.closure import HeldOut, measure_closure
from calib.gap.verdict.decide import decide
from calib.gap.verdict.evidence import Evidence
from calib.gap.verdict.result import BY_MODEL, BY_SIMULATOR
from calib.gap.verdict.transfer import trials
from calib.gap.where.locate import locate
from calib.progress import Progress, silent

if TYPE_CHECKING:
    from calib.coefficients.sections import EffectSection

#: by which factor at most what the fit leaves may enlarge the floor's variance
MOST_FLOOR: Final = 1.5
#: how often at most the floor is taken again once a large effect is known
PASSES: Final = 3
#: of a millimetre the square is a part in 1e18 of this way's: double precision ends there
FURTHEST_M: Final = 1e6


def diagnose_in_full(
    campaign: Campaign,
    *,
    seed: int = 0,
    exclude: tuple[str, ...] = (),
    model: OdometryModel | None = None,
    applied: Sequence[EffectSection] = (),
    settings: Settings | None = None,
    plan: bool = True,
    model_name: str = "",
    observations: Observations | None = None,
    journeys: Campaign | None = None,
    progress: Progress = silent,
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
    model_name : str
        Name of the file that `model` is from, for the verdict to say what it judged against.
    observations : Observations, optional
        What was observed on the campaign, in place of its own files: planted effects, drawn noise. `model` and
        `applied` are in it already.
    journeys : Campaign, optional
        Runs still to be driven, of `calib.gap.plan.plan_file.read_plan`: where causes cannot be told apart, their
        corrections are compared on these instead of on the runs driven.
    progress : callable
        See `calib.progress.Progress`.

    Raises
    ------
    RefusedError
        Where no run has both counts and something measured.
    """
    settings = settings or Settings()
    rng = np.random.default_rng(seed)
    declared = campaign.extra.get("effects", ())
    situation = _situation(campaign, model, applied, exclude, observations)
    campaign, observations = situation.campaign, situation.observations
    judged_against = BY_SIMULATOR if np.isfinite(observations.simulated).any() else (model_name or BY_MODEL)
    nominal = predict(observations)
    effects = library(observations, exclude=exclude, declared=declared)
    shifts = {effect.id: effect.shifts for effect in effects}
    noise, base, searched = _searched(nominal, effects, settings, progress)
    best = searched.fitted
    progress(0, 0, "verdict")
    left_out = LeftOut(best, nominal, noise, searched.weighting)
    held_out = _held_out(nominal, noise, searched, effects, left_out, rng)
    if situation.as_counted is not None:
        held_out = replace(held_out, before=situation.as_counted)
    alone = WhitenedSystem(base.path, nominal, noise)
    alone.know(searched.alone)
    evidence = Evidence(
        campaign=campaign.name,
        simulated=campaign.simulated,
        nominal=nominal,
        noise=noise,
        effects={effect.id: effect for effect in effects},
        search=searched,
        recalibration=judge_recalibration(best, nominal, noise, settings, shifts, searched),
        held_out=held_out,
        trials=trials(left_out, residuals(nominal, nominal), noise.dof),
        where=locate(observations, nominal, noise, held_out.before, rng=rng, floor=held_out.floor, campaign=campaign),
        undetectable=undetectable(alone, effects, searched.forms),
        faults=situation.faults,
        settings=settings,
        notes=situation.notes,
        judged_against=judged_against,
        journeys=None if journeys is None else observations_of(joined(campaign, journeys), observations.model),
        declared=declared,
    )
    verdict = decide(evidence)
    if plan and verdict.groups:
        progress(0, 0, "next runs")
        ties = [group.effects for group in verdict.groups]
        verdict = replace(verdict, next_runs=tuple(next_runs(campaign, effects, noise, ties, best, model=model)))
    return Diagnosis(verdict, observations, noise, nominal, best, held_out, searched, tuple(effects))


@dataclass(frozen=True, slots=True, eq=False)
class _Situation:
    """What was driven, gross faults put right; and the gap with the counts as they were, where they were wrong."""

    campaign: Campaign
    observations: Observations
    notes: tuple[str, ...]
    faults: tuple[GrossFault | TurnedReference, ...]
    as_counted: FloatArray | None


def _situation(
    campaign: Campaign,
    model: OdometryModel | None,
    applied: Sequence[EffectSection],
    exclude: tuple[str, ...],
    observations: Observations | None,
) -> _Situation:
    faults: list[GrossFault | TurnedReference] = []
    notes: tuple[str, ...] = ()
    if observations is None:
        observations, notes = _observed(campaign, model, applied)
        turned = turned_before_search(predict(observations), exclude)
        if turned is not None:
            faults.append(turned)
            campaign = turned.put_right(campaign)
            observations, notes = _observed(campaign, model, applied)
    nominal = predict(observations)
    fault = fault_before_search(observations, nominal, exclude)
    if fault is None:
        return _Situation(campaign, observations, notes, tuple(faults), None)
    as_counted = residuals(nominal, nominal)
    return _Situation(campaign, corrected(observations, fault), notes, (*faults, fault), as_counted)


def _observed(
    campaign: Campaign, model: OdometryModel | None, applied: Sequence[EffectSection]
) -> tuple[Observations, tuple[str, ...]]:
    """Return what was driven, as a simulator that has some effects already predicts it, and what had to be assumed."""
    observations = observations_of(campaign, model)
    _check_ways(campaign, observations)
    if not observations.usable.any():
        raise RefusedError(
            f"{campaign.name}: no run has a channel that can be compared with the simulation; an end pose needs "
            "ref_x_m and ref_y_m together and a log where the path bends, or give distance_m or ref_theta_rad"
        )
    if not applied:
        return observations, ()
    return with_effects(observations, applied, declared=campaign.extra.get("effects", ()))


def _check_ways(campaign: Campaign, observations: Observations) -> None:
    """Refuse runs whose wheels rolled further than can be computed with beside millimetres."""
    for travel_m in (observations.travel_left_m, observations.travel_right_m):
        ways_m = np.bincount(observations.unit, np.abs(travel_m), len(observations))
        number = int(np.argmax(ways_m))
        if not ways_m[number] <= FURTHEST_M:
            raise BadInputError(
                f"{campaign.name}: run {observations.labels['run_id'][number]}: found counts of a way of "
                f"{ways_m[number]:.3g} m; expected {FURTHEST_M:.0e} m at most, beside which a millimetre is lost in "
                "rounding; look at the counts of this run"
            )


def _searched(
    nominal: Path, effects: Sequence[Effect], settings: Settings, progress: Progress
) -> tuple[Noise, Fitted, Search]:
    """Return the floor, the recalibration alone, and the hypotheses tried; the floor is that of the best of them."""
    passes = count(1)

    def passed() -> None:
        # how many passes it takes, the data decide
        progress(next(passes), 0, "search of causes")

    noise, base = _settle(nominal)
    searched = search(nominal, noise, base, effects, settings, passed=passed)
    for _ in range(PASSES):
        best = searched.fitted
        # what a large effect leaves within conditions is no noise: take the floor again without it, and ask again
        again = estimate_noise(best.path, best.left) if best.forms else noise
        if again is noise or not _differ(noise, again):
            break
        noise, base = again, fit(nominal, again, start=base)
        searched = search(nominal, noise, base, effects, settings, start=searched, passed=passed)
    return noise, base, searched


def _held_out(
    nominal: Path,
    noise: Noise,
    searched: Search,
    effects: Sequence[Effect],
    left_out: LeftOut,
    rng: np.random.Generator,
) -> HeldOut:
    """Return the gap before and after on runs left out: whole sessions, unless the cause is a step between them."""
    # where no cause is missing, what is left is noise, and its size the better estimate of the floor
    best, n_rows = searched.fitted, int(nominal.s.usable.sum())
    factor = (FLOOR_DOF + best.chi_square) / (FLOOR_DOF + n_rows)
    factor = 1.0 if searched.rest > 0.5 else min(factor, MOST_FLOOR)
    sessions = not any(effect.per_session for effect in effects if effect.id in searched.effects)
    return measure_closure(nominal, noise, best, rng, sessions=sessions, floor_factor=factor, left_out=left_out)


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
