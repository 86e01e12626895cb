"""The sections of the coefficient file, and what they are made of: numbers with their unit.

A number is ``{"value": 0.7, "unit": "m"}``.
"""

import re
from collections.abc import Callable
from typing import Annotated, Any, Final, Generic, Literal, Self, TypeVar, get_args

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_serializer, model_validator

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

#: keys written also at their default; older readers do not know the others that may be omitted
ALWAYS: Final = ("created", "load_table", "effects", "inputs", "wrap_bits", "dof", "systematic", "form", "settings")

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

    @model_serializer(mode="wrap")
    def _written(self, written: Callable[[Self], dict[str, Any]]) -> dict[str, Any]:
        usual = {name: of.get_default(call_default_factory=True) for name, of in type(self).model_fields.items()}
        return {name: part for name, part in written(self).items() if name in ALWAYS or part != usual[name]}

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
    actual = repr(value) if isinstance(value, (str, int, float)) or value is None else f"a {type(value).__name__}"
    expected = re.sub("^(Value error, |.* should (be|have) )", "", first["msg"])
    if first["type"] == "missing":
        actual, expected = "nothing", "a value"
    expected = "no such key" if first["type"] == "extra_forbidden" else expected
    return ".".join(str(part) for part in first["loc"]), actual, expected


def validated(section: type[SectionT], fields: dict[str, object]) -> SectionT:
    """Return a section of its fields, as models or plain values.

    Raises BadInputError where they break the schema.
    """
    try:
        return section.model_validate(fields)
    except ValidationError as error:
        where, actual, expected = first_fault(error)
        fault = f"{where or 'the coefficients'}: found {actual}"
        raise BadInputError(f"{fault}; expected {expected}; these make no coefficient file") from error


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
    #: mean square of sessions over that of their runs, below 1: intervals are no narrower than of independent runs
    session_f: Number | None = None

    @staticmethod
    def of_estimate(estimate: LineEstimate) -> "StrataSection":
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
            systematic=np.array([(one.radius_ref.value, one.slope.value) for one in self.systematic]).reshape(-1, 2),
            systematic_dof=np.array([np.inf if one.dof is None else one.dof.value for one in self.systematic]),
        )


def variances(covariance: FloatArray) -> dict[str, float]:
    """Return the fields of a covariance of radius and slope, shape (2, 2)."""
    names = ("variance_radius_ref", "covariance_radius_ref_slope", "variance_slope")
    return dict(zip(names, covariance[np.triu_indices(2)], strict=True))


def _matrix(of: "StratumSection | WheelSection") -> FloatArray:
    cross = of.covariance_radius_ref_slope.value
    return np.array([[of.variance_radius_ref.value, cross], [cross, of.variance_slope.value]])


class WheelSection(Section):
    """The law of one wheel: r(F) = radius_ref + slope (F - reference_load), valid within valid_load.

    residual_std: standard deviation of a single run, in a session of its own, about the law (`single_run_std_m` of
    fit.json; `residual_std_m` there is that of all residuals as if runs were independent); 0: not estimated, and no
    band of a single run is stated. dof: the smaller of those of radius_ref and slope; strata tells those at each load.
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
    load_track: PositiveLength | None = None
    load_wheelbase: PositiveLength | None = None


class NoiseSection(Section):
    """Random part of the pose's covariance: random walk per square root of metre, and one encoder reading.

    A radian of turning counts as 0.1 m of way.
    """

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
