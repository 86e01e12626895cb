"""Odometry of logged counts, with constant radii or radii that follow the load during the run (Fig. 7)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from calib.arrays import FloatArray, IntArray
from calib.campaign.settings import Encoder, OdometryModel
from calib.errors import BadInputError
from calib.radius.law import RadiusLaw


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
