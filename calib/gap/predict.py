"""The path that the counts and a hypothesis predict, its residuals, and the signatures of small perturbations.

Campaigns of many samples are worked through in parts: what is kept is per observation, not per step.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Final

import numpy as np

from calib.gap import AT_ENDS, LINE, TURN, WAY, Perturbation, Steps, X, Y, total_perturbation
from calib.gap.observations import N_CHANNELS, POSE, Channel, Observations
from calib.gap.observations.observation import let_go
from calib.types import BoolArray, FloatArray

#: a run whose wheels turn by less than this in all, to and fro, was guided
GUIDED_TURN_RAD: Final = 1.0
#: a heading off by more is no scatter: radii off by half a per mille make 0.02 rad on 20 m
LARGEST_BEND_RAD: Final = 0.05
#: the derivative by a delay is over a typical one: a vehicle that brakes stands at the very end
DELAY_STEP_S: Final = 0.05


@dataclass(frozen=True, eq=False)
class Path:
    """Path of every observation under a hypothesis, each in the frame of its own start."""

    s: Observations
    perturbation: Perturbation  #: the hypothesis
    end: FloatArray  #: shape (n_obs, 3): end pose
    #: shape (n_obs, n_channels): predicted reading of each channel: distance, x, y, heading, front, steering
    reading: FloatArray
    line_m: FloatArray  #: shape (n_obs,): length of the line that the observation was guided along, signed
    kept: Steps | None = None  #: the steps, where they are few enough to be kept

    @property
    def steps(self) -> Steps:
        """The steps of all observations; integrated anew each time where they are too many to be kept: see `parts`."""
        return Steps(self.s, self.perturbation) if self.kept is None else self.kept

    def traces(self) -> list[FloatArray]:
        """Return the poses (n, 3) of each observation: its start, the middles of its steps, its end."""
        steps = self.steps
        places = np.column_stack((steps.x_m, steps.y_m, steps.mid_rad))
        pieces = zip(pairwise(self.s.starts.tolist()), self.end, strict=True)
        return [np.vstack((np.zeros(3), places[first:last], end)) for (first, last), end in pieces]

    def parts(self) -> "Iterator[tuple[slice, Path]]":
        """Yield observations some at a time, each time with the path of these alone; itself where steps are few."""
        for units, part in self._integrated():
            if part is not self:
                vars(part)["calibration"] = self.calibration[units]
            yield units, part

    def _integrated(self) -> "Iterator[tuple[slice, Path]]":
        if self.kept is not None:
            yield slice(0, len(self.s)), self
            return
        for units in self.s.spans:
            part, perturbation = self.s.part(units), self.perturbation.part(units, self.s)
            own = (self.end[units], self.reading[units], self.line_m[units])
            yield units, Path(part, perturbation, *own, Steps(part, perturbation))
            let_go(*self.s.steps, *self.perturbation.parts())

    @cached_property
    def way_m(self) -> FloatArray:
        """Way along of each observation, signed, shape (n_obs,)."""
        return self.of_parts(lambda part: part.s.total(part.steps.ds_m))

    @cached_property
    def rolling_radii_m(self) -> FloatArray:
        """Travel of the left and right wheel over their rotation, shape (n_obs, 2); NaN where a wheel stood."""

        def radii(part: Path) -> FloatArray:
            s, steps = part.s, part.steps
            wheels = ((steps.ds_left_m, s.roll_left_rad), (steps.ds_right_m, s.roll_right_rad))
            with np.errstate(divide="ignore", invalid="ignore"):
                ratios = [s.total(travel * np.sign(roll)) / s.total(np.abs(roll)) for travel, roll in wheels]
            return np.stack(ratios, axis=1)

        return self.of_parts(radii)

    def of_parts(self, what: "Callable[[Path], FloatArray]") -> FloatArray:
        """Return a quantity of each observation (n_obs, ...) that is worked out from steps, part by part."""
        return np.concatenate([what(part) for _, part in self._integrated()])

    @cached_property
    def bent_m(self) -> FloatArray:
        """What an even bend of 1 rad takes off the end by its square, shape (n_obs, 2): on a straight a sixth of it."""

        def taken(part: Path) -> FloatArray:
            s, steps = part.s, part.steps
            way = np.abs(steps.ds_m)
            share = (s.cumulative(way) - 0.5 * way) / np.maximum(s.total(way), 1e-9)[s.unit]
            by_square = 0.5 * share**2 * steps.ds_m
            directions = (np.cos(steps.mid_rad), np.sin(steps.mid_rad))
            return np.stack([s.total(by_square * direction) for direction in directions], axis=1)

        return self.of_parts(taken)

    @property
    def distance_m(self) -> FloatArray:
        """What a perfect laser reads, without any perturbation of the readings, shape (n_obs,)."""
        (x, y), axis = self.end[:, :2].T, self.s.axis
        return np.where(np.abs(axis) == 1, axis * x, np.where(axis == 2, np.hypot(x, y), np.abs(self.line_m)))

    @cached_property
    def frame(self) -> FloatArray:
        """Heading in which along and lateral are read: the measured one, else the wheels', shape (n_obs,)."""
        measured = self.s.measured[:, Channel.HEADING]
        return np.where(np.isfinite(measured), measured, self.end[:, 2])

    @cached_property
    def frame_turned(self) -> tuple[FloatArray, FloatArray]:
        """Cosine and sine of `frame`, each shape (n_obs,)."""
        return np.cos(self.frame), np.sin(self.frame)

    def to_end_frame(self, x_m: FloatArray, y_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Turn changes of x and y, each shape (n_obs,), into along and lateral in `frame`."""
        c, sn = self.frame_turned
        return c * x_m + sn * y_m, c * y_m - sn * x_m

    @cached_property
    def calibration(self) -> FloatArray:
        """Derivative of the readings by (left, right radius, track, front radius), shape (n_obs, n_channels, 4).

        All are relative; only the front channels feel the fourth.
        """
        return self.beside_straights(self.of_parts(_calibration))

    def beside_straights(self, calibration: FloatArray) -> FloatArray:
        """Return the derivative (n_obs, n_channels, 4) without the track, where all observations were guided."""
        if self.guided.all():
            calibration[:, :, 2] = 0.0
        return calibration

    @cached_property
    def guided(self) -> BoolArray:
        """Which observations were guided, shape (n_obs,).

        There the turn by the wheels is noise: as a turn it would pass for a track that is off. Straight runs alone say
        nothing of the track.
        """
        s = self.s
        with np.errstate(invalid="ignore"):
            bent = np.abs(s.measured[:, Channel.HEADING]) > GUIDED_TURN_RAD
        turned = s.of_parts(lambda part: part.total(np.abs(part.turn_rad)))
        return ((turned < GUIDED_TURN_RAD) & ~bent) | s.guided


def _calibration(path: Path) -> FloatArray:
    s = path.s
    ones = np.ones(len(s))
    if s.by_front:
        # one wheel: both that represent it share a radius; wheelbase and zero are the steering's
        both = 0.5 * _along_path(path, Perturbation(left=ones, right=ones))
        return np.stack([both, both, np.zeros_like(both), np.zeros_like(both)], axis=2)
    by_front = np.zeros((len(s), N_CHANNELS))
    by_front[:, Channel.FRONT :] = -s.front_ways
    wheels = [_along_path(path, Perturbation(**{name: ones})) for name in ("left", "right", "track")]
    return np.stack([*wheels, by_front], axis=2)


def predict(s: Observations, perturbations: list[Perturbation] | None = None) -> Path:
    """Integrate the counts (exact arcs) under a hypothesis: perturbations already scaled; none is the model alone."""
    perturbation = total_perturbation(s, perturbations or [])
    if len(s.spans) == 1:
        return _predicted(s, perturbation)
    _ = s.front_ways
    path = Path(s, perturbation, np.zeros((len(s), 3)), np.zeros((len(s), N_CHANNELS)), np.zeros(len(s)))
    kept = []
    for units in s.spans:
        part = _predicted(s.part(units), perturbation.part(units, s))
        path.end[units], path.reading[units], path.line_m[units] = part.end, part.reading, part.line_m
        kept.append((_calibration(part), part.way_m, part.rolling_radii_m, part.bent_m))
        let_go(*s.steps, *perturbation.parts())
    derivatives, way_m, radii_m, bent_m = map(np.concatenate, zip(*kept, strict=True))
    vars(path).update(way_m=way_m, rolling_radii_m=radii_m, bent_m=bent_m)
    vars(path)["calibration"] = path.beside_straights(derivatives)
    return path


def _predicted(s: Observations, perturbation: Perturbation) -> Path:
    steps = Steps(s, perturbation)
    reading = np.zeros((len(s), N_CHANNELS))
    path = Path(s, perturbation, steps.end, reading, s.total(steps.ds_m * steps.weave_cos), steps)
    reading[:, [*POSE, Channel.HEADING]] = steps.end
    reading[:, Channel.DISTANCE] = path.distance_m
    if s.usable[:, Channel.FRONT :].any():
        # what the rear wheels say, less what the front wheel and its steering say of the same (Eqs 12 to 14)
        rear = np.stack([s.total(steps.ds_m), s.total(steps.turn_rad)], axis=1)
        reading[:, Channel.FRONT :] = rear - s.front_ways
    _between_arcs(reading, perturbation, steps)
    if perturbation.reading is not None:
        reading += _turned(perturbation.reading, path.frame)
    reading[:] = _turned(reading, perturbation.turned_rad)
    return path


def _between_arcs(reading: FloatArray, perturbation: Perturbation, steps: Steps) -> None:
    place = reading[:, Channel.ALONG] + 1j * reading[:, Channel.LATERAL]
    end_arc, start_arc = perturbation.end_arc, perturbation.start_arc
    if perturbation.delay_s is not None:
        late = -np.stack(steps.motion_before_end(perturbation.delay_s), axis=1)
        start_arc = _late_start(start_arc, late, steps.s.follows)
        end_arc = late if end_arc is None else end_arc + late
    if end_arc is not None:
        way_m, turn = end_arc.T
        place = place + way_m * np.sinc(0.5 * turn / np.pi) * np.exp(1j * (reading[:, Channel.HEADING] + 0.5 * turn))
        reading[:, Channel.HEADING] += turn
    if start_arc is not None:
        way_m, turn = start_arc.T
        place = (place - way_m * np.sinc(0.5 * turn / np.pi) * np.exp(0.5j * turn)) * np.exp(-1j * turn)
        reading[:, Channel.HEADING] -= turn
    reading[:, Channel.ALONG], reading[:, Channel.LATERAL] = place.real, place.imag


def _late_start(start_arc: FloatArray | None, late: FloatArray, follows: BoolArray) -> FloatArray | None:
    return None if start_arc is None else np.where(follows[:, None], np.roll(late, 1, axis=0), start_arc)


def _turned(readings: FloatArray, angle_rad: FloatArray | None) -> FloatArray:
    if angle_rad is None:
        return readings
    c, s, turned = np.cos(angle_rad), np.sin(angle_rad), readings.copy()
    x, y = readings[:, Channel.ALONG], readings[:, Channel.LATERAL]
    turned[:, Channel.ALONG], turned[:, Channel.LATERAL] = c * x - s * y, s * x + c * y
    return turned


def signature(path: Path, perturbation: Perturbation) -> FloatArray:
    """Return what a perturbation does to the readings, to first order about a path, shape (n_obs, n_channels).

    The change of (distance, along, lateral, heading, front, steering) per unit of the parameter; along and lateral in
    the frame of the end heading.
    """
    s = path.s
    n_units, n_steps = len(s), len(s.unit)
    change = np.zeros((n_units, N_CHANNELS))
    stepwise = replace(perturbation, **dict.fromkeys(AT_ENDS))
    for number, name in enumerate(("left", "right", "track")):
        part: FloatArray | None = getattr(perturbation, name)
        if part is not None and len(part) == n_units and n_units != n_steps:
            change += path.calibration[:, :, number] * part[:, None]
            stepwise = replace(stepwise, **{name: None})
    if any(part is not None for part in stepwise.parts()):
        for units, of_units in path.parts():
            change[units] += _along_path(of_units, stepwise if path.kept is not None else stepwise.part(units, s))
    if perturbation.reading is not None:
        change += _turned(perturbation.reading, path.perturbation.turned_rad)
    _add_moved(change, path, perturbation)
    return change


def _delay_rates(path: Path) -> FloatArray:

    def rates(part: Path) -> FloatArray:
        own = part.perturbation.delay_s
        before = np.zeros(len(part.s)) if own is None else own
        motions = (part.steps.motion_before_end(delay_s) for delay_s in (before, before + DELAY_STEP_S))
        now, later = (np.stack(motion, axis=1) for motion in motions)
        return (now - later) / DELAY_STEP_S

    return path.of_parts(rates)


def _add_moved(change: FloatArray, path: Path, perturbation: Perturbation) -> None:
    moved = np.zeros(len(change), dtype=np.complex128)
    place = path.reading[:, Channel.ALONG] + 1j * path.reading[:, Channel.LATERAL]
    if perturbation.turned_rad is not None:
        moved += 1j * perturbation.turned_rad * place
    start_arc, ends = perturbation.start_arc, [perturbation.end_arc]
    if perturbation.delay_s is not None:
        late = perturbation.delay_s[:, None] * _delay_rates(path)
        start_arc = _late_start(start_arc, late, path.s.follows)
        ends.append(late)
    for arc in ends:
        if arc is not None:
            change[:, [Channel.ALONG, Channel.HEADING]] += arc
    if start_arc is not None:
        moved -= start_arc[:, 0] + 1j * start_arc[:, 1] * place
        change[:, Channel.HEADING] -= start_arc[:, 1]
    along, lateral = path.to_end_frame(moved.real, moved.imag)
    change[:, Channel.ALONG] += along
    change[:, Channel.LATERAL] += lateral


def _along_path(path: Path, perturbation: Perturbation) -> FloatArray:
    s = path.s
    sums = path.steps.sums(perturbation)
    x, y = sums[X], sums[Y]
    change = np.zeros((len(s), N_CHANNELS))
    change[:, Channel.ALONG], change[:, Channel.LATERAL] = path.to_end_frame(x, y)
    change[:, Channel.HEADING] = sums[TURN]
    change[:, Channel.DISTANCE] = np.where(np.abs(s.axis) == 1, s.axis * x, sums[LINE] * np.sign(path.way_m))
    chords = np.flatnonzero(s.axis == 2)
    if len(chords):
        end_x, end_y = path.end[chords, 0], path.end[chords, 1]
        with np.errstate(invalid="ignore", divide="ignore"):
            chord = (end_x * x[chords] + end_y * y[chords]) / np.hypot(end_x, end_y)
        change[chords, Channel.DISTANCE] = np.nan_to_num(chord)
    if s.usable[:, Channel.FRONT :].any():
        change[:, Channel.FRONT] = sums[WAY]
        change[:, Channel.STEERING] = sums[TURN]
    return _turned(change, path.perturbation.turned_rad)


def measured_gap(path: Path, nominal: Path) -> FloatArray:
    """Return measured minus predicted, shape (n_obs, n_channels), 0 where an observation lacks the channel.

    Along and lateral are in the frame of the end heading. Where an outside simulator predicted one, that takes the
    place of `nominal`, the model alone, and the hypothesis' change is added to it.
    """
    s = path.s
    gap = s.measured - np.where(np.isfinite(s.simulated), s.simulated + path.reading - nominal.reading, path.reading)
    return np.where(s.usable, np.nan_to_num(_turned(gap, -path.frame)), 0.0)


def residuals(path: Path, nominal: Path) -> FloatArray:
    """Return the gap, shape (n_obs, n_channels), as signatures to first order hold it.

    A heading that is off bends the path, which takes off its square too: of one sign in every run where radii scatter,
    and in no signature. It is given back.
    """
    s, gap = path.s, measured_gap(path, nominal)
    own = s.usable[:, Channel.HEADING] & (not s.calibration_held)
    bend = np.where(own, np.clip(gap[:, Channel.HEADING], -LARGEST_BEND_RAD, LARGEST_BEND_RAD), 0.0)
    taken = np.zeros_like(gap)
    taken[:, POSE] = bend[:, None] ** 2 * path.bent_m
    taken[:, Channel.DISTANCE] = np.where(np.abs(s.axis) == 1, s.axis * taken[:, Channel.ALONG], 0.0)
    return gap + np.where(s.usable, _turned(taken, -path.frame), 0.0)
