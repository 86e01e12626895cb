"""Odometry over whole logs as arrays: wheel travel in, poses out (Eqs 7 to 9)."""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Final

import numpy as np
import numpy.typing as npt

from calib.arrays import FloatArray
from calib.errors import BadInputError
from calib.motion.odometry.blocks import WHOLE, Block, blocks
from calib.motion.odometry.numba_loop import compiled_fill, is_installed
from calib.motion.odometry.steps import Flat, after, before, cut, lay_flat
from calib.motion.poses import Poses

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
