"""Which runs to drive next, best first, to separate confounded effects; plans and candidates from a file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from calib.campaign.checks.design import FEWEST_OF_A_LAW, sessions_of_loads
from calib.campaign.model import Campaign
from calib.campaign.read import CLOSED, GYRO_TURN
from calib.campaign.settings import OdometryModel
from calib.campaign.settings_file import load_toml, parse_settings
from calib.errors import PLANNED_RUNS, BadFileError, BadInputError, refuse_beyond
from calib.gap.effects.effect import Effect, Family
from calib.gap.effects.radii import AnySpeed, SpeedRadius
from calib.gap.effects.reference import ReferenceScale
from calib.gap.inference.fit import Fitted
from calib.gap.inference.noise import Noise
from calib.gap.observations.from_campaign import observations_of
from calib.gap.plan import planned_runs
from calib.gap.plan.identifiability import SEPARATION_SD, Signatures, fitted_sizes, noise_at
from calib.gap.plan.planned_runs import DEFAULT_CORRIDOR_M, Measured, PlannedRun, drive, joined, route_of
from calib.gap.predict import predict
from calib.types import FloatArray

#: runs to recommend: about an hour of driving
MOST_RUNS: Final = 5
#: effects or pairs named for a run: one line
MOST_NAMED: Final = 3
#: twice the separation needed: a margin for other sizes
ENOUGH_SD: Final = 2.0 * SEPARATION_SD
#: separation worth no further run
CAP_SD: Final = 4.0 * SEPARATION_SD
#: smallest gain worth naming, in standard deviations
NOTEWORTHY_SD: Final = 0.05
#: candidates weighed at once
AT_ONCE: Final = 16
#: runs of a route that show its scatter
REPEATS: Final = 3
#: recorded distances of corridors
CORRIDOR_RANGE_M: Final = (2.0, 500.0)


def next_runs(
    campaign: Campaign,
    effects: Sequence[Effect],
    noise: Noise,
    ties: Sequence[Sequence[str]] = (),
    fitted: Fitted | None = None,
    *,
    model: OdometryModel | None = None,
    candidates: Sequence[PlannedRun] | None = None,
    most: int = MOST_RUNS,
) -> list[PlannedRun]:
    """Return the runs to drive next, best first, with `why`, `distance` and `count`; empty where none helps.

    The runs are driven in one session that begins with a repeat of an unladen corridor run, those at another
    temperature in one of their own, and those of a route that was not repeated so far `REPEATS` times. Each greedy
    step takes the run after which the two nearest confounded effects are furthest apart; where none are confounded, the
    run after which most effects of the library are detected and separated. What the law of the load lacks comes after
    the former and before the latter; first comes a length beside a reference that alone measures any.

    `noise`: of `campaign`, with the scales of the next runs; `effects`: the library; `ties`: groups of confounded
    effects, the named one first; `fitted`: gives sizes, typical for others; `model`: the simulator's, by default the
    campaign's; `candidates`: see `default_candidates`; `most`: runs to recommend.
    """
    driven = campaign.included()
    if model is not None:
        driven = replace(driven, model=model)
    measured = _measured(driven)
    candidates = _candidates(driven, measured, ties) if candidates is None else candidates
    if not candidates:
        return []
    candidates = [replace(run, count=_count(driven, run)) for run in candidates]
    reference = _corridor_run(driven)
    planned = drive(driven, [reference, *candidates], measured, _corridor_m(driven))
    observations = observations_of(joined(driven, planned))
    path = predict(observations)
    sizes = fitted_sizes(observations, effects, fitted)
    directed = {effect.id for effect in effects if effect.family is Family.DIRECTION}
    if any(tie[0] in directed and SpeedRadius.id in tie for tie in ties):
        effects = [AnySpeed() if effect.id == SpeedRadius.id else effect for effect in effects]
    signatures = Signatures(path, noise_at(path, noise.scales), effects, sizes)
    run_id = observations.labels["run_id"].astype(str)
    # the reference run comes first
    names = [f"next{number:03d}" for number in range(len(candidates) + 1)]
    alone = signatures.gram(~np.char.startswith(run_id, "next"))
    base = alone + signatures.gram(run_id == names[0])
    grams = {
        number: run.count * signatures.gram(run_id == name)
        for number, (run, name) in enumerate(zip(candidates, names[1:], strict=True))
        if (run_id == name).any()
    }
    task = _Task(signatures, ties)
    chosen: list[PlannedRun] = []
    taped = any(ReferenceScale.id in tie for tie in ties) and not measured.distance
    # what 'calib fit' lacks follows the runs that tell confounded effects
    law = _of_law(driven, candidates)
    first, law = ([], law) if task.pairs else ([(n, _OF_LAW) for n in law[:1]], [])
    for number, why in [*first, *((n, _OF_SCALE) for n, run in enumerate(candidates) if taped and run.tape)][:most]:
        base = base + grams.pop(number, 0.0)
        chosen.append(replace(candidates[number], why=why))
    while len(chosen) < most - bool(law and most > 1) and grams and not task.done(before := task.distances(base)):
        after = task.distances_with(base, grams)
        best = max(after, key=lambda number: (task.score(after[number]), -number))
        if not (task.score(after[best]) > task.score(before) and task.gains(before, after[best])):
            break
        base = base + grams.pop(best)
        law, nearest = [] if best in law else law, float(after[best].min()) if task.pairs else None
        chosen.append(replace(candidates[best], why=task.why(before, after[best]), distance=nearest))
    before, then = task.distances(alone), task.distances(base)
    if not chosen and not task.done(before) and task.gains(before, then):
        chosen.append(replace(reference, why=task.why(before, then)))
    chosen += [replace(candidates[n], why=_OF_LAW) for n in law[: min(1, most - len(chosen))]]
    return [_stated(run, _corridor_m(driven), by_laser=measured.distance) for run in chosen]


def _stated(run: PlannedRun, corridor_m: float, *, by_laser: bool) -> PlannedRun:
    aside = _BY_TAPE * (run.tape and by_laser) + _OTHER_DAY * (run.session in planned_runs.OTHER_DAYS)
    return replace(run, why=run.why + aside, size=planned_runs.size_of(route_of(run.kind, corridor_m)))


_OF_LAW: Final = "for 'calib fit' alone, a second load on another day: it needs two sessions of two loads or more"
_OF_SCALE: Final = "a length by tape or laser (distance_m) tells radii and track from the scale of the reference"
_BY_TAPE: Final = "; the end's place by tape belongs in ref_x_m and ref_y_m"
_OTHER_DAY: Final = "; in a session of its own, on a day when the hall has that temperature"


def _candidates(driven: Campaign, measured: Measured, ties: Sequence[Sequence[str]]) -> list[PlannedRun]:
    tape = not (measured.distance or measured.position)
    loops = not (measured.position and measured.heading)
    candidates = planned_runs.default_candidates(driven, loops=loops, tape=tape)
    scaled = any(ReferenceScale.id in tie for tie in ties)
    if scaled if not measured.distance else not (measured.position and measured.beside):
        candidates.append(replace(_corridor_run(driven), tape=True))
    return candidates


def _corridor_run(driven: Campaign) -> PlannedRun:
    return PlannedRun("corridor", "out", temperature_C=planned_runs.usual_temperature_C(driven))


def _of_law(driven: Campaign, candidates: Sequence[PlannedRun]) -> list[int]:
    """Return the laden corridor runs, the largest payload first, where one session alone has several loads."""
    measured = np.isfinite(driven.runs.number("distance_m")).sum() >= FEWEST_OF_A_LAW
    if not measured or len(sessions_of_loads(driven)) != 1:
        return []
    laden = [number for number, run in enumerate(candidates) if run.kind == "corridor" and run.payload_kg > 0.0]
    return sorted(laden, key=lambda number: -candidates[number].payload_kg)


def with_next(campaign: Campaign, runs: Sequence[PlannedRun]) -> Campaign:
    """Return the runs driven and, as their model says, those of `next_runs` with the repeat before them."""
    driven = campaign.included()
    planned = [_corridor_run(driven), *(run for run in runs for _ in range(run.count))]
    return joined(driven, drive(driven, planned, _measured(driven), _corridor_m(driven)))


class _Task:
    def __init__(self, signatures: Signatures, ties: Sequence[Sequence[str]]) -> None:
        self.signatures = signatures
        number = {name: index for index, name in enumerate(signatures.names)}
        pairs = [pair for group in ties for pair in combinations(group, 2)]
        known = [(number[a], number[b]) for a, b in pairs if a in number and b in number]
        # radii and track are rivals together, not one of the three alone
        own = signatures.own_calibration
        self.pairs = [(b, a) if own[a] and not own[b] else (a, b) for a, b in known]
        self.truths = sorted({a for a, _ in self.pairs}) if self.pairs else list(range(len(signatures.names)))

    def distances(self, gram: FloatArray) -> FloatArray:
        """Return the distance of confounded pairs, else of effects from zero and nearest neighbour.

        `gram`: (..., n_columns, n_columns), scalar products; distances for each.
        """
        signal, distance = self.signatures.distances(gram, self.truths)
        if self.pairs:
            row = {truth: index for index, truth in enumerate(self.truths)}
            return np.stack([distance[..., row[a], b] for a, b in self.pairs], axis=-1)
        return np.asarray(np.minimum(signal, distance.min(axis=-1, initial=np.inf)))

    def distances_with(self, gram: FloatArray, added: Mapping[int, FloatArray]) -> dict[int, FloatArray]:
        numbers, after = list(added), dict[int, FloatArray]()
        for some in (numbers[first : first + AT_ONCE] for first in range(0, len(numbers), AT_ONCE)):
            after |= zip(some, self.distances(gram + np.stack([added[number] for number in some])), strict=True)
        return after

    def done(self, distances: FloatArray) -> bool:
        return bool((distances >= ENOUGH_SD).all())

    def score(self, distances: FloatArray) -> tuple[float, float]:
        capped = np.minimum(distances, CAP_SD)
        separated = float(np.minimum(distances / SEPARATION_SD, 1.0).sum())
        return round(float(capped.min()), 6) if self.pairs else separated, float(capped.sum())

    def gains(self, before: FloatArray, after: FloatArray) -> list[int]:
        order = np.argsort(-(np.minimum(after, CAP_SD) - np.minimum(before, CAP_SD)))[:MOST_NAMED]
        return [int(k) for k in order if after[k] > before[k] + NOTEWORTHY_SD]

    def why(self, before: FloatArray, after: FloatArray) -> str:
        names, gains = self.signatures.names, self.gains(before, after)
        if self.pairs:
            parts = []
            for k in gains:
                told = f"{names[self.pairs[k][0]]} from {names[self.pairs[k][1]]}"
                if after[k] < SEPARATION_SD:
                    parts.append(f"begins to tell {told} ({after[k]:.1f} of {SEPARATION_SD:g} standard deviations)")
                else:
                    parts.append(f"tells {told}{' more surely' if before[k] >= SEPARATION_SD else ''}")
            return ", ".join(parts)
        # what the runs before did not show
        new = [k for k in gains if before[k] < SEPARATION_SD]
        clear = [k for k in new if after[k] >= SEPARATION_SD]
        return f"shows {', '.join(names[self.truths[k]] for k in clear or new or gains)}{' better' * (not clear)}"


def _measured(campaign: Campaign) -> Measured:
    runs, logs = campaign.runs, campaign.logs
    front = logs.columns.get("counts_front")
    # a floor mark measures a closed loop
    open_path = runs.label("loop") != CLOSED
    by_laser, turned = np.isfinite(runs.number("distance_m")), np.isfinite(runs.number("ref_theta_rad"))
    # a place without a heading beside a laser's distance is a tape's
    placed = np.isfinite(runs.number("ref_x_m")) & (turned | ~by_laser)
    position = bool((placed & open_path).any()) or "ref_x_m" in logs.columns
    heading = bool((turned & open_path).any()) or "ref_theta_rad" in logs.columns
    beside = "ref_x_m" in logs.columns or not by_laser.any()
    return Measured(
        distance=bool(by_laser.any() or "range_m" in logs.columns),
        position=position,
        heading=heading,
        front=front is not None and bool(np.isfinite(front).any()),
        log=bool(logs.present.any()),
        gyro=bool(np.isfinite(runs.number(GYRO_TURN)).any()),
        beside=beside or bool(placed[by_laser].any()),
    )


def _count(campaign: Campaign, run: PlannedRun) -> int:
    runs = campaign.runs
    alike = (runs.label("kind") == run.kind) & ((runs.label("loop") == CLOSED) == (run.loop == CLOSED))
    if run.tape:
        alike &= np.isfinite(runs.number("ref_x_m" if _measured(campaign).distance else "distance_m"))
    return 1 if np.count_nonzero(alike) >= REPEATS else REPEATS


def _corridor_m(campaign: Campaign) -> float:
    distance = campaign.runs.number("distance_m")
    corridor = (campaign.runs.label("kind") == "corridor") & np.isfinite(distance)
    length = float(np.median(distance[corridor])) if corridor.any() else DEFAULT_CORRIDOR_M
    low, high = CORRIDOR_RANGE_M
    return length if low <= length <= high else DEFAULT_CORRIDOR_M


FORMAT: Final = "calib-plan/1"
#: sensors that drive the odometry without rear encoders -> what only a log has
_IN_LOG_ONLY: Final = {
    "front": "the front wheel and its angle",
    "wheels": "the counts of the four wheels",
    "shaft": "the steering angle",
}
#: beyond: a typing error
_Size = Annotated[float, Field(ge=-1e6, le=1e6)]
_NotNegative = Annotated[float, Field(ge=0.0, le=1e6)]


class _Strict(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False)


_Section = TypeVar("_Section", bound=_Strict)


class _MeasuredSection(_Strict):
    distance: bool = True
    poses: bool = True
    position: bool = False
    heading: bool = False
    front: bool = False
    log: bool = True
    gyro: bool = False
    corridor_m: float = Field(DEFAULT_CORRIDOR_M, ge=1.0, le=1000.0)


class _RunEntry(_Strict):
    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Annotated[float, Field(ge=-1e12, le=1e12)]]

    kind: str
    count: int = Field(1, ge=1)
    direction: Literal["", "out", "back"] = ""
    session: str = ""
    loop: Literal["", "closed"] = ""
    tape: bool = False
    payload_kg: _NotNegative = 0.0
    payload_x_m: _Size = 0.0
    payload_y_m: _Size = 0.0
    speed_mps: float = Field(0.5, ge=1e-3, le=1e6)
    temperature_C: _Size = 0.0
    minutes_under_load: _NotNegative = 0.0
    read_rolling: bool = False
    stops: int = Field(0, ge=0, le=100)

    def run(self) -> PlannedRun:
        columns = self.__pydantic_extra__
        return PlannedRun(**self.model_dump(exclude_unset=True, exclude={"count", *columns}), columns=columns)


def read_plan(path: Path) -> Campaign:
    """Return the campaign that a plan would give if the vehicle were exactly as its model.

    `path`: the plan: ``format = "calib-plan/1"``, the sections of ``campaign.toml``, ``[measured]`` with ``distance``,
    ``poses`` (or ``position``, ``heading`` alone), ``front``, ``log``, ``gyro`` (true or false) and ``corridor_m``, and
    ``[[runs]]``, each with ``kind``, where wanted ``count`` and the columns of the run table, ``stops``,
    ``read_rolling``, ``tape``.

    Raises
    ------
    BadFileError
        Where the file cannot be used.
    """
    document = _load(path)
    runs = _runs(document.pop("runs", None), path)
    section = document.pop("measured", {})
    measured = _validated(_MeasuredSection, section, path, "measured")
    position, heading = measured.poses or measured.position, measured.poses or measured.heading
    if not (measured.distance or position or heading or measured.gyro or any(run.loop or run.tape for run in runs)):
        raise _wrong(path, "measured", section, "distance, poses or gyro to be true, else nothing is measured")
    settings = parse_settings(document, str(path), path.stem)
    if settings.odometry.source in _IN_LOG_ONLY and not measured.log:
        only = _IN_LOG_ONLY[settings.odometry.source]
        raise _wrong(path, "measured.log", False, f"true: without a log there is no record of {only}")
    by = Measured(measured.distance, position, heading, measured.front, measured.log, measured.gyro)
    return drive(replace(settings, simulated=True), runs, by, measured.corridor_m)


def read_candidates(path: Path) -> list[PlannedRun]:
    """Return runs to choose from: a file with ``[[runs]]`` as in a plan, ``count`` unused."""
    return list({repr(run): run for run in _runs(_load(path).get("runs"), path)}.values())


def _load(path: Path) -> dict[str, Any]:
    document = load_toml(path, str(path))
    if (stated := document.pop("format", FORMAT)) != FORMAT:
        raise BadFileError(
            path, column="format", found=repr(stated)[:60], expected=repr(FORMAT), remedy="give a plan of runs"
        )
    return document


def _runs(section: object, path: Path) -> list[PlannedRun]:
    if not isinstance(section, list) or not section:
        raise _wrong(path, "runs", section, "one [[runs]] or more")
    runs: list[PlannedRun] = []
    for number, table in enumerate(section, start=1):
        where = f"runs[{number}]"
        entry = _validated(_RunEntry, table, path, where)
        remedy = "plan fewer, or judge the plan in parts"
        refuse_beyond(len(runs) + entry.count, PLANNED_RUNS, shown=str(path), what="runs", remedy=remedy, column=where)
        try:
            route_of(entry.kind)
        except BadInputError as error:
            expected = str(error).partition("expected ")[2].partition(";")[0]
            raise _wrong(path, f"{where}.kind", entry.kind, expected) from error
        runs += [entry.run()] * entry.count
    return runs


def _validated(kind: type[_Section], table: object, path: Path, where: str) -> _Section:
    if not isinstance(table, dict):
        raise _wrong(path, where, table, "a table")
    try:
        return kind.model_validate(table)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        column = ".".join([where, *(str(part) for part in first["loc"])])
        if first["type"] == "missing":
            raise _wrong(path, column, None, "a value") from error
        known = f"one of {', '.join(kind.model_fields)}" if first["type"] == "extra_forbidden" else ""
        raise _wrong(path, column, first["input"], known or first["msg"].removeprefix("Input should be ")) from error


def _wrong(path: Path, column: str, found: object, expected: str) -> BadFileError:
    shown = str(found).lower() if isinstance(found, bool) else repr(found)
    return BadFileError(path, column=column, found=shown[:60], expected=expected, remedy="correct the plan")
