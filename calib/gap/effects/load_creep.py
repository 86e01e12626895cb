"""The radii give way slowly under a load, and come back slowly when it is taken off."""

from __future__ import annotations

from typing import Final

import numpy as np

from calib.arrays import FloatArray
from calib.gap.effects.effect import Centre, Effect, Family, Form, Observations, Parameter, Push, varies
from calib.gap.effects.scales import softness

TIMES_MIN: Final = (3.0, 10.0, 30.0, 90.0)


class LoadCreep(Effect):
    """dr_i = -c_i F_i (1 - exp(-t / tau)), t since the load was put on, each wheel its own c."""

    id = "load_creep"
    title = "wheel bands that creep under the load"
    implausible = "the load itself, or a temperature that rose meanwhile"
    family = Family.LOAD
    of_rear_wheels = True
    needs = "minutes_under_load that vary"
    separates = "the same load after 0, 10 and 60 minutes, put on and taken off"
    shifts = ("radius_scale", "unequal_radii")

    def forms(self, observations: Observations) -> list[Form]:
        """Return forms by time constant and by the load that creeps; none where the times under load do not vary.

        The load that creeps is the whole wheel load, its part above the unladen load, or (where the order of the
        loads makes a difference) the change since the load before: then a band that was unloaded recovers as slowly.
        """
        minutes = observations.number("minutes_under_load")
        left, right = observations.number("load_left_N"), observations.number("load_right_N")
        if not varies(minutes, 0.5) or not (np.isfinite(left).all() and np.isfinite(right).all()):
            return []
        # the middle of the run stands for the run: a tau of minutes hardly moves within it
        t = minutes + 0.5 * np.nan_to_num(observations.total(np.nan_to_num(observations.duration_s))) / 60.0
        radius = 0.5 * (observations.model.radius_left_m + observations.model.radius_right_m) * softness(observations)
        unladen = observations.vehicle.unladen_load_N
        parameters = tuple(
            Parameter(name, "m/N", typical=1.5e-6 * radius, largest=2e-5 * radius, sign=1)
            for name in ("creep_left", "creep_right")
        )
        # the load before it, from which the band creeps to the present one; its own load the vehicle always bears
        before: dict[str, tuple[FloatArray, FloatArray] | None] = {"whole load": None}
        if varies(left, 5.0) or varies(right, 5.0):
            before["load above the unladen"] = None
            loads = (_before(left, right, unladen), _before(right, left, unladen))
            if np.ptp(loads[0]) > 5.0 or np.ptp(loads[1]) > 5.0:
                before["change of load"] = loads

        def form(name: str, tau: float, centre: Centre | None) -> Form:
            nought = 0.0 if centre is None else centre.mean
            gone = np.exp(-t / tau)
            pushes = []
            for number, (load, radius_m) in enumerate(
                ((left, observations.radius_left_m), (right, observations.radius_right_m))
            ):
                loads = before[name]
                old = np.zeros(len(observations)) if loads is None else loads[number] - nought
                now = load - nought
                pushes.append(-(now - (now - old) * gone) / radius_m)
            per_left, per_right = pushes
            return Form(
                self.id,
                f"{name}, time constant {tau:g} min",
                parameters,
                lambda _: [Push(left=per_left), Push(right=per_right)],
                settings={"tau_min": tau},
                tries=len(before) * len(TIMES_MIN),
                centre=centre,
                about=None if centre is None else lambda elsewhere: form(name, tau, elsewhere),
            )

        centre = Centre(unladen)
        return [form(name, tau, None if name == "whole load" else centre) for name in before for tau in TIMES_MIN]


def _before(load: FloatArray, other: FloatArray, first: float) -> FloatArray:
    """Return the load of the wheel before the present payload was put on, shape (n_units,), in the order driven."""
    new = np.concatenate(([True], (np.abs(np.diff(load)) > 5.0) | (np.abs(np.diff(other)) > 5.0)))
    block = np.cumsum(new) - 1
    of_block = load[new]
    return np.asarray(np.concatenate(([first], of_block[:-1]))[block])
