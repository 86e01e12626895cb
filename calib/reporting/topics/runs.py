"""Runs: a check's findings, those of a fit, their paths, what they show of each effect, and those to drive next."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from calib import reporting
from calib.campaign.check import CheckReport
from calib.campaign.checks import listed
from calib.campaign.model import Note
from calib.radius.deviation import RunDeviations
from calib.reporting import Block, Notice, Table, Text, caption, items, paragraph, table
from calib.reporting.formatting import MISSING, fixed, plural, prose, span, three_digits
from calib.types import grouped, unit_of

if TYPE_CHECKING:
    from calib.gap.decision.diagnosis import Plan
    from calib.gap.effects.library import Entry
    from calib.gap.plan import Outlook
    from calib.kinematics.assemble import Promise


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
            number = len({note.text for note in notes})
            content += [reporting.Heading(f"{title} ({number})"), *items(_grouped(notes))]
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
        heads, columns = zip(*(note.where.partition(", column ")[::2] for note in same), strict=True)
        if len(same) > 1 and not runs and len({*heads}) == 1 and all(columns):
            where = f"{heads[0]}, columns {', '.join(columns)}"
        elif len(same) > 1:
            shown = runs or list(dict.fromkeys(note.where for note in same))
            where = f"{plural(len(shown), 'run' if runs else 'place')}, {listed(shown, MAX_RUNS)}"
        elif runs:
            where += f" [{runs[0]}]"
        lines.append(prose(f"{where}: {text}"))
    hidden = {code: count - MAX_SIMILAR for code, count in of_code.items() if code and count > MAX_SIMILAR}
    return [*lines, *(f"and {count} more like these: {code.replace('_', ' ')}" for code, count in hidden.items())]


def _verdict(report: CheckReport) -> Notice:
    wrong, suspicious = (len({note.text for note in of}) for of in (report.wrong, report.suspicious))
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
    block = table(f"{name}: error that each path adds to its radii.{mark}", ("<Run", "<From", *heads, "<Verdict"), rows)
    return (block, *items(map(prose, notes)), Text(prose(judged.summary)))


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


def runs_and_promises(plan: "Plan") -> tuple[Block, ...]:
    """Return the runs to drive next, and the intervals they promise."""
    promises = [promise_table(plan.now, plan.then)] if plan.then else []
    mark = (reporting.simulated_notice(),) if plan.campaign.simulated else ()
    return (*mark, next_runs_table([run.to_dict() for run in plan.runs]), *promises)


#: unit of an effect -> (factor, printed unit) from the largest to the smallest
PRINTED_UNITS: Final = {
    "m": ((1.0, "m"), (1e3, "mm"), (1e6, "µm")),
    "rad": ((1.0, "rad"), (1e3, "mrad"), (1e6, "µrad")),
    "1": ((1e2, "%"), (1e6, "ppm")),
}


def size_text(value: float, unit: str) -> str:
    """Return a size with a printed unit: ``1e-6`` of ``m/N`` as ``1 µm/N``, ``3e-3`` of ``1`` as ``0.3 %``."""
    above, slash, below = unit.partition(" per " if " per " in unit else "/")
    for factor, name in PRINTED_UNITS.get(above, ((1.0, above),)):
        if factor * abs(value) >= 0.095 or name in {"µm", "µrad", "ppm"}:
            return f"{factor * value:.3g} {name}{slash}{below}"
    return f"{value:.3g} {unit}"


def next_runs_table(runs: Sequence[Mapping[str, Any]]) -> Table | Text:
    """Return the runs to drive next, best first, with the effects separated."""
    if not runs:
        return Text("No run of the list would separate more effects than the runs driven.")
    return table(
        "Runs to drive next in one session, best first.",
        ("<Run", "Payload (kg)", "Speed (m/s)", "Hall (°C)", "Loaded (min)", "*What it separates"),
        [_row(number, run) for number, run in enumerate(runs, start=1)],
    )


def promise_table(now: "Promise | None", then: "Promise") -> Table:
    """Return the half widths that `calib geometry` will give, beside those of the runs driven."""
    before = {} if now is None else {each.name: each.half_width for each in now.estimates}
    rows = []
    for each in then.estimates:
        unit = unit_of(each.name)
        known = size_text(before[each.name], unit) if each.name in before else MISSING
        rows.append((each.name, *([] if now is None else [known]), size_text(each.half_width, unit)))
    walk = 1e3 * float(np.sqrt(then.scales[2]))
    left = f" Left open: {', '.join(then.undetermined)}." if then.undetermined else ""
    gives, heads = ("will give", ["These"]) if now is None else ("gives", ["Runs driven", "With the next"])
    return table(caption("table-promise", gives=gives, walk=walk, left=left), ("<Parameter", *heads), rows)


#: key of a run to drive -> what is said of it
_REMARKS: Final = {
    "size": "{}", "stops": "{} stops", "loop": "closed loop", "tape": "by tape", "count": "{} times",
    "read_rolling": "read while rolling",
}  # fmt: skip


def _row(number: int, run: Mapping[str, Any]) -> tuple[str, ...]:
    extra = [words.format(run[key]) for key, words in _REMARKS.items() if run.get(key)]
    if run.get("payload_kg"):
        extra.append(f"payload at {run.get('payload_x_m', 0.0):g}, {run.get('payload_y_m', 0.0):g} m".replace("-", "−"))
    what = ", ".join([f"{str(run['kind']).replace('_', ' ')} {run.get('direction', '')}".strip(), *extra])

    def shown(key: str, decimals: int = 2) -> str:
        return f"{round(run[key], decimals):g}".replace("-", "−") if run.get(key) is not None else MISSING

    numbers = (shown("payload_kg"), shown("speed_mps"), shown("temperature_C", 1), shown("minutes_under_load"))
    return (f"{number}. {what}", *numbers, prose(str(run["why"])))


_SIGNS: Final = {-1: "- ", 0: "± ", 1: ""}


def effects_content(entries: "Sequence[Entry]", runs: str) -> tuple[Block, ...]:
    """Return the catalogue as a table."""
    from calib.gap.effects.library import LIBRARY

    catalogue = table(
        f"{plural(len(entries), 'effect')}; typical size of the form that shows most on {runs}.",
        ("<Effect", "*What it is", "<Family", "<Typical size"),
        [(entry.effect.id, entry.effect.title, str(entry.effect.family), _typical(entry)) for entry in entries],
    )
    silent = items(f"{entry.effect.id}: {_why_no_form(entry)}" for entry in entries if entry.signature is None)
    own = (entry.effect for entry in entries if entry.effect.origin != LIBRARY)
    elsewhere = items(f"{effect.id}: from {effect.origin}" for effect in own)
    without = (Text(f"Without a form on {runs}:"), *silent) if silent else ()
    return (catalogue, *without, *((Text("Not from the library:"), *elsewhere) if elsewhere else ()))


def effect_content(entry: "Entry", runs: str) -> tuple[Block, ...]:
    """Return one effect in full."""
    effect = entry.effect
    facts = {
        "From": effect.origin,
        "Family": f"{effect.family}: {effect.family.words}",
        "Needs": effect.needs,
        "Separated from others by": effect.separates,
        "Beyond plausible, suspect": effect.implausible,
        "Shifts": ", ".join(effect.shifts),
    }
    known = reporting.Facts(tuple((name, value) for name, value in facts.items() if value))
    doc = (type(effect).__doc__ or "").strip().split("\n\n")[0]
    content: list[Block] = [reporting.Heading(f"{effect.id}: {effect.title}"), Text(" ".join(doc.split())), known]
    if entry.signature is None:
        return (*content, Text(f"Without a form on {runs}: {_why_no_form(entry)}."))
    form = entry.signature.form
    rows = [
        (p.name.replace("_", " "), _SIGNS[p.sign] + size_text(p.typical, p.unit), size_text(p.largest, p.unit))
        for p in form.parameters
    ]
    label = f" ({form.label})" if form.label else ""
    sizes = table(f"Parameters{label}.", ("<Parameter", "<Typical size", "<Largest plausible"), rows)
    return (*content, sizes, *_signature(entry, runs))


def _signature(entry: "Entry", runs: str) -> tuple[Block, ...]:
    from calib.gap.effects.library import UNCHANGED
    from calib.gap.observations import Channel

    moved = [c for c in Channel if any(np.nan_to_num(rms[c]) > UNCHANGED for rms in entry.changes.values())]
    if not moved:
        return (Text(f"At its typical size it changes nothing that is measured on {runs}."),)
    heads = ("<Kind of run", *(f"{channel.label} (m{channel.unit})" for channel in moved))
    rows = [
        (kind, *("0" if rms[c] < UNCHANGED else three_digits(1e3 * float(rms[c])) for c in moved))
        for kind, rms in entry.changes.items()
    ]
    return (table(f"Signature: root mean square change at the typical size on {runs}.", heads, rows),)


def _typical(entry: "Entry") -> str:
    if entry.signature is None:
        return MISSING
    sizes = dict.fromkeys(
        size_text(one.typical, one.unit).replace(f" per {getattr(entry.effect, 'column', '')}", " a unit")
        for one in entry.signature.form.parameters
    )
    return ", ".join(sizes)


def _why_no_form(entry: "Entry") -> str:
    if entry.effect.found_before_search:
        return "found by trial, before the search"
    return f"needs {entry.effect.needs}" if entry.effect.needs else "shows on other runs only"


#: in one cell
MAX_NAMED: Final = 4


def outlook_content(name: str, n_runs: int, outlook: "Outlook") -> tuple[Block, ...]:
    """Return the detectability of each effect by a plan of runs."""
    document = outlook.to_dict()
    told_apart = set(document["told_apart"])
    rows = []
    for number, effect in enumerate(outlook.effects):
        others = listed(document["confused"].get(effect, []), MAX_NAMED) or "not seen at its typical size"
        words = "yes" if effect in told_apart else others
        rows.append((effect, fixed(float(outlook.signal[number]), 1), prose(outlook.smallest[effect].sentence), words))
    known = {"told": len(told_apart), "effects": len(outlook.effects) + len(outlook.absent)}
    heads = ("<Effect", "Signal", "*Smallest size seen", "*Told apart, or confused with")
    block = table(caption("table-outlook", name=name, runs=n_runs, **known), heads, rows)
    why = (prose(outlook.smallest[effect].sentence) for effect in outlook.absent[:1])
    return (block, *items(f"{', '.join(outlook.absent)}: {text}" for text in why))
