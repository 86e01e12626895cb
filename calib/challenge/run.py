"""Diagnosing every case of a set; the truth is never opened here."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from calib.campaign.model import Campaign
from calib.campaign.read import read_campaign
from calib.challenge.seal import each, read_public
from calib.errors import CalibError
from calib.files import inside, write_json

#: campaign, seed, effects to leave out, the fresh campaign of the same truth -> verdict and, where it can be had, what
#: the verdict's fix achieves on the fresh campaign
Diagnoser = Callable[[Campaign, int, tuple[str, ...], Campaign | None], tuple[dict[str, Any], dict[str, Any] | None]]


@dataclass(frozen=True, slots=True)
class Ran:
    """What a run did."""

    #: done, skipped, failed: cases diagnosed now, found diagnosed already, and ended by an error (written down as such)
    done: int
    skipped: int
    failed: int


def diagnose_and_try(
    campaign: Campaign, seed: int, exclude: tuple[str, ...], fresh: Campaign | None
) -> tuple[dict[str, Any], dict[str, Any] | None]:
    """Diagnose with the library's own diagnosis, and try its fix on the fresh campaign."""
    from calib.challenge.achieved import achieved
    from calib.gap.diagnose import diagnose_in_full as whole

    diagnosis = whole(campaign, seed=seed, exclude=exclude)
    return diagnosis.verdict.to_dict(), None if fresh is None else achieved(diagnosis, fresh, exclude)


def run_case(
    folder: Path, case: str, exclude: tuple[str, ...], seed: int, diagnoser: Diagnoser = diagnose_and_try
) -> bool:
    """Diagnose one case and write ``verdicts/<case>.json``; return whether it ended without an error.

    An error of the diagnosis is written down as such: it is a miss of the case, not an end of the run.

    Parameters
    ----------
    folder : Path
        The sealed set.
    case : str
        Name of the case.
    exclude : tuple of str
        Effects that the library is denied.
    seed : int
        Seed of the diagnosis.
    diagnoser : callable
        What diagnoses; calib's own diagnosis by default.
    """
    folder = Path(folder)
    place = inside(folder, f"cases/{case}", named_in=folder / "challenge.json", column=case)
    again = folder / "fresh" / case
    started = time.perf_counter()
    try:
        campaign = read_campaign(place)
        fresh = read_campaign(again) if again.is_dir() else None
        verdict, achieved = diagnoser(campaign, seed, exclude, fresh)
        document = {
            **verdict,
            "challenge": {"seconds": round(time.perf_counter() - started, 3), "achieved": achieved},
        }
        fine = True
    except Exception as error:
        what = "refused" if isinstance(error, CalibError) else type(error).__name__
        document = {
            "verdict": "error",
            "error": f"{what}: {error}",
            "challenge": {"seconds": None, "achieved": None},
        }
        fine = False
    write_json(folder / "verdicts" / f"{case}.json", document, force=True)
    return fine


def run(
    folder: Path,
    *,
    workers: int = 2,
    seed: int = 0,
    limit: int | None = None,
    diagnoser: Diagnoser | None = None,
    tick: Callable[[int, int], None] | None = None,
) -> Ran:
    """Diagnose the cases that have no verdict yet.

    Parameters
    ----------
    folder : Path
        A set made by `calib.challenge.seal.make`.
    workers : int
        Processes; 1 stays in this one.
    seed : int
        Of the diagnosis.
    limit : int, optional
        Only the first so many cases.
    diagnoser : callable, optional
        Instead of the library's own diagnosis; needs ``workers=1``.
    tick : callable, optional
        ``tick(done, total)``.
    """
    folder = Path(folder)
    cases = list(read_public(folder)["cases"].items())[:limit]
    waiting = [
        (case, tuple(entry["exclude"])) for case, entry in cases if not (folder / "verdicts" / f"{case}.json").exists()
    ]
    skipped = len(cases) - len(waiting)
    report = tick or (lambda _done, _total: None)
    report(skipped, len(cases))
    work = partial(_job, folder, seed, diagnoser or diagnose_and_try)
    alone = diagnoser is not None or not waiting
    fine = each(work, waiting, 1 if alone else workers, lambda done: report(skipped + done, len(cases)))
    return Ran(done=len(fine), skipped=skipped, failed=fine.count(False))


def _job(folder: Path, seed: int, diagnoser: Diagnoser, case: tuple[str, tuple[str, ...]]) -> bool:
    return run_case(folder, *case, seed, diagnoser)
