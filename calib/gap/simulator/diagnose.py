"""A diagnosis in the parameters of the user's simulator, and a fix that it confirms itself.

Rivals are sets of parameters that leave no more than noise when the simulator is run with them.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, islice
from math import exp, log, sqrt
from operator import attrgetter
from pathlib import Path as FilePath
from typing import Final

import numpy as np

from calib.campaign.model import Campaign
from calib.campaign.wheels import on_its_source_alone
from calib.errors import BadInputError, RefusedError
from calib.gap.decision import most_square
from calib.gap.decision.confounding import any_probability
from calib.gap.decision.diagnosis import Diagnosis, VerdictKind
from calib.gap.decision.fix import PLAN
from calib.gap.decision.kind import NO_GAP_SHOWN
from calib.gap.decision.sentences import joined
from calib.gap.diagnose import diagnose_in_full
from calib.gap.effects import Effect, Form, simulator
from calib.gap.effects.encoder import BLUNDER_MISFIT
from calib.gap.effects.library import check_excluded, library
from calib.gap.effects.simulator import SIMULATOR_PREFIX, HeldCalibration, SimulatorParameter
from calib.gap.effects.steering import SteeringScale, SteeringZero
from calib.gap.inference import LOG_EVIDENCE_WINDOW
from calib.gap.inference.fit import signature_columns
from calib.gap.observations import Observations
from calib.gap.observations.from_campaign import observations_of
from calib.gap.predict import Path, predict, residuals
from calib.gap.simulator import COLUMNS, Declared, SimulatorSettings, run_cache, written_wrong
from calib.gap.simulator.fix import (
    SimulatorFix,
    bend,
    fixed,
    iterated,
    left_by,
    named_parameters,
    run_alone,
    scaled_signatures,
    square_left,
    without_parameter,
)
from calib.gap.simulator.runner import Differences, SimulatorRunner, differences_of
from calib.types import FloatArray, Progress, silent

#: most of a calibration effect that the simulator's parameters may miss and still replace it
SPANNED_SHARE: Final = 0.1
#: standard deviations of the gap that may be left of one of the steering
TOLD_SD: Final = 3.0


@dataclass(frozen=True, slots=True)
class SimulatorDiagnosis:
    """A diagnosis in a simulator's parameters, and what ran it."""

    diagnosis: Diagnosis
    runs: SimulatorRunner


@dataclass(frozen=True, slots=True, eq=False)
class _Rival:
    names: frozenset[str]
    score: float  #: squares left, and log n a parameter (Schwarz, Annals of Statistics 6, 1978)
    named: Mapping[str, Declared]
    fix: SimulatorFix | None  #: None of a verdict with effects of the library


def diagnose_simulator(
    campaign: Campaign,
    settings: SimulatorSettings,
    *,
    seed: int = 0,
    exclude: tuple[str, ...] = (),
    workers: int = 1,
    progress: Progress = silent,
) -> SimulatorDiagnosis:
    """Diagnose the gap between what was measured and the user's simulator.

    For parameters see `calib.api.results.diagnose`; `exclude` takes ``simulator:NAME`` too. Raises CalibError where the
    simulator fails, hangs, writes nonsense, or predicts nothing measured.
    """
    if campaign.root is None or not (campaign.root / "campaign.toml").is_file():
        raise BadInputError(
            f"{campaign.name}: found no folder with campaign.toml; expected one, which the simulator reads; "
            "run 'calib ingest' first"
        )
    root = FilePath(campaign.root)
    campaign = on_its_source_alone(campaign)
    measured = observations_of(campaign, into_windows=False)
    _check_excluded(exclude, measured, settings, campaign)
    run_ids = [str(run) for run in dict.fromkeys(measured.labels["run_id"])]
    cache = run_cache(settings, campaign.hashes)
    runner = SimulatorRunner(settings, root.resolve(), run_ids, cache, workers, progress)
    differences = differences_of(runner, measured.sigma.min(axis=0))
    _refuse_nonsense(measured, differences)
    observations = differences.simulated(measured)
    if not observations.usable.any():
        raise RefusedError(
            f"{settings.path.name}: the simulator predicts nothing that the campaign measured; write sim_distance_m "
            "where distance_m was measured, and sim_x_m, sim_y_m, sim_theta_rad where end poses were"
        )

    def searched(differences: Differences, without: Sequence[str] = ()) -> Diagnosis:
        candidates, notes = _candidates(observations, differences, exclude, campaign)
        diagnosis = diagnose_in_full(
            campaign,
            seed=seed,
            exclude=exclude,
            observations=observations,
            candidates=[effect for effect in candidates if effect.id not in without],
            model_name=settings.path.name,
            plan=False,
            progress=progress,
        )
        return replace(diagnosis, notes=(*diagnosis.notes, *notes))

    diagnosis = _confirmed(searched, differences, np.random.default_rng(seed))
    why = tuple(text.replace(PLAN, "other routes, speeds or loads tell") for text in diagnosis.fix.why)
    return SimulatorDiagnosis(replace(diagnosis, fix=replace(diagnosis.fix, why=why)), runner)


#: searches that leave out what takes the place of parameters which were run
_MOST_SEARCHES: Final = 4
_Search = Callable[[Differences, Sequence[str]], Diagnosis]


def _confirmed(searched: _Search, differences: Differences, rng: np.random.Generator) -> Diagnosis:
    diagnosis = searched(differences, ())
    named = named_parameters(diagnosis, differences)
    fix = iterated(diagnosis, differences) if named else None
    if diagnosis.kind in NO_GAP_SHOWN:
        return diagnosis
    rivals, unnamed = _rivals_of(diagnosis, differences, fix), ""
    if any(each.fix is not None for each in rivals):
        if outcome := _told_by_runs(searched, diagnosis, differences, rivals):
            diagnosis, fix = outcome
        else:
            names = joined(sorted(next(each.names for each in rivals if each.fix is not None)), "and")
            unnamed = f" Run by themselves {names} leave no more than noise, too: --exclude the others to ask for them."
    if fix is None:
        return without_parameter(diagnosis, unnamed)
    return fixed(diagnosis, differences, fix, rng, unnamed)


def _told_by_runs(
    searched: _Search, first: Diagnosis, differences: Differences, rivals: Sequence[_Rival]
) -> tuple[Diagnosis, SimulatorFix] | None:
    best = next((each for each in rivals if each.fix is not None), None)
    if best is None or best.fix is None:
        return None
    if best.names == {cause.effect for cause in first.causes}:
        return _as_rivals(first, rivals), best.fix
    typical = {each.name: each.parameter.typical for each in best.named.values()}
    through, without = differences.through(best.fix.deviation, best.fix.table, typical), list[str]()
    for _ in range(_MOST_SEARCHES):
        again = searched(through, without)
        names = {cause.effect for cause in again.causes}
        if names == best.names:
            return _as_rivals(again, rivals), iterated(again, through, best.fix)
        if names and names < best.names:
            return again, iterated(again, through)
        if not (others := sorted(names - best.names)):
            break
        without += others
    return None


def _refuse_nonsense(measured: Observations, differences: Differences) -> None:
    path, table = differences.runner.settings.path, differences.nominal[differences.rows(measured)]
    gone = measured.usable[:, :4] & ~np.isfinite(table) & np.isfinite(table).any(axis=0)
    if gone.any():
        row, column = np.argwhere(gone)[0]
        raise BadInputError(
            f"{path}: found no {COLUMNS[column]} of run {measured.labels['run_id'][row]}; expected a number "
            "in each run where it was measured; write it, or leave the column out"
        )
    if words := written_wrong(table, predict(measured).reading[:, :4], BLUNDER_MISFIT):
        wrong, cure = words.split("; ", 1)
        raise BadInputError(
            f"{path}: found that the simulator writes {wrong}; expected ends near those of the logged counts; {cure}"
        )


def _check_excluded(
    exclude: Sequence[str], measured: Observations, settings: SimulatorSettings, campaign: Campaign
) -> None:
    own = settings.by_cause
    if unknown := [name for name in exclude if name.startswith(SIMULATOR_PREFIX) and name not in own]:
        raise BadInputError(f"--exclude: found {unknown[0]!r}; expected one of: {', '.join(sorted(own))}")
    if others := [name for name in exclude if name not in own]:
        check_excluded(others, measured, campaign.extra.get("effects", ()))


def _candidates(
    observations: Observations, differences: Differences, exclude: Sequence[str], campaign: Campaign
) -> tuple[list[Effect], tuple[str, ...]]:
    # what parameters replace or reproduce is left to these: a parameter can be set
    nominal = predict(observations)
    own = [effect for effect in differences.effects(nominal) if effect.id not in exclude]
    idle = [effect.parameter.name for effect in own if not effect.forms(observations)]
    # what may only be of the other sign than the gap asks for stands for nothing
    gap, signed = _scaled_gap(nominal), [(e, form) for e in own if e.parameter.sign for form in e.forms(observations)]
    out = {e.id for e, form in signed if e.parameter.sign * (_scaled(nominal, [form])[:, 0] @ gap) < 0.0}.union(exclude)
    stands_for = Counter(each.effect for cause, each in differences.by_cause.items() if cause not in out)
    every = library(observations, exclude=exclude, declared=campaign.extra.get("effects", ()))
    # one slope for both wheels does not do what one each does
    every = [effect for effect in every if not simulator.of_at_most(stands_for[effect.id], effect, observations)]
    rivals = [HeldCalibration(effect) if effect.calibration else effect for effect in every]
    noisy = differences.repeats > 1
    signs = _spanned([rival for rival in rivals if _is_setting(rival, observations, noisy)], own, nominal, noisy)
    spanned = [name for name, forms in signs.items() if all(len(theirs) == 2 for theirs in forms.values())]
    for number, rival in enumerate(rivals):
        theirs = signs.get(rival.id, {})
        if isinstance(rival, HeldCalibration) and len(theirs.get("", [])) == 1:
            rivals[number] = HeldCalibration(rival.effect, -theirs[""][0])
        elif rival.id not in spanned and any(theirs.values()):
            rivals[number] = simulator.without_forms(rival, [label for label, ways in theirs.items() if len(ways) == 2])
    notes = []
    if idle:
        notes.append(f"no run of the simulator changes with {', '.join(idle)}: check that it reads them")
    if spanned:
        notes.append(f"parameters of the simulator do what {', '.join(spanned)} would: these were not searched")
    if noisy:
        notes.append(f"the simulator does not repeat itself: {differences.repeats} runs were averaged each time")
    held, others = {rival.id: rival for rival in rivals if isinstance(rival, HeldCalibration)}, list[Effect]()
    for rival in rivals:
        zeros = {held[name]: 1.0 / _reach(held[name], nominal)[""] for name in rival.own_shifts if name in spanned}
        others.append(simulator.with_zero(rival, zeros, _reach(rival, nominal) if zeros else {}))
    return [*own, *(rival for rival in others if rival.id not in spanned)], tuple(notes)


def _reach(effect: Effect, nominal: Path) -> dict[str, float]:
    return {form.label: float(np.linalg.norm(_scaled(nominal, [form]))) for form in effect.forms(nominal.s)}


def _is_setting(effect: Effect, observations: Observations, noisy: bool) -> bool:
    if noisy and (forms := effect.forms(observations)):
        return all(len(form.parameters) == 1 for form in forms)
    steered = observations.by_front and effect.id in (SteeringZero.id, SteeringScale.id)
    return steered or isinstance(effect, HeldCalibration)


def _spanned(
    rivals: Sequence[Effect], own: Sequence[SimulatorParameter], nominal: Path, noisy: bool
) -> dict[str, dict[str, list[int]]]:
    offered = [form for effect in own for form in effect.forms(nominal.s)]
    targets = [form for rival in rivals for form in rival.forms(nominal.s)]
    if not offered or not targets:
        return {}
    columns, aims = (_scaled(nominal, forms) for forms in (offered, targets))
    parameters = [parameter for form in offered for parameter in form.parameters]
    columns = columns * np.array([p.largest / p.typical for p in parameters])
    sign, spanned = np.array([p.sign for p in parameters]), dict[str, dict[str, list[int]]]()
    gap = _scaled_gap(nominal)
    for form, aim in zip(targets, aims.T, strict=True):
        share = SPANNED_SHARE
        if not noisy and not isinstance(next(rival for rival in rivals if rival.id == form.effect), HeldCalibration):
            # wheelbase and angle scale are alike in small angles alone
            share = min(share, TOLD_SD / max(float(np.linalg.norm(gap)), 1e-12))
        limit = share * np.linalg.norm(aim)
        ways = [way for way in (1, -1) if np.linalg.norm(left_by(columns, way * aim, sign)) < limit]
        spanned.setdefault(form.effect, {})[form.label] = ways
    return spanned


def _scaled_gap(path: Path) -> FloatArray:
    usable = path.s.usable[:, :4]
    return residuals(path, path)[:, :4][usable] / path.s.sigma[usable]


def _scaled(path: Path, forms: Sequence[Form]) -> FloatArray:
    whole = np.concatenate(signature_columns(path, forms), axis=2)[:, :4] / path.s.sigma[:, :, None]
    return whole[path.s.usable[:, :4]]


#: of a set's score over the best one's: ten times less probable
WINDOW: Final = 2.0 * LOG_EVIDENCE_WINDOW
#: what a parameter not run may bend, of the gap
BENT_SHARE: Final = 0.05
#: squares over noise's that a run may promise before it is given up: twice the noise level
PROMISED: Final = 4.0
#: parameters tried together, and sets weighed: all of thirty parameters
MOST_ALONE: Final = 3
MOST_SETS: Final = 5000
#: share by which a size moves where another parameter beside it takes a part
MOVED: Final = 0.1


def _rivals_of(diagnosis: Diagnosis, differences: Differences, named_fix: SimulatorFix | None) -> list[_Rival]:
    # the named parameters, those most able, and variants of the best set
    n_rows, named = int(diagnosis.nominal.s.usable.sum()), named_parameters(diagnosis, differences)
    limit, verdict = most_square(n_rows, diagnosis.noise.dof), frozenset(cause.effect for cause in diagnosis.causes)

    def rival(subset: Mapping[str, Declared], fix: SimulatorFix) -> _Rival:
        return _Rival(frozenset(subset), fix.square + len(subset) * log(n_rows), subset, fix)

    pure = named_fix is not None and len(named) == len(verdict)
    run = [rival(named, named_fix)] if named_fix is not None and pure and named_fix.square <= limit else []
    # of a simulator that scatters more than noise may be its own
    if not run and (not pure or differences.repeats == 1):
        able = [subset for subset in _most_able(diagnosis, differences) if subset.keys() != named.keys()]
        sets = [*able, named] if named and not pure else able
        fixes = [(subset, run_alone(diagnosis, differences, subset)) for subset in sets]
        run = sorted((rival(subset, fix) for subset, fix in fixes if fix.square <= limit), key=attrgetter("score"))[:1]
    for subset in _neighbours(diagnosis, differences, run[0], limit) if run else ():
        fix = run_alone(diagnosis, differences, subset, limit=PROMISED * limit)
        if fix.square > limit:
            continue
        run.append(rival(subset, fix))
        if added := subset.keys() - run[0].named.keys():
            whole = {**run[0].named, **{name: subset[name] for name in added}}
            run.append(rival(whole, run_alone(diagnosis, differences, whole, limit=PROMISED * limit)))
    if run and len(named) < len(verdict):
        n_sizes = sum(len(size) for _, size, _ in diagnosis.fitted.each())
        # as run, where it was: changes about nominal bend
        square = diagnosis.fitted.chi_square if named_fix is None else named_fix.square
        run.append(_Rival(verdict, square + n_sizes * log(n_rows), named, None))
    run.sort(key=attrgetter("score"))
    kept: list[_Rival] = []
    for each in run:
        if each.score <= run[0].score + WINDOW and not any(better.names <= each.names for better in kept):
            kept.append(each)
    return kept


def _neighbours(
    diagnosis: Diagnosis, differences: Differences, best: _Rival, limit: float
) -> Iterator[dict[str, Declared]]:
    # what leaves too much, bent as far as may be, is no rival
    assert best.fix is not None
    forms, sign, columns, gap = scaled_signatures(diagnosis)
    names = [form.effect for form in forms]
    inside = [names.index(name) for name in best.named]
    bent = max(bend(diagnosis, differences, best.fix), BENT_SHARE * float(np.linalg.norm(gap)))
    most = (sqrt(limit) + bent) ** 2
    for number in inside:
        others = [each for each in inside if each != number]
        for instead in ([], *([each] for each in range(len(names)) if each not in inside)):
            subset = [*others, *instead]
            if subset and (not instead or square_left(columns[:, subset], gap, sign[subset]) <= most):
                yield {names[each]: differences.by_cause[names[each]] for each in subset}


def _most_able(diagnosis: Diagnosis, differences: Differences) -> Iterator[dict[str, Declared]]:
    # radii off alike show in the two together alone: of each number the best set
    forms, sign, columns, gap = scaled_signatures(diagnosis)
    for size in range(1, min(MOST_ALONE, len(forms)) + 1):
        sets = islice(combinations(range(len(forms)), size), MOST_SETS)
        square, best = min((square_left(columns[:, [*subset]], gap, sign[[*subset]]), subset) for subset in sets)
        if square < np.inf:
            yield {forms[number].effect: differences.by_cause[forms[number].effect] for number in best}


def _as_rivals(diagnosis: Diagnosis, rivals: Sequence[_Rival]) -> Diagnosis:
    best = next(each for each in rivals if each.fix is not None)
    weights = [exp(0.5 * (rivals[0].score - each.score)) for each in rivals]
    groups = {group[0]: tuple(group) for group in diagnosis.groups}
    for other in rivals:
        # what stands in the place of a cause, or takes a part of it
        for name in sorted(name for name in best.names if name not in other.names or _moves(name, best, other)):
            if instead := sorted(other.names - best.names):
                groups[name] = tuple(dict.fromkeys((*groups.get(name, (name,)), *instead)))
    shares = {
        name: sum(weight for each, weight in zip(rivals, weights, strict=True) if name in each.names) / sum(weights)
        for name in best.names
    }
    evidence, ran = diagnosis.evidence, set[str]().union(*(each.names for each in rivals))
    assert evidence is not None
    causes = []
    for cause in diagnosis.causes:
        # what was run together shares its probability by the runs alone
        group = ran.intersection(groups.get(cause.effect, ()))
        probability = any_probability(evidence, group) if len(group) > 1 else cause.probability
        causes.append(replace(cause, probability=probability * shares.get(cause.effect, 1.0)))
    tied = len(groups) > len(diagnosis.groups) and diagnosis.kind is VerdictKind.EXPLAINED
    return replace(
        diagnosis,
        causes=tuple(causes),
        groups=tuple(groups.values()),
        kind=VerdictKind.AMBIGUOUS if tied else diagnosis.kind,
        credible_sets=tuple(dict.fromkeys((*(tuple(sorted(each.names)) for each in rivals), *diagnosis.credible_sets))),
        probabilities={**diagnosis.probabilities, **{cause.effect: cause.probability for cause in causes}},
    )


def _moves(name: str, best: _Rival, other: _Rival) -> bool:
    if best.fix is None or other.fix is None:
        return False
    size, other_size = (fix.deviation[best.named[name].name] for fix in (best.fix, other.fix))
    return abs(other_size - size) > MOVED * abs(size)
