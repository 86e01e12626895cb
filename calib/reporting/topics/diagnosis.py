"""Diagnosis of a gap: its verdict, place, causes and closure."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np

from calib import reporting
from calib.gap.decision.diagnosis import Diagnosis, Plan, Quantity, VerdictKind
from calib.gap.decision.held_out import RERUN
from calib.gap.decision.sentences import advice, headline
from calib.gap.effects.reference import RangefinderScale, ReferenceScale
from calib.gap.localise import PlaceResult
from calib.gap.localise.locate import GapLocation, RunDeviation
from calib.gap.observations import POSE, Channel
from calib.reporting import Block, Notice, Picture, Section, Table, Text, caption, formatting, items, picture, table
from calib.reporting.formatting import MISSING, fixed, length, percent, prose, three_digits, with_unit
from calib.reporting.source import doubtful_causes
from calib.reporting.topics.runs import next_runs_table, runs_and_promises
from calib.types import FloatArray, floats, grouped

if TYPE_CHECKING:
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


def with_kind(title: str, kind: VerdictKind, *further: str) -> str:
    """Return a title with the verdict's word, if new, and further remarks in brackets."""
    remarks = [*([] if kind.value in title else [kind.value]), *further]
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
    return (
        verdict_notice(verdict),
        Text(reporting.paragraph("noise_level"), small=True),
        *(_map_picture(gap) if gap else ()),
        *where_blocks(verdict.where),
        *(_covariate_picture(gap, verdict) if gap else ()),
        *cause_blocks(verdict),
        *confounded_blocks(verdict),
        *closure_blocks(verdict),
        *(_before_after_picture(gap) if gap else ()),
        *limit_blocks(verdict),
        *((next_runs_table([run.to_dict() for run in verdict.next_runs]),) if verdict.next_runs else ()),
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


#: most covariates, runs and places shown; the JSON has them all
MAX_LINES: Final = 12
MAX_RUNS: Final = 5
#: a run is named where its gap exceeds this many noise levels
OUTSTANDING_Z: Final = 4.0
INTERVAL: Final = ("95 % interval | from", "95 % interval | to")


def where_blocks(where: GapLocation) -> list[Block]:
    """Return where the gap lies, as tables and sentences."""
    outstanding = grouped((line.name, line) for line in where.runs if abs(line.z) > OUTSTANDING_Z)
    lines = [prose(_run(run, of_run)) for run, of_run in outstanding.items()][:MAX_RUNS]
    return [
        *([_channels(where)] if where.channels else ()),
        *([_covariates(where)] if where.significant else ()),
        *(Text(prose(_place(line))) for line in where.places[:MAX_LINES]),
        *([Text("Runs with the largest gap:"), *items(lines)] if lines else ()),
    ]


def _channels(where: GapLocation) -> Table:
    rows = [(c.channel.label, *_sizes(c.channel.unit, c.rms, c.floor), fixed(c.ratio, 1)) for c in where.channels]
    title = "Where: the gap by channel, root mean square, against its noise level."
    return table(title, ("<Channel", "<Unit", "Gap", "Noise", "Ratio"), rows)


def _sizes(unit: str, *sizes: float) -> tuple[str, ...]:
    factor, shown = formatting.readable(unit, sizes[0])
    return (shown, *(three_digits(factor * size) for size in sizes))


def _covariates(where: GapLocation) -> Table:
    rows = []
    for line in where.significant[:MAX_LINES]:
        shares = [fixed(value, 2) for value in (line.share, *(line.ci95 or (None, None)))]
        rows.append((formatting.in_words(line.name), line.channel_label, *shares, formatting.probability(line.p_value)))
    return table(caption("table-covariates"), ("<Correlates with", "<Channel", "Share", *INTERVAL, "p"), rows)


def _run(run: str, lines: Sequence[RunDeviation]) -> str:
    parts = (
        f"{line.channel.label} {'+' * (line.value >= 0)}{three_digits(1e3 * line.value)} m{line.channel.unit} "
        f"({abs(line.z):.0f} times its noise level)"
        for line in lines
    )
    return f"{run}: {', '.join(parts)}"


def _place(line: PlaceResult) -> str:
    size = f"{1e3 * line.size:+.3g} m{line.unit}"
    spread = f"{1e3 * line.ci95[0]:.3g} to {1e3 * line.ci95[1]:.3g}"
    if line.place is None or line.place_ci95 is None:
        return f"It opens at {line.where}: {line.channel.label} {size} {line.what} (95 %: {spread})."
    places = dict(zip(("low", "high", "first", "last"), (*line.place, *line.place_ci95), strict=True))
    route = f" on {line.route.replace('_', ' ')}" if line.route else ""
    known = {"where": line.where, "route": route, "size": f"{line.channel.label} {size}", "spread": spread}
    return reporting.paragraph("place", **known, **places, coordinate=line.coordinate)


def closure_blocks(verdict: Diagnosis) -> list[Block]:
    """Return how far the gap shrinks and whether the fix is recommended."""
    fix, unexplained, paper = verdict.fix, verdict.unexplained, headline(verdict)
    sentences = [" ".join([_sentence(verdict) if verdict.causes else "", prose(advice(verdict))]).strip()]
    sentences += [prose(paper.sentence)] if paper else []
    if fix.agreement_m is not None:
        apart = f"{length(fix.agreement_m)} at the end of the {fix.agreement_on}"
        sentences.append(f"The corrections of the confounded causes differ by at most {apart}.")
    none = "No named cause" if verdict.causes else "No effect of the library"
    return [
        *([_by_channel(verdict)] if verdict.causes and verdict.closure.channels else ()),
        *map(Text, filter(None, sentences)),
        *([_transfer(verdict)] if fix.transfer else ()),
        *([Text(f"{none} explains {percent(unexplained.share)} of the gap.")] if unexplained else []),
        *(items(map(prose, unexplained.where)) if unexplained else ()),
    ]


def _by_channel(verdict: Diagnosis) -> Table:
    closure = verdict.closure
    rows = []
    for line in closure.channels:
        sizes = _sizes(line.channel.unit, line.before_rms, line.after_rms, line.floor_rms)
        rows.append((line.channel.label, *sizes, percent(line.fraction)))
    if closure.before_rms_m is not None and any(line.channel in POSE for line in closure.channels):
        ends = _sizes("m", closure.before_rms_m, closure.after_rms_m or 0.0, closure.floor_rms_m or 0.0)
        rows.append(("end position", *ends, MISSING))
    heads = ("<Channel", "<Unit", "Before", "After", "Noise", "Closed")
    runs = (
        f"on held-out runs, each {closure.held_out} in turn; root mean square with the model alone and with the causes"
    )
    if closure.held_out == RERUN:
        runs = "on all runs; root mean square with the simulator as it is, run again with the fix"
    return table(caption("table-closure", on=runs), heads, formatting.aligned(rows, 2, 3, 4))


def _sentence(verdict: Diagnosis) -> str:
    closure = verdict.closure
    if closure.fraction is None:
        return ""
    text = f"Each run and channel weighted by its noise, {percent(closure.fraction)} of the gap above the noise closes"
    interval = "" if closure.ci95 is None else f" (95 % interval {' to '.join(map(percent, closure.ci95))})"
    return f"{text}{interval}."


def _transfer(verdict: Diagnosis) -> Table:
    where, head = "on conditions that it was not fitted on, each held out in turn", "<Held out"
    if verdict.closure.held_out == RERUN:
        where, head = "where your simulator ran again with it", "<On runs of"
    rows = [
        (trial.left_out, trial.value.replace("_", " "), length(trial.before_rms_m), length(trial.after_rms_m))
        for trial in verdict.fix.transfer
    ]
    return table(caption("table-transfer", where=where), (head, "<Which", "Before", "After"), rows)


#: in a table, and in one sentence; the JSON has them all
MAX_CAUSES: Final = 24
MAX_SETS: Final = 8


def effect_name(effect: str) -> str:
    """Return an effect's id without underscores and colons."""
    return effect.replace("_", " ").replace(":", " ")


def cause_blocks(verdict: Diagnosis) -> list[Block]:
    """Return the named causes, their sizes, and remarks."""
    if not verdict.causes:
        return []
    named = verdict.causes[:MAX_CAUSES]
    doubtful = not all(cause.plausible for cause in named)
    ranked = []
    for cause in named:
        shares = map(percent, (cause.probability, cause.share, *(cause.share_ci95 or (None, None))))
        plausible = ["yes" if cause.plausible else "NO"] if doubtful else []
        ranked.append((cause.title + (f" ({cause.form})" if cause.form else ""), cause.effect, *shares, *plausible))
    title = "Which: the named causes, most probable first; the share is that of the gap above the noise level."
    heads = ("*Cause", "<Id", "Probability", "Share", *INTERVAL, *(["<Plausible"] if doubtful else []))
    blocks: list[Block] = [table(title, heads, ranked)]
    rows = [
        (cause.effect, effect_name(name), quantity.unit if quantity.unit != "1" else "", *_interval(quantity))
        for cause in named
        for name, quantity in cause.parameters.items()
    ]
    if rows:
        columns = ("<Cause", "<Parameter", "<Unit", "Value", *INTERVAL)
        blocks.append(table("Sizes of the causes with 95 % intervals.", columns, rows))
    known = {name: f"{name} ({100 * p:.0f} %)" for name, p in verdict.probabilities.items()}
    remarks = [f"{cause.effect}: {prose(cause.remark)}" for cause in verdict.causes if cause.remark]
    remarks += [
        f"{cause.effect}: these runs do not determine the form; "
        f"{', '.join(known.get(name, name) for name in cause.forms_open)} fit equally well"
        for cause in verdict.causes
        if cause.forms_open
    ]
    return [*blocks, *items(remarks)]


def confounded_blocks(verdict: Diagnosis) -> list[Block]:
    """Return the effects that these runs confound, and the credible sets of causes."""
    groups = items(", ".join(group) for group in verdict.groups[:MAX_CAUSES])
    sets = [" + ".join(names) or "none" for names in verdict.credible_sets]
    suffix = f"; and {len(sets) - MAX_SETS} more" if len(sets) > MAX_SETS else ""
    one_of = Text(f"With 95 % probability the cause is one of: {'; '.join(sets[:MAX_SETS])}{suffix}.")
    title = Text("Confounded in these runs, since their signatures are the same:")
    return [*([title, *groups] if groups else ()), *([one_of] if len(sets) > 1 else ())]


def limit_blocks(verdict: Diagnosis) -> list[Block]:
    """Return the detection limits of these runs, and the effects that they do not excite."""
    blocks: list[Block] = []
    unseen = [(limit.effect, prose(limit.smallest)) for limit in verdict.undetectable if not limit.never]
    if unseen:
        title = "Detection limits above the typical size: the smallest size that these runs would show."
        blocks.append(table(title, ("<Effect", "*Smallest size that would show"), unseen[:MAX_CAUSES]))
    if never := grouped((limit.smallest, limit.effect) for limit in verdict.undetectable if limit.never):
        effects = items(f"{', '.join(names)}: {prose(why)}" for why, names in never.items())
        blocks += [Text("Not excited by these runs, at any size:"), *effects]
    return blocks


def _interval(quantity: Quantity) -> tuple[str, ...]:
    low, high = quantity.ci95
    value = quantity.value
    numbers = (value, low, high) if math.isfinite(value) else (math.nan,) * 3
    half = 0.5 * (high - low) if math.isfinite(high - low) else abs(value)
    small = 0 < max(abs(value), half) < 1e-3
    return tuple(_scientific(number) if small else fixed(number, formatting.places(half)) for number in numbers)


def _scientific(value: float) -> str:
    if not math.isfinite(value):
        return MISSING
    mantissa, exponent = f"{value:.2e}".split("e")
    raised = str(int(exponent)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return f"{mantissa} × 10{raised}".replace("-", "−")


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
