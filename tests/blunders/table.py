"""Every blunder through ``calib geometry`` and ``calib diagnose``: ``python -m tests.blunders.table``.

A row a blunder and reference (end poses, along the path): exit status of both commands, what they name, and what became
of it. An exit status of 0 beside an interval that misses the truth is silent. ``--controls 20``: sound campaigns.
"""

from __future__ import annotations

import argparse
import io
import json
import sys
import tempfile
from collections import Counter
from collections.abc import Collection
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from enum import StrEnum
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
    "rear_radius_m": plant.RADIUS_LEFT_M,
    "wheel_radius_m": plant.RADIUS_LEFT_M,
    "half_length_plus_half_width_m": plant.ARM_M,
    "wheelbase_m": plant.WHEELBASE_M,
}
#: what a diagnosis may name with exit status 0: the calibration of the plant, or the blunder itself
RIGHT: Final = {
    *("radius_scale", "unequal_radii", "track_width", "encoder_gross", "reference_latency", "reference_yaw"),
    *("steering_scale", "steering_zero", "steering_backlash", "steering_delay", "drive_slip"),
}
#: effect that the plant has beside each blunder -> its size
SIZES: Final = {"steering_delay": plant.STEERING_DELAY_S}
#: a size is right within twice its 95 % interval: beyond four standard uncertainties it is none of chance
INTERVALS: Final = 2.0
#: blunder -> what geometry may name; of the others nothing is named, or what is wrong is said in an error
NAMES: Final = {
    **{f"axes turned by {degrees} degrees": {"axes_turned"} for degrees in (30, 10, 2, 90, 180)},
    "tricycle axes turned by 30 degrees": {"axes_turned"},
    "time in milliseconds": {"time_unit"},
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
    "left counts per revolution half": {"counts_per_rev", "radius_factor"},
    "left counts stay at zero": {"counter_still"},
    "heading off by a turn in one run": {"heading_turn"},
    "half the track as track": {"half_track"},
    "diameter as radius": {"radius_factor"},
    "steering in degrees": {"steering_unit"},
    "steering reversed": {"reversed_steering"},
    "counters reset halfway": {"count_jump"},
    "a tenth of the counts lost": {"counts_lost"},
    "counts of the motor's shaft": {"count_gear", "radius_factor"},
    "steering of the motor's shaft": {"steering_gear"},
    "radius in inches": {"count_gear", "radius_factor"},
    "y of a camera squeezed by 8 %": {"axis_scale"},
    "positions in degrees of latitude": {"radius_factor"},
    "absolute steering encoder that wraps": {"steering_wraps"},
    "steering 0.3 rad off its zero": {"steering_offset"},
    "steering stays at zero": {"steering_still"},
    "heading as the quaternion's z": {"heading_quaternion"},
    **{f"steering with a play of {play} rad": {"steering_play"} for play in ("0.02", "0.06")},
}


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


def missed(document: dict[str, Any]) -> list[str]:
    """Return the parameters of a geometry whose stated interval misses the truth."""
    wrong = []
    for name, value in document.get("parameters", {}).items():
        low, high = value["ci95"]
        if name in TRUTH and not low <= TRUTH[name] <= high:
            wrong.append(f"{name} {100 * (value['value'] / TRUTH[name] - 1.0):+.2f} %")
    return wrong


class Outcome(StrEnum):
    """What became of a blunder in ``geometry``."""

    #: a result with another exit status than 0 that names the blunder
    NAMED = "named"
    #: an error, or a result that is doubtful or wrong, without a name for it
    REFUSED = "refused"
    #: exit status 0, and every interval holds the truth: the blunder does not touch what is estimated
    UNCHANGED = "answer unchanged"
    #: exit status 0 beside an interval that misses the truth
    SILENT = "SILENT"
    #: another blunder is named
    MISNAMED = "MISNAMED"


@dataclass(frozen=True)
class Row:
    """A blunder by both commands."""

    name: str
    reference: str
    geometry: Answer
    diagnosis: Answer | None

    @property
    def codes(self) -> list[str]:
        """What geometry names."""
        return [fault.get("code", "") for fault in self.geometry.document.get("faults", ())]

    @property
    def outcome(self) -> Outcome:
        """What became of the blunder in geometry."""
        if not set(self.codes) <= NAMES.get(self.name, set()):
            return Outcome.MISNAMED
        if self.geometry.status == 0:
            return Outcome.SILENT if missed(self.geometry.document) else Outcome.UNCHANGED
        return Outcome.NAMED if self.codes else Outcome.REFUSED

    @property
    def diagnosis_unnoticed(self) -> bool:
        """Whether the diagnosis gives an all-clear, or recommends a fix, beside the blunder."""
        return self.diagnosis is not None and self.diagnosis.status == 0 and not _right(self.diagnosis.document)

    def __str__(self) -> str:
        error = self.geometry.error.splitlines()[0][:90] if self.geometry.error else ""
        said = ", ".join(self.codes) or self.geometry.document.get("verdict", "") or error
        off = missed(self.geometry.document) if self.geometry.status == 0 else []
        cells = [self.name, self.reference, str(self.geometry.status), said, " ".join([self.outcome, *off])]
        if self.diagnosis is not None:
            causes = ", ".join(cause["effect"] for cause in self.diagnosis.document.get("causes", ()))
            word = f"{self.diagnosis.document.get('verdict', self.diagnosis.error[:60])} {causes}"
            cells += [str(self.diagnosis.status), word, "SILENT" if self.diagnosis_unnoticed else ""]
        return "| " + " | ".join(cells) + " |"


def _right(document: dict[str, Any]) -> bool:
    """Return whether a diagnosis names the calibration of the plant, or the blunder, and nothing else."""
    causes = document.get("causes", ())
    return bool(causes) and all(cause["effect"] in RIGHT and _size_right(cause) for cause in causes)


def _size_right(cause: dict[str, Any]) -> bool:
    """Return whether the size of a cause that the plant has is that of the plant."""
    if cause["effect"] not in SIZES:
        return True
    ((value, (low, high)),) = ((size["value"], size["ci95"]) for size in cause["parameters"].values())
    return bool(abs(value - SIZES[cause["effect"]]) <= INTERVALS * 0.5 * (high - low))


REFERENCES: Final = {"end poses": False, "along": True}
PLANTS: Final = ((DIFFERENTIAL, plant.differential), (TRICYCLE, plant.tricycle))
ALL_NAMES: Final = (*DIFFERENTIAL, *TRICYCLE)
#: drives of the controls: campaigns without any blunder
SOUND: Final = (plant.differential, plant.tricycle, plant.ackermann, plant.mecanum)


def geometry(place: Path, reference: str) -> Answer:
    """Run ``calib geometry`` on a campaign folder."""
    return ask("geometry", str(place), *(["--using", "windows"] if REFERENCES[reference] else []))


def rows(
    names: Collection[str],
    *,
    diagnose: bool,
    folder: Path,
    references: Collection[str] = tuple(REFERENCES),
    repeats: int = 3,
) -> list[Row]:
    """Return the rows of the named blunders, each route driven so often."""
    found = []
    for changes, make in PLANTS:
        sound = make(np.random.default_rng(1), repeats)
        for name in (name for name in changes if name in names):
            altered = sound.copy()
            changes[name](altered)
            for reference in references:
                place = plant.write(altered, folder / f"{len(found)}", along=REFERENCES[reference])
                diagnosis = ask("diagnose", str(place)) if diagnose and not REFERENCES[reference] else None
                found.append(Row(name, reference, geometry(place, reference), diagnosis))
                sys.stdout.write(f"{found[-1]}\n")
                sys.stdout.flush()
    return found


def controls(seeds: Collection[int], folder: Path, references: Collection[str] = tuple(REFERENCES)) -> int:
    """Print what geometry makes of sound campaigns of each drive, and return how many it does not pass."""
    refused = 0
    for make in SOUND:
        bad, inside, intervals = [], 0, 0
        for seed in seeds:
            for reference in references:
                along = REFERENCES[reference]
                sound = make(np.random.default_rng(seed))
                place = plant.write(sound, folder / f"{make.__name__}{seed}{along}", along=along)
                answer = geometry(place, reference)
                intervals += len(TRUTH.keys() & answer.document.get("parameters", {}).keys())
                inside -= len(missed(answer.document))
                if answer.status != 0:
                    bad.append(f"seed {seed}, {reference}: {answer.document.get('why', answer.error)}")
        refused += len(bad)
        sys.stdout.write(
            f"{make.__name__}: {len(seeds) * len(references)} sound campaigns, not passed {len(bad)}; "
            f"intervals that hold the truth {inside + intervals} of {intervals}\n"
            + "".join(f"  {one}\n" for one in bad)
        )
        sys.stdout.flush()
    return refused


def main() -> None:
    """Print the table; exit status 1 where a blunder goes unnoticed or a sound campaign is not passed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="blunders; all by default")
    parser.add_argument("--no-diagnosis", action="store_true")
    parser.add_argument("--reference", action="append", choices=list(REFERENCES), help="both by default")
    parser.add_argument("--part", default="1/1", help="1/3: the first of three parts of the table")
    parser.add_argument(
        "--controls", type=int, default=0, metavar="SEEDS", help="sound campaigns of each drive instead"
    )
    given = parser.parse_args()
    references = given.reference or list(REFERENCES)
    with tempfile.TemporaryDirectory() as folder:
        if given.controls:
            sys.exit(int(controls(range(2, 2 + given.controls), Path(folder), references) > 0))
        part, parts = map(int, given.part.split("/"))
        names = (given.names or ALL_NAMES)[part - 1 :: parts]
        sys.stdout.write("| blunder | reference | geometry | it says | outcome | diagnose | it says | |\n")
        sys.stdout.write("|---" * 8 + "|\n")
        table = rows(names, diagnose=not given.no_diagnosis, folder=Path(folder), references=references)
    outcomes = Counter(row.outcome for row in table)
    silent, asked = sum(row.diagnosis_unnoticed for row in table), sum(row.diagnosis is not None for row in table)
    counts = ", ".join(f"{outcome} {outcomes[outcome]}" for outcome in Outcome)
    sys.stdout.write(f"{len(table)} recordings: geometry {counts}; diagnose silent {silent} of {asked}\n")
    sys.exit(int(silent + outcomes[Outcome.SILENT] + outcomes[Outcome.MISNAMED] > 0))


if __name__ == "__main__":
    main()
