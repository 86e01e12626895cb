"""Which units were driven alike, by what was driven: length, turn, curvature, speed and loads; labels are hints."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.arrays import BoolArray, FloatArray, IntArray, StrArray
from calib.campaign.model import Campaign
from calib.vehicle import Vehicle

#: places along a route at which two are compared
KNOTS: Final = 10
#: routes are alike within this share of their length, at every place
LENGTH_SHARE: Final = 0.15
#: and within these turns: absolute, and as a share of all the turning
TURN_RAD, TURN_SHARE = 0.25, 0.05
#: where no heading was measured, wheels that differ by this share pass for the same route
WHEELS_SHARE: Final = 0.02
#: a kind of route that ends so is driven on another lane of the same floor
_LANE: Final = re.compile(r"_([b-z]|\d+)$")


@dataclass(frozen=True, slots=True, eq=False)
class Driven:
    """Steps of all units, end to end, as the wheels tell them."""

    starts: IntArray  #: shape (n_units + 1,): steps of unit u stand at ``starts[u]:starts[u + 1]``
    #: left_m, right_m: shape (n_steps,): travel of the wheels in each step
    left_m: FloatArray
    right_m: FloatArray
    track_m: float
    heading_rad: FloatArray  #: shape (n_units,): measured turn of each unit, NaN where not measured
    duration_s: FloatArray  #: shape (n_steps,): how long each step took
    logged: BoolArray  #: shape (n_units,): which units have a log

    @property
    def rolled_m(self) -> FloatArray:
        """What the wheels rolled in each step, the mean of both, standing turns included, shape (n_steps,)."""
        rolled: FloatArray = 0.5 * (np.abs(self.left_m) + np.abs(self.right_m))
        return rolled


def levels(values: FloatArray, width: float) -> IntArray:
    """Return a number for each of the levels that set values stand at, shape (n,).

    Values that differ by no more than `width` from their neighbour in size are one level, wherever that lies. What
    varies without steps is cut into bins of twice the width. NaN is a level of its own.
    """
    number = np.full(len(values), -1, dtype=np.int64)
    known = np.flatnonzero(np.isfinite(values))
    if not len(known):
        return number
    order = known[np.argsort(values[known], kind="stable")]
    sorted_values = values[order]
    level = np.concatenate(([0], np.cumsum(np.diff(sorted_values) > width)))
    first = np.searchsorted(level, np.arange(level[-1] + 1))
    spans = np.diff(np.append(first, len(level)))
    lowest = np.repeat(sorted_values[first], spans)
    highest = np.repeat(sorted_values[np.append(first[1:], len(level)) - 1], spans)
    # a chain of small differences is no level: cut into equal bins as wide as a level may be
    n_bins = np.ceil(np.maximum((highest - lowest) / (2.0 * width), 1.0))
    place = np.clip((sorted_values - lowest) / np.maximum(highest - lowest, 1e-300) * n_bins, 0.0, n_bins - 1.0)
    chained = n_bins > 1
    bins = np.where(chained, np.floor(place), 0.0)
    number[order] = joined([level, bins])
    return number


def joined(columns: Sequence[IntArray | FloatArray | StrArray]) -> IntArray:
    """Return a number for each distinct row of several columns, in the order of first appearance, shape (n,)."""
    code = np.zeros(len(columns[0]), dtype=np.int64)
    for column in columns:
        _, part = np.unique(column, return_inverse=True)
        _, code = np.unique(code * (int(part.max(initial=0)) + 1) + part, return_inverse=True)
    _, first, inverse = np.unique(code, return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first, kind="stable")] = np.arange(len(first))
    return rank[inverse]


def routes(driven: Driven) -> IntArray:
    """Return a number for each of the routes driven, shape (n_units,), in the order of first appearance.

    Two units have one route where their length is alike and their heading and way are, at every tenth of the wheels'
    rolling. The heading is the wheels', drawn linearly to the measured one at the end where there is one, so that
    wheels of unlike radii make no other route.
    """
    shapes, rolled, tolerance = _shapes(driven)
    route = np.full(len(rolled), -1, dtype=np.int64)
    leaders: list[int] = []
    for unit in range(len(rolled)):
        if leaders:
            lead = np.array(leaders)
            ratio = np.abs(np.log(rolled[unit] / rolled[lead])) / LENGTH_SHARE
            apart = np.abs(shapes[lead] - shapes[unit]) / np.maximum(tolerance[lead], tolerance[unit])[:, :, None]
            distance = np.maximum(ratio, apart.max(axis=(1, 2)))
            nearest = int(np.argmin(distance))
            if distance[nearest] <= 1.0:
                route[unit] = nearest
                continue
        route[unit] = len(leaders)
        leaders.append(unit)
    return route


def _shapes(driven: Driven) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the heading and way of each unit at its knots (n, 2, KNOTS), its length (n,) and tolerances (n, 2)."""
    starts, n = driven.starts, len(driven.starts) - 1
    rolled = driven.rolled_m
    turn = (driven.right_m - driven.left_m) / driven.track_m
    sums = [np.concatenate(([0.0], np.cumsum(x))) for x in (rolled, turn, 0.5 * (driven.left_m + driven.right_m))]
    length = np.maximum(sums[0][starts[1:]] - sums[0][starts[:-1]], 1e-9)
    share = np.arange(1, KNOTS + 1) / KNOTS
    at = sums[0][starts[:-1], None] + share * length[:, None]
    heading, way = (
        np.interp(at.ravel(), sums[0], column).reshape(n, KNOTS) - column[starts[:-1], None] for column in sums[1:]
    )
    off = driven.heading_rad - heading[:, -1]
    heading = heading + np.nan_to_num(off)[:, None] * share
    turning = np.add.reduceat(np.abs(turn), starts[:-1])
    unseen = np.where(np.isfinite(driven.heading_rad), 0.0, WHEELS_SHARE * length / driven.track_m)
    tolerance = np.stack([TURN_RAD + TURN_SHARE * turning + unseen, LENGTH_SHARE * length], axis=1)
    return np.stack([heading, way], axis=1), length, tolerance


def load_width_N(vehicle: Vehicle) -> float:
    """Return the difference of wheel loads from which on two runs were loaded differently."""
    return 0.017 * vehicle.unladen_load_N


def speed_width_mps(speed_mps: FloatArray) -> float:
    """Return the difference of speeds from which on two runs were driven differently: a tenth, 0.05 m/s at most."""
    known = speed_mps[np.isfinite(speed_mps) & (speed_mps > 0)]
    return float(min(0.05, 0.1 * np.median(known))) if len(known) else 0.05


def lane_names(kind: StrArray) -> StrArray:
    """Return the lane that a label of the kind of route ends with (``_b``, ``_2``), else an empty text, shape (n,)."""
    ending = [_LANE.search(str(name)) for name in kind]
    return np.array([match.group(1) if match else "" for match in ending], dtype=np.str_)


def measured_speed(driven: Driven) -> FloatArray:
    """Return the mean speed of each unit over its way, by its log, shape (n_units,); NaN without a log.

    A mean over the way, so that standing still at the ends weighs nothing.
    """
    way_m, first = driven.rolled_m, driven.starts[:-1]
    with np.errstate(divide="ignore", invalid="ignore"):
        pace = np.where(driven.duration_s > 0, way_m**2 / driven.duration_s, 0.0)
        speed = np.add.reduceat(np.nan_to_num(pace), first) / np.add.reduceat(way_m, first)
    return np.where(driven.logged & np.isfinite(speed) & (speed > 0), speed, np.nan)


def alike(
    campaign: Campaign, driven: Driven, numbers: Mapping[str, FloatArray], labels: Mapping[str, StrArray]
) -> tuple[IntArray, IntArray, IntArray]:
    """Return the route, the condition and the cell of each unit, each shape (n_units,)."""
    route = joined([routes(driven), labels["direction"], lane_names(labels["kind"])])
    nothing = np.zeros(len(route))
    speed = measured_speed(driven)
    speed = np.where(np.isfinite(speed), speed, numbers.get("speed_mps", nothing + np.nan))
    loads = [levels(numbers[name], load_width_N(campaign.vehicle)) for name in ("load_left_N", "load_right_N")]
    condition = joined([route, *loads, levels(speed, speed_width_mps(speed))])
    warmth, dwell = (numbers.get(name, nothing) for name in ("temperature_C", "minutes_under_load"))
    further = [levels(numbers[name], _width(numbers[name])) for name in campaign.runs.covariates]
    cell = joined([condition, labels["session"], levels(warmth, 2.0), levels(dwell, 5.0), *further])
    return route, condition, cell


def _width(values: FloatArray) -> float:
    """Width that tells set values of a further column apart: a tenth of its spread."""
    spread = float(np.nanmax(values) - np.nanmin(values)) if np.isfinite(values).any() else 0.0
    return spread / 10.0 if spread > 0 else 1.0
