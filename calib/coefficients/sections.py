"""The sections of the coefficient file; see `calib.coefficients.quantities` for their numbers."""

from __future__ import annotations

from typing import Annotated, Final, Self

import numpy as np
from pydantic import Field, model_validator

from calib.campaign.settings import OdometrySource
from calib.coefficients import quantities
from calib.coefficients.quantities import Force, Length, Measured, Number, PositiveLength, Section
from calib.radius.law import LineEstimate, WheelLaw
from calib.types import FloatArray
from calib.vehicle import Drive

#: how far a covariance may miss being positive semi-definite through rounding, relative
ROUNDING: Final = 1e-9


class Quantity(Measured[float, str]):
    """A number and its unit."""


class LoadRange(Section):
    """Wheel loads for which a law holds, both ends included."""

    min: Force
    max: Force

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.min.value > self.max.value:
            raise ValueError("min is above max")
        return self

    def __contains__(self, load_N: float) -> bool:
        return self.min.value <= load_N <= self.max.value


class StratumSection(Section):
    """A part of a law's covariance with its own degrees of freedom, and the standard deviation behind it."""

    variance_radius_ref: quantities.LengthSquared
    covariance_radius_ref_slope: quantities.LengthSquaredPerForce
    variance_slope: quantities.LengthSquaredPerForceSquared
    dof: Number
    scatter: quantities.NonNegativeLength


class SystematicSection(Section):
    """What one standard uncertainty of a source that is the same in every run changes; dof null: infinite."""

    radius_ref: Length
    slope: quantities.LengthPerForce
    dof: Number | None = None


class StrataSection(Section):
    """Parts of a law's covariance: runs within a session, sessions, and what is the same in every run.

    They add up to the covariance, and tell the degrees of freedom of mean and single run at each load.
    """

    within: StratumSection
    between: StratumSection
    systematic: list[SystematicSection] = Field(default_factory=list)
    #: mean square of sessions over that of their runs, below 1: intervals are no narrower than of independent runs
    session_f: Number | None = None

    @staticmethod
    def of_estimate(estimate: LineEstimate) -> StrataSection:
        """Return the parts of an estimate."""

        def stratum(covariance: FloatArray, dof: float, variance: float) -> StratumSection:
            return StratumSection.of(**variances(covariance), dof=dof, scatter=variance**0.5)

        return StrataSection.of(
            within=stratum(estimate.cov_within, estimate.dof_within, estimate.run_variance),
            between=stratum(estimate.cov_between, estimate.dof_between, estimate.session_variance),
            systematic=[
                SystematicSection.of(radius_ref=radius, slope=slope, dof=dof if np.isfinite(dof) else None)
                for (radius, slope), dof in zip(estimate.systematic, estimate.systematic_dof, strict=True)
            ],
            session_f=estimate.session_f if estimate.sessions_agree else None,
        )

    def estimate(self, radius_m: float, slope_m_per_N: float) -> LineEstimate:
        """Return the estimate that they are parts of."""
        within, between = self.within, self.between
        rows = [(one.radius_ref.value, one.slope.value) for one in self.systematic]
        return LineEstimate(
            coefficients=np.array([radius_m, slope_m_per_N]),
            dof_within=within.dof.value,
            dof_between=between.dof.value,
            run_variance=within.scatter.value**2,
            session_variance=between.scatter.value**2,
            cov_within=_matrix(within),
            cov_between=_matrix(between),
            session_f=None if self.session_f is None else self.session_f.value,
            hc3=False,
            design="",
            systematic=np.array(rows).reshape(-1, 2),
            systematic_dof=np.array([np.inf if one.dof is None else one.dof.value for one in self.systematic]),
        )


def variances(covariance: FloatArray) -> dict[str, float]:
    """Return the fields of a covariance of radius and slope, shape (2, 2)."""
    names = ("variance_radius_ref", "covariance_radius_ref_slope", "variance_slope")
    return dict(zip(names, covariance[np.triu_indices(2)], strict=True))


def _matrix(of: StratumSection | WheelSection) -> FloatArray:
    cross = of.covariance_radius_ref_slope.value
    return np.array([[of.variance_radius_ref.value, cross], [cross, of.variance_slope.value]])


class WheelSection(Section):
    """The law of one wheel: r(F) = radius_ref + slope (F - reference_load), valid within valid_load.

    residual_std: standard deviation of a single run, in a session of its own, about the law (`single_run_std_m` of
    fit.json; `residual_std_m` there is that of all residuals as if runs were independent). dof: the smaller of those of
    radius_ref and slope; strata tells those at each load.
    """

    radius_ref: PositiveLength
    slope: quantities.LengthPerForce
    reference_load: Force
    variance_radius_ref: quantities.LengthSquared
    covariance_radius_ref_slope: quantities.LengthSquaredPerForce
    variance_slope: quantities.LengthSquaredPerForceSquared
    dof: Number
    residual_std: quantities.NonNegativeLength
    n_runs: Number
    valid_load: LoadRange
    strata: StrataSection | None = None

    @model_validator(mode="after")
    def _possible(self) -> Self:
        covariance = self.covariance_radius_ref_slope.value
        # squared by parts: variances near 1e-18 must not underflow into a false refusal
        bound = self.variance_radius_ref.value**0.5 * self.variance_slope.value**0.5
        if abs(covariance) > bound * (1.0 + ROUNDING):
            raise ValueError("variances and a covariance of a distribution (a correlation within 1)")
        for load in (self.valid_load.min.value, self.valid_load.max.value):
            if self.radius_ref.value + self.slope.value * (load - self.reference_load.value) <= 0.0:
                raise ValueError(f"the radius is not above zero at the valid load {load:g} N")
        if (strata := self.law.strata) is not None:
            if not np.allclose(strata.covariance, _matrix(self), rtol=1e-6, atol=0.0):
                raise ValueError("strata that add up to the covariance")
            if not np.isclose(strata.run_variance + strata.session_variance, self.residual_std.value**2, rtol=1e-6):
                raise ValueError("strata whose scatters add up to residual_std in squares")
        return self

    @property
    def law(self) -> WheelLaw:
        """The law of the wheel, as arrays compute with it; it does not look at the valid range."""
        return WheelLaw(
            covariance=_matrix(self),
            load_min_N=self.valid_load.min.value,
            load_max_N=self.valid_load.max.value,
            n_runs=int(self.n_runs.value),
            strata=None if self.strata is None else self.strata.estimate(self.radius_ref.value, self.slope.value),
            **self.si("reference_load", "radius_ref", "slope", "dof", "residual_std"),
        )


class WheelsSection(Section):
    """The laws of both rear wheels."""

    left: WheelSection
    right: WheelSection


class VehicleSection(Section):
    """Geometry and mass, enough for the vehicle to compute its wheel loads from a payload (Eqs 1-2).

    `drive` and `front_wheel_radius` are in the file only where they differ from those of a tricycle; `load_track` and
    `load_wheelbase`, by which the wheel loads are computed, where the odometry's were calibrated.
    """

    track: PositiveLength
    track_std: quantities.NonNegativeLength
    wheelbase: PositiveLength
    wheel_radius: PositiveLength
    mass: quantities.Mass
    cog_x: Length
    cog_y: Length
    cog_z: Length
    max_wheel_load: Force
    gravity: quantities.GravityAcceleration
    drive: Drive = "tricycle"
    front_wheel_radius: PositiveLength | None = None
    load_track: PositiveLength | None = None
    load_wheelbase: PositiveLength | None = None


class EncoderSection(Section):
    """Rear-wheel encoders; wrap_bits is null where the counter does not wrap."""

    counts_per_rev_left: quantities.CountsPerRev
    counts_per_rev_right: quantities.CountsPerRev
    wrap_bits: quantities.Bits | None = None


class NoiseSection(Section):
    """Random part of the pose's covariance: random walk per square root of metre, and one encoder reading."""

    along: quantities.LengthPerRootMetre
    heading: quantities.HeadingPerRootMetre
    count_std: quantities.CountStd


class LimitsSection(Section):
    """Faults for the runtime: a longer travel, or a longer gap, between two samples."""

    max_step: PositiveLength
    max_gap: quantities.Time


class LoadPoint(Section):
    """A named line of the load table."""

    name: Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9 ._+\-]+$")]
    load_left: Force
    load_right: Force


class EffectSection(Section):
    """A diagnosed effect added to the model: which form of it, what is fixed in that form, and its parameters."""

    effect: Annotated[str, Field(min_length=1, max_length=128)]
    form: Annotated[str, Field(max_length=256)] = ""
    settings: dict[str, float] = Field(default_factory=dict)
    parameters: dict[str, Quantity]


class CovarianceEntry(Section):
    """Covariance of two parameters of the geometry; of one with itself: its variance."""

    first: str
    second: str
    covariance: Quantity


class GeometrySection(Section):
    """Geometry estimated together: every parameter of the drive, and the joint covariance of those determined.

    Holds what the wheels' sections cannot: the parameters of drives other than two wheels on an axle, and the terms
    that couple left, right and track. Parameters without a variance were not determined and keep their nominal
    value. run_covariance: of a single run's scatter about both laws of a corridor campaign.
    """

    drive: Drive
    source: OdometrySource
    parameters: dict[str, Quantity]
    covariance: list[CovarianceEntry]
    run_covariance: Quantity | None = None

    @model_validator(mode="after")
    def _known(self) -> Self:
        names = {name for entry in self.covariance for name in (entry.first, entry.second)}
        if not names <= set(self.parameters):
            raise ValueError(f"covariance names {', '.join(sorted(names - set(self.parameters)))}, which have no value")
        return self

    @property
    def values(self) -> dict[str, float]:
        """Value of each parameter."""
        return {name: quantity.value for name, quantity in self.parameters.items()}


class AcceptedSection(Section):
    """Findings beyond the bounds of the vehicle that the user passed on, and why."""

    reason: str
    findings: list[str]


class InputFile(Section):
    """A file that the coefficients were computed from."""

    path: str
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
