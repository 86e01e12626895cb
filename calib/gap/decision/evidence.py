"""What a diagnosis is decided on: the situation, the search and the held-out trials, with whitened contributions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.campaign.model import Campaign
from calib.gap.decision.held_out import HeldOut
from calib.gap.decision.trials import Trial
from calib.gap.effects.calibration import DIRECTIONS, NAMES
from calib.gap.effects.effect import Effect
from calib.gap.effects.encoder import Blunder
from calib.gap.effects.reference import TurnedReference
from calib.gap.inference.fit import CALIBRATION_SD, Fitted, whitened_rows
from calib.gap.inference.linear_model import WhitenedSystem
from calib.gap.inference.local_search import SearchResult
from calib.gap.inference.noise import Noise
from calib.gap.inference.recalibration import Recalibration
from calib.gap.localise.result import GapLocation
from calib.gap.observations.arrays import Observations
from calib.gap.predict import Path, residuals
from calib.types import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Situation:
    """What was driven, blunders corrected."""

    campaign: Campaign
    observations: Observations
    notes: tuple[str, ...] = ()  #: what had to be assumed
    faults: tuple[Blunder | TurnedReference, ...] = ()  #: blunders of encoders and reference mounting, corrected
    as_counted: FloatArray | None = None  #: the gap with the counts as they were, shape (n_units, n_channels)


@dataclass(frozen=True, eq=False)
class Evidence:
    """What the stages before the decision have measured."""

    situation: Situation
    judged_against: str  #: model, simulator or file that gives the simulated motion
    nominal: Path  #: the model alone
    noise: Noise  #: covariance of each observation
    effects: Mapping[str, Effect]  #: the library, by id
    search: SearchResult  #: sets of effects and their probabilities
    recalibration: Recalibration  #: calibration parameters that are off beside the most probable set
    held_out: HeldOut  #: the gap before and after on held-out runs
    trials: tuple[Trial, ...]  #: the correction on routes, speeds, loads, directions and sessions held out in turn
    where: GapLocation  #: where the gap lies
    #: the runs driven followed by runs to come, on which the corrections of confounded effects are compared
    journeys: Observations | None = None

    @property
    def observations(self) -> Observations:
        """Observations and steps."""
        return self.nominal.s

    @property
    def fitted(self) -> Fitted:
        """The most probable hypothesis, a recalibration free beside it."""
        return self.search.fitted

    @cached_property
    def calibration(self) -> tuple[str, ...]:
        """Calibration parameters that are off, of those that the library holds."""
        return tuple(name for name in self._recalibrated if name in self.effects)

    @property
    def _recalibrated(self) -> tuple[str, ...]:
        """The most probable set of calibration parameters; not the empty one where no effect is named."""
        likeliest = self.recalibration.likeliest
        return likeliest if likeliest or self.search.effects else self.recalibration.needed

    @property
    def denied(self) -> bool:
        """Whether a calibration parameter is off that is excluded from the library: a cause outside the library."""
        return len(self.calibration) < len(self._recalibrated)

    @property
    def named(self) -> tuple[str, ...]:
        """Effects of the most probable hypothesis, and calibration parameters that are off."""
        return (*self.search.effects, *self.calibration)

    @cached_property
    def system(self) -> WhitenedSystem:
        """The whitened system about the path of the most probable hypothesis."""
        offered = [form for forms in self.search.forms.values() for form in forms]
        return WhitenedSystem(self.fitted.path, self.nominal, self.noise, offered)

    @cached_property
    def per_unit(self) -> FloatArray:
        """What a relative change of each calibration parameter does, whitened, shape (n_rows, 4)."""
        return np.asarray(self.system.calibration / CALIBRATION_SD)

    def calibration_contribution(self, names: Sequence[str]) -> FloatArray:
        """Return what calibration parameters do at their fitted sizes, whitened, shape (n_rows,)."""
        numbers = [NAMES.index(name) for name in names]
        return np.asarray(self.per_unit @ DIRECTIONS[numbers].T @ self.recalibration.values[numbers])

    @cached_property
    def explained_share(self) -> tuple[float, float]:
        """Share of the gap above the noise level that the most probable hypothesis explains, and its uncertainty."""
        before = whitened_rows(self.nominal, self.noise, residuals(self.nominal, self.nominal)[:, :, None])[:, 0]
        excess = max(float(before @ before) - len(before), 1.0)
        share = float(np.clip(1.0 - max(self.fitted.chi_square - len(before), 0.0) / excess, 0.0, 1.0))
        # noise alone scatters as chi-square does
        return share, float(np.sqrt(2.0 * len(before)) / excess)
