"""How far the gap shrinks: on runs left out, on conditions that the fix was not fitted on, and what is left."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from calib.gap.verdict.result import Verdict
from calib.gap.verdict.sentence import advice
from calib.report.blocks import Block, Column, Items, Table, Text
from calib.report.numbers import left, length, percent, prose

__all__ = ["closure_blocks"]


def closure_blocks(verdict: Verdict, headline: Mapping[str, Any] | None = None) -> list[Block]:
    """Return how far the gap shrinks and whether the fix is recommended.

    Parameters
    ----------
    verdict : Verdict
        Of a diagnosis.
    headline : mapping, optional
        The paper's headline beside it; from `calib.gap.verdict.paper_headline.headline`.
    """
    blocks: list[Block] = []
    sentence = _sentence(verdict)
    advised = advice(verdict)
    if sentence or advised:
        blocks.append(Text(" ".join(part for part in (sentence, prose(advised)) if part)))
    if headline is not None:
        blocks.append(Text(prose(str(headline["sentence"]))))
    fix = verdict.fix
    if fix.agreement_m is not None:
        blocks.append(
            Text(
                "The corrections of the causes that cannot be told apart differ by at most "
                f"{length(fix.agreement_m)} on the runs asked about."
            )
        )
    if fix.transfer:
        blocks.append(_transfer(verdict))
    if verdict.rest is not None:
        words = f"No named cause explains {percent(verdict.rest.share)} of the gap."
        blocks.append(Text(words))
        if verdict.rest.where:
            blocks.append(Items(tuple(prose(line) for line in verdict.rest.where)))
    return blocks


def _sentence(verdict: Verdict) -> str:
    closure = verdict.closure
    if closure.before_rms_m is None or closure.after_rms_m is None:
        return ""
    text = (
        f"How far: on runs left out (each {closure.held_out} in turn) the gap is {length(closure.before_rms_m)} with "
        f"the model alone and {length(closure.after_rms_m)} with the cause added"
    )
    text += "." if closure.floor_rms_m is None else f"; the floor is {length(closure.floor_rms_m)}."
    if closure.fraction is None:
        return text
    text += f" Every run and channel weighed by its noise, that closes {percent(closure.fraction)} of the gap"
    if closure.ci95 is None:
        return f"{text} above the floor."
    low, high = closure.ci95
    return f"{text} above the floor (95 % interval {percent(low)} to {percent(high)})."


def _transfer(verdict: Verdict) -> Table:
    return Table(
        "What the fix does on conditions that it was not fitted on, each left out in turn.",
        (left("Left out"), left("Which"), Column("Before"), Column("After")),
        tuple(
            (trial.left_out, trial.value.replace("_", " "), length(trial.before_rms_m), length(trial.after_rms_m))
            for trial in verdict.fix.transfer
        ),
    )
