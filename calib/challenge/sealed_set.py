"""Sealed sets: first all truths, into one file apart whose hash is stored; then the campaigns; then their diagnoses.

Each fix is tried on a fresh campaign of the same truth, from a file that the diagnosis does not open.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

import numpy as np

from calib.campaign.model import Campaign
from calib.campaign.read import read_campaign
from calib.campaign.tables import write_campaign
from calib.challenge.cases import Truth, campaigns_of, truth_of
from calib.challenge.recipe import read_seeds, recipes
from calib.documents import plain, to_json
from calib.errors import BadFileError, CalibError, RefusedError, refuse_workers
from calib.fleet.workers import engine
from calib.io import inside, refuse_existing, sha256_file, write_json, write_text
from calib.types import FloatArray, Progress, silent

if TYPE_CHECKING:
    from calib.gap.decision.diagnosis import Diagnosis
    from calib.gap.effects.effect import Form
    from calib.gap.observations.arrays import Observations

PUBLIC: Final = "challenge.json"
HASH: Final = "truth.sha256"
_PUBLIC_FORMAT: Final = "calib-challenge/1"
TRUTH_FORMAT: Final = "calib-challenge-truth/1"

#: pieces of work that a case counts as beside the reading of a file: a batch has one
WEIGHT: Final = 64

T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True, slots=True)
class Sealed:
    """What was made."""

    folder: Path
    truth: Path
    sha256: str
    cases: int


def truth_path(folder: Path) -> Path:
    """Return where the truth of a set lies by default: beside its folder, not in it."""
    if folder.name in {"", ".."}:
        folder = Path(os.path.abspath(folder))  # noqa: PTH100  (a link to a set is not followed)
    return folder.parent / f"{folder.name}.truth.json"


def each(work: Callable[[T], R], items: Sequence[T], workers: int, tick: Callable[[int], None]) -> list[R]:
    """Return the work on each item, in order; `tick` gets how many are done."""
    refuse_workers(workers)
    results: dict[int, R] = {}
    numbered = list(enumerate(items))
    with engine(workers) as opened:
        for number, result in opened.run(partial(_worked, work), numbered, _died, lambda _item: WEIGHT):
            results[number] = result
            tick(len(results))
    return [results[number] for number in range(len(items))]


def _worked(work: Callable[[T], R], items: Sequence[tuple[int, T]]) -> list[tuple[int, R]]:
    return [(number, work(item)) for number, item in items]


def _died(item: tuple[int, T], why: str) -> tuple[int, R]:
    raise RefusedError(f"item {item[0] + 1}: {why}")


def _write_one(folder: Path, truth: Truth) -> None:
    digits = {"t_s": 3, "steer_rad": 4, "ref_x_m": 5, "ref_y_m": 5, "ref_theta_rad": 5}
    for kind, campaign in zip(("cases", "fresh"), campaigns_of(truth), strict=True):
        write_campaign(campaign, folder / kind / truth.recipe.case, force=True, log_decimals=digits)


def make(
    seeds_file: Path,
    folder: Path,
    *,
    limit: int | None = None,
    truth_file: Path | None = None,
    workers: int = 2,
    force: bool = False,
    progress: Progress = silent,
    sealed: Callable[[str], None] = lambda _digest: None,
) -> Sealed:
    """Make a sealed set of the first `limit` cases of a seeds file; see `truth_path` for where the truth goes.

    `folder` gets ``challenge.json``, ``truth.sha256``, ``cases/<case>`` and ``fresh/<case>`` (the same truth, driven
    again); `sealed` gets the hash as soon as the truth is sealed, before any campaign is driven. Raises BadInputError
    where a set stands there and `force` is False.
    """
    truth_file = truth_file or truth_path(folder)
    refuse_existing([folder / PUBLIC, truth_file], force=force)
    seeds = read_seeds(seeds_file)
    wanted = recipes(seeds, limit)
    draw = partial(truth_of, seed=seeds.seed, max_runs=seeds.max_runs)
    truths = each(draw, wanted, workers, lambda done: progress(done, len(wanted), "truths"))
    sealed_cases = {truth.recipe.case: plain(truth) for truth in truths}
    content = {"format": TRUTH_FORMAT, "purpose": seeds.purpose, "cases": sealed_cases}
    write_text(truth_file, to_json(content), force=force)
    digest = sha256_file(truth_file)
    write_text(folder / HASH, f"{digest}  {truth_file.name}\n", force=True)
    sealed(digest)
    each(partial(_write_one, folder), truths, workers, lambda done: progress(done, len(wanted), "campaigns"))
    cases = {recipe.case: {"exclude": [recipe.deleted] if recipe.deleted else []} for recipe in wanted}
    public = {"format": _PUBLIC_FORMAT, "purpose": seeds.purpose, "truth_sha256": digest, "cases": cases}
    write_text(folder / PUBLIC, to_json(public), force=True)
    return Sealed(folder, truth_file, digest, len(truths))


def read_public(folder: Path) -> Mapping[str, Any]:
    """Return what a set says openly: the truth's hash, the cases, and what is deleted from the library for each."""
    path = folder / PUBLIC
    try:
        if path.exists() and not path.is_file():
            raise OSError("no regular file")
        data: Mapping[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise BadFileError(path, str(error), "a set made by 'calib challenge make'", "make one first") from error
    if not isinstance(data, dict) or data.get("format") != _PUBLIC_FORMAT or not isinstance(data.get("cases"), dict):
        found = f"another format ({data.get('format') if isinstance(data, dict) else type(data).__name__})"
        raise BadFileError(path, found, _PUBLIC_FORMAT, "make the set again with this version")
    return data


#: what a fix achieves on a fresh campaign, by the keys of `achieved`
Achieved = dict[str, float | None]


def achieved(diagnosis: Diagnosis, fresh: Campaign, exclude: tuple[str, ...] = ()) -> Achieved | None:
    """Return the gap of a fresh campaign of the same truth under the model alone and under the fix, not refitted.

    ``before_rms_m``, ``after_rms_m`` of the end position (else of the distance); ``before_over_floor``,
    ``after_over_floor``, all channels against their noise; the closure ``fraction`` of whitened squares. None where the
    verdict names no cause, or a form of its causes cannot be had there.
    """
    from calib.gap.inference.fit import hypothesis_path, whitened_rows
    from calib.gap.observations.from_campaign import observations_of
    from calib.gap.predict import predict, residuals

    if not diagnosis.causes:
        return None
    there = observations_of(fresh)
    forms = _forms_there(diagnosis, there, fresh, exclude)
    if forms is None or len(there) != len(diagnosis.observations):
        return None
    nominal = predict(there)
    fixed = hypothesis_path(there, diagnosis.correction.calibration, forms, diagnosis.correction.theta, nominal)
    before, after = residuals(nominal, nominal), residuals(fixed, nominal)
    white = whitened_rows(nominal, diagnosis.noise, np.stack([before, after], axis=2))
    squares, floor = np.sum(white**2, axis=0), float(len(white))
    gap = float(squares[0]) - floor
    fraction = None if gap < 0.5 * floor else float(np.clip(1 - max(float(squares[1]) - floor, 0.0) / gap, -1.0, 1.0))
    norms = np.sqrt(squares / max(floor, 1.0))
    return {
        "before_rms_m": _rms(there, before),
        "after_rms_m": _rms(there, after),
        "before_over_floor": float(norms[0]),
        "after_over_floor": float(norms[1]),
        "fraction": fraction,
    }


def _forms_there(
    diagnosis: Diagnosis, there: Observations, fresh: Campaign, exclude: tuple[str, ...]
) -> tuple[Form, ...] | None:
    """Return the verdict's forms on another campaign, found again by effect, label and settings."""
    from calib.gap.effects.applied import matching_form
    from calib.gap.effects.library import library

    effects = {e.id: e for e in library(there, exclude=exclude, declared=fresh.extra.get("effects", ()))}
    matches = []
    for wanted in diagnosis.correction.forms:
        effect = effects.get(wanted.effect)
        offered = [] if effect is None else effect.forms(there)
        alike = [form for form in offered if len(form.parameters) == len(wanted.parameters)]
        nearest = matching_form(alike, wanted.label, wanted.settings)
        if nearest is None:
            return None
        # the fitted fix as it stands: zero where it was zero on the runs it was fitted to
        matches.append(nearest.centred_at(wanted.centre))
    return tuple(matches)


def _rms(there: Observations, values: FloatArray) -> float | None:
    pose = there.usable[:, 1] & there.usable[:, 2]
    if pose.any():
        return float(np.sqrt(np.mean(values[pose, 1] ** 2 + values[pose, 2] ** 2)))
    if there.usable[:, 0].any():
        return float(np.sqrt(np.mean(values[there.usable[:, 0], 0] ** 2)))
    return None


#: campaign, seed, effects to leave out, the fresh campaign of the same truth -> verdict and, where it can be had, what
#: the verdict's fix achieves on the fresh campaign
Diagnoser = Callable[[Campaign, int, tuple[str, ...], Campaign | None], tuple[Mapping[str, Any], Achieved | None]]


@dataclass(frozen=True, slots=True)
class Ran:
    """What a run did."""

    #: done, skipped, failed: cases diagnosed now, found diagnosed already, and ended by an error (written down as such)
    done: int
    skipped: int
    failed: int


def diagnose_and_try(
    campaign: Campaign, seed: int, exclude: tuple[str, ...], fresh: Campaign | None
) -> tuple[Mapping[str, Any], Achieved | None]:
    """Diagnose with the library's own diagnosis, and try its fix; see `Diagnoser`."""
    from calib.gap.diagnose import diagnose_in_full

    diagnosis = diagnose_in_full(campaign, seed=seed, exclude=exclude)
    return diagnosis.to_dict(), None if fresh is None else achieved(diagnosis, fresh, exclude)


def run_case(
    folder: Path, case: str, exclude: tuple[str, ...], seed: int, diagnoser: Diagnoser = diagnose_and_try
) -> bool:
    """Diagnose one case and write ``verdicts/<case>.json``; return whether it ended without an error; see `Diagnoser`.

    An error of the diagnosis is written down as such: it is a miss of the case, not an end of the run.
    """
    place = inside(folder, f"cases/{case}", named_in=folder / "challenge.json", column=case)
    again = folder / "fresh" / case
    started = time.perf_counter()
    try:
        campaign = read_campaign(place)
        verdict, gained = diagnoser(campaign, seed, exclude, read_campaign(again) if again.is_dir() else None)
        extra = {"seconds": round(time.perf_counter() - started, 3), "achieved": gained}
    except Exception as error:
        what = "refused" if isinstance(error, CalibError) else type(error).__name__
        verdict = {"verdict": "error", "error": f"{what}: {error}"}
        extra = {"seconds": None, "achieved": None}
    write_json(folder / "verdicts" / f"{case}.json", {**verdict, "challenge": extra}, force=True)
    return extra["seconds"] is not None


def run(
    folder: Path,
    *,
    workers: int = 2,
    seed: int = 0,
    limit: int | None = None,
    diagnoser: Diagnoser | None = None,
    progress: Progress = silent,
) -> Ran:
    """Diagnose the cases of a set (see `calib.challenge.seal.make`) that have no verdict yet, of the first `limit`.

    A `diagnoser` in place of the library's own runs in this process.
    """
    cases = list(read_public(folder)["cases"].items())[:limit]
    waiting = [
        (case, tuple(entry["exclude"])) for case, entry in cases if not (folder / "verdicts" / f"{case}.json").exists()
    ]
    skipped = len(cases) - len(waiting)
    progress(skipped, len(cases), "cases")
    work = partial(_job, folder, seed, diagnoser or diagnose_and_try)
    alone = diagnoser is not None or not waiting
    fine = each(work, waiting, 1 if alone else workers, lambda done: progress(skipped + done, len(cases), "cases"))
    return Ran(done=len(fine), skipped=skipped, failed=fine.count(False))


def _job(folder: Path, seed: int, diagnoser: Diagnoser, case: tuple[str, tuple[str, ...]]) -> bool:
    return run_case(folder, *case, seed, diagnoser)
