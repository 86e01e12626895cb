"""Every blunder through ``calib geometry`` and ``calib diagnose``: ``python -m tests.blunders.table``.

A row a blunder and reference (end poses, along the path): exit status of both commands, what they name, and whether it
went unnoticed: an exit status of 0 beside an interval that misses the truth.
"""

from __future__ import annotations

import argparse
import io
import json
import sys
import tempfile
from collections.abc import Collection
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from calib.cli.main import run
from tests.blunders import plant
from tests.blunders.blunders import DIFFERENTIAL, TRICYCLE

#: parameter -> the truth of the plant
TRUTH: Final = {
    "radius_left_m": plant.RADIUS_LEFT_M,
    "radius_right_m": plant.RADIUS_RIGHT_M,
    "track_m": plant.TRACK_M,
    "front_radius_m": plant.RADIUS_LEFT_M,
    "wheelbase_m": plant.WHEELBASE_M,
}
#: what a diagnosis may name with exit status 0: the calibration of the plant, or the blunder itself
RIGHT: Final = {
    *("radius_scale", "unequal_radii", "track_width", "encoder_gross", "reference_latency", "reference_yaw"),
    *("steering_scale", "steering_zero", "drive_slip"),
}
#: blunder -> what geometry may name; of the others nothing is named, or what is wrong is said in an error
NAMES: Final = {
    **{f"axes turned by {degrees} degrees": {"axes_turned"} for degrees in (30, 10, 2, 90, 180)},
    "tricycle axes turned by 30 degrees": {"axes_turned"},
    "y mirrored": {"y_mirrored"},
    "x mirrored": {"x_mirrored"},
    "y and heading mirrored": {"mirrored", "swapped_wheels"},
    "heading clockwise": {"heading_clockwise"},
    "x and y exchanged": {"axes_exchanged"},
    **{f"positions in {unit}": {"position_unit"} for unit in ("millimetres", "centimetres", "inches")},
    "positions in feet": {"position_unit", "radius_factor"},
    "x alone in millimetres": {"position_unit"},
    "tricycle positions in millimetres": {"position_unit"},
    "heading in degrees": {"heading_unit"},
    "heading in turns": {"heading_unit"},
    **{f"wheel {what} read as counts": {"count_unit"} for what in ("angles in radians", "ways in metres", "turns")},
    "left wheel in radians": {"count_unit"},
    "front counts in radians": {"count_unit"},
    "increments read as counts": {"count_increments"},
    "increments of the left wheel": {"count_increments"},
    "absolute encoder, not unwrapped": {"counts_wrap"},
    "absolute encoder of the right wheel, not unwrapped": {"counts_wrap"},
    "16 bit counter, not unwrapped": {"counts_wrap"},
    "front counts wrap": {"counts_wrap"},
    "counts of left and right exchanged": {"swapped_wheels"},
    "left counts negative": {"reversed_left"},
    "both counts negative": {"reversed_both"},
    **{f"counts per revolution {what}": {"radius_factor"} for what in ("half", "a quarter", "double")},
    "left counts per revolution half": {"counts_per_rev"},
    "heading off by a turn in one run": {"heading_turn"},
    "half the track as track": {"half_track"},
    "diameter as radius": {"radius_factor"},
    "steering in degrees": {"steering_unit"},
    "steering reversed": {"reversed_steering"},
    "counters reset halfway": {"count_jump"},
    "counts of the motor's shaft": {"count_gear", "radius_factor"},
    "steering of the motor's shaft": {"steering_gear"},
    "radius in inches": {"count_gear"},
    "positions in degrees of latitude": {"radius_factor"},
    "absolute steering encoder that wraps": {"steering_wraps"},
}
#: an estimate nearer than this to the truth is no harm (relative)
HARMLESS: Final = 2e-2


@dataclass(frozen=True)
class Answer:
    """What a command answered: exit status, its JSON (empty where it has none), and its one line of error."""

    status: int
    document: dict[str, Any]
    error: str


def ask(*arguments: str) -> Answer:
    """Run a command in this process with its JSON on standard output."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        status = run([*arguments, "--json", "-"])
    try:
        document = json.loads(out.getvalue())
    except ValueError:
        document = {}
    return Answer(status, document, err.getvalue().strip())


def harmful(document: dict[str, Any]) -> list[str]:
    """Return the parameters of a geometry whose value is further from the truth than is harmless."""
    wrong = []
    for name, value in document.get("parameters", {}).items():
        if name in TRUTH:
            off = value["value"] / TRUTH[name] - 1.0
            if abs(off) > HARMLESS:
                wrong.append(f"{name} {100 * off:+.1f} %")
    return wrong


@dataclass(frozen=True)
class Row:
    """A blunder by both commands."""

    name: str
    reference: str
    geometry: Answer
    diagnosis: Answer | None

    @property
    def geometry_unnoticed(self) -> bool:
        """Whether geometry gives wrong parameters with exit status 0."""
        return self.geometry.status == 0 and bool(harmful(self.geometry.document))

    @property
    def codes(self) -> list[str]:
        """What geometry names."""
        return [fault.get("code", "") for fault in self.geometry.document.get("faults", ())]

    @property
    def misnamed(self) -> bool:
        """Whether geometry names another blunder than the one that was made."""
        return not set(self.codes) <= NAMES.get(self.name, set())

    @property
    def diagnosis_unnoticed(self) -> bool:
        """Whether the diagnosis gives an all-clear, or recommends a fix, beside the blunder."""
        return self.diagnosis is not None and self.diagnosis.status == 0 and not _right(self.diagnosis.document)

    def __str__(self) -> str:
        error = self.geometry.error.splitlines()[0][:90] if self.geometry.error else ""
        named = ", ".join(self.codes) or self.geometry.document.get("verdict", "") or error
        mark = "SILENT " + ", ".join(harmful(self.geometry.document)) if self.geometry_unnoticed else ""
        mark += "MISNAMED" if self.misnamed else ""
        cells = [self.name, self.reference, str(self.geometry.status), named, mark]
        if self.diagnosis is not None:
            causes = ", ".join(cause["effect"] for cause in self.diagnosis.document.get("causes", ()))
            word = f"{self.diagnosis.document.get('verdict', self.diagnosis.error[:60])} {causes}"
            cells += [str(self.diagnosis.status), word, "SILENT" if self.diagnosis_unnoticed else ""]
        return "| " + " | ".join(cells) + " |"


def _right(document: dict[str, Any]) -> bool:
    """Return whether a diagnosis names the calibration of the plant, or the blunder, and nothing else."""
    named = {cause["effect"] for cause in document.get("causes", ())}
    return bool(named) and named <= RIGHT


REFERENCES: Final = {"end poses": False, "along": True}


def rows(
    names: Collection[str], *, diagnose: bool, folder: Path, references: Collection[str] = tuple(REFERENCES)
) -> list[Row]:
    """Return the rows of the named blunders; all of them where none is named."""
    found = []
    for changes, make in ((DIFFERENTIAL, plant.differential), (TRICYCLE, plant.tricycle)):
        sound = make(np.random.default_rng(1))
        for name, change in changes.items():
            if names and name not in names:
                continue
            altered = sound.copy()
            change(altered)
            for reference in references:
                along = REFERENCES[reference]
                place = plant.write(altered, folder / f"{len(found)}", along=along)
                diagnosis = ask("diagnose", str(place)) if diagnose and not along else None
                using = ["--using", "windows"] if along else []
                found.append(Row(name, reference, ask("geometry", str(place), *using), diagnosis))
                sys.stdout.write(f"{found[-1]}\n")
                sys.stdout.flush()
    return found


def main() -> None:
    """Print the table; exit status 1 where a blunder goes unnoticed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*")
    parser.add_argument("--no-diagnosis", action="store_true")
    given = parser.parse_args()
    sys.stdout.write("| blunder | reference | geometry | it names | | diagnose | it says | |\n" + "|---" * 8 + "|\n")
    with tempfile.TemporaryDirectory() as folder:
        table = rows(given.names, diagnose=not given.no_diagnosis, folder=Path(folder))
    silent = sum(row.geometry_unnoticed for row in table), sum(row.diagnosis_unnoticed for row in table)
    asked = sum(row.diagnosis is not None for row in table)
    misnamed, named = sum(row.misnamed for row in table), sum(bool(row.codes) for row in table)
    sys.stdout.write(
        f"{len(table)} recordings: geometry silent {silent[0]}, blunder named {named}, misnamed {misnamed}; "
        f"diagnose silent {silent[1]} of {asked}\n"
    )
    sys.exit(int(any(silent) or misnamed > 0))


if __name__ == "__main__":
    main()
