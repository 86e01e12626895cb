"""The pipeline of a diagnosis: from a campaign to the causes of its gap and what their correction is worth."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import count
from pathlib import Path as FilePath
from typing import Final

import numpy as np

from calib.campaign.checks import listed, pasted_rows
from calib.campaign.model import SIMULATED_POSE, Campaign
from calib.campaign.settings import OdometryModel
from calib.coefficients.sections import EffectSection
from calib.gap.decision import trials
from calib.gap.decision.confounding import apart_on
from calib.gap.decision.decide import decide
from calib.gap.decision.diagnosis import BY_MODEL, BY_SIMULATOR, Diagnosis, Evidence, Situation, VerdictKind
from calib.gap.decision.held_out import measure_closure
from calib.gap.decision.kind import (
    OF_A_PATH,
    beside_geometry,
    fails,
    kept_back,
    open_questions,
    tells_more,
    with_left,
)
from calib.gap.decision.sought import (
    Sought,
    furthest,
    lone_recordings,
    lone_run,
    lone_windows,
    refuse_copied,
    without_runs,
)
from calib.gap.effects import Effect
from calib.gap.effects.encoder import BLUNDER_MISFIT, misfit
from calib.gap.effects.library import ELSEWHERE, beyond_law, library, model_of, with_mounting_of
from calib.gap.effects.reference import ReferenceLeverArm, ReferenceYaw
from calib.gap.effects.simulator import IntegrationScheme
from calib.gap.inference import EVEN_PROBABILITY
from calib.gap.inference.fit import Fitted, recalibrate
from calib.gap.inference.least_squares import HeldOutFit, WhitenedSystem
from calib.gap.inference.local_search import SearchResult
from calib.gap.inference.marginal_likelihood import FLOOR_DOF
from calib.gap.inference.model_search import search
from calib.gap.inference.noise import Noise, estimate_noise
from calib.gap.inference.recalibration import judge_recalibration
from calib.gap.localise.locate import locate
from calib.gap.observations import Observations
from calib.gap.observations.from_campaign import observations_of, with_known_loads
from calib.gap.plan import undetectable
from calib.gap.plan.planned_runs import joined
from calib.gap.predict import Path, residuals
from calib.types import Progress, silent

#: largest variance factor of the fit over the noise level
MOST_VARIANCE_FACTOR: Final = 1.5
#: estimates of the noise level, each without causes named so far: one or two settle it
NOISE_PASSES: Final = 3
#: change of the noise level that calls for another search
NOISE_CHANGE: Final = 1.25
#: searches beside a reference mounted as found: turned, its place, and its delay
MOUNTINGS: Final = 3


def diagnose_in_full(
    campaign: Campaign,
    *,
    seed: int = 0,
    exclude: tuple[str, ...] = (),
    model: OdometryModel | None = None,
    applied: Sequence[EffectSection] = (),
    plan: bool = True,
    model_name: str = "",
    observations: Observations | None = None,
    candidates: Sequence[Effect] | None = None,
    journeys: Campaign | None = None,
    progress: Progress = silent,
) -> Diagnosis:
    """Diagnose the gap of a campaign by the ends of its runs, and by windows of its recordings where these tell more.

    For parameters see `calib.api.results.diagnose`; `applied`: effects of `model`; `model_name`: its file, or what
    simulated. `plan`: recommend runs. `observations` stand in place of the campaign's, and hold `model` and `applied`;
    `candidates` in place of the library.
    """
    sought, planted = Sought(model, applied, exclude), observations
    campaign, unloaded = (campaign, "") if planted is not None else with_known_loads(campaign)
    copied = [note.run_id for note in pasted_rows(campaign.included())] if planted is None else []
    campaign = without_runs(campaign, copied)
    situation = sought.situation(campaign) if planted is None else sought.counted(campaign, planted, ())
    if planted is None and (lone := lone_run(situation)):
        situation = replace(sought.situation(without_runs(campaign, lone)), omitted=lone)
    kept, seen = without_runs(campaign, situation.omitted), situation.observations
    own = planted is None and (bool(applied) or not np.isfinite(seen.simulated).any())
    if own:
        refuse_copied(situation.campaign, situation.nominal)
    judge = partial(_judged, (seed, model_name, candidates, journeys), progress)
    diagnosis = judge(kept, sought, situation)
    if own:
        kept, diagnosis = _beside_lone(judge, kept, sought, situation, diagnosis)
    unsure = all(cause.probability < EVEN_PROBABILITY for cause in diagnosis.causes)
    if own and not seen.windowed and (unsure or diagnosis.recommended):
        along = replace(sought, into_windows=True)
        windows = replace(along.situation(kept), omitted=situation.omitted)
        if windows.observations.windowed and diagnosis.recommended:
            diagnosis = kept_back(diagnosis, windows.nominal, windows.noise)
        elif windows.observations.windowed and tells_more(by_windows := judge(kept, along, windows), diagnosis):
            diagnosis = kept_back(by_windows, diagnosis.arrays.nominal, diagnosis.arrays.noise)
    diagnosis = beside_geometry(diagnosis, kept) if own else diagnosis
    notes = (f"copies of other runs, which count once: {listed(copied)}",) * bool(copied) + diagnosis.notes
    diagnosis = replace(diagnosis, sentence=f"{diagnosis.sentence}{unloaded}", notes=notes)
    if not plan or not diagnosis.groups or (evidence := diagnosis.evidence) is None:
        return diagnosis
    from calib.gap.plan.next_runs import next_runs

    progress(0, 0, "next runs")
    driven = replace(evidence.situation.campaign, model=model or campaign.model)
    known = driven, [*evidence.effects.values()], evidence.noise, open_questions(diagnosis)
    return replace(diagnosis, next_runs=tuple(next_runs(*known, apart_on=partial(apart_on, evidence))))


def _beside_lone(
    judge: Callable[[Campaign, Sought, Situation], Diagnosis],
    kept: Campaign,
    sought: Sought,
    situation: Situation,
    diagnosis: Diagnosis,
) -> tuple[Campaign, Diagnosis]:
    """Return campaign and diagnosis without recordings or windows that are off by themselves, where that settles it.

    Parameters
    ----------
    judge
        `_judged`, asked and all.
    kept, sought, situation, diagnosis
        What was judged, and how it ended.
    """

    def doubtful() -> bool:
        return not diagnosis.recommended and diagnosis.kind is not VerdictKind.NO_GAP

    seen = situation.observations
    unknown = diagnosis.kind is VerdictKind.UNKNOWN and bool(OF_A_PATH.intersection(kept.logs.columns))
    by_path = seen.windowed or unknown
    if doubtful() and (lone := lone_recordings(situation) if by_path else _furthest(diagnosis)):
        others = without_runs(kept, lone)
        again = judge(others, sought, replace(sought.situation(others), omitted={**situation.omitted, **lone}))
        named = again.kind is not VerdictKind.UNKNOWN if unknown else not diagnosis.causes
        if again.recommended or again.kind is VerdictKind.NO_GAP or named:
            kept, diagnosis = others, again
    without, omitted = lone_windows(situation) if doubtful() and seen.windowed else (set(), {})
    if without:
        read = replace(sought, without=without)
        omitted = {**diagnosis.arrays.situation.omitted, **omitted}
        again = judge(kept, read, replace(read.situation(kept), omitted=omitted))
        if again.recommended or again.kind is VerdictKind.NO_GAP:
            diagnosis = again
    return kept, diagnosis


def _furthest(diagnosis: Diagnosis) -> dict[str, float]:
    """Return the run, by id, its share off, that the best fit leaves three times as far off as any other."""
    evidence = diagnosis.arrays
    seen, fitted = evidence.observations, evidence.fitted
    off = np.sqrt(evidence.left_out.squares(fitted.left) / np.fmax(seen.usable.sum(axis=1), 1))
    run, kind = furthest(off), seen.labels["kind"]
    apart = run >= 0 and (kind == kind[run]).sum() > 1
    return {str(seen.labels["run_id"][run]): float(misfit(fitted.path)[run])} if apart else {}


def _judged(
    asked: tuple[int, str, Sequence[Effect] | None, Campaign | None],
    progress: Progress,
    recorded: Campaign,
    sought: Sought,
    situation: Situation,
) -> Diagnosis:
    seed, model_name, candidates, journeys = asked
    rng, declared = np.random.default_rng(seed), recorded.extra.get("effects", ())
    campaign, observations = situation.campaign, situation.observations
    simulator = BY_SIMULATOR if np.isfinite(observations.simulated).any() and not sought.applied else None
    nominal = situation.nominal
    outside = not sought.applied or any(name in campaign.runs.numbers for name in SIMULATED_POSE)
    # what calib's own model predicts is integrated exactly
    exclude = sought.exclude if outside else (*sought.exclude, IntegrationScheme.id)
    effects = library(observations, exclude=exclude, declared=declared) if candidates is None else [*candidates]
    offered, every = {effect.id for effect in effects}, effects
    effects, noise, base, searched = _searched(nominal, situation.noise, effects, progress)
    for number in range(MOUNTINGS if candidates is None else 0):
        if mounted := sought.mounted(recorded, situation, searched, every, refine=number == 0):
            situation = sought.remounted(recorded, situation, mounted)
            known = {fault.effect.id for fault in mounted} - {ReferenceYaw.id}
            effects, nominal = [effect for effect in every if effect.id not in known], situation.nominal
            offered -= known
            effects, noise, base, searched = _searched(nominal, situation.noise, effects, progress)
    campaign, observations = situation.campaign, situation.observations
    progress(0, 0, "verdict")
    fitted = searched.fitted
    left_out = HeldOutFit(fitted, nominal, noise, searched.weighting)
    # where no cause is missing, the residual is noise
    factor = (FLOOR_DOF + fitted.chi_square) / (FLOOR_DOF + int(observations.usable.sum()))
    held_out = measure_closure(
        left_out,
        rng,
        sessions=not any(effect.per_session for effect in effects if effect.id in searched.effects),
        floor_factor=1.0 if searched.rest > EVEN_PROBABILITY else min(factor, MOST_VARIANCE_FACTOR),
        as_counted=situation.as_counted,
    )
    shifts = {effect.id: effect.own_shifts for effect in effects}
    evidence = Evidence(
        situation=situation,
        judged_against=(candidates is None and simulator) or model_name or BY_MODEL,
        nominal=nominal,
        noise=noise,
        effects={effect.id: effect for effect in effects},
        search=searched,
        recalibration=judge_recalibration(searched, shifts),
        held_out=held_out,
        trials=trials(left_out, residuals(nominal, nominal)),
        where=locate(nominal, noise, held_out.before, held_out.floor, fitted.left, campaign, rng),
        journeys=None if journeys is None else observations_of(joined(campaign, journeys), observations.model),
    )
    recalibrated = WhitenedSystem(base.path, nominal, noise, known=searched.alone)
    diagnosis = replace(with_left(decide(evidence)), undetectable=undetectable(recalibrated, effects, searched.forms))
    struck = ", ".join(sorted(offered - evidence.effects.keys()))
    note = f"{struck}: not confirmed on routes held out, and not among the causes"
    return replace(diagnosis, notes=(*diagnosis.notes, note)) if struck else diagnosis


def _holds(nominal: Path, noise: Noise, searched: SearchResult) -> bool:
    best, gap = searched.fitted, residuals(nominal, nominal)
    transfer = trials(HeldOutFit(best, nominal, noise, searched.weighting), gap)
    routes = [trial for trial in transfer if trial.left_out == "kind"]
    gained = sum(trial.before_square - trial.after_square for trial in routes)
    return gained > 0.0 and not any(map(fails, routes))


def diagnosed(
    campaign: Campaign,
    model: FilePath | str | None,
    exclude: Sequence[str],
    seed: int,
    journeys: FilePath | str | None,
    *,
    progress: Progress = silent,
) -> tuple[Diagnosis, tuple[EffectSection, ...]]:
    """Return the diagnosis of calib's own model, and the effects that this model has already; see `diagnose_in_full`.

    The words of the diagnosis name the model by its file.
    """
    believed, effects = (None, ()) if model is None else model_of(FilePath(model), campaign)
    mounted, acting = (campaign, effects) if model is None else with_mounting_of(FilePath(model), campaign, effects)
    planned = None
    if journeys is not None:
        from calib.gap.plan.next_runs import read_plan

        planned = read_plan(FilePath(journeys))
    diagnosis = diagnose_in_full(
        mounted,
        seed=seed,
        exclude=tuple(exclude),
        model=believed,
        applied=acting,
        model_name="" if model is None else FilePath(model).name,
        journeys=planned,
        progress=progress,
    )
    beyond = () if model is None else beyond_law(model, diagnosis.observations)
    diagnosis = replace(diagnosis, notes=(*diagnosis.notes, *beyond))
    kept = [effect for effect in effects if effect.effect != ReferenceLeverArm.id]
    return diagnosis, tuple(effect for effect in kept if not effect.form.endswith(ELSEWHERE))


def _searched(
    nominal: Path, alone: Noise, effects: Sequence[Effect], progress: Progress
) -> tuple[list[Effect], Noise, Fitted, SearchResult]:
    """Return effects, noise, recalibration alone and model search; the noise is that beside the best hypothesis.

    `alone`: noise about the model alone. What rests on an assumption is none of the effects where it does not hold on
    routes that it was not fitted on.
    """
    passes = count(1)

    def passed() -> None:
        progress(next(passes), 0, "search of causes")

    noise, base = alone, recalibrate(nominal, alone)
    if base.calibration.any():
        noise = estimate_noise(base.path, base.left)
        base = recalibrate(nominal, noise, base)
    searched = search(nominal, noise, base, effects, passed=passed)
    for _ in range(NOISE_PASSES):
        best = searched.fitted
        # what a large effect leaves within conditions is no noise
        again = estimate_noise(best.path, best.left) if best.forms else noise
        ratio, usable = noise.floor / again.floor, nominal.s.usable
        change = np.array([abs(np.log(np.median(ratio[use, k]))) for k, use in enumerate(usable.T) if use.any()])
        # runs far off under any effect are a blunder at any noise level
        if (
            not (change > np.log(NOISE_CHANGE)).any()
            or np.mean(misfit(best.path, nominal, by_extent=True)) >= BLUNDER_MISFIT
        ):
            break
        noise, base = again, recalibrate(nominal, again, base)
        searched = search(nominal, noise, base, effects, start=searched, passed=passed)
    assumed = {each.id for each in effects if each.id in searched.effects and each.assumption(nominal.s)}
    if assumed and not _holds(nominal, noise, searched):
        return _searched(nominal, alone, [each for each in effects if each.id not in assumed], progress)
    return [*effects], noise, base, searched
