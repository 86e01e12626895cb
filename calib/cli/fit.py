"""`calib fit`: the radius law of each wheel, with intervals, checks and budget."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from calib.cli.output import FORCE, JSON, emit_json, say, say_wrapped, table, wants_stdout

if TYPE_CHECKING:
    from calib.radius.comparison import Difference, ModelComparison
    from calib.radius.fitted import Fit
    from calib.radius.regression import WheelFit

__all__ = ["register"]

EPILOG = "Example: calib fit sample_runs/corridor --into results/corridor"
MARKS = {"ok": "ok    ", "note": "note  ", "failed": "FAILED"}


def register(application: typer.Typer, name: str) -> None:
    """Add the command to `application`."""

    @application.command(name, epilog=EPILOG)
    def fit(
        campaign: Path = typer.Argument(..., metavar="CAMPAIGN", help="Folder with campaign.toml and runs.csv."),
        into: Path | None = typer.Option(
            None, "--into", metavar="FOLDER", help="Result folder: fit.json and runs.csv, for report and export."
        ),
        reference_load: float | None = typer.Option(
            None,
            "--reference-load",
            metavar="N",
            help="Load on which the coefficients are centred; without it: reference_load_N of campaign.toml.",
        ),
        model: Path | None = typer.Option(
            None,
            "--model",
            metavar="FILE",
            help="Coefficient file whose law the fitted one is held against, at that law's reference load.",
        ),
        runs: bool = typer.Option(False, "--runs", help="List the radius of every run."),
        json_target: str | None = JSON,
        force: bool = FORCE,
    ) -> int:
        """Fit each wheel's effective radius against its load.

        The intervals allow for what runs of one session have in common. Exit status 1 where a check says that the law
        should not be used as it is; what --model shows is told, and does not change it.
        """
        from dataclasses import replace

        from calib import __version__
        from calib.campaign.read import read_campaign
        from calib.coefficients.source import coefficients_of, effects_left_out
        from calib.errors import BadInputError
        from calib.radius.comparison import compare_laws
        from calib.radius.fit import fit_campaign
        from calib.radius.result import FIT_FILE, RUNS_FILE, provenance, write_result

        if into is not None and not force:
            _refuse_existing(into, (FIT_FILE, RUNS_FILE))
        believed = None
        if model is not None:
            if reference_load is not None:
                raise BadInputError(
                    "--reference-load: found with --model; expected one of them, since the model brings its own; leave "
                    "one out"
                )
            believed = coefficients_of(model)
            reference_load = believed.file.law.left.reference_load_N
        read = read_campaign(campaign)
        found = fit_campaign(read, reference_load_N=reference_load)
        compared = None if believed is None else compare_laws(found.left, found.right, believed.file.law)
        left_out = () if believed is None else (*believed.notes, *effects_left_out(believed.file, "not compared"))
        arguments = {"campaign": campaign.name, "reference_load_N": reference_load}
        found = replace(found, provenance=provenance(read, version=__version__, arguments=arguments))
        if not wants_stdout(json_target):
            _show(found, json_target, runs=runs)
            if compared is not None:
                _show_comparison(compared, left_out, json_target)
        if into is not None:
            written = write_result(found, into, force=force)
            if not wants_stdout(json_target):
                say(f"wrote {written}", target=json_target)
        document = found.to_dict()
        if compared is not None:
            document["model_comparison"] = compared.to_dict() | {"notes": list(left_out)}
        emit_json(document, json_target, force=force)
        return 0 if found.passed else 1


def _refuse_existing(folder: Path, names: Sequence[str]) -> None:
    from calib.errors import would_overwrite

    for name in names:
        if (folder / name).exists():
            raise would_overwrite(folder / name)


def _show(fit: Fit, target: str | None, *, runs: bool) -> None:
    sessions = len(set(fit.radii.session))
    say(
        f"{fit.name}: {len(fit.radii)} runs in {sessions} {'session' if sessions == 1 else 'sessions'}"
        + (" - SIMULATED DATA" if fit.simulated else ""),
        target=target,
    )
    for wheel in fit.wheels.values():
        _show_wheel(f"{wheel.wheel.capitalize()} wheel", wheel, target)
    for wheel in fit.static.values():
        _show_wheel(f"{wheel.wheel.capitalize()} wheel, standing (static radius)", wheel, target)
    _show_checks(fit, target)
    _show_budget(fit, target)
    if runs:
        table(
            "Runs",
            ["run", "session", "load left N", "load right N", "left mm", "right mm", "residual left um", "right um"],
            _run_rows(fit),
            target=target,
        )
    for note in fit.notes:
        say_wrapped(note, target=target)
    if fit.radii.left_out:
        say(f"Left out: {len(fit.radii.left_out)} runs", target=target)
        for run in fit.radii.left_out:
            say(f"  {run.run_id} {run.reason}", target=target)
    say("", target=target)
    notes = sum(check.level == "note" for wheel in fit.wheels.values() for check in wheel.checks)
    if not fit.passed:
        say("A check FAILED: do not use the law as it is; see above.", target=target)
    elif notes:
        say(f"No check failed; {notes} {'note' if notes == 1 else 'notes'} to read above.", target=target)
    else:
        say("Every check passed.", target=target)


def _show_wheel(title: str, fit: WheelFit, target: str | None) -> None:
    law = fit.law
    say("", target=target)
    say(title, target=target)
    std = float(law.covariance[0, 0]) ** 0.5
    rows = [
        _line(
            f"radius at {law.reference_load_N:.0f} N",
            1e3 * law.radius_ref_m,
            1e3 * std,
            [1e3 * end for end in fit.radius_ref_ci95_m],
            "mm",
            fit.dof_radius_ref,
        )
    ]
    if fit.slope_ci95_m_per_N is not None:
        std = float(law.covariance[1, 1]) ** 0.5
        rows.append(
            _line(
                "slope",
                1e6 * law.slope_m_per_N,
                1e6 * std,
                [1e6 * end for end in fit.slope_ci95_m_per_N],
                "um/N",
                fit.dof_slope,
            )
        )
    for row in rows:
        say("  " + row, target=target)
    if fit.naive is not None and fit.estimate.dof_between > 0 and fit.slope_ci95_m_per_N is not None:
        low, high = (1e6 * end for end in fit.naive.slope_ci95_m_per_N)
        digits = _decimals(0.5 * (high - low))
        say(
            f"    (as if runs were independent, 95 %: [{low:.{digits}f}, {high:.{digits}f}] um/N"
            f" with {fit.naive.dof:.0f} degrees of freedom)",
            target=target,
        )
    say(
        f"  scatter           {1e6 * fit.run_std_m:.1f} um a run, {1e6 * fit.session_std_m:.1f} um a session"
        + (f"; R^2 = {fit.r_squared:.5f}" if fit.model == "line" else ""),
        target=target,
    )
    low, high = (float(1e6 * (end - law.radius_ref_m)) for end in fit.prediction_band_m(law.reference_load_N))
    say(
        f"  next single run   within {low:+.0f} .. {high:+.0f} um of the law at {law.reference_load_N:.0f} N (95 %)",
        target=target,
    )


def _show_comparison(found: ModelComparison, notes: Sequence[str], target: str | None) -> None:
    rows = []
    for side, wheel in (("left", found.left), ("right", found.right)):
        rows.append(_comparison_row(f"{side}: radius at {found.reference_load_N:.0f} N", wheel.radius_ref, 1e3, "mm"))
        if wheel.slope is not None:
            rows.append(_comparison_row(f"{side}: slope", wheel.slope, 1e6, "um/N"))
    say("", target=target)
    table(
        "Fitted law against the model's",
        ["", "unit", "fitted", "model", "difference", "95 %", "model lies"],
        rows,
        target=target,
    )
    for note in notes:
        say_wrapped(note, target=target, lead="  note  ")


def _comparison_row(name: str, one: Difference, factor: float, unit: str) -> tuple[str, ...]:
    low, high = (factor * end for end in one.ci95)
    digits = _decimals(0.5 * (high - low))
    values = (f"{factor * one.fitted:.{digits}f}", f"{factor * one.model:.{digits}f}")
    interval = f"{low:+.{digits}f} .. {high:+.{digits}f}"
    return (
        name,
        unit,
        *values,
        f"{factor * one.difference:+.{digits}f}",
        interval,
        "inside" if one.inside else "OUTSIDE",
    )


def _line(name: str, value: float, std: float, ends: Sequence[float], unit: str, dof: float) -> str:
    digits = _decimals(std)
    share = f" ({100 * std / abs(value):.2g} %)" if value else ""
    return (
        f"{name:17} {value:.{digits}f} +- {std:.{digits}f} {unit}{share}"
        f"   95 %: [{ends[0]:.{digits}f}, {ends[1]:.{digits}f}]   t with {dof:.3g} degrees of freedom"
    )


def _decimals(std: float) -> int:
    """Return the decimals that show two significant digits of a standard uncertainty."""
    from math import floor, isfinite, log10

    return max(0, 1 - floor(log10(std))) if std > 0 and isfinite(std) else 4


def _show_checks(fit: Fit, target: str | None) -> None:
    say("", target=target)
    say("Checks", target=target)
    pairs: dict[tuple[str, str, str], list[str]] = {}
    for wheel in fit.wheels.values():
        for check in wheel.checks:
            pairs.setdefault((check.name, check.level, check.sentence), []).append(wheel.wheel)
    order = {check.name: number for number, check in enumerate(fit.left.checks + fit.right.checks)}
    for (name, level, sentence), wheels in sorted(pairs.items(), key=lambda item: order[item[0][0]]):
        who = "both" if len(wheels) == 2 else wheels[0]
        say_wrapped(sentence, target=target, lead=f"  {MARKS[level]} {who:5} {name.replace('_', ' '):18}")


def _show_budget(fit: Fit, target: str | None) -> None:
    budget = fit.radii.budget
    if not budget:
        return
    rows = [
        (
            f"{part.name.replace('_', ' ')}: {part.what}",
            part.kind,
            part.distribution,
            f"{1e6 * part.std_left_m:.2f}",
            f"{1e6 * part.std_right_m:.2f}",
        )
        for part in budget
    ]
    left, right = (
        1e6 * sum(value**2 for value in side) ** 0.5
        for side in ([part.std_left_m for part in budget], [part.std_right_m for part in budget])
    )
    rows.append(("combined standard uncertainty of a single radius", "", "", f"{left:.2f}", f"{right:.2f}"))
    say("", target=target)
    table(
        "Uncertainty budget of one run's radius (um, k = 1; GUM evaluation A or B)",
        ["source", "type", "distribution", "left", "right"],
        rows,
        target=target,
    )


def _run_rows(fit: Fit) -> list[list[str]]:
    radii = fit.radii
    columns: list[Any] = [
        radii.run_id,
        radii.session,
        [f"{one:.1f}" for one in radii.load_left_N],
        [f"{one:.1f}" for one in radii.load_right_N],
        [f"{1e3 * one:.4f}" for one in radii.radius_left_m],
        [f"{1e3 * one:.4f}" for one in radii.radius_right_m],
        [f"{1e6 * one:+.1f}" for one in fit.left.residual_m],
        [f"{1e6 * one:+.1f}" for one in fit.right.residual_m],
    ]
    return [[str(cell) for cell in row] for row in zip(*columns, strict=True)]
