"""``calib check``: what a campaign holds, what is wrong and what is suspicious, before anyone computes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calib.cli import terminal


def run(
    campaign: Annotated[Path, typer.Argument(help="Campaign folder (campaign.toml, runs.csv, logs), or a recording.")],
    strict: Annotated[bool, typer.Option("--strict", help="Exit status 1 on suspicious things, too.")] = False,
    mapping: terminal.MappingOption = None,
) -> int:
    """Say what was found in a campaign, what is wrong and what is suspicious; nothing is changed.

    It ends in one of three verdicts: sound, look at this (something is suspicious), or wrong. The exit status is 1
    where something is wrong, 0 otherwise (with --strict only where nothing is suspicious either), 2 where the campaign
    cannot be read at all.

    Example: calib check sample_runs/corridor --json -
    """
    from dataclasses import asdict

    from calib.campaign.check import check_campaign
    from calib.campaign.read import read_or_ingest
    from calib.reporting.next_step import after_check
    from calib.reporting.topics.checks import check_content

    with terminal.progress("checking") as tick:
        report = check_campaign(read_or_ingest(campaign, mapping=mapping, lenient=True, progress=tick), tick)
    document = {
        "campaign": report.campaign,
        "simulated": report.simulated,
        "sound": report.sound,
        "verdict": report.verdict,
        "found": asdict(report.found),
        **{level: [asdict(note) for note in getattr(report, level)] for level in ("wrong", "suspicious", "info")},
    }
    terminal.answer(document, check_content(report))
    terminal.then(after_check(report.verdict, campaign, distances=report.found.distance_m is not None))
    return 1 if report.verdict == "wrong" or (strict and report.verdict != "sound") else 0
