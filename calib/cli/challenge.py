"""`calib challenge`: a blind check of the diagnosis on cases whose truth is sealed."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from calib.cli.output import FORCE, JSON, emit_json, say, table
from calib.cli.threads import one_blas_thread

if TYPE_CHECKING:
    from calib.challenge.score import Score

__all__ = ["register"]

EPILOG = "Example: calib challenge make --seeds calib/challenge/seeds/ci.toml --into blind"
MAKE_EPILOG = "Example: calib challenge make --seeds calib/challenge/seeds/development.toml --into blind --cases 40"
RUN_EPILOG = "Example: calib challenge run blind"
SCORE_EPILOG = "Example: calib challenge score blind --plot blind.png --json blind-score.json"

FOLDER = typer.Argument(..., metavar="DIR", help="A set made by 'calib challenge make'.")
CASES = typer.Option(None, "--cases", metavar="N", min=1, help="Only so many cases.")
WORKERS = typer.Option(2, "--workers", metavar="N", min=1, help="Processes.")
TRUTH = typer.Option(None, "--truth", metavar="FILE", help="The sealed truth; DIR.truth.json where not given.")


def register(application: typer.Typer, name: str) -> None:
    """Add the command to `application`."""
    group = typer.Typer(
        no_args_is_help=True,
        rich_markup_mode=None,
        epilog=EPILOG,
        help="Check the diagnosis blind: make sealed cases, diagnose them, open the truth and score.",
    )

    @group.command("make", epilog=MAKE_EPILOG)
    def make(
        seeds: Path = typer.Option(..., "--seeds", metavar="FILE", help="Seeds file; see calib/challenge/seeds."),
        into: Path = typer.Option(..., "--into", metavar="DIR", help="Folder for the set."),
        cases: int | None = CASES,
        truth: Path | None = TRUTH,
        workers: int = WORKERS,
        json_target: str | None = JSON,
        force: bool = FORCE,
    ) -> None:
        """Make sealed cases: first the truth, in one file apart whose hash is stored, then the campaigns."""
        one_blas_thread()
        from calib.challenge.seal import make as make_set

        with _progress("making") as tick:
            made = make_set(
                seeds,
                into,
                limit=cases,
                truth_file=truth,
                workers=workers,
                force=force,
                tick=lambda stage, done, total: tick(done, total, stage),
                sealed=lambda digest: say(f"truth sealed, SHA-256 {digest}", target=json_target),
            )
        say(f"{made.cases} cases in {made.folder}, truth apart in {made.truth}", target=json_target)
        found = {"folder": str(made.folder), "truth": str(made.truth), "sha256": made.sha256, "cases": made.cases}
        emit_json(found, json_target, force=force)

    @group.command("run", epilog=RUN_EPILOG)
    def run(
        folder: Path = FOLDER,
        cases: int | None = CASES,
        workers: int = WORKERS,
        seed: int = typer.Option(0, "--seed", metavar="N", min=0, help="Seed of the diagnosis."),
        json_target: str | None = JSON,
        force: bool = FORCE,
    ) -> None:
        """Diagnose every case that has no verdict yet; the truth is not opened."""
        one_blas_thread()
        from calib.challenge.run import run as run_set

        with _progress("diagnosing") as tick:
            ran = run_set(
                folder, workers=workers, seed=seed, limit=cases, tick=lambda done, total: tick(done, total, "cases")
            )
        say(
            f"{ran.done} cases diagnosed, {ran.skipped} had a verdict already, {ran.failed} ended in an error",
            target=json_target,
        )
        emit_json({"done": ran.done, "skipped": ran.skipped, "failed": ran.failed}, json_target, force=force)

    @group.command("score", epilog=SCORE_EPILOG)
    def score(
        folder: Path = FOLDER,
        truth: Path | None = TRUTH,
        plot: Path | None = typer.Option(
            None, "--plot", metavar="FILE", help="PNG, SVG or PDF; the confusion matrix goes beside it."
        ),
        json_target: str | None = JSON,
        force: bool = FORCE,
    ) -> int:
        """Open the truth once, check its hash, and score the verdicts. Exit status 1 where a target is missed."""
        one_blas_thread()
        from calib.challenge.score import score as score_set

        found = score_set(folder, truth_file=truth)
        _show(found, json_target)
        if plot is not None:
            from calib.challenge.figures import board_figure, confusion_figure, save

            beside = plot.with_name(f"{plot.stem}-confusion{plot.suffix}")
            save(board_figure(found), plot, force=force)
            save(confusion_figure(found), beside, force=force)
            say(f"drawn: {plot}, {beside}", target=json_target)
        emit_json(found.to_dict(), json_target, force=force)
        return 1 if any(found.meets(line) is False for line in found.board) else 0

    application.add_typer(group, name=name)


def _show(found: Score, json_target: str | None) -> None:
    from calib.challenge.intervals import clopper_pearson, wilson
    from calib.challenge.score import TARGETS

    rows = []
    for name, one in found.board.items():
        low, high = wilson(one.hits, one.total)
        exact = clopper_pearson(one.hits, one.total)
        target = f"{TARGETS[name][1]} {TARGETS[name][0]:.0%}" if name in TARGETS else ""
        met = {True: "met", False: "MISSED", None: ""}[found.meets(name)]
        rate = "-" if one.rate is None else f"{one.rate:.1%}"
        bounds = [f"{low:.1%}..{high:.1%}", f"{exact[0]:.1%}..{exact[1]:.1%}"]
        rows.append([name, f"{one.hits}/{one.total}", rate, *bounds, target, met])
    header = ["", "cases", "share", "Wilson 95 %", "Clopper-Pearson 95 %", "target", ""]
    title = f"{len(found.cases)} sealed cases ({found.purpose}), truth {found.truth_sha256}"
    table(title, header, rows, target=json_target)
    words = ("detected", "first", "in_group", "covered")
    signals = [
        [signal, *(f"{row[word].hits}/{row[word].total}" for word in words)] for signal, row in found.by_signal.items()
    ]
    head = ["signal", "a gap seen", "named first", "named or in its group", "in the 95 % set"]
    table("Single effects by signal", head, signals, target=json_target)
    bins = []
    for row in found.reliability:
        true, band = row["true"], f"{row['low']:.1f}..{row['high']:.1f}"
        bins.append([band, f"{row['stated']:.3f}", f"{true['rate']:.3f}", f"{true['total']}"])
    table("Stated probabilities", ["bin", "stated", "true", "statements"], bins, target=json_target)
    summary = found.summary
    coverage = summary["interval_coverage"]
    say(f"95 % set: {summary['median_set_size']} hypotheses (median)", target=json_target)
    say(f"95 % intervals that hold the truth: {coverage['hits']} of {coverage['total']}", target=json_target)
    if summary["closure_compared"]:
        difference = summary["closure_predicted_minus_achieved_median"]
        say(f"closure, predicted against achieved: {difference:.3f} apart (median)", target=json_target)
    misses = [
        [
            case.case,
            case.group,
            "-" if case.signal is None else f"{case.signal:g}",
            (f"deleted {case.deleted}" if case.deleted else " + ".join(case.truth)) or "nothing",
            case.error or f"{case.verdict}: {', '.join(case.named)}".rstrip(": "),
            case.rival,
        ]
        for case in found.misses
    ]
    table("Misses", ["case", "group", "signal", "truth", "answer", "nearest rival, sigma"], misses, target=json_target)


@contextmanager
def _progress(what: str) -> Iterator[Callable[[int, int, str], None]]:
    """Give a function that shows progress on standard error, where that is a terminal."""
    if not sys.stderr.isatty():
        yield lambda _done, _total, _stage: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        tasks: dict[str, object] = {}

        def tick(done: int, total: int, stage: str) -> None:
            if stage not in tasks:
                tasks[stage] = bar.add_task(f"{what} {stage}", total=total)
            bar.update(tasks[stage], completed=done)  # type: ignore[arg-type]

        yield tick
