"""Check of a campaign: what was found in it, its findings, and its verdict."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Final

from calib.reporting.blocks import Block, Facts, Heading, Items, Notice
from calib.reporting.formatting import plural, prose, span

if TYPE_CHECKING:
    from calib.campaign.check import CheckReport
    from calib.campaign.model import Note

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
