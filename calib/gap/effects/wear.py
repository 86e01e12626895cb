"""The radii wear away."""

from __future__ import annotations

import numpy as np

from calib.arrays import FloatArray
from calib.gap.effects.effect import Centre, Effect, Family, Form, Observations, Parameter, Push, varies
from calib.gap.effects.shapes import sessions


class Wear(Effect):
    """dr_i / r_i = w_i times the km driven in the campaign, or the number of the session; each wheel its own w < 0."""

    id = "wear"
    title = "wheels that wear"
    implausible = "temperature, or something else that drifted over the campaign"
    family = Family.DRIFT
    columns = ("travelled_km",)
    needs = "travelled_km, or two sessions"
    separates = "a reference run repeated over many kilometres"
    shifts = ("radius_scale", "unequal_radii")

    def forms(self, observations: Observations) -> list[Form]:
        """Return a form per km and, with two sessions and more, one per session."""
        measures: list[tuple[str, str, FloatArray, float, float]] = []
        km = observations.number("travelled_km")
        if varies(km, 1e-3):
            measures.append(("per km", "1/km", km, 1e-5, 1e-4))
        session = sessions(observations)
        names, first, of = np.unique(session, return_index=True, return_inverse=True)
        if len(names) > 1:
            rank = np.argsort(np.argsort(first))
            measures.append(("per session", "1/session", rank[of].astype(np.float64), 1e-4, 1e-3))

        def form(
            label: str, unit: str, driven: FloatArray, typical: float, largest: float, centre: Centre | None = None
        ) -> Form:
            parameters = tuple(Parameter(f"rate_{side}", unit, typical, largest, sign=-1) for side in ("left", "right"))
            centre = centre or Centre.of(driven)
            grows = centre.deviations(driven)
            return Form(
                self.id,
                label,
                parameters,
                lambda _: [Push(left=grows), Push(right=grows)],
                tries=len(measures),
                centre=centre,
                about=lambda elsewhere: form(label, unit, driven, typical, largest, elsewhere),
            )

        return [form(*measure) for measure in measures]
