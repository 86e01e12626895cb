"""The coefficients of a line through runs in sessions, with their covariance by stratum and what follows from it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from calib.arrays import FloatArray
from calib.radius.welch import critical_value, equivalent_dof


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """Coefficients (radius at x = 0, slope) and their covariance by stratum.

    Parameters
    ----------
    design : str
        ``crossed`` (slope from within sessions), ``confounded`` (slope from session means only), ``mixed``, ``single``
        (one session, or sessions that cannot be told from runs) or ``constant`` (no slope).
    coefficients : array of float, shape (2,)
        Radius at the reference load and slope.
    cov_within, cov_between : array of float, shape (2, 2)
        Parts of the covariance that come from the scatter of runs and of sessions; their sum is the covariance.
    dof_within, dof_between : float
        Degrees of freedom of each part; 0 where it has none.
    run_variance, session_variance : float
        Estimated variances of runs within a session and of sessions (0 where negative).
    session_f : float or None
        Ratio of the two mean squares; F(dof_between, dof_within) where sessions do not scatter.
    robust : bool
        Whether the within part is heteroscedasticity-consistent (HC3).
    systematic : array of float, shape (n_sources, 2)
        What each source that is the same in every run does to the coefficients, times its standard uncertainty.
    systematic_dof : array of float, shape (n_sources,)
        Degrees of freedom behind each of these.
    """

    design: str
    coefficients: FloatArray
    cov_within: FloatArray
    dof_within: float
    cov_between: FloatArray
    dof_between: float
    run_variance: float
    session_variance: float
    session_f: float | None
    robust: bool
    systematic: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    systematic_dof: FloatArray = field(default_factory=lambda: np.zeros(0))

    @property
    def cov_systematic(self) -> FloatArray:
        """Part of the covariance that no number of runs makes smaller, shape (2, 2)."""
        return np.asarray(self.systematic.T @ self.systematic)

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the coefficients, shape (2, 2)."""
        return np.asarray(self.cov_within + self.cov_between + self.cov_systematic)

    def _systematic_half(self, contrast: npt.ArrayLike, coverage: float) -> FloatArray:
        """Return the half width that the systematic sources alone give ``contrast @ coefficients``, shape (...)."""
        from scipy.special import stdtrit

        each = np.asarray(contrast, dtype=np.float64) @ self.systematic.T
        # in place of infinitely many: Student's t is then normal to six digits
        factor = stdtrit(np.minimum(self.systematic_dof, 1e6), 0.5 + coverage / 2)
        return np.asarray(np.sqrt(np.sum((each * factor) ** 2, axis=-1)))

    def parts(self, contrast: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the within and between parts of the variance of ``contrast @ coefficients``.

        Parameters
        ----------
        contrast : array_like, shape (..., 2)
            For example (1, 0) for the radius and (0, 1) for the slope.

        Returns
        -------
        within, between : array of float, shape (...)
        """
        c = np.asarray(contrast, dtype=np.float64)
        within = np.einsum("...i,ij,...j->...", c, self.cov_within, c)
        between = np.einsum("...i,ij,...j->...", c, self.cov_between, c)
        return np.maximum(within, 0.0), np.maximum(between, 0.0)

    def half_width(
        self, contrast: npt.ArrayLike, coverage: float, *, more_within: float = 0.0, more_between: float = 0.0
    ) -> FloatArray:
        """Return the half width of the interval of ``contrast @ coefficients``, shape (...); see `parts`.

        Parameters
        ----------
        contrast : array_like, shape (..., 2)
            What is wanted of the coefficients.
        coverage : float
            Coverage of the interval.
        more_within, more_between : float
            Variances of a further run and session, for a prediction.
        """
        within, between = self.parts(contrast)
        within, between = within + more_within, between + more_between
        total = within + between
        share = np.where(total > 0, between / np.where(total > 0, total, 1.0), 0.0)
        random = critical_value(share, self.dof_between, self.dof_within, coverage) * np.sqrt(total)
        return (
            np.asarray(np.hypot(random, self._systematic_half(contrast, coverage))) if len(self.systematic) else random
        )

    def dof(self, contrast: npt.ArrayLike, coverage: float = 0.95) -> FloatArray:
        """Return the degrees of freedom whose Student's t gives `half_width`, shape (...)."""
        within, between = self.parts(contrast)
        total = within + between
        if len(self.systematic):
            c = np.asarray(contrast, dtype=np.float64)
            std = np.sqrt(total + np.einsum("...i,ij,...j->...", c, self.cov_systematic, c))
            return equivalent_dof(self.half_width(contrast, coverage) / np.where(std > 0, std, 1.0), coverage)
        share = np.where(total > 0, between / np.where(total > 0, total, 1.0), 0.0)
        critical = critical_value(share, self.dof_between, self.dof_within, coverage)
        dof = equivalent_dof(critical, coverage)
        # pure parts to the last digit
        dof = np.where(share <= 0, self.dof_within, dof)
        return np.where(share >= 1, self.dof_between, dof)
