"""The path between the ends: a weave, stops, and the integration of an outside simulator."""

from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np

from calib.gap.effects import quantities
from calib.gap.effects.effect import Effect, Family, Form, Parameter, varies
from calib.gap.effects.steering import rate_per_s
from calib.gap.observations.arrays import POSE, STRAIGHT_RAD, Channel, Observations
from calib.gap.predict import Path, predict
from calib.gap.steps import Perturbation
from calib.radius.path_length import whole_period_excess
from calib.types import BoolArray, FloatArray

#: a stop lies in a curve where a way of one track turns by more, in radians
LEAST_BEND_PER_TRACK: Final = 0.1


class PathWeave(Effect):
    """Wheels roll (pi A / lambda)^2 further than the distance shows; the parameter is the share of the known weave.

    A run with a log needs no such thing, its path is integrated; a run without one is taken as one arc, and an outside
    simulator may have driven the straight line.
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
        # nobody measured the heading, and every run ends at one place of its wave, but not that where it began
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


class IntegrationScheme(Effect):
    """Exact arcs less steps along the heading at their end (Eq. 7 as printed) or start (Euler): e_n ~ v dt theta / 2.

    Calib's own odometry integrates exact arcs, so only an outside simulator's poses can have it. The difference is
    computed on the log's steps and grows with them: a share of 1 means that the simulator takes the log's steps.
    """

    id = "integration_scheme"
    title = "a simulator that integrates the heading coarsely"
    implausible = "latency, or a start heading that differs"
    family = Family.PATH
    needs = "poses of an outside simulator on runs that turn"
    separates = "none: it is computed from the logs"

    def forms(self, observations: Observations) -> list[Form]:
        """See `Effect`."""
        posed = np.isfinite(observations.simulated[:, POSE]).all(axis=1) & observations.usable[:, Channel.ALONG]
        outside = observations.from_log & posed
        if not outside.any():
            return []
        parameter = Parameter("share", "1", typical=1.0, largest=2.0, sign=1)

        def coarse(path: Path, back: float) -> list[Perturbation]:
            heading = observations.cumulative(path.steps.turn_rad) - back * path.steps.turn_rad
            end_x, end_y = path.end[:, 0], path.end[:, 1]
            x = np.where(outside, end_x - observations.total(path.steps.ds_m * np.cos(heading)), 0.0)
            y = np.where(outside, end_y - observations.total(path.steps.ds_m * np.sin(heading)), 0.0)
            along, lateral = path.to_end_frame(x, y)
            # a laser's simulated distance was taken from the same pose
            chord = (end_x * x + end_y * y) / np.maximum(np.hypot(end_x, end_y), 1e-9)
            laser = np.where(observations.axis == 1, x, np.where(observations.axis == 2, chord, 0.0))
            distance = np.where(np.isfinite(observations.simulated[:, 0]), laser, 0.0)
            return [Perturbation.on_readings(observations, distance=distance, along=along, lateral=lateral)]

        schemes = [("end-point heading", 0.0), ("start heading (Euler)", 1.0)]
        forms = self.offer([(label, (parameter,), partial(coarse, back=back)) for label, back in schemes])
        reading = coarse(predict(observations), 0.0)[0].reading
        return forms if reading is not None and float(np.abs(reading).max()) > 1e-5 else []


class BrakingSkid(Effect):
    """A slide at each stop, the same at every stop or growing with the square of the highest speed since the last one.

    Wheels that creep let the vehicle turn on along its curve, locked ones do not, and a turn may end with the drive: in
    curves the turn is a parameter of its own, the way along the curve that would turn it as much.
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
        bends = observations.of_parts(lambda part: np.abs(quantities.curvature_per_m(part)[stops(part)]))
        if not len(bends):
            return []
        per_stop = Parameter("per_stop", "m", typical=5e-4, largest=1e-2, sign=1)
        squared = Parameter("per_speed_squared", "s2/m", typical=2e-3, largest=4e-2, sign=1)
        laws = [("the same at each stop", per_stop, 0), ("~ v^2", squared, 2)]
        speed = quantities.driven_speed_mps(observations)
        speeds_differ = varies(speed, quantities.same_speed_mps(speed), observations)
        turns = observations.applied or bends.max() > LEAST_BEND_PER_TRACK / observations.model.track_m

        def slides(path: Path, power: int) -> list[Perturbation]:
            s, at = path.s, stops(path.s)
            along = np.where(at, np.where(s.path_m < 0.0, -1.0, 1.0) * _highest_mps(s, at) ** power, 0.0)
            turn = np.abs(along) * quantities.curvature_per_m(s)
            return [Perturbation(along_m=along), Perturbation(heading_rad=turn)][: 1 + turns]

        return self.offer(
            [
                (label, (one, replace(one, name=f"turning_{one.name}"))[: 1 + turns], partial(slides, power=power))
                for label, one, power in laws[: 1 + speeds_differ]
            ],
            by_parts=True,
        )


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
    spot = quantities.on_the_spot(observations, observations.turn_rad, observations.path_m) > 0.0
    moving = (speed > quantities.standstill_mps(observations)[observations.unit]) & ~spot
    follows = np.concatenate((moving[1:], [False]))
    driven = np.nan_to_num(quantities.driven_speed_mps(observations))[observations.unit]
    within = moving & ~last & ~follows
    at_end = last & moving & (speed < 0.5 * driven)
    return np.where(observations.from_log[observations.unit], within | at_end, last)
