"""What an effect is: a named cause, its parameters, and what it does to wheels, track, path or readings."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from calib.arrays import FloatArray
from calib.gap.data.observations import Observations
from calib.gap.predict.path import Path, Push

__all__ = ["Effect", "Form", "Parameter", "centred", "varies"]


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter of an effect.

    Parameters
    ----------
    name, unit : str
        As printed; ``1`` for a plain number.
    typical : float
        Order of magnitude that the field's literature and arithmetic give; the scale of its prior.
    largest : float
        Beyond this size the effect as named is physically implausible.
    sign : int
        1 where only positive values have a meaning, 0 where either sign does.
    """

    name: str
    unit: str
    typical: float
    largest: float
    sign: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Form:
    """One form of an effect on one campaign: its parameters and how each of them pushes.

    Parameters
    ----------
    effect : str
        Id of the effect.
    label : str
        Which form, for example ``exponent 0.7``; empty where there is one only.
    parameters : tuple of Parameter
        The parameters that the data choose.
    pushes : callable
        Path -> one `Push` a parameter, per unit of the parameter.
    settings : mapping of str to float
        Quantities of the form that are not fitted linearly (an exponent, a time constant, a place).
    tries : int
        How many forms were searched over; the evidence pays for the search.
    """

    effect: str
    label: str
    parameters: tuple[Parameter, ...]
    pushes: Callable[[Path], Sequence[Push]]
    settings: dict[str, float] = field(default_factory=dict)
    tries: int = 1

    @property
    def typical(self) -> FloatArray:
        """Typical size of each parameter in its unit, shape (n_parameters,)."""
        return np.array([p.typical for p in self.parameters])


class Effect(ABC):
    """A candidate cause. A new effect is a subclass in a file of its own and one line in the registry.

    Attributes
    ----------
    id : str
        Name in verdicts.
    title : str
        What it is, for people, in a few words that fit into "the gap is explained by ...".
    implausible : str
        What to suspect where the fitted size is beyond what is plausible; a clause.
    calibration : bool
        True for the three that a plain recalibration absorbs.
    shifts : tuple of str
        Calibration effects that a zero point of this effect other than assumed looks like (a temperature counted from
        20 degrees instead of the mean shifts the radii); a shift no larger than the effect counts as part of it.
    """

    id: ClassVar[str]
    title: ClassVar[str]
    implausible: ClassVar[str] = "another cause that looks alike"
    calibration: ClassVar[bool] = False
    shifts: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def forms(self, s: Observations) -> list[Form]:
        """Return the effect's forms on this campaign; empty where the campaign cannot show it at all."""


def varies(values: FloatArray, by: float = 0.0) -> bool:
    """Return whether a covariate is known everywhere and takes more than one value (further apart than `by`)."""
    return bool(np.isfinite(values).all() and np.ptp(values) > by)


def centred(values: FloatArray) -> FloatArray:
    """Return the values less their mean, NaN as 0, same shape."""
    mean = np.nanmean(values) if np.isfinite(values).any() else 0.0
    return np.asarray(np.nan_to_num(values - mean))
