"""The blind check in blocks: the scoreboard, and what a laboratory's own data would find."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from calib.challenge.score import TARGETS, clopper_pearson, wilson
from calib.reporting.blocks import Block, Items, Table, table
from calib.reporting.formatting import MISSING

if TYPE_CHECKING:
    from calib.challenge.own.run import Own
    from calib.challenge.score import Score

_MET: Final = {True: "met", False: "MISSED", None: ""}


def score_content(score: Score) -> list[Block]:
    """Return what a score says."""
    summary = score.summary
    coverage = summary["interval_coverage"]
    sentences = [
        f"95 % set: {summary['median_set_size']} hypotheses (median)",
        f"95 % intervals that hold the truth: {coverage['hits']} of {coverage['total']}",
    ]
    if summary["closure_compared"]:
        difference = summary["closure_predicted_minus_achieved_median"]
        sentences.append(f"closure, predicted against achieved: {difference:.3f} apart (median)")
    if summary["crowded_stated_minus_true"] is not None:
        sentences.append(
            "crowded cases: stated probabilities less the share that is true: "
            f"{summary['crowded_stated_minus_true']:+.3f} (wanted within 0.05)"
        )
    return [_board(score), *_parts(score), Items(tuple(sentences)), _misses(score)]


def _board(score: Score) -> Table:
    rows = []
    for name, line in score.board.items():
        rate = MISSING if line.rate is None else f"{line.rate:.1%}"
        spans = [
            f"{low:.1%}..{high:.1%}" for low, high in (of(line.hits, line.total) for of in (wilson, clopper_pearson))
        ]
        target = f"{TARGETS[name][1]} {TARGETS[name][0]:.0%}" if name in TARGETS else ""
        rows.append((name, f"{line.hits}/{line.total}", rate, *spans, target, _MET[score.meets(name)]))
    caption = f"{len(score.cases)} sealed cases ({score.purpose}), truth {score.truth_sha256}"
    intervals = ("95 % interval | Wilson", "95 % interval | Clopper-Pearson")
    return table(caption, ("<Line", "Cases", "Share", *intervals, "Target", "<"), rows)


def _parts(score: Score) -> list[Table]:
    words = ("detected", "first", "in_group", "covered")
    titles = ("Signal", "A gap seen", "Named first", "Named or in its group", "In the 95 % set",
              "Ceiling", "First over ceiling", "Own ceiling", "First over own")  # fmt: skip
    ceilings = ("gated", "hits_over_gated", "own_gated", "hits_over_own_gated")
    by_signal = tuple(
        (
            signal,
            *(f"{row[word].hits}/{row[word].total}" for word in words),
            *(MISSING if (v := score.ceilings[signal][key]) is None else f"{v:.2f}" for key in ceilings),
        )
        for signal, row in score.by_signal.items()
    )
    reliability = tuple(
        (f"{one.low:.1f}..{one.high:.1f}", f"{one.stated:.3f}", f"{one.true.rate:.3f}", f"{one.true.total}")
        for one in score.reliability
    )
    return [
        table("Single effects by signal.", titles, by_signal),
        table("Stated probabilities.", ("Bin", "Stated", "True", "Statements"), reliability),
    ]


def _misses(score: Score) -> Table:
    rows = tuple(
        (
            case.case,
            case.group,
            MISSING if case.signal is None else f"{case.signal:g}",
            (f"deleted {case.deleted}" if case.deleted else " + ".join(case.truth)) or "nothing",
            case.error or f"{case.verdict}: {', '.join(case.named)}".rstrip(": "),
            case.rival,
        )
        for case in score.misses
    )
    return table("Misses.", ("<Case", "<Group", "Signal", "*Truth", "*Answer", "*Nearest alternative, sigma"), rows)


def own_content(own: Own) -> list[Block]:
    """Return what was found, as blocks."""
    head = ("*Planted", "Size", "<Unit", "Signal", "Times", "Seen")
    rows: dict[bool, list[tuple[str, ...]]] = {False: [], True: []}
    for found in own.found:
        plant = found.plant
        counted = ("open", "wrong") if plant.outside else ("first", "in_group", "wrong")
        counts = (str(len(found.answers)), *(str(found.times(what)) for what in ("seen", *counted)))
        rows[plant.outside].append((plant.effect, f"{plant.size:.3g}", plant.unit, f"{plant.signal:.1f}", *counts))
    low, high = (f"{bound:.0%}" for bound in clopper_pearson(own.raised, len(own.empty)))
    sentences = [
        f"False alarms where nothing was planted: {own.raised} of {len(own.empty)} (95 %: {low} to {high}).",
        f"Something else named: {own.wrong} of {own.planted} planted.",
        f"The noise is what the diagnosis leaves of {own.units} units, {own.units_with_repeats} of them with repeats; "
        f"the campaign's own verdict was {own.own_verdict}.",
    ]
    if own.done < own.asked:
        sentences.append(f"Diagnosed {own.done} of {own.asked}: the time was up.")
    planted = f"Planted on {own.campaign}'s own noise and route."
    blocks: list[Block] = [table(planted, (*head, "First", "In group", "Wrong"), rows[False])]
    if rows[True]:
        blocks.append(table("Causes that no library holds.", (*head, "Left open", "Fix recommended"), rows[True]))
    return [*blocks, Items((*sentences, *(f"Not planted: {name}: {why}." for name, why in own.left_out.items())))]
