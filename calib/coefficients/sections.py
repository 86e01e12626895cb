"""The sections of the coefficient file."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from calib.coefficients.quantities import (
    Bits,
    CountsPerRev,
    CountStd,
    Force,
    GravityAcceleration,
    HeadingPerRootMetre,
    Length,
    LengthPerForce,
    LengthPerRootMetre,
    LengthSquared,
    LengthSquaredPerForce,
    LengthSquaredPerForceSquared,
    Mass,
    NonNegativeLength,
    Number,
    PositiveLength,
    Quantity,
    Section,
    Time,
)
from calib.vehicle import Drive

#: how far a covariance may miss being positive semi-definite through rounding, relative
ROUNDING = 1e-9


class LoadRange(Section):
    """Wheel loads for which a law holds, both ends included."""

    min: Force
    max: Force

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.min.value > self.max.value:
            raise ValueError("min stands above max")
        return self


class WheelSection(Section):
    """The law of one wheel: r(F) = radius_ref + slope (F - reference_load), valid within valid_load."""

    radius_ref: PositiveLength
    slope: LengthPerForce
    reference_load: Force
    variance_radius_ref: LengthSquared
    covariance_radius_ref_slope: LengthSquaredPerForce
    variance_slope: LengthSquaredPerForceSquared
    dof: Number
    residual_std: NonNegativeLength
    n_runs: Number
    valid_load: LoadRange

    @model_validator(mode="after")
    def _possible(self) -> Self:
        covariance = self.covariance_radius_ref_slope.value
        # squared by parts: variances near 1e-18 must not underflow into a false refusal
        bound = self.variance_radius_ref.value**0.5 * self.variance_slope.value**0.5
        if abs(covariance) > bound * (1.0 + ROUNDING):
            raise ValueError("variances and covariance belong to no distribution (correlation beyond 1)")
        for load in (self.valid_load.min.value, self.valid_load.max.value):
            if self.radius_ref.value + self.slope.value * (load - self.reference_load.value) <= 0.0:
                raise ValueError(f"the radius is not above zero at the valid load {load:g} N")
        return self


class WheelsSection(Section):
    """The laws of both rear wheels."""

    left: WheelSection
    right: WheelSection


class VehicleSection(Section):
    """Geometry and mass, enough for the vehicle to compute its wheel loads from a payload (Eqs 1-2).

    `drive` and `front_wheel_radius` stand in the file only where they are not those of the usual tricycle.
    """

    track: PositiveLength
    track_std: NonNegativeLength
    wheelbase: PositiveLength
    wheel_radius: PositiveLength
    mass: Mass
    cog_x: Length
    cog_y: Length
    cog_z: Length
    max_wheel_load: Force
    gravity: GravityAcceleration
    drive: Drive = "tricycle"
    front_wheel_radius: PositiveLength | None = None


class EncoderSection(Section):
    """Rear-wheel encoders; wrap_bits is null where the counter does not wrap."""

    counts_per_rev_left: CountsPerRev
    counts_per_rev_right: CountsPerRev
    wrap_bits: Bits | None = None


class NoiseSection(Section):
    """Random part of the pose's covariance: random walk per square root of metre, and one encoder reading."""

    along: LengthPerRootMetre
    heading: HeadingPerRootMetre
    count_std: CountStd


class LimitsSection(Section):
    """What the runtime takes for a fault: a travel between two samples, a silence between two samples."""

    max_step: PositiveLength
    max_gap: Time


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
    that couple left, right and track. Parameters without a variance were not determined and stand at their nominal
    value.
    """

    drive: Drive
    source: Literal["rear", "front", "wheels"]
    parameters: dict[str, Quantity]
    covariance: list[CovarianceEntry]

    @model_validator(mode="after")
    def _known(self) -> Self:
        names = {name for entry in self.covariance for name in (entry.first, entry.second)}
        if not names <= set(self.parameters):
            raise ValueError(f"covariance names {', '.join(sorted(names - set(self.parameters)))}, which have no value")
        return self


class AcceptedSection(Section):
    """Findings beyond the bounds of the vehicle that the user passed on, and why."""

    reason: str
    findings: list[str]


class InputFile(Section):
    """A file that the coefficients were computed from."""

    path: str
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
