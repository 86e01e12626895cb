"""Diagnosis of a gap, runs to drive next, and known effects."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from calib import reporting
from calib.campaign.checks import listed
from calib.gap.decision.diagnosis import Diagnosis, Plan, VerdictKind
from calib.gap.effects.library import LIBRARY, UNCHANGED, Entry
from calib.gap.effects.reference import RangefinderScale, ReferenceScale
from calib.gap.observations import Channel
from calib.gap.plan import Outlook
from calib.reporting import Block, Notice, Picture, Section, Table, Text, caption, items, picture, table
from calib.reporting.formatting import MISSING, fixed, length, plural, prose, three_digits, with_unit
from calib.reporting.source import doubtful_causes
from calib.reporting.topics import gap as findings
from calib.reporting.topics.gap import effect_name
from calib.types import FloatArray, floats, unit_of

if TYPE_CHECKING:
    from calib.kinematics.assemble import Promise
    from calib.reporting.figures.gap import GapArrays

GAP_FIGURES: Final = ("gap-map", "before-after", *(f"gap-by-covariate-{channel.label}" for channel in Channel))
#: level of the notice, and title
TITLES: Final[Mapping[VerdictKind, tuple[str, str]]] = {
    VerdictKind.NO_GAP: ("good", "No gap beyond the noise"),
    VerdictKind.EXPLAINED: ("good", "The gap is explained"),
    VerdictKind.PARTLY_EXPLAINED: ("note", "The gap is partly explained"),
    VerdictKind.AMBIGUOUS: ("note", "These runs cannot tell the causes apart"),
    VerdictKind.UNKNOWN: ("bad", "The cause of the gap is unknown"),
    VerdictKind.UNDECIDED: ("note", "These runs cannot show whether there is a gap"),
}
CORRECT_FIRST: Final = ("bad", "Correct this first")
#: of a gap that is less probable than none
IMPROBABLE_GAP: Final = ("note", "Probably no gap")


def verdict_notice(verdict: Diagnosis) -> Notice:
    """Return the verdict with its sentence."""
    level, title = IMPROBABLE_GAP if verdict.is_improbable else TITLES[verdict.kind]
    if verdict.sentence.startswith(CORRECT_FIRST[1]):
        level, title = CORRECT_FIRST
    return Notice(level, with_kind(title, verdict.kind), prose(verdict.sentence.removeprefix(title).lstrip(": ")))


def with_kind(title: str, kind: VerdictKind, *more: str) -> str:
    """Return a title with the verdict's word, if new, and further remarks in brackets."""
    remarks = [*([] if kind.value in title else [kind.value]), *more]
    return f"{title} ({', '.join(remarks)})" if remarks else title


def page_one_notice(verdict: Diagnosis) -> Notice:
    """Return the verdict for the first page, with probabilities of doubtful causes."""
    notice = verdict_notice(verdict)
    doubt = doubtful_causes((cause.effect, cause.probability) for cause in verdict.causes)
    return replace(notice, text=f"{notice.text} {doubt}".strip())


def diagnosis_full(verdict: Diagnosis) -> tuple[Block, ...]:
    """Return what the terminal prints of a diagnosis."""
    mark = (reporting.simulated_notice(),) if verdict.simulated else ()
    return (reporting.Heading(verdict.campaign), *mark, *diagnosis_content(verdict))


def diagnosis_content(verdict: Diagnosis, gap: "GapArrays | None" = None) -> tuple[Block, ...]:
    """Return the statements of a diagnosis, with `gap` its pictures."""
    next_runs = (next_runs_table([run.to_dict() for run in verdict.next_runs]),) if verdict.next_runs else ()
    return (
        verdict_notice(verdict),
        Text(reporting.paragraph("noise_level"), small=True),
        *(_map_picture(gap) if gap else ()),
        *findings.where_blocks(verdict.where),
        *(_covariate_picture(gap, verdict) if gap else ()),
        *findings.cause_blocks(verdict),
        *findings.confounded_blocks(verdict),
        *findings.closure_blocks(verdict),
        *(_before_after_picture(gap) if gap else ()),
        *findings.limit_blocks(verdict),
        *next_runs,
        *((Text("Notes:"), *items(map(prose, verdict.notes))) if verdict.notes else ()),
    )


def gap_section(verdict: Diagnosis, gap: "GapArrays | None" = None) -> Section:
    """Return a report's section on a diagnosis; `gap`: by default its own."""
    from calib.reporting.figures.gap import GapArrays

    gap = gap or (None if verdict.evidence is None else GapArrays.of(verdict))
    return Section("Diagnosis of the gap", diagnosis_content(verdict, gap))


def _map_picture(gap: "GapArrays") -> list[Picture]:
    if gap.offset_m is None:
        return []
    largest = length(float(np.nanmax(np.hypot(*gap.offset_m.T), initial=0.0)))
    alt = f"Floor plan of {len(gap.paths_m)} runs with the gap at their ends, at most {largest}"
    return [picture("gap-map", alt, "gap.gap_map", gap.paths_m, gap.offset_m, gap.labels["kind"])]


def _covariate_picture(gap: "GapArrays", verdict: Diagnosis) -> list[Picture]:
    from calib.reporting.figures.gap import MAX_PANELS, distinct, rms

    lines = sorted(verdict.where.covariates, key=lambda line: not line.significant)
    rank = {line.name: number for number, line in reversed(list(enumerate(lines)))}
    varied = {
        name: gap.covariates[name]
        for name in sorted(gap.covariates, key=lambda name: rank.get(name, len(rank)))
        if len(known := _known(gap.covariates[name])) >= 3 and np.ptp(known) > 0
    }
    levels = [rms(column) for column in gap.noise_level.T]
    ratios = [
        rms(values) / level if len(_known(values)) >= 3 and level > 0 else -1.0
        for values, level in zip(gap.before.T, levels, strict=True)
    ]
    worst = int(np.argmax(ratios))
    if not varied or ratios[worst] <= 0:
        return []
    channel, unit = gap.channels[worst]
    title = effect_name(channel)
    shown = list(distinct(varied).items())[:MAX_PANELS]
    alike = [f"{', '.join(map(with_unit, others))} like {with_unit(name)}" for name, others in shown if others]
    aside = f" Not drawn, since they vary alike: {'; '.join(alike)}." if alike else ""
    alt = f"Gap of the channel {title} against {', '.join(effect_name(name) for name, _ in shown)}"
    gaps = (gap.before[:, worst], title, unit, varied)
    draw = partial(reporting.drawn, "gap.gap_by_covariate", *gaps, noise_level=levels[worst], group=gap.labels["kind"])
    return [Picture("gap-by-covariate", caption("gap-by-covariate", title=title, aside=aside), alt, draw)]


def _before_after_picture(gap: "GapArrays") -> list[Picture]:
    if not np.isfinite(gap.before).any():
        return []
    from calib.reporting.figures.gap import rms

    channels = [(effect_name(name), unit) for name, unit in gap.channels]
    sizes = [
        f"{name} {three_digits(rms(before))} to {three_digits(rms(after))} {unit}"
        for (name, unit), before, after in zip(channels, gap.before.T, gap.after.T, strict=True)
        if np.isfinite(before).any()
    ]
    alt = f"Gap before and after by channel: {'; '.join(sizes)}"
    return [picture("gap-before-after", alt, "gap.before_after", channels, gap.before, gap.after, gap.noise_level)]


def _known(values: FloatArray) -> FloatArray:
    return floats(values[np.isfinite(values)])


def diagnosis_brief(diagnosis: Diagnosis) -> tuple[Block, ...]:
    """Return what the interpreter shows of a diagnosis."""
    return (verdict_notice(diagnosis),)


def plan_content(plan: Plan) -> tuple[Block, ...]:
    """Return what the terminal prints of a plan: verdict, and runs to drive next."""
    return (verdict_notice(plan.diagnosis), *runs_and_promises(plan))


def runs_and_promises(plan: Plan) -> tuple[Block, ...]:
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


def effects_content(entries: Sequence[Entry], runs: str) -> tuple[Block, ...]:
    """Return the catalogue as a table."""
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


def effect_content(entry: Entry, runs: str) -> tuple[Block, ...]:
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


def _signature(entry: Entry, runs: str) -> tuple[Block, ...]:
    moved = [c for c in Channel if any(np.nan_to_num(rms[c]) > UNCHANGED for rms in entry.changes.values())]
    if not moved:
        return (Text(f"At its typical size it changes nothing that is measured on {runs}."),)
    heads = ("<Kind of run", *(f"{channel.label} (m{channel.unit})" for channel in moved))
    rows = [
        (kind, *("0" if rms[c] < UNCHANGED else three_digits(1e3 * float(rms[c])) for c in moved))
        for kind, rms in entry.changes.items()
    ]
    return (table(f"Signature: root mean square change at the typical size on {runs}.", heads, rows),)


def _typical(entry: Entry) -> str:
    if entry.signature is None:
        return MISSING
    sizes = dict.fromkeys(
        size_text(one.typical, one.unit).replace(f" per {getattr(entry.effect, 'column', '')}", " a unit")
        for one in entry.signature.form.parameters
    )
    return ", ".join(sizes)


def _why_no_form(entry: Entry) -> str:
    if entry.effect.found_before_search:
        return "found by trial, before the search"
    return f"needs {entry.effect.needs}" if entry.effect.needs else "shows on other runs only"


#: in one cell
MAX_NAMED: Final = 4


def outlook_content(name: str, n_runs: int, outlook: Outlook) -> tuple[Block, ...]:
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
    told = table(caption("table-outlook", name=name, runs=n_runs, **known), heads, rows)
    why = (prose(outlook.smallest[effect].sentence) for effect in outlook.absent[:1])
    return (told, *items(f"{', '.join(outlook.absent)}: {text}" for text in why))


def after_diagnosis(diagnosis: Diagnosis, *, simulator: bool = False) -> str:
    """Return the step that a diagnosis was, by its verdict and fix; `simulator`: whether it was of the user's own."""
    kind = "recommended" if diagnosis.recommended else diagnosis.kind.value
    if simulator and diagnosis.recommended:
        tied = any(name.startswith("simulator:") for group in diagnosis.groups for name in group)
        kind = "simulator" if diagnosis.fix.parameters else "simulator group" if tied else "simulator lacks"
    step = f"diagnose {'wrong' if diagnosis.correct_first else kind}"
    if step in reporting.catalogue()["next"]:
        return step
    return without_runs(diagnosis) if diagnosis.groups and not (diagnosis.next_runs or simulator) else "diagnose"


def without_runs(diagnosis: Diagnosis) -> str:
    """Return the step where no run tells the causes apart: of two instruments a third length tells which is wrong."""
    instruments = {RangefinderScale.id, ReferenceScale.id}
    return "plan instruments" if any(instruments.issubset(group) for group in diagnosis.groups) else "plan nothing"
