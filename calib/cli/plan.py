"""`calib plan`: the runs to drive next, and what a plan could show before anything is driven."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calib.cli import terminal
from calib.errors import BadInputError

#: the picture of --figures
MATRIX = "plan-matrix"


def run(
    campaign: Annotated[Path | None, typer.Argument(metavar="[CAMPAIGN]", help="Campaign that was driven.")] = None,
    source: Annotated[
        Path | None,
        typer.Option("--from", metavar="PLAN.toml", help="A plan of runs, judged before anything is driven."),
    ] = None,
    candidates: Annotated[
        Path | None, typer.Option(metavar="FILE.toml", help="Runs to choose from, as [[runs]]; else the usual ones.")
    ] = None,
    most: Annotated[int, typer.Option(min=1, max=50, help="How many runs to name.")] = 5,
    seed: terminal.Seed = 0,
    figures: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="With --from: write the matrix there as PNG, SVG and PDF.")
    ] = None,
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
    from calib.reporting.topics.effects import outlook_content, promise_table

    terminal.refuse_outputs(*terminal.figure_files(figures, [MATRIX]))
    with terminal.progress("judging the plan") as tick:
        planned = read_plan(source)
        outlook = outlook_of(planned, progress=tick)
        promise = promised(planned)
    content = outlook_content(planned.name, len(planned.runs), outlook)
    terminal.show((*content, *([promise_table(None, promise)] if promise else [])))
    if figures is not None:
        from calib.reporting.figures.effects import plan_matrix

        terminal.draw(lambda: {MATRIX: plan_matrix(outlook)}, figures)
    terminal.then("plan --from")
    geometry = promise and promise.to_dict()
    terminal.emit_json({"plan": planned.name, "runs": len(planned.runs), **outlook.to_dict(), "geometry": geometry})
    return 0
