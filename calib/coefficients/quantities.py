"""What the sections of the coefficient file are made of: numbers with their unit, ``{"value": 0.7, "unit": "m"}``."""

from __future__ import annotations

import re
from typing import Annotated, Any, Final, Generic, Literal, Self, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from calib.errors import BadInputError

Positive = Annotated[float, Field(gt=0.0)]
NonNegative = Annotated[float, Field(ge=0.0)]
#: width of a counter
BitCount = Annotated[float, Field(ge=8.0, le=48.0, multiple_of=1.0)]
ValueT = TypeVar("ValueT", bound=float)
UnitT = TypeVar("UnitT", bound=str)
SectionT = TypeVar("SectionT", bound="Section")

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
        found = f"{where or 'the coefficients'}: found {found}"
        raise BadInputError(f"{found}; expected {expected}; these make no coefficient file") from error
