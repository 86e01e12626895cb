"""The sections of the coefficient file; numbers have their unit: ``{"value": 0.7, "unit": "m"}``."""

from __future__ import annotations

import re
from typing import Annotated, Any, Final, Generic, Literal, Self, TypeVar, get_args

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from calib.campaign.settings import OdometrySource
from calib.errors import BadInputError
from calib.radius.law import LineEstimate, WheelLaw
from calib.types import FloatArray
from calib.vehicle import Drive

Positive = Annotated[float, Field(gt=0.0)]
NonNegative = Annotated[float, Field(ge=0.0)]
#: width of a counter
BitCount = Annotated[float, Field(ge=8.0, le=48.0, multiple_of=1.0)]
ValueT = TypeVar("ValueT", bound=float)
UnitT = TypeVar("UnitT", bound=str)
SectionT = TypeVar("SectionT", bound="Section")

#: how far a covariance may miss being positive semi-definite through rounding, relative
ROUNDING: Final = 1e-9
#: unit in the file -> suffix of the same number's name in Python
SUFFIXES: Final = {
    "m": "_m", "N": "_N", "kg": "_kg", "s": "_s", "m/N": "_m_per_N", "m/s^2": "_mps2",
    "m/m^0.5": "_m_per_sqrt_m", "rad/m^0.5": "_rad_per_sqrt_m",
}  # fmt: skip


class Section(BaseModel):
    """A part of the file: immutable, no unknown keys, no infinity or NaN, no numbers written as text."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, strict=True)

    @classmethod
    def of(cls, source: object = None, /, **fields: Any) -> Self:
        """Return the section of SI numbers, which get the units that it states, and of other fields as they are.

        A field that is not given is the attribute of `source` with the same name and the suffix of its unit. Raises
        BadInputError where a value breaks the schema.
        """
        for name in cls.model_fields.keys() - fields.keys():
            unit = cls._unit(name)
            attribute = name if unit is None else name + SUFFIXES.get(unit, "")
            if hasattr(source, attribute):
                fields[name] = getattr(source, attribute)
        for name, value in fields.items():
            unit = cls._unit(name)
            if unit is not None and isinstance(value, (int, float)):
                fields[name] = {"value": float(value), "unit": unit}
        return validated(cls, fields)

    @classmethod
    def _unit(cls, name: str) -> str | None:
        annotation: Any = cls.model_fields[name].annotation
        kinds = [kind for kind in (annotation, *get_args(annotation)) if isinstance(kind, type)]
        units = [get_args(kind.model_fields["unit"].annotation) for kind in kinds if issubclass(kind, Measured)]
        return units[0][0] if units and units[0] else None

    def si(self, *names: str) -> dict[str, Any]:
        """Return fields as Python names them: with the suffix of their unit, and None where they are not in the file.

        `names`: which fields; without, all numbers that have one unit.
        """
        numbers = {}
        for name in names or type(self).model_fields:
            unit = self._unit(name)
            if unit is not None:
                part = getattr(self, name)
                numbers[name + SUFFIXES.get(unit, "")] = None if part is None else part.value
        return numbers


class Measured(Section, Generic[ValueT, UnitT]):
    """A number and its unit."""

    value: ValueT
    unit: UnitT


class Quantity(Measured[float, str]):
    """A number and its unit."""


class Length(Measured[float, Literal["m"]]):
    """A length."""


class PositiveLength(Measured[Positive, Literal["m"]]):
    """A length above zero."""


class NonNegativeLength(Measured[NonNegative, Literal["m"]]):
    """A length of zero or more."""


class LengthPerForce(Measured[float, Literal["m/N"]]):
    """Change of a length with a force."""


class LengthSquared(Measured[NonNegative, Literal["m^2"]]):
    """Variance of a length."""


class LengthSquaredPerForce(Measured[float, Literal["m^2/N"]]):
    """Covariance of a length and its change with force."""


class LengthSquaredPerForceSquared(Measured[NonNegative, Literal["m^2/N^2"]]):
    """Variance of the change of a length with force."""


class Force(Measured[NonNegative, Literal["N"]]):
    """A force; here a wheel load, so never below zero."""


class Mass(Measured[Positive, Literal["kg"]]):
    """A mass."""


class GravityAcceleration(Measured[Positive, Literal["m/s^2"]]):
    """Acceleration of free fall."""


class Time(Measured[Positive, Literal["s"]]):
    """A duration."""


class Number(Measured[NonNegative, Literal["1"]]):
    """A number without dimension."""


class CountsPerRev(Measured[Positive, Literal["count/rev"]]):
    """Encoder counts per revolution of the wheel."""


class CountStd(Measured[NonNegative, Literal["count"]]):
    """Standard deviation of one encoder reading."""


class Bits(Measured[BitCount, Literal["bit"]]):
    """Width of a counter."""


class LengthPerRootMetre(Measured[NonNegative, Literal["m/m^0.5"]]):
    """Random walk of the distance along the path, per square root of the distance driven."""


class HeadingPerRootMetre(Measured[NonNegative, Literal["rad/m^0.5"]]):
    """Random walk of the heading, per square root of the distance driven."""


def first_fault(error: ValidationError) -> tuple[str, str, str]:
    """Return place, found value and expectation of the first fault."""
    first = error.errors(include_url=False)[0]
    value = first.get("input")
    found = repr(value) if isinstance(value, (str, int, float)) or value is None else f"a {type(value).__name__}"
    expected = re.sub("^(Value error, |.* should (be|have) )", "", first["msg"])
    if first["type"] == "missing":
        found, expected = "nothing", "a value"
    return ".".join(str(part) for part in first["loc"]), found, expected


def validated(section: type[SectionT], fields: dict[str, object]) -> SectionT:
    """Return a section of its fields, as models or plain values.

    Raises BadInputError where they break the schema.
    """
    try:
        return section.model_validate(fields)
    except ValidationError as error:
        where, found, expected = first_fault(error)
        raise BadInputError(
            f"{where or 'the coefficients'}: found {found}; expected {expected}; these make no coefficient file"
        ) from error


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

    variance_radius_ref: LengthSquared
    covariance_radius_ref_slope: LengthSquaredPerForce
    variance_slope: LengthSquaredPerForceSquared
    dof: Number
    scatter: NonNegativeLength


class SystematicSection(Section):
    """What one standard uncertainty of a source that is the same in every run changes; dof null: infinite."""

    radius_ref: Length
    slope: LengthPerForce
    dof: Number | None = None


class StrataSection(Section):
    """Parts of a law's covariance: runs within a session, sessions, and what is the same in every run.

    They add up to the covariance, and tell the degrees of freedom of mean and single run at each load.
    """

    within: StratumSection
    between: StratumSection
    systematic: list[SystematicSection] = Field(default_factory=list)

    def estimate(self, radius_m: float, slope_m_per_N: float) -> LineEstimate:
        """Return the estimate that they are parts of."""
        within, between = self.within, self.between
        return LineEstimate(
            np.array([radius_m, slope_m_per_N]),
            within.dof.value,
            between.dof.value,
            within.scatter.value**2,
            between.scatter.value**2,
            _matrix(within),
            _matrix(between),
            None,
            hc3=False,
            design="",
            systematic=np.array([list(one.si("radius_ref", "slope").values()) for one in self.systematic]).reshape(
                -1, 2
            ),
            systematic_dof=np.array([np.inf if one.dof is None else one.dof.value for one in self.systematic]),
        )


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
    slope: LengthPerForce
    reference_load: Force
    variance_radius_ref: LengthSquared
    covariance_radius_ref_slope: LengthSquaredPerForce
    variance_slope: LengthSquaredPerForceSquared
    dof: Number
    residual_std: NonNegativeLength
    n_runs: Number
    valid_load: LoadRange
    strata: StrataSection | None = None

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
        strata = self.law.strata
        if strata is not None and not np.allclose(strata.covariance, _matrix(self), rtol=1e-6, atol=0.0):
            raise ValueError("strata do not add up to the covariance")
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

    `drive` and `front_wheel_radius` are in the file only where they differ from those of a tricycle.
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
    """Faults for the runtime: a longer travel, or a longer gap, between two samples."""

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
    that couple left, right and track. Parameters without a variance were not determined and keep their nominal
    value.
    """

    drive: Drive
    source: OdometrySource
    parameters: dict[str, Quantity]
    covariance: list[CovarianceEntry]

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
