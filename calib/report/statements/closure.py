"""How far the gap shrinks: on runs left out, on conditions that the fix was not fitted on, and what is left."""

from __future__ import annotations

from calib.gap.data.channels import POSE
from calib.gap.verdict.paper_headline import PaperHeadline
from calib.gap.verdict.result import Verdict
from calib.gap.verdict.sentence import advice
from calib.report.blocks import Block, Column, Table, Text, items
from calib.report.numbers import MISSING, aligned, left, length, percent, prose, readable, three_digits


def closure_blocks(verdict: Verdict, headline: PaperHeadline | None = None) -> list[Block]:
    """Return how far the gap shrinks and whether the fix is recommended."""
    blocks: list[Block] = []
    if verdict.causes and verdict.closure.channels:
        blocks.append(_by_channel(verdict))
    sentence = _sentence(verdict) if verdict.causes else ""
    advised = advice(verdict)
    if sentence or advised:
        blocks.append(Text(" ".join(part for part in (sentence, prose(advised)) if part)))
    if headline is not None:
        blocks.append(Text(prose(headline.sentence)))
    fix = verdict.fix
    if fix.agreement_m is not None:
        blocks.append(
            Text(
                "The corrections of the causes that cannot be told apart differ by at most "
                f"{length(fix.agreement_m)} at the end of the {fix.agreement_on}."
            )
        )
    if fix.transfer:
        blocks.append(_transfer(verdict))
    if verdict.rest is not None:
        blocks.append(Text(f"No named cause explains {percent(verdict.rest.share)} of the gap."))
        blocks += items(map(prose, verdict.rest.where))
    return blocks


def _by_channel(verdict: Verdict) -> Table:
    closure = verdict.closure
    rows = []
    for line in closure.channels:
        factor, unit = readable(line.channel.unit, line.before_rms)
        sizes = (three_digits(factor * value) for value in (line.before_rms, line.after_rms, line.floor_rms))
        rows.append((line.channel.label, unit, *sizes, percent(line.fraction)))
    if closure.before_rms_m is not None and any(line.channel in POSE for line in closure.channels):
        factor, unit = readable("m", closure.before_rms_m)
        ends = (closure.before_rms_m, closure.after_rms_m or 0.0, closure.floor_rms_m or 0.0)
        rows.append(("end position", unit, *(three_digits(factor * value) for value in ends), MISSING))
    return Table(
        f"How far: the gap by channel on runs left out, each {closure.held_out} in turn; root mean square with the "
        "model alone, with the causes added, and of the floor. Closed is the share of the squares beyond the floor.",
        (left("Channel"), left("Unit"), Column("Before"), Column("After"), Column("Floor"), Column("Closed")),
        aligned(rows, 2, 3, 4),
    )


def _sentence(verdict: Verdict) -> str:
    closure = verdict.closure
    if closure.fraction is None:
        return ""
    text = f"Every run and channel weighed by its noise, {percent(closure.fraction)} of the gap above the floor closes"
    if closure.ci95 is None:
        return f"{text}."
    low, high = closure.ci95
    return f"{text} (95 % interval {percent(low)} to {percent(high)})."


def _transfer(verdict: Verdict) -> Table:
    return Table(
        "What the fix does to the end position (else the distance), root mean square, on conditions that it was not "
        "fitted on, each left out in turn.",
        (left("Left out"), left("Which"), Column("Before"), Column("After")),
        tuple(
            (trial.left_out, trial.value.replace("_", " "), length(trial.before_rms_m), length(trial.after_rms_m))
            for trial in verdict.fix.transfer
        ),
    )
