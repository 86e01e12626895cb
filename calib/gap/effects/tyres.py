"""Tyres of a steered vehicle that slip: along the way with the driving force, sideways in turns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.gap.effects.effect import Centre, Effect, Family, Form, Observations, Parameter, Perturbation
from calib.gap.effects.steering import excess, front_travel_m, has_front, rate_per_s
from calib.types import FloatArray


class DriveSlip(Effect):
    """The front wheel counts a share s = F_x / C more than it travels; only the front channels see it.

    A constant share looks the same as a front radius that is off, and is named so.

    The driving force is mass times acceleration (when it speeds up, or also, reversed, when the front wheel brakes) and
    rolling resistance, in proportion to the weight; the stiffness C is constant or in proportion to the front load.
    """

    id = "drive_slip"
    title = "slip of the driven wheel"
    implausible = "the front wheel's radius"
    family = Family.STEERING
    needs = "the front wheel in the log"
    separates = "several accelerations"

    def forms(self, observations: Observations) -> list[Form]:
        """Return forms by the force that slips; none without a front wheel in the log."""
        if not has_front(observations).any():
            return []
        # in the sense of rolling
        acceleration = rate_per_s(observations, np.abs(observations.speed_mps), 2)
        speeding = np.maximum(acceleration, 0.0)
        front = front_travel_m(observations)
        # a driven wheel turns too much, never too little; a share common to all runs may be the radius, off either way
        weight_varies = float(np.ptp(_over_mean(observations.weight_N))) > 1e-9
        per_acceleration = Parameter("slip_per_mps2", "s2/m", typical=1e-2, largest=1e-1, sign=1)
        common = Parameter("slip_rolling", "1", typical=3e-3, largest=5e-2)
        rolling = replace(common, sign=1) if weight_varies else common
        # a run from rest to rest gains and loses the same by acceleration and braking
        gains = bool((np.abs(observations.total(front * speeding)) > 1e-4).any())
        forces = _forces_N(observations)
        # label, the force (None where the load does nothing), the parts that correlate with it, their parameters
        slips: list[tuple[str, FloatArray | None, list[Perturbation], tuple[Parameter, ...]]] = []

        # of the steps only this is kept by the forms
        with_speeding, with_acceleration, with_way = (
            _front_excess(observations, travel) for travel in (front * speeding, front * acceleration, front)
        )
        both = (per_acceleration, rolling)
        # where the driven wheel drives the odometry, a share in all runs alike is its radius: an effect of its own
        share_shows = weight_varies or not observations.by_front
        for name, force in forces.items():
            if gains:
                slips.append((f"{name}, speeding up", force, [with_speeding], (per_acceleration,)))
            if gains and share_shows:
                slips.append((f"{name}, speeding up and rolling", force, [with_speeding, with_way], both))
            wide = Centre(0.0, float(np.mean(force))).deviations(force)[observations.unit]
            if (np.abs(observations.total(front * acceleration * wide)) > 1e-2).any():
                slips.append((f"{name}, speeding up, braking and rolling", force, [with_acceleration, with_way], both))
            if share_shows:
                slips.append((f"{name}, rolling", force, [with_way], (rolling,)))
        if weight_varies and not observations.by_front:
            slips.append(("a constant share, or the front wheel's radius", None, [with_way], (common,)))

        def form(
            label: str,
            force: FloatArray | None,
            parts: list[Perturbation],
            parameters: tuple[Parameter, ...],
            centre: Centre | None = None,
        ) -> Form:
            perturbations = parts
            if force is not None:
                centre = centre or Centre(0.0, float(np.mean(force)))
                perturbations = [_shared(observations, part, centre.deviations(force)) for part in parts]
            return Form(
                self.id,
                label,
                parameters,
                lambda _: perturbations,
                tries=len(slips),
                centre=centre,
                about=None if centre is None else lambda elsewhere: form(label, force, parts, parameters, elsewhere),
            )

        return [form(*slip) for slip in slips]


class Understeer(Effect):
    """Front tyres slip more than rear ones: curvature tan(delta) / (L (1 + K v^2)), so e_theta ~ -K v^2 theta."""

    id = "understeer"
    title = "turns that widen with speed (understeer)"
    implausible = "a steering angle of wrong scale"
    family = Family.STEERING
    needs = "the front wheel in the log, turned at several speeds"
    separates = "the same steering angle at two speeds"

    def forms(self, observations: Observations) -> list[Form]:
        """Return the single form; none without a front wheel in the log, or where nothing turns at a known speed."""
        turn = front_travel_m(observations) * observations.steer_sin / observations.vehicle.wheelbase_m
        over = turn * observations.speed_mps**2
        if not has_front(observations).any() or not (np.abs(observations.total(over)) > 1e-4).any():
            return []
        # a hundredth wider at 1 m/s; front wheels of 0.2 push straight on at 3 m/s
        parameter = Parameter("per_speed_squared", "s2/m2", typical=1e-2, largest=2e-1)
        perturbations = [excess(observations, np.zeros_like(over), over)]
        return [Form(self.id, "", (parameter,), lambda _: perturbations)]


def _front_excess(observations: Observations, travel_m: FloatArray) -> Perturbation:
    """Return the perturbation by excess travel of the front wheel, shape (n_steps,), along its steered direction."""
    turn = travel_m * observations.steer_sin / observations.vehicle.wheelbase_m
    return excess(observations, travel_m * observations.steer_cos, turn)


def _forces_N(observations: Observations) -> dict[str, FloatArray]:
    """Return what the slip may depend on, each (n_obs,): the weight and, where it differs, that over the front load."""
    forces = {"by the force": observations.weight_N}
    front_N = observations.weight_N - observations.number("load_left_N") - observations.number("load_right_N")
    over_front = observations.weight_N / np.maximum(front_N, 0.05 * observations.weight_N)
    if np.isfinite(over_front).all() and np.ptp(_over_mean(over_front) / _over_mean(observations.weight_N)) > 0.02:
        forces["by the force over the front load"] = over_front
    return forces


def _shared(observations: Observations, perturbation: Perturbation, share: FloatArray) -> Perturbation:
    """Return a perturbation times a share of each observation, shape (n_obs,)."""
    if perturbation.reading is not None:
        return Perturbation(reading=perturbation.reading * share[:, None])
    assert perturbation.along_m is not None
    assert perturbation.heading_rad is not None
    wide = share[observations.unit]
    return Perturbation(along_m=perturbation.along_m * wide, heading_rad=perturbation.heading_rad * wide)


def _over_mean(values: FloatArray) -> FloatArray:
    return values / np.mean(values)
