"""Result of a fit, at a glance and in full, and its comparison with a model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

from calib.radius.result import Fit
from calib.reporting.blocks import Block, Heading, Notice, Picture, Section, Text, items, simulated_notice, table
from calib.reporting.formatting import fixed, places, plural, prose
from calib.reporting.topics.budget import budget_picture, radius_budget
from calib.reporting.topics.checks import checks_table, residuals_picture, usable_notice
from calib.reporting.topics.conditions import assumed_notice
from calib.reporting.topics.deviation import deviation_picture
from calib.reporting.topics.law import (
    law_table,
    naive_text,
    quality_text,
    regressions_picture,
    single_run_text,
    static_table,
)
from calib.reporting.topics.runs import left_out_table, runs_picture, runs_table

if TYPE_CHECKING:
    from calib.radius.fit import Difference, ModelComparison
    from calib.reporting.source import Source

#: names of the pictures of a fit, in the order of the report's pages
FIT_PICTURES: Final = ("runs-by-series", "regressions", "path-deviation", "residuals", "budget")


def fit_content(fit: Fit, *, runs: bool = False) -> tuple[Block | Section, ...]:
    """Return what a fit says, the most important first and last; with `runs` the radius of every run, too."""
    sessions = len(set(fit.radii.session.tolist()))
    return (
        Heading(f"{fit.name}: {plural(len(fit.radii), 'run')} in {plural(sessions, 'session')}"),
        *([simulated_notice()] if fit.simulated else []),
        law_table(fit),
        single_run_text(fit),
        Text(" ".join(map(quality_text, fit.wheels.values()))),
        *naive_text(fit),
        *([static_table(fit)] if fit.static else []),
        checks_table(fit),
        *([radius_budget(fit)] if fit.radii.budget else []),
        *([runs_table(fit)] if runs else []),
        *items(map(prose, fit.notes)),
        *([left_out_table(fit)] if fit.radii.left_out else []),
        usable_notice(fit),
    )


def comparison_content(compared: ModelComparison, notes: Sequence[str]) -> tuple[Block, ...]:
    """Return a fitted law held against a model's."""
    rows = []
    for side, wheel in (("left", compared.left), ("right", compared.right)):
        rows.append(_row(f"{side}: radius at {compared.reference_load_N:.0f} N", wheel.radius_ref, 1e3, "mm"))
        if wheel.slope is not None:
            rows.append(_row(f"{side}: slope", wheel.slope, 1e6, "µm/N"))
    interval = ("95 % interval | from", "95 % interval | to")
    heads = ("<Quantity", "<Unit", "Fitted", "Model", "Difference", *interval, "<Model lies")
    caption = "Fitted law against the model's; the interval is that of the difference."
    return (table(caption, heads, rows), *items(map(prose, notes)))


def _row(name: str, difference: Difference, factor: float, unit: str) -> tuple[str, ...]:
    low, high = (factor * end for end in difference.ci95)
    decimals = places(0.5 * (high - low))
    values = (factor * difference.fitted, factor * difference.model, factor * difference.difference, low, high)
    return (name, unit, *(fixed(value, decimals) for value in values), "inside" if difference.inside else "OUTSIDE")


def result_section(source: Source) -> Section:
    """Return the laws in one table and the verdict of the checks in one sentence."""
    fit = source.fit
    laws = [wheel.law for wheel in fit.wheels.values()]
    low, high = max(law.load_min_N for law in laws), min(law.load_max_N for law in laws)
    loads = f"a wheel load of {low:.0f} N" if high - low < 1.0 else f"wheel loads from {low:.0f} to {high:.0f} N"
    holds = Text(
        f"The law holds for {loads}. It comes from {len(fit.radii)} runs along a straight corridor. The same law, with "
        "its covariance, is attached to this PDF as coefficients.json."
    )
    assumed = () if fit.setup is None else assumed_notice(fit.setup.assumed)
    return Section("Result", (law_table(fit), holds, single_run_text(fit), usable_notice(fit), *assumed, *_gap(source)))


def diagnosis_section(source: Source) -> Section | None:
    """Return the findings of the diagnosis, or None where the report has none."""
    if source.verdict is None:
        return None
    from calib.reporting.topics.diagnosis import gap_section

    return gap_section(source.verdict, source.gap)


def _gap(source: Source) -> tuple[Notice, ...]:
    """Return what a diagnosis found, where one was made with this report or lies beside the fit."""
    if source.verdict is None and source.known_verdict is None:
        return ()
    from calib.reporting.topics.diagnosis import TITLES, page_one_notice

    if source.verdict is not None:
        return (page_one_notice(source.verdict),)
    assert source.known_verdict is not None
    kind, sentence = source.known_verdict
    level, title = TITLES[kind]
    return (Notice(level, f"{title} ({kind.value}, from diagnosis.json)", prose(sentence)),)


def fit_pictures(fit: Fit) -> tuple[Picture, ...]:
    """Return the pictures that a report on a fit shows."""
    draw = (runs_picture, regressions_picture, deviation_picture, residuals_picture)
    return (*(picture(fit) for picture in draw), *((budget_picture(fit),) if fit.radii.budget else ()))


def fit_brief(fit: Fit) -> tuple[Block, ...]:
    """Return what the interpreter shows of a fit: both laws, and whether they can be used."""
    return (law_table(fit), usable_notice(fit))
