"""`calib diagnose`: where the sim-to-real gap lies, which effect causes it, how far it shrinks."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from calib.cli.output import FORCE, JSON, emit_json, say, say_wrapped, table
from calib.cli.threads import one_blas_thread

if TYPE_CHECKING:
    from calib.campaign.model import Campaign
    from calib.gap.verdict.result import Verdict

__all__ = ["register"]

EPILOG = "Example: calib diagnose sample_runs/corridor_crossed --apply coefficients.json"
RESULT_FILE = "diagnosis.json"
#: lines shown of long lists; the JSON has them all
SHOWN = 12


def register(application: typer.Typer, name: str) -> None:
    """Add the command to `application`."""

    @application.command(name, epilog=EPILOG)
    def diagnose(
        campaign: Path = typer.Argument(..., metavar="CAMPAIGN", help="Folder with campaign.toml and runs.csv."),
        model: Path | None = typer.Option(
            None, "--model", metavar="FILE", help="Coefficient file that the simulator believes, effects included."
        ),
        exclude: list[str] = typer.Option(
            [], "--exclude", metavar="EFFECT", help="Leave an effect out of the library; again for more."
        ),
        seed: int = typer.Option(0, "--seed", help="Seed of the bootstraps."),
        apply: Path | None = typer.Option(
            None, "--apply", metavar="FILE", help="Write the model with the named effect added, as coefficient file."
        ),
        figures: Path | None = typer.Option(
            None, "--figures", metavar="FOLDER", help="Write the pictures there as PNG, SVG and PDF."
        ),
        into: Path | None = typer.Option(None, "--into", metavar="FOLDER", help="Result folder: diagnosis.json."),
        json_target: str | None = JSON,
        force: bool = FORCE,
    ) -> int:
        """Say where the gap between measured and simulated motion lies, and which unmodelled effect causes it.

        Exit status 0: there is no gap, or it is explained. 1: the causes cannot be told apart, or the gap is explained
        in part only, or its cause is unknown. 2: bad input.
        """
        one_blas_thread()
        from calib.campaign.read import read_campaign
        from calib.errors import would_overwrite
        from calib.files import write_bytes, write_json
        from calib.gap.apply import applied_model
        from calib.gap.diagnose import diagnose_in_full
        from calib.gap.effects.applied import model_of
        from calib.gap.verdict.paper_headline import headline
        from calib.gap.verdict.result import VerdictKind

        for target in (apply, None if into is None else into / RESULT_FILE):
            if target is not None and target.exists() and not force:
                raise would_overwrite(target)
        read = read_campaign(campaign)
        if exclude:
            _check_excluded(exclude, read)
        believed, effects = (None, ()) if model is None else model_of(model, read)
        found = diagnose_in_full(
            read,
            seed=seed,
            exclude=tuple(exclude),
            model=believed,
            applied=effects,
            model_name="" if model is None else model.name,
        )
        document = found.verdict.to_dict() | {"headline": headline(found.verdict)}
        _show(found.verdict, document, json_target)
        if apply is not None:
            write_bytes(apply, applied_model(found, read, effects).to_bytes(), force=force)
            say(f"wrote {apply}", target=json_target)
            if not found.verdict.recommended:
                say_wrapped(
                    "The written model is not recommended: see above what speaks against it.", target=json_target
                )
        if into is not None:
            write_json(into / RESULT_FILE, document, force=force)
            say(f"wrote {into / RESULT_FILE}", target=json_target)
        if figures is not None:
            from calib.report.figures.gap_files import write_gap_pictures

            written = write_gap_pictures(found, figures, force=force)
            say(f"wrote {len(written)} figure files to {figures}", target=json_target)
        emit_json(document, json_target, force=force)
        return 0 if found.verdict.kind in {VerdictKind.NO_GAP, VerdictKind.EXPLAINED} else 1


def _check_excluded(exclude: list[str], campaign: Campaign) -> None:
    """Refuse what is no effect of the campaign's library, its columns' and the user's own included."""
    from calib.errors import BadInputError
    from calib.gap.data.from_campaign import observations_of
    from calib.gap.effects.library import check_excluded

    try:
        check_excluded(exclude, observations_of(campaign), campaign.extra.get("effects", ()))
    except BadInputError as error:
        raise BadInputError(f"--{error}") from error


def _show(verdict: Verdict, document: Mapping[str, Any], target: str | None) -> None:
    say(document["campaign"] + (" - SIMULATED DATA" if document["simulated"] else ""), target=target)
    say("", target=target)
    say_wrapped(f"Verdict ({document['verdict']}): {document['sentence']}", target=target)
    say("", target=target)
    _show_where(document["where"], target)
    _show_causes(document, target)
    _show_closure(verdict, document, target)
    _show_limits(verdict, target)
    _show_next(document, target)
    for note in document["notes"]:
        say_wrapped(str(note), target=target, lead="  note  ")


def _show_where(where: Mapping[str, Any], target: str | None) -> None:
    rows = []
    for name, one in where.get("channels", {}).items():
        unit = "mrad" if name in {"heading", "steering"} else "mm"
        rms, floor = one["rms"], one["floor"]
        rows.append(
            (name, _milli(rms), _milli(floor), unit, f"{rms / floor:.1f}" if floor else "-"),
        )
    if rows:
        table("Where: the gap by channel", ["channel", "gap rms", "floor", "unit", "ratio"], rows, target=target)
    found = [line for line in where.get("covariates", ()) if line.get("significant")]
    if found:
        table(
            "What it goes with (chance of any false line 5 %)",
            ["covariate", "channel", "share", "95 % interval", "p"],
            [
                (
                    str(line["name"]),
                    str(line["channel"]),
                    f"{line['share']:.2f}",
                    "-" if line["ci95"] is None else f"{line['ci95'][0]:.2f} .. {line['ci95'][1]:.2f}",
                    f"{line['p_value']:.1e}",
                )
                for line in found[:SHOWN]
            ],
            target=target,
        )
    from calib.report.gap_lines import place_line, run_line

    for place in where.get("places", ())[:5]:
        say_wrapped(place_line(place), target=target, lead="  place  ")
    worst = [run for run in where.get("runs", ()) if abs(run["z"]) > 4.0][:3]
    for run in worst:
        say_wrapped(run_line(run), target=target, lead="  run    ")


def _show_causes(document: Mapping[str, Any], target: str | None) -> None:
    rows = []
    for cause in document["causes"]:
        for number, (name, one) in enumerate(cause["parameters"].items()):
            low, high = one["ci95"]
            value = one["value"]
            half = None if low is None or high is None else 0.5 * (high - low)
            rows.append(
                (
                    cause["effect"] + (f", {cause['form']}" if cause["form"] else "") if number == 0 else "",
                    f"{cause['probability']:.2f}" if number == 0 else "",
                    f"{cause['share']:.2f}" if number == 0 else "",
                    name,
                    "-" if value is None else f"{value:.4g}" + ("" if half is None else f" +- {half:.2g}"),
                    one["unit"],
                    ("yes" if cause["plausible"] else "NO") if number == 0 else "",
                )
            )
    if rows:
        table(
            "Which: causes with sizes (+- is the 95 % interval)",
            ["cause", "probability", "share", "parameter", "size", "unit", "plausible"],
            rows,
            target=target,
        )
    for cause in document["causes"]:
        if cause["remark"]:
            say_wrapped(f"{cause['effect']}: {cause['remark']}", target=target, lead="  ")
    for group in document["indistinguishable"]:
        say_wrapped(f"these runs cannot tell apart: {', '.join(group)}", target=target, lead="  ")


def _show_closure(verdict: Verdict, document: Mapping[str, Any], target: str | None) -> None:
    closure = document["closure"]
    if closure.get("before_rms_m") is None:
        return
    said = (
        f"How far: gap {_milli(closure['before_rms_m'])} mm before, {_milli(closure.get('after_rms_m'))} mm after, "
        f"noise floor {_milli(closure.get('floor_rms_m'))} mm; "
        f"each {closure.get('held_out', 'condition')} left out in turn"
    )
    if closure.get("fraction") is not None:
        # the root mean squares are those of the ends, which the noisiest runs and channels rule; the closure weighs
        said += f"; closure, every run and channel weighed by its noise, {closure['fraction']:.2f}"
        if closure.get("ci95"):
            said += f" (95 %: {closure['ci95'][0]:.2f} .. {closure['ci95'][1]:.2f})"
    say_wrapped(said + ".", target=target)
    if document["headline"] is not None:
        say_wrapped(document["headline"]["sentence"], target=target)
    from calib.gap.verdict.sentence import advice

    if verdict.causes:
        say_wrapped(advice(verdict), target=target)
    say("", target=target)


def _show_limits(verdict: Verdict, target: str | None) -> None:
    never = [limit.effect for limit in verdict.undetectable if limit.never]
    rows = [(limit.effect, limit.smallest) for limit in verdict.undetectable if not limit.never]
    if rows:
        table("What these runs could have shown", ["effect", "smallest size"], rows, target=target)
    if never:
        say_wrapped(f"Never to be seen in these runs: {', '.join(never)}", target=target, lead="  ")


def _show_next(document: Mapping[str, Any], target: str | None) -> None:
    runs = document["next_runs"]
    if runs:
        say("Next runs, best first (more with 'calib plan'):", target=target)
    for number, run in enumerate(runs[:5], start=1):
        what = ", ".join(
            f"{run[key]:g} {unit}"
            for key, unit in (("payload_kg", "kg"), ("speed_mps", "m/s"), ("temperature_C", "degC"))
            if run.get(key) is not None
        )
        say_wrapped(
            f"{run['kind']} {run.get('direction', '')}, {what}: {run['why']}", target=target, lead=f"  {number}. "
        )


def _milli(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{1e3 * value:.3g}" if abs(value) < 0.9995 else f"{1e3 * value:.0f}"
