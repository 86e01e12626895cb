"""What comes out of a diagnosis: the verdict, and the arrays behind it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from calib.gap.data.observations import Observations
from calib.gap.effects.effect import Effect
from calib.gap.evidence.fit import Fitted
from calib.gap.evidence.noise import Noise
from calib.gap.evidence.search import Search
from calib.gap.predict.path import Path
from calib.gap.verdict.closure import HeldOut
from calib.gap.verdict.result import Verdict


@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis:
    """A verdict with the arrays behind it."""

    verdict: Verdict  #: the answer
    observations: Observations  #: units and steps; the counts put right where they had a gross fault
    noise: Noise  #: covariance of each unit
    nominal: Path  #: the model alone
    fitted: Fitted  #: the hypothesis that the verdict names, the recalibration free
    held_out: HeldOut  #: residuals before and after on runs that the fit has not seen
    search: Search  #: all hypotheses tried, and the forms of the library on this campaign
    effects: tuple[Effect, ...]  #: the library that it was judged by

    def to_dict(self) -> dict[str, Any]:
        """Return the verdict as plain JSON values; see `Verdict.to_dict`."""
        return self.verdict.to_dict()
