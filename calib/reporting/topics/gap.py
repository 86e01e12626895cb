"""Gap: its place, causes and closure."""

import math
from collections.abc import Sequence
from typing import Final

from calib.gap.decision.diagnosis import Diagnosis, Quantity
from calib.gap.decision.held_out import RERUN, Closure
from calib.gap.decision.sentences import advice, headline
from calib.gap.localise import PlaceResult
from calib.gap.localise.locate import GapLocation, RunDeviation
from calib.gap.observations import POSE
from calib.reporting import Block, Table, Text, caption, formatting, items, paragraph, table
from calib.reporting.formatting import MISSING, fixed, length, percent, probability, prose, readable, three_digits
from calib.types import grouped

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
    factor, shown = readable(unit, sizes[0])
    return (shown, *(three_digits(factor * size) for size in sizes))


def _covariates(where: GapLocation) -> Table:
    rows = []
    for line in where.significant[:MAX_LINES]:
        shares = [fixed(value, 2) for value in (line.share, *(line.ci95 or (None, None)))]
        rows.append((formatting.in_words(line.name), line.channel_label, *shares, probability(line.p_value)))
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
    return paragraph("place", **known, **places, coordinate=line.coordinate)


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


def _on_which_runs(closure: Closure) -> str:
    if closure.held_out == RERUN:
        return "on all runs; root mean square with the simulator as it is, run again with the fix"
    return (
        f"on held-out runs, each {closure.held_out} in turn; root mean square with the model alone and with the causes"
    )


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
    return table(caption("table-closure", on=_on_which_runs(closure)), heads, formatting.aligned(rows, 2, 3, 4))


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
    more = f"; and {len(sets) - MAX_SETS} more" if len(sets) > MAX_SETS else ""
    one_of = Text(f"With 95 % probability the cause is one of: {'; '.join(sets[:MAX_SETS])}{more}.")
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
