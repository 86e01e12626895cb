"""`calib challenge run`: every case diagnosed, the truth unopened."""

from __future__ import annotations

from typing import Annotated

import typer

from calib.cli.challenge.options import Cases, Folder, Workers
from calib.cli.options import Force, JsonTarget
from calib.cli.terminal import emit_json, keep, progress, say
from calib.cli.threads import one_blas_thread

EPILOG = "Example: calib challenge run blind"


def run(
    folder: Folder,
    cases: Cases = None,
    workers: Workers = 2,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Seed of the diagnosis.")] = 0,
    json: JsonTarget = None,
    force: Force = False,
) -> None:
    """Diagnose every case that has no verdict yet; the truth is not opened."""
    one_blas_thread()
    from calib.challenge.run import run as run_set

    keep(f"the verdicts so far, in {folder}; the same command goes on")
    with progress("diagnosing") as tick:
        ran = run_set(
            folder, workers=workers, seed=seed, limit=cases, tick=lambda done, total: tick(done, total, "cases")
        )
    say(f"{ran.done} cases diagnosed, {ran.skipped} had a verdict already, {ran.failed} ended in an error", target=json)
    emit_json({"done": ran.done, "skipped": ran.skipped, "failed": ran.failed}, json, force=force)
