"""`calib challenge make`: sealed cases."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calib.cli.challenge.options import Cases, Truth, Workers
from calib.cli.options import Force, JsonTarget
from calib.cli.terminal import emit_json, progress, say
from calib.cli.threads import one_blas_thread

EPILOG = "Example: calib challenge make --seeds calib/challenge/seeds/development.toml --into blind --cases 40"


def run(
    seeds: Annotated[Path, typer.Option(metavar="FILE", help="Seeds file; see calib/challenge/seeds.")],
    into: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the set.")],
    cases: Cases = None,
    truth: Truth = None,
    workers: Workers = 2,
    json: JsonTarget = None,
    force: Force = False,
) -> None:
    """Make sealed cases: first the truth, in one file apart whose hash is stored, then the campaigns."""
    one_blas_thread()
    from calib.challenge.seal import make

    with progress("making") as tick:
        sealed_set = make(
            seeds,
            into,
            limit=cases,
            truth_file=truth,
            workers=workers,
            force=force,
            tick=lambda stage, done, total: tick(done, total, stage),
            sealed=lambda digest: say(f"truth sealed, SHA-256 {digest}", target=json),
        )
    say(f"{sealed_set.cases} cases in {sealed_set.folder}, truth apart in {sealed_set.truth}", target=json)
    document = {
        "folder": str(sealed_set.folder),
        "truth": str(sealed_set.truth),
        "sha256": sealed_set.sha256,
        "cases": sealed_set.cases,
    }
    emit_json(document, json, force=force)
