"""`calib challenge score`: the truth opened once, the verdicts scored."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calib.cli.challenge.board import score_content
from calib.cli.challenge.options import Folder, Truth
from calib.cli.options import Force, JsonTarget
from calib.cli.terminal import emit_json, show, wrote
from calib.cli.threads import one_blas_thread
from calib.files import refuse_existing

EPILOG = "Example: calib challenge score blind --plot blind.png --json blind-score.json"


def run(
    folder: Folder,
    truth: Truth = None,
    plot: Annotated[
        Path | None, typer.Option(metavar="FILE", help="PNG, SVG or PDF; the confusion matrix goes beside it.")
    ] = None,
    json: JsonTarget = None,
    force: Force = False,
) -> int:
    """Open the truth once, check its hash, and score the verdicts. Exit status 1 where a target is missed."""
    one_blas_thread()
    from calib.challenge.score import score

    beside = None if plot is None else plot.with_name(f"{plot.stem}-confusion{plot.suffix}")
    refuse_existing([plot, beside], force=force)
    scored = score(folder, truth_file=truth)
    show(score_content(scored), target=json)
    if plot is not None and beside is not None:
        from calib.report.figures.challenge import board_figure, confusion_figure, save

        save(board_figure(scored), plot, force=force)
        save(confusion_figure(scored), beside, force=force)
        wrote([plot, beside], target=json)
    emit_json(scored.to_dict(), json, force=force)
    return 1 if any(scored.meets(line) is False for line in scored.board) else 0
