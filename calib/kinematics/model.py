"""Stretches of runs that are compared, and the sensor's predicted motion in each."""

from dataclasses import dataclass, fields, replace
from typing import Final

import numpy as np

from calib.errors import RefusedError
from calib.kinematics import Recording, drives, parts_seen
from calib.kinematics.drives import Path, integrate_motion, moved_between
from calib.types import BoolArray, ComplexArray, FloatArray, IntArray

#: windows as parts of a block: whole, half, quarter
LEVELS: Final = (1.0, 0.5, 0.25)
#: begin, end and level of each in a block, overlapping by half
WINDOWS: Final = np.array(
    [
        (0.5 * share * start, 0.5 * share * (start + 2), level)
        for level, share in enumerate(LEVELS)
        for start in range(round(2 / share) - 1)
    ]
).T
#: half a chord, as a part of a block: the whole is as long as the shortest window
HALF_CHORD: Final = 0.5 * LEVELS[-1]
#: chords below this part of the usual one tell a direction by mostly noise
SHORT_CHORD: Final = 0.5
#: displacements of a sensor, (n, 3), and derivatives, (n, 3, n_parameters)
Sensed = tuple[FloatArray, FloatArray, FloatArray]
#: a late reference of a vehicle that starts moves by less of its speed
ON_THE_MOVE: Final = 0.75
#: replicates differ in path and displacement by less than this share of the path, and in turn by less
REPLICATE_SHARE: Final = 0.05
REPLICATE_TURN_RAD: Final = 0.3
#: and speeds by less than this share: what is set is kept to a tenth
REPLICATE_SPEED: Final = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class Segments:
    """Stretches and what the reference says of them."""

    #: run number, first and last sample, shape (n,)
    run: IntArray
    first: IntArray
    last: IntArray
    #: displacement of the sensor in its own frame at the start: forward, left, turn, shape (n, 3)
    measured: FloatArray
    #: measured, shape (n, 3)
    seen: BoolArray
    #: stretches of one block share noise and are nested in it, shape (n,)
    block: IntArray
    #: 0 for the longest windows, shape (n,)
    level: IntArray
    #: whose turn a gyro measured, shape (n,)
    gyro: BoolArray
    #: samples of the chord that is the start's direction; one twice where headings were measured, shape (n, 2)
    around: IntArray | None = None

    def __len__(self) -> int:
        return len(self.run)

    def are_runs_of(self, recording: Recording) -> bool:
        """Return whether the stretches are whole runs."""
        return np.array_equal(self.first, recording.offsets[self.run])

    def between(self, values: FloatArray) -> FloatArray:
        """Return sums over each stretch of steps, shape (..., n_samples) in, (..., n) out."""
        total = np.cumsum(values, axis=-1)
        return total[..., self.last] - total[..., self.first]

    @property
    def chords_alone(self) -> bool:
        """Whether chords are the directions at all starts."""
        return self.around is not None and bool((np.diff(self.around) > 0).all())

    def select(self, keep: BoolArray) -> "Segments":
        """Return the stretches that `keep` picks."""
        parts = (getattr(self, column.name)[keep] for column in fields(self)[:-1])
        return replace(Segments(*parts), around=None if self.around is None else self.around[keep])


def end_pose_segments(recording: Recording) -> Segments:
    """Return each run with an end pose as one stretch.

    Raises RefusedError where no run has an end pose.
    """
    runs = np.flatnonzero(np.isfinite(recording.end_pose).any(axis=1))
    if not len(runs):
        raise RefusedError("end poses: found none; expected ref_x_m, ref_y_m, ref_theta_rad of some runs; measure them")
    measured, block, level = recording.end_pose[runs], np.arange(len(runs)), np.zeros_like(runs)
    first, last, gyro = recording.offsets[runs], recording.offsets[runs + 1] - 1, recording.by_gyro[runs]
    return Segments(runs, first, last, np.nan_to_num(measured), np.isfinite(measured), block, level, gyro)


def window_segments(recording: Recording, blocks: int) -> Segments:
    """Return windows of three lengths, overlapping by half, nested in blocks of equal travel.

    `blocks`: about how many of all runs; a run is one at least. Of positions alone windows begin where the run does,
    with heading zero; in a map the chord about their start is their direction. Raises RefusedError where the reference
    follows the vehicle nowhere.
    """
    travel = recording.travel_rad
    ends = np.array([travel[stop - 1] for stop in recording.offsets[1:]])
    length = float(ends.sum()) / max(blocks, 1)
    pieces: list[IntArray] = []
    seen: list[BoolArray] = []
    block, by_course = 0, np.zeros(len(recording), bool) if recording.by_course is None else recording.by_course
    for run in range(len(recording)):
        reference = recording.reference[:, recording.offsets[run] : recording.offsets[run + 1]]
        parts = parts_seen(reference)
        samples = np.flatnonzero(np.isfinite(reference[parts]).all(axis=0) & parts.any()) + recording.offsets[run]
        if len(samples) < 2 or length <= 0.0:
            continue
        anywhere, half = parts[2] or by_course[run], HALF_CHORD * length * by_course[run]
        n_blocks = max(1, round(float(ends[run]) / length)) if anywhere else 1
        edges = np.linspace(travel[samples[0]] + half, travel[samples[-1]], n_blocks + 1)
        mine = WINDOWS if anywhere else WINDOWS[:, WINDOWS[0] == 0.0]
        order = np.argsort(np.tile(mine[2], n_blocks), kind="stable")
        wanted = edges[:-1, None] + mine[:2, None] * np.diff(edges)[:, None]
        first, last = samples[_nearest(travel[samples], wanted.reshape(2, -1)[:, order])]
        of_block, level = np.divmod(order, mine.shape[1])
        beside = travel[first] + np.array([[-half], [half]])
        chord = samples[_nearest(travel[samples], beside)] if half else (first, first)
        same = np.full_like(first, run)
        piece = np.stack([same, first, last, block + of_block, mine[2, level].astype(int), *chord])[:, last > first]
        seen.append(np.repeat(parts[None], piece.shape[1], axis=0))
        pieces.append(piece)
        block += n_blocks
    if not sum(piece.shape[1] for piece in pieces):
        text = "windows: found no reference along the path"
        raise RefusedError(f"{text}; expected ref_x_m, ref_y_m, ref_theta_rad in logs; use end poses instead")
    run_of, first, last, block_of, level_of, *around = np.concatenate(pieces, axis=1)
    no_gyro, course = np.zeros(len(first), dtype=np.bool_), by_course[run_of]
    chords = np.stack(around, axis=1) if course.any() else None
    measured = measured_between(recording.reference, first, last, chords)
    segments = Segments(run_of, first, last, measured, np.concatenate(seen), block_of, level_of, no_gyro, chords)
    if chords is None:
        return segments
    size = np.hypot(*np.diff(recording.reference[:2, chords], axis=2)[..., 0])
    return segments.select(~course | (size >= SHORT_CHORD * np.median(size[course])))


def measured_between(reference: FloatArray, first: IntArray, last: IntArray, around: IntArray | None) -> FloatArray:
    """Return displacements by the reference, shape (n, 3), in the frames of the headings or chords at their start."""
    pose = np.nan_to_num(reference)
    moved = moved_between(pose, first, last)
    if around is None:
        return moved
    chord = np.diff(pose[0, around] + 1j * pose[1, around])[:, 0]
    return _parts((moved[:, 0] + 1j * moved[:, 1]) * _back(chord), moved[:, 2])


def _back(chord: ComplexArray) -> ComplexArray:
    return np.asarray(np.exp(-1j * np.angle(chord)))


def _nearest(travel: FloatArray, wanted: FloatArray) -> IntArray:
    after = np.clip(np.searchsorted(travel, wanted), 1, len(travel) - 1)
    return after - (wanted - travel[after - 1] < travel[after] - wanted)


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Residuals, their derivatives, and the path behind them."""

    #: measured less predicted displacement; 0 where nothing was measured, shape (n, 3)
    residuals: FloatArray
    #: derivatives of the prediction by drive parameters, sensor pose and delay, shape (n, 3, n_parameters)
    jacobian: FloatArray
    path: Path


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """A drive, a recording and stretches of it: predicts at any parameter values.

    Parameters are those of the drive, then those of `SENSOR`.
    """

    drive: drives.Drive
    recording: Recording
    segments: Segments

    def motion(self, values: FloatArray) -> drives.Motion:
        """Return the motion of the body in each step at `values`, shape (n_parameters,)."""
        motion = self.drive.motion(values[: -len(drives.SENSOR)], self.recording.steps)
        motion.body[1] += self.recording.steps.aside_m
        return motion

    def predict(self, values: FloatArray, *, path: Path | None = None, by_drive: bool = True) -> Prediction:
        """Return residuals and derivatives at `values`, shape (n_parameters,); `path`: the drive's there, if known.

        Without `by_drive` derivatives are by sensor and delay alone.
        """
        path = path or integrate_motion(self.motion(values))
        at_times = _at_times(path, self.recording, self.segments, float(values[-1]), by_drive=by_drive)
        pose, by_parameter, (first, *others) = at_times
        n_drive = len(by_parameter) - 1
        moved = (_displacement(pose, by_parameter, first, other) for other in others)
        seen, through, by_sensor = _along_chord(*(_sensor(*one, values[-4:-1]) for one in moved))
        by_gyro = np.zeros((len(seen), 3, 1))
        by_gyro[:, 2, 0] = np.where(self.segments.gyro, seen[:, 2], 0.0)
        jacobian = np.concatenate([through[:, :, :n_drive], by_gyro, by_sensor, through[:, :, n_drive:]], axis=2)
        scale = np.where(self.segments.gyro, values[-len(drives.SENSOR)], 1.0)
        jacobian[:, 2, np.arange(jacobian.shape[2]) != n_drive] *= scale[:, None]
        seen[:, 2] *= scale
        residuals = self.segments.measured - seen
        unseen = ~self.segments.seen
        residuals[unseen] = 0.0
        jacobian[unseen] = 0.0
        return Prediction(residuals, jacobian, path)

    def residuals(self, values: FloatArray) -> FloatArray:
        """Return residuals alone."""
        return self.predict(values, by_drive=False).residuals

    def turns(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the headings' residuals, shape (n,), and derivatives, (n, n_parameters); no path is integrated."""
        motion, segments, t_s = self.motion(values), self.segments, self.recording.t_s
        low, high = self.recording.offsets[segments.run], self.recording.offsets[segments.run + 1] - 1
        total = np.cumsum(np.vstack([motion.body[2], motion.by_parameter()[:, 2]]), axis=1)
        turn, *by = total[:, segments.last] - total[:, segments.first]
        by_delay = np.subtract(*(_velocity(total[0], t_s, at, low, high) for at in (segments.first, segments.last)))
        scale, delayed = np.where(segments.gyro, values[-5], 1.0), turn + values[-1] * by_delay
        by_sensor = [segments.gyro * delayed, *np.zeros((3, len(turn))), scale * by_delay]
        jacobian = np.stack([*(scale * each for each in by), *by_sensor], axis=1)
        seen = segments.seen[:, 2]
        return seen * (segments.measured[:, 2] - scale * delayed), seen[:, None] * jacobian


def _at_times(
    path: Path, recording: Recording, segments: Segments, delay_s: float, *, by_drive: bool
) -> tuple[FloatArray, FloatArray, list[IntArray]]:
    # what the reference stamps t was true at t - delay; before the first count the vehicle moved as after it, where
    ends = [segments.first, segments.last, *(() if segments.around is None else segments.around.T)]
    used, inverse = np.unique(ends, return_inverse=True)
    places = list(inverse.reshape(len(ends), -1))
    run = recording.run[used]
    low, high = recording.offsets[run], recording.offsets[run + 1] - 1
    t_s = recording.t_s
    delay = delay_s + recording.delay_added_s[run] + recording.clock_rate * t_s[used]
    wanted = np.clip(t_s[used] - delay, t_s[low], t_s[high])
    # a time that steps back stands still there, or the search fails in all other runs
    shift = np.concatenate(([0.0], np.cumsum(np.maximum.reduceat(t_s, recording.offsets[:-1]) + 1.0)))[:-1]
    clock = np.maximum.accumulate(t_s + shift[recording.run])
    at = np.clip(np.searchsorted(clock, wanted + shift[run], side="right") - 1, low, np.maximum(high - 1, low))
    near = np.clip(at + np.arange(-1, 3)[:, None], low, high)
    weights = _between(t_s[near], wanted)
    before, after = np.maximum(at - 2, low), np.minimum(at + 3, high)
    per_s = 1.0 / np.where(t_s[after] > t_s[before], t_s[after] - t_s[before], np.inf)
    pose = np.einsum("pin,in->pn", path.pose[:, near], weights)
    velocity, seen = ((each[:, after] - each[:, before]) * per_s for each in (path.pose, recording.reference))
    moved = np.hypot(*seen[:2]) > ON_THE_MOVE * np.hypot(*velocity[:2])
    before_s = np.where(moved, np.minimum(t_s[used] - delay - wanted, 0.0), 0.0)
    by_parameter = np.zeros((0, *pose.shape))
    if by_drive:
        samples, inverse = np.unique([*near, before, after], return_inverse=True)
        *by_near, by_before, by_after = np.moveaxis(path.by_parameter(samples)[..., inverse], -2, 0)
        by_parameter = np.einsum("ikpn,in->kpn", by_near, weights) + before_s * (by_after - by_before) * per_s
    return pose + before_s * velocity, np.concatenate([by_parameter, -velocity[None]]), places


def _between(t_s: FloatArray, wanted_s: FloatArray) -> FloatArray:
    # weights of a cubic between the inner two samples: a chord would cut curves
    before, span, after = np.diff(t_s, axis=0)
    span = np.where(span > 0.0, span, np.inf)
    share = (wanted_s - t_s[1]) / span
    begin, end = share * (1.0 - share) ** 2 / (1.0 + before / span), share**2 * (share - 1.0) / (1.0 + after / span)
    step = share - begin * before / span - end * after / span
    return np.stack([-begin, 1.0 + begin - step, step - end, end])


def _velocity(pose: FloatArray, t_s: FloatArray, at: IntArray, low: IntArray, high: IntArray) -> FloatArray:
    before, after = np.maximum(at - 2, low), np.minimum(at + 3, high)
    span = t_s[after] - t_s[before]
    return (pose[..., after] - pose[..., before]) / np.where(span > 0.0, span, np.inf)


def _displacement(
    pose: FloatArray, by_parameter: FloatArray, first: IntArray, last: IntArray
) -> tuple[FloatArray, FloatArray]:
    # with derivatives, (n_segments, 3, n_parameters), by those of the poses, (n_parameters, 3, n)
    moved = moved_between(pose, first, last)
    cosine, sine = np.cos(pose[2, first]), np.sin(pose[2, first])
    d_delta = by_parameter[:, :, last] - by_parameter[:, :, first]
    d_start = by_parameter[:, 2][:, first]
    d_forward = cosine * d_delta[:, 0] + sine * d_delta[:, 1] + moved[:, 1] * d_start
    d_left = cosine * d_delta[:, 1] - sine * d_delta[:, 0] - moved[:, 0] * d_start
    return moved, np.stack([d_forward, d_left, d_delta[:, 2]]).transpose(2, 0, 1)


def _sensor(moved: FloatArray, derivative: FloatArray, place: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    lever, back, turned = place[0] + 1j * place[1], np.exp(-1j * place[2]), np.exp(1j * moved[:, 2])
    seen = back * (moved[:, 0] + 1j * moved[:, 1] + (turned - 1.0) * lever)
    by_motion = derivative[:, 0] + 1j * derivative[:, 1] + (1j * turned * lever)[:, None] * derivative[:, 2]
    by_lever = back * (turned - 1.0)
    by_sensor = np.stack([by_lever, 1j * by_lever, -1j * seen], axis=1)
    parts = _parts(back * by_motion, derivative[:, 2]), _parts(by_sensor, np.zeros(by_sensor.shape))
    return np.stack([seen.real, seen.imag, moved[:, 2]], axis=1), *parts


def _along_chord(seen: Sensed, *chord: Sensed) -> Sensed:
    if not chord:
        return seen
    (way, *by), (begin, *by_begin), (end, *by_end) = (
        [one[:, 0] + 1j * one[:, 1] for one in of] for of in (seen, *chord)
    )
    back, size = _back(end - begin), np.where(end == begin, 1.0, end - begin)[:, None]
    turned = (((two - one) / size).imag for one, two in zip(by_begin, by_end, strict=True))
    by = [back[:, None] * (one - 1j * way[:, None] * turn) for one, turn in zip(by, turned, strict=True)]
    through, by_sensor = (_parts(one, of[:, 2]) for one, of in zip(by, seen[1:], strict=True))
    return _parts(way * back, seen[0][:, 2]), through, by_sensor


def _parts(place: ComplexArray, turn: FloatArray) -> FloatArray:
    return np.stack([place.real, place.imag, turn], axis=1)


def replicates(whole: Model, way_m: FloatArray, load_width_N: float | None = None) -> IntArray:
    """Return each segment's group of replicates, shape (n,): of like motion; with `load_width_N` in speed, load too."""
    by_wheels = whole.segments.measured - whole.residuals(drives.nominal_values(whole.drive))
    steps, lapse_s = whole.recording.steps, np.maximum(np.diff(whole.recording.t_s, prepend=0.0), 1e-3)
    rolled = np.abs(steps.turned_rad).mean(axis=0)
    total = np.maximum(whole.segments.between(rolled), 1e-9)
    speed = whole.segments.between(rolled**2 / lapse_s) / total
    load_N = whole.segments.between(rolled * (np.zeros((1, 1)) if (n := steps.load_offset_N) is None else n)) / total
    group = np.full(len(way_m), -1, dtype=np.int64)
    while (group < 0).any():
        at = int(np.argmin(group))
        near = np.abs(way_m - way_m[at]) < REPLICATE_SHARE * way_m[at]
        near &= np.hypot(*(by_wheels[:, :2] - by_wheels[at, :2]).T) < REPLICATE_SHARE * way_m[at]
        near &= np.abs(by_wheels[:, 2] - by_wheels[at, 2]) < REPLICATE_TURN_RAD
        if load_width_N is not None:
            near &= np.abs(speed - speed[at]) < REPLICATE_SPEED * speed[at]
            near &= (np.abs(load_N - load_N[:, [at]]) < load_width_N).all(axis=0)
        group[near & (group < 0)] = at
        group[at] = at
    return group
