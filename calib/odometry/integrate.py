"""Odometry over arrays of runs: from wheel travel to poses, with radii that follow the load."""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Final

import numpy as np
import numpy.typing as npt

from calib.campaign.settings import Encoder, OdometryModel
from calib.errors import BadInputError
from calib.odometry.blocks import WHOLE, Block, Flat, after, before, blocks, cut, lay_flat
from calib.odometry.numba_loop import compiled_fill, is_installed
from calib.odometry.poses import Poses
from calib.radius.law import RadiusLaw
from calib.types import FloatArray, IntArray

#: how a step is drawn -> by which part of its turn the heading used lies behind the heading at its end
_BEHIND: Final = {"exact": 0.5, "mid_point": 0.5, "euler": 1.0, "end_point": 0.0}

#: ``end_point`` is Eq. 7 as printed: the heading at the end of the step
SCHEMES: Final = tuple(_BEHIND)

#: steps a block: the arrays in use stay in the second-level cache; two threads take twice as many at a time, so that
#: they seldom wait for each other between two array functions
BLOCK: Final = 32768

#: steps from which on a second thread, and machine code, are worth their start
MANY_STEPS: Final = 1_000_000


def integrate(
    travel_left_m: npt.ArrayLike,
    travel_right_m: npt.ArrayLike,
    track_m: npt.ArrayLike,
    *,
    offsets: npt.ArrayLike | None = None,
    start: npt.ArrayLike = (0.0, 0.0, 0.0),
    scheme: str = "exact",
    out: Poses | None = None,
    threads: int | None = None,
    compiled: bool | None = None,
) -> Poses:
    """Integrate the travel of the rear wheels into poses.

    Parameters
    ----------
    travel_left_m, travel_right_m : array_like of float, shape (n,) or (runs, n)
        Travel of each wheel in each step: one log, a stack of runs of equal length, or, with `offsets`, runs of any
        length laid end to end. For a log of counter readings give 0 at a run's first sample: the poses then stand at
        the samples.
    track_m : array_like of float
        Distance of the rear wheels' contact points: a number, or anything that broadcasts to the travel's shape.
    offsets : array_like of int, shape (runs + 1,), optional
        Steps of run i stand at ``offsets[i]:offsets[i + 1]``; runs may be empty.
    start : array_like of float, shape (3,) or (runs, 3)
        Start pose (x in m, y in m, theta in rad), one for all or one a run.
    scheme : {"exact", "mid_point", "euler", "end_point"}
        How a step is drawn: as the arc of constant curvature; as a straight line at the heading in its middle, at its
        beginning, or at its end (Eq. 7 as printed).
    out : Poses, optional
        Contiguous arrays of the travel's shape to write to; new memory costs as much as the arithmetic.
    threads : {1, 2}, optional
        Work on both halves of the steps at once; None: where there are two processors, a million steps, and two runs
        to part. To cut a run costs one more pass, and its last digit depends on it.
    compiled : bool, optional
        Whether exact arcs are drawn by machine code (extra ``fast``), which gives the same poses to 1e-9 m; None: where
        it is installed and there are a million steps. Its first call in a process costs a second.

    Returns
    -------
    Poses
        Pose after each step, of the travel's shape.

    Raises
    ------
    BadInputError
        Where shapes do not fit or the scheme is not known.
    """
    _known(scheme)
    flat = lay_flat(travel_left_m, travel_right_m, track_m, offsets, start)
    n = len(flat.left)
    if out is None:
        out = Poses(np.empty(flat.shape), np.empty(flat.shape), np.empty(flat.shape))
    elif any(a.shape != flat.shape or not a.flags.c_contiguous for a in (out.x_m, out.y_m, out.theta_rad)):
        raise BadInputError(f"out: found arrays of shape {out.shape}; expected contiguous ones of shape {flat.shape}")
    x, y, theta = out.x_m.reshape(n), out.y_m.reshape(n), out.theta_rad.reshape(n)
    if threads is None:
        many = n >= MANY_STEPS and (os.cpu_count() or 1) > 1
        threads = 2 if many and cut(flat, BLOCK) in flat.starts else 1
    if compiled is None:
        compiled = n >= MANY_STEPS and is_installed()
    fill = compiled_fill if compiled and scheme == "exact" else partial(_fill, scheme=scheme, size=threads * BLOCK)
    if threads == 1 or n < 2:
        fill(flat, x, y, theta)
        return out
    middle = cut(flat, BLOCK)
    halves = ((before(flat, middle), slice(0, middle)), (after(flat, middle), slice(middle, n)))
    with ThreadPoolExecutor(2) as pool:
        waiting = [pool.submit(fill, part, x[where], y[where], theta[where]) for part, where in halves]
        for half in waiting:
            half.result()
        run = int(np.searchsorted(flat.starts, middle, side="right")) - 1
        if flat.starts[run] != middle:
            # the second half was driven from the origin: put it where the first one ended
            stop = int(flat.starts[run + 1]) if run + 1 < len(flat.starts) else n
            moved = [pool.submit(np.add, a[middle:stop], a[middle - 1], out=a[middle:stop]) for a in (x, y)]
            for done in moved:
                done.result()
    return out


def end_poses(
    travel_left_m: npt.ArrayLike,
    travel_right_m: npt.ArrayLike,
    track_m: npt.ArrayLike,
    *,
    offsets: npt.ArrayLike | None = None,
    start: npt.ArrayLike = (0.0, 0.0, 0.0),
    scheme: str = "exact",
) -> Poses:
    """Integrate the travel of the rear wheels and return the end pose of each run alone.

    Parameters and errors are those of `integrate`; an empty run ends where it starts.

    Returns
    -------
    Poses
        End poses, shape (runs,), or () for one log.
    """
    _known(scheme)
    flat = lay_flat(travel_left_m, travel_right_m, track_m, offsets, start)
    end = flat.pose.copy()
    for block in _walk(flat, BLOCK, scheme, None):
        runs = flat.runs[block.runs]
        end[0, runs] += block.sums(block.dx)
        end[1, runs] += block.sums(block.dy)
        end[2, runs] += block.turned
    if offsets is None and len(flat.shape) == 1:
        return Poses(end[0, 0], end[1, 0], end[2, 0])
    return Poses(end[0], end[1], end[2])


def _known(scheme: str) -> None:
    if scheme not in _BEHIND:
        raise BadInputError(f"scheme: found {scheme!r}; expected one of {', '.join(SCHEMES)}; choose one of them")


def _walk(flat: Flat, size: int, scheme: str, theta: FloatArray | None) -> Iterator[Block]:
    return blocks(flat, size, behind=_BEHIND[scheme], curved=scheme == "exact", theta=theta)


def _fill(flat: Flat, x: FloatArray, y: FloatArray, theta: FloatArray, *, size: int, scheme: str) -> None:
    """Write the poses of steps laid flat."""
    for block in _walk(flat, size, scheme, theta):
        block.running(flat, block.dx, 0, [(x[block.steps], WHOLE)])
        block.running(flat, block.dy, 1, [(y[block.steps], WHOLE)])


def loads_in_steps(run_N: npt.ArrayLike, logged_N: npt.ArrayLike | None, offsets: npt.ArrayLike) -> FloatArray:
    """Return the load of one wheel in the step that ends at each sample of runs laid end to end.

    Parameters
    ----------
    run_N : array_like of float, shape (runs,)
        Load of each run: it holds until its log says otherwise.
    logged_N : array_like of float, shape (n,), or None
        Load at each sample; NaN where the log does not say: the load before then stays.
    offsets : array_like of int, shape (runs + 1,)
        Samples of run i stand at ``offsets[i]:offsets[i + 1]``.

    Returns
    -------
    array of float, shape (n,)
        A load takes effect in the step after the sample that has it: the vehicle stands while it is loaded.
    """
    edges = np.asarray(offsets, dtype=np.int64)
    carried = np.repeat(np.asarray(run_N, dtype=np.float64), np.diff(edges))
    if logged_N is None:
        return carried
    logged = np.asarray(logged_N, dtype=np.float64)
    own = np.arange(len(carried))
    first = np.repeat(edges[:-1], np.diff(edges))
    # the last sample before this one, of the same run, that has a load
    last = np.maximum.accumulate(np.where(np.isfinite(logged), own, -1))
    last = np.where(own > first, np.concatenate(([-1], last[:-1])), -1)
    known = last >= first
    carried[known] = logged[last[known]]
    return carried


def radii_under_load(
    law: RadiusLaw, load_left_N: npt.ArrayLike, load_right_N: npt.ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Return the effective radii of both wheels for loads of any shape, in m: the block that Fig. 7 adds."""
    return law.left.radius_m(load_left_N), law.right.radius_m(load_right_N)


def radii_of_model(
    model: OdometryModel, load_left_N: npt.ArrayLike, load_right_N: npt.ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Return the radii that a simulator uses for loads of any shape, in m: its own slopes about its reference load."""
    left_N, right_N = np.asarray(load_left_N, dtype=np.float64), np.asarray(load_right_N, dtype=np.float64)
    return (
        np.asarray(model.radius_left_m + model.slope_left_m_per_N * (left_N - model.reference_load_N)),
        np.asarray(model.radius_right_m + model.slope_right_m_per_N * (right_N - model.reference_load_N)),
    )


def travel_from_counts(
    counts_left: npt.ArrayLike,
    counts_right: npt.ArrayLike,
    encoder: Encoder,
    radius_left_m: npt.ArrayLike,
    radius_right_m: npt.ArrayLike,
    *,
    offsets: npt.ArrayLike | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Return the travel of each wheel in the step that ends at each sample (Eqs 10 and 11).

    Parameters
    ----------
    counts_left, counts_right : array_like of float, shape (n,)
        Unwrapped counter readings of one run, or of runs laid end to end.
    encoder : Encoder
        Counts a revolution.
    radius_left_m, radius_right_m : array_like of float
        Radii: a number, one a run (with `offsets`), or one a sample.
    offsets : array_like of int, shape (runs + 1,), optional
        Samples of run i stand at ``offsets[i]:offsets[i + 1]``.

    Returns
    -------
    left_m, right_m : array of float, shape (n,)
        0 at the first sample of each run.
    """
    edges = np.asarray([0, len(np.atleast_1d(counts_left))] if offsets is None else offsets, dtype=np.int64)
    travels = []
    for counts, per_rev, radius in (
        (counts_left, encoder.counts_per_rev_left, radius_left_m),
        (counts_right, encoder.counts_per_rev_right, radius_right_m),
    ):
        values = np.asarray(counts, dtype=np.float64)
        travel = np.diff(values, prepend=values[:1])
        firsts = edges[:-1][np.diff(edges) > 0]
        travel[firsts] = 0.0
        wide = _wide(np.asarray(radius, dtype=np.float64), edges, len(values))
        travel *= (2 * np.pi / per_rev) * wide
        travels.append(travel)
    return travels[0], travels[1]


def _wide(radius: FloatArray, edges: IntArray, n: int) -> FloatArray:
    """Spread radii over samples."""
    if radius.ndim == 0 or len(radius) == n:
        return radius
    if len(radius) == len(edges) - 1:
        return np.repeat(radius, np.diff(edges))
    raise BadInputError(
        f"radii: found {len(radius)} values; expected one, one a run ({len(edges) - 1}) or one a sample ({n})"
    )
