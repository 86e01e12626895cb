"""`calib init`, `ingest` and `check`: an empty campaign, one from raw lab files, and what is wrong with one."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from calib.cli import terminal
from calib.cli.terminal import Place, arg, opt

if TYPE_CHECKING:
    from calib.campaign.ingest.build import Ingested

#: runs cut out of a recording that are listed
_LISTED_RUNS = 8


def init(folder: Annotated[Path, arg(None, "Campaign folder to make.")]) -> None:
    """Make an empty campaign to fill in by hand: campaign.toml with remarks, runs.csv with its header, logs.

    What a laboratory has already, in spreadsheets, loggers or recordings, goes in with 'calib ingest' instead.

    Example: calib init hall3
    """
    from calib.campaign.ingest.describe import write_blank

    written = write_blank(folder, force=terminal.forced())
    terminal.emit_json({"campaign": str(folder), "written": [str(path) for path in written]})
    if not terminal.wants_stdout():
        terminal.wrote(written)
        terminal.then("init", c=folder)


def ingest(
    sources: Annotated[
        list[Path], arg(None, "Run table first, where there is one; then logs, recordings or folders of them.")
    ],
    into: Annotated[Place, opt("CAMPAIGN", "Campaign folder to make.")] = None,
    mapping: Annotated[Place, opt("FILE", "TOML that names the columns.")] = None,
    describe: Annotated[bool, opt(None, "Describe the files and propose a mapping, as TOML.", "--describe")] = False,
    dry_run: Annotated[bool, opt(None, "Do everything but write.", "--dry-run")] = False,
) -> None:
    """Make a campaign out of raw lab files; the sources are hashed and left untouched.

    First 'calib ingest --describe FILE... > lab.toml': it lists the contents (sheets, header rows, topics, channels,
    units, time formats, overflowing counters) and proposes a mapping. Edit it, try it with --dry-run, and ingest. The
    mapping's sections [table] and [log] say which source column is which calib column, as a name (run_id = "Run no.")
    or with unit, factor and texts (distance_m = {column = "Distance", unit = "mm"}); log.file = "Run_{n:02}.csv" names
    a run's log; [cut] says how a continuous recording is cut into runs. All else goes into campaign.toml.

    Example: calib ingest export.xlsx logger/ --mapping lab.toml --into hall3
    """
    from calib.errors import BadInputError

    if describe:
        _describe(sources)
        return
    if into is None:
        raise BadInputError(
            "--into: found no campaign folder to make; expected one; give --into FOLDER, or --describe to look first"
        )
    from calib.campaign.ingest import build
    from calib.documents import plain

    with terminal.progress("reading") as tick:
        ingested = build.ingest(sources, into, mapping=mapping, force=terminal.forced(), dry_run=dry_run, progress=tick)
    document = {
        "campaign": str(ingested.folder),
        "n_runs": ingested.n_runs,
        "n_logs": ingested.n_logs,
        "written": not dry_run,
        "assumed": list(ingested.campaign.assumed),
        "sources": dict(ingested.sources),
        "cuts": plain(ingested.cuts),
        "notes": [{"level": note.level, "where": note.where, "text": note.text} for note in ingested.notes],
    }
    terminal.emit_json(document)
    if terminal.wants_stdout():
        return
    for note in build.merged_notes(ingested.notes):
        terminal.say(f"{note.where}: {note.text}")
    _say_cuts(ingested)
    end = "; nothing was written" if dry_run else ""
    terminal.say(f"{ingested.folder}: {ingested.n_runs} runs, {ingested.n_logs} logs{end}")
    terminal.then("ingest --dry-run" if dry_run else "ingest", c=ingested.folder)


def _describe(sources: list[Path]) -> None:
    from calib.campaign.ingest.describe import describe

    with terminal.waiting("looking"):
        description = describe(sources)
    terminal.emit_json(description.to_dict())
    if not terminal.wants_stdout():
        terminal.emit_text(description.to_toml())
        # standard output is the mapping alone
        terminal.then("ingest --describe", aside=True, sources=sources)


def _say_cuts(ingested: Ingested) -> None:
    if not ingested.cuts:
        return
    shown = ", ".join(f"{cut.run_id} {cut.start_s:.1f}-{cut.end_s:.1f} s" for cut in ingested.cuts[:_LISTED_RUNS])
    more = f" and {len(ingested.cuts) - _LISTED_RUNS} more" if len(ingested.cuts) > _LISTED_RUNS else ""
    terminal.say(f"Cut into runs: {shown}{more}.")


def check(
    campaign: Annotated[Path, arg(None, "Campaign folder (campaign.toml, runs.csv, logs), or a recording.")],
    strict: Annotated[bool, opt(None, "Exit status 1 on suspicious things, too.", "--strict")] = False,
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
    from calib.reporting.topics.runs import check_content

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
    measured = "check" if report.found.distance_m is not None else "check without distances"
    terminal.then("check wrong" if report.verdict == "wrong" else measured, c=campaign)
    return 1 if report.verdict == "wrong" or (strict and report.verdict != "sound") else 0
