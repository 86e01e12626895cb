"""What all stages share: types of arrays, progress, operations on samples and poses, units.

Inside the package all is SI (m, rad, s, kg, N, degrees Celsius for floor temperature): columns and keys are converted
at the border.
"""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from typing import Final, TypeVar

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
StrArray = npt.NDArray[np.str_]
#: a row of a table by its columns
Row = dict[str, str | float | None]

#: called with steps done, number of steps (0: unknown), name of the stage
Progress = Callable[[int, int, str], None]

Item = TypeVar("Item")
Key = TypeVar("Key")


def floats(values: npt.ArrayLike) -> FloatArray:
    """Return values as an array of doubles, not copied if one."""
    return np.asarray(values, dtype=np.float64)


def silent(_done: int, _total: int, _stage: str) -> None:
    """Report nothing."""


def stepped(items: Collection[Item], progress: Progress, stage: str) -> Iterator[Item]:
    """Iterate over `items` and report the number done: before each item, and after the last."""
    for number, item in enumerate(items):
        progress(number, len(items), stage)
        yield item
    progress(len(items), len(items), stage)


def grouped(pairs: Iterable[tuple[Key, Item]]) -> dict[Key, list[Item]]:
    """Return the second parts of pairs by the first, in order of appearance."""
    groups: dict[Key, list[Item]] = {}
    for key, item in pairs:
        groups.setdefault(key, []).append(item)
    return groups


def since_start(steps: FloatArray, offsets: IntArray) -> FloatArray:
    """Return running sums of steps within each run, 0 at its first sample; runs stand in the last axis, same shape."""
    total = np.cumsum(steps, axis=-1)
    return total - np.repeat(total[..., offsets[:-1]], np.diff(offsets), axis=-1)


def unwrapped(theta: FloatArray) -> FloatArray:
    """Return headings without jumps of whole turns, NaN where they were, shape (n,)."""
    good = np.isfinite(theta)
    headings = theta.copy()
    headings[good] = np.unwrap(theta[good])
    return headings


def in_frame(apart: FloatArray, heading_rad: FloatArray) -> FloatArray:
    """Return differences of poses, shape (3, n), ahead, to the left and in heading, at headings (n,), shape (n, 3)."""
    cosine, sine = np.cos(heading_rad), np.sin(heading_rad)
    return np.stack([cosine * apart[0] + sine * apart[1], cosine * apart[1] - sine * apart[0], apart[2]], axis=1)


def evenly(count: int, most: int) -> IntArray:
    """Return at most `most` indices of `count` samples, evenly, with both ends."""
    return np.linspace(0, max(count - 1, 0), min(count, most)).round().astype(np.int64)


def few_digits(value: float, digits: int = 3) -> str:
    """Return a size to some digits; of a large one all before the point, no exponent."""
    return f"{value:.{digits}g}" if abs(value) < 10**digits - 0.5 else f"{value:.0f}"


def rows_of(columns: Mapping[str, FloatArray]) -> list[dict[str, float]]:
    """Return the rows of columns of equal length (n,), each a mapping by name."""
    return [dict(zip(columns, row, strict=True)) for row in np.stack(list(columns.values()), axis=1).tolist()]


GRAVITY_MPS2: Final = 9.81

#: way that a radian of turning counts as in the random walks of a pose: a turn on the spot slips too
WAY_PER_RAD_M: Final = 0.1

#: suffix as calib writes it -> suffixes as labs write it, each with its factor
_FACTORS: Final[dict[str, dict[str, float]]] = {
    "m": {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "km": 1e3, "um": 1e-6, "ft": 0.3048, "yd": 0.9144, "in": 0.0254},
    "kg": {"kg": 1.0, "g": 1e-3, "t": 1e3, "lb": 0.45359237},
    "N": {"N": 1.0, "kN": 1e3, "daN": 10.0, "kgf": 9.80665, "lbf": 4.4482216152605},
    "rad": {"rad": 1.0, "mrad": 1e-3, "deg": 0.017453292519943295},
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "day": 86400.0},
    "mps": {"mps": 1.0, "kmh": 1 / 3.6, "mmps": 1e-3},
    "radps": {"radps": 1.0, "degps": 0.017453292519943295},
    "C": {"C": 1.0, "K": 1.0, "F": 5 / 9},
}
_OFFSETS: Final = {"K": -273.15, "F": -160 / 9}
#: suffix as labs write it -> (suffix as calib writes it, factor, offset): calib value = factor * value + offset
SUFFIXES: Final[dict[str, tuple[str, float, float]]] = {
    name: (suffix, factor, _OFFSETS.get(name, 0.0)) for suffix, of in _FACTORS.items() for name, factor in of.items()
}

#: how people write a unit, in lower case -> suffix as in `SUFFIXES`; those that differ by case alone are in `_CASED`
_SPELLINGS: Final[dict[str, str]] = {
    spelling: unit
    for unit, spellings in {
        "m": "meter, meters, metre, metres",
        "mm": "millimeter, millimeters, millimetre, millimetres",
        "cm": "centimeter, centimeters, centimetre, centimetres",
        "um": "µm, μm, micron, microns",
        "in": 'inch, inches, "',
        "ft": "foot, feet",
        "yd": "yard, yards",
        "day": "days, tage",
        "kg": "kilogram, kilograms, kilogramm, kgs",
        "g": "gram, grams, gramm",
        "t": "tonne, tonnes, tonnen",
        "N": "newton, newtons",
        "kN": "kn, kilonewton",
        "daN": "dan",
        "kgf": "kp",
        "lb": "lbs, pound, pounds",
        "rad": "radian, radians, radiant",
        "deg": "°, º, degree, degrees",
        "s": "sec, secs, second, seconds, sek, sekunden",
        "ms": "msec, millisecond, milliseconds, millisekunden",
        "us": "µs, μs, usec, microsecond, microseconds",
        "ns": "nsec, nanosecond, nanoseconds",
        "mps": "m/s, m/sec, m*s^-1, m·s⁻¹, m s-1, m s^-1",
        "kmh": "km/h, kph, kmph",
        "mmps": "mm/s, mm/sec",
        "radps": "rad/s, rad/sec",
        "degps": "deg/s, deg/sec, °/s, dps",
        "C": "°c, ºc, ℃, degc, deg c, celsius, grad celsius, degrees celsius",
        "K": "kelvin",
        "F": "°f, ºf, degf, deg f, fahrenheit",
    }.items()
    for spelling in spellings.split(", ")
}
#: a German degree begins with a capital; the English grad is a hundredth of a right angle
_CASED: Final = {"Grad": "deg"}


def unit_named(text: str) -> str | None:
    """Return the unit of `SUFFIXES` that a text names as people write it (``mm/s``, ``°C``, ``seconds``), or None."""
    clean = text.strip()
    return clean if clean in SUFFIXES else _CASED.get(clean) or _SPELLINGS.get(clean.lower())


def split_suffix(name: str) -> tuple[str, str | None]:
    """Split a column name into its stem and its unit suffix.

    ``distance_mm`` gives `stem` ``distance`` and `suffix` ``mm``, None without a known unit.
    """
    stem, sep, suffix = name.rpartition("_")
    return (stem, suffix) if sep and suffix in SUFFIXES else (name, None)


#: suffix of a parameter -> its unit
PARAMETER_UNITS: Final = {
    "_m": "m",
    "_rad": "rad",
    "_s": "s",
    "_scale": "1",
    "_m_per_N": "m/N",
    "_s2_per_m": "s^2/m",
    "_s2_per_m2": "s^2/m^2",
}


def unit_of(name: str) -> str:
    """Return the unit of a parameter by the longest suffix that its name ends in, ``1`` by default."""
    return PARAMETER_UNITS[
        max((suffix for suffix in PARAMETER_UNITS if name.endswith(suffix)), key=len, default="_scale")
    ]


def convertible(name: str, wanted: str) -> tuple[float, float] | None:
    """Return (factor, offset) that turn column `name` into column `wanted`, or None where they do not match."""
    stem, suffix = split_suffix(name)
    wanted_stem, wanted_suffix = split_suffix(wanted)
    if suffix is None or wanted_suffix is None or stem != wanted_stem:
        return None
    target, factor, offset = SUFFIXES[suffix]
    return (factor, offset) if target == wanted_suffix else None
