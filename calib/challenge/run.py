"""Diagnose every case, and try each fix on a fresh campaign; the truth stays closed."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from calib.campaign.model import Campaign
from calib.campaign.read import read_campaign
from calib.challenge import each, read_public
from calib.errors import CalibError
from calib.gap.decision.diagnosis import Diagnosis
from calib.gap.decision.held_out import end_rms_m
from calib.gap.diagnose import diagnose_in_full
from calib.gap.effects import forms_on
from calib.gap.effects.library import library
from calib.gap.inference.fit import hypothesis_path, whitened_rows
from calib.gap.observations.from_campaign import observations_of
from calib.gap.predict import predict, residuals
from calib.io import inside, write_json
from calib.types import Progress, silent

Achieved = dict[str, float | None]


def achieved(diagnosis: Diagnosis, fresh: Campaign, exclude: tuple[str, ...]) -> Achieved | None:
    """Return the gap of a fresh campaign under the model alone and under the fix, not refitted.

    ``before_rms_m``, ``after_rms_m`` are of the end position (else of the distance), those ``over_floor`` of all
    channels over their noise, ``fraction`` of whitened squares. None where the verdict names no cause, or a form of its
    causes cannot be had there.
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
    """Diagnose the first `limit` cases of a set that have no verdict yet; see `calib.challenge.make`.

    A `diagnoser` runs in this process.
    """
    cases = list(read_public(folder)["cases"].items())[:limit]
    waiting = [
        (case, tuple(entry["exclude"])) for case, entry in cases if not (folder / "verdicts" / f"{case}.json").exists()
    ]
    skipped = len(cases) - len(waiting)
    progress(skipped, len(cases), "cases")
    work = partial(_run_case, folder, seed, diagnoser or _diagnose_and_try)
    alone = diagnoser is not None or not waiting
    fine = each(work, waiting, 1 if alone else workers, lambda done: progress(skipped + done, len(cases), "cases"))
    return Ran(done=len(fine), skipped=skipped, failed=fine.count(False))
