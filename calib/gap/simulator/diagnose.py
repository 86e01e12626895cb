"""A diagnosis in the parameters of the user's simulator, and a fix that it confirms itself."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path as FilePath
from typing import Final

import numpy as np

from calib.campaign.model import Campaign
from calib.campaign.wheels import on_its_source_alone
from calib.errors import BadInputError, RefusedError
from calib.gap.decision.diagnosis import Diagnosis
from calib.gap.decision.fix import PLAN
from calib.gap.decision.kind import NO_GAP_SHOWN
from calib.gap.decision.sentences import joined
from calib.gap.diagnose import diagnose_in_full
from calib.gap.effects import simulator
from calib.gap.effects.effect import Effect, Form
from calib.gap.effects.encoder import BLUNDER_MISFIT
from calib.gap.effects.library import check_excluded, library
from calib.gap.effects.simulator import SIMULATOR_PREFIX, HeldCalibration, SimulatorParameter
from calib.gap.effects.steering import SteeringScale, SteeringZero
from calib.gap.inference.fit import signature_columns
from calib.gap.observations.arrays import N_CHANNELS, Channel, Observations
from calib.gap.observations.from_campaign import observations_of
from calib.gap.predict import Path, predict, residuals
from calib.gap.simulator.fix import (
    SimulatorFix,
    fixed,
    iterated,
    left_by,
    named_parameters,
    without_parameter,
)
from calib.gap.simulator.rivals import Rival, as_rivals, rivals_of
from calib.gap.simulator.runner import Differences, SimulatorRunner, differences_of
from calib.gap.simulator.settings import COLUMNS, SimulatorSettings, run_cache, written_wrong
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

    For parameters see `calib.api.results.diagnose`; `exclude`
    takes ``simulator:NAME`` too. Raises CalibError where the simulator fails, hangs, writes nonsense, or predicts
    nothing measured.
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
    observations = _simulated_observations(measured, differences)
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
    found = iterated(diagnosis, differences) if named else None
    if diagnosis.kind in NO_GAP_SHOWN:
        return diagnosis
    rivals, unnamed = rivals_of(diagnosis, differences, found), ""
    if len(rivals) > 1 or any(each.names != frozenset(c.effect for c in diagnosis.causes) for each in rivals):
        if told := _told_by_runs(searched, diagnosis, differences, rivals):
            diagnosis, found = told
        else:
            names = joined(sorted(next(each.names for each in rivals if each.fix is not None)), "and")
            unnamed = f" Run by themselves {names} leave no more than noise, too: --exclude the others to ask for them."
    if found is None:
        return without_parameter(diagnosis, unnamed)
    return fixed(diagnosis, differences, found, rng, unnamed)


def _told_by_runs(
    searched: _Search, first: Diagnosis, differences: Differences, rivals: Sequence[Rival]
) -> tuple[Diagnosis, SimulatorFix] | None:
    # None where no search names the parameters that were run
    best = next((each for each in rivals if each.fix is not None), None)
    if best is None or best.fix is None:
        return None
    if best.names == {cause.effect for cause in first.causes}:
        return as_rivals(first, rivals), best.fix
    typical = {each.name: each.parameter.typical for each in best.named.values()}
    through, without = differences.through(best.fix.deviation, best.fix.table, typical), list[str]()
    for _ in range(_MOST_SEARCHES):
        again = searched(through, without)
        names = {cause.effect for cause in again.causes}
        if names == best.names:
            return as_rivals(again, rivals), iterated(again, through, best.fix)
        if names and names < best.names:
            return again, iterated(again, through)
        if not (others := sorted(names - best.names)):
            break
        without += others
    return None


def _simulated_observations(measured: Observations, differences: Differences) -> Observations:
    simulated = np.full((len(measured), N_CHANNELS), np.nan)
    simulated[:, :4] = differences.nominal[differences.rows(measured)]
    simulated[:, 3] += 2 * np.pi * np.nan_to_num(np.round((measured.measured[:, 3] - simulated[:, 3]) / (2 * np.pi)))
    usable = measured.usable & np.isfinite(simulated)
    axis = differences.axis
    # a laser reads a length of a run driven backward, too
    ahead = np.where(measured.measured[:, Channel.ALONG] < 0.0, -1.0, 1.0) if axis == 1.0 else axis
    noise = differences.scatter[differences.rows(measured)] / np.sqrt(differences.repeats)
    variance = noise**2
    variance[:, 1:3] = variance[:, 1:3].mean(axis=1, keepdims=True)
    observations = replace(
        measured,
        simulated=np.where(usable, simulated, np.nan),
        usable=usable,
        calibration_held=True,
        axis=measured.axis if ahead is None else np.where(measured.axis == 0.0, 0.0, ahead),
        sigma=np.sqrt(measured.sigma**2 + variance),
    )
    return simulator.as_simulated(observations, noise)


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
    # what parameters replace or, of the calibration, reproduce is left to these: a parameter can be set
    nominal = predict(observations)
    own = [effect for effect in differences.effects(nominal) if effect.id not in exclude]
    idle = [effect.parameter.name for effect in own if not effect.forms(observations)]
    stands_for = {each.effect for cause, each in differences.by_cause.items() if cause not in exclude}
    every = library(observations, exclude=(*exclude, *stands_for), declared=campaign.extra.get("effects", ()))
    rivals = [HeldCalibration(effect) if effect.calibration else effect for effect in every]
    noisy = differences.repeats > 1
    signs = _spanned([rival for rival in rivals if _is_setting(rival, observations, noisy)], own, nominal, noisy)
    spanned = [name for name, forms in signs.items() if all(len(theirs) == 2 for theirs in forms.values())]
    for number, rival in enumerate(rivals):
        theirs = signs.get(rival.id, {})
        if isinstance(rival, HeldCalibration) and len(theirs.get("", [])) == 1:
            rivals[number] = HeldCalibration(rival.effect, -theirs[""][0])
        elif rival.id not in spanned and any(theirs.values()):
            done = [label for label, ways in theirs.items() if len(ways) == 2]
            rivals[number] = simulator.without_forms(rival, done)
    notes = []
    if idle:
        notes.append(f"no run of the simulator changes with {', '.join(idle)}: check that it reads them")
    if spanned:
        notes.append(f"parameters of the simulator do what {', '.join(spanned)} would: these were not searched")
    if noisy:
        notes.append(f"the simulator does not repeat itself: {differences.repeats} runs were averaged each time")
    held = {rival.id: rival for rival in rivals if isinstance(rival, HeldCalibration)}
    others = []
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
    usable = nominal.s.usable[:, :4]
    gap = residuals(nominal, nominal)[:, :4][usable] / nominal.s.sigma[usable]
    for form, aim in zip(targets, aims.T, strict=True):
        share = SPANNED_SHARE
        if not noisy and not isinstance(next(rival for rival in rivals if rival.id == form.effect), HeldCalibration):
            # wheelbase and angle scale are alike in small angles alone
            share = min(share, TOLD_SD / max(float(np.linalg.norm(gap)), 1e-12))
        limit = share * np.linalg.norm(aim)
        ways = [way for way in (1, -1) if np.linalg.norm(left_by(columns, way * aim, sign)) < limit]
        spanned.setdefault(form.effect, {})[form.label] = ways
    return spanned


def _scaled(path: Path, forms: Sequence[Form]) -> FloatArray:
    whole = np.concatenate(signature_columns(path, forms), axis=2)[:, :4] / path.s.sigma[:, :, None]
    return whole[path.s.usable[:, :4]]
