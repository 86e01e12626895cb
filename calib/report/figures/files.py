"""Figures as files: each as PNG, SVG and PDF, and none where one of them exists already."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Final

from matplotlib.figure import Figure

from calib.errors import BadInputError
from calib.files import refuse_existing
from calib.folders import write_files
from calib.progress import Progress, silent, stepped
from calib.report.figures.style import render_all

FORMS: Final = ("png", "svg", "pdf")


def figure_paths(folder: Path | None, names: Iterable[str]) -> list[Path]:
    """Return the files that figures of these names are written to; none without a folder."""
    return [] if folder is None else [folder / f"{name}.{form}" for name in names for form in FORMS]


def write_figures(
    figures: Mapping[str, Figure], folder: Path, *, force: bool = False, progress: Progress = silent
) -> list[Path]:
    """Write figures in every format of `FORMS`; the same figure gives the same bytes.

    `figures`: by the name of their files, without suffix; `folder`: made where it is missing. Raises BadInputError
    where a file exists and `force` is False; nothing is then written.
    """
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise BadInputError(f"{folder}: found a file; expected a folder for the figures; choose another path")
    refuse_existing(figure_paths(folder, figures), force=force)
    drawn: dict[str, bytes] = {}
    for name, figure in stepped(figures.items(), progress, "figures"):
        drawn |= {f"{name}.{form}": data for form, data in render_all(figure, FORMS).items()}
    return write_files(folder, drawn, force=force) if drawn else []
