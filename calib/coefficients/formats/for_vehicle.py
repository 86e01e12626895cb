"""Files for a vehicle's programs: C99 headers, the look-up table as CSV, ROS 2 controller parameters.

An effect is a macro of its name in ``c_acts.j2``, a controller a name in `OF_DRIVE` and a branch of ``ros2.yaml.j2``.
A YAML holds for one load, with constant diagonals of the covariance, beside the vehicle's own parameter file.
"""

import math
import re
import sys
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import combinations
from typing import Final

import numpy as np

from calib.coefficients import formats
from calib.coefficients.file import CoefficientFile
from calib.coefficients.formats import Artifact, ExportOptions, LoadPair, c_number, left_out_lines, radii_m, rendered
from calib.coefficients.sections import EffectSection, WheelSection
from calib.documents import csv_text
from calib.errors import BadInputError, RefusedError
from calib.radius.law import JOINT, WheelLaw
from calib.types import WAY_PER_RAD_M, BoolArray, FloatArray

INT32_MAX: Final = 2**31 - 1
#: bound of intermediates of the integer form: rounding cannot overflow int64_t
INT64_HALF: Final = 2**62
MAX_SHIFT: Final = 40
LAST_BITS_MN: Final = Fraction(1, 10**6)
GEOMETRY: Final = ("track", "track_std", "wheelbase", "mass", "cog_x", "cog_y", "max_wheel_load", "gravity")


@dataclass(frozen=True, slots=True)
class FixedPoint:
    """Integer form of a wheel's law: ``(base + slope (load - load_min) + 2^(shift-1)) / 2^shift``, mN to nm.

    `max_error_nm` bounds the difference to the law in real numbers at every whole millinewton of the valid range.
    """

    base: int
    slope: int
    shift: int
    load_min_mN: int
    load_max_mN: int
    max_error_nm: Fraction

    @property
    def bound_nm(self) -> float:
        """The bound rounded up to six decimals, so that the stated error is never below the true one."""
        return float(-((-self.max_error_nm * 10**6) // 1)) / 1e6


def fixed_point(wheel: WheelSection, side: str) -> FixedPoint:
    """Return the integer form of the law of a wheel; refused where 32 bits of nm and mN are too few."""
    # inwards to whole millinewtons, but for last bits of a double
    low = math.ceil(Fraction(wheel.valid_load.min.value) * 1000 - LAST_BITS_MN)
    high = math.floor(Fraction(wheel.valid_load.max.value) * 1000 + LAST_BITS_MN)
    slope_nm_per_mN = Fraction(wheel.slope.value) * 10**6
    offset_N = Fraction(low, 1000) - Fraction(wheel.reference_load.value)
    base_nm = (Fraction(wheel.radius_ref.value) + Fraction(wheel.slope.value) * offset_N) * 10**9
    span = high - low
    largest = max(base_nm, base_nm + slope_nm_per_mN * span)
    if span < 0 or high > INT32_MAX or largest > INT32_MAX:
        raise RefusedError(
            f"wheels.{side}: found a radius of {float(largest) * 1e-9:.3g} m or a load of {high * 1e-3:.3g} N; "
            "expected what 32 bits of nanometres and millinewtons hold; the integer form cannot be made"
        )
    shift = MAX_SHIFT
    while shift > 1 and (base_nm + abs(slope_nm_per_mN) * span + 2) * 2**shift >= INT64_HALF:
        shift -= 1
    base, slope = round(base_nm * 2**shift), round(slope_nm_per_mN * 2**shift)
    # rounding to nm, and of base and slope (linear: worst at an end)
    rounding = [abs(base + slope * at - (base_nm + slope_nm_per_mN * at) * 2**shift) / 2**shift for at in (0, span)]
    return FixedPoint(base, slope, shift, low, high, Fraction(1, 2) + max(rounding))


def coefficients_header(file: CoefficientFile, _options: ExportOptions) -> tuple[Artifact, ...]:
    """Return the header of a coefficient file; options change nothing."""
    data = rendered(
        "c_header.h.j2",
        file=file,
        left_out=left_out_lines(file, "header"),
        wheels=[(side, wheel, fixed_point(wheel, side)) for side, wheel in file.wheels],
        numbers={
            **file.vehicle.si(*GEOMETRY),
            **{f"load_{name}": getattr(file.loaded, name) for name in ("track_m", "wheelbase_m")},
            **file.encoder.si("counts_per_rev_left", "counts_per_rev_right"),
            **file.noise.si("count_std", "along", "heading"),
            **file.limits.si("max_step", "max_gap"),
        },
        coupled=[(one, other) for one, other in combinations(range(len(JOINT)), 2) if one // 2 != other // 2],
    )
    return (Artifact("calib_coefficients.h", data),)


EFFECTS_NAME: Final = "calib_effects.h"
#: forms that act through what a run does not know, as in `calib.runtime.effects`
OTHER_FORMS: Final = ("change of load", "per session", "along the corridor alone", "other routes", "distance")
#: macro of an effect of a further column of the run table
COVARIATE: Final = "covariate"


def known_effects() -> set[str]:
    """Return the effects that act on the wheels, beside those of further columns."""
    macros = vars(formats.templates().get_template("c_acts.j2").module)
    return {name for name in macros if not name.startswith("_")} - {COVARIATE}


@dataclass(frozen=True, slots=True)
class _Effect:
    section: EffectSection
    #: reference load of the law in N
    reference: str
    #: number of its further column; -1 without one
    column: int

    @property
    def act(self) -> str:
        return COVARIATE if self.column >= 0 else self.section.effect

    @property
    def wheel(self) -> str:
        return "left" if self.section.form.startswith("left") else "right"

    def has(self, size: str) -> bool:
        return size in self.section.parameters

    def __getitem__(self, size: str) -> str:
        return c_number(self.section.parameters[size].value if self.has(size) else 0.0)

    def setting(self, name: str, default: float) -> str:
        return c_number(self.section.settings.get(name, float(default)))

    def off(self, value: str) -> str:
        """Return how far a number of the run lies from where the effect is zero."""
        spread = c_number(self.section.settings.get("spread", 1.0) or 1.0)
        return f"calib_effects_off({value}, {self.setting('centre', 0.0)}, {spread})"


def effects_header(file: CoefficientFile, _options: ExportOptions) -> tuple[Artifact, ...]:
    """Return the header with effects, or the law alone; options change nothing."""
    known = known_effects()

    def acts(section: EffectSection) -> bool:
        is_known = section.effect in known or section.effect.startswith("covariate:")
        return is_known and not any(words in section.form for words in OTHER_FORMS)

    acting = [section for section in file.effects if acts(section)]
    others = [section.effect for section in file.effects if not acts(section)]
    covariates = [section.effect.partition(":")[2] for section in acting if ":" in section.effect]
    reference = c_number(file.wheels.left.reference_load.value)
    effects = []
    for section in acting:
        at = covariates.index(section.effect.partition(":")[2]) if ":" in section.effect else -1
        effects.append(_Effect(section, reference, at))
    values = {"acting": effects, "others": others, "accepted": formats.accepted_lines(file), "covariates": covariates}
    data = rendered("c_effects.h.j2", file=file, **values)
    return (Artifact(EFFECTS_NAME, data, (f"not in the header: {', '.join(others)}",) if others else ()),)


#: of each wheel: radius, standard uncertainty of the mean, half widths of the 95 % bands of mean and single run
TABLE_COLUMNS: Final = ("radius_{}_m", "radius_{}_std_m", "radius_{}_mean_u95_m", "radius_{}_prediction_u95_m")
#: significant digits: a radius to less than a nanometre, uncertainties to a millionth
DIGITS: Final = (10, 6, 6, 6)
ROWS: Final = 41
LOAD_DECIMALS: Final = 3


def radius_table(file: CoefficientFile, options: ExportOptions) -> tuple[Artifact, ...]:
    """Return radius against load, with uncertainty, at chosen loads, else at 41 over the valid ranges.

    A cell is empty where a wheel's law was not measured and the file says refuse.
    """
    sides = {"left": file.law.left, "right": file.law.right}
    pairs = [(pair.left_N, pair.right_N) for pair in options.loads]
    if not pairs:
        low, high = min(law.load_min_N for law in sides.values()), max(law.load_max_N for law in sides.values())
        between = np.round(np.linspace(low, high, ROWS)[1:-1], LOAD_DECIMALS)
        pairs = [(float(load), float(load)) for load in np.unique([low, *between, high])]
    columns = dict(zip(sides, zip(*pairs, strict=True), strict=True))
    cells = {f"load_{side}_N": list(map(repr, loads)) for side, loads in columns.items()}
    clamp = file.outside == "clamp"
    for side, law in sides.items():
        loads = np.array(columns[side])
        used = np.clip(loads, law.load_min_N, law.load_max_N)
        cells |= _columns_of(law, used, side, (used == loads) | clamp)
        if clamp:
            cells[f"clamped_load_{side}_N"] = list(map(repr, used.tolist()))
    empty = [row for row in range(len(pairs)) if all(not cells[TABLE_COLUMNS[0].format(side)][row] for side in sides)]
    if empty:
        left, right = pairs[empty[0]]
        raise RefusedError(
            f"load {left:g} N left, {right:g} N right: found no wheel whose law holds there; expected "
            f"{sides['left'].load_min_N:g} to {sides['left'].load_max_N:g} N; give another --load or --outside clamp"
        )
    cells["simulated"] = [str(file.simulated).lower()] * len(pairs)
    cells["checksum"] = [file.checksum[: formats.CHECKSUM_DIGITS]] * len(pairs)
    if file.effects:
        # CSV has no comments that every reader skips
        cells["effects_not_in_table"] = [" ".join(effect.effect for effect in file.effects)] * len(pairs)
    if file.accepted_implausible is not None:
        cells["accepted_implausible"] = [file.accepted_implausible.reason] * len(pairs)
    if file.failed_checks:
        cells["failed_checks"] = [" | ".join(file.failed_checks)] * len(pairs)
    text = csv_text(list(cells), zip(*cells.values(), strict=True))
    return (Artifact("radius_table.csv", text.encode("utf-8", "backslashreplace")),)


def _columns_of(law: WheelLaw, used: FloatArray, side: str, shown: BoolArray) -> dict[str, list[str]]:
    bands = (law.half_width_m(used, single_run=single) for single in (False, True))
    numbers = (law.radius_m(used), law.mean_std_m(used), *bands)
    return {
        name.format(side): [
            f"{float(x):.{digits}g}" if keep and np.isfinite(x) else "" for x, keep in zip(column, shown, strict=True)
        ]
        for name, column, digits in zip(TABLE_COLUMNS, numbers, DIGITS, strict=True)
    }


#: parameters that are the track, or make it
TRACKS: Final = ("track_m", "half_length_plus_half_width_m")
_MECANUM: Final = "mecanum_drive_controller"
#: drive -> its controllers. A tricycle's free rear wheels are read as a differential drive's; its controller depends on
#: which wheels have motors
OF_DRIVE: Final[dict[str, tuple[str, ...]]] = {
    "tricycle": ("diff_drive_controller", "tricycle_controller", "tricycle_steering_controller"),
    "differential": ("diff_drive_controller",),
    "mecanum": (_MECANUM,),
    "ackermann": ("bicycle_steering_controller", "ackermann_steering_controller"),
    "skid": ("diff_drive_controller",),
}
CONTROLLERS: Final = tuple(dict.fromkeys(name for names in OF_DRIVE.values() for name in names))
#: where the front wheel alone drives the odometry, rear wheels were not measured
OF_FRONT: Final = ("tricycle_controller",)


def controllers_of(file: CoefficientFile, options: ExportOptions) -> tuple[Artifact, ...]:
    """Return a YAML a load point, with the drive's controllers or those chosen."""
    together = file.joint_geometry
    steered = together is not None and together.source == "front"
    controllers = options.controllers or (OF_FRONT if steered else OF_DRIVE[file.geometry.drive])
    if unknown := [name for name in controllers if name not in CONTROLLERS]:
        fault = f"controller: found {unknown[0]!r}"
        raise BadInputError(f"{fault}; expected one of {', '.join(CONTROLLERS)}; choose one of them")
    values = {
        "file": file,
        "options": options,
        "controllers": controllers,
        "calibrated": together is not None and any(entry.first in TRACKS for entry in together.covariance),
        "known": file.together,
        "left_out": left_out_lines(file, "file"),
        "at": sys.modules[__name__],
    }
    artifacts: dict[str, Artifact] = {}
    for pair in options.loads or formats.default_loads(file):
        left, right = radii_m(file, pair)
        if _MECANUM in controllers and (options.open_loop or not options.position_feedback):
            raise RefusedError(
                f"{_MECANUM}: found open_loop or position_feedback chosen; expected neither, since this "
                "controller has no such parameter; leave them out"
            )
        data = rendered("ros2.yaml.j2", pair=pair, left=left, right=right, used=formats.within_N(file, pair), **values)
        artifacts.setdefault(_name(pair), Artifact(_name(pair), data))
    return tuple(artifacts.values())


def _name(pair: LoadPair) -> str:
    text = f"{pair.left_N:.6g}N" if pair.left_N == pair.right_N else f"L{pair.left_N:.6g}N_R{pair.right_N:.6g}N"
    return f"controllers_{re.sub('[^0-9A-Za-z_.]', '_', text)}.yaml"


#: path and turning after which the pose's variances are stated: an aisle and its corner
PATH_M: Final = 10.0
TURN_RAD: Final = math.pi / 2.0
#: motion at which the twist's variances are stated, and the controllers' window: 0.1 s at 100 Hz
SPEED_MPS: Final = 1.0
TURN_RATE_RADPS: Final = 1.0
WINDOW_S: Final = 0.1
#: variances of height, roll and pitch, which odometry in the plane does not measure
UNSEEN: Final = (1e6, 1e6, 1e6)
#: uncalibrated standard uncertainties: a length (relative), the steering's zero (1 degree), its scale
LENGTH_STD: Final = 0.01
STEERING_ZERO_STD_RAD: Final = math.radians(1.0)
STEERING_SCALE_STD: Final = 0.01
#: steering angle of the turns
STEERING_RAD: Final = math.pi / 4.0


@dataclass(frozen=True, slots=True)
class Diagonals:
    """Variances of x, y, z, roll, pitch and yaw."""

    #: in m^2 and rad^2, and in (m/s)^2 and (rad/s)^2
    pose: tuple[float, ...]
    twist: tuple[float, ...]
    #: parameters that were not calibrated: their uncertainty is assumed
    assumed: tuple[str, ...] = ()


def rear_diagonals(file: CoefficientFile, pair: LoadPair) -> Diagonals:
    """Return the diagonals of two wheels on an axle at a load point, or the nearest valid one."""
    law, track = file.law, file.vehicle.track.value
    loads = formats.within_N(file, pair)
    radius = np.array([float(law.left.radius_m(loads[0])), float(law.right.radius_m(loads[1]))])
    left, right = 1.0 / radius
    path = [0.5 * left, 0.5 * right]
    rates = np.array([[*path, 0.0], [-left / track, right / track, 0.0], [*path, -1.0 / track]])
    per_rev = np.array(list(file.encoder.si("counts_per_rev_left", "counts_per_rev_right").values()))
    count = (2.0 * math.pi * radius / per_rev * file.noise.count_std.value) ** 2
    reading = (0.25 * float(count.sum()), float(count.sum()) / track**2)
    return _diagonals(file, rates, law.covariance_at(loads, file.vehicle.track_std.value, single_run=True), reading)


def steered_diagonals(file: CoefficientFile, pair: LoadPair, *, traction: str) -> Diagonals:
    """Return the diagonals of steering, assumed where the geometry lacks it, and traction wheels.

    `traction` ({"front", "rear", "shaft"}): what turning is measured: front wheel, rear wheels, or drive shaft behind.
    """
    from calib.kinematics.drives import STEERING_SCALE

    shaft = traction == "shaft"
    names = ("rear_radius_m" if shaft else "front_radius_m", "wheelbase_m", "steering_zero_rad", STEERING_SCALE)
    wheelbase = file.vehicle.wheelbase.value
    front = file.wheels.left.radius_ref.value if shaft else file.geometry.front_radius_m
    usual = (LENGTH_STD * front, LENGTH_STD * wheelbase, STEERING_ZERO_STD_RAD, STEERING_SCALE_STD)
    covariance, assumed = _known(file, names, usual)
    travel = 0.0 if traction == "rear" else 1.0 / front
    # turn in proportion to tan(angle) behind, to sin(angle) of the front wheel's own way
    by_angle = (math.tan(STEERING_RAD) + 1.0 / math.tan(STEERING_RAD)) if shaft else 1.0 / math.tan(STEERING_RAD)
    bend, turn = [0.0, 0.0, 1.0 / wheelbase, 0.0], [travel, -1.0 / wheelbase, by_angle, STEERING_RAD * by_angle]
    steered = _diagonals(file, np.array([[travel, 0.0, 0.0, 0.0], bend, turn]), covariance)
    if traction != "rear":
        return replace(steered, assumed=assumed)
    assumed = tuple(name for name in assumed if name != names[0])
    rear = rear_diagonals(file, pair)
    return Diagonals((rear.pose[0], *steered.pose[1:]), (rear.twist[0], *steered.twist[1:]), assumed)


def mecanum_diagonals(file: CoefficientFile) -> Diagonals:
    """Return the diagonals of odometry from four wheels with rollers."""
    arm, radius = 0.5 * file.vehicle.track.value, file.wheels.left.radius_ref.value
    names = ("wheel_radius_m", "half_length_plus_half_width_m")
    covariance, assumed = _known(file, names, (LENGTH_STD * radius, LENGTH_STD * arm))
    rates = np.array([[1.0 / radius, 0.0], [0.0, 0.0], [1.0 / radius, -1.0 / arm]])
    return replace(_diagonals(file, rates, covariance), assumed=assumed)


def _diagonals(
    file: CoefficientFile, rates: FloatArray, covariance: FloatArray, reading: tuple[float, float] = (0.0, 0.0)
) -> Diagonals:
    of_path, of_heading = reading
    stretch, bend, turn = (float(variance) for variance in np.einsum("ij,jk,ik->i", rates, covariance, rates))
    along, heading = file.noise.along.value**2, file.noise.heading.value**2
    pose = (
        PATH_M**2 * stretch + PATH_M * along + 2.0 * of_path,
        0.25 * PATH_M**4 * bend + PATH_M**3 / 3.0 * heading + PATH_M**2 * of_heading,
        *UNSEEN,
        PATH_M**2 * bend + TURN_RAD**2 * turn + (PATH_M + WAY_PER_RAD_M * TURN_RAD) * heading + 2.0 * of_heading,
    )
    walked = (SPEED_MPS + WAY_PER_RAD_M * TURN_RATE_RADPS) / WINDOW_S
    twist = (
        SPEED_MPS**2 * stretch + walked * along + 2.0 * of_path / WINDOW_S**2,
        # lateral speed is zero, its random walk that of the path
        walked * along,
        *UNSEEN,
        SPEED_MPS**2 * bend + TURN_RATE_RADPS**2 * turn + walked * heading + 2.0 * of_heading / WINDOW_S**2,
    )
    return Diagonals(pose, twist)


def _known(
    file: CoefficientFile, names: tuple[str, ...], assumed_std: tuple[float, ...]
) -> tuple[FloatArray, tuple[str, ...]]:
    covariance = np.diag(np.square(assumed_std))
    together = file.joint_geometry
    entries = [] if together is None else [e for e in together.covariance if e.first in names and e.second in names]
    determined = {entry.first for entry in entries if entry.first == entry.second}
    for entry in entries:
        row, column = names.index(entry.first), names.index(entry.second)
        covariance[row, column] = covariance[column, row] = entry.covariance.value
    return covariance, tuple(name for name in names if name not in determined)
