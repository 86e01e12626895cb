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
    """A verdict and its arrays; figures whose arrays are missing are left out."""

    #: the answer
    verdict: Verdict
    #: the paper's headline beside it, where load is the cause
    headline: PaperHeadline | None = None
    #: name and unit (``m`` or ``rad``) of each channel, shape (n_channels,)
    channels: tuple[tuple[str, str], ...] = ()
    #: measured minus simulated, by the model alone and by the model with the named cause, on held-out units; NaN where
    #: a unit lacks the channel, shape (n_units, n_channels)
    before: FloatArray | None = None
    after: FloatArray | None = None
    #: standard deviation that repeats cannot explain away; NaN as above, shape (n_units, n_channels)
    floor: FloatArray | None = None
    #: route or kind of each unit, for colours, shape (n_units,)
    group: StrArray | None = None
    #: candidates that the gap may depend on, by name with unit suffix, shape (n_units,)
    covariates: Mapping[str, FloatArray] = field(default_factory=dict)
    #: path of each unit on the floor plan, x and y, shape (n_samples, 2)
    paths_m: tuple[FloatArray, ...] = ()
    #: measured minus simulated end position on the floor plan, shape (n_units, 2)
    offset_m: FloatArray | None = None

    @staticmethod
    def of(verdict: Verdict) -> GapFindings:
        """Return a verdict alone, without the arrays of its figures."""
        return GapFindings(verdict, headline=headline(verdict))

    def to_dict(self) -> dict[str, Any]:
        """Return the verdict as ``calib diagnose --json`` writes it."""
        return self.verdict.to_dict() | {"headline": None if self.headline is None else asdict(self.headline)}
