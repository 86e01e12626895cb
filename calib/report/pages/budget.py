"""The uncertainty budget of a single effective radius and of the law."""

from __future__ import annotations

from calib.report.blocks import Block, Section
from calib.report.source import Source
from calib.report.statements.budget import law_budget, radius_budget, scatter_text

__all__ = ["section"]


def section(source: Source) -> Section:
    """Return what the uncertainty is made of."""
    blocks: list[Block] = [radius_budget(source.fit), law_budget(source.fit)]
    scatter = scatter_text(source.fit)
    return Section("Uncertainty budget", (*blocks, *((scatter,) if scatter else ())))
