"""The coefficients of a line through runs in sessions, with their covariance by stratum and what follows from it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from calib.arrays import FloatArray
from calib.radius.welch import critical_value, equivalent_dof


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """Coefficients (radius at x = 0, slope) and their covariance by stratum."""

    #: ``crossed`` (slope from within sessions), ``confounded`` (slope from session means only), ``mixed``, ``single``
    #: (one session, or sessions that cannot be told from runs) or ``constant`` (no slope)
    design: str
    #: radius at the reference load and slope, shape (2,)
    coefficients: FloatArray
    #: parts of the covariance that come from the scatter of runs and of sessions, shape (2, 2), which add up to the
    #: covariance, and the degrees of freedom of each; 0 where it has none
    cov_within: FloatArray
    dof_within: float
    cov_between: FloatArray
    dof_between: float
    #: estimated variances of runs within a session and of sessions (0 where negative)
    run_variance: float
    session_variance: float
    #: ratio of the two mean squares; F(dof_between, dof_within) where sessions do not scatter
    session_f: float | None
    #: whether the within part is heteroscedasticity-consistent (HC3)
    robust: bool
    #: what each source that is the same in every run does to the coefficients, times its standard uncertainty, shape
    #: (n_sources, 2), and the degrees of freedom behind each
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

        `contrast` (shape (..., 2)): for example (1, 0) for the radius and (0, 1) for the slope. `within`, `between`
        (shape (...)).
        """
        c = np.asarray(contrast, dtype=np.float64)
        within = np.einsum("...i,ij,...j->...", c, self.cov_within, c)
        between = np.einsum("...i,ij,...j->...", c, self.cov_between, c)
        return np.maximum(within, 0.0), np.maximum(between, 0.0)

    def half_width(
        self, contrast: npt.ArrayLike, coverage: float, *, more_within: float = 0.0, more_between: float = 0.0
    ) -> FloatArray:
        """Return the half width of the interval of ``contrast @ coefficients``, shape (...); see `parts`.

        `contrast` (shape (..., 2)): what is wanted of the coefficients; `coverage`: coverage of the interval;
        `more_within`, `more_between`: variances of a further run and session, for a prediction.
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


def of_one_stratum(
    design: str, coefficients: FloatArray, covariance: FloatArray, dof: float, variance: float, *, robust: bool = False
) -> Estimate:
    """Return an estimate in which every run counts as independent: nothing between sessions; see `Estimate`."""
    return Estimate(design, coefficients, covariance, dof, np.zeros((2, 2)), 0.0, variance, 0.0, None, robust)
