"""Numbers with their unit, as the coefficient file writes them: ``{"value": 0.7, "unit": "m"}``."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

Positive = Annotated[float, Field(gt=0.0)]
NonNegative = Annotated[float, Field(ge=0.0)]


class Section(BaseModel):
    """A part of the file: immutable, no unknown keys, no infinity or NaN, no numbers written as text."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, strict=True)


class Quantity(Section):
    """A number and its unit."""

    value: float
    unit: str


class Length(Quantity):
    """A length."""

    unit: Literal["m"]


class PositiveLength(Length):
    """A length above zero."""

    value: Positive


class NonNegativeLength(Length):
    """A length of zero or more."""

    value: NonNegative


class LengthPerForce(Quantity):
    """Change of a length with a force."""

    unit: Literal["m/N"]


class LengthSquared(Quantity):
    """Variance of a length."""

    value: NonNegative
    unit: Literal["m^2"]


class LengthSquaredPerForce(Quantity):
    """Covariance of a length and its change with force."""

    unit: Literal["m^2/N"]


class LengthSquaredPerForceSquared(Quantity):
    """Variance of the change of a length with force."""

    value: NonNegative
    unit: Literal["m^2/N^2"]


class Force(Quantity):
    """A force; here a wheel load, so never below zero."""

    value: NonNegative
    unit: Literal["N"]


class Mass(Quantity):
    """A mass."""

    value: Positive
    unit: Literal["kg"]


class GravityAcceleration(Quantity):
    """Acceleration of free fall."""

    value: Positive
    unit: Literal["m/s^2"]


class Time(Quantity):
    """A duration."""

    value: Positive
    unit: Literal["s"]


class Number(Quantity):
    """A number without dimension."""

    value: NonNegative
    unit: Literal["1"]


class CountsPerRev(Quantity):
    """Encoder counts per revolution of the wheel."""

    value: Positive
    unit: Literal["count/rev"]


class CountStd(Quantity):
    """Standard deviation of one encoder reading."""

    value: NonNegative
    unit: Literal["count"]


class Bits(Quantity):
    """Width of a counter."""

    value: Annotated[float, Field(ge=8.0, le=48.0, multiple_of=1.0)]
    unit: Literal["bit"]


class LengthPerRootMetre(Quantity):
    """Random walk of the distance along the path, per square root of the distance driven."""

    value: NonNegative
    unit: Literal["m/m^0.5"]


class HeadingPerRootMetre(Quantity):
    """Random walk of the heading, per square root of the distance driven."""

    value: NonNegative
    unit: Literal["rad/m^0.5"]
