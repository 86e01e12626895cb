"""Which runs to drive next, best first, to separate confounded effects; plans and candidates from a file."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from pathlib import Path as FilePath
from typing import Annotated, Any, Final, Literal, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from calib.campaign.checks import FEWEST_OF_A_LAW, columns_as_one, sessions_of_loads
from calib.campaign.model import Campaign
from calib.campaign.read import CLOSED, GYRO_TURN
from calib.campaign.settings_file import load_toml, parse_settings
from calib.campaign.wheels import odometry_source
from calib.coefficients.sections import first_fault
from calib.errors import PLANNED_RUNS, BadFileError, BadInputError, refuse_beyond
from calib.gap.effects import Effect
from calib.gap.effects.quantities import driven_speed_mps
from calib.gap.effects.reference import ReferenceScale
from calib.gap.inference import FORM_ERROR
from calib.gap.inference.noise import Noise
from calib.gap.observations.from_campaign import observations_of
from calib.gap.plan import ENOUGH_SD, Apart, Signatures, Task, noise_at, planned_runs, tied, untied
from calib.gap.plan.planned_runs import DEFAULT_CORRIDOR_M, Dimensions, Measured, PlannedRun, drive, joined, route_of
from calib.gap.predict import Path, predict
from calib.odometry.routes import Route
from calib.types import FloatArray

#: recorded distances of corridors
CORRIDOR_RANGE_M: Final = (0.1, 500.0)
#: track of the vehicles that routes are made for, from half to twice as much
USUAL_TRACK_M: Final = 0.7
#: least radius of a car's turn over its wheelbase: at a steering angle of 34 degrees
LEAST_RADIUS: Final = 1.5
#: slow over fast at most: else one speed was driven
SLOWER: Final = 0.7
#: of the fastest: slower runs turn on the spot
LEAST_SPEED: Final = 0.25
#: runs to recommend: about an hour of driving
MOST_RUNS: Final = 5
#: runs of a route that show its scatter
REPEATS: Final = 3


def dimensions_of(driven: Campaign) -> Dimensions:
    """Return what the vehicle of a campaign can drive where it was driven.

    Corridors as long as those driven, else no longer than any run led; other routes in proportion to the track or, up
    to the usual size, to how far any run led; no faster than it was driven.
    """
    path = predict(observations_of(driven, into_windows=False))
    led_m = [np.hypot(*trace[:, :2].T).max() for trace in path.traces()]
    most_m, ratio = float(np.max(led_m, where=path.s.from_log, initial=0.0)), driven.model.track_m / USUAL_TRACK_M
    scale = 1.0 if 0.5 <= ratio <= 2.0 else ratio
    distance_m, corridor = np.abs(driven.runs.number("distance_m")), driven.runs.label("kind") == "corridor"
    known = np.isfinite(distance_m)
    lengths_m = distance_m[known & corridor] if (known & corridor).any() else distance_m[known]
    length_m = float(np.median(lengths_m)) if len(lengths_m) else 0.0
    if not CORRIDOR_RANGE_M[0] <= length_m <= CORRIDOR_RANGE_M[1]:
        length_m = min(DEFAULT_CORRIDOR_M, max(most_m, DEFAULT_CORRIDOR_M * scale))
    speeds = driven_speed_mps(path.s)
    speeds = speeds[speeds > LEAST_SPEED * np.nanmax(speeds, initial=0.0)]
    slow, fast = np.quantile(speeds, (0.1, 0.9)).tolist() if len(speeds) else (0.3 * scale, 0.7 * scale)
    least_m = LEAST_RADIUS * driven.vehicle.wheelbase_m * (odometry_source(driven) == "shaft")
    return Dimensions(
        length_m, scale, most_m, least_m, (float(f"{min(slow, SLOWER * fast):.2g}"), float(f"{fast:.2g}"))
    )


def size_of(route: Route) -> str:
    """Return a route's straights and radii of bends in words."""
    pieces = list(zip(np.abs(route.length_m).tolist(), np.abs(route.turn_rad).tolist(), strict=True))
    straights = ", ".join(dict.fromkeys(f"{length:.3g}" for length, turn in pieces if not turn))
    radii = ", ".join(dict.fromkeys(f"{length / turn:.3g}" for length, turn in pieces if turn))
    return f"{straights} m" * bool(straights) + " and " * bool(straights and radii) + f"radius {radii} m" * bool(radii)


def next_runs(
    campaign: Campaign,
    effects: Sequence[Effect],
    noise: Noise,
    ties: Sequence[Sequence[str]] = (),
    *,
    apart_on: Callable[[Path, Noise, Collection[str]], Apart] | None = None,
    candidates: Sequence[PlannedRun] | None = None,
    most: int = MOST_RUNS,
) -> list[PlannedRun]:
    """Return the runs to drive next, best first, with `why`, `distance` and `count`; empty where none helps.

    Each step takes the run that parts the two nearest confounded effects most, else most effects of the library; those
    at another temperature are a session of their own.

    `noise`: of `campaign`, with the scales of the next runs; `effects`: the library; `ties`: groups of confounded
    effects; `apart_on`: how far those are on other runs; `candidates`: see `default_candidates`; `most`: runs to name.
    """
    driven = campaign.included()
    measured, dimensions = _measured(driven), dimensions_of(driven)
    if not (candidates := _candidates(driven, measured, dimensions, ties) if candidates is None else candidates):
        return []
    # the unladen run comes first; one repeat more shows the noise
    extra, unladen = int(noise.dof <= 0.0), _corridor_run(driven, dimensions)
    unladen = replace(unladen, tape=not (measured.distance or measured.position), count=1 + extra * REPEATS)
    runs = [unladen, *(replace(run, count=_count(driven, run) + extra) for run in candidates)]
    observations = observations_of(joined(driven, drive(driven, runs, measured, dimensions)))
    path = predict(observations)
    noise, names = noise_at(path, noise.scales), [f"next{number:03d}" for number in range(len(runs))]
    number = np.array([names.index(name) if name in names else -1 for name in observations.labels["run_id"]])
    counts = np.array([run.count for run in runs])
    task = None
    if ties and apart_on is not None:
        task = tied(apart_on(path, noise, {name for tie in ties for name in tie}), number, counts, ties)
    if task is None or not task.names:
        task = untied(Signatures(path, noise, effects), number, counts)
    taped = any(ReferenceScale.id in tie for tie in ties) and not measured.distance
    # what 'calib fit' lacks follows the runs that tell confounded effects
    measured_runs = np.isfinite(driven.runs.number("distance_m")).sum()
    law = _laden(runs) if measured_runs >= FEWEST_OF_A_LAW and len(sessions_of_loads(driven)) == 1 else []
    first = {} if task.tied else dict.fromkeys(law[:1], _OF_LAW)
    first |= dict.fromkeys(_of_one_way(driven, runs), _BOTH_WAYS)
    first |= {n: _OF_SCALE for n, run in enumerate(runs) if taped and run.tape}
    chosen = [0, *list(first)[:most]]
    left = set(number[number > 0].tolist()).difference(chosen)
    while len(chosen) <= most - bool(task.tied and law and most > 1) and left:
        numbers = sorted(left)
        before, *after = task.of([chosen, *([*chosen, n] for n in numbers)])
        best = _best(task, after, [runs[n] for n in numbers], dimensions.speeds_mps[1])
        enough, gained = (before >= ENOUGH_SD).all(), task.score(after[best]) > task.score(before)
        if enough or not (gained and task.gains(before, after[best])):
            break
        chosen.append(numbers[best])
        left.remove(numbers[best])
    later = law[: min(1, most + 1 - len(chosen))] if task.tied and not set(law).intersection(chosen) else []
    kept = {*first, 0} if later or set(first.values()) & {_OF_LAW, _BOTH_WAYS} else {*first}
    chosen, beside = _needed(task, chosen, kept, most - len(later) * (most != 2))
    later = later[: most - len(chosen)]
    if task.tied and len(chosen) < most and _all_new(driven, [runs[n] for n in (0, *chosen, *later)]):
        chosen, runs[0] = [*chosen, 0], replace(unladen, count=1)
    proposed, steps = list[PlannedRun](), task.of([[*beside, *chosen[:place]] for place in range(len(chosen) + 1)])
    for n, before, after in zip(chosen, steps, steps[1:], strict=False):
        why = "; ".join(filter(None, (first.get(n, ""), task.why(before, after, steps[-1])))) or _BESIDE
        why += _ONE_MORE * bool(beside and n == chosen[0])
        proposed.append(replace(runs[n], why=why, distance=float(after.min()) if task.tied else None))
    proposed += [replace(runs[n], why=_OF_LAW) for n in later]
    runs = sorted(proposed, key=lambda run: run.why == _BESIDE)
    return [_stated(run, dimensions, by_laser=measured.distance) for run in runs]


def _all_new(driven: Campaign, runs: Sequence[PlannedRun]) -> bool:
    # but the first: new routes alone could be a step of the session
    known, *new = [_count(driven, replace(run, tape=False)) == 1 for run in runs]
    return known and bool(new) and not any(new)


def _best(task: Task, after: Sequence[FloatArray], runs: Sequence[PlannedRun], usual_mps: float) -> int:
    best = max(range(len(after)), key=lambda k: (task.score(after[k]), -k))
    usual, least = replace(runs[best], speed_mps=usual_mps), (1.0 - FORM_ERROR) * after[best]
    alike = (k for k, run in enumerate(runs) if task.tied and run == usual and (after[k] >= least).all())
    return next(alike, best)


def _needed(task: Task, chosen: list[int], kept: Collection[int], most: int) -> tuple[list[int], list[int]]:
    for n in reversed(chosen):
        others = [other for other in chosen if other != n]
        if n not in kept and (task.tied or n == 0) and task.told(others) >= task.told(chosen):
            chosen = others
    if len(chosen) <= most:
        return chosen, []
    # the last tells least; the unladen alone tells no causes apart
    spare = [n for n in chosen if n not in kept] if most > 1 or not task.tied else []
    out = spare[-1] if spare else chosen[0]
    others = [n for n in chosen if n != out]
    return others, [0] * (out == 0 and (0 in kept or task.told(others) < task.told(chosen)))


def _stated(run: PlannedRun, dimensions: Dimensions, *, by_laser: bool) -> PlannedRun:
    aside = _BY_TAPE * (run.tape and by_laser) + _OTHER_DAY * (run.session in planned_runs.OTHER_DAYS)
    return replace(run, why=run.why + aside, size=size_of(route_of(run.kind, dimensions)))


_OF_LAW: Final = "for 'calib fit' alone, a second load on another day: it needs two sessions of two loads or more"
_OF_SCALE: Final = "a length by tape or laser (distance_m) tells radii and track from the scale of the reference"
_BY_TAPE: Final = "; the end's place by tape belongs in ref_x_m and ref_y_m"
_BOTH_WAYS: Final = "drive each load both ways: load and direction changed together, which tells nothing of either"
_BESIDE: Final = "the same session without load, for the others to be compared with"
_ONE_MORE: Final = ", beside the same session without load: one run more"
_OTHER_DAY: Final = "; in a session of its own, on a day when the hall has that temperature"


def _candidates(
    driven: Campaign, measured: Measured, dimensions: Dimensions, ties: Sequence[Sequence[str]]
) -> list[PlannedRun]:
    tape = not (measured.distance or measured.position)
    loops = not (measured.position and measured.heading)
    candidates = planned_runs.default_candidates(driven, dimensions, loops=loops, tape=tape)
    scaled = any(ReferenceScale.id in tie for tie in ties)
    if scaled if not measured.distance else not (measured.position and measured.beside):
        candidates.append(replace(_corridor_run(driven, dimensions), tape=True))
    return candidates


def _corridor_run(driven: Campaign, dimensions: Dimensions) -> PlannedRun:
    usual_C = planned_runs.usual_temperature_C(driven)
    return PlannedRun("corridor", "out", temperature_C=usual_C, speed_mps=dimensions.speeds_mps[1])


def _laden(runs: Sequence[PlannedRun]) -> list[int]:
    laden = [number for number, run in enumerate(runs) if run.kind == "corridor" and run.payload_kg > 0.0]
    return sorted(laden, key=lambda number: -runs[number].payload_kg)


def _of_one_way(driven: Campaign, runs: Sequence[PlannedRun]) -> list[int]:
    laden = _laden(runs) if any("load and direction" in note.where for note in columns_as_one(driven)) else []
    return [n for way in ("out", "back") for n in [n for n in laden if runs[n].direction == way][:1]]


def with_next(campaign: Campaign, runs: Sequence[PlannedRun]) -> Campaign:
    """Return the runs driven and, as their model says, those of `next_runs`."""
    driven = campaign.included()
    planned = [run for run in runs for _ in range(run.count)]
    return joined(driven, drive(driven, planned, _measured(driven), dimensions_of(driven)))


def _measured(campaign: Campaign) -> Measured:
    runs, logs = campaign.runs, campaign.logs
    front = logs.columns.get("counts_front")
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


FORMAT: Final = "calib-plan/1"
_REMEDY: Final = "correct the plan"
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


def read_plan(path: FilePath) -> Campaign:
    """Return the campaign that a plan (`path`, see ``calib plan --help``) would give of a vehicle as modelled.

    Raises BadFileError where the file cannot be used.
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
    return drive(replace(settings, simulated=True), runs, by, Dimensions(measured.corridor_m))


def read_candidates(path: FilePath) -> list[PlannedRun]:
    """Return runs to choose from: a file with ``[[runs]]`` as in a plan, ``count`` unused."""
    return list({repr(run): run for run in _runs(_load(path).get("runs"), path)}.values())


def _load(path: FilePath) -> dict[str, Any]:
    document = load_toml(path, str(path), remedy="give the path of the plan, as sample_runs/plan.toml")
    if (stated := document.pop("format", FORMAT)) != FORMAT:
        raise BadFileError(
            path, column="format", found=repr(stated)[:60], expected=repr(FORMAT), remedy="give a plan of runs"
        )
    return document


def _runs(section: object, path: FilePath) -> list[PlannedRun]:
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


def _validated(kind: type[_Section], table: object, path: FilePath, where: str) -> _Section:
    if not isinstance(table, dict):
        raise _wrong(path, where, table, "a table")
    try:
        return kind.model_validate(table)
    except ValidationError as error:
        part, actual, expected = first_fault(error)
        raise BadFileError(path, actual[:60], expected, _REMEDY, column=f"{where}.{part}") from error


def _wrong(path: FilePath, column: str, actual: object, expected: str) -> BadFileError:
    shown = str(actual).lower() if isinstance(actual, bool) else repr(actual)
    return BadFileError(path, column=column, found=shown[:60], expected=expected, remedy=_REMEDY)
