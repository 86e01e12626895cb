"""``calib challenge``: a blind check of the diagnosis, on sealed cases and on the own data of a laboratory."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from calib.cli import terminal
from calib.cli.terminal import Place, arg, opt
from calib.documents import plain
from calib.errors import BadInputError

Folder = Annotated[Path, arg("DIR", "A set made by 'calib challenge make'.")]
Cases = Annotated[int | None, opt("N", "Only so many cases.", "--cases", min=1)]
Truth = Annotated[Place, opt("FILE", "The sealed truth; DIR.truth.json where not given.", "--truth")]


def make(
    seeds: Annotated[Path, opt("FILE", "Seeds file; see calib/challenge/seeds.")],
    into: Annotated[Path, opt("DIR", "Folder for the set.")],
    cases: Cases = None,
    truth: Truth = None,
    workers: terminal.Workers = 2,
) -> None:
    """Make sealed cases: first the truth, in one file apart whose hash is stored, then the campaigns.

    Example: calib challenge make --seeds calib/challenge/seeds/development.toml --into blind --cases 40
    """
    from calib.challenge.seal import make

    with terminal.progress("making") as tick:
        sealed_set = make(
            seeds,
            into,
            limit=cases,
            truth_file=truth,
            workers=workers,
            force=terminal.forced(),
            progress=tick,
            sealed=lambda digest: terminal.say(f"truth sealed, SHA-256 {digest}"),
        )
    terminal.say(f"{sealed_set.cases} cases in {sealed_set.folder}, truth apart in {sealed_set.truth}")
    terminal.then("challenge make", c=into)
    terminal.emit_json(plain(sealed_set))


def run(folder: Folder, cases: Cases = None, workers: terminal.Workers = 2, seed: terminal.Seed = 0) -> None:
    """Diagnose every case that has no verdict yet; the truth is not opened.

    Example: calib challenge run blind
    """
    from calib.challenge.run import run as run_set

    terminal.keep(f"the verdicts so far, in {folder}; the same command goes on")
    with terminal.progress("diagnosing") as tick:
        ran = run_set(folder, workers=workers, seed=seed, limit=cases, progress=tick)
    terminal.say(f"{ran.done} cases diagnosed, {ran.skipped} had a verdict already, {ran.failed} ended in an error")
    terminal.then("challenge run", c=folder)
    terminal.emit_json(plain(ran))


def score(
    folder: Folder,
    truth: Truth = None,
    plot: Annotated[Place, opt("FILE", "PNG, SVG or PDF; the confusion matrix goes beside it.")] = None,
) -> int:
    """Open the truth once, check its hash, and score the verdicts. Exit status 1 where a target is missed.

    Example: calib challenge score blind --plot blind.png --json blind-score.json
    """
    from calib.challenge.score import score as score_set
    from calib.reporting.topics.fleet import score_content

    beside = None if plot is None else plot.parent / f"{plot.stem}-confusion{plot.suffix}"
    terminal.refuse_outputs(plot, beside)
    scored = score_set(folder, truth_file=truth)
    terminal.show(score_content(scored))
    if plot is not None and beside is not None:
        from calib.reporting.figures.challenge import board_figure, confusion_figure, save

        save(board_figure(scored), plot, force=terminal.forced())
        save(confusion_figure(scored), beside, force=terminal.forced())
        terminal.wrote([plot, beside])
    terminal.then("challenge score", c=folder)
    terminal.emit_json(scored.to_dict())
    return 1 if any(scored.meets(line) is False for line in scored.board) else 0


def own(
    folder: Annotated[Path, arg("CAMPAIGN", "Folder with campaign.toml, runs.csv, logs.")],
    effects: Annotated[str | None, opt("A,B", "Effects to plant; all that the runs can show by default.")] = None,
    sizes: Annotated[
        str, opt("LIST", "10s: a signal of 10; 2x: twice the typical size; 0.01: in its unit.")
    ] = "5s,10s,25s",
    planted: Annotated[int, opt("N", "How often each.", min=1)] = 5,
    workers: terminal.Workers = 2,
    seconds: Annotated[float, opt("S", "Begin no diagnosis after so long.", min=1.0)] = 900.0,
    seed: terminal.Seed = 0,
) -> int:
    """Plant known effects on this campaign's own noise and route, and say what its data would find.

    Exit status 1 where false alarms, or wrong names, are surely more than one in twenty.

    Example: calib challenge own sample_runs/yard --effects track_width,temperature_radius --planted 3
    """
    from calib.campaign.read import read_campaign
    from calib.challenge.own_plants import parse_sizes
    from calib.challenge.own_runs import Asked, challenge_own
    from calib.reporting.topics.fleet import own_content

    names = tuple(name.strip() for name in (effects or "").split(",") if name.strip())
    if effects is not None and not names:
        raise BadInputError(f"--effects: found {effects!r}; expected effects with commas; 'calib effects' lists them")
    asked = Asked(names, parse_sizes(sizes), planted, workers, seconds, seed)
    campaign = read_campaign(folder)
    with terminal.progress("planting") as tick:
        own_score = challenge_own(campaign, asked, tick)
    if own_score.done < own_score.asked:
        terminal.note(
            f"{seconds:g} s were enough for {own_score.done} of {own_score.asked} diagnoses; for more, raise --seconds"
        )
    terminal.show(own_content(own_score))
    terminal.then("challenge own", c=folder)
    terminal.emit_json(own_score.to_dict())
    return 0 if own_score.trusted else 1
