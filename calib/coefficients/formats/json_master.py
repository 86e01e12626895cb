"""The master itself as an export format: the coefficient file's JSON."""

from __future__ import annotations

from calib.coefficients.file import CoefficientFile
from calib.coefficients.loads import Artifact, ExportOptions


def render(file: CoefficientFile, options: ExportOptions) -> tuple[Artifact, ...]:
    """Return the coefficient file; it holds the whole law, so `options` change nothing."""
    del options
    return (Artifact("coefficients.json", file.to_bytes()),)
