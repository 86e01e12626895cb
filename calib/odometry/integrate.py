"""Odometry over arrays of runs: from wheel travel to poses, with radii that follow the load."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from calib.campaign.settings import Encoder, OdometryModel
from calib.errors import BadInputError
from calib.odometry.poses import Poses
from calib.odometry.step_loops import HEADING_BEHIND, Flat, fill_arrays, is_installed, machine_code
from calib.radius.law import RadiusLaw
from calib.types import FloatArray, IntArray, floats

#: ``end_point`` is Eq. 7 as printed: the heading at the end of the step
SCHEMES: Final = tuple(HEADING_BEHIND)

#: steps from which on a second thread, and machine code, are worth their start
MANY_STEPS: Final = 1_000_000


def _laid_flat(
    travel_left_m: ArrayLike, travel_right_m: ArrayLike, track_m: ArrayLike, offsets: ArrayLike | None, start: ArrayLike
) -> Flat:
    """Return the steps of `integrate` laid flat; raises BadInputError where shapes do not fit."""
    left = np.ascontiguousarray(travel_left_m, dtype=np.float64)
    right = np.ascontiguousarray(travel_right_m, dtype=np.float64)
    shape = left.shape
    if right.shape != shape or left.ndim not in (1, 2):
        raise BadInputError(
            f"travel: found shapes {shape} (left) and {right.shape} (right); expected the same, of one or two axes; "
            "give one value a step for each wheel"
        )
    track = floats(track_m)
    if offsets is not None:
        edges = np.asarray(offsets, dtype=np.int64)
        if left.ndim != 1 or len(edges) < 1 or edges[0] != 0 or edges[-1] != len(left) or (np.diff(edges) < 0).any():
            raise BadInputError(
                f"offsets: found {len(edges)} values for travel of shape {shape}; expected rising values from 0 to the "
                "number of steps of a flat array; lay the runs end to end"
            )
    elif left.ndim == 2:
        edges = np.arange(shape[0] + 1, dtype=np.int64) * shape[1]
    else:
        edges = np.array([0, len(left)], dtype=np.int64)
    n_runs = len(edges) - 1
    pose = floats(start)
    if pose.shape not in {(3,), (n_runs, 3)}:
        raise BadInputError(f"start: found shape {pose.shape}; expected (3,) or ({n_runs}, 3); give x, y, theta")
    try:
        wide = None if track.size == 1 else np.ascontiguousarray(np.broadcast_to(track, shape)).reshape(-1)
    except ValueError:
        raise BadInputError(f"track: found shape {track.shape}; expected one that broadcasts to {shape}") from None
    runs = np.flatnonzero(np.diff(edges) > 0)
    return Flat(
        left=left.reshape(-1),
        right=right.reshape(-1),
        per_m=1.0 / (track.reshape(1) if wide is None else wide),
        starts=edges[:-1][runs],
        runs=runs,
        pose=np.ascontiguousarray(np.broadcast_to(pose, (n_runs, 3)).T),
        shape=shape,
    )


def _halved(flat: Flat) -> tuple[Flat, ...]:
    """Return the steps in two parts, cut between two runs; whole where no such cut halves the work fairly."""
    middle = len(flat.left) // 2
    run = int(np.argmin(np.abs(flat.starts - middle))) if len(flat.starts) else 0
    step = int(flat.starts[run]) if run else 0
    if not run or abs(step - middle) >= len(flat.left) // 16:
        return (flat,)
    return tuple(
        replace(
            flat,
            left=flat.left[steps],
            right=flat.right[steps],
            per_m=flat.per_m[steps] if len(flat.per_m) > 1 else flat.per_m,
            starts=flat.starts[runs] - (steps.start or 0),
            runs=flat.runs[runs],
        )
        for steps, runs in ((slice(0, step), slice(0, run)), (slice(step, None), slice(run, None)))
    )


def _fill_compiled(flat: Flat, x: FloatArray, y: FloatArray, theta: FloatArray) -> None:
    pose = np.ascontiguousarray(flat.pose[:, flat.runs])
    machine_code()((flat.left, flat.right), flat.per_m, flat.starts, pose, (x, y, theta))


def integrate(
    travel_left_m: ArrayLike,
    travel_right_m: ArrayLike,
    track_m: ArrayLike,
    *,
    offsets: ArrayLike | None = None,
    start: ArrayLike = (0.0, 0.0, 0.0),
    scheme: str = "exact",
    out: Poses | None = None,
    threads: int | None = None,
    compiled: bool | None = None,
) -> Poses:
    """Integrate the travel of the rear wheels into the pose after each step, of the travel's shape.

    Raises BadInputError where shapes do not fit or the scheme is not known.

    Parameters
    ----------
    travel_left_m, travel_right_m : array_like of float, shape (n,) or (runs, n)
        Travel of each wheel in each step: one log, a stack of runs of equal length, or, with `offsets`, runs of any
        length laid end to end. With 0 at a run's first sample the poses stand at the samples.
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
        Work on both halves of the runs at once; None: where there are two processors and `MANY_STEPS`.
    compiled : bool, optional
        Whether exact arcs are drawn by machine code (extra ``fast``), which gives the same poses to 1e-9 m; None: where
        it is installed and there are `MANY_STEPS`. Its first call in a process costs a second.
    """
    flat = _laid_flat(travel_left_m, travel_right_m, track_m, offsets, start)
    n = len(flat.left)
    if out is None:
        out = Poses(np.empty(flat.shape), np.empty(flat.shape), np.empty(flat.shape))
    elif any(a.shape != flat.shape or not a.flags.c_contiguous for a in (out.x_m, out.y_m, out.theta_rad)):
        raise BadInputError(f"out: found arrays of shape {out.shape}; expected contiguous ones of shape {flat.shape}")
    if scheme not in HEADING_BEHIND:
        raise BadInputError(f"scheme: found {scheme!r}; expected one of {', '.join(SCHEMES)}; choose one of them")
    if compiled is None:
        compiled = n >= MANY_STEPS and is_installed()
    if threads is None:
        threads = 2 if n >= MANY_STEPS and (os.cpu_count() or 1) > 1 else 1
    fill = _fill_compiled if compiled and scheme == "exact" else partial(fill_arrays, scheme=scheme)
    halves = _halved(flat) if threads == 2 else (flat,)
    middle = len(halves[0].left)
    x, y, theta = (part.reshape(n) for part in (out.x_m, out.y_m, out.theta_rad))
    with ThreadPoolExecutor(2) as pool:
        places = zip(halves, (slice(0, middle), slice(middle, n)), strict=False)
        waiting = [pool.submit(fill, half, x[where], y[where], theta[where]) for half, where in places]
        for half in waiting:
            half.result()
    return out


def end_poses(
    travel_left_m: ArrayLike,
    travel_right_m: ArrayLike,
    track_m: ArrayLike,
    *,
    offsets: ArrayLike | None = None,
    start: ArrayLike = (0.0, 0.0, 0.0),
    scheme: str = "exact",
) -> Poses:
    """Return the end pose of each run alone, shape (runs,), or () for one log.

    Parameters and errors are those of `integrate`; an empty run ends where it starts.
    """
    flat = _laid_flat(travel_left_m, travel_right_m, track_m, offsets, start)
    poses = integrate(travel_left_m, travel_right_m, track_m, offsets=offsets, start=start, scheme=scheme, threads=1)
    end = flat.pose.copy()
    if len(flat.runs):
        last = np.append(flat.starts[1:], len(flat.left)) - 1
        end[:, flat.runs] = [part.reshape(-1)[last] for part in (poses.x_m, poses.y_m, poses.theta_rad)]
    if offsets is None and len(flat.shape) == 1:
        return Poses(end[0, 0], end[1, 0], end[2, 0])
    return Poses(end[0], end[1], end[2])


def loads_in_steps(run_N: ArrayLike, logged_N: ArrayLike | None, offsets: ArrayLike) -> FloatArray:
    """Return the load of one wheel in the step that ends at each sample of runs laid end to end.

    A load takes effect in the step after the sample that has it: the vehicle stands while it is loaded. That of the run
    (`run_N`) holds until its log (`logged_N`) says otherwise, a load of the log until the next; NaN is none.
    """
    edges = np.asarray(offsets, dtype=np.int64)
    carried = np.repeat(floats(run_N), np.diff(edges))
    if logged_N is None:
        return carried
    logged = floats(logged_N)
    own = np.arange(len(carried))
    first = np.repeat(edges[:-1], np.diff(edges))
    # the last sample before this one, of the same run, that has a load
    last = np.maximum.accumulate(np.where(np.isfinite(logged), own, -1))
    last = np.where(own > first, np.concatenate(([-1], last[:-1])), -1)
    known = last >= first
    carried[known] = logged[last[known]]
    return carried


def radii_under_load(law: RadiusLaw, load_left_N: ArrayLike, load_right_N: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return the effective radii of both wheels for loads of any shape, in m: the block that Fig. 7 adds."""
    return law.left.radius_m(load_left_N), law.right.radius_m(load_right_N)


def radii_of_model(
    model: OdometryModel, load_left_N: ArrayLike, load_right_N: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Return the radii that a simulator uses for loads of any shape, in m: its own slopes about its reference load."""
    left_N, right_N = floats(load_left_N), floats(load_right_N)
    return (
        np.asarray(model.radius_left_m + model.slope_left_m_per_N * (left_N - model.reference_load_N)),
        np.asarray(model.radius_right_m + model.slope_right_m_per_N * (right_N - model.reference_load_N)),
    )


def travel_from_counts(
    counts_left: ArrayLike,
    counts_right: ArrayLike,
    encoder: Encoder,
    radius_left_m: ArrayLike,
    radius_right_m: ArrayLike,
    *,
    offsets: ArrayLike | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Return the travel of each wheel in the step that ends at each sample (Eqs 10 and 11), 0 at the first of each run.

    `counts_left`, `counts_right`: unwrapped counter readings (n,) of one run, or of runs laid end to end by `offsets`,
    see `integrate`; radii: a number, one a run, or one a sample.
    """
    edges = np.asarray([0, len(np.atleast_1d(counts_left))] if offsets is None else offsets, dtype=np.int64)
    travels = []
    for counts, per_rev, radius in (
        (counts_left, encoder.counts_per_rev_left, radius_left_m),
        (counts_right, encoder.counts_per_rev_right, radius_right_m),
    ):
        values = floats(counts)
        travel = np.diff(values, prepend=values[:1])
        firsts = edges[:-1][np.diff(edges) > 0]
        travel[firsts] = 0.0
        travel *= (2 * np.pi / per_rev) * _wide(floats(radius), edges, len(values))
        travels.append(travel)
    return travels[0], travels[1]


def _wide(radius: FloatArray, edges: IntArray, n: int) -> FloatArray:
    if radius.ndim == 0 or len(radius) == n:
        return radius
    if len(radius) == len(edges) - 1:
        return np.repeat(radius, np.diff(edges))
    raise BadInputError(
        f"radii: found {len(radius)} values; expected one, one a run ({len(edges) - 1}) or one a sample ({n})"
    )
