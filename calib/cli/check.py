"""``calib check``: what a campaign holds, what is wrong and what is suspicious, before anyone computes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer

from calib.cli.output import FORCE, JSON, emit_json, say, wants_stdout

__all__ = ["register"]

_EPILOG = "Example: calib check sample_runs/corridor --json -"


def register(application: typer.Typer, name: str) -> None:
    """Add the command to the application."""

    @application.command(name, epilog=_EPILOG)
    def check(
        campaign: Path = typer.Argument(help="Campaign folder (campaign.toml, runs.csv, logs)."),
        json: str | None = JSON,
        force: bool = FORCE,
    ) -> int:
        """Say what was found in a campaign, what is wrong and what is suspicious; nothing is changed.

        The exit status is 1 where something is wrong, 0 where nothing is (suspicious things alone do not count), 2
        where the campaign cannot be read at all.
        """
        from dataclasses import asdict

        from calib.campaign.check import check_campaign
        from calib.campaign.read import read_campaign

        report = check_campaign(read_campaign(campaign, lenient=True))
        notes = {level: getattr(report, level) for level in ("wrong", "suspicious", "info")}
        emit_json(
            {
                "campaign": report.campaign,
                "simulated": report.simulated,
                "sound": report.sound,
                "found": asdict(report.found),
                **{level: [asdict(note) for note in found] for level, found in notes.items()},
            },
            json,
            force=force,
        )
        if not wants_stdout(json):
            _show(report)
        return 0 if report.sound else 1


def _show(report: Any) -> None:
    found = report.found
    say(f"{report.campaign}{' (simulated)' if report.simulated else ''}")
    excluded = f", {found.n_excluded} excluded" if found.n_excluded else ""
    say(f"  runs       {found.n_runs}{excluded}")
    for title, counted in (("sessions", found.sessions), ("kinds", found.kinds)):
        if counted:
            say(f"  {title:<10} {len(counted)}: " + ", ".join(f"{key} ({n})" for key, n in list(counted.items())[:12]))
    if found.payloads_kg:
        say(f"  payloads   {', '.join(f'{value:g}' for value in found.payloads_kg[:12])} kg")
    for title, span, unit in (
        ("left load", found.load_left_N, "N"),
        ("right load", found.load_right_N, "N"),
        ("distance", found.distance_m, "m"),
        ("speed", found.speed_mps, "m/s"),
        ("hall", found.temperature_C, "degC"),
    ):
        if span:
            say(f"  {title:<10} {span[0]:.5g} to {span[1]:.5g} {unit}")
    if found.n_logs and found.rate_Hz and found.duration_s:
        say(
            f"  logs       {found.n_logs}, {found.n_samples} samples at {found.rate_Hz[0]:.4g} to "
            f"{found.rate_Hz[1]:.4g} "
            f"Hz, {found.duration_s[0]:.4g} to {found.duration_s[1]:.4g} s ({', '.join(found.log_columns)})"
        )
    if found.covariates:
        say(f"  covariates {', '.join(found.covariates)}")
    for level, title in (("info", "Recognised"), ("suspicious", "Suspicious"), ("wrong", "Wrong")):
        notes = getattr(report, level)
        if notes:
            say(f"{title} ({len(notes)})")
            for note in notes:
                run = f" [{note.run_id}]" if note.run_id else ""
                say(f"  {note.where}{run}: {note.text}")
    say("Nothing is wrong." if report.sound else f"{len(report.wrong)} thing(s) wrong; put them right first.")
