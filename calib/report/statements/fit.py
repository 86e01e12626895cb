"""What a fit says."""

from __future__ import annotations

from collections.abc import Sequence

from calib.radius.comparison import Difference, ModelComparison
from calib.radius.fitted import Fit
from calib.report.blocks import Block, Heading, Section, Table, Text, items
from calib.report.numbers import fixed, left, number_columns, places, plural, prose, text_columns
from calib.report.statements.budget import radius_budget
from calib.report.statements.checks import checks_table, usable_notice
from calib.report.statements.law import law_table, naive_text, quality_text, single_run_text, static_table
from calib.report.statements.runs import left_out_table, runs_table
from calib.report.statements.simulated import simulated_notice


def fit_content(fit: Fit, *, runs: bool = False) -> tuple[Block | Section, ...]:
    """Return what a fit says, the most important first and last; with `runs` the radius of every run, too."""
    sessions = len(set(fit.radii.session.tolist()))
    blocks: list[Block | Section] = [
        Heading(f"{fit.name}: {plural(len(fit.radii), 'run')} in {plural(sessions, 'session')}")
    ]
    if fit.simulated:
        blocks.append(simulated_notice())
    blocks += [law_table(fit), single_run_text(fit), Text(" ".join(map(quality_text, fit.wheels.values())))]
    naive = naive_text(fit)
    blocks += [naive] if naive else []
    blocks += [static_table(fit)] if fit.static else []
    blocks.append(checks_table(fit))
    if fit.radii.budget:
        blocks.append(radius_budget(fit))
    if runs:
        blocks.append(runs_table(fit))
    blocks += items(map(prose, fit.notes))
    if fit.radii.left_out:
        blocks.append(left_out_table(fit))
    return (*blocks, usable_notice(fit))


def comparison_content(compared: ModelComparison, notes: Sequence[str]) -> tuple[Block, ...]:
    """Return a fitted law held against a model's."""
    rows = []
    for side, wheel in (("left", compared.left), ("right", compared.right)):
        rows.append(_row(f"{side}: radius at {compared.reference_load_N:.0f} N", wheel.radius_ref, 1e3, "mm"))
        if wheel.slope is not None:
            rows.append(_row(f"{side}: slope", wheel.slope, 1e6, "µm/N"))
    columns = (
        *text_columns("Quantity", "Unit"),
        *number_columns("Fitted", "Model", "Difference"),
        *number_columns("from", "to", group="95 % interval"),
        left("Model lies"),
    )
    table = Table("Fitted law against the model's; the interval is that of the difference.", columns, tuple(rows))
    return (table, *items(map(prose, notes)))


def _row(name: str, difference: Difference, factor: float, unit: str) -> tuple[str, ...]:
    low, high = (factor * end for end in difference.ci95)
    decimals = places(0.5 * (high - low))
    values = (factor * difference.fitted, factor * difference.model, factor * difference.difference, low, high)
    return (name, unit, *(fixed(value, decimals) for value in values), "inside" if difference.inside else "OUTSIDE")
