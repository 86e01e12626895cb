"""`calib plan`: the runs to drive next, and what a plan could show before anything is driven."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib.cli.terminal import Force, JsonTarget, draw, emit_json, figure_files, progress, say, show, then
from calib.errors import BadInputError
from calib.io import refuse_existing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from calib.gap.plan.identifiability import Outlook

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
    seed: Annotated[int, typer.Option(help="Seed of the diagnosis' bootstraps.")] = 0,
    figures: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="With --from: write the matrix there as PNG, SVG and PDF.")
    ] = None,
    json: JsonTarget = None,
    force: Force = False,
) -> int:
    """List the runs to drive next, best first, with what each tells apart.

    With --from, say which effects a plan could see at which size, and which it could never tell apart. A plan has
    format = "calib-plan/1", the sections of campaign.toml, [measured] with distance, poses, front, log (true or
    false) and corridor_m, and [[runs]], each with kind, count, direction, session, payload_kg, payload_x_m,
    payload_y_m, speed_mps, temperature_C, minutes_under_load, stops, read_rolling, or a further numeric column.

    Example: calib plan sample_runs/corridor; calib plan --from PLAN.toml --figures pictures
    """
    if (campaign is None) == (source is None):
        raise BadInputError("plan: found both or none; expected a CAMPAIGN or --from PLAN.toml; give one of them")
    if source is not None:
        if candidates is not None:
            raise BadInputError("--candidates: found with --from; expected with a CAMPAIGN; leave one of them out")
        return _judge(source, figures, json, force=force)
    assert campaign is not None
    if figures is not None:
        raise BadInputError("--figures: found without --from; expected with it; leave it out")
    return _next(campaign, candidates, most, seed, json, force=force)


def _next(campaign: Path, candidates: Path | None, most: int, seed: int, json: str | None, *, force: bool) -> int:
    from calib.campaign.read import read_campaign
    from calib.gap.diagnose import diagnose_in_full
    from calib.gap.plan.next_runs import next_runs
    from calib.gap.plan.plan_file import read_candidates
    from calib.reporting.next_step import after_plan
    from calib.reporting.topics.effects import next_runs_table

    with progress("planning") as tick:
        read = read_campaign(campaign, progress=tick)
        offered = None if candidates is None else read_candidates(candidates)
        diagnosis = diagnose_in_full(read, seed=seed, plan=False, progress=tick)
        ties = [group.effects for group in diagnosis.groups]
        runs = [
            run.to_dict()
            for run in next_runs(
                read, diagnosis.effects, diagnosis.noise, ties, diagnosis.fitted, candidates=offered, most=most
            )
        ]
    say(f"{diagnosis.campaign}: {diagnosis.sentence}", target=json)
    show([next_runs_table(runs)], target=json)
    then(after_plan(campaign, len(runs)), target=json)
    document = {
        "verdict": diagnosis.kind.value,
        "indistinguishable": [list(group.effects) for group in diagnosis.groups],
        "next_runs": runs,
    }
    emit_json(document, json, force=force)
    return 0


def _judge(source: Path, figures: Path | None, json: str | None, *, force: bool) -> int:
    from calib.gap.plan.identifiability import outlook_of
    from calib.gap.plan.plan_file import read_plan
    from calib.reporting.next_step import after_plan_file
    from calib.reporting.topics.effects import outlook_content

    refuse_existing(figure_files(figures, [MATRIX]), force=force)
    with progress("judging the plan") as tick:
        planned = read_plan(source)
        outlook = outlook_of(planned, progress=tick)
    show(outlook_content(planned.name, len(planned.runs), outlook), target=json)
    draw(lambda: _figures(outlook), figures, json=json, force=force)
    then(after_plan_file(), target=json)
    emit_json({"plan": planned.name, "runs": len(planned.runs), **outlook.to_dict()}, json, force=force)
    return 0


def _figures(outlook: Outlook) -> dict[str, Figure]:
    from calib.reporting.figures.effects import plan_matrix

    return {MATRIX: plan_matrix(outlook)}
