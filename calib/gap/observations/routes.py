"""Replicates and guided runs, told by what was driven: length, turn, curvature, speed and loads."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.campaign.model import Campaign
from calib.types import BoolArray, FloatArray, IntArray, StrArray

#: places at which routes are compared
ROUTE_KNOTS: Final = 10
#: share of length within which routes are one, at every place
ROUTE_LENGTH_SHARE: Final = 0.15
#: and within these turns: absolute, and as a share of all the turning
ROUTE_TURN_RAD, ROUTE_TURN_SHARE = 0.25, 0.05
#: share by which wheels on one route differ, without measured heading
ROUTE_WHEELS_SHARE: Final = 0.02
#: end of a kind that names a lane of the same floor
_LANE: Final = re.compile(r"_([b-z]|\d+)$")


@dataclass(frozen=True, slots=True, eq=False)
class WheelTravel:
    """Steps of all observations, end to end, by wheels and model."""

    starts: IntArray  #: shape (n_obs + 1,): observation u has steps ``starts[u]:starts[u + 1]``
    left_m: FloatArray  #: shape (n_steps,): travel
    right_m: FloatArray
    track_m: float
    duration_s: FloatArray  #: shape (n_steps,)
    logged: BoolArray  #: shape (n_obs,): whether there is a log

    def total(self, steps: FloatArray) -> FloatArray:
        """Sum a step quantity (n_steps,) over each observation, shape (n_obs,)."""
        return np.add.reduceat(steps, self.starts[:-1])

    @property
    def path_m(self) -> FloatArray:
        """Signed path of each step, shape (n_steps,)."""
        return 0.5 * (self.left_m + self.right_m)

    @property
    def turn_rad(self) -> FloatArray:
        """Signed turn of each step, shape (n_steps,)."""
        return (self.right_m - self.left_m) / self.track_m

    @property
    def rolled_m(self) -> FloatArray:
        """Mean unsigned travel of both wheels in each step, shape (n_steps,)."""
        return 0.5 * (np.abs(self.left_m) + np.abs(self.right_m))


def levels(values: FloatArray, width: float) -> IntArray:
    """Return a number for each level of values, (n,).

    Those within `width` of a neighbour in size are one level; without steps, bins of twice the width; NaN its own.
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
    n_bins = np.ceil(np.maximum((highest - lowest) / (2.0 * width), 1.0))
    place = np.clip((sorted_values - lowest) / np.maximum(highest - lowest, 1e-300) * n_bins, 0.0, n_bins - 1.0)
    number[order] = row_numbers([level, np.where(n_bins > 1, np.floor(place), 0.0)])
    return number


def row_numbers(columns: Sequence[IntArray | FloatArray | StrArray]) -> IntArray:
    """Return a number for each distinct row of columns, by first appearance, (n,)."""
    code = np.zeros(len(columns[0]), dtype=np.int64)
    for column in columns:
        _, part = np.unique(column, return_inverse=True)
        _, code = np.unique(code * (int(part.max(initial=0)) + 1) + part, return_inverse=True)
    _, first, inverse = np.unique(code, return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first, kind="stable")] = np.arange(len(first))
    return rank[inverse]


def routes(driven: WheelTravel, heading_rad: FloatArray) -> IntArray:
    """Return each observation's number of route, (n_obs,), by first appearance."""
    shapes, rolled, tolerance = _shapes(driven, heading_rad)
    route = np.full(len(rolled), -1, dtype=np.int64)
    leaders: list[int] = []
    for unit in range(len(rolled)):
        if leaders:
            lead = np.array(leaders)
            ratio = np.abs(np.log(rolled[unit] / rolled[lead])) / ROUTE_LENGTH_SHARE
            apart = np.abs(shapes[lead] - shapes[unit]) / np.maximum(tolerance[lead], tolerance[unit])[:, :, None]
            distance = np.maximum(ratio, apart.max(axis=(1, 2)))
            if distance.min() <= 1.0:
                route[unit] = int(np.argmin(distance))
                continue
        route[unit] = len(leaders)
        leaders.append(unit)
    return route


def _shapes(driven: WheelTravel, heading_rad: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    starts, n = driven.starts, len(driven.starts) - 1
    sums = [np.concatenate(([0.0], np.cumsum(x))) for x in (driven.rolled_m, driven.turn_rad, driven.path_m)]
    length = np.maximum(sums[0][starts[1:]] - sums[0][starts[:-1]], 1e-9)
    share = np.arange(1, ROUTE_KNOTS + 1) / ROUTE_KNOTS
    at = sums[0][starts[:-1], None] + share * length[:, None]
    heading, way = (
        np.interp(at.ravel(), sums[0], total).reshape(n, ROUTE_KNOTS) - total[starts[:-1], None] for total in sums[1:]
    )
    heading = heading + np.nan_to_num(heading_rad - heading[:, -1])[:, None] * share
    turning = driven.total(np.abs(driven.turn_rad))
    unseen = np.where(np.isfinite(heading_rad), 0.0, ROUTE_WHEELS_SHARE * length / driven.track_m)
    tolerance = np.stack([ROUTE_TURN_RAD + ROUTE_TURN_SHARE * turning + unseen, ROUTE_LENGTH_SHARE * length], axis=1)
    return np.stack([heading, way], axis=1), length, tolerance


def speed_width_mps(speed_mps: FloatArray) -> float:
    """Return the difference of speeds that tells runs apart: a tenth, 0.05 m/s at most."""
    known = speed_mps[np.isfinite(speed_mps) & (speed_mps > 0)]
    return float(min(0.05, 0.1 * np.median(known))) if len(known) else 0.05


def lane_names(kind: StrArray) -> StrArray:
    """Return the lane that labels end with (``_b``, ``_2``), else empty, (n,)."""
    ending = [_LANE.search(str(name)) for name in kind]
    return np.array([match.group(1) if match else "" for match in ending], dtype=np.str_)


def _measured_speed(driven: WheelTravel) -> FloatArray:
    way_m = driven.rolled_m
    with np.errstate(divide="ignore", invalid="ignore"):
        pace = np.where(driven.duration_s > 0, way_m**2 / driven.duration_s, 0.0)
        speed = driven.total(np.nan_to_num(pace)) / driven.total(way_m)
    return np.where(driven.logged & np.isfinite(speed) & (speed > 0), speed, np.nan)


def replicates(
    campaign: Campaign,
    driven: WheelTravel,
    heading_rad: FloatArray,
    numbers: Mapping[str, FloatArray],
    labels: Mapping[str, StrArray],
) -> tuple[IntArray, IntArray, IntArray]:
    """Return the route, the condition and the cell of each observation, each shape (n_obs,).

    Replicates share a condition; those of one session, temperature, dwell and further columns a cell.

    Parameters
    ----------
    driven, campaign
        Its vehicle scales the loads, its further columns tell cells apart.
    heading_rad : shape (n_obs,)
        Measured turn, NaN where not measured.
    numbers : shape (n_obs,)
        Covariates.
    labels : shape (n_obs,)
        ``session``, ``kind`` and ``direction``.
    """
    route = row_numbers([routes(driven, heading_rad), labels["direction"], lane_names(labels["kind"])])
    nothing = np.zeros(len(route))
    speed = _measured_speed(driven)
    speed = np.where(np.isfinite(speed), speed, numbers.get("speed_mps", nothing + np.nan))
    width_N = 0.017 * campaign.vehicle.unladen_load_N
    loads = [levels(numbers[name], width_N) for name in ("load_left_N", "load_right_N")]
    condition = row_numbers([route, *loads, levels(speed, speed_width_mps(speed))])
    warmth, dwell = (numbers.get(name, nothing) for name in ("temperature_C", "minutes_under_load"))
    further = [levels(numbers[name], _column_width(numbers[name])) for name in campaign.runs.covariates]
    cell = row_numbers([condition, labels["session"], levels(warmth, 2.0), levels(dwell, 5.0), *further])
    return route, condition, cell


def _column_width(values: FloatArray) -> float:
    spread = float(np.nanmax(values) - np.nanmin(values)) if np.isfinite(values).any() else 0.0
    return spread / 10.0 if spread > 0 else 1.0


#: of a guided run from its line, unless specified
ASSUMED_LATERAL_M: Final = 0.05


def heading_by_straightness(
    amplitude_m: FloatArray, wavelength_m: FloatArray, weave_rad: FloatArray, way_m: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Return the uncertainty of a straight run's heading at the end, and where it was assumed, each (n_obs,)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        stated = 2 * np.pi * np.abs(amplitude_m) / wavelength_m
        assumed = 2 * np.pi * ASSUMED_LATERAL_M / np.maximum(way_m, ASSUMED_LATERAL_M)
    seen = np.sqrt(2.0) * weave_rad
    has_stated, has_seen = np.isfinite(stated) & (stated > 0), np.isfinite(weave_rad)
    sigma = np.where(has_stated, stated, np.where(has_seen, np.maximum(seen, 0.1 * assumed), assumed))
    return sigma, ~(has_stated | has_seen)


def weave_of_log(driven: WheelTravel) -> FloatArray:
    """Return the heading's rms about its trend along the path, that of unequal radii, (n_obs,); NaN without a log."""
    starts = driven.starts
    unit = np.repeat(np.arange(len(driven.logged)), np.diff(starts))

    def within(steps: FloatArray) -> FloatArray:
        running = np.cumsum(steps)
        return running - 0.5 * steps - np.concatenate(([0.0], running))[starts[:-1]][unit]

    total, weight = driven.total, np.abs(driven.path_m)
    along, heading = within(weight), within(driven.turn_rad)
    whole = np.maximum(total(weight), 1e-12)
    along = along - (total(weight * along) / whole)[unit]
    heading = heading - (total(weight * heading) / whole)[unit]
    slope = total(weight * along * heading) / np.maximum(total(weight * along * along), 1e-12)
    residual = heading - slope[unit] * along
    return np.where(driven.logged, np.sqrt(total(weight * residual * residual) / whole), np.nan)
