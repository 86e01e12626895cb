"""`calib diagnose`, `effects`, `plan`: where the sim-to-real gap lies, what causes it, which runs show it."""

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from calib import cli
from calib.cli import Place, Text, Texts, arg, opt
from calib.errors import BadInputError, RefusedError, refuse_workers
from calib.reporting import drawn, named

if TYPE_CHECKING:
    from calib.campaign.model import Campaign
    from calib.coefficients.sections import EffectSection
    from calib.gap.decision.diagnosis import Diagnosis
    from calib.types import Progress


RESULT_FILE = "diagnosis.json"


def run(
    campaign: cli.CampaignOrRecording,
    model: Annotated[Place, opt("FILE", "Coefficients that the simulator believes, or a result of geometry.")] = None,
    exclude: Annotated[Texts, opt("EFFECT", "Leave an effect out of the library; again for more.")] = None,
    seed: cli.Seed = 0,
    apply: Annotated[Place, opt("FILE", "Write the model with the named effect; of a simulator: what to set.")] = None,
    figures: cli.Figures = None,
    html: Annotated[Place, opt("FILE", "Write one interactive page, with linked panels.")] = None,
    into: Annotated[Place, opt("FOLDER", "Result folder: diagnosis.json.")] = None,
    journeys: Annotated[Place, opt("PLAN", "Runs to come, to compare the corrections of tied causes on.")] = None,
    simulator: Annotated[
        Place, opt("SIM.toml", "Your own simulator: its command, which is run, and its parameters.")
    ] = None,
    workers: Annotated[int, opt("N", "Runs of the simulator at once.", "--workers", min=1)] = 1,
    mapping: cli.MappingOption = None,
) -> int:
    """Say where the gap between measured and simulated motion lies, and which unmodelled effect causes it.

    Exit status 0: there is no gap, or it is explained. 1: the causes cannot be told apart, or the gap is explained
    in part only, or its cause is unknown, or the data are to be corrected first. 2: bad input.

    Example: calib diagnose sample_runs/corridor_crossed --apply coefficients.json
    """
    from calib.campaign.check import runs_of_broken_counters
    from calib.campaign.read import read_or_ingest
    from calib.gap.decision.diagnosis import VerdictKind
    from calib.gap.diagnose import diagnosed
    from calib.reporting.topics.diagnosis import GAP_FIGURES, after_diagnosis, diagnosis_full

    result = None if into is None else into / RESULT_FILE
    cli.refuse_outputs(apply, html, result, figures=figures, names=GAP_FIGURES)
    if html is not None:  # a missing extra is said before the work
        import_module("calib.reporting.interactive")
    if simulator is not None and (model or journeys):
        name = "--model" if model else "--journeys"
        raise BadInputError(f"{name}: found it beside --simulator, which is judged instead; give one of them")
    left_out = tuple(exclude or ())
    with cli.progress("diagnosing") as tick:
        read = read_or_ingest(campaign, mapping=mapping, progress=tick)
        effects: tuple[EffectSection, ...] | None = None
        if simulator is not None:
            diagnosis, ran = _simulated(read, simulator, left_out, seed, workers, tick)
        else:
            if left_out:
                _check_excluded(left_out, read)
            ran = ""
            diagnosis, effects = diagnosed(read, model, left_out, seed, journeys, progress=tick)
    document = diagnosis.to_dict()
    cli.show(diagnosis_full(diagnosis))
    cli.say(ran)
    cli.save(result, document)
    if html is not None:
        from calib.reporting.pages import diagnosis_page

        with cli.progress("making the page"):
            page = diagnosis_page(diagnosis, read)
        cli.save(html, page)
    cli.draw(figures, lambda: named("figures", "gap.gap_figures")(diagnosis), simulated=read.simulated)
    cli.emit_json(document)
    applied = "" if apply is None else _apply(diagnosis, read, model, effects, apply)
    step = applied or after_diagnosis(diagnosis, simulator=simulator is not None)
    odd = runs_of_broken_counters(read) if step in _UNSETTLED else ()
    cli.then(
        "diagnose counters" if odd else step, c=campaign, sim=simulator or "", runs_named=odd[:6], file=apply or ""
    )
    fine = diagnosis.kind in {VerdictKind.NO_GAP, VerdictKind.EXPLAINED} and not diagnosis.correct_first
    return 0 if applied is not None and fine else 1


#: steps that broken counters may be the cause of
_UNSETTLED: Final = frozenset({"diagnose", "diagnose unknown", "diagnose wrong", "plan nothing"})


def _apply(
    diagnosis: "Diagnosis",
    campaign: "Campaign",
    believed: Path | None,
    effects: "tuple[EffectSection, ...] | None",
    target: Path,
) -> str | None:
    from calib.coefficients.file import fitted_beside, load_coefficients
    from calib.gap.apply import applied_model, on_vehicle
    from calib.gap.decision.diagnosis import VerdictKind
    from calib.gap.simulator.fix import parameters_to_set

    if diagnosis.kind is VerdictKind.NO_GAP:
        cli.say(f"{target} is not written: there is no gap, so the model stays as it is.")
        return ""
    what, step, left_out = "parameters are", "", tuple[str, ...]()
    try:
        if effects is None:
            content: Any = parameters_to_set(diagnosis)
            step = "diagnose simulator --apply"
        else:
            model = applied_model(
                diagnosis, campaign, effects, None if believed is None else load_coefficients(believed)
            )
            content, what, step = model.to_bytes(), "model is", "diagnose --apply"
            left_out = fitted_beside(model) and on_vehicle(model, diagnosis, campaign)
    except RefusedError as refused:
        cli.say(f"{target} is not written: {refused}.")
        return None
    cli.save(target, content)
    for text in left_out:
        cli.note(text)
    if diagnosis.recommended:
        return step
    cli.say(f"The written {what} not recommended: see above what speaks against it.")
    return ""


def _simulated(
    campaign: "Campaign", simulator: Path, exclude: tuple[str, ...], seed: int, workers: int, tick: "Progress"
) -> "tuple[Diagnosis, str]":
    from calib.gap.simulator import cache_folder, read_settings
    from calib.gap.simulator.diagnose import diagnose_simulator
    from calib.gap.simulator.runner import RUNS_STAGE
    from calib.reporting.formatting import plural

    refuse_workers(workers)
    settings, finished = read_settings(simulator), {RUNS_STAGE: 0}

    def counted(done: int, total: int, stage: str) -> None:
        finished[stage] = done
        tick(done, total, stage)

    try:
        done = diagnose_simulator(campaign, settings, seed=seed, exclude=exclude, workers=workers, progress=counted)
    except KeyboardInterrupt:
        if (runs := finished[RUNS_STAGE]) and cache_folder() is not None:
            cli.keep(f"results of {plural(runs, 'run')} of the simulator, which will not run again")
        raise
    return done.diagnosis, done.runs.sentence


def _check_excluded(exclude: tuple[str, ...], campaign: "Campaign") -> None:
    from calib.gap.effects.library import REGISTRY, check_excluded
    from calib.gap.observations.from_campaign import observations_of

    try:
        check_excluded(exclude, observations_of(campaign), campaign.extra.get("effects", ()))
    except BadInputError as error:
        near = "".join(cli.nearest(name, REGISTRY) for name in exclude if name not in REGISTRY)
        raise BadInputError(f"--{error}{near}") from error


def effects(
    effect: Annotated[Text, arg("ID", "An effect, of which all is said; without it a list.")] = None,
    campaign: Annotated[
        Place, opt("CAMPAIGN", "Judge on this campaign's runs; its columns and declared effects are listed, too.")
    ] = None,
    figures: cli.Figures = None,
) -> None:
    """List the effects that may cause a gap, or say of one what it needs, what separates it, and what it leaves.

    Effects of installed packages (entry points of the group calib.effects) are listed with the package; those that
    campaign.toml declares, and further columns of the run table, with --campaign.

    Example: calib effects track_width --figures pictures
    """
    from calib.campaign.read import read_campaign
    from calib.gap.effects.library import catalogue, every_effect
    from calib.gap.observations.from_campaign import observations_of
    from calib.gap.plan.planned_runs import demonstration
    from calib.gap.predict import predict

    with cli.progress("looking"):
        read = demonstration() if campaign is None else read_campaign(campaign)
        declared = read.extra.get("effects", ())
        nominal = predict(observations_of(read))
        if effect is not None and effect not in (known := every_effect(nominal.s, declared=declared)):
            near = cli.nearest(effect, known) or "; choose one of it"
            raise BadInputError(f"found the effect {effect!r}; expected one that 'calib effects' lists{near}")
        entries = catalogue(nominal, declared, () if effect is None else (effect,))
    runs = f"the runs of {read.name}" if campaign else "demonstration runs (corridor both ways, squares, curves)"
    shown = {f"signature-{one.effect.id}": one.signature for one in entries if one.signature is not None}
    drawable = {name.replace(":", "-"): signature for name, signature in shown.items()}
    cli.refuse_outputs(figures=figures, names=drawable)
    from calib.reporting.topics.runs import effect_content, effects_content

    cli.show(effects_content(entries, runs) if effect is None else effect_content(entries[0], runs))
    cli.draw(figures, lambda: {name: drawn("gap.signature_figure", one, nominal) for name, one in drawable.items()})
    cli.then("effects EFFECT" if effect else "effects", c=campaign or "CAMPAIGN")
    cli.emit_json({"runs": runs, "effects": [entry.to_dict() for entry in entries]})


def plan(
    campaign: Annotated[Place, arg("CAMPAIGN", "Campaign that was driven.")] = None,
    source: Annotated[Place, opt("PLAN.toml", "A plan of runs, judged before anything is driven.", "--from")] = None,
    candidates: Annotated[Place, opt("FILE.toml", "Runs to choose from, as [[runs]]; else the usual ones.")] = None,
    most: Annotated[int, opt(None, "How many runs to name; repeats count once.", min=1, max=50)] = 5,
    seed: cli.Seed = 0,
    figures: Annotated[Place, opt("FOLDER", "With --from: write the matrix there as PNG, SVG and PDF.")] = None,
) -> None:
    """List the runs to drive next, best first, with what each tells apart.

    With --from, say which effects a plan could see at which size, and which it could never tell apart. Either way, what
    intervals of radii, track and the like the end poses promise. A plan has
    format = "calib-plan/1", the sections of campaign.toml, [measured] with distance, poses, front, log, gyro (true or
    false) and corridor_m, and [[runs]], each with kind, count, direction, session, payload_kg, payload_x_m,
    payload_y_m, speed_mps, temperature_C, minutes_under_load, stops, read_rolling, or a further numeric column.

    Example: calib plan sample_runs/corridor; calib plan --from PLAN.toml --figures pictures
    """
    if (campaign is None) == (source is None):
        raise BadInputError("plan: found both or none; expected a CAMPAIGN or --from PLAN.toml; give one of them")
    if source is not None:
        cli.refuse_options("with --from", {"--candidates": candidates})
        _judge(source, figures)
    elif campaign is not None:
        cli.refuse_options("without --from", {"--figures": figures})
        _next(campaign, candidates, most, seed)


def _next(campaign: Path, candidates: Path | None, most: int, seed: int) -> None:
    from calib.api.outputs import proposed
    from calib.campaign.read import read_campaign
    from calib.gap.plan.next_runs import read_candidates
    from calib.reporting.topics.diagnosis import without_runs
    from calib.reporting.topics.runs import runs_and_promises

    with cli.progress("planning") as tick:
        read = read_campaign(campaign, progress=tick)
        offered = None if candidates is None else read_candidates(candidates)
        plan = proposed(read, among=offered, most=most, seed=seed, progress=tick)
    cli.say(f"{plan.diagnosis.campaign}: {plan.diagnosis.sentence}")
    cli.show(runs_and_promises(plan))
    cli.then("plan" if plan.runs else without_runs(plan.diagnosis), c=campaign)
    cli.emit_json(plan.to_dict())


def _judge(source: Path, figures: Path | None) -> None:
    from calib.api.outputs import promised
    from calib.gap.plan import outlook_of
    from calib.gap.plan.next_runs import read_plan
    from calib.reporting.topics.runs import outlook_content, promise_table

    cli.refuse_outputs(figures=figures, names=["plan-matrix"])
    with cli.progress("judging the plan") as tick:
        planned = read_plan(source)
        outlook = outlook_of(planned, progress=tick)
        promise = promised(planned)
    content = outlook_content(planned.name, len(planned.runs), outlook)
    cli.show((*content, *([promise_table(None, promise)] if promise else [])))
    cli.draw(figures, lambda: {"plan-matrix": drawn("gap.plan_matrix", outlook)})
    cli.then("plan --from")
    geometry = promise and promise.to_dict()
    cli.emit_json({"plan": planned.name, "runs": len(planned.runs), **outlook.to_dict(), "geometry": geometry})
