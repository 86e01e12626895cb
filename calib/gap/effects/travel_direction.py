"""The same floor driven out and back gives different radii."""

from __future__ import annotations

import numpy as np

from calib.arrays import FloatArray
from calib.gap.effects.effect import Effect, Family, Form, Observations, Parameter, Push, varies


class TravelDirection(Effect):
    """dr / r = d sigma for both wheels, sigma +1 out and -1 back."""

    id = "travel_direction"
    title = "a difference between driving out and back"
    implausible = "a sloping floor, or a start mark that differs"
    family = Family.DIRECTION
    needs = "runs out and back"
    separates = "the vehicle turned by 180 degrees on the same lane"
    shifts = ("radius_scale",)

    def forms(self, observations: Observations) -> list[Form]:
        """Return two forms, unlike in runs of neither direction; none where all runs go one way."""
        sigma = observations.heading_sign
        if not varies(sigma):
            return []
        labelled = np.isin(observations.labels["direction"], ("out", "back"))
        parameter = Parameter("relative", "1", typical=1e-3, largest=5e-3)

        def form(label: str, way: FloatArray, tries: int) -> Form:
            return Form(self.id, label, (parameter,), lambda _: [Push(left=way, right=way)], tries=tries)

        if labelled.all():
            return [form("", sigma, 1)]
        along = form("along the corridor alone", np.where(labelled, sigma, 0.0), 2)
        return [along, form("other routes as out", sigma, 2)]
