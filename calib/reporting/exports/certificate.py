"""The ``[certificate]`` section of ``campaign.toml``: what a calibration certificate states beside its numbers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from datetime import date
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from calib.errors import BadInputError, RefusedError

Text = Annotated[str, Field(min_length=1, max_length=1000)]
#: ISO 3166-1, two letters
Country = Annotated[str, Field(pattern="^[A-Z]{2}$")]


def _iso_date(value: object) -> object:
    """Return the date of a text, as a result folder keeps it; anything else is checked by its field."""
    return date.fromisoformat(value) if isinstance(value, str) else value


#: a date, or its text as YYYY-MM-DD
Day = Annotated[date, BeforeValidator(_iso_date)]


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


class Contact(_Section):
    """A laboratory or a customer."""

    name: Text
    email: Text
    city: Text
    country: Country
    street: Text | None = None
    street_no: Text | None = None
    postcode: Text | None = None
    phone: Text | None = None
    #: of an accredited laboratory
    code: Text | None = None


class Item(_Section):
    """The vehicle that was calibrated."""

    name: Text
    manufacturer: Text
    model: Text
    serial: Text
    owner_id: Text | None = None


class Person(_Section):
    """A person responsible for the certificate."""

    name: Text
    role: Text


class Equipment(_Section):
    """An instrument; without `certificate` nothing is said of its traceability."""

    name: Text
    serial: Text
    manufacturer: Text | None = None
    model: Text | None = None
    certificate: Text | None = None


class Certificate(_Section):
    """Everything that a certificate states and no measurement gives."""

    identifier: Text
    country: Country
    begin: Day
    end: Day
    performed_at: Literal["laboratory", "customer", "laboratoryBranch", "customerBranch", "other"]
    laboratory: Contact
    customer: Contact
    item: Item
    persons: Annotated[list[Person], Field(min_length=1)]
    equipment: Annotated[list[Equipment], Field(min_length=1)]
    received: Day | None = None

    @model_validator(mode="after")
    def _ordered(self) -> Certificate:
        if self.end < self.begin:
            raise ValueError("end is before begin")
        return self


def certificate_of(section: Any, where: str) -> Certificate:
    """Return the ``[certificate]`` section, checked.

    `section`: as ``campaign.toml`` has it, or as a result folder keeps it, dates as text; `where`: the file, for the
    message. Raises RefusedError where something is not stated, all of it by name; BadInputError where a value is wrong.
    """
    if not isinstance(section, Mapping):
        missing = ", ".join(_required(Certificate))
        raise RefusedError(
            f"{where}: found no section [certificate]; expected {missing}; state them, nothing of a certificate is "
            "invented (docs/exports.md has the section to fill in)"
        )
    try:
        return Certificate.model_validate(dict(section))
    except ValidationError as error:
        faults = error.errors(include_url=False)
        places = [(".".join(str(part) for part in fault["loc"]), fault) for fault in faults]
        missing = ", ".join(place for place, fault in places if fault["type"] == "missing")
        if missing:
            raise RefusedError(
                f"{where}, [certificate]: found no {missing}; expected what a certificate states; state them, nothing "
                "of a certificate is invented"
            ) from error
        place, fault = places[0]
        found = repr(fault.get("input"))[:80]
        raise BadInputError(
            f"{where}, certificate.{place}: found {found}; expected {fault['msg'].removeprefix('Value error, ')}; "
            "correct it"
        ) from error


def _required(model: type[BaseModel], prefix: str = "") -> Iterator[str]:
    """Yield the keys that have to be stated."""
    for name, field in model.model_fields.items():
        if not field.is_required():
            continue
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            yield from _required(field.annotation, f"{prefix}{name}.")
        else:
            yield prefix + name
