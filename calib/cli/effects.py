"""`calib effects`: the library of causes, what each needs and leaves; `calib plan`: the runs that tell them apart."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from calib.cli import terminal
from calib.cli.terminal import arg, opt
from calib.errors import BadInputError

if TYPE_CHECKING:
    from calib.gap.effects.library import Entry
    from calib.gap.predict import Path as DrivenPath


DEMONSTRATION = "demonstration runs (corridor both ways, squares, curves)"


def effects(
    effect: Annotated[str | None, arg("ID", "An effect, of which all is said; without it a list.")] = None,
    campaign: Annotated[
        Path | None,
        opt("CAMPAIGN", "Judge on this campaign's runs; its columns and declared effects are listed, too."),
    ] = None,
    figures: terminal.Figures = None,
) -> None:
    """List the effects that may cause a gap, or say of one what it needs, what separates it, and what it leaves.

    Effects of installed packages (entry points of the group calib.effects) are listed with the package; those that
    campaign.toml declares, and further columns of the run table, with --campaign.

    Example: calib effects track_width --figures pictures
    """
    with terminal.waiting("looking"):
        nominal, entries, runs = _catalogued(effect, campaign)
    drawable = {_file_name(entry): entry.signature for entry in entries if entry.signature is not None}
    terminal.refuse_outputs(*terminal.figure_files(figures, drawable))
    from calib.reporting.topics.effects import effect_content, effects_content

    terminal.show(effects_content(entries, runs) if effect is None else effect_content(entries[0], runs))
    if figures is not None:
        from calib.reporting.figures.geometry import signature_figure

        terminal.draw(lambda: {name: signature_figure(one, nominal) for name, one in drawable.items()}, figures)
    terminal.then("effects EFFECT" if effect else "effects", c=campaign or "CAMPAIGN")
    terminal.emit_json({"runs": runs, "effects": [entry.to_dict() for entry in entries]})


def _catalogued(effect: str | None, campaign: Path | None) -> tuple[DrivenPath, list[Entry], str]:
    """Return the runs, the effects asked for, and the runs' name."""
    from calib.campaign.read import read_campaign
    from calib.gap.effects.library import catalogue, every_effect
    from calib.gap.observations.from_campaign import observations_of
    from calib.gap.plan.plan_file import demonstration
    from calib.gap.predict import predict

    read = demonstration() if campaign is None else read_campaign(campaign)
    declared = read.extra.get("effects", ())
    nominal = predict(observations_of(read))
    if effect is not None:
        known = every_effect(nominal.s, declared=declared)
        if effect not in known:
            near = terminal.nearest(effect, known)
            raise BadInputError(
                f"found the effect {effect!r}; expected one that 'calib effects' lists{near or '; choose one of it'}"
            )
    runs = DEMONSTRATION if campaign is None else f"the runs of {read.name}"
    return nominal, catalogue(nominal, declared, () if effect is None else (effect,)), runs


def _file_name(entry: Entry) -> str:
    return f"signature-{entry.effect.id}".replace(":", "-")


#: the picture of --figures
MATRIX = "plan-matrix"


def plan(
    campaign: Annotated[Path | None, arg("[CAMPAIGN]", "Campaign that was driven.")] = None,
    source: Annotated[
        Path | None, opt("PLAN.toml", "A plan of runs, judged before anything is driven.", "--from")
    ] = None,
    candidates: Annotated[
        Path | None, opt("FILE.toml", "Runs to choose from, as [[runs]]; else the usual ones.")
    ] = None,
    most: Annotated[int, opt(None, "How many runs to name.", min=1, max=50)] = 5,
    seed: terminal.Seed = 0,
    figures: Annotated[Path | None, opt("FOLDER", "With --from: write the matrix there as PNG, SVG and PDF.")] = None,
) -> int:
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
        if candidates is not None:
            raise BadInputError("--candidates: found with --from; expected with a CAMPAIGN; leave one of them out")
        return _judge(source, figures)
    assert campaign is not None
    if figures is not None:
        raise BadInputError("--figures: found without --from; expected with it; leave it out")
    return _next(campaign, candidates, most, seed)


def _next(campaign: Path, candidates: Path | None, most: int, seed: int) -> int:
    from calib.api.results import proposed
    from calib.campaign.read import read_campaign
    from calib.gap.plan.plan_file import read_candidates
    from calib.reporting.topics.diagnosis import runs_and_promises

    with terminal.progress("planning") as tick:
        read = read_campaign(campaign, progress=tick)
        offered = None if candidates is None else read_candidates(candidates)
        plan = proposed(read, candidates=offered, most=most, seed=seed, progress=tick)
    terminal.say(f"{plan.diagnosis.campaign}: {plan.diagnosis.sentence}")
    terminal.show(runs_and_promises(plan))
    terminal.then("plan" if plan.runs else "plan nothing", c=campaign)
    terminal.emit_json(plan.to_dict())
    return 0


def _judge(source: Path, figures: Path | None) -> int:
    from calib.api.results import promised
    from calib.gap.plan.identifiability import outlook_of
    from calib.gap.plan.plan_file import read_plan
    from calib.reporting.topics.diagnosis import promise_table
    from calib.reporting.topics.effects import outlook_content

    terminal.refuse_outputs(*terminal.figure_files(figures, [MATRIX]))
    with terminal.progress("judging the plan") as tick:
        planned = read_plan(source)
        outlook = outlook_of(planned, progress=tick)
        promise = promised(planned)
    content = outlook_content(planned.name, len(planned.runs), outlook)
    terminal.show((*content, *([promise_table(None, promise)] if promise else [])))
    if figures is not None:
        from calib.reporting.figures.geometry import plan_matrix

        terminal.draw(lambda: {MATRIX: plan_matrix(outlook)}, figures)
    terminal.then("plan --from")
    geometry = promise and promise.to_dict()
    terminal.emit_json({"plan": planned.name, "runs": len(planned.runs), **outlook.to_dict(), "geometry": geometry})
    return 0
