"""Scrub, slip, understeer and load transfer in turns."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from math import inf
from typing import Final

import numpy as np

from calib.gap import Perturbation, total_perturbation
from calib.gap.effects import (
    Centre,
    Effect,
    Family,
    Form,
    Offer,
    Parameter,
    Perturbations,
    always,
    on_both,
    quantities,
    varies,
)
from calib.gap.effects.load import slope_parameters
from calib.gap.effects.reference import off_course
from calib.gap.effects.steering import excess, front_travel_m, front_turn_rad, has_front, rate_per_s
from calib.gap.observations import POSE, Observations
from calib.gap.predict import Path
from calib.types import GRAVITY_MPS2, FloatArray

#: what typical slip makes of a run is not seen below
LEAST_SLIP_M: Final = 1e-4


class CurveLoadTransfer(Effect):
    """dF = W v^2 kappa h / (g b) from the inner to the outer rear wheel, dr = c dF: e_theta ~ W v^2 theta.

    The front wheel stands on the centre line and takes no part of the roll moment.
    """

    id = "curve_load_transfer"
    title = "load that moves to the outer wheel in fast turns"
    implausible = "a wrong track width, or side slip"
    family = Family.TURNING
    of_rear_wheels = True
    needs = "turns at known speeds"
    separates = "the same turn at two speeds and two loads"

    def forms(self, observations: Observations) -> list[Form]:
        """See `Effect`."""
        if not quantities.shows_curves(observations) or not observations.speed_mps.any():
            return []

        def perturbations(path: Path) -> list[Perturbation]:
            s = path.s
            # rolling backward, the same turn pulls to the other side
            pull_mps2 = s.speed_mps * np.abs(s.speed_mps) * quantities.curvature_per_m(s)
            moved_N = s.weight_N[s.unit] * pull_mps2 * s.vehicle.cog_z_m / (GRAVITY_MPS2 * s.model.track_m)
            return [Perturbation(left=-moved_N / s.radius_left_m[s.unit], right=moved_N / s.radius_right_m[s.unit])]

        return [Form(self.id, "", slope_parameters(observations, "slope"), perturbations, by_parts=True)]


class LoadDependentTrack(Effect):
    """b (1 + k (F - F_0)), F the load of both rear wheels, F_0 twice the reference load of a wheel."""

    id = "load_dependent_track"
    title = "a track that follows the load"
    implausible = "load transfer in turns, or misreported payloads"
    family = Family.TURNING
    of_rear_wheels = True
    needs = "turns under two loads"
    separates = "the same slow turn under two loads"
    shifts = ("track_width",)

    def forms(self, observations: Observations) -> list[Form]:
        """See `Effect`."""
        axle = observations.wheel_loads_N.sum(axis=0)
        if not varies(axle, 2.0 * quantities.same_load_N(observations), observations) or not quantities.shows_curves(
            observations
        ):
            return []
        believed_N = 2.0 * observations.model.reference_load_N
        over = observations.loads_N.sum(axis=0) - believed_N
        # up to 1 % for 1000 N
        soft = quantities.softness(observations)
        parameter = Parameter("per_N", "1/N", typical=5e-6 * soft, largest=5e-5 * soft)
        # the load of the track as believed: none, as drawn, to the permissible one; not known where none is stated
        within = (-believed_N, 2.0 * observations.vehicle.max_wheel_load_N - believed_N) if believed_N else (-inf, inf)
        return [Form(self.id, "", (parameter,), lambda _: [Perturbation(track=over)], zero_within=within)]


class SideSlip(Effect):
    """A slip angle -K v^2 kappa, as tyres have, or -K v kappa, as what slides does: by the lateral acceleration too."""

    id = "side_slip"
    title = "side slip of the rear axle in fast turns"
    implausible = "load transfer, or a reference point off the rear axle"
    family = Family.TURNING
    needs = "turns at known speeds, with end positions"
    separates = "turns at two speeds, the lateral position measured"

    def forms(self, observations: Observations) -> list[Form]:
        """See `Effect`."""
        if (
            not quantities.shows_curves(observations)
            or not observations.speed_mps.any()
            or not observations.usable[:, POSE].any()
        ):
            return []

        def slips(path: Path, power: int) -> list[Perturbation]:
            # v^2 kappa ds is v |v| times the turn: it changes sides when the vehicle rolls backward
            turned_rad = np.sign(path.s.path_m) * path.s.turn_rad
            aside = Perturbation(lateral_m=-(np.abs(path.s.speed_mps) ** power) * turned_rad)
            return [total_perturbation(path.s, [aside, off_course(path, path.s.course_error[:, :, 5 - power])])]

        angle = Parameter("slip_per_acceleration", "s2/m", typical=2e-3, largest=5e-2, sign=1)
        offers = [
            ("slip angle", angle, 2),
            ("sideways speed", replace(angle, name="speed_per_acceleration", unit="s"), 1),
        ]
        return self.offer([(label, (one,), partial(slips, power=k)) for label, one, k in offers], by_parts=True)


class CurveScrub(Effect):
    """b (1 + k |kappa|), so e_theta = -k |kappa| theta."""

    id = "curve_scrub"
    title = "scrubbing in turns that widens the track"
    implausible = "a wrong track width, or load transfer in fast turns"
    family = Family.TURNING
    of_rear_wheels = True
    needs = "turns of several curvatures"
    separates = "turns of several radii at one speed"
    shifts = ("track_width",)
    zero_known = True

    def forms(self, observations: Observations) -> list[Form]:
        """Return a form that grows with the curvature and, beside turns on the spot, one of these; none without turns.

        Tyres that twist on the spot scrub where those that roll do not; it counts as a turn about a rear wheel.
        """
        # up to 3 % in a turn of the vehicle's own length; tracks of real robots narrow in turns, too
        size = quantities.reach(observations)
        parameters = (Parameter("widening", "m", typical=1.5e-2 * size, largest=1.5e-1 * size),)

        def of_spots(path: Path) -> list[Perturbation]:
            return [Perturbation(track=quantities.on_the_spot(path.s, path.steps.turn_rad, path.steps.ds_m))]

        offers: list[Offer] = []
        if quantities.shows_curves(observations):
            offers.append(
                ("", parameters, lambda path: [Perturbation(track=np.abs(quantities.path_curvature_per_m(path)))])
            )
        if quantities.turns_on_the_spot_too(observations):
            offers.append(("on the spot", parameters, of_spots))
        return self.offer(offers, by_parts=True)


class WheelSlip(Effect):
    """Two driven wheels count a share s = k a more than the vehicle travels: e_s = -k times the integral of a ds.

    a is the rate of the speed: braking, they count less. From rest to rest both cancel, unless only speeding up slips.
    """

    id = "wheel_slip"
    title = "driven wheels that slip when the speed changes"
    implausible = "a reference that reads late, or an offset of the reference"
    family = Family.SPEED
    of_rear_wheels = True
    needs = "two driven wheels, and runs that begin or end on the move, or several accelerations"
    separates = "the same way at a gentle and at a hard acceleration"

    def forms(self, observations: Observations) -> list[Form]:
        """Return forms in proportion to a and to its square, for both and for speeding up alone."""
        if observations.vehicle.drive not in ("differential", "skid"):
            return []
        # a tenth at 1 m/s2 is a tyre at a tenth of its grip
        linear = Parameter("slip_per_mps2", "s2/m", typical=1e-2, largest=1e-1, sign=1)
        squared = replace(linear, name="slip_per_square", unit="s4/m2")
        laws = [
            (f"{label}{of_power}", parameter, least_mps2, power)
            for label, least_mps2 in (("speeding up and braking", -np.inf), ("speeding up", 0.0))
            for of_power, parameter, power in (("", linear, 1), (", ~ a^2", squared, 2))
        ]
        # a run from rest to rest gains and loses the same
        shown = [(label, one, law) for label, one, *law in laws if _most_lost_m(observations, one, *law) > LEAST_SLIP_M]

        def slips(path: Path, law: Sequence[float]) -> list[Perturbation]:
            return [on_both(-_slip(path.s, *law))]

        return self.offer([(label, (one,), partial(slips, law=law)) for label, one, law in shown], by_parts=True)


def _slip(observations: Observations, least_mps2: float, power: float) -> FloatArray:
    rate = np.maximum(rate_per_s(observations, np.abs(observations.speed_mps), 2), least_mps2)
    return np.sign(rate) * np.abs(rate) ** power


def _most_lost_m(observations: Observations, parameter: Parameter, least_mps2: float, power: float) -> float:

    def lost_m(part: Observations) -> FloatArray:
        return part.total(np.abs(part.path_m) * _slip(part, least_mps2, power))

    return parameter.typical * float(np.abs(observations.of_parts(lost_m)).max(initial=0.0))


class DriveSlip(Effect):
    """The front wheel counts a share s = F_x / C more than it travels; only the front channels see it.

    A constant share is named as a front radius. The driving force is mass times acceleration (speeding up, or also
    braking) and rolling resistance, by the weight; the stiffness C is constant or in proportion to the front load.
    """

    id = "drive_slip"
    title = "slip of the driven wheel"
    implausible = "the front wheel's radius"
    family = Family.STEERING
    needs = "the front wheel in the log"
    separates = "several accelerations"

    def forms(self, observations: Observations) -> list[Form]:
        """See `Effect`."""
        if not has_front(observations).any():
            return []
        acceleration = rate_per_s(observations, np.abs(observations.speed_mps), 2)
        speeding = np.maximum(acceleration, 0.0)
        front = front_travel_m(observations)
        # a driven wheel turns too much; a share common to all runs may be the radius
        weight_varies = float(np.ptp(_over_mean(observations.weight_N))) > 1e-9
        per_acceleration = Parameter("slip_per_mps2", "s2/m", typical=1e-2, largest=1e-1, sign=1)
        common = Parameter("slip_rolling", "1", typical=3e-3, largest=5e-2)
        rolling = replace(common, sign=1) if weight_varies else common
        with_speeding, with_acceleration, with_way = (
            _front_excess(observations, travel) for travel in (front * speeding, front * acceleration, front)
        )
        both = (per_acceleration, rolling)
        # from rest to rest both cancel
        gains = bool((np.abs(observations.total(front * speeding)) > 1e-4).any())
        # where it drives the odometry, a share alike in all runs, or by the load, is its radius
        share_shows = not observations.by_front
        slips: list[tuple[str, FloatArray | None, list[Perturbation], tuple[Parameter, ...]]] = []
        for name, force in _forces_N(observations).items():
            if gains:
                slips.append((f"{name}, speeding up", force, [with_speeding], (per_acceleration,)))
            if gains and share_shows:
                slips.append((f"{name}, speeding up and rolling", force, [with_speeding, with_way], both))
            wide = Centre(0.0, float(np.mean(force))).deviations(force)[observations.unit]
            if (np.abs(observations.total(front * acceleration * wide)) > 1e-2).any():
                slips.append((f"{name}, speeding up and braking", force, [with_acceleration], (per_acceleration,)))
                if share_shows:
                    label = f"{name}, speeding up, braking and rolling"
                    slips.append((label, force, [with_acceleration, with_way], both))
            if weight_varies and share_shows:
                slips.append((f"{name}, rolling", force, [with_way], (rolling,)))
        if share_shows:
            slips.append(("a constant share, or the front wheel's radius", None, [with_way], (common,)))

        def form(
            label: str, force: FloatArray | None, parts: list[Perturbation], parameters: tuple[Parameter, ...]
        ) -> Form:
            if force is None:
                return Form(self.id, label, parameters, always(*parts), tries=len(slips))

            def about(centre: Centre) -> Perturbations:
                return always(*(_shared(observations, part, centre.deviations(force)) for part in parts))

            centre = Centre(0.0, float(np.mean(force)))
            return Form(self.id, label, parameters, about(centre), tries=len(slips), centre=centre, about=about)

        return [form(*slip) for slip in slips]


class Understeer(Effect):
    """Front tyres slip more than rear ones: curvature tan(delta) / (L (1 + K v^2)), so e_theta ~ -K v^2 theta.

    A front wheel that counts turns less by K v^2 cos(delta)^2, and goes further by K v^2 sin(delta)^2.
    """

    id = "understeer"
    title = "turns that widen with speed (understeer)"
    implausible = "a steering angle of wrong scale"
    family = Family.STEERING
    needs = "the front wheel in the log, turned at several speeds"
    separates = "the same steering angle at two speeds"

    def forms(self, observations: Observations) -> list[Form]:
        """See `Effect`."""

        def square(part: Observations) -> FloatArray:
            return np.where(has_front(part)[part.unit], part.speed_mps**2, 0.0)

        turned = observations.total(front_turn_rad(observations) * square(observations))
        if not has_front(observations).any() or not (np.abs(turned) > 1e-4).any():
            return []

        def perturbations(path: Path) -> list[Perturbation]:
            # the steering says K v^2 times the turn driven too much, at any size
            turn = square(path.s) * path.steps.turn_rad
            if path.s.by_shaft:
                return [excess(path.s, np.zeros_like(turn), turn)]
            ahead = -square(path.s) * path.steps.ds_m * path.s.steer_sin**2
            return [excess(path.s, ahead, turn * path.s.steer_cos**2)]

        # a hundredth wider at 1 m/s; front wheels of 0.2 push straight on at 3 m/s
        parameter = Parameter("per_speed_squared", "s2/m2", typical=1e-2, largest=2e-1)
        return [Form(self.id, "", (parameter,), perturbations, by_parts=True)]


def _front_excess(observations: Observations, travel_m: FloatArray) -> Perturbation:
    turn = travel_m * observations.steer_sin / observations.vehicle.wheelbase_m
    return excess(observations, travel_m * observations.steer_cos, turn)


def _forces_N(observations: Observations) -> dict[str, FloatArray]:
    forces = {"by the force": observations.weight_N}
    front_N = observations.weight_N - observations.wheel_loads_N.sum(axis=0)
    over_front = observations.weight_N / np.maximum(front_N, 0.05 * observations.weight_N)
    if np.isfinite(over_front).all() and np.ptp(_over_mean(over_front) / _over_mean(observations.weight_N)) > 0.02:
        forces["by the force over the front load"] = over_front
    return forces


def _shared(observations: Observations, perturbation: Perturbation, share: FloatArray) -> Perturbation:
    wide = share[observations.unit]
    by_field = {"reading": share[:, None], "along_m": wide, "heading_rad": wide}
    parts = {name: (getattr(perturbation, name), by) for name, by in by_field.items()}
    return Perturbation(**{name: part * by for name, (part, by) in parts.items() if part is not None})


def _over_mean(values: FloatArray) -> FloatArray:
    return values / np.mean(values)
