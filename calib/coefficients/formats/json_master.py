"""The master itself as an export format: the coefficient file's JSON."""

from __future__ import annotations

from collections.abc import Sequence

from calib.coefficients.file import CoefficientFile
from calib.coefficients.loads import Artifact, LoadPair

__all__ = ["render"]


def render(file: CoefficientFile, loads: Sequence[LoadPair]) -> tuple[Artifact, ...]:
    """Return the coefficient file; it holds the whole law, so `loads` change nothing."""
    del loads
    return (Artifact("coefficients.json", file.to_bytes()),)
