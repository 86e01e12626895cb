"""What a check of a campaign says: what is there, what is recognised, suspicious and wrong, and the verdict."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from calib.campaign.check import CheckReport
from calib.campaign.model import Note
from calib.report.blocks import Block, Facts, Heading, Items, Notice
from calib.report.numbers import plural, prose, span

#: entries of a list of names, and runs named for one note
_MOST: Final = 12
_RUNS: Final = 6
#: lines of one kind of note that differ in their numbers alone; the JSON has them all
_LIKE: Final = 8


def check_content(report: CheckReport) -> tuple[Block, ...]:
    """Return what a check says."""
    blocks: list[Block] = [
        Heading(f"{report.campaign}{' (simulated)' if report.simulated else ''}"),
        Facts(tuple(_facts(report))),
    ]
    for title, notes in (
        ("Recognised", report.info),
        ("Suspicious", report.suspicious),
        ("Wrong", report.wrong),
    ):
        if notes:
            blocks += [Heading(f"{title} ({len(notes)})"), Items(tuple(_grouped(notes)))]
    return (*blocks, _verdict(report))


def _facts(report: CheckReport) -> list[tuple[str, str]]:
    contents = report.found
    rows = [("runs", str(contents.n_runs) + (f", {contents.n_excluded} excluded" if contents.n_excluded else ""))]
    for title, counted in (("sessions", contents.sessions), ("kinds", contents.kinds)):
        if counted:
            names = ", ".join(f"{key} ({count})" for key, count in list(counted.items())[:_MOST])
            rows.append((title, f"{len(counted)}: {names}" + (", ..." if len(counted) > _MOST else "")))
    if contents.payloads_kg:
        shown = ", ".join(f"{value:g}" for value in contents.payloads_kg[:_MOST])
        rows.append(("payloads", shown + (", ..." if len(contents.payloads_kg) > _MOST else "") + " kg"))
    for title, ends, unit in (
        ("left load", contents.load_left_N, "N"),
        ("right load", contents.load_right_N, "N"),
        ("distance", contents.distance_m, "m"),
        ("speed", contents.speed_mps, "m/s"),
        ("hall", contents.temperature_C, "°C"),
    ):
        if ends:
            rows.append((title, span(*ends, unit, ".5g")))
    if contents.n_logs and contents.rate_Hz and contents.duration_s:
        rows.append(
            (
                "logs",
                f"{contents.n_logs}, {contents.n_samples} samples at {span(*contents.rate_Hz, 'Hz')}, "
                f"{span(*contents.duration_s, 's')} ({', '.join(contents.log_columns)})",
            )
        )
    if contents.covariates:
        rows.append(("covariates", ", ".join(contents.covariates)))
    return rows


def _grouped(notes: Sequence[Note]) -> list[str]:
    """Return one line for what is said alike of several runs."""
    by_text: dict[str, list[Note]] = {}
    for note in notes:
        by_text.setdefault(note.text, []).append(note)
    lines = []
    of_code: dict[str, int] = {}
    for text, alike in by_text.items():
        code = alike[0].code
        of_code[code] = of_code.get(code, 0) + 1
        if code and of_code[code] > _LIKE:
            continue
        runs = list(dict.fromkeys(note.run_id for note in alike if note.run_id))
        where = alike[0].where
        if len(alike) > 1:
            places = list(dict.fromkeys(note.where for note in alike))
            shown = runs or places
            more = f" and {len(shown) - _RUNS} more" if len(shown) > _RUNS else ""
            where = f"{plural(len(shown), 'run' if runs else 'place')}, {', '.join(shown[:_RUNS])}{more}"
        elif runs:
            where += f" [{runs[0]}]"
        lines.append(prose(f"{where}: {text}"))
    rest = {code: count - _LIKE for code, count in of_code.items() if code and count > _LIKE}
    return [*lines, *(f"and {count} more like these: {code.replace('_', ' ')}" for code, count in rest.items())]


def _verdict(report: CheckReport) -> Notice:
    wrong, suspicious = len(report.wrong), len(report.suspicious)
    if report.verdict == "wrong":
        return Notice("bad", f"Wrong: {plural(wrong, 'fault')}", "Put them right before anything is computed.")
    if report.verdict == "look at this":
        text = f"No fault, and {plural(suspicious, 'thing')} that may spoil the result; decide before you rely on it."
        return Notice("note", "Look at this", text)
    return Notice("good", "Sound", "No fault, and nothing suspicious.")
