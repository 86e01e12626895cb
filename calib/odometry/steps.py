"""Steps of odometry: exact arcs, and the schemes that approximate them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import factorial, sqrt
from typing import Final

import numpy as np
import numpy.typing as npt

from calib.errors import BadInputError
from calib.types import FloatArray, IntArray

#: sin(d/2)/d as a series in d^2: half the ratio of chord to arc for a turn of d
_SERIES: Final = tuple((-1) ** k / (2 ** (2 * k + 1) * factorial(2 * k + 1)) for k in range(12))

#: how many of its terms are good exactly up to which d
_TERMS: Final = ((3, 8e-3), (4, 4e-2), (5, 0.2), (7, 1.0), (9, 2.0), (12, 3.2))

#: turn up to which two terms do, if the second one bears its part of the third
_SMALL_RAD: Final = 1.2e-3

#: the third term, d^4 / 3840, as a multiple of d^2 that misses it least up to there: by 2e-16 of the path
_TWO: Final = (0.5, _SERIES[1] + 2.0 * (sqrt(2.0) - 1.0) * _SERIES[2] * _SMALL_RAD**2)


def sinc(u: npt.ArrayLike) -> FloatArray:
    """Return sin(u) / u, 1 at 0; any shape, u in rad: the ratio of chord to arc for a turn of 2 u."""
    return np.asarray(np.sinc(np.asarray(u, dtype=np.float64) / np.pi))


def shorten(path: FloatArray, turn: FloatArray, square: FloatArray, work: FloatArray, *, unit: float = 1.0) -> None:
    """Turn twice the length of arcs into the length of their chords, in place.

    Parameters
    ----------
    path : array of float, shape (n,)
        Twice the length of each arc in m; becomes the chord.
    turn : array of float, shape (n,)
        Turn of each arc, in units of `unit`.
    square, work : array of float, shape (n,)
        Overwritten.
    unit : float
        Unit of `turn` in rad.
    """
    np.square(turn, out=square)
    largest = float(square.max()) * unit * unit
    if largest <= _SMALL_RAD**2:
        square *= _TWO[1] * unit * unit
        square += _TWO[0]
        path *= square
        return
    for terms, limit in _TERMS:
        if largest <= limit * limit:
            series = [coefficient * unit ** (2 * k) for k, coefficient in enumerate(_SERIES[:terms])]
            np.multiply(square, series[-1], out=work)
            for coefficient in series[-2:0:-1]:
                work += coefficient
                work *= square
            work += series[0]
            path *= work
            return
    path *= 0.5 * sinc(0.5 * unit * turn)


@dataclass(slots=True, eq=False)
class Flat:
    """Steps of runs laid end to end, and how far the sums over them have come."""

    #: left, right: shape (n,): travel of the wheels in m
    left: FloatArray
    right: FloatArray
    per_m: FloatArray | None  #: shape (n,): one over the track; None where it is `unit` throughout
    unit: float  #: what the difference of the wheels' travel (times `per_m`) is multiplied by to give the turn
    #: starts, runs: shape (filled,): first step and number of each run that has steps
    starts: IntArray
    runs: IntArray
    pose: FloatArray  #: shape (3, n_runs): start poses
    shape: tuple[int, ...]  #: shape that the travel came in
    #: carried, rest: where x, y and theta stand before the next step, and what rounding omitted of that
    carried: list[float] = field(default_factory=lambda: [0.0] * 3)
    rest: list[float] = field(default_factory=lambda: [0.0] * 3)


def lay_flat(
    travel_left_m: npt.ArrayLike,
    travel_right_m: npt.ArrayLike,
    track_m: npt.ArrayLike,
    offsets: npt.ArrayLike | None,
    start: npt.ArrayLike,
) -> Flat:
    """Check the input and lay it flat.

    Parameters
    ----------
    travel_left_m, travel_right_m : array_like of float, shape (n,) or (runs, n)
        Travel of each wheel in each step.
    track_m : array_like of float
        Track; anything that broadcasts to the travel's shape.
    offsets : array_like of int, shape (runs + 1,), or None
        Where runs of unlike length begin and end.
    start : array_like of float, shape (3,) or (runs, 3)
        Start poses.

    Raises
    ------
    BadInputError
        Where shapes do not fit.
    """
    left = np.ascontiguousarray(travel_left_m, dtype=np.float64)
    right = np.ascontiguousarray(travel_right_m, dtype=np.float64)
    shape = left.shape
    if right.shape != shape or left.ndim not in (1, 2):
        raise BadInputError(
            f"travel: found shapes {shape} (left) and {right.shape} (right); expected the same, of one or two axes; "
            "give one value a step for each wheel"
        )
    track = np.asarray(track_m, dtype=np.float64)
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
    pose = np.asarray(start, dtype=np.float64)
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
        per_m=None if wide is None else 1.0 / wide,
        unit=1.0 / float(track.reshape(-1)[0]) if wide is None else 1.0,
        starts=edges[:-1][runs],
        runs=runs,
        pose=np.ascontiguousarray(np.broadcast_to(pose, (n_runs, 3)).T),
        shape=shape,
    )


def cut(flat: Flat, block: int) -> int:
    """Return where to cut the steps in two: between two runs where that halves the work fairly, else in the middle."""
    n = len(flat.left)
    middle = n // 2 // block * block or n // 2
    near = int(flat.starts[int(np.argmin(np.abs(flat.starts - middle)))])
    return near if near > 0 and abs(near - middle) < n // 16 else middle


def before(flat: Flat, step: int) -> Flat:
    """Return the steps before `step`."""
    keep = flat.starts < step
    return _piece(flat, slice(0, step), flat.starts[keep], flat.runs[keep], flat.pose)


def after(flat: Flat, step: int) -> Flat:
    """Return the steps from `step` on; a run that is cut goes on from the origin, with its heading."""
    run = int(np.searchsorted(flat.starts, step, side="right")) - 1
    pose = flat.pose
    if flat.starts[run] != step:
        head = slice(int(flat.starts[run]), step)
        if flat.per_m is None:
            turned = float(flat.right[head].sum() - flat.left[head].sum())
        else:
            turned = float((flat.right[head] - flat.left[head]) @ flat.per_m[head])
        pose = pose.copy()
        pose[:, flat.runs[run]] = 0.0, 0.0, pose[2, flat.runs[run]] + turned * flat.unit
    return _piece(flat, slice(step, len(flat.left)), np.maximum(flat.starts[run:] - step, 0), flat.runs[run:], pose)


def _piece(flat: Flat, part: slice, starts: IntArray, runs: IntArray, pose: FloatArray) -> Flat:
    return replace(
        flat,
        left=flat.left[part],
        right=flat.right[part],
        per_m=None if flat.per_m is None else flat.per_m[part],
        starts=starts,
        runs=runs,
        pose=pose,
        carried=[0.0] * 3,
        rest=[0.0] * 3,
    )
