"""What is judged before a fit: the findings of a check, and what the deviation of a path does to the radii."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Final

from calib.reporting.blocks import Block, Facts, Heading, Items, Notice, Text, items, table
from calib.reporting.formatting import MISSING, fixed, plural, prose, span

if TYPE_CHECKING:
    from calib.campaign.check import CheckReport
    from calib.campaign.model import Note
    from calib.radius.run_deviation import RunDeviations

#: entries of a list of names, and runs named for one note
MAX_NAMES: Final = 12
MAX_RUNS: Final = 6
#: lines of one kind of note that differ in their numbers alone; the JSON has them all
MAX_SIMILAR: Final = 8


def check_content(report: CheckReport) -> tuple[Block, ...]:
    """Return the findings of a check, and its verdict."""
    blocks: list[Block] = [
        Heading(f"{report.campaign}{' (simulated)' if report.simulated else ''}"),
        Facts(tuple(_facts(report))),
    ]
    for title, notes in (("Recognised", report.info), ("Suspicious", report.suspicious), ("Wrong", report.wrong)):
        if notes:
            blocks += [Heading(f"{title} ({len(notes)})"), Items(tuple(_grouped(notes)))]
    return (*blocks, _verdict(report))


def _facts(report: CheckReport) -> list[tuple[str, str]]:
    contents = report.found
    rows = [("runs", str(contents.n_runs) + (f", {contents.n_excluded} excluded" if contents.n_excluded else ""))]
    for title, counted in (("sessions", contents.sessions), ("kinds", contents.kinds)):
        if counted:
            rows.append((title, f"{len(counted)}: {_first(f'{key} ({count})' for key, count in counted.items())}"))
    if contents.payloads_kg:
        rows.append(("payloads", f"{_first(f'{value:g}' for value in contents.payloads_kg)} kg"))
    ranges = {
        ("left load", "N"): contents.load_left_N,
        ("right load", "N"): contents.load_right_N,
        ("distance", "m"): contents.distance_m,
        ("speed", "m/s"): contents.speed_mps,
        ("hall", "°C"): contents.temperature_C,
    }
    rows += [(title, span(*ends, unit, ".5g")) for (title, unit), ends in ranges.items() if ends]
    if contents.n_logs and contents.rate_Hz and contents.duration_s:
        size = f"{contents.n_logs}, {contents.n_samples} samples at {span(*contents.rate_Hz, 'Hz')}"
        rows.append(("logs", f"{size}, {span(*contents.duration_s, 's')} ({', '.join(contents.log_columns)})"))
    if contents.covariates:
        rows.append(("covariates", ", ".join(contents.covariates)))
    return rows


def _first(names: Iterable[str]) -> str:
    """Return the first names of a list, and that there are more."""
    listed = list(names)
    return ", ".join(listed[:MAX_NAMES] + ["..."] * (len(listed) > MAX_NAMES))


def _grouped(notes: Sequence[Note]) -> list[str]:
    """Return one line for notes of the same text on several runs."""
    by_text: dict[str, list[Note]] = {}
    for note in notes:
        by_text.setdefault(note.text, []).append(note)
    lines = []
    of_code: Counter[str] = Counter()
    for text, same in by_text.items():
        code = same[0].code
        of_code[code] += 1
        if code and of_code[code] > MAX_SIMILAR:
            continue
        runs = list(dict.fromkeys(note.run_id for note in same if note.run_id))
        where = same[0].where
        if len(same) > 1:
            shown = runs or list(dict.fromkeys(note.where for note in same))
            more = f" and {len(shown) - MAX_RUNS} more" if len(shown) > MAX_RUNS else ""
            where = f"{plural(len(shown), 'run' if runs else 'place')}, {', '.join(shown[:MAX_RUNS])}{more}"
        elif runs:
            where += f" [{runs[0]}]"
        lines.append(prose(f"{where}: {text}"))
    hidden = {code: count - MAX_SIMILAR for code, count in of_code.items() if code and count > MAX_SIMILAR}
    return [*lines, *(f"and {count} more like these: {code.replace('_', ' ')}" for code, count in hidden.items())]


def _verdict(report: CheckReport) -> Notice:
    wrong, suspicious = len(report.wrong), len(report.suspicious)
    if report.verdict == "wrong":
        return Notice("bad", f"Wrong: {plural(wrong, 'fault')}", "Correct them before you compute anything.")
    if report.verdict == "look at this":
        text = f"No fault, and {plural(suspicious, 'thing')} that may spoil the result; decide before you rely on it."
        return Notice("note", "Look at this", text)
    return Notice("good", "Sound", "No fault, and nothing suspicious.")


def weave_content(rows: Sequence[Mapping[str, float]], tolerance: float, track_m: float) -> tuple[Block, ...]:
    """Return the excess of woven paths, and the amplitude that a tolerance allows."""
    heads = {
        "whole periods (%)": ("excess_whole_periods", 6),
        "(πA/λ)² (%)": ("excess_small_amplitude", 6),
        "This distance | centre (%)": ("excess_centre", 4),
        "This distance | left (%)": ("excess_left", 4),
        "This distance | right (%)": ("excess_right", 4),
        "Error of the radius | of periods (%)": ("radius_error_whole_periods", 4),
        "Error of the radius | left (%)": ("radius_error_left", 4),
        "Error of the radius | right (%)": ("radius_error_right", 4),
    }
    excess = table(
        f"y = A sin(2πx/λ), Sₒ = {rows[0]['distance_m']:g} m, track {track_m:g} m: excess of the path, and what it "
        "does to a radius.",
        ("A (m)", "λ (m)", *heads),
        [
            [
                *(f"{row[key]:g}" for key in ("amplitude_m", "wavelength_m")),
                *(fixed(100 * row[key], decimals) for key, decimals in heads.values()),
            ]
            for row in rows
        ],
    )
    allowed = {row["wavelength_m"]: row["allowed_amplitude_m"] for row in rows}
    sentences = (
        f"At a wavelength of {wavelength:g} m a radius stays within {100 * tolerance:g} % up to an amplitude of "
        f"{1e3 * amplitude:.1f} mm (whole periods)."
        for wavelength, amplitude in allowed.items()
    )
    return (excess, *map(Text, sentences))


def arc_content(arc: Mapping[str, float]) -> tuple[Block, ...]:
    """Return what wheels of different radii do on a straight line."""
    longer = ", ".join(f"{fixed(100 * arc[f'excess_{at}'], 4)} % ({at})" for at in ("centre", "left", "right"))
    text = (
        f"Wheels with r_R / r_L = {arc['radius_ratio']:g} taken for equal: over {arc['distance_m']:g} m a turn of "
        f"{arc['turn_rad']:+.4f} rad and {arc['offset_m']:+.3f} m beside the line; the path is longer by {longer}."
    )
    return (Text(text),)


def runs_content(name: str, simulated: bool, judged: RunDeviations) -> tuple[Block, ...]:
    """Return the verdict on each run of a campaign."""
    heads = {
        "A (mm)": ("amplitude_m", 1e3, 1),
        "λ (m)": ("wavelength_m", 1.0, 2),
        "Excess | centre (%)": ("excess_centre", 100.0, 5),
        "~Excess | small A (%)": ("small_amplitude", 100.0, 5),
        "Error of radius | left (µm)": ("error_left_m", 1e6, 1),
        "Error of radius | right (µm)": ("error_right_m", 1e6, 1),
        "allowed A (mm)": ("allowed_amplitude_m", 1e3, 1),
    }
    rows = [
        (
            *(str(row[key]) for key in ("run_id", "source")),
            *(MISSING if row[key] is None else fixed(k * row[key], places) for key, k, places in heads.values()),
            str(row["verdict"]),
        )
        for row in judged.rows()
    ]
    mark = " SIMULATED DATA." if simulated else ""
    notes = [*judged.notes, *(f"Not used: {run.run_id} {run.reason}" for run in judged.left_out)]
    errors = table(
        f"{name}: error that each path adds to its radii.{mark}", ("<Run", "<From", *heads, "<Verdict"), rows
    )
    return (errors, *items(map(prose, notes)), Text(prose(judged.summary)))
