"""Any further numeric column of the run table, as a candidate of its own."""

from __future__ import annotations

from typing import Final

import numpy as np

from calib.campaign.model import NUMERIC_COLUMNS
from calib.gap.effects.effect import Centre, Effect, Family, Form, Observations, Parameter, Path, Push, varies

PREFIX: Final = "covariate:"
ACTS_ON: Final = ("both radii", "left radius", "right radius", "yaw per metre")


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
    family = Family.COVARIATE
    needs = "a column of numbers in the run table that varies"
    separates = "runs that vary this column alone"
    shifts = ("radius_scale", "unequal_radii")

    def __init__(self, column: str) -> None:
        self.column = column
        self.id = PREFIX + column
        self.title = f"an influence of the column {column}"

    def forms(self, observations: Observations) -> list[Form]:
        """Return four forms; none where the column has gaps or does not vary."""
        values = observations.number(self.column)
        if not varies(values):
            return []
        spread = float(np.std(values))
        if spread <= 1e-12 * float(np.max(np.abs(values))):
            return []
        centre = Centre(float(np.mean(values)), spread)
        return [self._form(observations, centre, label) for label in ACTS_ON]

    def _form(self, observations: Observations, centre: Centre, label: str) -> Form:
        standard = centre.deviations(observations.number(self.column))
        turns, left, right = label == "yaw per metre", label != "right radius", label != "left radius"
        name, unit = ("yaw_per_sd", "rad/m") if turns else ("relative_per_sd", "1")
        parameter = Parameter(name, unit, typical=1e-3, largest=2e-2)

        def pushes(path: Path) -> list[Push]:
            here = path.s.here(standard)
            if turns:
                return [Push(heading_rad=here[path.s.unit] * path.s.path_m)]
            return [Push(left=here if left else None, right=here if right else None)]

        return Form(
            self.id,
            label,
            (parameter,),
            pushes,
            settings={"mean": centre.mean, "standard_deviation": centre.spread},
            tries=len(ACTS_ON),
            centre=centre,
            about=lambda elsewhere: self._form(observations, elsewhere, label),
            by_parts=True,
        )


def covariate_columns(observations: Observations) -> tuple[str, ...]:
    """Return the further numeric columns of a campaign, in its own order."""
    return tuple(name for name in observations.numbers if name not in NUMERIC_COLUMNS)


def column_of(effect: str) -> str | None:
    """Return the column of a covariate's id, None for any other id."""
    return effect.removeprefix(PREFIX) if effect.startswith(PREFIX) else None


def covariate_effects(observations: Observations) -> list[Covariate]:
    """Return an effect for each further numeric column."""
    return [Covariate(column) for column in covariate_columns(observations)]
