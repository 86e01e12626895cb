"""The pages of a report, one file each; adding one means adding its file and its line here."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from calib.report.blocks import Section
    from calib.report.source import Source

__all__ = ["PAGES", "sections_of"]

#: modules of this folder, in the order of the report; each has ``section(source) -> Section | None``
PAGES: Final = (
    "outcome",
    "item",
    "method",
    "conditions",
    "runs",
    "regression",
    "deviation",
    "residuals",
    "coefficients",
    "budget",
    "diagnosis",
    "decision",
    "limits",
    "files",
)


def sections_of(source: Source) -> tuple[Section, ...]:
    """Return the sections of all pages that have something to say on `source`, in the order of `PAGES`."""
    sections = (importlib.import_module(f"calib.report.pages.{name}").section(source) for name in PAGES)
    return tuple(section for section in sections if section is not None)
