"""Each session has radii of its own, of no known cause."""

from __future__ import annotations

import numpy as np

from calib.gap.effects.effect import Effect, Family, Form, Observations, Parameter, Push
from calib.gap.effects.shapes import sessions


class SessionStep(Effect):
    """A relative step of each radius in every session but the first, counted from the campaign's mean."""

    id = "session_step"
    title = "wheel radii that step from session to session"
    implausible = "wheels, encoders or set-up changed between sessions"
    family = Family.DRIFT
    needs = "two sessions"
    separates = "one run repeated at the beginning of each session"
    per_session = True
    shifts = ("radius_scale", "unequal_radii")

    def forms(self, observations: Observations) -> list[Form]:
        """Return forms with a step a session but the first, one for both wheels or one each; none with one session."""
        session = sessions(observations)
        names, first = np.unique(session, return_index=True)
        names = names[np.argsort(first)]
        if len(names) < 2:
            return []
        inside = [(session == name).astype(np.float64) for name in names[1:]]
        steps = [share - share.mean() for share in inside]

        def form(label: str, pushes: list[Push], sides: tuple[str, ...]) -> Form:
            parameters = tuple(
                Parameter(f"{side}_{name}", "1", typical=5e-4, largest=1e-2) for name in names[1:] for side in sides
            )
            return Form(self.id, label, parameters, lambda _: pushes, tries=2)

        alike = [Push(left=step, right=step) for step in steps]
        each = [push for step in steps for push in (Push(left=step), Push(right=step))]
        return [form("both wheels alike", alike, ("both",)), form("each wheel its own", each, ("left", "right"))]
