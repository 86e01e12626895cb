"""Checks of the campaign and of the fit's residuals, the decision rule, and whether the law can be used."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Final

from calib.radius.design_checks import FAIL_BELOW, NOTE_BELOW
from calib.reporting.blocks import Block, Facts, Heading, Items, Notice, Picture, Section, Table, Text, picture, table
from calib.reporting.formatting import plural, probability, prose, span

if TYPE_CHECKING:
    from calib.campaign.check import CheckReport
    from calib.campaign.model import Note
    from calib.radius.regression import Check
    from calib.radius.result import Fit
    from calib.reporting.source import Source


_LEVELS: Final = {"ok": "passed", "note": "remark", "failed": "FAILED"}
#: remarks beside the result, a sentence each
MAX_REMARKS: Final = 3


def checks_table(fit: Fit) -> Table:
    """Return the checks of both wheels: verdict, statistic, and what it means for the user."""
    by_name: dict[str, dict[tuple[str, str], dict[str, Check]]] = {}
    for wheel, fitted in fit.wheels.items():
        for check in fitted.checks:
            by_name.setdefault(check.name, {}).setdefault((check.level, check.sentence), {})[wheel] = check
    rows = [
        (
            name.replace("_", " "),
            "both" if len(same) == 2 else next(iter(same)),
            _LEVELS.get(level, level),
            _statistics(list(same.values())),
            " / ".join(dict.fromkeys(probability(check.p_value) for check in same.values())),
            prose(sentence),
        )
        for name, results in by_name.items()
        for (level, sentence), same in results.items()
    ]
    return table(
        "Checks of the fit; p is the probability of a statistic at least as extreme where all assumptions hold.",
        ("<Check", "<Wheel", "<Verdict", "*~Statistic", "~p", "*Meaning"),
        rows,
        dense=True,
    )


def _statistics(checks: list[Check]) -> str:
    """Return the statistics of a check on one wheel or both, by one name."""
    values: dict[str, list[str]] = {}
    for check in checks:
        if check.statistic is not None and check.statistic_name:
            values.setdefault(check.statistic_name, []).append(f"{check.statistic:.3g}".replace("-", "−"))
    return prose("; ".join(f"{name} = {' / '.join(dict.fromkeys(each))}" for name, each in values.items()))


def usable_notice(fit: Fit) -> Notice:
    """Return whether the law can be used, and what its user has to know."""
    checks = [(name, check) for name, wheel in fit.wheels.items() for check in wheel.checks]
    failed = [f"{name} wheel, {check.name.replace('_', ' ')}" for name, check in checks if not check.passed]
    if fit.implausible and fit.accepted:
        findings = f"Reason given: {prose(fit.accepted)}. Findings: {' '.join(map(prose, fit.implausible))}"
        return Notice("bad", "Implausible, and accepted by the user", findings)
    if failed:
        title = "The law should not be used as it is" if fit.implausible else "The law is doubtful"
        return Notice("bad", title, f"FAILED: {'; '.join(failed)}. The checks say what that means and what to do.")
    remarks = list(dict.fromkeys(prose(check.sentence) for _, check in checks if check.level == "note"))
    if remarks:
        return Notice("note", "The law can be used; its user has to know this", " ".join(remarks[:MAX_REMARKS]))
    return Notice("good", "The law can be used", "Every check of the fit passed without remark.")


def residuals_section(source: Source) -> Section:
    """Return the checks of both wheels: verdict, statistic, and what it means for the user."""
    fit = source.fit
    return Section("Residual checks", (residuals_picture(fit), checks_table(fit)))


def decision_section(source: Source) -> Section:
    """Return by which rule the checks were judged, and what was not judged."""
    tests = sum(check.p_value is not None for wheel in source.fit.wheels.values() for check in wheel.checks)
    false_alarm = 100 * (1 - (1 - NOTE_BELOW) ** tests)
    rules = (
        f"A check with a probability p below {NOTE_BELOW:g} is given as a remark: the result stands, but its user has "
        "to know.",
        f"A check on which the validity of the law rests has failed where p is below {FAIL_BELOW:g}; the law should "
        "then not be used as it is. One failed check on one wheel is enough.",
        f"With the {tests} tests made here, all assumptions being true, the probability of any remark is about "
        f"{false_alarm:.0f} %, and that of any failure at most {100 * tests * FAIL_BELOW:.2g} %.",
        "Intervals are two-sided with a coverage of 95 %; uncertainties are rounded to two significant digits, values "
        "to the same place.",
    )
    conformity = (
        "No tolerance on radius or slope was agreed, so no statement of conformity with a specification is made. Where "
        "one is made from these results, the expanded uncertainty has to be taken into account."
    )
    return Section("Decision rule", (Items(rules), Text(conformity)))


def residuals_picture(fit: Fit) -> Picture:
    """Return the residuals of both wheels."""
    return picture(
        "residuals",
        "Residuals of both wheels against load, in the order driven, and against a normal distribution; colours are "
        "sessions as above.",
        "Residuals of both wheels: "
        + "; ".join(
            f"{name} wheel within {1e6 * float(abs(wheel.residual_m).max()):.0f} µm"
            for name, wheel in fit.wheels.items()
        ),
        "radius.residuals",
        *(fit.left, fit.right, fit.radii.session),
    )


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
