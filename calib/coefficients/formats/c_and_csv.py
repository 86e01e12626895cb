"""C99 headers and the look-up table as CSV, for programs that read no coefficient file.

What an effect does in a simulator's loop is a macro of its name in ``c_acts.j2``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from itertools import combinations
from typing import Final

import numpy as np

from calib.coefficients import formats
from calib.coefficients.file import CoefficientFile
from calib.coefficients.formats import Artifact, ExportOptions, c_number, left_out_lines, rendered, templates
from calib.coefficients.sections import EffectSection, WheelSection
from calib.documents import csv_text
from calib.errors import RefusedError
from calib.radius.law import JOINT, WheelLaw
from calib.types import FloatArray

INT32_MAX: Final = 2**31 - 1
#: bound of intermediates of the integer form: half of int64_t, so that rounding cannot overflow it
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
    # rounding to nanometres, plus the error of rounded base and slope (linear: worst at an end)
    rounding = [abs(base + slope * at - (base_nm + slope_nm_per_mN * at) * 2**shift) / 2**shift for at in (0, span)]
    return FixedPoint(base, slope, shift, low, high, Fraction(1, 2) + max(rounding))


def coefficients_header(file: CoefficientFile, options: ExportOptions) -> tuple[Artifact, ...]:
    """Return the header of a coefficient file; it holds the whole law, so `options` change nothing."""
    del options
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
#: forms that act through what a single run does not know, as in `calib.runtime.effects`
OTHER_FORMS: Final = ("change of load", "per session", "along the corridor alone", "other routes", "distance")
#: macro of an effect of a further column of the run table
COVARIATE: Final = "covariate"


def known_effects() -> set[str]:
    """Return the effects that act on the wheels, beside those of further columns."""
    macros = vars(templates().get_template("c_acts.j2").module)
    return {name for name in macros if not name.startswith("_")} - {COVARIATE}


@dataclass(frozen=True, slots=True)
class _Effect:
    """An effect as its macro reads it: sizes and settings as C numbers, 0 for a size that the form lacks."""

    name: str
    form: str
    settings: Mapping[str, float]
    sizes: Mapping[str, float]
    #: reference load of the law
    reference_N: float
    #: number of its further column; -1 without one
    column: int

    @property
    def act(self) -> str:
        return COVARIATE if self.column >= 0 else self.name

    @property
    def reference(self) -> str:
        return c_number(self.reference_N)

    @property
    def wheel(self) -> str:
        return "left" if self.form.startswith("left") else "right"

    def has(self, size: str) -> bool:
        return size in self.sizes

    def __getitem__(self, size: str) -> str:
        return c_number(self.sizes.get(size, 0.0))

    def setting(self, name: str, default: float) -> str:
        return c_number(self.settings.get(name, float(default)))

    def off(self, value: str) -> str:
        """Return how far a number of the run lies from where the effect is zero."""
        spread = c_number(self.settings.get("spread", 1.0) or 1.0)
        return f"calib_effects_off({value}, {self.setting('centre', 0.0)}, {spread})"


def effects_header(file: CoefficientFile, options: ExportOptions) -> tuple[Artifact, ...]:
    """Return the header of a coefficient file, with the law alone where it has no effects; `options` change nothing."""
    del options
    known = known_effects()

    def acts(section: EffectSection) -> bool:
        of_column = section.effect.startswith("covariate:")
        return (of_column or section.effect in known) and not any(words in section.form for words in OTHER_FORMS)

    acting = [section for section in file.effects if acts(section)]
    others = [section.effect for section in file.effects if not acts(section)]
    covariates = [section.effect.partition(":")[2] for section in acting if ":" in section.effect]
    reference_N = file.wheels.left.reference_load.value
    effects = []
    for section in acting:
        sizes = {name: quantity.value for name, quantity in section.parameters.items()}
        at = covariates.index(section.effect.partition(":")[2]) if ":" in section.effect else -1
        effects.append(_Effect(section.effect, section.form, section.settings, sizes, reference_N, at))
    values = {"acting": effects, "others": others, "accepted": formats.accepted_lines(file), "covariates": covariates}
    data = rendered("c_effects.h.j2", file=file, **values)
    notes = (f"not in the header: {', '.join(others)}",) if others else ()
    return (Artifact(EFFECTS_NAME, data, notes),)


#: for each wheel: radius, standard uncertainty of the mean, half widths of the 95 % bands of mean and of a single run
TABLE_COLUMNS: Final = ("radius_{}_m", "radius_{}_std_m", "radius_{}_mean_u95_m", "radius_{}_prediction_u95_m")
#: significant digits of each: a radius to less than a nanometre, its uncertainties to a part in a million
DIGITS: Final = (10, 6, 6, 6)
ROWS: Final = 41
LOAD_DECIMALS: Final = 3
CHECKSUM_DIGITS: Final = 23  # sha256: and 16 digits, enough to find the file


def radius_table(file: CoefficientFile, options: ExportOptions) -> tuple[Artifact, ...]:
    """Return radius against load, with its uncertainty, at the loads chosen, else at 41 over both wheels' valid ranges.

    A cell stays empty where a wheel's law was not measured at that load and the file says refuse.
    """
    sides = {"left": file.law.left, "right": file.law.right}
    pairs = [(pair.left_N, pair.right_N) for pair in options.loads]
    if not pairs:
        low, high = min(law.load_min_N for law in sides.values()), max(law.load_max_N for law in sides.values())
        # valid ends, rounded between them
        between = np.round(np.linspace(low, high, ROWS)[1:-1], LOAD_DECIMALS)
        pairs = [(float(load), float(load)) for load in np.unique([low, *between, high])]
    columns = dict(zip(sides, zip(*pairs, strict=True), strict=True))
    cells = {f"load_{side}_N": list(map(repr, loads)) for side, loads in columns.items()}
    for side, law in sides.items():
        cells |= _columns_of(law, np.array(columns[side]), side, clamp=file.outside == "clamp")
    empty = [row for row in range(len(pairs)) if all(not cells[TABLE_COLUMNS[0].format(side)][row] for side in sides)]
    if empty:
        left, right = pairs[empty[0]]
        raise RefusedError(
            f"load {left:g} N left, {right:g} N right: found no wheel whose law holds there; expected "
            f"{sides['left'].load_min_N:g} to {sides['left'].load_max_N:g} N; give another --load or --outside clamp"
        )
    cells["simulated"] = [str(file.simulated).lower()] * len(pairs)
    cells["checksum"] = [file.checksum[:CHECKSUM_DIGITS]] * len(pairs)
    if file.effects:
        # CSV has no comments that every reader skips
        cells["effects_not_in_table"] = [" ".join(effect.effect for effect in file.effects)] * len(pairs)
    if file.accepted_implausible is not None:
        cells["accepted_implausible"] = [file.accepted_implausible.reason] * len(pairs)
    text = csv_text(list(cells), zip(*cells.values(), strict=True))
    return (Artifact("radius_table.csv", text.encode("utf-8", "backslashreplace")),)


def _columns_of(law: WheelLaw, loads: FloatArray, side: str, *, clamp: bool) -> dict[str, list[str]]:
    used = np.clip(loads, law.load_min_N, law.load_max_N)
    bands = (law.half_width_m(used, single_run=single) for single in (False, True))
    numbers = (law.radius_m(used), law.mean_std_m(used), *bands)
    shown = (used == loads) | clamp
    return {
        name.format(side): [
            f"{float(x):.{digits}g}" if keep and np.isfinite(x) else "" for x, keep in zip(column, shown, strict=True)
        ]
        for name, column, digits in zip(TABLE_COLUMNS, numbers, DIGITS, strict=True)
    }
