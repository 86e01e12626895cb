"""What a diagnosis says: verdict, where, which, what cannot be told apart, how far, what next."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from calib.gap.verdict.result import Verdict, VerdictKind
from calib.report.blocks import Block, Heading, Notice, Text, items
from calib.report.gap_findings import GapFindings
from calib.report.numbers import prose
from calib.report.statements.causes import apart_blocks, cause_blocks, limit_blocks
from calib.report.statements.closure import closure_blocks
from calib.report.statements.gap_pictures import before_after_picture, covariate_picture, map_picture
from calib.report.statements.plan import next_runs_table
from calib.report.statements.simulated import simulated_notice
from calib.report.statements.where import where_blocks

#: verdict -> how it is shown, and its title
TITLES: Final[Mapping[VerdictKind, tuple[str, str]]] = {
    VerdictKind.NO_GAP: ("good", "No gap beyond the noise"),
    VerdictKind.EXPLAINED: ("good", "The gap is explained"),
    VerdictKind.PARTLY_EXPLAINED: ("note", "The gap is explained in part"),
    VerdictKind.AMBIGUOUS: ("note", "These runs cannot tell the causes apart"),
    VerdictKind.UNKNOWN: ("bad", "The cause of the gap is unknown"),
    VerdictKind.UNDECIDED: ("note", "These runs cannot show whether there is a gap"),
}


def verdict_notice(verdict: Verdict) -> Notice:
    """Return the verdict with its sentence."""
    level, title = TITLES[verdict.kind]
    return Notice(level, f"{title} ({verdict.kind.value})", prose(verdict.sentence))


def verdict_content(verdict: Verdict) -> tuple[Block, ...]:
    """Return what a verdict says by itself, under the name of its campaign."""
    mark = (simulated_notice(),) if verdict.simulated else ()
    return (Heading(verdict.campaign), *mark, *diagnosis_content(GapFindings.of(verdict)))


def diagnosis_content(gap: GapFindings) -> tuple[Block, ...]:
    """Return what a diagnosis says, with the pictures that its arrays allow."""
    verdict = gap.verdict
    blocks: list[Block] = [
        verdict_notice(verdict),
        Text(
            "The gap is measured minus simulated motion, run by run. The floor is what repeats of a run scatter; "
            "no model gets below it.",
            small=True,
        ),
        *map_picture(gap),
        *where_blocks(verdict.where),
        *covariate_picture(gap),
        *cause_blocks(verdict),
        *apart_blocks(verdict),
        *closure_blocks(verdict, gap.headline),
        *before_after_picture(gap),
        *limit_blocks(verdict),
    ]
    if verdict.next_runs:
        blocks.append(next_runs_table([run.to_dict() for run in verdict.next_runs]))
    return (*blocks, *items(map(prose, verdict.notes)))
