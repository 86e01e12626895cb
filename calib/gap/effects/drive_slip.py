"""The driven front wheel slips."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.arrays import FloatArray
from calib.gap.effects.effect import Centre, Effect, Family, Form, Observations, Parameter, Push
from calib.gap.effects.steering import excess, front_travel_m, has_front


class DriveSlip(Effect):
    """The front wheel counts a share s = F_x / C more than it travels; only the front channels see it.

    A constant share looks the same as a front radius that is off, and is named so.

    The driving force is mass times acceleration (when it speeds up, or also, reversed, when the front wheel brakes) and
    rolling resistance, which goes with the weight; the stiffness C is constant or goes with the front wheel's load.
    """

    id = "drive_slip"
    title = "slip of the driven front wheel"
    implausible = "the front wheel's radius"
    family = Family.STEERING
    needs = "the front wheel in the log"
    separates = "several accelerations"

    def forms(self, observations: Observations) -> list[Form]:
        """Return forms by the force that slips; none without a front wheel in the log."""
        if not has_front(observations).any():
            return []
        acceleration = _acceleration_mps2(observations)
        speeding = np.maximum(acceleration, 0.0)
        front, ones = front_travel_m(observations), np.ones(len(observations.unit))
        cosine, sine, wheelbase = observations.steer_cos, observations.steer_sin, observations.vehicle.wheelbase_m
        # a driven wheel turns too much, never too little; a share common to all runs may be the radius, off either way
        weight_varies = float(np.ptp(_over_mean(observations.weight_N))) > 1e-9
        per_acceleration = Parameter("slip_per_mps2", "s2/m", typical=1e-2, largest=1e-1, sign=1)
        common = Parameter("slip_rolling", "1", typical=3e-3, largest=5e-2)
        rolling = replace(common, sign=1) if weight_varies else common
        # a run from rest to rest gains and loses the same by acceleration and braking
        gains = bool((np.abs(observations.total(front * speeding)) > 1e-4).any())
        forces = _forces_N(observations)
        # label, the force (None where the load does nothing), the parts that go with it, their parameters
        slips: list[tuple[str, FloatArray | None, list[Push], tuple[Parameter, ...]]] = []

        def slipped(part: FloatArray) -> Push:
            way = front * part
            return excess(observations, way * cosine, way * sine / wheelbase)

        # of the steps only this is kept by the forms
        with_speeding, with_acceleration, with_way = slipped(speeding), slipped(acceleration), slipped(ones)
        for name, force in forces.items():
            if gains:
                slips.append((f"{name}, speeding up", force, [with_speeding], (per_acceleration,)))
                both = (per_acceleration, rolling)
                slips.append((f"{name}, speeding up and rolling", force, [with_speeding, with_way], both))
            wide = Centre(0.0, float(np.mean(force))).deviations(force)[observations.unit]
            if (np.abs(observations.total(front * acceleration * wide)) > 1e-2).any():
                both = (per_acceleration, rolling)
                slips.append((f"{name}, speeding up, braking and rolling", force, [with_acceleration, with_way], both))
            slips.append((f"{name}, rolling", force, [with_way], (rolling,)))
        if weight_varies:
            slips.append(("a constant share, or the front wheel's radius", None, [with_way], (common,)))

        def form(
            label: str,
            force: FloatArray | None,
            parts: list[Push],
            parameters: tuple[Parameter, ...],
            centre: Centre | None = None,
        ) -> Form:
            pushes = parts
            if force is not None:
                centre = centre or Centre(0.0, float(np.mean(force)))
                pushes = [_shared(observations, push, centre.deviations(force)) for push in parts]
            return Form(
                self.id,
                label,
                parameters,
                lambda _: pushes,
                tries=len(slips),
                centre=centre,
                about=None if centre is None else lambda elsewhere: form(label, force, parts, parameters, elsewhere),
            )

        return [form(*slip) for slip in slips]


def _forces_N(observations: Observations) -> dict[str, FloatArray]:
    """Return what the slip may go with, each (n_units,): the weight and, where it differs, that over the front load."""
    forces = {"by the force": observations.weight_N}
    front_N = observations.weight_N - observations.number("load_left_N") - observations.number("load_right_N")
    over_front = observations.weight_N / np.maximum(front_N, 0.05 * observations.weight_N)
    if np.isfinite(over_front).all() and np.ptp(_over_mean(over_front) / _over_mean(observations.weight_N)) > 0.02:
        forces["by the force over the front load"] = over_front
    return forces


def _shared(observations: Observations, push: Push, share: FloatArray) -> Push:
    """Return a push times a share of each unit, shape (n_units,)."""
    if push.reading is not None:
        return Push(reading=push.reading * share[:, None])
    assert push.along_m is not None
    assert push.heading_rad is not None
    wide = share[observations.unit]
    return Push(along_m=push.along_m * wide, heading_rad=push.heading_rad * wide)


def _over_mean(values: FloatArray) -> FloatArray:
    return values / np.mean(values)


def _acceleration_mps2(observations: Observations) -> FloatArray:
    """Return the acceleration in the sense of rolling in each step, over two steps each way, shape (n_steps,)."""
    speed = np.abs(observations.speed_mps)
    index = np.arange(len(speed))
    before = np.maximum(index - 2, observations.starts[observations.unit])
    after = np.minimum(index + 2, observations.starts[observations.unit + 1] - 1)
    middle = observations.time_s - 0.5 * observations.duration_s
    with np.errstate(divide="ignore", invalid="ignore"):
        rate = (speed[after] - speed[before]) / (middle[after] - middle[before])
    return np.where(np.isfinite(rate), rate, 0.0)
