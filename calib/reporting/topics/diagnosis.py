"""Diagnosis of a gap: verdict, pictures and page of linked panels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from calib.gap.decision.diagnosis import Diagnosis, Plan, VerdictKind
from calib.reporting.blocks import (
    Block,
    Heading,
    Notice,
    Picture,
    Section,
    Text,
    items,
    picture,
    simulated_notice,
)
from calib.reporting.formatting import length, prose, three_digits, with_unit
from calib.reporting.source import doubtful_causes
from calib.reporting.topics.effects import next_runs_table, promise_table
from calib.reporting.topics.gap import (
    cause_blocks,
    closure_blocks,
    confounded_blocks,
    effect_name,
    limit_blocks,
    where_blocks,
)
from calib.types import FloatArray

if TYPE_CHECKING:
    from calib.reporting.figures.gap import GapArrays

#: verdict -> level of its notice, and its title
TITLES: Final[Mapping[VerdictKind, tuple[str, str]]] = {
    VerdictKind.NO_GAP: ("good", "No gap beyond the noise"),
    VerdictKind.EXPLAINED: ("good", "The gap is explained"),
    VerdictKind.PARTLY_EXPLAINED: ("note", "The gap is explained in part"),
    VerdictKind.AMBIGUOUS: ("note", "These runs cannot tell the causes apart"),
    VerdictKind.UNKNOWN: ("bad", "The cause of the gap is unknown"),
    VerdictKind.UNDECIDED: ("note", "These runs cannot show whether there is a gap"),
}


def verdict_notice(verdict: Diagnosis) -> Notice:
    """Return the verdict with its sentence."""
    level, title = TITLES[verdict.kind]
    return Notice(level, with_kind(title, verdict.kind), prose(verdict.sentence))


def with_kind(title: str, kind: VerdictKind, *more: str) -> str:
    """Return a title with the verdict's word, where the title does not hold it, and further remarks in brackets."""
    remarks = [*([] if kind.value in title else [kind.value]), *more]
    return f"{title} ({', '.join(remarks)})" if remarks else title


def page_one_notice(verdict: Diagnosis) -> Notice:
    """Return the verdict for the first page: with the probabilities of its causes where one is in doubt."""
    notice = verdict_notice(verdict)
    doubt = doubtful_causes((cause.effect, cause.probability) for cause in verdict.causes)
    return replace(notice, text=f"{notice.text} {doubt}".strip())


def diagnosis_full(verdict: Diagnosis) -> tuple[Block, ...]:
    """Return what the terminal prints of a diagnosis, under the name of its campaign."""
    mark = (simulated_notice(),) if verdict.simulated else ()
    return (Heading(verdict.campaign), *mark, *diagnosis_content(verdict))


def diagnosis_content(verdict: Diagnosis, gap: GapArrays | None = None) -> tuple[Block, ...]:
    """Return the statements of a diagnosis, with its pictures where its arrays are given."""
    next_runs = (next_runs_table([run.to_dict() for run in verdict.next_runs]),) if verdict.next_runs else ()
    return (
        verdict_notice(verdict),
        Text(
            "The gap is measured minus simulated motion, run by run. The noise level is the scatter of repeated runs; "
            "no model gets below it.",
            small=True,
        ),
        *map_picture(gap),
        *where_blocks(verdict.where),
        *covariate_picture(gap, verdict),
        *cause_blocks(verdict),
        *confounded_blocks(verdict),
        *closure_blocks(verdict),
        *before_after_picture(gap),
        *limit_blocks(verdict),
        *next_runs,
        *items(map(prose, verdict.notes)),
    )


def gap_section(verdict: Diagnosis, gap: GapArrays | None = None) -> Section:
    """Return the section of a report on a diagnosis; `gap`: the arrays of its figures, by default its own."""
    from calib.reporting.figures.gap import GapArrays

    if gap is None and verdict.evidence is not None:
        gap = GapArrays.of(verdict)
    return Section("Diagnosis of the gap", diagnosis_content(verdict, gap))


def map_picture(gap: GapArrays | None) -> list[Picture]:
    """Return the gap on the floor plan."""
    if gap is None or gap.offset_m is None:
        return []
    largest = float(np.nanmax(np.hypot(*gap.offset_m.T), initial=0.0))
    return [
        picture(
            "gap-map",
            "The gap on the floor plan: paths driven, and arrows from the simulated to the measured end of each run.",
            f"Floor plan of {len(gap.paths_m)} runs with the gap at their ends, at most {length(largest)}",
            "gap.gap_map",
            *(gap.paths_m, gap.offset_m, gap.labels["kind"]),
        )
    ]


def covariate_picture(gap: GapArrays | None, verdict: Diagnosis) -> list[Picture]:
    """Return the channel furthest above its noise level, against what varied between the runs."""
    if gap is None:
        return []
    from calib.reporting.figures.gap import MAX_PANELS, distinct, rms

    # covariates that explain most come first: the number of panels is limited
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
    return [
        picture(
            "gap-by-covariate",
            f"The {title} gap against what varied between the runs; squares are means with their 95 % intervals, the "
            f"grey band is the noise level.{aside}",
            f"Gap of the channel {title} against {', '.join(effect_name(name) for name, _ in shown)}",
            "gap.gap_by_covariate",
            *(gap.before[:, worst], title, unit, varied),
            noise_level=levels[worst],
            group=gap.labels["kind"],
        )
    ]


def before_after_picture(gap: GapArrays | None) -> list[Picture]:
    """Return the gap of every run before and after the correction, channel by channel."""
    if gap is None or not np.isfinite(gap.before).any():
        return []
    from calib.reporting.figures.gap import rms

    channels = [(effect_name(name), unit) for name, unit in gap.channels]
    sizes = [
        f"{name} {three_digits(rms(before))} to {three_digits(rms(after))} {unit}"
        for (name, unit), before, after in zip(channels, gap.before.T, gap.after.T, strict=True)
        if np.isfinite(before).any()
    ]
    return [
        picture(
            "gap-before-after",
            "The gap of every run before and after the correction, channel by channel, on held-out runs; bars "
            "are mean and standard deviation, numbers root mean squares, the grey band is the noise level.",
            "Gap before and after by channel: " + "; ".join(sizes),
            "gap.before_after",
            *(channels, gap.before, gap.after, gap.noise_level),
        )
    ]


def _known(values: FloatArray) -> FloatArray:
    return np.asarray(values[np.isfinite(values)], dtype=np.float64)


def diagnosis_brief(diagnosis: Diagnosis) -> tuple[Block, ...]:
    """Return what the interpreter shows of a diagnosis: its verdict."""
    return (verdict_notice(diagnosis),)


def plan_content(plan: Plan) -> tuple[Block, ...]:
    """Return what the terminal prints of a plan: the verdict that it follows from, and the runs to drive next."""
    return (verdict_notice(plan.diagnosis), *runs_and_promises(plan))


def runs_and_promises(plan: Plan) -> tuple[Block, ...]:
    """Return the runs to drive next, and the intervals that `calib geometry` will then give."""
    promises = [promise_table(plan.now, plan.then)] if plan.then else []
    return (next_runs_table([run.to_dict() for run in plan.runs]), *promises)
