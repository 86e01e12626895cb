"""Effects that are not in the library: columns of the run table, declared effects, classes by entry point."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Final

import numpy as np

from calib.campaign.model import NUMERIC_COLUMNS
from calib.errors import BadFileError, BadInputError
from calib.gap.effects.effect import Centre, Effect, Family, Form, Observations, Parameter, Path, Perturbation, varies
from calib.types import FloatArray

COVARIATE_PREFIX: Final = "covariate:"
#: form of a covariate -> what it acts on
COVARIATE_FORMS: Final = {
    "both radii": "both",
    "left radius": "left",
    "right radius": "right",
    "yaw per metre": "yaw",
}


class Covariate(Effect):
    """A column acts on both radii, on one radius, or turns the vehicle by so much a metre.

    The column enters standardised, (value - mean) / standard deviation, so sizes are per standard deviation.

    Parameters
    ----------
    column : str
        Name of the column.
    """

    # an instance's own, unlike the class attributes of the other effects
    id: str  # type: ignore[misc]
    title: str  # type: ignore[misc]
    implausible = "something else that changed with this column"
    family = Family.COVARIATE
    needs = "a column of numbers in the run table that varies"
    separates = "runs that vary this column alone"
    shifts = ("radius_scale", "unequal_radii")

    def __init__(self, column: str) -> None:
        self.column = column
        self.id = COVARIATE_PREFIX + column
        self.title = f"an influence of the column {column}"

    def forms(self, observations: Observations) -> list[Form]:
        """Return four forms; none where the column has gaps or does not vary."""
        values = observations.number(self.column)
        if not varies(values):
            return []
        spread = float(np.std(values))
        if spread <= 1e-12 * float(np.max(np.abs(values))):
            return []
        centre = Centre(float(np.mean(values)), spread)
        return [self._form(observations, centre, label) for label in COVARIATE_FORMS]

    def _form(self, observations: Observations, centre: Centre, label: str) -> Form:
        acts_on = COVARIATE_FORMS[label]
        name, unit = ("yaw_per_sd", "rad/m") if acts_on == "yaw" else ("relative_per_sd", "1")
        standard = centre.deviations(observations.number(self.column))
        return Form(
            self.id,
            label,
            (Parameter(name, unit, typical=1e-3, largest=2e-2),),
            lambda path: [_column_perturbation(path, acts_on, standard)],
            settings={"mean": centre.mean, "standard_deviation": centre.spread},
            tries=len(COVARIATE_FORMS),
            centre=centre,
            about=lambda elsewhere: self._form(observations, elsewhere, label),
            by_parts=True,
        )


def _column_perturbation(path: Path, acts_on: str, column: FloatArray) -> Perturbation:
    """Return what a column, shape (n_obs,) of all observations, does to one of `ACTS_ON` on a path."""
    here = path.s.here(column)
    if acts_on == "distance":
        return Perturbation.on_readings(path.s, distance=here)
    if acts_on == "yaw":
        return Perturbation(heading_rad=here[path.s.unit] * path.s.path_m)
    if acts_on == "track":
        return Perturbation(track=here)
    left, right = acts_on in {"left", "both"}, acts_on in {"right", "both"}
    return Perturbation(left=here if left else None, right=here if right else None)


def covariate_columns(observations: Observations) -> tuple[str, ...]:
    """Return the further numeric columns of a campaign, in its own order."""
    return tuple(name for name in observations.numbers if name not in NUMERIC_COLUMNS)


def column_of(effect: str) -> str | None:
    """Return the column of a covariate's id, None for any other id."""
    return effect.removeprefix(COVARIATE_PREFIX) if effect.startswith(COVARIATE_PREFIX) else None


def covariate_effects(observations: Observations) -> list[Covariate]:
    """Return an effect for each further numeric column."""
    return [Covariate(column) for column in covariate_columns(observations)]


#: group of entry points under which packages offer classes of effects
ENTRY_POINT_GROUP: Final = "calib.effects"

#: what a declared effect acts on -> unit of its size per unit of the column
ACTS_ON: Final[dict[str, str]] = {
    "left": "1",
    "right": "1",
    "both": "1",
    "track": "1",
    "yaw": "rad/m",
    "distance": "m",
}
#: what a declared effect acts on -> calibration that a shift of the column's zero looks like
_SHIFTS: Final[dict[str, tuple[str, ...]]] = {
    "left": ("radius_scale", "unequal_radii"),
    "right": ("radius_scale", "unequal_radii"),
    "both": ("radius_scale",),
    "track": ("track_width",),
    "yaw": ("unequal_radii",),
    "distance": (),
}
_CAMPAIGN_FILE: Final = "campaign.toml"
DECLARED_KEYS: Final = ("id", "title", "column", "acts_on", "typical", "largest")


class Declared(Effect):
    """A linear effect: size times (column - its mean) on one radius, both, the track, yaw per metre or the laser.

    Parameters
    ----------
    id : str
        Name in verdicts.
    title : str
        What it is.
    column : str
        Numeric column of the run table.
    acts_on : str
        ``left``, ``right``, ``both`` or ``track`` (relative change), ``yaw`` (rad per metre) or ``distance`` (m added
        to the laser's distance).
    typical, largest : float
        Sizes per unit of the column.
    """

    id: str  # type: ignore[misc]
    title: str  # type: ignore[misc]
    implausible = "something else that changed with this column"
    family = Family.COVARIATE
    needs = "its column to vary"
    separates = "runs that vary this column alone"

    def __init__(self, *, id: str, title: str, column: str, acts_on: str, typical: float, largest: float) -> None:  # noqa: A002
        self.id, self.title = id, title
        self.column, self.acts_on = column, acts_on
        self.columns = (column,)  # type: ignore[misc]
        self.typical, self.largest = typical, largest
        # counted from another zero than the campaign's mean, the effect looks like these beside it
        self.shifts = _SHIFTS[acts_on]  # type: ignore[misc]

    def forms(self, observations: Observations) -> list[Form]:
        """Return the single form; none where the column has gaps or does not vary."""
        values = observations.number(self.column)
        if not varies(values):
            return []
        return [self._form(observations, Centre(float(np.mean(values))))]

    def _form(self, observations: Observations, centre: Centre) -> Form:
        over = centre.deviations(observations.number(self.column))

        unit = f"{ACTS_ON[self.acts_on]} per {self.column}"
        return Form(
            self.id,
            "",
            (Parameter("size", unit, self.typical, self.largest),),
            lambda path: [_column_perturbation(path, self.acts_on, over)],
            settings={"mean": centre.mean},
            centre=centre,
            about=lambda elsewhere: self._form(observations, elsewhere),
            by_parts=True,
        )


def _wrong(key: str, found: object, expected: str, remedy: str) -> BadFileError:
    return BadFileError(_CAMPAIGN_FILE, column=key, found=repr(found), expected=expected, remedy=remedy)


def _text(entry: Mapping[str, Any], number: int, key: str) -> str:
    value = entry.get(key)
    if not isinstance(value, str) or not value.strip():
        raise _wrong(f"effects[{number}].{key}", value, "a text", f"give every [[effects]] table its {key}")
    return value.strip()


def _size(entry: Mapping[str, Any], number: int, key: str) -> float:
    value = entry.get(key)
    bad = isinstance(value, bool) or not isinstance(value, int | float)
    if bad or not math.isfinite(float(value)) or float(value) <= 0.0:  # type: ignore[arg-type]
        remedy = f"give {key} as the size of the effect for one unit of the column"
        raise _wrong(f"effects[{number}].{key}", value, "a number above 0", remedy)
    return float(value)  # type: ignore[arg-type]


def declared_effects(declared: object, observations: Observations, taken: Collection[str]) -> list[Effect]:
    """Return the effects of the ``[[effects]]`` tables, which act through columns of the run table.

    No id is `taken` twice. Nothing in a declaration is ever evaluated; an error names the key that cannot be used.
    """
    if declared is None:
        return []
    if isinstance(declared, str | bytes | Mapping) or not isinstance(declared, Sequence):
        raise _wrong("effects", declared, "a list of tables", "write each effect as its own [[effects]] table")
    effects: list[Effect] = []
    used = set(taken)
    for number, entry in enumerate(declared):
        if not isinstance(entry, Mapping):
            raise _wrong(f"effects[{number}]", entry, "a table", "write each effect as its own [[effects]] table")
        strange = [str(key) for key in entry if key not in DECLARED_KEYS]
        if strange:
            raise _wrong(
                f"effects[{number}]", strange[0], "only the keys " + ", ".join(DECLARED_KEYS), "remove or rename it"
            )
        name = _text(entry, number, "id")
        if name in used:
            raise _wrong(f"effects[{number}].id", name, "an id that no other effect has", "choose another id")
        column = _text(entry, number, "column")
        if column not in observations.numbers:
            known = ", ".join(sorted(observations.numbers))
            remedy = f"add the column to runs.csv or name one of: {known}"
            raise _wrong(f"effects[{number}].column", column, "a numeric column of the run table", remedy)
        acts_on = _text(entry, number, "acts_on")
        if acts_on not in ACTS_ON:
            raise _wrong(f"effects[{number}].acts_on", acts_on, "one of " + ", ".join(ACTS_ON), "name one of these")
        typical, largest = _size(entry, number, "typical"), _size(entry, number, "largest")
        if largest < typical:
            key = f"effects[{number}].largest"
            raise _wrong(key, largest, f"no less than typical ({typical:g})", "raise largest or lower typical")
        title = _text(entry, number, "title") if "title" in entry else f"an influence of the column {column}"
        effects.append(Declared(id=name, title=title, column=column, acts_on=acts_on, typical=typical, largest=largest))
        used.add(name)
    return effects


def entry_point_effects(taken: Collection[str], points: Sequence[EntryPoint] | None = None) -> list[Effect]:
    """Return the effects that installed packages offer (or these entry points); no id is `taken` twice."""
    return [effect for _, effect in _offered(taken, points)]


def entry_point_origins() -> dict[str, str]:
    """Return which package each effect of an entry point comes from, by its id; see `entry_point_effects`."""
    origins = {}
    for point, effect in _offered((), None):
        package = (
            "an installed package" if point.dist is None else f"the package {point.dist.name} {point.dist.version}"
        )
        origins[effect.id] = f"{package} ({point.name} = {point.value})"
    return origins


def _offered(taken: Collection[str], points: Sequence[EntryPoint] | None) -> list[tuple[EntryPoint, Effect]]:
    """Return the installed effects, each with its entry point."""
    loaded: list[tuple[EntryPoint, Effect]] = []
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
        loaded.append((point, effect))
        used.add(name)
    return loaded
