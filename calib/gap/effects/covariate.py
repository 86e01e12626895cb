"""Any further numeric column of the run table, as a candidate of its own."""

from __future__ import annotations

from typing import Final

import numpy as np

from calib.arrays import FloatArray
from calib.campaign.model import NUMERIC_COLUMNS
from calib.gap.data.observations import Observations
from calib.gap.effects.effect import Effect, Form, Parameter, varies
from calib.gap.predict.path import Push

__all__ = ["PREFIX", "Covariate", "covariate_columns", "covariate_effects"]

PREFIX: Final = "covariate:"
_OWN: Final = frozenset({*NUMERIC_COLUMNS, "travelled_km"})


class Covariate(Effect):
    """A column acts on both radii, on one radius, or turns the vehicle by so much a metre.

    The column enters standardised, (value - mean) / standard deviation, so sizes are per standard deviation.

    Parameters
    ----------
    column : str
        Name of the column.
    """

    # an instance's own, unlike the class attributes of the other effects
    id: str  # type: ignore[misc]
    title: str  # type: ignore[misc]
    implausible = "something else that changed with this column"
    shifts = ("radius_scale", "unequal_radii")

    def __init__(self, column: str) -> None:
        self.column = column
        self.id = PREFIX + column
        self.title = f"an influence of the column {column}"

    def forms(self, s: Observations) -> list[Form]:
        """Return four forms; none where the column has gaps or does not vary."""
        values = s.number(self.column)
        if not varies(values):
            return []
        spread = float(np.std(values))
        if spread <= 1e-12 * float(np.max(np.abs(values))):
            return []
        standard = (values - float(np.mean(values))) / spread
        radius = Parameter("relative_per_sd", "1", typical=1e-3, largest=2e-2)
        yaw = Parameter("yaw_per_sd", "rad/m", typical=1e-3, largest=2e-2)
        along: FloatArray = standard[s.unit] * s.path_m
        made = [
            ("both radii", radius, Push(left=standard, right=standard)),
            ("left radius", radius, Push(left=standard)),
            ("right radius", radius, Push(right=standard)),
            ("yaw per metre", yaw, Push(heading_rad=along)),
        ]
        settings = {"mean": float(np.mean(values)), "standard_deviation": spread}
        return [
            Form(self.id, label, (parameter,), lambda _, push=push: [push], settings=dict(settings), tries=len(made))  # type: ignore[misc]
            for label, parameter, push in made
        ]


def covariate_columns(s: Observations) -> tuple[str, ...]:
    """Return the further numeric columns of a campaign, in its own order."""
    return tuple(name for name in s.numbers if name not in _OWN)


def covariate_effects(s: Observations) -> list[Effect]:
    """Return an effect for each further numeric column."""
    return [Covariate(column) for column in covariate_columns(s)]
