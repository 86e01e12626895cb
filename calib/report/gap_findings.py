"""What the report shows of a diagnosis: the verdict as plain values, and the arrays behind its figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from calib.arrays import FloatArray, StrArray
from calib.gap.verdict.paper_headline import PaperHeadline, headline
from calib.gap.verdict.result import Verdict


@dataclass(frozen=True, slots=True, eq=False)
class GapFindings:
    """A verdict and its arrays; figures whose arrays are missing are left out.

    Parameters
    ----------
    verdict : Verdict
        The answer.
    headline : PaperHeadline or None
        The paper's headline beside it, where load is the cause.
    channels : tuple of (str, str)
        Name and unit (``m`` or ``rad``) of each channel, shape (n_channels,).
    before, after : array of float, shape (n_units, n_channels), or None
        Measured minus simulated, by the model alone and by the model with the named cause, on held-out units; NaN where
        a unit lacks the channel.
    floor : array of float, shape (n_units, n_channels), or None
        Standard deviation that repeats cannot explain away; NaN as above.
    group : array of str, shape (n_units,), or None
        Route or kind of each unit, for colours.
    covariates : mapping of str to array of float, shape (n_units,)
        Candidates that the gap may depend on, by name with unit suffix.
    paths_m : tuple of array of float, shape (n_samples, 2)
        Path of each unit on the floor plan, x and y.
    offset_m : array of float, shape (n_units, 2), or None
        Measured minus simulated end position on the floor plan.
    """

    verdict: Verdict
    headline: PaperHeadline | None = None
    channels: tuple[tuple[str, str], ...] = ()
    before: FloatArray | None = None
    after: FloatArray | None = None
    floor: FloatArray | None = None
    group: StrArray | None = None
    covariates: Mapping[str, FloatArray] = field(default_factory=dict)
    paths_m: tuple[FloatArray, ...] = ()
    offset_m: FloatArray | None = None

    @staticmethod
    def of(verdict: Verdict) -> GapFindings:
        """Return a verdict alone, without the arrays of its figures."""
        return GapFindings(verdict, headline=headline(verdict))

    def to_dict(self) -> dict[str, Any]:
        """Return the verdict as ``calib diagnose --json`` writes it."""
        return self.verdict.to_dict() | {"headline": None if self.headline is None else asdict(self.headline)}
