"""Instruments: errors of the rangefinder and of the pose reference."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar, Final

import numpy as np

from calib.campaign.model import Campaign
from calib.gap.effects.effect import Centre, Effect, Family, Form, Parameter, Perturbations, varies
from calib.gap.effects.quantities import end_motion, reach, standstill_mps
from calib.gap.observations.arrays import POSE, Channel, Observations
from calib.gap.predict import Path, predict, residuals
from calib.gap.steps import Perturbation, total_perturbation
from calib.types import ComplexArray, FloatArray


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
    # a zero read by the wrong mark is millimetres off; counted from the bumper instead of the axle, half a metre
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

    def forms(self, observations: Observations) -> list[Form]:
        """See `Effect`."""
        heading = predict(observations).frame
        if not (observations.usable[:, 1] & (np.abs(np.exp(1j * heading) - 1.0) > 0.02)).any():
            return []

        def perturbations(path: Path) -> list[Perturbation]:
            return [_off_course(path, path.s.course_error[:, :, n], place) for n, place in enumerate((1.0, 1j))]

        scale = reach(observations)
        # a steered vehicle's sensor can sit anywhere between the axles
        longest = max(2e-1 * scale, observations.vehicle.wheelbase_m * observations.by_front)
        names = (("lever_x", longest), ("lever_y", 2e-1 * scale))
        parameters = tuple(Parameter(name, "m", typical=1e-2 * scale, largest=most) for name, most in names)
        return [Form(self.id, "", parameters, perturbations)]

    def elsewhere(self, observations: Observations) -> tuple[float, str]:
        """See `Effect`: it moves a position by |exp(i theta) - 1| l."""
        heading = predict(observations).frame[observations.usable[:, 1]]
        shown = float(np.max(np.abs(np.exp(1j * heading) - 1.0), initial=0.0))
        if observations.windowed or shown > np.sqrt(2.0):
            return 1.0, ""
        return np.sqrt(2.0) / max(shown, 1e-3), "after a quarter turn; drive a route that ends at 90 degrees or more"


def _off_course(path: Path, error: FloatArray, beside_m: complex = 0.0) -> Perturbation:
    c, sn = path.frame_turned
    # the stated place turns with them
    moved = np.asarray(1j * complex(*path.s.sensor_m) * ((c + 1j * sn) * error[:, 1] - error[:, 0]), np.complex128)
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
    #: label of the form that leaves the heading as it is
    OF_POSITION: ClassVar[str] = "position alone"

    def forms(self, observations: Observations) -> list[Form]:
        """See `Effect`."""
        if not observations.usable[:, 2].any():
            return []
        parameter = Parameter("yaw", "rad", typical=5e-3, largest=5e-2)

        # a window begins in the same axes: what it turns by is not touched
        shapes = {self.OF_POSITION: 0.0} | ({} if observations.windowed else {"position and heading": 1.0})

        def turned(path: Path, heading: float) -> list[Perturbation]:
            along, lateral = _read_at(path, 1j * complex(*observations.sensor_m))
            reading = Perturbation.on_readings(path.s, along=along, lateral=lateral, heading=heading)
            return [replace(reading, turned_rad=np.ones(len(path.s)))]

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
    #: label of the form whose scale changes as the radii of wheels would
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

    A window of a recording begins in motion too, and its start, from which all is counted, is as late as its end.
    """

    id = "reference_latency"
    title = "a reference that reads late"
    implausible = "an offset, or radii that follow the speed"
    family = Family.REFERENCE
    needs = "readings taken while it rolls"
    separates = "readings after the stop beside readings on the move"
    #: label of the form of end poses alone, and of that whose delay grows
    OF_POSE: ClassVar[str] = "end pose"
    OF_CLOCK: ClassVar[str] = "a clock at another rate"

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
        # the start lay back as well, and all is seen from there
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
        parameters = dict.fromkeys(late, Parameter("latency", "s", typical=5e-2, largest=5e-1))
        if has_pose and observations.windowed:
            # of a clock at another rate the delay grows with the time since the run's start
            begin_s = np.where(logged, observations.start_s, 0.0)
            end_s = np.where(logged, observations.time_s[observations.starts[1:] - 1], 0.0)
            late[self.OF_CLOCK] = Perturbation(start_arc=start * begin_s[:, None], delay_s=end_s)
            parameters[self.OF_CLOCK] = Parameter("rate", "1", typical=5e-4, largest=1e-2)
            since[self.OF_CLOCK] = np.stack([begin_s, end_s], axis=1)

        def push(path: Path, label: str) -> list[Perturbation]:
            off = _off_course(path, path.s.course_error[:, :, 2] * since.get(label, 1.0))
            return [total_perturbation(path.s, [late[label], off])]

        return self.offer([(label, (parameters[label],), partial(push, label=label)) for label in late])


#: a smaller angle is left to `ReferenceYaw`, whose form is linear in it: at 0.1 rad it errs by a two-hundredth
MIN_TURN_RAD: Final = 0.1
#: a turned reference keeps lengths; one that stretches them by more is another fault
MAX_STRETCH: Final = 0.2
#: a turn and a place are two unknowns of each run's two: with fewer runs they explain anything
MIN_TURNED_RUNS: Final = 4
#: what the angle leaves is less than this share of what it explains, and what bends the heading less than this of it
TURN_RESIDUAL_SHARE: Final = 0.2
#: by how much the end's heading may be off where none is measured: radii unequal by a hundredth, over ten tracks
HEADING_ERROR_RAD: Final = 0.1
MIRRORED: Final = 0.999  #: confidence at which the scatter of ends tells mirrored axes from turned ones


@dataclass(frozen=True, slots=True)
class TurnedReference:
    """The angle by which the sensor's axes are turned against the vehicle's, beyond what the campaign states."""

    effect = ReferenceYaw
    #: yaw_rad, sd_rad: the angle and its standard uncertainty
    yaw_rad: float
    sd_rad: float
    #: whether y has to be mirrored first
    mirrored: bool = False

    @property
    def label(self) -> str:
        """What is wrong with the axes."""
        if not self.mirrored:
            return "the sensor is mounted turned"
        quarter = abs(abs(self.yaw_rad) - np.pi / 2.0) < MIN_TURN_RAD
        return "x and y are exchanged" if quarter else "the axes are mirrored"

    @property
    def remark(self) -> str:
        """What to do about it."""
        state = f"state sensor_yaw_rad = {self.yaw_rad:.4f} in [reference] of campaign.toml"
        if not self.mirrored:
            return f"{state}, then diagnose again"
        if "exchanged" in self.label:
            signs = "" if self.yaw_rad > 0.0 else ", both with the other sign"
            return f"{self.label}{signs}: correct ref_x_m and ref_y_m, then diagnose again"
        also = "" if abs(self.yaw_rad) < MIN_TURN_RAD else f", {state}"
        return f"y is positive to the right: change the sign of ref_y_m{also}, then diagnose again"

    @property
    def sizes(self) -> Mapping[str, tuple[float, tuple[float, float], str]]:
        """Value, 95 % interval and unit of its parameter."""
        value, half = self.yaw_rad, 2.0 * self.sd_rad
        return {"yaw": (value, (value - half, value + half), "rad")}

    def refined(self, turned_rad: float, sd_rad: float) -> "TurnedReference":
        """Return the mounting whose positions a fit beside the other causes found turned by so much more."""
        return replace(self, yaw_rad=self.yaw_rad - turned_rad, sd_rad=sd_rad)

    def correct(self, campaign: Campaign) -> Campaign:
        """Return the campaign with the sensor's yaw stated, y mirrored where that is needed."""
        if self.mirrored:
            runs, logs = campaign.runs, campaign.logs
            numbers, columns = (
                {name: -values if name == "ref_y_m" else values for name, values in each.items()}
                for each in (runs.numbers, logs.columns)
            )
            campaign = replace(campaign, runs=replace(runs, numbers=numbers), logs=replace(logs, columns=columns))
        reference = campaign.reference
        yaw_rad = float(np.angle(np.exp(1j * (reference.sensor_yaw_rad + self.yaw_rad))))
        return replace(campaign, reference=replace(reference, sensor_yaw_rad=yaw_rad))


def find_turned(nominal: Path) -> TurnedReference | None:
    """Return the large angle by which the reference is turned; None where there is none, or it explains too little.

    A sensor at the place l on the vehicle and turned by psi sees the end z of a run that turned by theta as
    ``exp(-i psi) (z + (exp(i theta) - 1) l)``: least squares in two complex unknowns; mirrored axes see the conjugate.
    """
    from scipy.special import fdtri

    observations = nominal.s
    on = observations.usable[:, POSE].all(axis=1)
    if on.sum() < MIN_TURNED_RUNS or np.isfinite(observations.simulated).any():
        return None
    headed = observations.usable[:, Channel.HEADING]
    heading = np.where(headed, residuals(nominal, nominal)[:, Channel.HEADING], 0.0)
    # radii that bend a path evenly turn its end by half of what they turn the heading
    end = (nominal.end[on, 0] + 1j * nominal.end[on, 1]) * np.exp(0.5j * heading[on])
    seen = observations.measured[on, Channel.ALONG] + 1j * observations.measured[on, Channel.LATERAL]
    turned = np.exp(1j * (nominal.end[on, 2] + heading[on])) - 1.0
    turn, left_m2 = _turn(end, turned, seen)
    # on a map, displacements were turned by start headings that are right
    mirrored_seen = seen.conj() * np.exp(-2j * np.nan_to_num(observations.start_pose[on, 2]))
    mirror, mirrored_left_m2 = _turn(end, turned, mirrored_seen)
    # wrong radii leave as much in both, but for the direction of an end
    aimed = np.exp(1j * np.angle(end)) * np.abs(seen)
    aside, mirrored_aside = (_turn(aimed, turned, each)[1] for each in (seen, mirrored_seen))
    by_chance = mirrored_aside * fdtri(len(seen), len(seen), MIRRORED)
    mirrored = mirrored_left_m2 < TURN_RESIDUAL_SHARE**2 * left_m2 or bool(aside > by_chance)
    if mirrored:
        turn, left_m2 = mirror, mirrored_left_m2
    yaw_rad = -float(np.angle(turn))
    if abs(abs(turn) - 1.0) > MAX_STRETCH:
        return None
    by_place = turned.conj() @ (seen - end) / (turned.conj() @ turned + 1e-3)
    before_m2 = float(np.sum(np.abs(seen - end - by_place * turned) ** 2))
    bent_rad = float(np.sqrt(np.mean(heading[headed] ** 2))) if headed.any() else HEADING_ERROR_RAD
    # swapped wheels mirror the headings too, and turn nothing
    angle_rad = max(abs(yaw_rad), float(np.sqrt(np.mean(nominal.end[on, 2] ** 2))) if mirrored else 0.0)
    if angle_rad < max(MIN_TURN_RAD, bent_rad / TURN_RESIDUAL_SHARE) or left_m2 > TURN_RESIDUAL_SHARE**2 * before_m2:
        return None
    sd_rad = float(np.sqrt(left_m2 / (2 * (len(seen) - 2)) / np.sum(np.abs(end) ** 2)))
    return TurnedReference(yaw_rad, sd_rad, mirrored)


def _turn(end: ComplexArray, turned: ComplexArray, seen: ComplexArray) -> tuple[complex, float]:
    # a place within a metre, ends good to some centimetres; without turns there is nothing to see of it
    columns, prior = np.stack([end, turned], axis=1), np.diag([1e-9, 1e-3])
    turn, place = np.linalg.solve(columns.conj().T @ columns + prior, columns.conj().T @ seen)
    return complex(turn), float(np.sum(np.abs(seen - turn * end - place * turned) ** 2))
