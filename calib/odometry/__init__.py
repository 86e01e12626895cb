"""From counts and radii to poses: here odometry over arrays of runs, in numpy or machine code (numba, extra `fast`).

Headings count from the first of a few steps, so that a short series gives sine and cosine.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from calib.errors import BadInputError
from calib.odometry.poses import Poses, sinc
from calib.types import FloatArray, IntArray, floats

#: scheme -> share of a step's turn by which the heading used lies behind that at its end
HEADING_BEHIND: Final = {"exact": 0.5, "mid_point": 0.5, "euler": 1.0, "end_point": 0.0}

SCHEMES: Final = tuple(HEADING_BEHIND)

#: steps worth machine code
MANY_STEPS: Final = 1_000_000
#: steps a block: its arrays stay in the cache, and no BLAS starts threads
BLOCK: Final = 16_384

#: turn up to which three terms of sin(u) / u hold to 2e-16
_SMALL_TURN_RAD: Final = 0.02

#: steps summed by one row of a product
_ROW: Final = 16
_ONES: Final = np.ones(_ROW)
_TRIANGLE: Final = np.triu(np.ones((_ROW, _ROW)))


@dataclass(frozen=True, slots=True, eq=False)
class _Flat:
    #: shape (n,): travel of the wheels, runs end to end
    left: FloatArray
    right: FloatArray
    per_m: FloatArray  #: shape (n,) or (1,): one over the track
    #: shape (filled,): first step and number of each run that has steps
    starts: IntArray
    runs: IntArray
    pose: FloatArray  #: shape (3, n_runs): start poses
    shape: tuple[int, ...]


def _fill_arrays(flat: _Flat, x: FloatArray, y: FloatArray, theta: FloatArray, *, scheme: str) -> None:
    n = len(flat.left)
    buffers = np.empty((4, min(BLOCK, n)))
    edges = np.append(np.arange(0, n, BLOCK), n)
    first_runs = np.searchsorted(flat.starts, edges[:-1], side="right") - 1
    last_runs = np.searchsorted(flat.starts, edges[1:], side="left")
    for first, last, k0, k1 in zip(edges[:-1].tolist(), edges[1:].tolist(), first_runs, last_runs, strict=True):
        steps = slice(first, last)
        begins = flat.starts[k0:k1] - first
        pose = flat.pose[:, flat.runs[k0:k1]]
        if begins[0] < 0:
            begins[0], pose[:, 0] = 0, (x[first - 1], y[first - 1], theta[first - 1])
        turn, path, angle, work = buffers[:, : last - first]
        left, right = flat.left[steps], flat.right[steps]
        np.subtract(right, left, out=turn)
        turn *= flat.per_m[steps] if len(flat.per_m) > 1 else flat.per_m
        np.add(left, right, out=path)
        path *= 0.5
        if scheme == "exact":
            _shorten(path, turn, angle, work)
        np.multiply(turn, -HEADING_BEHIND[scheme], out=angle)
        heading = theta[steps]
        _running(turn, begins, pose[2], heading)
        angle += heading
        # with t = tan(a / 2): cos a = 2 / (1 + t^2) - 1 and sin a = 2 t / (1 + t^2)
        angle *= 0.5
        tangent = np.tan(angle, out=angle)
        np.multiply(tangent, tangent, out=work)
        work += 1.0
        np.divide(path, work, out=work)
        work *= 2.0
        tangent *= work
        work -= path
        _running(work, begins, pose[0], x[steps])
        _running(tangent, begins, pose[1], y[steps])


def _shorten(path: FloatArray, turn: FloatArray, square: FloatArray, work: FloatArray) -> None:
    # arc lengths (n,) to chords in place; the last two arrays are overwritten
    np.multiply(turn, turn, out=square)
    if float(square.max()) <= _SMALL_TURN_RAD**2:
        np.multiply(square, 1.0 / 1920.0, out=work)
        work -= 1.0 / 24.0
        work *= square
        work += 1.0
        path *= work
    else:
        path *= sinc(0.5 * turn)


def _running(steps: FloatArray, begins: IntArray, start: FloatArray, out: FloatArray) -> None:
    if len(begins) > 1:
        ends = start + np.add.reduceat(steps, begins)
        steps[begins[1:]] += start[1:] - ends[:-1]
    steps[0] += start[0]
    if len(steps) % _ROW == 0:
        rows = steps.reshape(-1, _ROW)
        totals = np.cumsum(rows @ _ONES)
        # a product would spread a NaN over its row
        if np.isfinite(totals[-1]):
            rows[1:, 0] += totals[:-1]
            np.dot(rows, _TRIANGLE, out=out.reshape(-1, _ROW))
            return
    np.cumsum(steps, out=out)


_COUNT: Final = 64

#: sum of these steps' half turns up to which the series do
_SMALL_HALVES_RAD: Final = 0.125

#: coefficients of sin(u)/u and cos(u) by the square of u, after the first
_SINE: Final = (-1 / 6, 1 / 120, -1 / 5040, 1 / 362_880, -1 / 39_916_800)
_COSINE: Final = (-1 / 2, 1 / 24, -1 / 720, 1 / 40_320, -1 / 3_628_800)


@cache
def is_installed() -> bool:
    """Return whether numba is there; it is not imported."""
    return find_spec("numba") is not None


@cache
def _machine_code() -> Callable[..., None]:
    import numba

    try:
        loop: Any = numba.njit(nogil=True, cache=True, error_model="numpy")(_loop)
    except RuntimeError:
        loop = numba.njit(nogil=True, error_model="numpy")(_loop)
    return loop  # type: ignore[no-any-return]


def _loop(
    travel: tuple[FloatArray, FloatArray],
    per_m: FloatArray,
    starts: Any,
    pose: FloatArray,
    out: tuple[FloatArray, FloatArray, FloatArray],
) -> None:
    left, right = travel
    x, y, theta = out
    varies = len(per_m) > 1
    halves, middle, dx, dy = np.empty(_COUNT), np.empty(_COUNT), np.empty(_COUNT), np.empty(_COUNT)
    for run in range(len(starts)):
        stop = starts[run + 1] if run + 1 < len(starts) else len(left)
        so_far, carry = pose[:, run].copy(), np.zeros(3)
        for first in range(starts[run], stop, _COUNT):
            count = min(_COUNT, stop - first)
            at_x, at_y, at_theta = so_far[0] + carry[0], so_far[1] + carry[1], so_far[2] + carry[2]
            turned = largest = 0.0
            for k in range(count):
                half = 0.5 * (right[first + k] - left[first + k]) * per_m[first + k if varies else 0]
                halves[k] = half
                middle[k] = turned + half
                turned += 2.0 * half
                theta[first + k] = at_theta + turned
                largest = max(largest, abs(half))
            cos, sin = math.cos(at_theta), math.sin(at_theta)
            if largest * _COUNT <= _SMALL_HALVES_RAD:
                for k in range(count):
                    u = halves[k] * halves[k]
                    chord = 0.5 * (left[first + k] + right[first + k]) * (1.0 + u * (_SINE[0] + u * _SINE[1]))
                    u = middle[k] * middle[k]
                    sine = _SINE[2] + u * (_SINE[3] + u * _SINE[4])
                    sine = middle[k] * (1.0 + u * (_SINE[0] + u * (_SINE[1] + u * sine)))
                    cosine = _COSINE[2] + u * (_COSINE[3] + u * _COSINE[4])
                    cosine = 1.0 + u * (_COSINE[0] + u * (_COSINE[1] + u * cosine))
                    dx[k] = chord * (cos * cosine - sin * sine)
                    dy[k] = chord * (sin * cosine + cos * sine)
            else:
                for k in range(count):
                    chord = 0.5 * (left[first + k] + right[first + k])
                    if halves[k] != 0.0:
                        chord *= math.sin(halves[k]) / halves[k]
                    dx[k] = chord * math.cos(at_theta + middle[k])
                    dy[k] = chord * math.sin(at_theta + middle[k])
            gone_x = gone_y = 0.0
            for k in range(count):
                gone_x += dx[k]
                gone_y += dy[k]
                x[first + k] = at_x + gone_x
                y[first + k] = at_y + gone_y
            for j, gone in enumerate((gone_x, gone_y, turned)):
                # with its rounding (Neumaier): equal steps add up no bias
                ahead, before = so_far[j] + gone, so_far[j]
                carry[j] += (before - ahead) + gone if abs(before) >= abs(gone) else (gone - ahead) + before
                so_far[j] = ahead


def _laid_flat(
    travel_left_m: ArrayLike, travel_right_m: ArrayLike, track_m: ArrayLike, offsets: ArrayLike | None, start: ArrayLike
) -> _Flat:
    left = np.ascontiguousarray(travel_left_m, dtype=np.float64)
    right = np.ascontiguousarray(travel_right_m, dtype=np.float64)
    shape = left.shape
    if right.shape != shape or left.ndim not in (1, 2):
        text = f"travel: found shapes {shape} (left) and {right.shape} (right)"
        raise BadInputError(f"{text}; expected the same, of one or two axes; give one value a step for each wheel")
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
        track = track if track.size == 1 else np.ascontiguousarray(np.broadcast_to(track, shape))
    except ValueError:
        raise BadInputError(f"track: found shape {track.shape}; expected one that broadcasts to {shape}") from None
    runs, pose = np.flatnonzero(np.diff(edges) > 0), np.ascontiguousarray(np.broadcast_to(pose, (n_runs, 3)).T)
    travel = left.reshape(-1), right.reshape(-1)
    return _Flat(*travel, 1.0 / track.reshape(-1), edges[:-1][runs], runs, pose, shape)


def integrate(
    travel_left_m: ArrayLike,
    travel_right_m: ArrayLike,
    track_m: ArrayLike,
    *,
    offsets: ArrayLike | None = None,
    start: ArrayLike = (0.0, 0.0, 0.0),
    scheme: str = "exact",
    out: Poses | None = None,
    compiled: bool | None = None,
) -> Poses:
    """Integrate the travel of the rear wheels into the pose after each step, of the travel's shape.

    Raises BadInputError where shapes do not fit or the scheme is not known.

    Parameters
    ----------
    travel_left_m, travel_right_m : array_like of float, shape (n,) or (runs, n)
        Travel in each step, 0 at a run's first sample: one log, runs of equal length, or, with `offsets`, end to end.
    track_m : array_like of float
        Distance of the rear wheels' contact points; broadcasts to the travel's shape.
    offsets : array_like of int, shape (runs + 1,), optional
        Steps of run i stand at ``offsets[i]:offsets[i + 1]``; runs may be empty.
    start : array_like of float, shape (3,) or (runs, 3)
        Start pose (x in m, y in m, theta in rad), one for all or one a run.
    scheme : {"exact", "mid_point", "euler", "end_point"}
        A step is an arc; or a line at the heading in its middle, at its beginning, or at its end (Eq. 7 as printed).
    out : Poses, optional
        Contiguous arrays of the travel's shape to write to.
    compiled : bool, optional
        Whether machine code (extra ``fast``) draws exact arcs; None: where installed, from `MANY_STEPS` on.
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
    poses = [part.reshape(n) for part in (out.x_m, out.y_m, out.theta_rad)]
    if compiled and scheme == "exact":
        starts = np.ascontiguousarray(flat.pose[:, flat.runs])
        _machine_code()((flat.left, flat.right), flat.per_m, flat.starts, starts, tuple(poses))
    else:
        _fill_arrays(flat, *poses, scheme=scheme)
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
    poses = integrate(travel_left_m, travel_right_m, track_m, offsets=offsets, start=start, scheme=scheme)
    end = flat.pose.copy()
    if len(flat.runs):
        last = np.append(flat.starts[1:], len(flat.left)) - 1
        end[:, flat.runs] = [part.reshape(-1)[last] for part in (poses.x_m, poses.y_m, poses.theta_rad)]
    if offsets is None and len(flat.shape) == 1:
        return Poses(end[0, 0], end[1, 0], end[2, 0])
    return Poses(end[0], end[1], end[2])
