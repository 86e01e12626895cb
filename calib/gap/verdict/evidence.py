"""All that a verdict is decided on, in one object."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from calib.arrays import FloatArray
from calib.gap.data.observations import Observations
from calib.gap.effects.calibration import DIRECTIONS, NAMES
from calib.gap.effects.effect import Effect, Form
from calib.gap.effects.encoder_gross import GrossFault
from calib.gap.effects.turned_reference import TurnedReference
from calib.gap.evidence.climb import Settings
from calib.gap.evidence.fit import Fitted
from calib.gap.evidence.marginal import CALIBRATION_SD
from calib.gap.evidence.noise import Noise
from calib.gap.evidence.recalibration import Recalibration
from calib.gap.evidence.search import Search
from calib.gap.evidence.whitened import WhitenedSystem
from calib.gap.predict.path import Path
from calib.gap.verdict.closure import HeldOut
from calib.gap.verdict.outcome import Detectable
from calib.gap.verdict.result import BY_MODEL
from calib.gap.verdict.transfer import Trial
from calib.gap.where.result import Where


@dataclass(frozen=True, eq=False)
class Evidence:
    """What the stages before the decision have measured.

    Parameters
    ----------
    campaign : str
        Its name.
    simulated : bool
        Whether its data were made by a program.
    nominal : Path
        The model alone (a gross fault put right).
    noise : Noise
        Covariance of each unit.
    effects : mapping of str to Effect
        The library, by id.
    search : Search
        Sets of effects and their probabilities.
    recalibration : Recalibration
        Which calibration parameters are off beside the best hypothesis' effects.
    held_out : HeldOut
        The gap before and after on runs left out, for the best hypothesis.
    trials : tuple of Trial
        What the correction does on kinds, speeds, loads, directions and sessions left out in turn.
    where : Where
        Where the gap lies.
    undetectable : tuple of Detectable
        Effects that these runs could not have shown.
    faults : tuple of GrossFault or TurnedReference
        Gross faults of the encoders and of the reference's mounting, found and put right before the search.
    settings : Settings
        What the search took for granted.
    notes : tuple of str
        What had to be assumed on the way.
    judged_against : str
        What the gap was judged against.
    journeys : Observations, optional
        The runs driven and, after them, runs to come, on which the corrections of causes that cannot be told apart are
        compared.
    declared : object
        The ``[[effects]]`` tables of the campaign.
    """

    campaign: str
    simulated: bool
    nominal: Path
    noise: Noise
    effects: Mapping[str, Effect]
    search: Search
    recalibration: Recalibration
    held_out: HeldOut
    trials: tuple[Trial, ...] = ()
    where: Where = field(default_factory=Where)
    undetectable: tuple[Detectable, ...] = ()
    faults: tuple[GrossFault | TurnedReference, ...] = ()
    settings: Settings = field(default_factory=Settings)
    notes: tuple[str, ...] = ()
    judged_against: str = BY_MODEL
    journeys: Observations | None = None
    declared: object = ()

    @property
    def observations(self) -> Observations:
        """Units and steps."""
        return self.nominal.s

    @property
    def fitted(self) -> Fitted:
        """The best hypothesis, a recalibration free beside it."""
        return self.search.fitted

    @cached_property
    def calibration(self) -> tuple[str, ...]:
        """Calibration parameters that are off, of those that the library holds."""
        return tuple(name for name in self._recalibrated if name in self.effects)

    @property
    def _recalibrated(self) -> tuple[str, ...]:
        """The likeliest set of calibration parameters; not the empty one where nothing else says what is off."""
        likeliest = self.recalibration.likeliest
        return likeliest if likeliest or self.search.effects else self.recalibration.needed

    @property
    def denied(self) -> bool:
        """Whether a calibration parameter is off that the library was denied: a cause outside the library."""
        return len(self.calibration) < len(self._recalibrated)

    @property
    def named(self) -> tuple[str, ...]:
        """Effects of the best hypothesis, and calibration parameters that are off."""
        return (*self.search.effects, *self.calibration)

    @cached_property
    def system(self) -> WhitenedSystem:
        """The whitened system about the best hypothesis' path."""
        offered = [form for forms in self.search.forms.values() for form in forms]
        return WhitenedSystem(self.fitted.path, self.nominal, self.noise, offered)

    @cached_property
    def per_unit(self) -> FloatArray:
        """What a relative change of each calibration parameter does, whitened, shape (n_rows, 4)."""
        columns: FloatArray = self.system.calibration / CALIBRATION_SD
        return columns

    def contribution(self, form: Form, theta: FloatArray) -> FloatArray:
        """Return what a form does at a size (n_parameters,), whitened, shape (n_rows,)."""
        whitened: FloatArray = self.system.columns(form) @ (theta / form.typical)
        return whitened

    def calibration_contribution(self, names: Sequence[str]) -> FloatArray:
        """Return what calibration parameters do at their fitted sizes, whitened, shape (n_rows,)."""
        whitened: FloatArray = np.zeros(len(self.system.gap))
        for name in names:
            k = NAMES.index(name)
            whitened += self.per_unit @ DIRECTIONS[k] * self.recalibration.values[k]
        return whitened
