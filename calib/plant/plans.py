"""Designs of good and of poor quality, drawn at random within what a lab would drive."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Final

import numpy as np

from calib.errors import BadInputError
from calib.plant.design import Design
from calib.plant.effects.wheels import COLUMNS
from calib.vehicle import Vehicle

#: names of the poor designs
DESIGNS: Final = ("load_a_session", "corridor_only", "squares_one_load", "few_repeats")

_TURNING: Final = ("square_cw", "square_ccw", "figure8", "route_left", "route_right", "slalom")


@dataclass(frozen=True, slots=True)
class _Run:
    kind: str = "corridor"
    direction: str = ""
    session: str = "s1"
    payload_kg: float = 0.0
    payload_x_m: float = 0.4
    payload_y_m: float = 0.0
    speed_mps: float = 0.5
    temperature_C: float = 20.0
    minutes_under_load: float = 0.0
    flying: bool = False
    stops: int = 0


def _design(runs: Sequence[_Run], **settings: Any) -> Design:
    columns = {field.name: np.array([getattr(run, field.name) for run in runs]) for field in fields(_Run)}
    return Design(**(settings | columns))


def _vehicle(rng: np.random.Generator) -> Vehicle:
    return Vehicle(
        track_m=round(float(rng.uniform(0.6, 0.8)), 3),
        wheelbase_m=round(float(rng.uniform(0.9, 1.2)), 3),
        cog_x_m=round(float(rng.uniform(0.35, 0.42)), 3),
        cog_z_m=round(float(rng.uniform(0.35, 0.6)), 2),
    )


def good_design(rng: np.random.Generator, *, n_runs: int = 60, needs: Iterable[str] = (), **settings: Any) -> Design:
    """Return a crossed design: routes, loads, sides, speeds, temperatures, dwell and sessions vary apart, with repeats.

    `needs`: see `calib.plant.world.Form`; `settings`: fields of `Design` that are given instead of drawn.
    """
    need = set(needs)
    n_sessions = int(rng.integers(3, 6))
    conditions = _crossed(rng, max(8, n_runs // 3), need, turning=settings.pop("turning", True))
    rows = _scheduled(rng, conditions, n_runs, n_sessions)
    return _design(rows, **{**_surroundings(rng, need, n_runs), **settings})


def _crossed(rng: np.random.Generator, n_conditions: int, need: set[str], *, turning: bool) -> list[_Run]:
    payloads = [0.0, *sorted(rng.choice([50.0, 80.0, 100.0, 120.0, 150.0, 200.0], 3, replace=False))]
    sides = [-0.15, 0.0, 0.15]
    quick = [0.25, 0.35, 0.5, 0.65] if "three_speeds" in need else [0.25, 0.35, 0.5, 0.65, 0.8]
    speeds = sorted(rng.choice(quick, 3, replace=False))
    kinds = ["corridor", *_TURNING] if turning else ["corridor"]

    def deal(values: list[Any]) -> list[Any]:
        """Return the values spread evenly over the conditions, in random order: no two factors go together."""
        dealt = [values[number % len(values)] for number in range(n_conditions)]
        return [dealt[number] for number in rng.permutation(n_conditions)]

    # half of the conditions go along the corridor, the others turn; within each the routes are dealt evenly
    half = n_conditions // 2
    route = ["corridor"] * half + [kinds[1:][number % (len(kinds) - 1)] for number in range(n_conditions - half)]
    if "lanes" in need:
        route[:half:2] = ["corridor_b"] * len(route[:half:2])
    elif "lengths" in need or rng.random() < 0.5:
        for number in range(half):
            if number % 3 == 1:
                route[number] = "corridor_short"
    ways = ["out", "back"]
    payload, side, ahead = deal(payloads), deal(sides), deal([0.15, 0.4, 0.6])
    speed = deal(list(map(float, speeds)))
    stops = deal([0, 0, 1, 3] if "stops" in need else [0, 0, 0, 1])
    flying = deal([True, False] if "flying" in need else [False])
    conditions = []
    for number, kind in enumerate(route):
        corridor, loaded = kind.startswith("corridor"), payload[number] > 0
        # tight routes are not driven fast
        condition = _Run(
            kind=kind,
            direction=ways[(number // 2) % 2] if corridor else "",
            payload_kg=payload[number],
            payload_x_m=ahead[number] if loaded else 0.0,
            payload_y_m=side[number] if loaded else 0.0,
            speed_mps=speed[number] if corridor or kind.startswith("route") else min(speed[number], 0.65),
            stops=stops[number],
            flying=flying[number],
        )
        conditions.append(condition)
    return conditions


def _scheduled(rng: np.random.Generator, conditions: Sequence[_Run], n_runs: int, n_sessions: int) -> list[_Run]:
    """Return the runs in the order driven: sessions, dwell and temperatures vary apart from the conditions."""
    # each session has a cold and a warm half; dwell varies from run to run; no condition correlates with a session
    levels = []
    for _ in range(n_sessions):
        cold = float(rng.uniform(10, 20))
        halves = [cold, cold + float(rng.uniform(6, 12))]
        levels.append(halves if rng.random() < 0.5 else halves[::-1])
    driven = [conditions[number] for number in np.resize(np.arange(len(conditions)), n_runs).tolist()]
    minutes = [float(rng.choice([2.0, 10.0, 30.0, 60.0])) if run.payload_kg > 0 else 0.0 for run in driven]
    shuffle = np.concatenate([rng.permutation(part) for part in np.array_split(np.arange(n_runs), len(conditions))])
    # conditions are dealt to sessions by a shuffle of the whole order, sessions stay contiguous
    runs = []
    for number, at in enumerate(rng.permutation(shuffle)):
        place = number * n_sessions / n_runs
        temperature_C = round(levels[int(place)][int(2 * (place % 1))] + float(rng.uniform(-0.3, 0.3)), 1)
        session = f"s{number * n_sessions // n_runs + 1}"
        runs.append(replace(driven[at], session=session, minutes_under_load=minutes[at], temperature_C=temperature_C))
    return runs


def _surroundings(rng: np.random.Generator, need: set[str], n_runs: int) -> dict[str, object]:
    """Return what is the same in all runs: vehicle, lengths, what is logged; and further columns."""
    drawn: dict[str, object] = {
        "length_m": round(float(rng.uniform(15.0, 25.0)), 1),
        "side_m": round(float(rng.uniform(2.0, 3.5)), 1),
        "radius_m": round(float(rng.uniform(0.9, 1.4)), 2),
        "vehicle": _vehicle(rng),
        "counts_per_rev": float(rng.choice([2048, 4096, 8192])),
        "slope_per_N": float(rng.uniform(0.8e-5, 1.4e-5)) if "slope" in need else 0.0,
        "log_period_s": 0.0 if "no_logs" in need else float(rng.choice([0.1, 0.1, 0.12])),
        **{name: name in need for name in ("front", "trace", "outside")},
    }
    if "no_logs" in need:
        drawn["poses"] = "none"
    column_names = [want.partition(":")[2] for want in need if want.startswith("column:")]
    if not column_names and rng.random() < 0.3:
        column_names = [str(rng.choice(COLUMNS))]
    return drawn | {"columns": {name: np.round(rng.uniform(0, 100, n_runs), 1) for name in column_names}}


def poor_design(name: str, rng: np.random.Generator, *, n_runs: int = 40, **settings: Any) -> Design:
    """Return a design that cannot answer everything; `settings` are fields of `Design` that are given instead of drawn.

    ``load_a_session`` (the paper's own: corridor runs out and back, each session under its own load), ``corridor_only``
    (varied loads and speeds, no turn), ``squares_one_load`` or ``few_repeats``.
    """
    if name not in DESIGNS:
        raise BadInputError(f"design {name!r} found; expected one of {', '.join(DESIGNS)}; name one of these")
    drawn: dict[str, object] = {
        "length_m": round(float(rng.uniform(15.0, 30.0)), 1),
        "vehicle": _vehicle(rng),
        "log_period_s": float(rng.choice([0.1, 0.12])),
    }
    if name == "few_repeats":
        return _few_repeats(rng, n_runs, settings)
    rows = [_POOR[name](rng, number, n_runs) for number in range(n_runs)]
    if name == "load_a_session":
        drawn["poses"] = str(rng.choice(["all", "none"]))
    if name == "squares_one_load":
        drawn["laser"] = False
    return _design(rows, **{**drawn, **settings})


def _load_a_session(rng: np.random.Generator, number: int, n_runs: int) -> _Run:
    loads = [0.0, 50.0, 100.0, 150.0, 200.0]
    session = number * len(loads) // n_runs
    return _Run(
        direction="out" if number % 2 == 0 else "back",
        session=f"s{session + 1}",
        payload_kg=loads[session],
        payload_x_m=0.3 if loads[session] else 0.0,
        temperature_C=round(19.0 + float(rng.uniform(-0.5, 0.5)), 1),
        minutes_under_load=10.0 if loads[session] else 0.0,
    )


def _corridor_only(rng: np.random.Generator, number: int, n_runs: int) -> _Run:
    payload = float(rng.choice([0.0, 100.0, 200.0]))
    return _Run(
        direction="out" if number % 2 == 0 else "back",
        session=f"s{number * 3 // n_runs + 1}",
        payload_kg=payload,
        payload_x_m=0.4 if payload else 0.0,
        payload_y_m=float(rng.choice([-0.15, 0.0, 0.15])) if payload else 0.0,
        speed_mps=float(rng.choice([0.3, 0.6])),
        temperature_C=round(float(rng.uniform(12, 28)), 1),
        minutes_under_load=10.0 if payload else 0.0,
    )


def _square_under_one_load(_rng: np.random.Generator, number: int, n_runs: int) -> _Run:
    kind, session = ("square_cw", "square_ccw")[number % 2], f"s{number * 2 // n_runs + 1}"
    return _Run(kind, session=session, payload_kg=100.0, minutes_under_load=10.0, speed_mps=0.4)


def _few_repeats(rng: np.random.Generator, n_runs: int, settings: Mapping[str, Any]) -> Design:
    whole = good_design(rng, n_runs=3 * n_runs, **settings)
    what = np.char.add(np.char.add(whole.kind, whole.direction), whole.payload_kg.astype(np.str_))
    first = np.unique(what, return_index=True)[1]
    return whole.select(np.sort(np.concatenate((first, np.setdiff1d(np.arange(3 * n_runs), first)))[:n_runs]))


#: poor design -> what one of its runs is
_POOR: Final = {
    "load_a_session": _load_a_session,
    "corridor_only": _corridor_only,
    "squares_one_load": _square_under_one_load,
}
