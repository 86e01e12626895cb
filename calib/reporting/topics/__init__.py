"""Topics of a result: what the terminal prints and what the report shows of each, in one file."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from calib.reporting.blocks import Section
    from calib.reporting.source import Source

#: ``module:function`` of this folder, in the order of the report; each function is ``(source) -> Section | None``
PAGES: Final = (
    "fit:result_section", "report:item_section", "report:method_section", "report:conditions_section",
    "report:preparation_section", "runs:runs_section", "report:regression_section", "runs:deviation_section",
    "fit:residuals_section", "report:coefficients_section", "report:budget_section", "fit:diagnosis_section",
    "fit:decision_section", "report:limits_section", "report:files_section", "report:missing_section",
)  # fmt: skip


def sections_of(source: Source) -> tuple[Section, ...]:
    """Return the sections of all pages that apply to `source`, in the order of `PAGES`."""
    pages = (page.split(":") for page in PAGES)
    sections = (getattr(importlib.import_module(f"{__name__}.{module}"), name)(source) for module, name in pages)
    return tuple(section for section in sections if section is not None)
