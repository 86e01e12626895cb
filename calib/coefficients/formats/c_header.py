"""The coefficients as one self-contained C99 header: radius functions, integer form, odometry."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from importlib.resources import files
from itertools import combinations
from typing import Final

import numpy as np

from calib.coefficients.file import CoefficientFile
from calib.coefficients.formats import Artifact, ExportOptions, ascii_line, left_out_lines
from calib.coefficients.sections import WheelSection
from calib.errors import RefusedError
from calib.radius.law import JOINT

#: see `calib.coefficients.formats`
AXLE_ONLY: Final = True

BODY_NAME: Final = "c_runtime.h"
INT32_MAX: Final = 2**31 - 1
#: bound of every intermediate of the integer form; half the range of int64_t, so that rounding cannot overflow it
INT64_HALF: Final = 2**62
MAX_SHIFT: Final = 40
LAST_BITS_MN: Final = Fraction(1, 10**6)
C_LINKAGE: Final = ("#ifdef __cplusplus", 'extern "C" {', "#endif", "")


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

    def radius_nm(self, load_mN: int) -> int:
        """Return the radius in nm at a load in mN within the valid range, as the C form computes it."""
        total = self.base + self.slope * (load_mN - self.load_min_mN) + (1 << (self.shift - 1))
        return total >> self.shift


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
    body = files("calib.coefficients.formats").joinpath(BODY_NAME).read_text(encoding="utf-8")
    return (Artifact("calib_coefficients.h", (_head(file) + body).encode("utf-8")),)


def _head(file: CoefficientFile) -> str:
    outside = "clamped to its end" if file.outside == "clamp" else "refused, CALIB_LOAD_OUT_OF_RANGE"
    about = [
        f"load outside the valid range: {outside}",
        *left_out_lines(file, "header"),
        "",
        "calib_odometer o; calib_pose p;",
        "calib_init(&o);",
        "calib_set_payload(&o, 120.0, 0.45, 0.02);      or calib_set_wheel_loads, calib_set_load_point",
        "if (calib_feed_at(&o, counts_left, counts_right, t_s) != CALIB_OK) { stop and look }",
        "calib_get_pose(&o, &p);",
    ]
    title = "Wheel coefficients and odometry, C99, no memory allocation, one header to include."
    lines = [
        *begin_header(file, title, about, "CALIB_COEFFICIENTS_H", ("math.h", "stdint.h")),
        *C_LINKAGE,
        f'#define CALIB_CHECKSUM "{file.checksum}"',
        f"#define CALIB_SIMULATED {int(file.simulated)}",
        f"#define CALIB_OUTSIDE_CLAMP {int(file.outside == 'clamp')}",
        "",
        "/* 1: the covariance of the pose also holds the scatter of single runs about the law */",
        "#ifndef CALIB_PREDICTION_BAND",
        "#define CALIB_PREDICTION_BAND 0",
        "#endif",
        "",
        *_wheel(file.wheels.left, "left"),
        *_wheel(file.wheels.right, "right"),
        *_numbers(file),
        *_cross(file),
        *_table(file),
    ]
    return "\n".join([*lines, "", ""])


def begin_header(
    file: CoefficientFile, title: str, about: Sequence[str], guard: str, included: Sequence[str]
) -> list[str]:
    """Return the first lines of a C header.

    Parameters
    ----------
    file : CoefficientFile
        Origin, date and checksum, which the comment states.
    title : str
        First sentence of the comment.
    about : sequence of str
        Its further lines; an empty text is an empty line.
    guard : str
        Macro that keeps the header from being read twice.
    included : sequence of str
        System headers that it needs.
    """
    return [
        f"/* {title}",
        f" * campaign: {ascii_line(file.name)}" + (" -- SIMULATED DATA" if file.simulated else ""),
        f" * created: {file.created or 'no date given'}, calib {ascii_line(file.calib_version)}",
        f" * coefficient file: {file.checksum}",
        *(f" * {line}".rstrip() for line in about),
        " */",
        f"#ifndef {guard}",
        f"#define {guard}",
        "",
        *(f"#include <{name}>" for name in included),
        "",
    ]


def _numbers(file: CoefficientFile) -> list[str]:
    """Return the lines of vehicle, encoders, noise and limits."""
    geometry = ("track", "track_std", "wheelbase", "mass", "cog_x", "cog_y", "max_wheel_load", "gravity")
    numbers = {
        **file.vehicle.si(*geometry),
        **file.encoder.si("counts_per_rev_left", "counts_per_rev_right"),
        **file.noise.si("count_std", "along", "heading"),
        **file.limits.si("max_step", "max_gap"),
    }
    bits = file.encoder.si("wrap_bits")["wrap_bits"]
    return [
        "/* vehicle, encoders, noise, limits */",
        *(f"#define CALIB_{name.upper()} {_c(value)}" for name, value in numbers.items()),
        f"#define CALIB_WRAP_BITS {int(bits or 0)} /* 0: the counters do not wrap */",
        "",
    ]


def _cross(file: CoefficientFile) -> list[str]:
    """Return the covariances that couple the wheels and the track; 0 where they were not estimated together."""
    joint = np.zeros((len(JOINT), len(JOINT))) if file.law.joint is None else file.law.joint
    return [
        "/* covariance of parameters estimated together: 0 radius left, 1 slope left, 2 radius right,",
        " * 3 slope right, 4 track; 0.0 where they were estimated apart */",
        *(
            f"#define CALIB_COV_{first}{second} {_c(joint[first, second])}"
            for first, second in combinations(range(len(JOINT)), 2)
            if first // 2 != second // 2
        ),
        "",
    ]


def _wheel(wheel: WheelSection, side: str) -> list[str]:
    name, integer = f"CALIB_{side.upper()}", fixed_point(wheel, side)
    radius, slope, load = (_c(part.value) for part in (wheel.radius_ref, wheel.slope, wheel.reference_load))
    return [
        # from the same text as the values, so that comment and code agree
        f"/* {side} wheel: {radius} m at the reference load of {load} N, plus {slope} m for each N above it;",
        " * radius = radius_ref + slope (load - reference_load) */",
        f"#define {name}_RADIUS_REF_M {radius}",
        f"#define {name}_SLOPE_M_PER_N {slope}",
        f"#define {name}_REFERENCE_LOAD_N {load}",
        f"#define {name}_LOAD_MIN_N {_c(wheel.valid_load.min.value)}",
        f"#define {name}_LOAD_MAX_N {_c(wheel.valid_load.max.value)}",
        f"#define {name}_VAR_RADIUS_REF_M2 {_c(wheel.variance_radius_ref.value)}",
        f"#define {name}_COV_M2_PER_N {_c(wheel.covariance_radius_ref_slope.value)}",
        f"#define {name}_VAR_SLOPE_M2_PER_N2 {_c(wheel.variance_slope.value)}",
        f"#define {name}_RESIDUAL_STD_M {_c(wheel.residual_std.value)}",
        "/* integer form, nm from mN; error against the law at most: */",
        f"#define {name}_MAX_ERROR_NM {_c(_up(integer.max_error_nm))}",
        f"#define {name}_LOAD_MIN_MN INT32_C({integer.load_min_mN})",
        f"#define {name}_LOAD_MAX_MN INT32_C({integer.load_max_mN})",
        f"#define {name}_SHIFT {integer.shift}",
        f"#define {name}_BASE_Q INT64_C({integer.base})",
        f"#define {name}_SLOPE_Q {_i64(integer.slope)}",
        "",
    ]


def _table(file: CoefficientFile) -> list[str]:
    cases = [
        f"    case {index}: /* {point.name} */\n"
        f"        *left_N = {_c(point.load_left.value)};\n"
        f"        *right_N = {_c(point.load_right.value)};\n"
        f"        return 1;"
        for index, point in enumerate(file.load_table)
    ]
    return [
        f"#define CALIB_LOAD_POINTS {len(file.load_table)}",
        "",
        "/* Wheel loads of a line of the load table; 0 where there is no such line. */",
        "static inline int calib_load_point(unsigned index, double *left_N, double *right_N)",
        "{",
        "    switch (index) {",
        *cases,
        "    default:",
        *([] if cases else ["        (void)left_N;", "        (void)right_N;"]),
        "        return 0;",
        "    }",
        "}",
    ]


def _c(value: float) -> str:
    """Return a double literal that reads back as the same double; negative ones in brackets."""
    text = c_number(value)
    return f"({text})" if text.startswith("-") else text


def c_number(value: float) -> str:
    """Return a double as C reads it, to the last bit."""
    text = repr(float(value))
    return text if any(mark in text for mark in ".e") else f"{text}.0"


def _i64(value: int) -> str:
    return f"(-INT64_C({-value}))" if value < 0 else f"INT64_C({value})"


def _up(bound: Fraction) -> float:
    """Return `bound` rounded up to six decimals, so that the stated error is never below the true one."""
    return float(-((-bound * 10**6) // 1)) / 1e6
