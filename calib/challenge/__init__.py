"""A blind check of the diagnosis: sealed cases, a runner that never opens the truth, a score."""

import json
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeVar, get_args

import numpy as np
from pydantic import Field, TypeAdapter, ValidationError

from calib.campaign import write_campaign
from calib.campaign.model import Campaign
from calib.campaign.read import read_campaign
from calib.campaign.settings_file import load_toml
from calib.challenge.cases import UNSIGNED, Recipe, Truth, campaigns_of, truth_of
from calib.documents import plain
from calib.errors import CASES, BadFileError, CalibError, RefusedError, refuse_beyond, refuse_workers
from calib.fleet.workers import engine
from calib.gap.decision.diagnosis import Diagnosis
from calib.gap.decision.held_out import end_rms_m
from calib.gap.diagnose import diagnose_in_full
from calib.gap.effects import forms_on
from calib.gap.effects.library import library
from calib.gap.inference.fit import hypothesis_path, whitened_rows
from calib.gap.observations.from_campaign import observations_of
from calib.gap.predict import predict, residuals
from calib.io import inside, refuse_existing, sha256_file, write_json, write_text
from calib.plant.design import DESIGNS
from calib.plant.effects import ALL, forms_of
from calib.plant.signal import CALIBRATION
from calib.types import Progress, silent

Group = Literal["empty", "calibration", "single", "natural", "pair", "outside", "alias", "deleted", "crowded"]
GROUPS: Final[tuple[Group, ...]] = get_args(Group)
SIGNALS: Final = (3.0, 5.0, 10.0, 25.0)
_FORMAT: Final = "calib-challenge-seeds/1"
_EXPECTED: Final = f"a whole number as seed, max_runs of 20 or more, and in [cases] counts of {', '.join(GROUPS)}"
_REMEDY: Final = "see calib challenge make --help and the manual's page on challenges"

_OUTSIDE: Final = [form.effect for form in ALL if form.effect.startswith("outside:")]
#: for pairs: effects that leave different things behind
_PAIRED: Final = (
    "load_radius", "temperature_radius", "speed_radius", "travel_direction", "curve_scrub", "load_dependent_track",
    "rangefinder_scale", "reference_yaw", "lost_counts", "payload_position", "rear_drag", "wear", "load_creep",
    "reference_lever_arm", "session_step", "curve_load_transfer",
)  # fmt: skip

#: exact aliases: truth, design, and what it cannot be told from there
_ALIASES: Final[tuple[tuple[str, str, tuple[str, ...]], ...]] = (
    ("radius_scale", "laser_only", ("rangefinder_scale", "beam_misalignment")),
    ("rangefinder_scale", "laser_only", ("radius_scale", "beam_misalignment")),
    ("beam_misalignment", "good", ("rangefinder_scale",)),
    ("lost_counts/constant", "good", ("unequal_radii", "radius_scale")),
    ("load_radius", "load_a_session", ("session_step",)),
    ("travel_direction", "corridor_only", ("floor_slope",)),
    ("floor_slope", "corridor_only", ("travel_direction",)),
)


@dataclass(frozen=True, slots=True)
class Seeds:
    """A seeds file."""

    purpose: str  #: ``development``, ``scoring`` or ``ci``
    seed: Annotated[int, Field(strict=True, ge=0)]
    cases: dict[Group, Annotated[int, Field(strict=True, ge=0)]]
    max_runs: Annotated[int, Field(strict=True, ge=20)] = 160


def read_seeds(path: Path) -> Seeds:
    """Read a seeds file; raises BadFileError."""
    data = load_toml(path, str(path), remedy=_REMEDY)
    if data.pop("format", None) != _FORMAT:
        raise BadFileError(path, column="format", found="another format", expected=_FORMAT, remedy=_REMEDY)
    try:
        seeds = TypeAdapter(Seeds).validate_python({"purpose": "", **data})
    except ValidationError as error:
        first = error.errors()[0]
        where, actual = ".".join(str(part) for part in first["loc"] if part != "[key]"), f"{first['input']!r:.80}"
        raise BadFileError(path, actual, _EXPECTED, _REMEDY, column=where) from error
    total = sum(seeds.cases.values())
    refuse_beyond(total, CASES, shown=str(path), what="cases", remedy="make several sets", column="cases")
    return seeds


def _library() -> list[str]:
    known = (form.effect for form in ALL if form.effect not in (*CALIBRATION, *UNSIGNED))
    names = dict.fromkeys(name for name in known if not name.startswith("outside:"))
    covariates = [name for name in names if name.startswith("covariate:")]
    return [name for name in names if name not in covariates[1:]]


def _singles(count: int, rng: np.random.Generator) -> list[tuple[str, float]]:
    faults = [(f"{form.effect}/{form.form}", float("nan")) for name in UNSIGNED for form in forms_of(name)]
    strong: list[tuple[str, float]] = []
    for turn, signal in enumerate((*SIGNALS, 10.0, 25.0)):
        for place, name in enumerate(_library()):
            forms = [item.form for item in forms_of(name) if (name, item.form) != ("lost_counts", "constant")]
            strong.append((f"{name}/{forms[(turn + place) % len(forms)]}", signal))
    if count < len(strong) + len(faults):
        names = [str(item) for item in rng.permutation(_library())]
        return [(names[n % len(names)], (10.0, 25.0, 25.0, 10.0, 5.0, 3.0)[n % 6]) for n in range(count)]
    whole = strong + faults
    return [whole[number % len(whole)] for number in range(count)]


def _of_group(group: Group, count: int, rng: np.random.Generator) -> list[Recipe]:
    case = partial(Recipe, "", 0, group)
    if group == "single":
        return [case((name,), (signal,)) for name, signal in _singles(count, rng)]
    names = [*_library(), *CALIBRATION] if group == "deleted" else _library()
    if group == "natural" or (group == "deleted" and count < len(names)):
        names = list(map(str, rng.permutation(names)))

    def made(n: int) -> Recipe:
        name = names[n % len(names)]
        if group == "empty":
            return case(design="good" if n % 5 < 3 else DESIGNS[(n // 5 * 2 + n % 5 - 3) % 4])
        if group == "calibration":
            return case((CALIBRATION[n % 3],), ((5.0, 10.0, 25.0, 100.0, 250.0)[n // 3 % 5],))
        if group == "natural":
            return case((name,), (float("nan"),))
        if group == "pair":
            pair = tuple(map(str, rng.choice(_PAIRED, 2, replace=False)))
            return case(pair, ((15.0, 15.0), (25.0, 12.0))[n % 2])
        if group == "outside":
            return case((_OUTSIDE[n % len(_OUTSIDE)],), ((25.0, 10.0)[n // len(_OUTSIDE) % 2],))
        if group == "alias":
            effect, design, others = _ALIASES[n % len(_ALIASES)]
            return case((effect,), ((25.0, 12.0)[n // len(_ALIASES) % 2],), design, others)
        if group == "crowded":
            return case(*_crowd(n, rng))
        return case((name,), (25.0,), deleted=name)

    return [made(n) for n in range(count)]


def _crowd(number: int, rng: np.random.Generator) -> tuple[tuple[str, ...], tuple[float, ...]]:
    drawn = rng.choice([*_PAIRED, "unequal_radii", "track_width"], 3 + number % 4, replace=False)
    signals = np.exp(rng.uniform(np.log(5.0), np.log(100.0), len(drawn)))
    targets = (*(round(float(signal), 1) for signal in signals), float(rng.choice([5.0, 10.0, 15.0])))
    return (*map(str, drawn), _OUTSIDE[number % len(_OUTSIDE)]), targets


def recipes(seeds: Seeds, limit: int | None = None) -> list[Recipe]:
    """Return the first `limit` cases of a seeds file, shuffled: names say nothing."""
    listed: list[Recipe] = []
    for number, group in enumerate(GROUPS):
        listed += _of_group(group, seeds.cases.get(group, 0), np.random.default_rng([seeds.seed, number]))
    order = np.random.default_rng([seeds.seed, 999]).permutation(len(listed))
    return [replace(listed[int(n)], case=f"c{place + 1:04d}", number=int(n)) for place, n in enumerate(order[:limit])]


PUBLIC: Final = "challenge.json"
HASH: Final = "truth.sha256"
_PUBLIC_FORMAT: Final = "calib-challenge/1"
TRUTH_FORMAT: Final = "calib-challenge-truth/1"

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
    """Return where the truth of a set lies by default: beside its folder."""
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
    limit: int | None = None,
    truth_file: Path | None = None,
    *,
    workers: int = 2,
    force: bool = False,
    progress: Progress = silent,
    sealed: Callable[[str], None] = lambda _digest: None,
) -> Sealed:
    """Make a sealed set of the first `limit` cases of a seeds file; see `truth_path`.

    `sealed` gets the hash before any campaign is driven.
    """
    truth_file = truth_file or truth_path(folder)
    refuse_existing([folder / PUBLIC, truth_file], force=force)
    seeds = read_seeds(seeds_file)
    wanted = recipes(seeds, limit)
    draw = partial(truth_of, seed=seeds.seed, max_runs=seeds.max_runs)
    truths = each(draw, wanted, workers, lambda done: progress(done, len(wanted), "truths"))
    sealed_cases = {truth.recipe.case: plain(truth) for truth in truths}
    content = {"format": TRUTH_FORMAT, "purpose": seeds.purpose, "cases": sealed_cases}
    write_json(truth_file, content, force=force)
    digest = sha256_file(truth_file)
    write_text(folder / HASH, f"{digest}  {truth_file.name}\n", force=True)
    sealed(digest)
    each(partial(_write_one, folder), truths, workers, lambda done: progress(done, len(wanted), "campaigns"))
    cases = {recipe.case: {"exclude": [recipe.deleted] if recipe.deleted else []} for recipe in wanted}
    public = {"format": _PUBLIC_FORMAT, "purpose": seeds.purpose, "truth_sha256": digest, "cases": cases}
    write_json(folder / PUBLIC, public, force=True)
    return Sealed(folder, truth_file, digest, len(truths))


def read_public(folder: Path) -> Mapping[str, Any]:
    """Return what a set says openly; see `make`."""
    path = folder / PUBLIC
    try:
        if path.exists() and not path.is_file():
            raise OSError("no regular file")
        data: Mapping[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        actual = getattr(error, "strerror", None) or str(error)
        raise BadFileError(path, actual, "a set made by 'calib challenge make'", "make one first") from error
    if not isinstance(data, dict) or data.get("format") != _PUBLIC_FORMAT or not isinstance(data.get("cases"), dict):
        actual = f"another format ({data.get('format') if isinstance(data, dict) else type(data).__name__})"
        raise BadFileError(path, actual, _PUBLIC_FORMAT, "make the set again with this version")
    return data


Achieved = dict[str, float | None]


def achieved(diagnosis: Diagnosis, fresh: Campaign, exclude: tuple[str, ...]) -> Achieved | None:
    """Return the gap of a fresh campaign under the model alone and under the fix, not refitted.

    ``..._rms_m`` are of the end position (else the distance), ``..._over_floor`` of all channels over their noise,
    ``fraction`` of whitened squares. None where no cause is named, or a form of one cannot be had there.
    """
    if not diagnosis.causes:
        return None
    observations = observations_of(fresh)
    effects = {e.id: e for e in library(observations, exclude=exclude, declared=fresh.extra.get("effects", ()))}
    forms = [form for form in forms_on(observations, effects, diagnosis.correction.forms) if form is not None]
    if len(forms) < len(diagnosis.correction.forms) or len(observations) != len(diagnosis.observations):
        return None
    nominal = predict(observations)
    fixed = hypothesis_path(observations, diagnosis.correction.calibration, forms, diagnosis.correction.theta, nominal)
    before, after = residuals(nominal, nominal), residuals(fixed, nominal)
    white = whitened_rows(nominal, diagnosis.noise, np.stack([before, after], axis=2))
    squares, floor = np.sum(white**2, axis=0), float(len(white))
    gap = float(squares[0]) - floor
    fraction = None if gap < 0.5 * floor else float(np.clip(1 - max(float(squares[1]) - floor, 0.0) / gap, -1.0, 1.0))
    norms = np.sqrt(squares / max(floor, 1.0))
    return {
        "before_rms_m": end_rms_m(before, observations),
        "after_rms_m": end_rms_m(after, observations),
        "before_over_floor": float(norms[0]),
        "after_over_floor": float(norms[1]),
        "fraction": fraction,
    }


#: campaign, seed, effects to exclude, fresh campaign -> verdict, what its fix achieves there
Diagnoser = Callable[[Campaign, int, tuple[str, ...], Campaign | None], tuple[Mapping[str, Any], Achieved | None]]


@dataclass(frozen=True, slots=True)
class Ran:
    """Cases diagnosed now, before, and failed."""

    done: int
    skipped: int
    failed: int


def _diagnose_and_try(
    campaign: Campaign, seed: int, exclude: tuple[str, ...], fresh: Campaign | None
) -> tuple[Mapping[str, Any], Achieved | None]:
    diagnosis = diagnose_in_full(campaign, seed=seed, exclude=exclude)
    return diagnosis.to_dict(), None if fresh is None else achieved(diagnosis, fresh, exclude)


def _run_case(folder: Path, seed: int, diagnoser: Diagnoser, waiting: tuple[str, tuple[str, ...]]) -> bool:
    case, exclude = waiting
    place = inside(folder, f"cases/{case}", named_in=folder / PUBLIC, column=case)
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
    """Diagnose the first `limit` cases of a set that have no verdict yet; see `make`.

    A `diagnoser` runs in this process.
    """
    cases = list(read_public(folder)["cases"].items())[:limit]
    made = folder / "verdicts"
    waiting = [(case, tuple(entry["exclude"])) for case, entry in cases if not (made / f"{case}.json").exists()]
    skipped = len(cases) - len(waiting)
    progress(skipped, len(cases), "cases")
    work = partial(_run_case, folder, seed, diagnoser or _diagnose_and_try)
    alone = diagnoser is not None or not waiting
    fine = each(work, waiting, 1 if alone else workers, lambda done: progress(skipped + done, len(cases), "cases"))
    return Ran(done=len(fine), skipped=skipped, failed=fine.count(False))
