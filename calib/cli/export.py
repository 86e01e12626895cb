"""`calib export`: the coefficients in the form that vehicle, controller or colleague needs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer

from calib.cli.output import FORCE, JSON, emit_json, say, wants_stdout

__all__ = ["register"]

EPILOG = "Example: calib export sample_runs/corridor --to ros2 --load 300 --load 500,700 --output params"


def register(application: typer.Typer, name: str) -> None:
    """Add the command to `application`."""

    @application.command(name, epilog=EPILOG)
    def export(
        source: Path = typer.Argument(
            ...,
            metavar="CAMPAIGN|FIT",
            help="Campaign, result folder of calib fit, its fit.json, or coefficients.json.",
        ),
        to: str = typer.Option(..., "--to", metavar="FORMAT", help="json (the master), ros2, c or csv."),
        output: Path | None = typer.Option(
            None, "--output", help="File, or folder where several files are made; without it: standard output."
        ),
        load: list[str] = typer.Option(
            [],
            "--load",
            metavar="N",
            help="Load point, N for both wheels or LEFT,RIGHT; may be given again (ros2, csv).",
        ),
        outside: str | None = typer.Option(
            None, "--outside", metavar="RULE", help="Loads that were not measured: refuse (the default) or clamp."
        ),
        date: str | None = typer.Option(None, "--date", metavar="YYYY-MM-DD", help="Date written into the file."),
        json_target: str | None = JSON,
        force: bool = FORCE,
    ) -> None:
        """Write the coefficients as JSON, ROS 2 parameters, C99 header or look-up table."""
        from calib.coefficients.export import export as make
        from calib.coefficients.export import parse_loads, place
        from calib.coefficients.source import coefficients_of

        found = coefficients_of(source, outside=outside, created=date)
        artifacts = make(found.file, to, parse_loads(load))
        for note in found.notes:
            typer.echo(f"calib: note: {note}", err=True)
        files: list[dict[str, Any]] = []
        if output is not None:
            files = place(artifacts, output, force=force)
            for written in files:
                say(f"wrote {written['path']}", target=json_target)
        elif wants_stdout(json_target):
            files = [{"name": made.name, "text": made.data.decode("utf-8")} for made in artifacts]
        else:
            typer.echo("---\n".join(made.data.decode("utf-8") for made in artifacts), nl=False)
        emit_json(
            {
                "to": to,
                "checksum": found.file.checksum,
                "outside": found.file.outside,
                "simulated": found.file.simulated,
                "files": files,
                "notes": list(found.notes),
            },
            json_target,
            force=force,
        )
