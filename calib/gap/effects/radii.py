"""Radii and track off by what a recalibration absorbs, or drifting; skids at stops, a path that weaves."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import compress, product
from typing import ClassVar, Final

import numpy as np

from calib.gap import Perturbation
from calib.gap.effects import (
    Centre,
    Effect,
    Family,
    Form,
    Offer,
    Parameter,
    Perturbations,
    Proportional,
    acting_on,
    always,
    varies,
)
from calib.gap.effects.quantities import (
    curvature_per_m,
    driven_speed_mps,
    numbered_sessions,
    on_the_spot,
    same_speed_mps,
    session_steps,
    standstill_mps,
)
from calib.gap.effects.steering import angle_error, has_front, rate_per_s
from calib.gap.observations import STRAIGHT_RAD, Channel, Observations
from calib.gap.predict import Path, predict
from calib.radius.path_length import whole_period_excess
from calib.types import BoolArray, FloatArray
from calib.vehicle import SKID_TRACK


class _Calibration(Effect):
    family = Family.CALIBRATION
    parameter: ClassVar[Parameter]
    acts_on: ClassVar[str]

    def forms(self, observations: Observations) -> list[Form]:
        ones, parameter = np.ones(len(observations)), self.parameter
        if self.acts_on == "track" and observations.vehicle.drive == "skid":
            parameter = replace(parameter, largest=SKID_TRACK - 1.0)
        return [Form(self.id, "", (parameter,), lambda path: [acting_on(path, self.acts_on, ones)])]


class RadiusScale(_Calibration):
    """e_s = -eps S, no heading error apart from the turn's own scale (calibration, absorbed by both radii)."""

    id = "radius_scale"
    title = "both effective radii off by the same share"
    implausible = "the encoder's counts per revolution, or a gear ratio"
    needs = "distances or end positions"
    separates = "a distance taped on the floor, against the counts and the instrument"
    hides_in = "the wheel radii"
    calibration_direction = (1.0, 1.0, 0.0, 0.0)
    acts_on = "both"
    parameter = Parameter("relative", "1", typical=3e-3, largest=3e-2)
    wrong_beyond = 0.15


class UnequalRadii(_Calibration):
    """e_theta = eps S / b and e_n = eps S^2 / 2b, with eps = (r_R - r_L) / r (Borenstein and Feng's E_d, Eq. 15)."""

    id = "unequal_radii"
    title = "rear wheels of unequal radius"
    implausible = "swapped or different encoders"
    of_rear_wheels = True
    needs = "headings or lateral positions at the end of straight runs"
    separates = "unladen runs, and squares both ways round"
    hides_in = "the ratio of the wheel radii"
    calibration_direction = (-0.5, 0.5, 0.0, 0.0)
    acts_on = "difference"
    parameter = Parameter("relative", "1", typical=2e-3, largest=2e-2)
    wrong_beyond = 0.15


class TrackWidth(_Calibration):
    """e_theta = -(db / b) theta (Eq. 16, E_b)."""

    id = "track_width"
    title = "a wrong track width"
    implausible = "the reference's scale, or scrubbing in tight turns"
    of_rear_wheels = True
    needs = "headings after turns"
    separates = "turns of several curvatures at several speeds"
    hides_in = "the track width"
    calibration_direction = (0.0, 0.0, 1.0, 0.0)
    acts_on = "track"
    parameter = Parameter("relative", "1", typical=1e-2, largest=1e-1)
    # a track may be an effective one, of two tyres that scrub or of a wide tread
    wrong_beyond = 0.3


_OWN: Final = (RadiusScale, UnequalRadii, TrackWidth)
NAMES: Final = tuple(effect.id for effect in _OWN)
#: each as a change of (left radius, right radius, track, front radius) per unit, shape (3, 4)
DIRECTIONS: Final = np.array([effect.calibration_direction for effect in _OWN])
#: relative change of (left radius, right radius, track) -> size of each, shape (3, 3)
OF_WHEELS: Final = np.linalg.inv(DIRECTIONS[:, :3].T)
#: typical size of each, shape (3,)
TYPICAL: Final = np.array([effect.parameter.typical for effect in _OWN])
HIDES_IN: Final = {effect.id: effect.hides_in for effect in _OWN}


class TemperatureRadius(Proportional):
    """dr / r = alpha (T - T_0) for both wheels, T_0 the campaign's mean temperature."""

    id = "temperature_radius"
    title = "wheel radii that follow the temperature"
    implausible = "wear, or something else that changed with the session"
    family = Family.DRIFT
    needs = "temperature_C that varies"
    separates = "cold and warm runs within one session"
    shifts = ("radius_scale",)
    # 0.05 to 0.2 % per 20 K
    parameter = Parameter("alpha", "1/K", typical=5e-5, largest=3e-4)
    varies_by = 0.5

    def quantity(self, observations: Observations) -> FloatArray:
        """See `Proportional`."""
        return observations.number("temperature_C")


class Wear(Effect):
    """dr_i / r_i = w_i times the km driven in the campaign, or the number of the session; each wheel its own w < 0."""

    id = "wear"
    title = "wheels that wear"
    implausible = "temperature, or something else that drifted over the campaign"
    family = Family.DRIFT
    columns = ("travelled_km",)
    needs = "some kilometres driven, or two sessions"
    separates = "a reference run repeated over many kilometres"
    shifts = ("radius_scale", "unequal_radii")

    def forms(self, observations: Observations) -> list[Form]:
        """See `Effect`."""
        measures: list[tuple[str, FloatArray, float]] = []
        km = observations.number("travelled_km")
        if varies(km, 1e-3, observations):
            measures.append(("km", km, 1e-5))
        number, count = numbered_sessions(observations)
        if count > 1:
            measures.append(("session", number.astype(np.float64), 1e-4))
        return [self._form(*measure, tries=len(measures)) for measure in measures]

    def _form(self, per: str, driven: FloatArray, typical: float, *, tries: int) -> Form:
        parameters = tuple(
            Parameter(f"rate_{side}", f"1/{per}", typical, 10.0 * typical, sign=-1) for side in ("left", "right")
        )

        def about(centre: Centre) -> Perturbations:
            grows = centre.deviations(driven)
            return lambda _: [Perturbation(left=grows), Perturbation(right=grows)]

        centre, end = Centre.of(driven), Centre(float(np.nanmax(driven)))
        return Form(self.id, f"per {per}", parameters, about(centre), tries=tries, centre=centre, end=end, about=about)


class SessionStep(Effect):
    """A relative step of each radius in every session but the first, or one that lasts, about the campaign's mean."""

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
        """See `Effect`."""
        steps = session_steps(observations)
        n = len(steps)
        lasting = [
            self._form(f"from {name} on", [(name, np.sum([step for _, step in steps[k:]], axis=0))], 2 * n)
            for k, (name, _) in enumerate(steps)
        ]
        return [self._form("", steps, 2), *lasting] if n > 1 else [self._form("", steps, 1)] if steps else []

    def _form(self, label: str, steps: Sequence[tuple[str, FloatArray]], tries: int) -> Form:
        each = [(side, *step) for step in steps for side in ("left", "right")]
        parameters = [Parameter(f"{side}_{name}", "1", typical=5e-4, largest=1e-2) for side, name, _ in each]
        perturbations = [Perturbation(**{side: step}) for side, _, step in each]
        return Form(self.id, label, tuple(parameters), always(*perturbations), tries=tries)


class SteeringZeroStep(Effect):
    """The zero of the steering angle in every session but the first, counted from the campaign's mean."""

    id = "steering_zero_step"
    title = "a steering zero that steps from session to session"
    implausible = "a sensor that slips on its shaft"
    family = Family.STEERING
    needs = "the front wheel in the log, in two sessions"
    separates = "one straight run at the beginning of each session"
    per_session = True
    not_transferable = "what steps from session to session says nothing of the next one; find the steering zero in each"

    def forms(self, observations: Observations) -> list[Form]:
        """See `Effect`."""
        steps = session_steps(observations) if has_front(observations).any() else []
        if not steps:
            return []
        parameters = tuple(Parameter(f"zero_{name}", "rad", typical=2e-3, largest=3.5e-2) for name, _ in steps)
        errors = [angle_error(observations, step[observations.unit]) for _, step in steps]
        return [Form(self.id, "", parameters, always(*errors))]


class SpeedRadius(Proportional):
    """dr / r = k (v - v_0) for both wheels, v_0 the campaign's mean speed; the speed of a run is its driven mean."""

    id = "speed_radius"
    title = "wheel radii that follow the speed"
    shifts = ("radius_scale",)
    implausible = "latency or lost counts (the centrifugal growth of a solid wheel is only about 6e-5 at 1 m/s)"
    family = Family.SPEED
    needs = "two speeds"
    separates = "one route at several speeds, read after the stop"
    parameter = Parameter("per_mps", "s/m", typical=3e-4, largest=3e-4)

    def same_within(self, values: FloatArray) -> float:
        """See `Proportional`."""
        return same_speed_mps(values)

    def quantity(self, observations: Observations) -> FloatArray:
        """See `Proportional`."""
        return driven_speed_mps(observations)


class AnySpeed(SpeedRadius):
    """Radii by any law of the speed: what `SpeedRadius` may be where its line is too narrow; no cause of the search."""

    def forms(self, observations: Observations) -> list[Form]:
        """See `Effect`."""
        line, speed = super().forms(observations), self.quantity(observations)
        order = np.argsort(speed)
        beyond = np.diff(speed[order]) > self.same_within(speed)
        if not line or not beyond.any():
            return line
        number = np.zeros(len(speed))
        number[order[1:]] = np.cumsum(beyond)
        steps = [np.asarray(number == k, dtype=np.float64) for k in range(1, int(number.max()) + 1)]
        parameters = (Parameter("step", "1", typical=1e-3, largest=5e-3),) * len(steps)
        return [*line, Form(self.id, "any", parameters, lambda path: [acting_on(path, "both", step) for step in steps])]


#: a stop lies in a curve where a way of one track turns by more, in radians
LEAST_BEND_PER_TRACK: Final = 0.1


class BrakingSkid(Effect):
    """A slide at each stop, the same at every stop or growing with the square of the highest speed since the last one.

    In curves the turn is a parameter of its own: wheels that creep let it turn on, locked ones do not. Brakes of unlike
    force slide one wheel further, which turns the vehicle on straights too.
    """

    id = "braking_skid"
    title = "skidding when it stops"
    implausible = "latency, or an offset of the reference"
    family = Family.SPEED
    needs = "stops"
    separates = "runs of one length with more and fewer stops"
    shifts = ("radius_scale",)
    zero_known = True

    def forms(self, observations: Observations) -> list[Form]:
        """See `Effect`."""
        bends = observations.of_parts(lambda part: np.abs(curvature_per_m(part)[stops(part)]))
        if not len(bends):
            return []
        per_stop = Parameter("per_stop", "m", typical=5e-4, largest=1e-2, sign=1)
        squared = Parameter("per_speed_squared", "s2/m", typical=2e-3, largest=4e-2, sign=1)
        laws = [("the same at each stop", per_stop, 0), ("~ v^2", squared, 2)]
        speed = driven_speed_mps(observations)
        speeds_differ = varies(speed, same_speed_mps(speed), observations)
        in_bends = observations.applied or bends.max() > LEAST_BEND_PER_TRACK / observations.model.track_m
        headed = observations.applied or observations.usable[:, [Channel.LATERAL, Channel.HEADING]].any()

        def slides(path: Path, power: int, acts: list[bool]) -> list[Perturbation]:
            s, at = path.s, stops(path.s)
            along = np.where(at, np.where(s.path_m < 0.0, -1.0, 1.0) * _highest_mps(s, at) ** power, 0.0)
            by_rad = along / observations.model.track_m
            # it turns where the step ends
            unlike = Perturbation(heading_rad=by_rad, lateral_m=-0.5 * by_rad * s.path_m)
            creep = Perturbation(heading_rad=np.abs(along) * curvature_per_m(s))
            return [*compress([Perturbation(along_m=along), creep, unlike], acts)]

        offers: list[Offer] = []
        for unlike, (label, one, power) in product((False, True)[: 1 + headed], laws[: 1 + speeds_differ]):
            acts = [True, bool(in_bends), unlike]
            each = (
                one,
                replace(one, name=f"turning_{one.name}"),
                replace(one, name=f"right_over_left_{one.name}", sign=0),
            )
            name = f"{label}, one wheel further" if unlike else label
            offers.append((name, (*compress(each, acts),), partial(slides, power=power, acts=acts)))
        return self.offer(offers, by_parts=True)


def _highest_mps(observations: Observations, at: BoolArray) -> FloatArray:
    middle_m = observations.cumulative(observations.path_m) - 0.5 * observations.path_m
    rate = np.abs(rate_per_s(observations, middle_m, 2))
    edges = np.union1d(observations.starts, np.flatnonzero(at) + 1)
    highest = np.maximum.reduceat(np.where(rate > 0.0, rate, np.abs(observations.speed_mps)), edges[:-1])
    return np.repeat(highest, np.diff(edges))


def stops(observations: Observations) -> BoolArray:
    """Return the last moving step before each stop, shape (n_steps,).

    A log that ends at less than half the driven speed ends in a stop. A run without a log stops once, at its end. The
    axle of a vehicle that turns on the spot does not slide on.
    """
    speed = np.abs(observations.speed_mps)
    last = np.zeros(len(observations.unit), dtype=bool)
    last[observations.starts[1:] - 1] = True
    spot = on_the_spot(observations, observations.turn_rad, observations.path_m) > 0.0
    moving = (speed > standstill_mps(observations)[observations.unit]) & ~spot
    follows = np.concatenate((moving[1:], [False]))
    driven = np.nan_to_num(driven_speed_mps(observations))[observations.unit]
    within = moving & ~last & ~follows
    at_end = last & moving & (speed < 0.5 * driven)
    return np.where(observations.from_log[observations.unit], within | at_end, last)


class PathWeave(Effect):
    """Wheels roll (pi A / lambda)^2 further than the distance shows; the parameter is the share of the known weave.

    Of a run without a log, which is taken as one arc.
    """

    id = "path_weave"
    title = "a path that weaves about its line"
    implausible = "both effective radii, or a weave other than noted"
    family = Family.PATH
    needs = "amplitude_m and wavelength_m, or logs beside an outside simulation"
    separates = "the log within a run"

    def forms(self, observations: Observations) -> list[Form]:
        """See `Effect`."""
        amplitude, wavelength = observations.number("amplitude_m"), observations.number("wavelength_m")
        noted = np.zeros(len(observations))
        weaves = ~observations.from_log & (amplitude > 0.0) & (wavelength > 0.0)
        if weaves.any():
            noted[weaves] = whole_period_excess(amplitude[weaves], wavelength[weaves])
        outside = observations.from_log & np.isfinite(observations.simulated[:, :2]).any(axis=1)
        logged = np.where(outside, _weave_of_logs(observations), 0.0) if outside.any() else np.zeros(len(observations))
        # unmeasured headings: every run ends at one place of its wave, but not that where it began
        guided = weaves & observations.guided
        swing = np.zeros(len(observations))
        swing[guided] = 2.0 * np.pi * amplitude[guided] / wavelength[guided]
        offered: list[tuple[str, FloatArray, list[Perturbation]]] = []
        if (noted > 1e-7).any():
            offered.append(("by the noted amplitude", noted, []))
            if guided.any():
                swung = Perturbation.on_readings(observations, heading=swing)
                offered.append(("by the noted amplitude, turned at the end", noted, [swung]))
        if (logged > 1e-7).any():
            offered.append(("by the logs", logged, []))
        share = Parameter("share", "1", typical=1.0, largest=2.0, sign=1)
        turned = Parameter("end_heading", "1", typical=1.0, largest=2.0)

        def form(label: str, excess: FloatArray, further: list[Perturbation]) -> Form:
            shorter = -excess / (1.0 + excess)

            def perturbations(path: Path) -> list[Perturbation]:
                along, lateral = path.to_end_frame(shorter * path.end[:, 0], shorter * path.end[:, 1])
                distance = shorter * path.distance_m
                at_end = Perturbation.on_readings(observations, distance=distance, along=along, lateral=lateral)
                return [at_end, *further]

            return Form(self.id, label, (share, turned)[: 1 + len(further)], perturbations, tries=len(offered))

        return [form(*each) for each in offered]


def _weave_of_logs(observations: Observations) -> FloatArray:
    path = predict(observations)
    with np.errstate(divide="ignore", invalid="ignore"):
        excess = path.of_parts(lambda part: part.s.total(np.abs(part.steps.ds_m))) / np.abs(path.line_m) - 1.0
    return np.where((np.abs(path.end[:, 2]) < STRAIGHT_RAD) & np.isfinite(excess), excess, 0.0)
