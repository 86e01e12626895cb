"""``calib ingest``: raw lab files become a campaign."""

from __future__ import annotations

from pathlib import Path

import typer

from calib.cli.output import FORCE, JSON, emit_json, say, wants_stdout

__all__ = ["register"]

_EPILOG = "Example: calib ingest export.xlsx logger/ --mapping lab.toml --into hall3"


def register(application: typer.Typer, name: str) -> None:
    """Add the command to the application."""

    @application.command(name, epilog=_EPILOG)
    def ingest(
        sources: list[Path] = typer.Argument(help="Run table first (csv, xlsx, parquet), then logs or folders."),
        into: Path = typer.Option(..., "--into", metavar="CAMPAIGN", help="Campaign folder to make."),
        mapping: Path | None = typer.Option(None, "--mapping", metavar="FILE", help="TOML that names the columns."),
        json: str | None = JSON,
        force: bool = FORCE,
    ) -> None:
        """Make a campaign out of raw lab files; the sources are hashed and left untouched.

        The mapping is written once for a lab's export. Its sections [table] and [log] say which source column is which
        calib column, as a name (run_id = "Run no.") or with unit and factor (distance_m = {column = "Distance", unit =
        "mm"}, counts_left = {column = "Enc L", factor = -1}); session = {value = "monday"} is the same for every run;
        log.file = "run_{run_id}.csv" names a run's log. All else ([vehicle], [encoder], name, ...) goes into
        campaign.toml. Columns that carry calib's names need no line.
        """
        from calib.campaign.ingest import ingest as make

        made = make(sources, into, mapping=mapping, force=force)
        emit_json(
            {
                "campaign": str(made.folder),
                "n_runs": made.n_runs,
                "n_logs": made.n_logs,
                "sources": dict(made.sources),
                "notes": [{"level": note.level, "where": note.where, "text": note.text} for note in made.notes],
            },
            json,
            force=force,
        )
        if not wants_stdout(json):
            for note in made.notes:
                say(f"  {note.where}: {note.text}")
            say(f"{made.folder}: {made.n_runs} runs, {made.n_logs} logs; look at it with 'calib check {made.folder}'")
