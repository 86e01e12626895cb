"""Runs: a check's findings, a fit's runs used and not used, deviation of their paths."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Final

import numpy as np

from calib import reporting
from calib.campaign.check import CheckReport
from calib.campaign.checks import SIDES, listed
from calib.campaign.model import Note
from calib.campaign.settings import WHEEL_LOADS
from calib.radius.deviation import RunDeviations, allowed_amplitude_m, radius_error
from calib.radius.result import Fit
from calib.reporting import Block, Notice, Section, Table, Text, caption, catalogue, items, paragraph, table
from calib.reporting.formatting import MISSING, fixed, plural, prose, span
from calib.reporting.source import Source
from calib.reporting.topics import fit as results
from calib.types import FloatArray, grouped


def _sessions_table(fit: Fit) -> Table:
    heads = ("^Loads | {} (N)", "Mean residual | {} (µm)", "Scatter | {} (µm)")
    rows = []
    for name, part in fit.table.groupby("session", sort=False):
        loads = (f"{part[load].min():.0f}–{part[load].max():.0f}" for load in WHEEL_LOADS)
        left = part[["residual_left_m", "residual_right_m"]]
        sizes = (fixed(1e6 * size, 1) for size in (*left.mean(), *left.std()))
        rows.append((str(name), str(len(part)), *loads, *sizes))
    first = f", the first {results.MOST_ROWS} of {len(rows)}" if len(rows) > results.MOST_ROWS else ""
    columns = ("<Session", "Runs", *(head.format(wheel) for head in heads for wheel in SIDES))
    title = caption("table-sessions", runs=len(fit.radii), first=first)
    return table(title, columns, rows[: results.MOST_ROWS], dense=True)


def runs_section(source: Source) -> Section:
    """Return the runs used, and not used with the reason."""
    fit, radii = source.fit, source.fit.radii
    sessions = plural(len(set(radii.session.tolist())), "session")
    content = (
        Text(f"{plural(len(radii), 'run')} in {sessions} entered the fit."),
        results.runs_picture(fit),
        results.runs_table(fit) if len(radii) <= results.MOST_ROWS else _sessions_table(fit),
        results.left_out_table(fit) if radii.left_out else Text("All runs were used.", small=True),
    )
    return Section("Runs", (*content, *([results.static_table(fit)] if fit.static else [])))


#: relative error of a radius that the runs are compared with
TOLERANCE: Final = 5e-4


def deviation_section(source: Source) -> Section:
    """Return how much longer the wheels' paths were than measured, and what was corrected."""
    radii = source.fit.radii
    known = np.isfinite(radii.amplitude_m) & np.isfinite(radii.wavelength_m)
    paths = np.array((radii.path_left, radii.path_right))
    rows = []
    for name in dict.fromkeys(radii.path_source.tolist()):
        on = radii.path_source == name
        weave = (1e3 * _median(radii.amplitude_m[on & known]), _median(radii.wavelength_m[on & known]))
        corrected = 1e6 * np.sqrt(np.mean(paths[:, on] ** 2, axis=1))
        sizes = (*(fixed(size, 1) for size in weave), *(fixed(float(value), 0) for value in corrected))
        rows.append((catalogue()["path"].get(name, name), str(int(on.sum())), *sizes))
    heads = ("*Correction from", "Runs", "Amplitude (mm)", "Wavelength (m)", "Left (ppm)", "Right (ppm)")
    corrected = {"corrected": int((radii.path_source != "none").sum()), "runs": len(radii)}
    text = Text(paragraph("paths", **corrected, worst=1e6 * float(np.abs(paths).max())))
    shown = table(caption("table-corrections"), heads, rows)
    content: list[Block] = [text, results.deviation_picture(source.fit), shown]
    if known.any():
        off = int((np.abs(radius_error(paths)).max(axis=0) > TOLERANCE).sum())
        wavelength = _median(radii.wavelength_m[known])
        values = {
            "off": plural(off, "run") if off else "no run",
            "tolerance": 1e6 * TOLERANCE,
            "wavelength": wavelength,
            "allowed": 1e3 * float(allowed_amplitude_m(TOLERANCE, wavelength)),
        }
        content.append(Text(paragraph("uncorrected", **values)))
    return Section("Path deviation", tuple(content))


def _median(values: FloatArray) -> float:
    return float(np.median(values)) if len(values) else float("nan")


#: entries of a list of names, and runs of one note
MAX_NAMES: Final = 12
MAX_RUNS: Final = 6
#: lines that differ in numbers alone; the JSON has them all
MAX_SIMILAR: Final = 8


def check_content(report: CheckReport) -> tuple[Block, ...]:
    """Return the findings of a check, and its verdict."""
    content: list[Block] = [
        reporting.Heading(f"{report.campaign}{' (simulated)' if report.simulated else ''}"),
        reporting.Facts(tuple(_facts(report))),
    ]
    for title, notes in (("Recognised", report.info), ("Suspicious", report.suspicious), ("Wrong", report.wrong)):
        if notes:
            content += [reporting.Heading(f"{title} ({len(notes)})"), *items(_grouped(notes))]
    return (*content, _verdict(report))


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
    listed = list(names)
    return ", ".join(listed[:MAX_NAMES] + ["..."] * (len(listed) > MAX_NAMES))


def _grouped(notes: Sequence[Note]) -> list[str]:
    lines = []
    of_code: Counter[str] = Counter()
    for text, same in grouped((note.text, note) for note in notes).items():
        code = same[0].code
        of_code[code] += 1
        if code and of_code[code] > MAX_SIMILAR:
            continue
        runs = list(dict.fromkeys(note.run_id for note in same if note.run_id))
        where = same[0].where
        if len(same) > 1:
            shown = runs or list(dict.fromkeys(note.where for note in same))
            where = f"{plural(len(shown), 'run' if runs else 'place')}, {listed(shown, MAX_RUNS)}"
        elif runs:
            where += f" [{runs[0]}]"
        lines.append(prose(f"{where}: {text}"))
    hidden = {code: count - MAX_SIMILAR for code, count in of_code.items() if code and count > MAX_SIMILAR}
    return [*lines, *(f"and {count} more like these: {code.replace('_', ' ')}" for code, count in hidden.items())]


def _verdict(report: CheckReport) -> Notice:
    wrong, suspicious = len(report.wrong), len(report.suspicious)
    if report.verdict == "wrong":
        return Notice("bad", f"Wrong: {plural(wrong, 'fault')}", "Correct what is named before you compute anything.")
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
    sizes = [[f"{row['amplitude_m']:g} / {row['wavelength_m']:g}"] for row in rows]
    shares = [[fixed(100 * row[key], places) for key, places in heads.values()] for row in rows]
    cells = [size + share for size, share in zip(sizes, shares, strict=True)]
    title = caption("table-weave", distance_m=rows[0]["distance_m"], track_m=track_m)
    excess = table(title, ("A / λ (m)", *heads), cells)
    sentences = (
        paragraph("weave", wavelength=wavelength, percent=100 * tolerance, amplitude_mm=1e3 * amplitude)
        for wavelength, amplitude in {row["wavelength_m"]: row["allowed_amplitude_m"] for row in rows}.items()
    )
    return (excess, *map(Text, sentences))


def arc_content(arc: Mapping[str, float]) -> tuple[Block, ...]:
    """Return what wheels of different radii do on a straight line."""
    longer = ", ".join(f"{fixed(100 * arc[f'excess_{at}'], 4)} % ({at})" for at in ("centre", "left", "right"))
    return (Text(paragraph("arc", longer=longer, **arc)),)


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
    rows = []
    for row in judged.rows():
        values = ((row[key], k, places) for key, k, places in heads.values())
        sizes = (fixed(k * value, places) if isinstance(value, float) else MISSING for value, k, places in values)
        rows.append((str(row["run_id"]), str(row["source"]), *sizes, str(row["verdict"])))
    mark = " SIMULATED DATA." if simulated else ""
    notes = [*judged.notes, *(f"Not used: {run.run_id} {run.reason}" for run in judged.left_out)]
    found = table(f"{name}: error that each path adds to its radii.{mark}", ("<Run", "<From", *heads, "<Verdict"), rows)
    return (found, *items(map(prose, notes)), Text(prose(judged.summary)))


#: what a check found -> its step, where the law of the load lacks runs
_NEEDED: Final = ("missing_counts", "missing_distance")
_LACKING: Final = {"few_runs": "check lacks runs", "one_session": "check lacks days"}


def after_check(report: CheckReport, columns: Iterable[str]) -> str:
    """Return the step that a check was; `columns`: of run table and logs."""
    used = report.found.n_runs - report.found.n_excluded
    nothing = (one.code in _NEEDED and one.text.startswith(f"{used} run(s)") for one in report.suspicious)
    if report.verdict == "wrong" or any(nothing):
        return "check wrong"
    if report.found.distance_m is None or report.found.counts_left is None:
        return "check without distances"
    if {"ref_x_m", "ref_theta_rad", "gyro_z_radps", "loop"}.intersection(columns):
        return "check"
    codes = {note.code for note in report.suspicious}
    return next((step for code, step in _LACKING.items() if code in codes), "check lengths")
