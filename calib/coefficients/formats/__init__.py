"""Export formats and what they share; a new one is a function in this folder, and a line here."""

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from calib.documents import templates_of
from calib.errors import BadInputError
from calib.io import refuse_existing, write_bytes, write_files

if TYPE_CHECKING:
    from jinja2 import Environment

    from calib.coefficients.file import CoefficientFile

#: format -> module and function of this package, from file and options to its files; empty: the coefficient file
FORMATS: Final = {
    "json": "",
    "ros2": "for_vehicle.controllers_of",
    "c": "for_vehicle.coefficients_header",
    "c_effects": "for_vehicle.effects_header",
    "csv": "for_vehicle.radius_table",
    "mjcf": "simulator_models.mjcf",
    "urdf": "simulator_models.urdf",
    "sdf": "simulator_models.sdf",
}
#: formats that state the track's uncertainty and the random walk
WITH_NOISE: Final = frozenset({"json", "ros2", "c"})
#: formats of a vehicle, which have no effects
RADII_ONLY: Final = frozenset({"ros2", "c", "csv"})
#: formats that change a copy of the user's model, and those of two wheels on one axle
PATCHING: Final = frozenset({"mjcf", "urdf", "sdf"})
AXLE_ONLY: Final = PATCHING | {"c", "c_effects", "csv"}
#: of a checksum: sha256: and 16, enough to find the file
CHECKSUM_DIGITS: Final = 23
#: of a user's name in a comment
COMMENT_LENGTH: Final = 120


@dataclass(frozen=True, slots=True)
class Artifact:
    """A file made by an export: its name and content."""

    name: str
    data: bytes
    #: what the format cannot say
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class LoadPair:
    """A load point: wheel loads in N, and a name where it has one."""

    left_N: float
    right_N: float
    name: str = ""


def parse_loads(texts: Iterable[str]) -> tuple[LoadPair, ...]:
    """Return load points from texts in N: ``600`` for both wheels, ``500,700`` for left and right."""
    pairs = []
    for text in texts:
        parts = text.split(",")
        try:
            values = [float(part) for part in parts]
        except ValueError:
            values = []
        # refuses NaN, too
        if len(values) not in (1, 2) or not all(0.0 <= value < float("inf") for value in values):
            raise BadInputError(f"load: found {text!r}; expected N, or LEFT,RIGHT in N; for example 600 or 500,700")
        pairs.append(LoadPair(values[0], values[-1]))
    return tuple(pairs)


def refuse_loads(loads: object, to: str) -> None:
    """Raise BadInputError where a format that holds for every load is given some."""
    if loads and to not in PATCHING | {"ros2", "csv"}:
        raise BadInputError(f"load: found it with {to!r}; expected ros2, csv, mjcf, urdf or sdf; leave it out")


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """Choices of an export; a format ignores those that it has no use for."""

    #: for formats of single loads; none: the format's choice
    loads: tuple[LoadPair, ...] = ()
    #: names of ROS 2 controllers; none: those of the vehicle's drive
    controllers: tuple[str, ...] = ()
    #: whether the wheels' joints report positions; False: velocities
    position_feedback: bool = True
    #: whether the controllers integrate commands in place of the encoders
    open_loop: bool = False
    #: the user's model, and its names of the rear wheels
    model: Path | None = None
    left: str = ""
    right: str = ""


#: of an export of which nothing was chosen
USUAL: Final = ExportOptions()


def place(artifacts: Sequence[Artifact], output: Path, *, force: bool) -> list[dict[str, str]]:
    """Write an export to a file, where it is one and `output` is no folder, else into that folder.

    Returns ``path`` and ``sha256`` of each. Raises BadInputError where a file exists, unless `force`.
    """
    single = len(artifacts) == 1 and not output.is_dir() and output.suffix != ""
    targets = [output if single else output / artifact.name for artifact in artifacts]
    refuse_existing(targets, force=force)
    if single:
        write_bytes(output, artifacts[0].data, force=force)
    else:
        write_files(output, {artifact.name: artifact.data for artifact in artifacts}, force=force)
    return [
        {"path": str(target), "sha256": hashlib.sha256(artifact.data).hexdigest()}
        for target, artifact in zip(targets, artifacts, strict=True)
    ]


def default_loads(file: "CoefficientFile") -> tuple[LoadPair, ...]:
    """Return the load table's points, else ends and reference of the common valid range, or any load."""
    if file.load_table:
        return tuple(LoadPair(p.load_left.value, p.load_right.value, p.name) for p in file.load_table)
    left, right = file.law.left, file.law.right
    low, high = max(left.load_min_N, right.load_min_N), min(left.load_max_N, right.load_max_N)
    unloaded = left.slope_m_per_N == right.slope_m_per_N == 0.0
    if unloaded or low > high:
        return (LoadPair(left.reference_load_N, right.reference_load_N, "any load" if unloaded else "reference"),)
    return tuple(LoadPair(load, load) for load in sorted({low, high, left.reference_load_N}) if low <= load <= high)


def radii_m(file: "CoefficientFile", pair: LoadPair) -> tuple[float, float]:
    """Return the radii of the left and the right wheel at a load point; see `CoefficientFile.radius_m`."""
    left, right = file.radius_m(pair.left_N, pair.right_N)
    return float(left), float(right)


def within_N(file: "CoefficientFile", pair: LoadPair) -> tuple[float, float]:
    """Return the wheel loads of a load point, or the nearest ones that were measured."""
    laws = ((file.law.left, pair.left_N), (file.law.right, pair.right_N))
    left, right = (min(max(load, law.load_min_N), law.load_max_N) for law, load in laws)
    return left, right


def ascii_line(text: str) -> str:
    """Return `text` as one short line of printable ASCII that cannot end a comment."""
    line = "".join(sign if " " <= sign <= "~" else "?" for sign in text)
    return line.replace("*/", "* /").replace("/*", "/ *").replace("??", "? ?").rstrip("\\")[:COMMENT_LENGTH]


def left_out_lines(file: "CoefficientFile", what: str) -> list[str]:
    """Return what `what`, a file or header, leaves out, and the findings that the user accepted."""
    from calib.coefficients.file import fitted_beside

    lines = [f"NOT in this {what}: effect {ascii_line(part.effect)} of the simulator's model" for part in file.effects]
    return [*lines, *fitted_beside(file), *assumed_note(file), *accepted_lines(file)]


def assumed_note(file: "CoefficientFile") -> tuple[str, ...]:
    """Return which numbers were neither measured nor stated, as a sentence, if any."""
    values = []
    for place in file.assumed:
        quantity = attrgetter(place)(file)
        values.append(f"{place} {quantity.value:g} {quantity.unit}")
    if not values:
        return ()
    return (f"assumed, not measured: {', '.join(values)}; 'calib geometry' and 'calib export --to nav2' measure them",)


def accepted_lines(file: "CoefficientFile") -> list[str]:
    """Return what makes a law doubtful, and why it was accepted; else nothing."""
    accepted, doubts = file.accepted_implausible, [f"DOUBTFUL: {ascii_line(one)}" for one in file.failed_checks]
    if accepted is None:
        return doubts
    return [
        *doubts,
        f"IMPLAUSIBLE, passed on with the reason: {ascii_line(accepted.reason)}",
        *(f"found: {ascii_line(finding)}" for finding in accepted.findings),
    ]


def number(value: float) -> str:
    """Return a float as text with a decimal point, which YAML needs."""
    mantissa, mark, exponent = repr(float(value)).partition("e")
    return (mantissa if "." in mantissa else f"{mantissa}.0") + mark + exponent


def c_number(value: float) -> str:
    """Return a double as C reads it, to the last bit."""
    text = repr(float(value))
    return text if any(mark in text for mark in ".e") else f"{text}.0"


def _c_literal(value: float) -> str:
    text = c_number(value)
    return f"({text})" if text.startswith("-") else text


@cache
def templates() -> "Environment":
    """Return the templates of this folder."""
    environment = templates_of(__name__)
    environment.filters |= {"ascii_line": ascii_line, "c_number": c_number, "literal": _c_literal, "number": number}
    # no variance is known better
    environment.filters["variance"] = lambda value: number(float(f"{value:.6g}"))
    return environment


def rendered(name: str, **values: Any) -> bytes:
    """Return the text that a template of this folder makes of values."""
    return templates().get_template(name).render(values).encode("utf-8")
