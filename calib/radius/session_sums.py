"""Sums over the runs of sessions, from which a line follows: a fleet adds runs to them and reads none again.

The estimator of `calib.radius.sessions` needs of the runs of a session only their number and the sums of loads, radii,
their squares and products. Only HC3 needs the runs themselves.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.radius.law import LineEstimate
from calib.radius.sessions import Strata, line_of_strata
from calib.types import FloatArray, StrArray

#: sums of squares counted from a reference load count as zero below this share: rounding
ROUNDING: Final = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class SessionSums:
    """Sums over the runs of each session, for one wheel."""

    #: labels, each once, in order, shape (n_sessions,)
    session: StrArray
    #: number of runs; sums of load, radius, load squared, load times radius, radius squared, day, and day squared.
    #: Loads are counted from a reference load (N), radii from a nominal radius (m), days from any common day, shape
    #: (n_sessions, 8)
    table: FloatArray
    #: span of the loads, counted from the same reference load; inf and -inf where there are no runs
    load_min_N: float
    load_max_N: float

    @staticmethod
    def from_runs(session: StrArray, load_N: FloatArray, radius_m: FloatArray, day: FloatArray) -> SessionSums:
        """Return the sums of runs, each argument of shape (n_runs,)."""
        labels, index = np.unique(session, return_inverse=True)
        ones = np.ones_like(load_N)
        terms = (ones, load_N, radius_m, load_N**2, load_N * radius_m, radius_m**2, day, day**2)
        table = np.stack([np.bincount(index, term, len(labels)) for term in terms], axis=1).astype(np.float64)
        return SessionSums(labels, table, float(load_N.min(initial=np.inf)), float(load_N.max(initial=-np.inf)))

    def added(self, other: SessionSums) -> SessionSums:
        """Return the sums of both, sessions of the same label as one."""
        labels, index = np.unique(np.concatenate([self.session, other.session]), return_inverse=True)
        table = np.zeros((len(labels), self.table.shape[1]))
        np.add.at(table, index, np.concatenate([self.table, other.table]))
        low = min(self.load_min_N, other.load_min_N)
        return SessionSums(labels, table, low, max(self.load_max_N, other.load_max_N))

    @property
    def n_runs(self) -> float:
        """Number of runs."""
        return float(self.table[:, 0].sum())

    @property
    def means(self) -> FloatArray:
        """Mean load, radius and day of each session, shape (n_sessions, 3)."""
        return np.asarray(self.table[:, [1, 2, 6]] / self.table[:, :1])

    @property
    def within(self) -> FloatArray:
        """Sums of squares within sessions: of load, of load times radius, of radius, shape (3,)."""
        n, x, y, xx, xy, yy = self.table[:, :6].T
        return np.array([(xx - x * x / n).sum(), (xy - x * y / n).sum(), (yy - y * y / n).sum()])


def line_from_sums(sums: SessionSums) -> LineEstimate | None:
    """Return the session-aware line, or None where these runs cannot carry one.

    As `stratified_line` gives it, without HC3; the plain line where there is one session, or one
    run a session. None with fewer than three runs or a single load.
    """
    n, n_sessions = sums.n_runs, len(sums.session)
    if n < 3:
        return None
    if not 2 <= n_sessions < n:
        return _plain(sums)
    x_mean, y_mean, _ = sums.means.T
    info, cross, square = sums.within
    if not info + float(np.ptp(x_mean)) ** 2 > ROUNDING * max(float(sums.table[:, 3].sum()), 1.0):
        return None
    slope = cross / info if info > 0 else 0.0
    strata = Strata(sums.table[:, 0], x_mean, y_mean, info, slope, square, max(square - slope * cross, 0.0))
    return line_of_strata(strata) or _plain(sums)


def _plain(sums: SessionSums) -> LineEstimate | None:
    """Return the least-squares line, every run counted as independent; None with a single load."""
    n, x, y, xx, xy, yy = sums.table[:, :6].sum(axis=0)
    info = xx - x * x / n
    if n < 3 or not info > ROUNDING * max(xx, 1.0):
        return None
    slope = (xy - x * y / n) / info
    variance = max(yy - y * y / n - slope * (xy - x * y / n), 0.0) / (n - 2)
    mean = x / n
    covariance = variance * (np.array([[mean**2, -mean], [-mean, 1.0]]) / info + np.diag([1.0 / n, 0.0]))
    coefficients = np.array([y / n - slope * mean, slope])
    return LineEstimate.one_stratum("single", coefficients, covariance, float(n - 2), float(variance))
