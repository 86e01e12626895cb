"""Runs led straight along a corridor: their heading at the end is that of the start, to within the way's straightness.

With a distance alone the two wheels cannot be told apart. A run that was led along a line still has two wheels that
went the same way, as `fit` takes it: a heading of nought, as uncertain as the way is straight.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from calib.arrays import BoolArray, FloatArray, IntArray

#: how far a run led along a corridor is taken to stray from its line, where nobody says
ASSUMED_LATERAL_M: Final = 0.05
#: wheels that differ by no more than this share may have rolled a straight line
MOST_UNEQUAL: Final = 0.02
#: the distance measured and that rolled agree to this share, on a straight line
AGREES: Final = 0.05
#: wheels on a smooth floor part by so much over a square root of a metre at least; of the real robots at hand the
#: smoothest parts by 9e-4
LEAST_WALK: Final = 1e-4
#: fewer runs may roll alike by chance
FEWEST_ALIKE: Final = 5


def were_led_straight(
    distance_m: FloatArray, path_m: FloatArray, turn_rad: FloatArray, track_m: float, posed: BoolArray
) -> BoolArray:
    """Return which units were led along a line, by what was measured alone, shape (n_units,).

    Parameters
    ----------
    distance_m : array of float, shape (n_units,)
        Measured length of the line, NaN where not measured.
    path_m, turn_rad : array of float, shape (n_units,)
        What the wheels rolled, and turned.
    track_m : float
        Track.
    posed : array of bool, shape (n_units,)
        Units with a measured end pose or heading.
    """
    way = np.abs(path_m)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.abs(distance_m) / way
        # a radius that is off makes all ways too short or too long, alike
        known = ratio[np.isfinite(ratio) & ~posed]
        along = np.abs(ratio / (np.median(known) if len(known) else 1.0) - 1.0) < AGREES
    straight = np.abs(turn_rad) * track_m < MOST_UNEQUAL * way
    led: BoolArray = along & straight & ~posed
    return led


def steered_by_counts(apart_m: FloatArray, way_m: FloatArray, count_m: tuple[float, float]) -> bool:
    """Return whether wheels rolled so alike, run by run, that the vehicle kept them alike itself.

    A vehicle that steers by its own counts ends each run with the wheels alike to within a count, wherever it went:
    nothing then says that the way was straight. Led along a line, the wheels part by what floor and rubber make of it.
    Where counting is coarser than that, the runs cannot say which it was, and are taken as led.

    Parameters
    ----------
    apart_m, way_m : array of float, shape (n_units,)
        What the right wheel rolled beyond the left, and the length of the way.
    count_m : tuple of float
        Way of one count, left and right.
    """
    if len(apart_m) < FEWEST_ALIKE:
        return False
    # the first and the last count are each off by a uniform share of a count
    counting = (count_m[0] ** 2 + count_m[1] ** 2) / 6.0
    walk = LEAST_WALK**2 * float(np.mean(np.abs(way_m)))
    return counting < walk and float(np.mean(apart_m**2)) < counting + 0.25 * walk


def heading_by_straightness(
    amplitude_m: FloatArray, wavelength_m: FloatArray, weave_rad: FloatArray, way_m: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Return how uncertain the heading at the end of a straight run is, and where it was assumed, each (n_units,).

    A stated weave of amplitude A and wavelength l (NaN where not stated) turns the vehicle by up to 2 pi A / l; else
    the log says by how much it wove (root mean square of the heading about its trend, NaN without a log); else it is
    taken to stray by `ASSUMED_LATERAL_M` in one wave over its length.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        stated = 2 * np.pi * np.abs(amplitude_m) / wavelength_m
        assumed = 2 * np.pi * ASSUMED_LATERAL_M / np.maximum(way_m, ASSUMED_LATERAL_M)
    # both ends lie somewhere on the wave, whose root mean square each of them adds
    seen = np.sqrt(2.0) * weave_rad
    has_stated, has_seen = np.isfinite(stated) & (stated > 0), np.isfinite(weave_rad)
    sigma = np.where(has_stated, stated, np.where(has_seen, np.maximum(seen, 0.1 * assumed), assumed))
    return sigma, ~(has_stated | has_seen)


def weave_of_log(starts: IntArray, way_m: FloatArray, turn_rad: FloatArray, logged: BoolArray) -> FloatArray:
    """Return the root mean square of the heading about its linear trend along the way, (n_units,); NaN without a log.

    Wheels of unlike radii turn evenly along the way: the trend is theirs. Way and turn by the wheels are given for each
    step, those of unit u at ``starts[u]:starts[u + 1]``.
    """
    unit = np.repeat(np.arange(len(logged)), np.diff(starts))

    def within(steps: FloatArray) -> FloatArray:
        running = np.cumsum(steps)
        before = np.concatenate(([0.0], running))[starts[:-1]]
        middle: FloatArray = running - 0.5 * steps - before[unit]
        return middle

    def total(steps: FloatArray) -> FloatArray:
        summed: FloatArray = np.add.reduceat(steps, starts[:-1])
        return summed

    weight = np.abs(way_m)
    along, heading = within(weight), within(turn_rad)
    whole = np.maximum(total(weight), 1e-12)
    along = along - (total(weight * along) / whole)[unit]
    heading = heading - (total(weight * heading) / whole)[unit]
    slope = total(weight * along * heading) / np.maximum(total(weight * along * along), 1e-12)
    left = heading - slope[unit] * along
    return np.where(logged, np.sqrt(total(weight * left * left) / whole), np.nan)
