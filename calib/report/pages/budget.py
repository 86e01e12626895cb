"""The uncertainty budget of a single effective radius and of the law."""

from __future__ import annotations

from calib.report.blocks import Block, Section
from calib.report.source import Source
from calib.report.statements.budget import budget_picture, declared_text, law_budget, radius_budget, scatter_text


def section(source: Source) -> Section:
    """Return what the uncertainty is made of."""
    fit = source.fit
    blocks: list[Block] = [radius_budget(fit), budget_picture(fit), law_budget(fit), declared_text(fit)]
    scatter = scatter_text(fit)
    return Section("Uncertainty budget", (*blocks, *((scatter,) if scatter else ())))
