"""``calib ingest``: raw lab files become a campaign."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calib.cli.options import Force, JsonTarget, refuse_existing
from calib.cli.terminal import emit_json, say, waiting, wants_stdout

__all__ = ["EPILOG", "run"]

EPILOG = "Example: calib ingest export.xlsx logger/ --mapping lab.toml --into hall3"


def run(
    sources: Annotated[list[Path], typer.Argument(help="Run table first (csv, xlsx, parquet), then logs or folders.")],
    into: Annotated[Path, typer.Option("--into", metavar="CAMPAIGN", help="Campaign folder to make.")],
    mapping: Annotated[
        Path | None, typer.Option("--mapping", metavar="FILE", help="TOML that names the columns.")
    ] = None,
    json: JsonTarget = None,
    force: Force = False,
) -> None:
    """Make a campaign out of raw lab files; the sources are hashed and left untouched.

    The mapping is written once for a lab's export. Its sections [table] and [log] say which source column is which
    calib column, as a name (run_id = "Run no.") or with unit and factor (distance_m = {column = "Distance", unit =
    "mm"}, counts_left = {column = "Enc L", factor = -1}); session = {value = "monday"} is the same for every run;
    log.file = "run_{run_id}.csv" names a run's log. All else ([vehicle], [encoder], name, ...) goes into
    campaign.toml. Columns that carry calib's names need no line.
    """
    from calib.campaign.ingest import ingest

    refuse_existing([json], force=force)
    with waiting("reading"):
        made = ingest(sources, into, mapping=mapping, force=force)
    document = {
        "campaign": str(made.folder),
        "n_runs": made.n_runs,
        "n_logs": made.n_logs,
        "sources": dict(made.sources),
        "notes": [{"level": note.level, "where": note.where, "text": note.text} for note in made.notes],
    }
    emit_json(document, json, force=force)
    if not wants_stdout(json):
        for note in made.notes:
            say(f"  {note.where}: {note.text}")
        say(f"{made.folder}: {made.n_runs} runs, {made.n_logs} logs; look at it with 'calib check {made.folder}'")
