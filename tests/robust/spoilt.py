"""A table of spoilt campaigns: what each command answers to units, settings and columns that are wrong.

``python -m tests.robust.spoilt`` makes them from ``sample_runs``, runs ``check``, ``fit``, ``export`` and ``report`` on
each and prints the table as Markdown; what passes silently is named and counted.
"""

from __future__ import annotations

import contextlib
import csv
import io
import math
import re
import shutil
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

from calib.campaign.check import check_campaign
from calib.campaign.read import read_campaign
from calib.cli.main import run

ROOT = Path(__file__).resolve().parents[2]
Spoil = Callable[[Path], None]
Change = Callable[[float], float]

#: answers: a check has failed and nothing is passed on; a file cannot be used; the check calls it suspicious, and it is
#: passed on; nothing is noticed
FAILED, REFUSED, SAID, SILENT = "failed", "refused", "said", "silent"


@dataclass(frozen=True)
class Case:
    """One spoilt campaign."""

    name: str
    spoil: Spoil
    wanted: str = FAILED
    base: str = "corridor"


def _rows(folder: Path) -> tuple[list[str], list[dict[str, str]]]:
    with (folder / "runs.csv").open(newline="", encoding="utf-8") as stream:
        reader = csv.DictReader(stream)
        rows = list(reader)
        return list(reader.fieldnames or ()), rows


def _write(folder: Path, names: list[str], rows: list[dict[str, str]]) -> None:
    with (folder / "runs.csv").open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, fieldnames=names, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def column(*names: str, change: Change) -> Spoil:
    """Return a spoiling that changes every value of some columns; logs are dropped where counts or ranges change."""

    def spoil(folder: Path) -> None:
        fields, rows = _rows(folder)
        for row in rows:
            for name in names:
                if row.get(name):
                    row[name] = repr(change(float(row[name])))
            if {"counts_left", "counts_right", "distance_m"} & set(names) and "log" in row:
                row["log"] = ""
        _write(folder, fields, rows)

    return spoil


def setting(key: str, change: Change) -> Spoil:
    """Return a spoiling that changes one number of ``campaign.toml``."""

    def spoil(folder: Path) -> None:
        path = folder / "campaign.toml"
        section, _, name = key.rpartition(".")
        text = path.read_text(encoding="utf-8")
        pattern = rf"(?ms)(^\[{section}\]\n(?:[^\[]*?\n)?{name} = )([-+\d.e]+)"
        changed, count = re.subn(
            pattern, lambda found: found.group(1) + repr(change(float(found.group(2)))), text, count=1
        )
        assert count == 1, key
        if name == "counts_per_rev":
            changed = re.sub(r"(?m)^(counts_per_rev = )(\d+)\.0$", r"\1\2", changed)
        path.write_text(changed, encoding="utf-8")

    return spoil


def rows(change: Callable[[list[dict[str, str]]], None]) -> Spoil:
    """Return a spoiling of the rows as a whole; logs are dropped."""

    def spoil(folder: Path) -> None:
        fields, table = _rows(folder)
        change(table)
        for row in table:
            if "log" in row:
                row["log"] = ""
        _write(folder, fields, table)

    return spoil


def times(factor: float) -> Change:
    """Return the change by a factor."""
    return lambda value: value * factor


def _shift(name: str, by: int) -> Callable[[list[dict[str, str]]], None]:
    def change(table: list[dict[str, str]]) -> None:
        values = [row[name] for row in table]
        for row, value in zip(table, [*values[-by:], *values[:-by]], strict=True):
            row[name] = value

    return change


def _alike(name: str, value: str) -> Callable[[list[dict[str, str]]], None]:
    def change(table: list[dict[str, str]]) -> None:
        for row in table:
            row[name] = value

    return change


def _reverse(name: str) -> Callable[[list[dict[str, str]]], None]:
    def change(table: list[dict[str, str]]) -> None:
        values = [row[name] for row in table][::-1]
        for row, value in zip(table, values, strict=True):
            row[name] = value

    return change


def _swap(first: str, second: str) -> Callable[[list[dict[str, str]]], None]:
    def change(table: list[dict[str, str]]) -> None:
        for row in table:
            row[first], row[second] = row[second], row[first]

    return change


def _some(name: str, every: int, change: Change) -> Callable[[list[dict[str, str]]], None]:
    def spoil(table: list[dict[str, str]]) -> None:
        for row in table[::every]:
            row[name] = repr(change(float(row[name])))

    return spoil


COMMANDS = ("check", "fit", "export", "report")
COUNTS = ("counts_left", "counts_right")
LOADS = ("load_left_N", "load_right_N")


def cases() -> list[Case]:
    """Return every spoilt campaign with the answer that is wanted."""
    made: list[Case] = []
    for factor, name in (
        (4.0, "4"), (0.25, "1/4"), (2.0, "2"), (0.5, "1/2"), (math.pi, "pi"), (1 / math.pi, "1/pi"),
        (2 * math.pi, "2 pi"), (1 / (2 * math.pi), "1/(2 pi)"), (10.0, "10"), (0.1, "1/10"), (1000.0, "1000"),
    ):  # fmt: skip
        made.append(Case(f"counts per revolution times {name}", setting("encoder.counts_per_rev", times(factor))))
        made.append(Case(f"counts of both wheels times {name}", column(*COUNTS, change=times(factor))))
    for side in ("left", "right"):
        for factor, name in ((4.0, "4"), (0.25, "1/4"), (2.0, "2"), (0.5, "1/2")):
            made.append(
                Case(f"counts of the {side} wheel times {name}", column(f"counts_{side}", change=times(factor)))
            )
    for factor, name in (
        (1000.0, "mm"), (100.0, "cm"), (0.001, "km"), (3.28084, "feet"), (39.3701, "inches"), (1.09361, "yards"),
    ):  # fmt: skip
        wanted = FAILED if name != "yards" else SAID
        made.append(Case(f"distance in {name}", column("distance_m", change=times(factor)), wanted))
    made += [Case(f"distances shifted by {shift} row(s)", rows(_shift("distance_m", shift))) for shift in (1, -1, 2)]
    made.append(
        Case("counts shifted by 1 row", rows(lambda table: [_shift(name, 1)(table) for name in COUNTS] and None))
    )
    made.append(Case("distances in reverse order", rows(_reverse("distance_m"))))
    made += [Case(f"all distances {value} m", rows(_alike("distance_m", value))) for value in ("40", "10", "100")]
    made.append(Case("distances negative", column("distance_m", change=times(-1.0))))
    made.append(Case("distances zero", column("distance_m", change=times(0.0))))
    for factor, name in (
        (1e-3, "kN"), (1 / 9.80665, "kg"), (1 / 4.44822, "pounds-force"), (1e3, "mN"), (9.80665, "N times g"),
        (-1.0, "N, negative"), (0.0, "zero"),
    ):  # fmt: skip
        made.append(
            Case(f"wheel loads in {name}" if factor else "wheel loads zero", column(*LOADS, change=times(factor)))
        )
    made.append(Case("one negative load", rows(_some("load_left_N", 60, times(-1.0)))))
    made.append(Case("every tenth load negative", rows(_some("load_right_N", 10, times(-1.0)))))
    made.append(Case("left load in kN", column("load_left_N", change=times(1e-3))))
    for key, factors in (
        ("vehicle.track_m", ((1000.0, "mm"), (100.0, "cm"), (1e-3, "km"))),
        ("vehicle.wheelbase_m", ((1000.0, "mm"), (100.0, "cm"), (1e-3, "km"))),
        ("vehicle.wheel_radius_m", ((1000.0, "mm"), (100.0, "cm"), (2.0, "a diameter"), (0.5, "halved"))),
        ("vehicle.wheel_radius_m", ((39.3701, "inches"),)),
        ("vehicle.mass_kg", ((1000.0, "g"), (1e-3, "t"), (9.80665, "N"))),
        ("vehicle.cog_x_m", ((1000.0, "mm"), (100.0, "cm"))),
        ("model.radius_left_m", ((1000.0, "mm"), (2.0, "a diameter"))),
        ("model.radius_right_m", ((0.5, "halved"), (100.0, "cm"))),
        ("model.track_m", ((1000.0, "mm"), (0.5, "halved"))),
        ("model.reference_load_N", ((1e-3, "kN"), (1e3, "mN"), (100.0, "times 100"))),
        ("rangefinder.sigma_m", ((1000.0, "mm"),)),
        ("reference.sigma_xy_m", ((1000.0, "mm"),)),
        ("reference.sigma_theta_rad", ((1000.0, "mrad"),)),
    ):  # fmt: skip
        made += [Case(f"{key} in {name}", setting(key, times(factor))) for factor, name in factors]
    for name, change in (
        ("Fahrenheit", lambda value: value * 1.8 + 32), ("kelvin", lambda value: value + 273.15),
        ("tenths of a degree", times(10.0)),
    ):  # fmt: skip
        made.append(Case(f"temperature in {name}", column("temperature_C", change=change)))
    for factor, name, wanted in ((1000.0, "mm/s", FAILED), (100.0, "cm/s", FAILED), (3.6, "km/h", SAID)):
        made.append(Case(f"speed in {name}", column("speed_mps", change=times(factor)), wanted))
    degrees = times(180 / math.pi)
    made.append(Case("end headings in degrees, loops", column("ref_theta_rad", change=degrees), FAILED, "yard"))
    made.append(Case("end headings in milliradians, loops", column("ref_theta_rad", change=times(1e3)), FAILED, "yard"))
    made.append(Case("end headings in degrees, corridor", column("ref_theta_rad", change=degrees)))
    made.append(Case("end poses in mm", column("ref_x_m", "ref_y_m", change=times(1e3))))
    made.append(Case("end poses in km", column("ref_x_m", "ref_y_m", change=times(1e-3))))
    made.append(
        Case("counts per revolution times 4, loops", setting("encoder.counts_per_rev", times(4.0)), FAILED, "yard")
    )
    made.append(Case("track in mm, loops", setting("vehicle.track_m", times(1000.0)), FAILED, "yard"))
    made.append(Case("payload in g", column("payload_kg", change=times(1e3))))
    made.append(Case("payload in pounds", column("payload_kg", change=times(2.20462))))
    made.append(Case("payload place in mm", column("payload_x_m", change=times(1e3))))
    made.append(Case("wheel counts swapped, corridor", rows(_swap(*COUNTS))))
    made.append(Case("wheel counts swapped, loops", rows(_swap(*COUNTS)), FAILED, "yard"))
    made.append(Case("wheel loads swapped", rows(_swap(*LOADS)), FAILED, "corridor_crossed"))
    made.append(Case("left counts negative", column("counts_left", change=times(-1.0))))
    made.append(Case("wheel radius 10 % too large", setting("vehicle.wheel_radius_m", times(1.1)), SAID))
    made.append(Case("track 10 % too large", setting("vehicle.track_m", times(1.1)), SAID))
    made.append(Case("every distance 5 cm too long", column("distance_m", change=lambda value: value + 0.05), SAID))
    return made


def suspicious(folder: Path) -> set[str]:
    """Return where a check finds something suspicious, and of which kind."""
    return {f"{note.where}: {note.code}" for note in check_campaign(read_campaign(folder, lenient=True)).suspicious}


def answers(case: Case, base: Path) -> dict[str, int]:
    """Return the exit status of every command on a spoilt campaign, and how much is suspicious that was not before."""
    folder = base / "campaign"
    shutil.rmtree(base, ignore_errors=True)
    shutil.copytree(ROOT / "sample_runs" / case.base, folder)
    case.spoil(folder)
    jobs = {
        "check": ["check", str(folder)],
        "fit": ["fit", str(folder)],
        "export": ["export", str(folder), "--to", "json", "--output", str(base / "c.json")],
        "report": ["report", str(folder), "--into", str(base / "r.pdf"), "--date", "2026-01-01"],
    }
    given = {}
    # what the report says is decided before its PDF is set, which takes most of the time
    with mock.patch("calib.reporting.pages.to_pdf", lambda *_: b"%PDF"):
        for name, arguments in jobs.items():
            with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
                given[name] = run(arguments)
    if given["export"] == 0:
        given["suspicious"] = len(suspicious(folder) - suspicious(ROOT / "sample_runs" / case.base))
    return given


def answered(given: dict[str, int]) -> str:
    """Return what the statuses of the commands amount to."""
    # loops allow no law, so that fit, export and report refuse them in any case: what counts there is the check
    if given["check"] == 1 and given["export"] in (1, 2) and given["report"] in (1, 2) and given["fit"] in (1, 2):
        return FAILED
    if all(status == 2 for status in given.values()):
        return REFUSED
    if given["export"] != 0:
        return "torn"
    return SAID if given["suspicious"] else SILENT


def main() -> int:
    """Print the table; the status is 1 where an answer is not the one wanted."""
    out = sys.stdout
    wrong, passed, every = 0, {SAID: [], SILENT: []}, cases()
    out.write("| campaign | check | fit | export | report | answer |\n|---|---|---|---|---|---|\n")
    for case in every:
        with tempfile.TemporaryDirectory() as folder:
            given = answers(case, Path(folder) / "spoilt")
        verdict = answered(given)
        # a file that cannot be used at all is refused by all four, which is as good
        as_wanted = verdict == case.wanted or (case.wanted == FAILED and verdict == REFUSED)
        wrong += not as_wanted
        if verdict in passed:
            passed[verdict].append(case.name)
        mark = "" if as_wanted else f" (wanted {case.wanted})"
        out.write(f"| {case.name} | {' | '.join(str(given[name]) for name in COMMANDS)} | {verdict}{mark} |\n")
        out.flush()
    out.write(f"\n{len(every)} spoilt campaigns.\n")
    for verdict, what in ((SAID, "are called suspicious and passed on"), (SILENT, "pass silently")):
        out.write(f"{len(passed[verdict])} {what}: {'; '.join(passed[verdict])}.\n")
    out.write(f"{wrong} answers are not the ones wanted.\n")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
