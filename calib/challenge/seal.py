"""Making a sealed set: first all truths, into one file apart whose hash is stored; then the campaigns."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final, TypeVar

from calib.campaign.write import write_campaign
from calib.challenge.cases import Truth, campaigns_of, truth_of
from calib.challenge.recipe import Recipe, read_seeds, recipes
from calib.documents import to_json
from calib.errors import BadFileError
from calib.io import refuse_existing, sha256_file, write_text
from calib.limits import refuse_workers

PUBLIC: Final = "challenge.json"
HASH: Final = "truth.sha256"
_PUBLIC_FORMAT: Final = "calib-challenge/1"
TRUTH_FORMAT: Final = "calib-challenge-truth/1"

Tick = Callable[[str, int, int], None]
T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True, slots=True)
class Sealed:
    """What was made."""

    folder: Path  #: the set
    truth: Path  #: the sealed file
    sha256: str  #: its hash
    cases: int  #: how many cases


def truth_path(folder: Path) -> Path:
    """Return where the truth of a set lies by default: beside its folder, not in it."""
    folder = Path(folder)
    return folder.with_name(folder.name + ".truth.json")


@contextmanager
def workers_of(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Give a pool of processes with one thread each."""
    refuse_workers(workers)
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(names, "1"))
    pool = ProcessPoolExecutor(max_workers=workers, mp_context=get_context("spawn"))
    try:
        yield pool
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    else:
        pool.shutdown()
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def each(work: Callable[[T], R], items: Sequence[T], workers: int, tick: Callable[[int], None]) -> list[R]:
    """Return the work on each item, in order; `tick` gets how many are done."""
    if workers <= 1:
        results = []
        for number, item in enumerate(items):
            results.append(work(item))
            tick(number + 1)
        return results
    with workers_of(workers) as pool:
        waiting = {pool.submit(work, item): number for number, item in enumerate(items)}
        by_place: dict[int, R] = {}
        for future in as_completed(waiting):
            by_place[waiting[future]] = future.result()
            tick(len(by_place))
    return [by_place[number] for number in range(len(items))]


def _draw_one(job: tuple[Recipe, int, int]) -> dict[str, Any]:
    return truth_of(*job).to_dict()


def _write_one(job: tuple[dict[str, Any], str]) -> str:
    data, folder = job
    truth = Truth.from_dict(data)
    campaign, fresh = campaigns_of(truth)
    case = truth.recipe.case
    digits = {"t_s": 3, "steer_rad": 4, "ref_x_m": 5, "ref_y_m": 5, "ref_theta_rad": 5}
    write_campaign(campaign, Path(folder) / "cases" / case, force=True, log_decimals=digits)
    if fresh is not None:
        write_campaign(fresh, Path(folder) / "fresh" / case, force=True, log_decimals=digits)
    return case


def make(
    seeds_file: Path,
    folder: Path,
    *,
    limit: int | None = None,
    truth_file: Path | None = None,
    workers: int = 2,
    force: bool = False,
    tick: Tick | None = None,
    sealed: Callable[[str], None] | None = None,
) -> Sealed:
    """Make a sealed set.

    Parameters
    ----------
    seeds_file : Path
        Which cases; see ``calib/challenge/seeds``.
    folder : Path
        Gets ``challenge.json``, ``truth.sha256``, ``cases/<case>`` and ``fresh/<case>`` (the same truth, driven again).
    limit : int, optional
        Only so many cases.
    truth_file : Path, optional
        Where the truth goes; beside the folder by default.
    workers : int
        Processes.
    force : bool
        Replace a set that stands there.
    tick : callable, optional
        ``tick(stage, done, total)``.
    sealed : callable, optional
        Gets the hash as soon as the truth is sealed, before any campaign is driven.

    Raises
    ------
    BadInputError
        Where a set stands there and `force` is False.
    """
    folder = Path(folder)
    truth_file = Path(truth_file) if truth_file else truth_path(folder)
    refuse_existing([folder / PUBLIC, truth_file], force=force)
    seeds = read_seeds(seeds_file)
    wanted = recipes(seeds, limit)
    report: Tick = tick or (lambda _stage, _done, _total: None)
    truths = each(
        _draw_one,
        [(item, seeds.seed, seeds.max_runs) for item in wanted],
        workers,
        lambda done: report("truths", done, len(wanted)),
    )
    content = {
        "format": TRUTH_FORMAT,
        "purpose": seeds.purpose,
        "cases": {item["recipe"]["case"]: item for item in truths},
    }
    write_text(truth_file, to_json(content), force=force)
    digest = sha256_file(truth_file)
    write_text(folder / HASH, f"{digest}  {truth_file.name}\n", force=True)
    if sealed is not None:
        sealed(digest)
    each(
        _write_one,
        [(item, str(folder)) for item in truths],
        workers,
        lambda done: report("campaigns", done, len(wanted)),
    )
    public = {
        "format": _PUBLIC_FORMAT,
        "purpose": seeds.purpose,
        "truth_sha256": digest,
        "cases": {
            item["recipe"]["case"]: {"exclude": [item["recipe"]["deleted"]] if item["recipe"]["deleted"] else []}
            for item in truths
        },
    }
    write_text(folder / PUBLIC, to_json(public), force=True)
    return Sealed(folder, truth_file, digest, len(truths))


def read_public(folder: Path) -> dict[str, Any]:
    """Return what a set says openly: the truth's hash, the cases, and what is deleted from the library for each."""
    path = Path(folder) / PUBLIC
    try:
        data: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise BadFileError(
            path, found=str(error), expected="a set made by 'calib challenge make'", remedy="make one first"
        ) from error
    if not isinstance(data, dict) or data.get("format") != _PUBLIC_FORMAT or not isinstance(data.get("cases"), dict):
        raise BadFileError(
            path,
            found=f"another format ({data.get('format') if isinstance(data, dict) else type(data).__name__})",
            expected=_PUBLIC_FORMAT,
            remedy="make the set again with this version",
        )
    return data
