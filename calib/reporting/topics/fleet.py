"""Fleet: spread between its vehicles, outliers, drift, common causes, failures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from calib.fleet.comparison import shown_quantity
from calib.fleet.population import Population
from calib.fleet.run import Fleet
from calib.fleet.survey import Survey
from calib.reporting.blocks import Block, Facts, Heading, Items, Picture, Table, Text, table

#: rows of a list at most; the tables have them all
MAX_ROWS = 40


def fleet_content(fleet: Fleet, *, pictures: bool = False) -> tuple[Block, ...]:
    """Return what the fit of a fleet says.

    `pictures`: for a page: with the figures, without what was read now.
    """
    view = fleet.view
    counts = f"{view.n_fitted} of {view.n_vehicles} fitted, {view.n_failed} failed"
    read = f"{fleet.n_read} read now, {fleet.n_kept} kept from before"
    # a page is the same however often the command was interrupted
    facts = (("vehicles", counts),) if pictures else (("vehicles", counts), ("files", read))
    blocks: list[Block] = [Heading("Fleet"), Facts(facts)]
    if view.populations:
        blocks.append(_population_table(view.populations))
    if pictures and view.n_fitted:
        blocks += _pictures(fleet)
    blocks += _counted("Outlying vehicles", [f"{outlier.vehicle}, {outlier.why}" for outlier in view.outliers])
    if view.drifting:
        blocks.append(_drifting(fleet))
    if view.common:
        blocks += [Heading("Common to many vehicles"), Items(tuple(cause.sentence for cause in view.common[:MAX_ROWS]))]
    failed = [record for record in fleet.records if record.status == "failed"]
    blocks += _counted("Failed", [f"{record.vehicle}: {record.why}" for record in failed])
    blocks.append(
        Text(
            "Outlying vehicles are named at a false discovery rate of 1 % "
            "(Benjamini and Hochberg); those that drift or share a cause at a family-wise error rate of 1 % "
            "(Holm). Mean and spread are those of the others, the differences between labels removed.",
            small=True,
        )
    )
    return tuple(blocks)


def _counted(title: str, lines: Sequence[str]) -> list[Block]:
    """Return lines under a title that says how many there are; nothing where there are none."""
    return [Heading(f"{title} ({len(lines)})"), Items(tuple(lines[:MAX_ROWS]))] if lines else []


def _population_table(populations: Mapping[str, Population]) -> Table:
    rows = []
    for name, population in populations.items():
        shown, scale, unit = shown_quantity(name)
        digits = 1 if unit == "nm/N" else 4
        half = 0.5 * (population.mean_ci95[1] - population.mean_ci95[0])
        numbers = (population.mean, half, population.spread, *population.spread_ci95, population.within)
        mean, plus, spread, low, high, within = (f"{scale * number:.{digits}f}" for number in numbers)
        rows.append((shown, f"{mean} ± {plus}", spread, f"{low} to {high}", within, unit))
    heads = ("<quantity", "mean", "between", "95 %", "within", "<unit")
    return table("The fleet; ± is the 95 % interval", heads, rows)


def _drifting(fleet: Fleet) -> Table:
    return table(
        f"Vehicles that drift ({len(fleet.view.drifting)}), soonest due first; ± is the 95 % interval",
        ("<vehicle", "<wheel", "drift (nm a day)", "due on day"),
        [
            (one.vehicle, one.wheel, f"{1e9 * one.per_day_m:+.0f} ± {1e9 * one.half_width_m:.0f}", f"{one.due_day:.0f}")
            for one in fleet.view.drifting[:MAX_ROWS]
        ],
    )


def _pictures(fleet: Fleet) -> list[Picture]:
    from calib.reporting.figures.challenge import fleet_distribution, fleet_drift

    caption = "Radius and slope of each vehicle with its 95 % interval, in order of size."
    alt = "Four panels of dots with bars: radius and slope of the left and right wheel, vehicles in order of size."
    pictures = [Picture("fleet-distribution", caption, alt, lambda: fleet_distribution(fleet))]
    drift = fleet_drift(fleet)
    if drift is not None:
        caption = "Drift of each wheel with its 95 % interval, in order of size."
        alt = "Dots with bars: drift of every wheel of the fleet in order of size."
        pictures.append(Picture("fleet-drift", caption, alt, lambda: drift))
    return pictures


def survey_content(survey: Survey, *, page: bool = False) -> tuple[Block, ...]:
    """Return what a task over a fleet says.

    `page`: for a page: without what was done now.
    """
    failed = [record for record in survey.records if record.status == "failed"]
    done = len(survey.records) - len(failed)
    facts = [("vehicles", f"{done} of {len(survey.records)} done, {len(failed)} failed")]
    if not page:
        facts.append(("now", f"{survey.n_done} done now, {survey.n_kept} kept from before"))
    blocks: list[Block] = [Heading(f"Fleet: {survey.what}"), Facts(tuple(facts))]
    quantities = survey.quantities
    shared = [cause.sentence for cause in survey.shared]
    if quantities is not None:
        if quantities.populations:
            blocks.append(_population_table(quantities.populations))
        blocks += _counted("Outlying vehicles", [f"{one.vehicle}, {one.why}" for one in quantities.outliers])
        shared += [difference.sentence for difference in quantities.common]
    if shared:
        blocks += [Heading("Common to many vehicles"), Items(tuple(shared[:MAX_ROWS]))]
    return (*blocks, *_counted("Failed", [f"{record.name}: {record.why}" for record in failed]))
