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
    stays = "what steps from session to session says nothing of the next one; calibrate in each"
    shifts = ("radius_scale", "unequal_radii")

    def forms(self, observations: Observations) -> list[Form]:
        """Return the single form, a left and a right step a session but the first; none with one session."""
        session = sessions(observations)
        names, first = np.unique(session, return_index=True)
        names = names[np.argsort(first)]
        if len(names) < 2:
            return []
        parameters: list[Parameter] = []
        pushes: list[Push] = []
        for name in names[1:]:
            inside = (session == name).astype(np.float64)
            step = inside - inside.mean()
            parameters += [Parameter(f"{side}_{name}", "1", typical=5e-4, largest=1e-2) for side in ("left", "right")]
            pushes += [Push(left=step), Push(right=step)]
        return [Form(self.id, "", tuple(parameters), lambda _: pushes)]
