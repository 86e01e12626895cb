"""Effects that are not in the library: columns of the run table, declared effects, classes by entry point."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from importlib.metadata import EntryPoint, entry_points
from typing import Annotated, Final, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from calib.campaign.model import NUMERIC_COLUMNS
from calib.coefficients.sections import first_fault
from calib.errors import BadFileError, BadInputError
from calib.gap.effects import Centre, Effect, Family, Form, Parameter, Proportional, varies
from calib.gap.observations import Observations
from calib.types import FloatArray

COVARIATE_PREFIX: Final = "covariate:"
#: form of a covariate -> what it acts on, and the parameter's name and unit
COVARIATE_FORMS: Final = {
    "both radii": ("both", "relative_per_sd", "1"),
    "left radius": ("left", "relative_per_sd", "1"),
    "right radius": ("right", "relative_per_sd", "1"),
    "yaw per metre": ("yaw", "yaw_per_sd", "rad/m"),
}


class _OfColumn(Proportional):
    id: str  # type: ignore[misc]
    title: str  # type: ignore[misc]
    implausible = "something else that changed with this column"
    family = Family.COVARIATE
    separates = "runs that vary this column alone"

    def __init__(self, name: str, title: str, column: str, origin: str) -> None:
        self.id, self.column, self.origin = name, column, origin  # type: ignore[misc]
        self.title = title or f"an influence of the column {column}"

    def quantity(self, observations: Observations) -> FloatArray:
        return observations.number(self.column)


class Covariate(_OfColumn):
    """A column acts on both radii, on one radius, or turns the vehicle by so much a metre.

    The column enters standardised, (value - mean) / standard deviation, so sizes are per standard deviation.
    """

    needs = "a column of numbers in the run table that varies"
    shifts = ("radius_scale", "unequal_radii")

    def __init__(self, column: str) -> None:
        super().__init__(COVARIATE_PREFIX + column, "", column, f"the column {column} of runs.csv")

    def centre(self, values: FloatArray) -> Centre:
        """See `Proportional`."""
        return Centre(float(np.mean(values)), float(np.std(values)) or 1.0)

    def forms(self, observations: Observations) -> list[Form]:
        """See `Effect`."""
        values = self.quantity(observations)
        if not varies(values, 0.0, observations) or self.centre(values).spread <= 1e-12 * float(np.max(np.abs(values))):
            return []
        centre = self.centre(values)
        settings = {"mean": centre.mean, "standard_deviation": centre.spread}
        forms = [
            self.form(values, acts_on, Parameter(name, unit, typical=1e-3, largest=2e-2), label)
            for label, (acts_on, name, unit) in COVARIATE_FORMS.items()
        ]
        return [replace(form, settings=settings, tries=len(forms)) for form in forms]


def covariate_columns(observations: Observations) -> tuple[str, ...]:
    """Return the further numeric columns of a campaign, in its own order."""
    return tuple(name for name in observations.numbers if name not in NUMERIC_COLUMNS)


#: group of entry points under which packages offer classes of effects
ENTRY_POINT_GROUP: Final = "calib.effects"

#: what a declared effect acts on -> unit of its size per unit of the column, and the calibration that a shift of the
#: column's zero looks like
ACTS_ON: Final[dict[str, tuple[str, tuple[str, ...]]]] = {
    "left": ("1", ("radius_scale", "unequal_radii")),
    "right": ("1", ("radius_scale", "unequal_radii")),
    "both": ("1", ("radius_scale",)),
    "track": ("1", ("track_width",)),
    "yaw": ("rad/m", ("unequal_radii",)),
    "distance": ("m", ()),
}
_Text = Annotated[str, Field(min_length=1)]


class _Entry(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", str_strip_whitespace=True)

    id: _Text
    title: _Text | None = None
    column: _Text
    #: see `acting_on`
    acts_on: Literal["left", "right", "both", "track", "yaw", "distance"]
    #: typical, largest: sizes per unit of the column
    typical: Annotated[FiniteFloat, Field(gt=0.0)]
    largest: Annotated[FiniteFloat, Field(gt=0.0)]


class Declared(_OfColumn):
    """A linear effect: size times (column - its mean) on one radius, both, the track, yaw per metre or the laser."""

    needs = "its column to vary"

    def __init__(self, entry: _Entry) -> None:
        super().__init__(entry.id, entry.title or "", entry.column, "[[effects]] of campaign.toml")
        self.acts_on = entry.acts_on  # type: ignore[misc]
        self.columns = (entry.column,)  # type: ignore[misc]
        unit, self.shifts = ACTS_ON[entry.acts_on]  # type: ignore[misc]
        unit = f"{unit} per {entry.column}"
        self.parameter = Parameter("size", unit, entry.typical, entry.largest)  # type: ignore[misc]

    def form(self, values: FloatArray, acts_on: str, parameter: Parameter | None = None, label: str = "") -> Form:
        """See `Proportional`."""
        return replace(super().form(values, acts_on, parameter, label), settings={"mean": self.centre(values).mean})


def declared_effects(declared: object, columns: Collection[str], taken: Collection[str]) -> list[Effect]:
    """Return the effects of the ``[[effects]]`` tables, which act through numeric `columns` of the run table.

    No id is `taken` twice. Nothing in a declaration is ever evaluated; an error names the key that cannot be used.
    """
    if declared is None:
        return []
    if isinstance(declared, str | bytes | Mapping) or not isinstance(declared, Sequence):
        raise _wrong("effects", declared, "a list of tables", "write each effect as its own [[effects]] table")
    effects: list[Effect] = []
    used = set(taken)
    for number, table in enumerate(declared):
        where = f"effects[{number}]"
        entry = _validated(table, where)
        if entry.id in used:
            raise _wrong(f"{where}.id", entry.id, "an id that no other effect has", "choose another id")
        if entry.column not in columns:
            remedy = f"add the column to runs.csv or name one of: {', '.join(sorted(columns))}"
            raise _wrong(f"{where}.column", entry.column, "a numeric column of the run table", remedy)
        if entry.largest < entry.typical:
            expected = f"no less than typical ({entry.typical:g})"
            raise _wrong(f"{where}.largest", entry.largest, expected, "raise largest or lower typical")
        effects.append(Declared(entry))
        used.add(entry.id)
    return effects


def _validated(table: object, where: str) -> _Entry:
    try:
        return _Entry.model_validate(table)
    except ValidationError as error:
        key, found, expected = first_fault(error)
        remedy = f"its keys are {', '.join(_Entry.model_fields)}; sizes are per unit"
        raise BadFileError("campaign.toml", found[:60], expected, remedy, column=f"{where}.{key}") from error


def _wrong(key: str, found: object, expected: str, remedy: str) -> BadFileError:
    return BadFileError("campaign.toml", column=key, found=repr(found)[:60], expected=expected, remedy=remedy)


def entry_point_effects(taken: Collection[str], points: Sequence[EntryPoint] | None = None) -> list[Effect]:
    """Return the effects that installed packages offer (or these entry points); no id is `taken` twice."""
    effects: list[Effect] = []
    used = set(taken)
    for point in entry_points(group=ENTRY_POINT_GROUP) if points is None else points:
        where = f"entry point {point.name} = {point.value} of group {ENTRY_POINT_GROUP}"
        remedy = "mend or uninstall the package that offers it"
        try:
            kind = point.load()
        except Exception as error:
            raise BadInputError(f"{where}: found {error}; expected a class that can be loaded; {remedy}") from error
        if not (isinstance(kind, type) and issubclass(kind, Effect)):
            raise BadInputError(f"{where}: found {kind!r}; expected a subclass of calib's Effect; {remedy}")
        try:
            effect = kind()
        except TypeError as error:
            raise BadInputError(f"{where}: found {error}; expected a class made without arguments; {remedy}") from error
        name = getattr(effect, "id", None)
        if not isinstance(name, str) or not name or name in used:
            raise BadInputError(f"{where}: found the id {name!r}; expected one that no other effect has; {remedy}")
        package = f"the package {point.dist.name} {point.dist.version}" if point.dist else "an installed package"
        effect.origin = f"{package} ({point.name} = {point.value})"  # type: ignore[misc]
        effects.append(effect)
        used.add(name)
    return effects
