"""Poses of a reference along the path: lost, mirrored against the headings, on a line or in another unit."""

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from calib.campaign import checks
from calib.campaign.checks import LEAST_RUNS, column_note, rolled_m
from calib.campaign.checks.counts import jumps_of
from calib.campaign.checks.measurements import factor_reason, odd_sessions
from calib.campaign.checks.poses import position_unit_hint
from calib.campaign.model import Campaign, Note
from calib.campaign.wheels import ASIDE
from calib.types import BoolArray, ComplexArray, FloatArray, few_digits

#: a lost reference's difference from the wheels: in m, beyond this slip, in standard uncertainties, in usual (90 %)
#: ones
_LOST_M, _SLIP, _LOST_SIGMAS, _UNUSUAL = 0.05, 0.5, 15.0, 4.0
#: readings on either side that tell the course of one
_NEAR: Final = 5


def lost_reference(campaign: Campaign) -> Iterator[Note]:
    """Find positions along the path that stand still while the wheels roll, or leap further."""
    for run, between_s, off_m, stands, _ in _unfollowed(campaign):
        at = int(np.argmax(off_m))
        what = "stands still while they roll" if stands[at] else "leaps further than they roll"
        text = f"""the position does not follow the wheels {len(off_m)} time(s), most from {between_s[at, 0]:.4g} to
            {between_s[at, 1]:.4g} s: it {what}, by {few_digits(off_m[at])} m; lost or hidden? Empty these cells, or
            exclude the run"""
        yield checks.cell_note(campaign, run, "log ref_x_m, ref_y_m", text, "lost_reference")


def lost_stretches_s(campaign: Campaign) -> dict[int, FloatArray]:
    """Return begin and end in s, (n, 2), by run, of each time at which the reference is off: no wheel skids so."""
    return {run: between_s[no_skid] for run, between_s, _, _, no_skid in _unfollowed(campaign) if no_skid.any()}


def _unfollowed(campaign: Campaign) -> Iterator[tuple[int, FloatArray, FloatArray, BoolArray, BoolArray]]:
    """Yield a run, where it is off: begin and end in s (n, 2), by how many m (n,), and two flags (n,).

    Whether the position stands still, and whether it does or leaps aside: on locked wheels a vehicle slides ahead.
    """
    campaign = checks.on_axle(campaign)
    vehicle, sensor = campaign.vehicle, campaign.reference
    least = max(_LOST_M, _LOST_SIGMAS * sensor.sigma_xy_m)
    # largest lever arm from the axle's middle to the sensor, in tracks
    arm = 1.0 + (vehicle.wheelbase_m + math.hypot(sensor.sensor_x_m, sensor.sensor_y_m)) / vehicle.track_m
    for run, log in campaign.logs.each(20, "ref_x_m", "ref_y_m", "counts_left", "counts_right"):
        position = log["ref_x_m"] + 1j * log["ref_y_m"]
        known = np.flatnonzero(np.isfinite(position))
        left, right = (rolled_m(campaign, side, log[f"counts_{side}"][known]) for side in checks.SIDES)
        way = (left + right) / 2 + 1j * log.get(ASIDE, 0.0 * log["t_s"])[known]
        heading = (right - left) / vehicle.track_m
        # each value of the reference, from its first sample to that after its last
        first = np.append(0, np.flatnonzero(np.diff(position[known])) + 1)
        last = np.append(first[1:], len(known)) - 1
        after = np.minimum(last + 1, len(known) - 1)
        if len(known) < LEAST_RUNS:
            continue
        turning = np.exp(0.5j * (heading[1:] + heading[:-1]))
        by_wheels = np.append(0.0, np.cumsum(np.diff(way) * turning))
        moved, rolled, apart = (of[after] - of[first] for of in (position[known], by_wheels, right - left))
        moved = _turned_back(moved, rolled)
        share = np.clip((moved * rolled.conj()).real / np.maximum(np.abs(rolled), 1e-12) ** 2, 0.0, 1.0)
        off = (moved - share * rolled) * np.exp(-0.5j * (heading[after] + heading[first]))
        slip = arm * np.abs(apart) + _SLIP * np.abs(rolled)
        leap, aside = np.abs(off) - slip, np.abs(off.imag) - slip
        stand = np.abs(way[last] - way[first])
        off_m = np.maximum(stand, leap)
        most = least + _UNUSUAL * np.quantile(np.append(off_m, 0.0), 0.9, method="lower")
        # counts that jump tell no way
        if (far := off_m > most).any() and not any(jumps_of(log)):
            between_s = log["t_s"][known[np.stack([first, after], axis=1)[far]]]
            yield run, between_s, off_m[far], (stand > leap)[far], (np.maximum(stand, aside) > most)[far]


def _turned_back(moved_m: ComplexArray, rolled_m: ComplexArray) -> ComplexArray:
    """Return steps by the reference (n,) in the axes of those by the wheels, as their neighbours lie in these."""
    step = moved_m.conj() / np.maximum(np.abs(moved_m), 1e-12) * rolled_m
    near = np.convolve(step, np.ones(2 * _NEAR + 1))[_NEAR : _NEAR + len(step)] - step
    return np.asarray(moved_m * near / np.maximum(np.abs(near), 1e-12))


#: part of the way whose course follows the heading: 0.8 to 0.97 of real robots
_FOLLOWS: Final = 0.8
#: times the part unmirrored: routes turning both ways look alike in a mirror
_CLEARLY: Final = 2.0


def mirrored_path(campaign: Campaign) -> Iterator[Note]:
    """Find positions along the path that are mirror images of what their headings say."""
    # resultant of the doubled angle between course and heading (backward is forward), and of that in a mirror
    along, in_mirror, way_m = 0.0j, 0.0j, 0.0
    for _, log in campaign.logs.each(LEAST_RUNS, "ref_x_m", "ref_y_m", "ref_theta_rad"):
        position, heading = log["ref_x_m"] + 1j * log["ref_y_m"], np.exp(1j * log["ref_theta_rad"])
        known = np.isfinite(position) & np.isfinite(heading)
        step, middle = np.diff(position[known]), heading[known][1:] * heading[known][:-1]
        double = step**2 / np.maximum(np.abs(step), 1e-12)
        along += np.sum(double * middle.conj())
        in_mirror += np.sum(double * middle)
        way_m += float(np.abs(step).sum())
    if abs(in_mirror) > max(_FOLLOWS * way_m, _CLEARLY * abs(along)):
        text = """positions along the path are mirror images of what the headings say; expected x ahead, y to the left
            and left turns positive; check the signs of ref_y_m and ref_theta_rad, or whether x and y are exchanged;
            'calib geometry' says which"""
        yield column_note("ref_x_m, ref_y_m, ref_theta_rad", text, "mirrored_path", of="logs")


#: steps into which a log is thinned
_STEPS: Final = 50
#: largest turn in a step whose chord counts as its length
_STRAIGHT_RAD: Final = 0.3
#: width over length: above, a path covers an area; below, it is a line
_AREA, _LINE = 0.2, 0.02
#: relative scatter of reference over wheels: 0.5 where an axis is missing
_UNEVEN: Final = 0.2
#: plausible ratio of reference to wheels; wrong counts alone make less of it
_MOST_RATIO, _LEAST_RATIO = 3.0, 0.02


def implausible_paths(campaign: Campaign) -> Iterator[Note]:
    """Yield positions in another unit or on a line, and two wheels with the same counts."""
    campaign = checks.on_axle(campaign)
    ratios, lines, alike = np.full(len(campaign.runs), np.nan), [], []
    columns = ("ref_x_m", "ref_y_m", "counts_left", "counts_right")
    for run, log in campaign.logs.each(2, *columns):
        x, y, left, right = (log[name] for name in columns)
        known = np.flatnonzero(np.isfinite(x + y + left + right))
        if len(known) < checks.LEAST_RUNS:
            continue
        at = known[:: 1 + len(known) // _STEPS]
        position, turned = (x + 1j * y)[at], checks.turned_rad(campaign, left[at], right[at])
        wheels = np.diff([checks.rolled_m(campaign, side, log[f"counts_{side}"][at]) for side in checks.SIDES])
        rolled = wheels.mean(axis=0)
        # on the spot the reference moves, not the axle
        straight = (np.abs(np.diff(turned)) < _STRAIGHT_RAD) & (np.abs(rolled) > 0.5 * np.abs(wheels).max())
        ratio = np.abs(np.diff(position)[straight] / rolled[straight])
        ratios[run] = np.median(ratio) if straight.any() else np.nan
        length, width = _length_and_width(position)
        alike += [bool((left == right)[known].all())] if width > _AREA * length and rolled.any() else []
        # on a bent path a missing axis shows as an uneven ratio
        long, wide = _length_and_width(np.cumsum(rolled * np.exp(0.5j * (turned[1:] + turned[:-1]))))
        if wide > _AREA * long and straight.any() and np.std(ratio) > _UNEVEN * np.mean(ratio):
            lines.append(width < _LINE * length)
    for names, odd, what, hint in (
        ("ref_x_m, ref_y_m", lines, "positions on a line", "is one the vertical axis, or both one column?"),
        ("counts_left, counts_right", alike, "the same counts of both wheels", "are both one column?"),
    ):
        if sum(odd) >= max(checks.LEAST_RUNS, checks.MOST_OF_THE_RUNS * len(odd)):
            text = f"found {what} in {sum(odd)} runs that turn; expected each its own; {hint}"
            yield checks.implausible_column(names, text, of="logs")
            return
    stated = all(checks.stated(campaign, key) for key in ("vehicle.wheel_radius_m", "encoder.counts_per_rev"))
    known = ratios[np.isfinite(ratios)]
    ratio = float(np.median(known)) if stated and len(known) >= checks.LEAST_RUNS else 1.0
    texts = []
    if ratio > _MOST_RATIO or 0.0 < ratio < _LEAST_RATIO:
        hint = position_unit_hint(ratio, "check their unit, wheel_radius_m and counts_per_rev")
        texts = [f"positions along the path move {ratio:.3g} times as far as the wheels; expected as far; {hint}"]
    for name, ratio in odd_sessions(campaign, ratios):
        moved = f"positions along the path move {ratio:.3g} times as far as in most runs"
        texts.append(f"in session {name} {moved}; {position_unit_hint(ratio, factor_reason(ratio))}")
    for text in texts:
        yield checks.implausible_column("ref_x_m, ref_y_m", text, of="logs")


def _length_and_width(path: ComplexArray) -> FloatArray:
    return np.linalg.svd((path - path.mean()).view(np.float64).reshape(-1, 2), compute_uv=False)
