"""Making a sealed set: first all truths, into one file apart whose hash is stored; then the campaigns."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final, TypeVar

from calib.campaign.tables import write_campaign
from calib.challenge.cases import Truth, campaigns_of, truth_of
from calib.challenge.recipe import read_seeds, recipes
from calib.documents import plain, to_json
from calib.errors import BadFileError, RefusedError, refuse_workers
from calib.fleet.workers import engine
from calib.io import refuse_existing, sha256_file, write_text
from calib.types import Progress, silent

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
