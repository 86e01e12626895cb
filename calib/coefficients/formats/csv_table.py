"""The coefficients as a look-up table: radius of both wheels against load, with its uncertainty, as CSV."""

from __future__ import annotations

from typing import Final

import numpy as np

from calib.coefficients.file import CoefficientFile
from calib.coefficients.formats import Artifact, ExportOptions
from calib.documents import csv_text
from calib.errors import RefusedError
from calib.radius.law import WheelLaw
from calib.types import FloatArray

#: for each wheel: radius, standard uncertainty of the mean, half widths of the 95 % bands of mean and of a single run
COLUMNS: Final = ("radius_{}_m", "radius_{}_std_m", "radius_{}_mean_u95_m", "radius_{}_prediction_u95_m")
#: significant digits of each: a radius to less than a nanometre, its uncertainties to a part in a million
DIGITS: Final = (10, 6, 6, 6)
ROWS: Final = 41
LOAD_DECIMALS: Final = 3
CHECKSUM_DIGITS: Final = 23  # sha256: and 16 digits, enough to find the file


def render(file: CoefficientFile, options: ExportOptions) -> tuple[Artifact, ...]:
    """Return the table at the loads chosen, or at 41 loads over the valid ranges of both wheels.

    Effects of the simulator's model that no radius holds are named in a column of their own, which is there only then.
    A cell stays empty where a wheel's law was not measured at that load and the file says refuse.

    Raises RefusedError where a load asked for is valid for neither wheel.
    """
    sides = {"left": file.law.left, "right": file.law.right}
    pairs = [(pair.left_N, pair.right_N) for pair in options.loads]
    if not pairs:
        low, high = min(law.load_min_N for law in sides.values()), max(law.load_max_N for law in sides.values())
        # the ends as they are valid, rounded between them
        between = np.round(np.linspace(low, high, ROWS)[1:-1], LOAD_DECIMALS)
        pairs = [(float(load), float(load)) for load in np.unique([low, *between, high])]
    columns = {f"load_{side}_N": [pair[at] for pair in pairs] for at, side in enumerate(sides)}
    cells: dict[str, list[str]] = {name: [repr(value) for value in values] for name, values in columns.items()}
    for side, law in sides.items():
        cells |= _wheel(law, np.array(columns[f"load_{side}_N"]), side, clamp=file.outside == "clamp")
    empty = [row for row in range(len(pairs)) if all(not cells[COLUMNS[0].format(side)][row] for side in sides)]
    if empty:
        left, right = pairs[empty[0]]
        raise RefusedError(
            f"load {left:g} N left, {right:g} N right: found no wheel whose law was measured there; expected "
            f"{sides['left'].load_min_N:g} to {sides['left'].load_max_N:g} N; give another --load or --outside clamp"
        )
    cells["simulated"] = [str(file.simulated).lower()] * len(pairs)
    cells["checksum"] = [file.checksum[:CHECKSUM_DIGITS]] * len(pairs)
    if file.effects:
        # a column, since CSV has no comments that every reader skips
        cells["effects_not_in_table"] = [" ".join(effect.effect for effect in file.effects)] * len(pairs)
    if file.accepted_implausible is not None:
        cells["accepted_implausible"] = [file.accepted_implausible.reason] * len(pairs)
    text = csv_text(list(cells), zip(*cells.values(), strict=True))
    return (Artifact("radius_table.csv", text.encode("utf-8", "backslashreplace")),)


def _wheel(law: WheelLaw, loads: FloatArray, side: str, *, clamp: bool) -> dict[str, list[str]]:
    from scipy.stats import t

    used = np.clip(loads, law.load_min_N, law.load_max_N)
    k = float(t.ppf(0.975, law.dof)) if law.dof > 0 else float("nan")
    mean = law.mean_std_m(used)
    numbers = (law.radius_m(used), mean, k * mean, k * law.prediction_std_m(used))
    shown = (used == loads) | clamp
    return {
        name.format(side): [
            f"{float(x):.{digits}g}" if keep and np.isfinite(x) else "" for x, keep in zip(column, shown, strict=True)
        ]
        for name, column, digits in zip(COLUMNS, numbers, DIGITS, strict=True)
    }
