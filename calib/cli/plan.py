"""`calib plan`: the runs to drive next, and what a plan could show before anything is driven."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from calib.cli.output import FORCE, JSON, emit_json, say, say_wrapped, table
from calib.cli.threads import one_blas_thread

if TYPE_CHECKING:
    from calib.gap.plan.next_runs import Outlook

__all__ = ["register"]

EPILOG = "Example: calib plan sample_runs/corridor; calib plan --from PLAN.toml --figures pictures"
FORMS = ("png", "svg", "pdf")


def register(application: typer.Typer, name: str) -> None:
    """Add the command to `application`."""

    @application.command(name, epilog=EPILOG)
    def plan(
        campaign: Path | None = typer.Argument(None, metavar="[CAMPAIGN]", help="Campaign that was driven."),
        source: Path | None = typer.Option(
            None, "--from", metavar="PLAN.toml", help="A plan of runs, judged before anything is driven."
        ),
        candidates: Path | None = typer.Option(
            None,
            "--candidates",
            metavar="FILE.toml",
            help="Runs to choose from, as [[runs]]; else the usual ones.",
        ),
        most: int = typer.Option(5, "--most", min=1, max=50, help="How many runs to name."),
        seed: int = typer.Option(0, "--seed", help="Seed of the diagnosis' bootstraps."),
        figures: Path | None = typer.Option(
            None, "--figures", metavar="FOLDER", help="With --from: write the matrix there as PNG, SVG and PDF."
        ),
        json_target: str | None = JSON,
        force: bool = FORCE,
    ) -> int:
        """List the runs to drive next, best first, with what each tells apart.

        With --from, say which effects a plan could see at which size, and which it could never tell apart. A plan has
        format = "calib-plan/1", the sections of campaign.toml, [measured] with distance, poses, front, log (true or
        false) and corridor_m, and [[runs]], each with kind, count, direction, session, payload_kg, payload_x_m,
        payload_y_m, speed_mps, temperature_C, minutes_under_load, stops, read_rolling, or a further numeric column.
        """
        one_blas_thread()
        from calib.errors import BadInputError

        if (campaign is None) == (source is None):
            raise BadInputError("plan: found both or none; expected a CAMPAIGN or --from PLAN.toml; give one of them")
        if source is not None:
            if candidates is not None:
                raise BadInputError("--candidates: found with --from; expected with a CAMPAIGN; leave one of them out")
            return _judge(source, figures, json_target, force=force)
        assert campaign is not None
        if figures is not None:
            raise BadInputError("--figures: found without --from; expected with it; leave it out")
        return _next(campaign, candidates, most, seed, json_target, force=force)


def _next(
    campaign: Path, candidates: Path | None, most: int, seed: int, json_target: str | None, *, force: bool
) -> int:
    from calib.campaign.read import read_campaign
    from calib.gap.diagnose import diagnose_in_full
    from calib.gap.plan.next_runs import next_runs
    from calib.gap.plan.plan_file import read_candidates

    read = read_campaign(campaign)
    offered = None if candidates is None else read_candidates(candidates)
    diagnosis = diagnose_in_full(read, seed=seed, plan=False)
    verdict = diagnosis.verdict
    runs = next_runs(
        read,
        diagnosis.effects,
        diagnosis.noise,
        [group.effects for group in verdict.groups],
        diagnosis.fitted,
        candidates=offered,
        most=most,
    )
    say_wrapped(f"{verdict.campaign}: {verdict.sentence}", target=json_target)
    say("", target=json_target)
    if runs:
        table(
            "Next runs, best first; in one session that begins with a repeat of an unladen corridor run",
            ["run", "kg", "at x, y m", "m/s", "degC", "loaded min", "why"],
            [_row(number, run.to_dict()) for number, run in enumerate(runs, start=1)],
            texts=["why"],
            target=json_target,
        )
    else:
        say("No run of the list would tell apart more than what was driven.", target=json_target)
    document = {
        "verdict": verdict.kind.value,
        "indistinguishable": [list(group.effects) for group in verdict.groups],
        "next_runs": [run.to_dict() for run in runs],
    }
    emit_json(document, json_target, force=force)
    return 0


def _row(number: int, run: Mapping[str, Any]) -> tuple[str, ...]:
    extra = [f"{run['stops']} stops"] if run.get("stops") else []
    extra += ["read while rolling"] if run.get("read_rolling") else []
    what = " ".join([str(run["kind"]), str(run.get("direction", "")), *extra]).strip()

    def shown(key: str) -> str:
        return f"{run[key]:g}" if run.get(key) is not None else "-"

    place = f"{run.get('payload_x_m', 0.0):g}, {run.get('payload_y_m', 0.0):g}" if run.get("payload_kg") else "-"
    numbers = (shown("payload_kg"), place, shown("speed_mps"), shown("temperature_C"), shown("minutes_under_load"))
    return (f"{number}. {what}", *numbers, str(run["why"]))


def _judge(source: Path, figures: Path | None, json_target: str | None, *, force: bool) -> int:
    from calib.errors import would_overwrite
    from calib.files import write_bytes
    from calib.gap.plan.next_runs import outlook_of
    from calib.gap.plan.plan_file import read_plan

    targets = [] if figures is None else [figures / f"plan-matrix.{form}" for form in FORMS]
    for target in targets:
        if target.exists() and not force:
            raise would_overwrite(target)
    planned = read_plan(source)
    outlook = outlook_of(planned)
    _show(planned.name, len(planned.runs), outlook, json_target)
    if figures is not None:
        from calib.report.figures.plan import plan_matrix
        from calib.report.figures.style import render

        figure = plan_matrix(outlook)
        for target, form in zip(targets, FORMS, strict=True):
            write_bytes(target, render(figure, form), force=force)
        say(f"wrote {len(targets)} figure files to {figures}", target=json_target)
    emit_json({"plan": planned.name, "runs": len(planned.runs), **outlook.to_dict()}, json_target, force=force)
    return 0


def _show(name: str, n_runs: int, outlook: Outlook, target: str | None) -> None:
    document = outlook.to_dict()
    told = set(document["told_apart"])
    rows = []
    for number, effect in enumerate(outlook.effects):
        others = document["confused"].get(effect, [])
        said = "yes" if effect in told else ("not seen at its typical size" if not others else ", ".join(others[:4]))
        if len(others) > 4:
            said += f" and {len(others) - 4} more"
        rows.append((effect, f"{outlook.signal[number]:.1f}", outlook.smallest[effect].sentence, said))
    table(
        f"{name}, {n_runs} runs: {len(told)} of {len(outlook.effects) + len(outlook.absent)} effects told apart",
        ["effect", "signal at typical size", "smallest size seen", "told apart, or confused with"],
        rows,
        target=target,
    )
    for effect in outlook.absent:
        say(f"  {effect}: {outlook.smallest[effect].sentence}", target=target)
