"""The coefficients as one self-contained C99 header: radius functions, integer form, odometry."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from itertools import combinations
from typing import Final

from calib.coefficients.file import CoefficientFile
from calib.coefficients.formats import Artifact, ExportOptions, left_out_lines, rendered
from calib.coefficients.sections import WheelSection
from calib.errors import RefusedError
from calib.radius.law import JOINT

INT32_MAX: Final = 2**31 - 1
#: bound of every intermediate of the integer form; half the range of int64_t, so that rounding cannot overflow it
INT64_HALF: Final = 2**62
MAX_SHIFT: Final = 40
LAST_BITS_MN: Final = Fraction(1, 10**6)
#: numbers of the vehicle that the header holds
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
    """Return the integer form of the law of a wheel.

    Raises RefusedError where radius or load do not fit 32 bits of nanometres and millinewtons.
    """
    # inwards to whole millinewtons, but for the last bits of a decimal that a double cannot hold
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
    # rounding to whole nanometres, plus the error of the rounded base and slope at the ends (linear: worst at an end)
    rounding = [abs(base + slope * at - (base_nm + slope_nm_per_mN * at) * 2**shift) / 2**shift for at in (0, span)]
    return FixedPoint(base, slope, shift, low, high, Fraction(1, 2) + max(rounding))


def render(file: CoefficientFile, options: ExportOptions) -> tuple[Artifact, ...]:
    """Return the header of a coefficient file; it holds the whole law, so `options` change nothing."""
    del options
    data = rendered(
        "c_header.h.j2",
        file=file,
        left_out=left_out_lines(file, "header"),
        wheels=[(side, wheel, fixed_point(wheel, side)) for side, wheel in file.wheels],
        numbers={
            **file.vehicle.si(*GEOMETRY),
            **file.encoder.si("counts_per_rev_left", "counts_per_rev_right"),
            **file.noise.si("count_std", "along", "heading"),
            **file.limits.si("max_step", "max_gap"),
        },
        # covariances that couple the wheels and the track
        coupled=[(one, other) for one, other in combinations(range(len(JOINT)), 2) if one // 2 != other // 2],
    )
    return (Artifact("calib_coefficients.h", data),)
