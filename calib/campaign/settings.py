"""What `campaign.toml` says: instruments, odometry, the simulator's model; the run table's columns."""

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from difflib import SequenceMatcher
from functools import lru_cache
from typing import Annotated, Final, Literal

import numpy as np
from pydantic import AfterValidator, Field

from calib.errors import BadFileError
from calib.types import GRAVITY_MPS2, SUFFIXES, FloatArray, convertible, split_suffix, unit_named
from calib.vehicle import Positive, Usual, Vehicle

Frame = Literal["start", "map"]
OdometrySource = Literal["rear", "front", "wheels", "shaft"]
EncoderKind = Literal["counts", "speed"]

#: distance of a count where the logs have speeds: below what any reference can tell
SPEED_COUNT_M: Final = 1e-6


def _width(bits: int) -> int:
    if not 8 <= bits <= 32:
        raise ValueError("8 to 32, mostly 16 or 32")
    return bits


@dataclass(frozen=True, slots=True)
class Encoder:
    """Encoders: counts per wheel revolution, and the counter's width where it wraps."""

    counts_per_rev_left: Positive = 4096.0
    counts_per_rev_right: Positive = 4096.0
    #: width of the counter; None: it does not wrap, or unspecified
    wrap_bits: Annotated[int, AfterValidator(_width)] | None = None
    #: counts a revolution of the front wheel; None: the left wheel's value
    counts_per_rev_front: Positive | None = None
    #: speed: the logs have speeds in m/s by the nominal radii, integrated to counts of `SPEED_COUNT_M`
    kind: EncoderKind = "counts"

    @property
    def front(self) -> float:
        """Counts a revolution of the front wheel, the left wheel's where it has none of its own."""
        return self.counts_per_rev_left if self.counts_per_rev_front is None else self.counts_per_rev_front

    def per_rev(self, column: str) -> float:
        """Return the counts a revolution of the wheel in a column; of a drive shaft, of the rear wheels."""
        if column == "counts_front":
            return self.front
        return self.counts_per_rev_right if column.endswith("right") else self.counts_per_rev_left


@dataclass(frozen=True, slots=True)
class FrontModel:
    """What the simulator believes of a steered vehicle; the true angle is scale times the sensor's, plus zero."""

    #: of the counted wheel: the front wheel, or with an Ackermann drive the rear wheels
    radius_m: float
    wheelbase_m: float
    zero_rad: float = 0.0
    scale: float = 1.0
    #: of an Ackermann drive in fast turns: curvature tan(angle) / (L (1 + understeer v^2)), slip angle
    #: -side_slip v^2 curvature
    understeer_s2_per_m2: float = 0.0
    side_slip_s2_per_m: float = 0.0


@dataclass(frozen=True, slots=True)
class MecanumModel:
    """What the simulator believes of four mecanum wheels: their radius, and half the length plus half the width."""

    radius_m: float
    arm_m: float


@dataclass(frozen=True, slots=True)
class OdometryModel:
    """What the simulator believes of the wheels: r = radius + slope (F - reference_load), and the track.

    `front` and `mecanum`: of a front wheel or of four wheels that alone drive the odometry; None: the nominal vehicle.
    """

    radius_left_m: Positive
    radius_right_m: Positive
    track_m: Positive
    reference_load_N: float
    slope_left_m_per_N: float = 0.0
    slope_right_m_per_N: float = 0.0
    front: FrontModel | None = None
    mecanum: MecanumModel | None = None

    @property
    def mean_radius_m(self) -> float:
        """Mean of both radii."""
        return 0.5 * (self.radius_left_m + self.radius_right_m)

    def steered(self, vehicle: Vehicle) -> FrontModel:
        """Return `front`, by default the nominal one: the shaft of an Ackermann drive counts the rear wheels' mean."""
        radius_m = self.mean_radius_m if vehicle.drive == "ackermann" else vehicle.front_radius_m
        return self.front or FrontModel(radius_m, vehicle.wheelbase_m)


@dataclass(frozen=True, slots=True)
class Rangefinder:
    """Laser rangefinder: standard uncertainty of a distance, and the span that it can measure."""

    sigma_m: Annotated[Positive, Usual(0.0, 0.5)] = 0.0015
    min_m: float = 0.05
    max_m: float = 250.0


#: beyond it the key's unit is another
SensorPlace = Annotated[float, Field(ge=-100.0, le=100.0)]


@dataclass(frozen=True, slots=True)
class Reference:
    """Pose reference: its uncertainties, where its frame sits on the vehicle, and the frame its poses stand in."""

    #: standard, of position (each axis) and heading
    sigma_xy_m: Annotated[Positive, Usual(0.0, 0.5)] = 0.002
    sigma_theta_rad: Annotated[Positive, Usual(0.0, 0.2)] = 0.0008
    #: the reference's frame on the vehicle: ahead of the rear axle's middle, left of it, turned counter-clockwise
    sensor_x_m: SensorPlace = 0.0
    sensor_y_m: SensorPlace = 0.0
    sensor_yaw_rad: Annotated[float, Field(ge=-2 * math.pi, le=2 * math.pi)] = 0.0
    #: start: poses in each run's start frame; map: in one frame common to all runs; None: unspecified
    frame: Frame | None = None


@dataclass(frozen=True, slots=True)
class Odometry:
    """What the vehicle's own odometry runs on."""

    #: encoders: rear: both rear wheels'; front: front wheel's, with steering angle; wheels: all (mecanum); shaft: rear
    #: axle's, with steering angle (Ackermann)
    source: Annotated[OdometrySource | None, Field(validation_alias="from")] = None


#: columns of the run table that are often weighed in kilograms
WHEEL_LOADS: Final = ("load_left_N", "load_right_N")
_BRACKETS: Final = re.compile(r"(.*?)\s*[\[(]\s*([^\[\]()]*?)\s*[\])]")
# no one-letter units, since names end in letters
_FURTHER: Final = frozenset({"mm", "cm", "km", "um", "deg", "mrad", "kN", "daN", "ms", "us", "ns", "kmh", "mmps"})


@dataclass(frozen=True, slots=True)
class Recognised:
    """A column found: its names in file and calib, the conversion, and what to say.

    ``value = factor * cell + offset``; `unitless`: the known column that a name without a unit might have meant.
    """

    found: str
    name: str
    factor: float = 1.0
    offset: float = 0.0
    said: str = ""
    unitless: str = ""


def spelled(column: str) -> str:
    """Return a name with underscores for blanks and a bracketed unit as suffix."""
    name, (stem, inside) = column.strip(), bracketed(column)
    if inside is not None:
        unit = unit_named(inside)
        redundant = inside in {"", "-", "1"} or (unit is not None and unit == split_suffix(stem)[1])
        name = stem if redundant else f"{stem}_{unit}" if unit else name
    return re.sub(r"[\s\-]+", "_", name.strip())


def bracketed(name: str) -> tuple[str, str | None]:
    """Return a column's name without brackets at its end, and their content or None."""
    match = _BRACKETS.fullmatch(name.strip())
    return (match[1], match[2]) if match else (name.strip(), None)


@lru_cache(maxsize=1024)
def recognise(column: str, known: tuple[str, ...], *, further: bool = True) -> Recognised:
    """Match a column name against the known ones.

    `column`: as ``distance [mm]`` or ``Load_Left_kN``; `known`: names with calib's unit suffixes; `further`: convert
    also unknown names that end in a unit (``static_radius_mm``). ``name`` is `column` (stripped) where nothing matches.
    """
    # names repeat in fleets and logs
    if (name := column.strip()) in known:
        return Recognised(column, name)
    clean = spelled(name)
    stem, suffix = split_suffix(clean)
    for wanted in sorted(known, key=lambda one: one != clean):
        if clean.lower() == wanted.lower():
            return Recognised(column, wanted, said=f"read as {wanted}")
        wanted_stem, _ = split_suffix(wanted)
        if suffix is not None and stem.lower() == wanted_stem.lower():
            factors = convertible(f"{wanted_stem}_{suffix}", wanted)
            if factors is None and wanted in WHEEL_LOADS and SUFFIXES[suffix][0] == "kg":
                factors = SUFFIXES[suffix][1] * GRAVITY_MPS2, 0.0
            if factors is not None:
                factor, offset = factors
                change = f"times {factor:.10g}" + (f" plus {offset:.6g}" if offset else "")
                return Recognised(column, wanted, factor, offset, f"read as {wanted} ({change})")
    for wanted in known if suffix is None else ():
        wanted_stem, wanted_suffix = split_suffix(wanted)
        if wanted_suffix is not None and clean.lower() == wanted_stem.lower():
            return Recognised(column, clean, unitless=wanted)
    if further and suffix in _FURTHER:
        target, factor, offset = SUFFIXES[suffix]
        renamed = f"{stem}_{target}"
        return Recognised(column, renamed, factor, offset, f"read as {renamed} (times {factor:.10g})")
    return Recognised(column, clean)


_WORDS: Final = {"l": "left", "r": "right", "temp": "temperature", "dist": "distance"} | dict.fromkeys(
    ("cnt", "count"), "counts"
)
#: words for how, where or of what a value was had
_BESIDE: Final = frozenset({"weighed", "measured", "wheel", "mean", "avg", "hall", "reported", "raw", "total", "value"})
#: letters of a word of five that one slip leaves in place
_TYPED: Final = 0.8


def look_alike(name: str, missing: Iterable[str]) -> str | None:
    """Return the missing known column that a name seems to mean; None for most names."""
    words = _words(name)
    likely = (wanted for wanted in missing if len(words) == len(_words(wanted)))
    return next((wanted for wanted in likely if all(map(_mistyped, words, _words(wanted)))), None)


def _mistyped(word: str, wanted: str) -> bool:
    return word == wanted or (len(wanted) > 3 and SequenceMatcher(None, word, wanted).ratio() >= _TYPED)


def _words(name: str) -> tuple[str, ...]:
    stem, _ = split_suffix(re.sub(r"[\s\-.]+", "_", name.strip()))
    words = re.split(r"_+", re.sub(r"(?<=[a-z])(?=[A-Z])", "_", stem).lower())
    return tuple(sorted(_WORDS.get(one, one) for one in words if one and one not in _BESIDE and one not in SUFFIXES))


def converted(values: FloatArray, factor: float, offset: float = 0.0) -> FloatArray:
    """Return ``factor * values + offset`` as in decimal arithmetic: 0.4348 kN is 434.8 N, not 434.79999999.

    Rounded to 15 significant digits, more than files have.
    """
    if factor == 1.0 and not offset:
        return values
    out = factor * values + offset
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = 10.0 ** np.clip(14 - np.floor(np.log10(np.abs(out))), -22, 22)
        rounded = np.rint(out * scale) / scale
    return np.where(np.isfinite(rounded), rounded, out)


def second_column(match: Recognised, column: str, shown: str) -> BadFileError:
    """Return the error of a second column of the same meaning."""
    return BadFileError(
        shown, f"a second column for {match.name}", "one", "remove or rename one of them", row=1, column=column
    )
