"""Radii that follow the load, and loads that were misreported."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from calib.gap.effects.effect import Centre, Effect, Family, Form, Observations, Parameter, Path, Perturbation, varies
from calib.gap.effects.quantities import reach, softness
from calib.types import BoolArray, FloatArray
from calib.units import GRAVITY_MPS2
from calib.vehicle import wheel_loads_N

#: relative slope where neither the model nor the hypothesis has any
NOMINAL_PER_N: Final = 1e-5


def slope_parameters(observations: Observations) -> tuple[Parameter, ...]:
    """Return the slopes of the left and right radius against load in m/N, as an effect's parameters.

    0.1 to 1.5 % per kN on a wheel of 0.1 m is 1e-7 to 1.5e-6 m/N; more on lighter vehicles.
    """
    radius = 0.5 * (observations.model.radius_left_m + observations.model.radius_right_m) * softness(observations)
    names = ("slope_left", "slope_right")
    return tuple(Parameter(name, "m/N", typical=1e-5 * radius, largest=6e-5 * radius) for name in names)


def radius_slopes_m_per_N(path: Path, use: BoolArray | None = None) -> tuple[float, float]:
    """Return the slopes of the left and right radius against load.

    Those of the model; where it has none, those that the hypothesis gives the radii of the observations `use`, shape
    (n_obs,); where there are none either, `NOMINAL_PER_N` times the radius (more on
    lighter vehicles). With a nominal slope only the product
    of slope and misreported load means anything.
    """
    observations = path.s
    model, nominal_per_N = observations.model, NOMINAL_PER_N * softness(observations)
    if model.slope_left_m_per_N != 0.0 or model.slope_right_m_per_N != 0.0:
        return model.slope_left_m_per_N, model.slope_right_m_per_N
    keep = np.ones(len(observations), dtype=bool) if use is None else use
    slopes = []
    for rolled, load, radius in zip(
        path.rolling_radii_m.T,
        (observations.number("load_left_N"), observations.number("load_right_N")),
        (model.radius_left_m, model.radius_right_m),
        strict=True,
    ):
        good = keep & np.isfinite(rolled) & np.isfinite(load)
        slope = 0.0
        if good.sum() > 1 and np.ptp(load[good]) > 20.0:
            over = load[good] - load[good].mean()
            slope = float(over @ rolled[good] / (over @ over))
        slopes.append(slope if abs(slope) > 0.1 * nominal_per_N * radius else nominal_per_N * radius)
    return slopes[0], slopes[1]


def payload_load_N(observations: Observations) -> tuple[FloatArray, FloatArray]:
    """Return what the reported payload adds to the left and right wheel, each shape (n_obs,) (Eqs 1 and 2)."""
    payload = np.nan_to_num(observations.number("payload_kg"))
    x, y = observations.number("payload_x_m"), observations.number("payload_y_m")
    x, y = np.where(np.isnan(x), observations.vehicle.cog_x_m, x), np.nan_to_num(y)
    _, left, right = wheel_loads_N(observations.vehicle, payload, x, y)
    _, none_left, none_right = wheel_loads_N(observations.vehicle, 0.0, 0.0, 0.0)
    return left - none_left, right - none_right


class LoadRadius(Effect):
    """dr_i = c_i (F_i - F_0), each wheel its own c and either sign: e_s ~ S dF, e_theta ~ S (F_R - F_L) / b."""

    id = "load_radius"
    title = "wheel radii that follow the load"
    implausible = "misreported payloads, or a wheel that has come loose from its rim"
    family = Family.LOAD
    of_rear_wheels = True
    needs = "two payloads or places of it, with distances or end poses"
    separates = "two loads and more, some of them off the middle"
    is_load_law = True
    carries_law_slope = True
    shifts = ("radius_scale", "unequal_radii")

    def forms(self, observations: Observations) -> list[Form]:
        """Return the linear law, one slope a wheel; none where the loads do not vary."""
        left, right = observations.number("load_left_N"), observations.number("load_right_N")
        if not (varies(left, 5.0) or varies(right, 5.0)):
            return []
        reference = observations.model.reference_load_N
        per_left, per_right = (
            (left - reference) / observations.radius_left_m,
            (right - reference) / observations.radius_right_m,
        )
        return [
            Form(
                self.id,
                "",
                slope_parameters(observations),
                lambda _: [Perturbation(left=per_left), Perturbation(right=per_right)],
            )
        ]


LOAD_EXPONENTS: Final = (0.5, 0.7, 0.85, 2.0)


class LoadRadiusNonlinear(Effect):
    """dr_i = c_i F_0 [(F_i / F_0)^p - 1] / p: no change at the reference load F_0, slope c_i there, for any p."""

    id = "load_radius_nonlinear"
    title = "wheel radii that follow the load by a curved law"
    implausible = "misreported payloads, or a wheel that has come loose from its rim"
    family = Family.LOAD
    of_rear_wheels = True
    needs = "three payloads, with distances or end poses"
    separates = "three loads and more, far apart"
    is_load_law = True
    shifts = ("radius_scale", "unequal_radii")

    def forms(self, observations: Observations) -> list[Form]:
        """Return one form an exponent, one slope a wheel; none where the loads do not vary."""
        left, right = observations.number("load_left_N"), observations.number("load_right_N")
        if not (varies(left, 5.0) or varies(right, 5.0)):
            return []
        reference = observations.model.reference_load_N
        if reference <= 1.0:
            reference = max(1.0, float(np.mean(0.5 * (left + right))))
        slopes = slope_parameters(observations)

        def form(exponent: float, centre: Centre) -> Form:
            reference = centre.mean

            def shape(load: FloatArray) -> FloatArray:
                ratio = np.maximum(load, 0.0) / reference
                return np.asarray(reference * (ratio**exponent - 1.0) / exponent)

            per_left, per_right = shape(left) / observations.radius_left_m, shape(right) / observations.radius_right_m
            label = "quadratic" if exponent == 2.0 else f"exponent {exponent:g}"
            return Form(
                self.id,
                label,
                slopes,
                lambda _: [Perturbation(left=per_left), Perturbation(right=per_right)],
                settings={"exponent": exponent},
                tries=len(LOAD_EXPONENTS),
                centre=centre,
                about=lambda elsewhere: form(exponent, elsewhere),
            )

        return [form(exponent, Centre(reference)) for exponent in LOAD_EXPONENTS]


CREEP_TIMES_MIN: Final = (3.0, 10.0, 30.0, 90.0)


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
            loads = (_load_before_N(left, right, unladen), _load_before_N(right, left, unladen))
            if np.ptp(loads[0]) > 5.0 or np.ptp(loads[1]) > 5.0:
                before["change of load"] = loads

        def form(name: str, tau: float, centre: Centre | None) -> Form:
            zero = 0.0 if centre is None else centre.mean
            gone = np.exp(-t / tau)
            perturbations = []
            for number, (load, radius_m) in enumerate(
                ((left, observations.radius_left_m), (right, observations.radius_right_m))
            ):
                loads = before[name]
                old = np.zeros(len(observations)) if loads is None else loads[number] - zero
                now = load - zero
                perturbations.append(-(now - (now - old) * gone) / radius_m)
            per_left, per_right = perturbations
            return Form(
                self.id,
                f"{name}, time constant {tau:g} min",
                parameters,
                lambda _: [Perturbation(left=per_left), Perturbation(right=per_right)],
                settings={"tau_min": tau},
                tries=len(before) * len(CREEP_TIMES_MIN),
                centre=centre,
                about=None if centre is None else lambda elsewhere: form(name, tau, elsewhere),
            )

        centre = Centre(unladen)
        return [form(name, tau, None if name == "whole load" else centre) for name in before for tau in CREEP_TIMES_MIN]


def _load_before_N(load: FloatArray, other: FloatArray, first: float) -> FloatArray:
    """Return the load of the wheel before the present payload was put on, shape (n_obs,), in the order driven."""
    new = np.concatenate(([True], (np.abs(np.diff(load)) > 5.0) | (np.abs(np.diff(other)) > 5.0)))
    block = np.cumsum(new) - 1
    of_block = load[new]
    return np.asarray(np.concatenate(([first], of_block[:-1]))[block])


MAX_PAYLOADS: Final = 6


class PayloadMass(Effect):
    """The payload of one label, or of all, is wrong by a share, and with it the loads: dr_i = c_i share dF_i.

    The slopes c_i are the model's, else those of the hypothesis as the other payloads show them, else a nominal 1 % per
    kN (then the share is only as good as that slope). All labels at once (a scale that reads too low) are asked of only
    where the model has slopes: in a model without them no payload does anything, and slopes that are off look alike.
    """

    id = "payload_mass"
    title = "a misreported payload mass"
    implausible = "radii that follow the load by a curved law"
    family = Family.LOAD
    needs = "payloads, with distances or end poses"
    separates = "a third payload, weighed"
    shifts = ("radius_scale", "unequal_radii")

    def forms(self, observations: Observations) -> list[Form]:
        """Return a form for each of the (at most six) payloads driven most, and one for all; none without payloads."""
        payload = np.nan_to_num(observations.number("payload_kg"))
        values, counts = np.unique(np.round(payload, 3), return_counts=True)
        laden = values > 0.0
        values, counts = values[laden], counts[laden]
        values = np.sort(values[np.argsort(-counts, kind="stable")[:MAX_PAYLOADS]])
        added_left, added_right = payload_load_N(observations)
        parameter = Parameter("share", "1", typical=0.15, largest=0.5)
        # one label may be mistyped; a scale that is off by more than a third is found out
        of_all = Parameter("share", "1", typical=0.1, largest=0.3)

        has_slopes = observations.model.slope_left_m_per_N != 0.0 or observations.model.slope_right_m_per_N != 0.0
        together = len(values) > 1 and has_slopes
        tries = len(values) + int(together)

        def form(label: str, mine: BoolArray, share: Parameter, settings: dict[str, float]) -> Form:

            def perturbations(path: Path) -> list[Perturbation]:
                left, right = radius_slopes_m_per_N(path, ~mine)
                return [
                    Perturbation(
                        left=np.where(mine, left * added_left, 0.0) / observations.radius_left_m,
                        right=np.where(mine, right * added_right, 0.0) / observations.radius_right_m,
                    )
                ]

            return Form(self.id, label, (share,), perturbations, settings, tries=tries)

        single = [
            form(f"payload of {value:g} kg", np.abs(payload - value) < 1e-3, parameter, {"payload_kg": float(value)})
            for value in values
        ]
        return [*single, form("all payloads", payload > 0.0, of_all, {})] if together else single


class PayloadPosition(Effect):
    """All payloads stand dy further left or dx further ahead: the loads shift, and with them the radii.

    Left: dF = +-m g dy / b, e_theta ~ S 2 c W dy / b^2. Ahead: dF = -m g dx / 2L on each rear wheel and +m g dx / L on
    the front wheel, so e_s and e_F go opposite ways. The slope is the mean of both wheels' (see `load_slopes`).
    """

    id = "payload_position"
    title = "a misreported payload position"
    implausible = "rear wheels of unequal radius, or loads that were misread"
    family = Family.LOAD
    needs = "payloads, with headings or the front wheel"
    separates = "unladen runs beside laden ones"
    shifts = ("radius_scale", "unequal_radii")

    def forms(self, observations: Observations) -> list[Form]:
        """Return a form sideways and one lengthways; none without payloads."""
        weight_N = GRAVITY_MPS2 * np.nan_to_num(observations.number("payload_kg"))
        if not (weight_N > 0.0).any():
            return []
        wheelbase, track = observations.vehicle.wheelbase_m, observations.model.track_m
        front_m = np.where(
            observations.usable[:, 4],
            np.nan_to_num(observations.total(np.nan_to_num(observations.front_roll_rad) * observations.steer_cos)),
            0.0,
        )
        by_steering = (
            observations.total(np.nan_to_num(observations.front_roll_rad) * observations.steer_sin) / wheelbase
        )
        by_steering = np.where(observations.usable[:, 5], by_steering, 0.0)

        def slope(path: Path) -> float:
            return 0.5 * sum(radius_slopes_m_per_N(path))

        def sideways(path: Path) -> list[Perturbation]:
            change_m = slope(path) * weight_N / track
            return [
                Perturbation(left=change_m / observations.radius_left_m, right=-change_m / observations.radius_right_m)
            ]

        def ahead(path: Path) -> list[Perturbation]:
            change_m = slope(path) * weight_N / wheelbase
            left, right = -0.5 * change_m / observations.radius_left_m, -0.5 * change_m / observations.radius_right_m
            # the front wheel travels more for its counts, which the front channels subtract
            front, steering = -front_m * change_m, -by_steering * change_m
            return [
                replace(Perturbation.on_readings(observations, front=front, steering=steering), left=left, right=right)
            ]

        def parameter(name: str) -> tuple[Parameter, ...]:
            return (Parameter(name, "m", typical=3e-2 * reach(observations), largest=2.5e-1 * reach(observations)),)

        return [
            Form(self.id, "sideways", parameter("further_left"), sideways, tries=2),
            Form(self.id, "lengthways", parameter("further_ahead"), ahead, tries=2),
        ]
