"""A fleet's results; the scoreboard of a blind check."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final

from calib.campaign.checks.design import listed
from calib.challenge.score import TARGETS, Score, clopper_pearson, wilson
from calib.fleet.comparison import Population, Quantities, shown_quantity
from calib.fleet.run import Fleet, Survey
from calib.reporting import blocks
from calib.reporting.blocks import Block, Facts, Heading, Items, Picture, Table, table
from calib.reporting.formatting import MISSING
from calib.types import grouped

if TYPE_CHECKING:
    from calib.challenge.own_runs import Own


#: rows of a list at most; the tables have them all
MAX_ROWS = 40
_COMMON: Final = "Common to many vehicles"


def fleet_content(fleet: Fleet | Survey, *, page: bool = False) -> tuple[Block, ...]:
    """Return what a task over a fleet says.

    For a page with pictures, and without what was done now: interruptions change nothing.
    """
    mark = (blocks.simulated_notice(),) if fleet.simulated and not page else ()
    return (*mark, *(_of_survey(fleet, page=page) if isinstance(fleet, Survey) else _of_fit(fleet, page=page)))


def _of_fit(fleet: Fleet, *, page: bool) -> tuple[Block, ...]:
    view = fleet.view
    facts = (("vehicles", f"{view.n_fitted} of {view.n_vehicles} fitted, {view.n_failed} failed"),)
    read = (("files", f"{fleet.n_read} read now, {fleet.n_kept} kept from before"),)
    doubtful = [f"{one.vehicle}: {'; '.join(one.doubtful)}" for one in fleet.records if one.doubtful]
    return (
        Heading("Fleet"),
        Facts(facts if page else facts + read),
        *_populations(view.populations),
        *(_pictures(fleet) if page else ()),
        *_counted("Outlying vehicles", [f"{outlier.vehicle}, {outlier.why}" for outlier in view.outliers]),
        *([_drifting(fleet)] if view.drifting else ()),
        *_counted(_COMMON, [cause.sentence for cause in view.common]),
        *_counted("Doubtful laws, by checks that 'calib fit' of the vehicle explains", doubtful),
        *_counted("Failed", [f"{one.vehicle}: {one.why}" for one in fleet.records if one.status == "failed"]),
        blocks.Text(blocks.paragraph("fleet_rates"), small=True),
    )


def _counted(title: str, lines: Sequence[str]) -> list[Block]:
    return [Heading(f"{title} ({len(lines)})"), Items(tuple(lines[:MAX_ROWS]))] if lines else []


def _populations(populations: Mapping[str, Population]) -> list[Table]:
    rows = []
    for name, population in populations.items():
        shown, scale, unit = shown_quantity(name)
        half = 0.5 * (population.mean_ci95[1] - population.mean_ci95[0])
        numbers = (population.mean, half, population.spread, *population.spread_ci95, population.within)
        mean, plus, spread, low, high, within = (f"{scale * number:.4f}" for number in numbers)
        rows.append((shown, f"{mean} ± {plus}", spread, f"{low} to {high}", within, unit))
    heads = ("<quantity", "mean", "between", "95 %", "within", "<unit")
    return [table("The fleet; ± is the 95 % interval", heads, rows)] if rows else []


def _drifting(fleet: Fleet) -> Table:
    title = f"Vehicles that drift ({len(fleet.view.drifting)}), soonest due first; ± is the 95 % interval"
    rows = [
        (one.vehicle, one.wheel, f"{1e9 * one.per_day_m:+.0f} ± {1e9 * one.half_width_m:.0f}", f"{one.due_day:.0f}")
        for one in fleet.view.drifting[:MAX_ROWS]
    ]
    return table(title, ("<vehicle", "<wheel", "drift (nm a day)", "due on day"), rows)


def _pictures(fleet: Fleet) -> list[Picture]:
    from calib.reporting.figures.challenge import fleet_figures

    figures, shown = fleet_figures(fleet).items(), blocks.catalogue()["fleet"]
    return [Picture(f"fleet-{name}", blocks.caption(f"fleet-{name}"), shown[name], draw) for name, draw in figures]


def _of_survey(survey: Survey, *, page: bool) -> tuple[Block, ...]:
    failed = [f"{record.name}: {record.why}" for record in survey.records if record.status == "failed"]
    done = len(survey.records) - len(failed)
    facts = (("vehicles", f"{done} of {len(survey.records)} done, {len(failed)} failed"),)
    now = (("now", f"{survey.n_done} done now, {survey.n_kept} kept from before"),)
    found = survey.quantities or Quantities({}, (), ())
    shared = [*(cause.sentence for cause in survey.shared), *(one.sentence for one in found.common)]
    return (
        Heading(f"Fleet: {survey.what}"),
        Facts(facts if page else facts + now),
        *([_verdicts(survey)] if done else ()),
        *_populations(found.populations),
        *_counted("Outlying vehicles", [f"{one.vehicle}, {one.why}" for one in found.outliers]),
        *_counted(_COMMON, shared),
        *_counted("Failed", failed),
    )


def _verdicts(survey: Survey) -> Table:
    found = []
    for name, values in ((one.name, one.values) for one in survey.records if one.status != "failed"):
        what = [cause["effect"] for cause in values.get("causes", ())]
        what += [*values.get("wrong", ()), *values.get("suspicious", ())]
        found.append(((values.get("verdict", MISSING), ", ".join(what) or MISSING), name))
    alike = sorted(grouped(found).items(), key=lambda one: -len(one[1]))[:MAX_ROWS]
    rows = [(*words, str(len(names)), listed(names)) for words, names in alike]
    return table("Verdicts", ("<Verdict", "*Found", "Vehicles", "*Which"), rows)


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
        intervals = (of(line.hits, line.total) for of in (wilson, clopper_pearson))
        spans = [f"{low:.1%}..{high:.1%}" for low, high in intervals]
        target = f"{TARGETS[name][1]} {TARGETS[name][0]:.0%}" if name in TARGETS else ""
        rows.append((name, f"{line.hits}/{line.total}", rate, *spans, target, _MET[score.meets(name)]))
    title = f"{len(score.cases)} sealed cases ({score.purpose}), truth {score.truth_sha256}"
    heads = ("95 % interval | Wilson", "95 % interval | Clopper-Pearson")
    return table(title, ("<Line", "Cases", "Share", *heads, "Target", "<"), rows)


def _parts(score: Score) -> list[Table]:
    words = ("detected", "first", "in_group", "covered")
    titles = ("Signal", "A gap seen", "Named first", "Named or in its group", "In the 95 % set",
              "Ceiling", "First over ceiling", "Own ceiling", "First over own")  # fmt: skip
    ceilings = ("gated", "hits_over_gated", "own_gated", "hits_over_own_gated")
    by_signal = []
    for signal, row in score.by_signal.items():
        reached = (score.ceilings[signal][key] for key in ceilings)
        shares = (f"{row[word].hits}/{row[word].total}" for word in words)
        by_signal.append((signal, *shares, *(MISSING if one is None else f"{one:.2f}" for one in reached)))
    reliability = [
        (f"{one.low:.1f}..{one.high:.1f}", f"{one.stated:.3f}", f"{one.true.rate:.3f}", f"{one.true.total}")
        for one in score.reliability
    ]
    return [
        table("Single effects by signal.", titles, by_signal),
        table("Stated probabilities.", ("Bin", "Stated", "True", "Statements"), reliability),
    ]


def _misses(score: Score) -> Table:
    rows = []
    for case in score.misses:
        signal = MISSING if case.signal is None else f"{case.signal:g}"
        truth = f"deleted {case.deleted}" if case.deleted else " + ".join(case.truth) or "nothing"
        answer = case.error or f"{case.verdict}: {', '.join(case.named)}".rstrip(": ")
        rows.append((case.case, case.group, signal, truth, answer, case.rival))
    return table("Misses.", ("<Case", "<Group", "Signal", "*Truth", "*Answer", "*Nearest alternative, sigma"), rows)


def own_content(own: "Own") -> list[Block]:
    """Return what was found, as blocks."""
    head = ("*Planted", "Size", "<Unit", "Signal", "Times", "Seen")
    rows: dict[bool, list[tuple[str, ...]]] = {False: [], True: []}
    for plant in own.found:
        counted = ("open", "wrong") if plant.outside else ("first", "in_group", "wrong")
        counts = (str(len(plant.answers)), *(str(plant.times(what)) for what in ("seen", *counted)))
        rows[plant.outside].append((plant.effect, f"{plant.size:.3g}", plant.unit, f"{plant.signal:.1f}", *counts))
    low, high = (f"{bound:.0%}" for bound in clopper_pearson(own.raised, len(own.empty)))
    sentences = [
        f"False alarms where nothing was planted: {own.raised} of {len(own.empty)} (95 %: {low} to {high}).",
        f"Something else named: {own.wrong} of {own.planted} planted.",
        blocks.paragraph("own_noise", units=own.units, repeated=own.units_with_repeats, verdict=own.own_verdict),
    ]
    if own.done < own.asked:
        sentences.append(f"Diagnosed {own.done} of {own.asked}: the time was up.")
    planted = f"Planted on {own.campaign}'s own noise and route."
    mark = [blocks.simulated_notice()] if own.simulated else []
    shown: list[Block] = [*mark, table(planted, (*head, "First", "In group", "Wrong"), rows[False])]
    if rows[True]:
        shown.append(table("Causes that no library holds.", (*head, "Left open", "Fix recommended"), rows[True]))
    return [*shown, Items((*sentences, *(f"Not planted: {name}: {why}." for name, why in own.left_out.items())))]
