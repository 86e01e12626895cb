"""Instruments: errors of the rangefinder and of the pose reference."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import ClassVar, Final

import numpy as np

from calib.gap import Perturbation, total_perturbation
from calib.gap.effects import Centre, Effect, Family, Form, Offer, Parameter, Perturbations, varies
from calib.gap.effects.quantities import end_motion, reach, standstill_mps
from calib.gap.observations import Channel, Observations
from calib.gap.predict import Path, predict
from calib.types import FloatArray


class _OfRangefinder(Effect):
    family = Family.INSTRUMENT
    needs = "distances by the instrument"
    parameter: ClassVar[Parameter]

    def forms(self, observations: Observations) -> list[Form]:
        if not observations.usable[:, Channel.DISTANCE].any():
            return []

        def perturbations(path: Path) -> list[Perturbation]:
            return [Perturbation.on_readings(observations, distance=self.too_much(path))]

        return [Form(self.id, "", (self.parameter,), perturbations)]

    def too_much(self, path: Path) -> FloatArray:
        return path.distance_m


class RangefinderScale(_OfRangefinder):
    """The laser reads (1 + k) times the distance; end poses do not change."""

    id = "rangefinder_scale"
    title = "a rangefinder of wrong scale"
    implausible = "both effective radii, or a target that moved"
    separates = "a length measured by other means"
    parameter = Parameter("relative", "1", typical=1e-3, largest=1e-2)


class RangefinderOffset(_OfRangefinder):
    """The laser reads a constant too much, for any distance; end poses do not change."""

    id = "rangefinder_offset"
    title = "a constant offset of the rangefinder"
    implausible = "a start mark or target that moved"
    separates = "several distances, read at rest"
    # by the wrong mark millimetres off; from the bumper instead of the axle, half a metre
    parameter = Parameter("offset", "m", typical=5e-3, largest=5e-1)

    def too_much(self, path: Path) -> FloatArray:
        """Return one metre everywhere."""
        return np.ones(len(path.s))


class BeamMisalignment(_OfRangefinder):
    """The laser reads the distance over cos(alpha); the parameter is 1 / cos(alpha) - 1, never negative."""

    id = "beam_misalignment"
    title = "a laser beam at an angle to the way"
    implausible = "the rangefinder's scale (a beam 5 degrees off reads only 0.4 % too much)"
    separates = "the beam aimed anew; a scale of the instrument looks exactly alike"
    # 1.5e-4 at 1 degree, 1.4e-3 at 3 degrees, 3.8e-3 at 5 degrees
    parameter = Parameter("excess", "1", typical=5e-4, largest=3.8e-3, sign=1)


class GyroScale(Effect):
    """A gyro measures (1 + k) times the turn: exactly what a track 1 + k times too wide makes of the wheels' turn."""

    id = "gyro_scale"
    title = "a gyro of wrong scale"
    implausible = "the track width"
    family = Family.INSTRUMENT
    needs = "turns by a gyro"
    separates = "a closed loop, or a turn of known angle"

    def forms(self, observations: Observations) -> list[Form]:
        """See `Effect`."""
        measured = observations.by_gyro & observations.usable[:, Channel.HEADING]
        if not measured.any() or not (np.abs(predict(observations).end[measured, 2]) > LEAST_TURN_RAD).any():
            return []

        def perturbations(path: Path) -> list[Perturbation]:
            return [Perturbation.on_readings(path.s, heading=np.where(path.s.by_gyro, path.end[:, 2], 0.0))]

        # a gyro of moderate price is stated within 1 %
        return [Form(self.id, "", (Parameter("relative", "1", typical=5e-3, largest=3e-2),), perturbations)]


#: runs that turn by less say nothing of a scale
LEAST_TURN_RAD: Final = 0.2


class ReferenceLeverArm(Effect):
    """A point l = (l_x, l_y) of the vehicle is read instead of its origin: the position moves by R(theta) l - l."""

    id = "reference_lever_arm"
    title = "a sensor offset (lever arm) of the reference"
    implausible = "heading errors in turns"
    family = Family.REFERENCE
    needs = "end positions of runs that turn"
    separates = "turns on the spot"
    NAMES: ClassVar[tuple[str, str]] = ("lever_x", "lever_y")

    def forms(self, observations: Observations) -> list[Form]:
        """See `Effect`."""
        heading = predict(observations).frame
        if not (observations.usable[:, 1] & (np.abs(np.exp(1j * heading) - 1.0) > 0.02)).any():
            return []

        def perturbations(path: Path) -> list[Perturbation]:
            return [off_course(path, path.s.course_error[:, :, n], place) for n, place in enumerate((1.0, 1j))]

        scale = reach(observations)
        # a steered vehicle's sensor can sit anywhere between the axles
        steered = observations.vehicle.drive in {"tricycle", "ackermann"}
        longest = max(2e-1 * scale, observations.vehicle.wheelbase_m * steered)
        most = zip(self.NAMES, (longest, 2e-1 * scale), strict=True)
        parameters = tuple(Parameter(name, "m", typical=1e-2 * scale, largest=largest) for name, largest in most)
        return [Form(self.id, "", parameters, perturbations)]

    def elsewhere(self, observations: Observations) -> tuple[float, str]:
        """See `Effect`: it moves a position by |exp(i theta) - 1| l."""
        heading = predict(observations).frame[observations.usable[:, 1]]
        shown = float(np.max(np.abs(np.exp(1j * heading) - 1.0), initial=0.0))
        if observations.windowed or shown > np.sqrt(2.0):
            return 1.0, ""
        return np.sqrt(2.0) / max(shown, 1e-3), "after a quarter turn; drive a route that ends at 90 degrees or more"


def off_course(path: Path, error: FloatArray, beside_m: complex = 0.0) -> Perturbation:
    """Return what it does that headings from the course are off by `error`, shape (n_obs, 2), at start and end."""
    c, sn = path.frame_turned
    moved = np.asarray(-1j * complex(*path.s.sensor_m) * ((c + 1j * sn) * error[:, 1] - error[:, 0]), np.complex128)
    ways = zip(path.to_end_frame(moved.real, moved.imag), _read_at(path, beside_m), strict=True)
    along, lateral = (turned + read for turned, read in ways)
    reading = Perturbation.on_readings(path.s, along=along, lateral=lateral, heading=error[:, 1] - error[:, 0])
    return replace(reading, turned_rad=-error[:, 0])


def _read_at(path: Path, place_m: complex) -> tuple[FloatArray, FloatArray]:
    # a heading from the course is off by what the place itself does to it
    heading = np.where(path.s.course_error.any(axis=(1, 2)), path.end[:, 2], path.frame)
    moved = np.asarray((np.exp(1j * heading) - 1.0) * place_m, np.complex128)
    return path.to_end_frame(moved.real, moved.imag)


class ReferenceYaw(Effect):
    """e_n = alpha_0 S on straight runs: the end pose is read in axes turned by alpha_0, a stated lever too."""

    id = "reference_yaw"
    title = "reference axes turned against the start heading"
    implausible = "unequal radii, or a badly placed start"
    family = Family.REFERENCE
    needs = "end positions"
    separates = "straight runs of several lengths"
    OF_POSITION: ClassVar[str] = "position alone"

    def forms(self, observations: Observations) -> list[Form]:
        """See `Effect`."""
        # a course is taken from the positions themselves: it has no axes to be turned against
        read = np.asarray(~observations.course_error.any(axis=(1, 2)))
        if not observations.usable[read, 2].any():
            return []
        parameter = Parameter("yaw", "rad", typical=5e-3, largest=5e-2)

        # a window begins in the same axes: what it turns by is not touched
        shapes = {self.OF_POSITION: 0.0} | ({} if observations.windowed else {"position and heading": 1.0})

        def turned(path: Path, heading: float) -> list[Perturbation]:
            along, lateral = _read_at(path, 1j * complex(*observations.sensor_m))
            by = path.s.here(read.astype(np.float64))
            reading = Perturbation.on_readings(path.s, along=by * along, lateral=by * lateral, heading=by * heading)
            return [replace(reading, turned_rad=by)]

        return self.offer([(label, (parameter,), partial(turned, heading=one)) for label, one in shapes.items()])


class ReferenceScale(Effect):
    """The pose reference reads (1 + k) times every way, k constant or by temperature; other distances do not change."""

    id = "reference_scale"
    title = "a pose reference of wrong scale"
    implausible = "both effective radii with the track"
    family = Family.REFERENCE
    needs = "end positions beside distances by another instrument or a front wheel"
    separates = "a length taped on the floor, against the reference"
    needs_calibration = True
    WITH_TEMPERATURE: ClassVar[str] = "with the temperature"

    def forms(self, observations: Observations) -> list[Form]:
        """Return a constant scale and one by temperature; none without both: what alone measures is the standard."""
        return self.unaided(observations) if self.aided(observations) else []

    @staticmethod
    def aided(observations: Observations) -> bool:
        """Return whether a rangefinder or a counted front wheel measures lengths beside the reference."""
        beside = observations.usable[:, [Channel.DISTANCE, Channel.FRONT]].any()
        return bool(beside and observations.usable[:, Channel.ALONG].any())

    def unaided(self, observations: Observations) -> list[Form]:
        """Return the forms where nothing else may measure a length."""

        def of(values: FloatArray) -> Callable[[Centre], Perturbations]:
            def scaled(path: Path, centre: Centre) -> list[Perturbation]:
                along, lateral = path.to_end_frame(path.end[:, 0], path.end[:, 1])
                by = path.s.here(centre.deviations(values))
                return [Perturbation.on_readings(path.s, along=by * along, lateral=by * lateral)]

            return lambda centre: lambda path: scaled(path, centre)

        temperature_C = observations.number("temperature_C")
        tries = 1 + varies(temperature_C, 0.5, observations)
        constant = Parameter("relative", "1", typical=1e-3, largest=1e-2)
        forms = [Form(self.id, "", (constant,), of(np.ones(len(observations)))(Centre(0.0)), tries=tries)]
        if tries > 1:
            # a mount of aluminium or plastic: 2 to 10 times the 1e-5 of the floor
            parameter = Parameter("per_K", "1/K", typical=5e-5, largest=3e-4)
            about, centre = of(temperature_C), Centre.of(temperature_C)
            label = self.WITH_TEMPERATURE
            forms.append(Form(self.id, label, (parameter,), about(centre), centre=centre, about=about, tries=tries))
        return forms


class ReferenceLatency(Effect):
    """The reading is tau old (or, below 0, ahead of the counts): e_s = -tau v_end and e_theta = -tau omega_end.

    A window of a recording begins in motion too, and its start, from which all is counted, is as late as its end. All
    sessions share tau, or each has its own.
    """

    id = "reference_latency"
    title = "a reference that reads late"
    implausible = "an offset, or radii that follow the speed"
    family = Family.REFERENCE
    needs = "readings taken while it rolls"
    separates = "readings after the stop beside readings on the move"
    OF_POSE: ClassVar[str] = "end pose"
    OF_CLOCK: ClassVar[str] = "a clock at another rate"
    BY_SESSION: ClassVar[str] = "another delay in each session"
    DELAY: ClassVar[str] = "latency"

    def forms(self, observations: Observations) -> list[Form]:
        """See `Effect`."""
        speed, rate = end_motion(observations)
        nothing = np.zeros(len(observations))
        first_speed, first_rate = (
            end_motion(observations, at_start=True) if observations.windowed else (nothing, nothing)
        )
        least = np.minimum(0.01, 0.2 * standstill_mps(observations))
        rolls = (np.abs(speed) > least) | (np.abs(first_speed) > least)
        has_pose = bool((observations.usable[:, 1:4].any(axis=1) & rolls).any())
        has_laser = bool((observations.usable[:, Channel.DISTANCE] & rolls).any())
        start, end = (-np.stack(edge, axis=1) for edge in ((first_speed, first_rate), (speed, rate)))
        logged = observations.from_log
        end[logged] = 0.0
        pose = Perturbation(start_arc=start, end_arc=end, delay_s=logged.astype(np.float64))
        # the laser reads a length, which grows in either rolling direction
        laser = Perturbation.on_readings(observations, distance=np.abs(first_speed) - np.abs(speed))
        late = {self.OF_POSE: pose} if has_pose else {}
        late |= {"laser": laser} if has_laser else {}
        late |= {"end pose and laser": replace(pose, reading=laser.reading)} if has_pose and has_laser else {}
        since: dict[str, FloatArray] = {}
        parameters = dict.fromkeys(late, Parameter(self.DELAY, "s", typical=5e-2, largest=5e-1))
        if has_pose and observations.windowed:
            # of a clock at another rate the delay grows with the time since the run's start
            begin_s = np.where(logged, observations.start_s, 0.0)
            end_s = np.where(logged, observations.time_s[observations.starts[1:] - 1], 0.0)
            late[self.OF_CLOCK] = Perturbation(start_arc=start * begin_s[:, None], delay_s=end_s)
            parameters[self.OF_CLOCK] = Parameter("rate", "1", typical=5e-4, largest=1e-2)
            since[self.OF_CLOCK] = np.stack([begin_s, end_s], axis=1)

        def push(path: Path, label: str) -> list[Perturbation]:
            off = off_course(path, path.s.course_error[:, :, 2] * since.get(label, 1.0))
            return [total_perturbation(path.s, [late[label], off])]

        session = observations.labels["session"]
        names = np.unique(session).tolist()

        def by_session(path: Path) -> list[Perturbation]:
            parts = push(path, self.OF_POSE)[0].parts()
            within = [session == name for name in names]
            return [Perturbation(*(part if part is None else (part.T * here).T for part in parts)) for here in within]

        offers: list[Offer] = [(label, (parameters[label],), partial(push, label=label)) for label in late]
        if has_pose and (len(names) > 1 or observations.applied):
            delays = [replace(parameters[self.OF_POSE], name=f"{self.DELAY}_{name}") for name in names]
            offers.append((self.BY_SESSION, tuple(delays), by_session))
        return self.offer(offers)
