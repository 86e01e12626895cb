"""Radii that drift with temperature, use, session or speed."""

from __future__ import annotations

import numpy as np

from calib.gap.effects.effect import Centre, Effect, Family, Form, Observations, Parameter, Perturbation, varies
from calib.gap.effects.quantities import driven_speed_mps, sessions
from calib.types import FloatArray


class TemperatureRadius(Effect):
    """dr / r = alpha (T - T_0) for both wheels, T_0 the campaign's mean temperature."""

    id = "temperature_radius"
    title = "wheel radii that follow the temperature"
    implausible = "wear, or something else that changed with the session"
    family = Family.DRIFT
    needs = "temperature_C that varies"
    separates = "cold and warm runs within one session"
    shifts = ("radius_scale",)

    def forms(self, observations: Observations) -> list[Form]:
        """Return the single form; none where the temperature is not known or does not vary."""
        temperature = observations.number("temperature_C")
        if not varies(temperature, 0.5):
            return []
        # 0.05 to 0.2 % per 20 K
        parameter = Parameter("alpha", "1/K", typical=5e-5, largest=3e-4)

        def form(centre: Centre) -> Form:
            over = centre.deviations(temperature)
            return Form(
                self.id, "", (parameter,), lambda _: [Perturbation(left=over, right=over)], centre=centre, about=form
            )

        return [form(Centre.of(temperature))]


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
                lambda _: [Perturbation(left=grows), Perturbation(right=grows)],
                tries=len(measures),
                centre=centre,
                about=lambda elsewhere: form(label, unit, driven, typical, largest, elsewhere),
            )

        return [form(*measure) for measure in measures]


class SessionStep(Effect):
    """A relative step of each radius in every session but the first, counted from the campaign's mean."""

    id = "session_step"
    title = "wheel radii that step from session to session"
    implausible = "wheels, encoders or set-up changed between sessions"
    family = Family.DRIFT
    needs = "two sessions"
    separates = "one run repeated at the beginning of each session"
    per_session = True
    not_transferable = "what steps from session to session says nothing of the next one; calibrate in each"
    shifts = ("radius_scale", "unequal_radii")

    def forms(self, observations: Observations) -> list[Form]:
        """Return the single form, a left and a right step a session but the first; none with one session."""
        session = sessions(observations)
        names, first = np.unique(session, return_index=True)
        names = names[np.argsort(first)]
        if len(names) < 2:
            return []
        parameters: list[Parameter] = []
        perturbations: list[Perturbation] = []
        for name in names[1:]:
            inside = (session == name).astype(np.float64)
            step = inside - inside.mean()
            parameters += [Parameter(f"{side}_{name}", "1", typical=5e-4, largest=1e-2) for side in ("left", "right")]
            perturbations += [Perturbation(left=step), Perturbation(right=step)]
        return [Form(self.id, "", tuple(parameters), lambda _: perturbations)]


class SpeedRadius(Effect):
    """dr / r = k (v - v_0) for both wheels, v_0 the campaign's mean speed; the speed of a run is its driven mean."""

    id = "speed_radius"
    title = "wheel radii that follow the speed"
    shifts = ("radius_scale",)
    implausible = "latency or lost counts (the centrifugal growth of a solid wheel is only about 6e-5 at 1 m/s)"
    family = Family.SPEED
    needs = "two speeds"
    separates = "one route at several speeds, read after the stop"

    def forms(self, observations: Observations) -> list[Form]:
        """Return the single form; none where all runs were replicated."""
        speed = driven_speed_mps(observations)
        if not varies(speed, 0.02):
            return []
        parameter = Parameter("per_mps", "s/m", typical=3e-4, largest=3e-4)

        def form(centre: Centre) -> Form:
            over = centre.deviations(speed)
            return Form(
                self.id, "", (parameter,), lambda _: [Perturbation(left=over, right=over)], centre=centre, about=form
            )

        return [form(Centre.of(speed))]
