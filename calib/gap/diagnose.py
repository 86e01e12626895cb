"""The pipeline of a diagnosis: from a campaign to the causes of its gap and what their correction is worth."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import count
from pathlib import Path as FilePath
from typing import Final

import numpy as np

from calib.campaign.check import implausible, notes_for_results
from calib.campaign.checks.design import listed, pasted_rows
from calib.campaign.model import Campaign
from calib.campaign.settings import OdometryModel
from calib.coefficients.sections import EffectSection
from calib.errors import BadInputError, RefusedError
from calib.gap.decision.confounding import apart_on
from calib.gap.decision.decide import decide
from calib.gap.decision.diagnosis import BY_MODEL, BY_SIMULATOR, Diagnosis, Evidence, Situation
from calib.gap.decision.held_out import measure_closure
from calib.gap.decision.kind import fails, kept_back, open_questions, tells_more, with_left
from calib.gap.decision.trials import most_square, trials
from calib.gap.effects.effect import Effect
from calib.gap.effects.encoder import BLUNDER_MISFIT, EncoderBlunder, bad_runs, corrected, find_blunder, misfit
from calib.gap.effects.library import ELSEWHERE, beyond_law, library, model_of, with_effects, with_sensor_of
from calib.gap.effects.reference import ReferenceYaw, TurnedReference, find_turned
from calib.gap.effects.simulator import as_simulated
from calib.gap.effects.steering import steering_blunder
from calib.gap.inference.fit import Fitted, recalibrate, squares_by_unit
from calib.gap.inference.least_squares import HeldOutFit
from calib.gap.inference.linear_model import WhitenedSystem
from calib.gap.inference.local_search import SearchResult
from calib.gap.inference.marginal_likelihood import FLOOR_DOF
from calib.gap.inference.model_search import search
from calib.gap.inference.noise import Noise, estimate_noise
from calib.gap.inference.recalibration import judge_recalibration
from calib.gap.inference.thresholds import EVEN_PROBABILITY
from calib.gap.localise.locate import locate
from calib.gap.observations.arrays import Channel, Observations
from calib.gap.observations.from_campaign import check_distances, observations_of, with_known_loads
from calib.gap.plan.identifiability import undetectable
from calib.gap.plan.planned_runs import joined
from calib.gap.predict import Path, measured_gap, predict, residuals
from calib.types import FloatArray, Progress, silent

#: largest variance factor of the fit over the noise level: more is a cause not found
MOST_VARIANCE_FACTOR: Final = 1.5
#: estimates of the noise level, each without the causes named so far; it settles in one or two
NOISE_PASSES: Final = 3
#: change of a typical noise level that calls for another search: below, the evidence changes by less than its scatter
NOISE_CHANGE: Final = 1.25
#: headings that agree with the counts within this share of their standard uncertainty, on so many runs of which one
#: turns by so much, are the odometry's own
COPIED_SHARE: Final = 1e-6
FEWEST_COPIED: Final = 4
LEAST_TURN_RAD: Final = 1e-2


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

    Parameters and refusals: see `calib.api.results.diagnose`; of `model` the effects are `applied` ones, and
    `model_name` is its file. `plan`: recommend runs. `observations` stand in place of the campaign's, and hold `model`
    and `applied`; `candidates` in place of the library, and `model_name` is then what simulated.
    """
    sought, planted = _Sought(model, applied, exclude), observations
    campaign, unloaded = (campaign, "") if planted is not None else with_known_loads(campaign)
    copied = [note.run_id for note in pasted_rows(campaign.included())] if planted is None else []
    campaign = _without(campaign, copied)
    situation = sought.situation(campaign) if planted is None else sought.counted(campaign, planted, ())
    if planted is None and (lone := _lone_run(situation)):
        situation = replace(sought.situation(_without(campaign, lone)), omitted=lone)
    given, found = _without(campaign, situation.omitted), situation.observations
    own = planted is None and (bool(applied) or not np.isfinite(found.simulated).any())
    if own:
        _check_copied(situation.campaign, predict(found))
    judge = partial(_judged, given, (seed, model_name, candidates, journeys), progress)
    diagnosis = judge(sought, situation)
    unsure = all(cause.probability < EVEN_PROBABILITY for cause in diagnosis.causes)
    if own and not found.windowed and (unsure or diagnosis.recommended):
        along = replace(sought, into_windows=True)
        windows = replace(along.situation(given), omitted=situation.omitted)
        nominal = predict(windows.observations)
        if windows.observations.windowed and diagnosis.recommended:
            diagnosis = kept_back(diagnosis, nominal, estimate_noise(nominal, residuals(nominal, nominal)))
        elif windows.observations.windowed and tells_more(by_windows := judge(along, windows), diagnosis):
            diagnosis = kept_back(by_windows, diagnosis.arrays.nominal, diagnosis.arrays.noise)
    notes = (f"copies of other runs, which count once: {listed(copied)}",) * bool(copied) + diagnosis.notes
    diagnosis = replace(diagnosis, sentence=f"{diagnosis.sentence}{unloaded}", notes=notes)
    if not plan or not diagnosis.groups or (evidence := diagnosis.evidence) is None:
        return diagnosis
    from calib.gap.plan.next_runs import next_runs

    progress(0, 0, "next runs")
    driven = replace(evidence.situation.campaign, model=model or campaign.model)
    known = driven, [*evidence.effects.values()], evidence.noise, open_questions(diagnosis)
    return replace(diagnosis, next_runs=tuple(next_runs(*known, apart_on=partial(apart_on, evidence))))


def _judged(
    given: Campaign,
    asked: tuple[int, str, Sequence[Effect] | None, Campaign | None],
    progress: Progress,
    sought: "_Sought",
    situation: Situation,
) -> Diagnosis:
    seed, model_name, candidates, journeys = asked
    rng, declared = np.random.default_rng(seed), given.extra.get("effects", ())
    campaign, observations = situation.campaign, situation.observations
    simulator = BY_SIMULATOR if np.isfinite(observations.simulated).any() and not sought.applied else None
    nominal = predict(observations)
    effects = library(observations, exclude=sought.exclude, declared=declared) if candidates is None else [*candidates]
    offered = {effect.id for effect in effects}
    effects, noise, base, searched = _searched(nominal, effects, progress)
    if refined := _refined(situation, searched.fitted):
        again = sought.corrected(given, refined, situation.as_counted)
        situation = replace(again, omitted=situation.omitted)
        campaign, observations, nominal = situation.campaign, situation.observations, predict(situation.observations)
        effects, noise, base, searched = _searched(nominal, effects, progress)
    progress(0, 0, "verdict")
    fitted = searched.fitted
    left_out = HeldOutFit(fitted, nominal, noise, searched.weighting)
    # where no cause is missing, the residual is noise, and a better estimate of its level
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
    said = f"{struck}: not confirmed on routes held out, and not among the causes"
    return replace(diagnosis, notes=(*diagnosis.notes, said)) if struck else diagnosis


def _holds(nominal: Path, noise: Noise, searched: SearchResult) -> bool:
    best, gap = searched.fitted, residuals(nominal, nominal)
    tried = trials(HeldOutFit(best, nominal, noise, searched.weighting), gap)
    routes = [trial for trial in tried if trial.left_out == "kind"]
    gained = sum(trial.before_square - trial.after_square for trial in routes)
    return gained > 0.0 and not any(map(fails, routes))


def diagnosed(
    campaign: Campaign,
    model: FilePath | str | None,
    exclude: Sequence[str],
    seed: int,
    journeys: FilePath | str | None,
    *,
    name: str = "",
    progress: Progress = silent,
) -> tuple[Diagnosis, tuple[EffectSection, ...]]:
    """Return the diagnosis of calib's own model, and the effects that this model has already; see `diagnose_in_full`.

    `name`: the model's, for the words of the diagnosis.
    """
    believed, effects = (None, ()) if model is None else model_of(FilePath(model), campaign)
    planned = None
    if journeys is not None:
        from calib.gap.plan.next_runs import read_plan

        planned = read_plan(FilePath(journeys))
    found = diagnose_in_full(
        campaign if model is None else with_sensor_of(FilePath(model), campaign),
        seed=seed,
        exclude=tuple(exclude),
        model=believed,
        applied=effects,
        model_name=name,
        journeys=planned,
        progress=progress,
    )
    beyond = () if model is None else beyond_law(model, found.observations)
    found = replace(found, notes=(*found.notes, *beyond))
    return found, tuple(effect for effect in effects if not effect.form.endswith(ELSEWHERE))


@dataclass(frozen=True, slots=True)
class _Sought:
    model: OdometryModel | None
    applied: Sequence[EffectSection]
    exclude: tuple[str, ...]
    into_windows: bool | None = None

    def situation(self, campaign: Campaign) -> Situation:
        """Return what was driven, blunders of the reference's mounting and of the encoders corrected."""
        observations, notes = self.observed(campaign, self.applied)
        nominal = predict(observations)
        # effects that the model has stand where an outside simulator's poses would
        bare = predict(self.observed(campaign, ())[0]) if self.applied else nominal
        if turned := None if ReferenceYaw.id in self.exclude else find_turned(bare):
            return self.corrected(campaign, turned, measured_gap(nominal, nominal))
        if omitted := bad_runs(nominal):
            return replace(self.situation(_without(campaign, omitted)), omitted=omitted)
        return self.counted(campaign, observations, notes)

    def corrected(self, campaign: Campaign, turned: TurnedReference, as_read: FloatArray | None) -> Situation:
        campaign = turned.correct(campaign)
        return self.counted(campaign, *self.observed(campaign, self.applied), (turned,), as_read)

    def counted(
        self,
        campaign: Campaign,
        observations: Observations,
        notes: tuple[str, ...],
        faults: tuple[TurnedReference, ...] = (),
        as_counted: FloatArray | None = None,
    ) -> Situation:
        # `as_counted`: the gap as first read
        nominal = predict(observations)
        fault = None if EncoderBlunder.id in self.exclude else find_blunder(observations, nominal)
        if fault is None:
            return Situation(campaign, observations, notes, faults, as_counted)
        if as_counted is None:
            as_counted = measured_gap(nominal, nominal)
        return Situation(campaign, corrected(observations, fault), notes, (*faults, fault), as_counted)

    def observed(self, campaign: Campaign, applied: Sequence[EffectSection]) -> tuple[Observations, tuple[str, ...]]:
        observations = observations_of(campaign, self.model, into_windows=self.into_windows)
        if np.isfinite(observations.simulated).any():
            observations = as_simulated(observations)
        if blunder := steering_blunder(observations):
            raise BadInputError(f"{campaign.name}: column steer_rad: {blunder}, then diagnose again")
        check_distances(campaign, observations)
        if not observations.usable.any():
            raise RefusedError(
                f"{campaign.name}: no run has a channel that can be compared with the simulation; an end pose needs "
                "ref_x_m and ref_y_m together and a log where the path bends, or give distance_m or ref_theta_rad"
            )
        said = (*(note.sentence for note in implausible(campaign)), *notes_for_results(campaign))
        if not applied:
            return observations, said
        changed, notes = with_effects(observations, applied, declared=campaign.extra.get("effects", ()))
        return changed, (*said, *notes)


def _lone_run(situation: Situation) -> dict[str, float]:
    """Return the one run, by id, its share off, beside which a recalibration leaves all others within the stated noise.

    Only where nothing was driven twice: repeats tell noise by themselves. Another run of its kind stays.
    """
    nominal = predict(situation.observations)
    noise, observations = estimate_noise(nominal, residuals(nominal, nominal)), situation.observations
    rows = observations.usable.sum(axis=1)
    if observations.windowed or noise.dof > 0.0 or not noise.supported or situation.omitted:
        return {}
    squares = squares_by_unit(nominal, noise, (whole := recalibrate(nominal, noise)).left)
    run, kind = int(np.argmax(squares)), observations.labels["kind"]
    if whole.chi_square <= most_square(int(rows.sum())) or (kind == kind[run]).sum() < 2:
        return {}
    weight = np.where(np.arange(len(rows)) == run, 1e12, 1.0)[:, None, None]
    others = recalibrate(nominal, replace(noise, covariance=noise.covariance * weight))
    if others.chi_square > most_square(int(rows.sum() - rows[run])):
        return {}
    return {str(observations.labels["run_id"][run]): float(misfit(others.path, nominal)[run])}


def _without(campaign: Campaign, omitted: Collection[str]) -> Campaign:
    if not omitted:
        return campaign
    excluded = campaign.runs.excluded | np.isin(campaign.runs.label("run_id"), list(omitted))
    return replace(campaign, runs=replace(campaign.runs, excluded=excluded))


def _refined(situation: Situation, fitted: Fitted) -> TurnedReference | None:
    for form, theta, place in fitted.each():
        if form.effect == ReferenceYaw.id and form.label == ReferenceYaw.OF_POSITION:
            sd_rad = float(np.sqrt(fitted.covariance[place, place][0, 0]))
            turned = (fault for fault in situation.faults if isinstance(fault, TurnedReference))
            return next((fault.refined(float(theta[0]), sd_rad) for fault in turned), None)
    return None


def _check_copied(campaign: Campaign, nominal: Path) -> None:
    observations = nominal.s
    measured = observations.usable[:, Channel.HEADING]
    turned_rad = nominal.end[measured, 2] + residuals(nominal, nominal)[measured, Channel.HEADING]
    if measured.sum() < FEWEST_COPIED or np.abs(turned_rad).max() < LEAST_TURN_RAD:
        return
    travels_m = (observations.travel_left_m, observations.travel_right_m)
    ways_m = np.stack([np.bincount(observations.unit, one, len(observations))[measured] for one in travels_m], axis=1)
    off_rad = float(np.abs(turned_rad - ways_m @ np.linalg.lstsq(ways_m, turned_rad)[0]).max())
    stated_rad = float(np.min(observations.sigma[measured, Channel.HEADING]))
    if off_rad < COPIED_SHARE * stated_rad:
        raise BadInputError(
            f"{campaign.name}: column ref_theta_rad: found headings that agree with the counts within {off_rad:.1g} "
            f"rad on all {measured.sum()} runs, where their standard uncertainty is {1e3 * stated_rad:.2g} mrad; "
            "expected those of an instrument of its own: these were computed from the counts"
        )


def _searched(
    nominal: Path, effects: Sequence[Effect], progress: Progress
) -> tuple[list[Effect], Noise, Fitted, SearchResult]:
    """Return effects, noise, recalibration alone and model search; the noise is that beside the best hypothesis.

    What rests on an assumption is none of the effects where it does not hold on routes that it was not fitted on.
    """
    passes = count(1)

    def passed() -> None:
        progress(next(passes), 0, "search of causes")

    noise = estimate_noise(nominal, residuals(nominal, nominal))
    base = recalibrate(nominal, noise)
    if base.calibration.any():
        noise = estimate_noise(base.path, base.left)
        base = recalibrate(nominal, noise, base)
    searched = search(nominal, noise, base, effects, passed=passed)
    for _ in range(NOISE_PASSES):
        best = searched.fitted
        # what a large effect leaves within conditions is no noise: estimate it without the effect, and search again
        again = estimate_noise(best.path, best.left) if best.forms else noise
        ratio, usable = noise.floor / again.floor, nominal.s.usable
        # a channel that few runs have changes as well
        change = np.array([abs(np.log(np.median(ratio[use, k]))) for k, use in enumerate(usable.T) if use.any()])
        # where the runs end far off under any effect, the verdict is a blunder at any noise level
        if (
            not (change > np.log(NOISE_CHANGE)).any()
            or np.mean(misfit(best.path, nominal, by_extent=True)) >= BLUNDER_MISFIT
        ):
            break
        noise, base = again, recalibrate(nominal, again, base)
        searched = search(nominal, noise, base, effects, start=searched, passed=passed)
    assumed = {each.id for each in effects if each.id in searched.effects and each.assumption(nominal.s)}
    if assumed and not _holds(nominal, noise, searched):
        return _searched(nominal, [each for each in effects if each.id not in assumed], progress)
    return [*effects], noise, base, searched
