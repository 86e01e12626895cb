"""Radii that follow the load, and loads that were misreported."""

from dataclasses import replace
from typing import Final

import numpy as np

from calib.gap import Perturbation
from calib.gap.effects import Centre, Effect, Family, Form, Parameter, Perturbations, always, varies
from calib.gap.effects.quantities import loads_vary, mean_radius_m, reach, same_load_N, softness
from calib.gap.observations import Channel, Observations
from calib.gap.predict import Path
from calib.types import GRAVITY_MPS2, BoolArray, FloatArray
from calib.vehicle import wheel_loads_N


def _sides(observations: Observations, name: str) -> tuple[str, ...]:
    return (f"{name}_mean",) if observations.by_shaft else (f"{name}_left", f"{name}_right")


def _of_wheels(observations: Observations, left: FloatArray, right: FloatArray) -> Perturbation:
    both = 0.5 * (left + right)
    return Perturbation(left=both, right=both) if observations.by_shaft else Perturbation(left=left, right=right)


def slope_parameters(observations: Observations, *names: str) -> tuple[Parameter, ...]:
    """Return slopes of a radius against load in m/N, as an effect's parameters of these names.

    0.1 to 1.5 % per kN on a wheel of 0.1 m is 1e-7 to 1.5e-6 m/N; more on lighter vehicles.
    """
    soft_m = mean_radius_m(observations) * softness(observations)
    return tuple(Parameter(name, "m/N", typical=1e-5 * soft_m, largest=6e-5 * soft_m) for name in names)


def _model_slopes(observations: Observations) -> FloatArray:
    return np.array([observations.model.slope_left_m_per_N, observations.model.slope_right_m_per_N])


def _slopes_m_per_N(path: Path, own: FloatArray) -> FloatArray:
    # the model's, else the hypothesis' own
    slopes = _model_slopes(path.s)
    if slopes.any() or path.perturbation.law_slopes is None:
        return slopes
    return own


def _shown_by(path: Path, others: BoolArray) -> FloatArray:

    def slope(rolled: FloatArray, load: FloatArray) -> float:
        good = others & np.isfinite(rolled) & np.isfinite(load)
        if good.sum() < 2 or np.ptp(load[good]) <= 4.0 * same_load_N(path.s):
            return 0.0
        over = load[good] - load[good].mean()
        return float(over @ rolled[good] / (over @ over))

    return np.array([slope(*each) for each in zip(path.rolling_radii_m.T, path.s.wheel_loads_N, strict=True)])


def _payload_load_N(observations: Observations) -> tuple[FloatArray, FloatArray]:
    payload = np.nan_to_num(observations.number("payload_kg"))
    x, y = observations.number("payload_x_m"), observations.number("payload_y_m")
    x, y = np.where(np.isnan(x), observations.vehicle.cog_x_m, x), np.nan_to_num(y)
    _, left, right = wheel_loads_N(observations.vehicle, payload, x, y)
    _, none_left, none_right = wheel_loads_N(observations.vehicle, 0.0, 0.0, 0.0)
    return left - none_left, right - none_right


class _OfLoad(Effect):
    family = Family.LOAD
    of_rear_wheels = True
    shifts = ("radius_scale", "unequal_radii")


def _on_radii(
    observations: Observations, left_m: FloatArray, right_m: FloatArray, *, is_law: bool = False
) -> Perturbations:
    loads_N = observations.loads_N
    radii_m = observations.radii_m(loads_N if loads_N.shape[1] == len(left_m) else observations.wheel_loads_N)
    left, right = np.stack([left_m, right_m]) / radii_m
    if observations.by_shaft:
        shared = _of_wheels(observations, left, right)
        return always(replace(shared, law_slopes=np.ones((len(observations), 2))) if is_law else shared)
    slopes = [np.tile(each, (len(observations), 1)) if is_law else None for each in np.eye(2)]
    return lambda _: [Perturbation(left=left, law_slopes=slopes[0]), Perturbation(right=right, law_slopes=slopes[1])]


class LoadRadius(_OfLoad):
    """dr_i = c_i (F_i - F_0), each wheel its own c and either sign: e_s ~ S dF, e_theta ~ S (F_R - F_L) / b."""

    id = "load_radius"
    title = "wheel radii that follow the load"
    implausible = "misreported payloads, or a wheel that has come loose from its rim"
    needs = "two payloads or places of it, with distances or end poses"
    separates = "two loads and more, some of them off the middle"
    zero_known = True
    is_load_law = True
    carries_law_slope = True

    def forms(self, observations: Observations) -> list[Form]:
        """See `Effect`."""
        left, right = observations.loads_N
        if not loads_vary(observations):
            return []
        reference = observations.model.reference_load_N
        slopes = slope_parameters(observations, *_sides(observations, "slope"))
        return [Form(self.id, "", slopes, _on_radii(observations, left - reference, right - reference, is_law=True))]


LOAD_EXPONENTS: Final = (0.5, 0.7, 0.85, 2.0)


class LoadRadiusNonlinear(_OfLoad):
    """dr_i = c_i F_0 [(F_i / F_0)^p - 1] / p: no change at the reference load F_0, slope c_i there, for any p."""

    id = "load_radius_nonlinear"
    title = "wheel radii that follow the load by a curved law"
    implausible = "misreported payloads, or a wheel that has come loose from its rim"
    needs = "three payloads, with distances or end poses"
    separates = "three loads and more, far apart"
    zero_known = True
    is_load_law = True

    def forms(self, observations: Observations) -> list[Form]:
        """See `Effect`."""
        loads, reference = observations.loads_N, observations.model.reference_load_N
        if not loads_vary(observations):
            return []
        centre = Centre(reference if reference > 1.0 else max(1.0, float(np.mean(loads))))
        slopes = slope_parameters(observations, *_sides(observations, "slope"))

        def form(exponent: float) -> Form:
            def about(centre: Centre) -> Perturbations:
                ratio = np.maximum(loads, 0.0) / centre.mean
                return _on_radii(observations, *(centre.mean * (ratio**exponent - 1.0) / exponent), is_law=True)

            label = "quadratic" if exponent == 2.0 else f"exponent {exponent:g}"
            settings, tries = {"exponent": exponent}, len(LOAD_EXPONENTS)
            return Form(self.id, label, slopes, about(centre), settings, tries, centre, about)

        return [form(exponent) for exponent in LOAD_EXPONENTS]


CREEP_TIMES_MIN: Final = (3.0, 10.0, 30.0, 90.0)


class LoadCreep(_OfLoad):
    """dr_i = -c_i F_i (1 - exp(-t / tau)), t since the load was put on, each wheel its own c."""

    id = "load_creep"
    title = "wheel bands that creep under the load"
    implausible = "the load itself, or a temperature that rose meanwhile"
    needs = "minutes_under_load that vary between laden runs"
    separates = "the same load after 0, 10 and 60 minutes, put on and taken off"

    def forms(self, observations: Observations) -> list[Form]:
        """Return forms by time constant and by the load that creeps.

        That is the whole wheel load, its part above the unladen load, or (where the order of the loads matters) its
        last change: an unloaded band then recovers as slowly.
        """
        minutes, now = observations.number("minutes_under_load"), observations.wheel_loads_N
        # loads that all stood alike creep as the load law says
        laden = (now > observations.vehicle.unladen_load_N + same_load_N(observations)).any(axis=0)
        stood = minutes[laden] if laden.any() else minutes
        if not np.isfinite([*minutes, *now.ravel()]).all() or not varies(stood, 0.5, observations):
            return []
        # a tau of minutes hardly moves within a run
        t = minutes + 0.5 * np.nan_to_num(observations.total(np.nan_to_num(observations.duration_s))) / 60.0
        t = np.maximum(t, 0.0)
        typical = 1.5e-6 * mean_radius_m(observations) * softness(observations)
        creep = Parameter("creep", "m/N", typical, largest=2e-5 / 1.5e-6 * typical, sign=1)
        parameters = tuple(replace(creep, name=name) for name in _sides(observations, "creep"))
        unladen = observations.vehicle.unladen_load_N
        # the load before it (2, n_obs), from which the band creeps to the present one; None for the load itself
        creeps: list[tuple[str, FloatArray | None, Centre | None]] = [("whole load", None, None)]
        if loads_vary(observations):
            creeps.append(("load above the unladen", None, Centre(unladen)))
            same_N = same_load_N(observations)
            before = np.stack([_load_before_N(each, unladen, same_N) for each in (now, now[::-1])])
            if (np.ptp(before, axis=1) > same_N).any():
                creeps.append(("change of load", before, Centre(unladen)))

        def form(name: str, before: FloatArray | None, centre: Centre | None, tau: float) -> Form:
            gone = np.exp(-t / tau)

            def about(centre: Centre) -> Perturbations:
                above = now - centre.mean
                old = np.zeros_like(now) if before is None else before - centre.mean
                return _on_radii(observations, *-(above - (above - old) * gone))

            label, tries = f"{name}, time constant {tau:g} min", len(creeps) * len(CREEP_TIMES_MIN)
            perturbations, settings = about(centre or Centre(0.0)), {"tau_min": tau}
            return Form(self.id, label, parameters, perturbations, settings, tries, centre, about if centre else None)

        return [form(*creep, tau) for creep in creeps for tau in CREEP_TIMES_MIN]


def _load_before_N(loads: FloatArray, first: float, same_N: float) -> FloatArray:
    new = np.append(True, (np.abs(np.diff(loads)) > same_N).any(axis=0))
    block = np.cumsum(new) - 1
    of_block = loads[0, new]
    return np.asarray(np.concatenate(([first], of_block[:-1]))[block])


MAX_PAYLOADS: Final = 6
LOAD_LAWS: Final = (LoadRadius.id, LoadRadiusNonlinear.id)


class _OfPayload(Effect):
    family = Family.LOAD
    shifts = ("radius_scale", "unequal_radii")
    zero_known = True


class PayloadMass(_OfPayload):
    """The payload of one label, or of all, is wrong by a share, and with it the loads: dr_i = c_i share dF_i."""

    id = "payload_mass"
    title = "a misreported payload mass"
    implausible = "radii that follow the load by a curved law"
    needs = "payloads, with distances or end poses"
    separates = "a third payload, weighed"

    def forms(self, observations: Observations) -> list[Form]:
        """See `Effect`."""
        payload = np.nan_to_num(observations.number("payload_kg"))
        values, counts = np.unique(np.round(payload[payload > 5e-4], 3), return_counts=True)
        values = np.sort(values[np.argsort(-counts, kind="stable")[:MAX_PAYLOADS]])
        added_left, added_right = _payload_load_N(observations)
        has_slopes = bool(_model_slopes(observations).any())
        together = len(values) > 1 and has_slopes

        def form(label: str, mine: BoolArray, parameter: Parameter, settings: dict[str, float]) -> Form:
            def perturbations(path: Path) -> list[Perturbation]:
                left, right = _slopes_m_per_N(path, _shown_by(path, ~mine))
                of_left = np.where(mine, left * added_left, 0.0) / observations.radius_left_m
                of_right = np.where(mine, right * added_right, 0.0) / observations.radius_right_m
                return [_of_wheels(observations, of_left, of_right)]

            through = () if has_slopes else LOAD_LAWS
            tries = len(values) + int(together)
            return Form(self.id, label, (parameter,), perturbations, settings, tries, acts_through=through)

        share = Parameter("share", "1", typical=0.15, largest=0.5)
        forms = [
            form(f"payload of {value:g} kg", np.abs(payload - value) < 1e-3, share, {"payload_kg": float(value)})
            for value in values
        ]
        if together:
            # a scale that is off by more than a third is found out
            of_all = Parameter("share", "1", typical=0.1, largest=0.3)
            forms.append(form("all payloads", payload > 0.0, of_all, {}))
        return forms


class PayloadPosition(_OfPayload):
    """All payloads stand dy further left or dx further ahead: the loads shift, and with them the radii.

    Left: dF = +-m g dy / b, e_theta ~ S 2 c W dy / b^2. Ahead: dF = -m g dx / 2L on each rear wheel and +m g dx / L on
    the front wheel, whose slope is taken as the mean of theirs.
    """

    id = "payload_position"
    title = "a misreported payload position"
    implausible = "rear wheels of unequal radius, or loads that were misread"
    needs = "payloads, with headings or the front wheel"
    separates = "unladen runs beside laden ones"

    def forms(self, observations: Observations) -> list[Form]:
        """See `Effect`."""
        weight_N = GRAVITY_MPS2 * np.nan_to_num(observations.number("payload_kg"))
        if not (weight_N > 0.0).any():
            return []
        wheelbase, track = observations.vehicle.wheelbase_m, observations.model.track_m
        has_slopes = bool(_model_slopes(observations).any())
        roll = np.nan_to_num(observations.front_roll_rad)
        rolled = np.nan_to_num(observations.total(roll * observations.steer_cos))
        turned = observations.total(roll * observations.steer_sin) / wheelbase
        front_m = np.where(observations.usable[:, Channel.FRONT], rolled, 0.0)
        by_steering = np.where(observations.usable[:, Channel.STEERING], turned, 0.0)
        radius_left, radius_right = observations.radius_left_m, observations.radius_right_m

        def changed_m(path: Path, lever_m: float) -> tuple[FloatArray, FloatArray]:
            law = path.perturbation.law_slopes
            slopes = _slopes_m_per_N(path, np.zeros(2) if law is None else law[0])
            if not has_slopes or observations.by_shaft:
                # slopes of their own would follow what the place is to explain
                slopes = np.full(2, slopes.mean())
            return slopes[0] * weight_N / lever_m, slopes[1] * weight_N / lever_m

        def sideways(path: Path) -> list[Perturbation]:
            left_m, right_m = changed_m(path, track)
            return [_of_wheels(observations, left_m / radius_left, -right_m / radius_right)]

        def ahead(path: Path) -> list[Perturbation]:
            left_m, right_m = changed_m(path, wheelbase)
            # the front wheel, of a mean slope, travels more for its counts
            change_m = 0.5 * (left_m + right_m)
            readings = Perturbation.on_readings(
                observations, front=-front_m * change_m, steering=-by_steering * change_m
            )
            return [replace(readings, left=-0.5 * left_m / radius_left, right=-0.5 * right_m / radius_right)]

        size, through = reach(observations), () if has_slopes else LOAD_LAWS
        # what stands off by more than a hand's width is seen
        left = Parameter("further_left", "m", typical=3e-2 * size, largest=1.2e-1 * size)
        offers = [("sideways", left, sideways), ("lengthways", replace(left, name="further_ahead"), ahead)]
        return [Form(self.id, label, (one,), acts, tries=2, acts_through=through) for label, one, acts in offers]
