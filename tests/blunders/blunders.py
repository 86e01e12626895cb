"""Mistakes that people make with recordings, each as a change of a sound one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from tests.blunders.plant import COUNTS_PER_REV, NOMINAL_RADIUS_M, NOMINAL_TRACK_M, Array, Recording, Run

Change = Callable[[Recording], None]
COUNTS: Final = ("counts_left", "counts_right")


def each_reference(change: Callable[[Array], Array]) -> Change:
    """Return a change of every reference pose, shape (n, 3), along the runs and at their ends."""

    def altered(recording: Recording) -> None:
        for run in recording.runs:
            _change_reference(run, change)

    return altered


def _change_reference(run: Run, change: Callable[[Array], Array]) -> None:
    names = ("ref_x_m", "ref_y_m", "ref_theta_rad")
    poses = change(np.stack([run.log[name] for name in names], axis=1))
    run.log |= dict(zip(names, poses.T, strict=True))
    run.end = change(run.end[None, :])[0]


def each_column(names: tuple[str, ...], change: Callable[[Array], Array]) -> Change:
    """Return a change of columns of every log."""

    def altered(recording: Recording) -> None:
        for run in recording.runs:
            for name in names:
                run.log[name] = change(run.log[name])

    return altered


def axes_turned(degrees: float) -> Change:
    """Return a reference whose axes are turned against the vehicle's start heading."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return each_reference(lambda p: np.column_stack([c * p[:, 0] - s * p[:, 1], s * p[:, 0] + c * p[:, 1], p[:, 2]]))


def columns_times(x: float, y: float, theta: float) -> Change:
    """Return reference columns times factors: units and mirrored axes."""
    return each_reference(lambda p: p * np.array([x, y, theta]))


def counts_times(left: float, right: float) -> Change:
    """Return counts times factors: counts per revolution, units, signs."""

    def altered(recording: Recording) -> None:
        for run in recording.runs:
            for name, factor in zip(COUNTS, (left, right), strict=True):
                run.log[name] = run.log[name] * factor

    return altered


def _swapped(recording: Recording) -> None:
    for run in recording.runs:
        run.log["counts_left"], run.log["counts_right"] = run.log["counts_right"], run.log["counts_left"]


def _wrapped(modulus: float, names: tuple[str, ...] = COUNTS) -> Change:
    return each_column(names, lambda column: np.mod(column, modulus))


def _after_start(poses: Array) -> Array:
    """Return the share of the run driven at each pose, 1 for an end pose alone."""
    return np.linspace(0.0 if len(poses) > 1 else 1.0, 1.0, len(poses))


def _turn_in_one_run(recording: Recording) -> None:
    turn = [0.0, 0.0, 2 * np.pi]
    _change_reference(recording.runs[4], lambda p: p + np.outer(np.ceil(_after_start(p)), turn))


def _one_bad_run_of_five(recording: Recording) -> None:
    del recording.runs[5:]
    _change_reference(recording.runs[2], lambda p: p + np.array([0.5, -0.3, 0.0]))


def _strafing(recording: Recording) -> None:
    """Every run also moves sideways by a tenth to a half of a metre, which two wheels cannot do."""
    for number, run in enumerate(recording.runs):
        sideways = [0.0, 0.1 + 0.1 * (number % 5), 0.0]
        _change_reference(run, lambda p, sideways=sideways: p + np.outer(_after_start(p), sideways))


def _late(seconds: float) -> Change:
    def altered(recording: Recording) -> None:
        for run in recording.runs:
            n = round(seconds / (run.log["t_s"][1] - run.log["t_s"][0]))
            for name in ("ref_x_m", "ref_y_m", "ref_theta_rad"):
                column = run.log[name]
                run.log[name] = np.concatenate([np.full(n, column[0]), column[:-n]])
            run.end = np.array([run.log[name][-1] for name in ("ref_x_m", "ref_y_m", "ref_theta_rad")])

    return altered


def _references_of_other_runs(recording: Recording) -> None:
    ends = [run.end for run in recording.runs]
    logs = [{name: run.log[name] for name in ("ref_x_m", "ref_y_m", "ref_theta_rad")} for run in recording.runs]
    for number, run in enumerate(recording.runs):
        other = (number + 1) % len(recording.runs)
        n = len(run.log["t_s"])
        run.end = ends[other]
        for name, column in logs[other].items():
            run.log[name] = np.pad(column, (0, max(n - len(column), 0)), mode="edge")[:n]


def _setting(section: str, key: str, value: object) -> Change:
    def altered(recording: Recording) -> None:
        recording.settings.setdefault(section, {})[key] = value

    return altered


def _rounded_metres(recording: Recording) -> None:
    each_reference(lambda p: np.round(p, 0))(recording)


def _half_of_the_runs(change: Change) -> Change:
    """Return a change of every second run: two people, or two days, with other settings."""

    def altered(recording: Recording) -> None:
        change(Recording(recording.runs[1::2], recording.drive, recording.settings))

    return altered


def _counter_reset(recording: Recording) -> None:
    """Every counter starts again from zero halfway."""
    for run in recording.runs:
        for name in COUNTS:
            half = len(run.log[name]) // 2
            run.log[name][half:] -= run.log[name][half]


def _samples_lost(recording: Recording) -> None:
    """A tenth of a second of counts is lost every second: the totals fall behind."""
    for run in recording.runs:
        kept = np.arange(len(run.log["t_s"])) % 20 >= 2
        for name in COUNTS:
            run.log[name] = np.cumsum(np.diff(run.log[name], prepend=0.0) * kept)


def _unsigned(recording: Recording) -> None:
    """One channel of each encoder is read: steps are counted, their direction is not."""
    each_column(COUNTS, lambda c: np.cumsum(np.abs(np.diff(c, prepend=c[0]))))(recording)


def _one_for_both(recording: Recording) -> None:
    for run in recording.runs:
        run.log["counts_left"] = run.log["counts_right"].copy()


def _own_odometry(recording: Recording) -> None:
    """The reference was computed from the counts, by the nominal vehicle."""
    for run in recording.runs:
        left, right = (np.diff(run.log[name], prepend=0.0) * _METRES_PER_COUNT for name in COUNTS)
        turn = (right - left) / NOMINAL_TRACK_M
        theta = np.cumsum(turn)
        x, y = (np.cumsum(0.5 * (left + right) * f(theta - 0.5 * turn)) for f in (np.cos, np.sin))
        run.log |= {"ref_x_m": x, "ref_y_m": y, "ref_theta_rad": theta}
        run.end = np.array([x[-1], y[-1], theta[-1]])


def _in_a_map(recording: Recording) -> None:
    """End poses in the hall's frame, each run from another start, taken for the run's own."""
    rng = np.random.default_rng(5)
    for run in recording.runs:
        x, y, theta = rng.uniform(-3.0, 3.0, 3)
        c, s = np.cos(theta), np.sin(theta)
        place = np.array([x, y, theta])
        _change_reference(run, lambda p, c=c, s=s, at=place: p @ [[c, s, 0], [-s, c, 0], [0, 0, 1]] + at)


def _ends_at_the_start(recording: Recording) -> None:
    for run in recording.runs:
        _change_reference(run, lambda p: p[:1] + 0.0 * p)
        run.end = 0.0 * run.end


def _slow_clock(recording: Recording) -> None:
    """The reference's clock loses a tenth: its poses are those of a later time."""
    for run in recording.runs:
        t_s = run.log["t_s"]
        for name in ("ref_x_m", "ref_y_m", "ref_theta_rad"):
            run.log[name] = np.interp(0.9 * t_s, t_s, run.log[name])
        run.end = np.array([run.log[name][-1] for name in ("ref_x_m", "ref_y_m", "ref_theta_rad")])


def _backwards_in_time(recording: Recording) -> None:
    """The reference's file is sorted the other way round."""
    for run in recording.runs:
        for name in ("ref_x_m", "ref_y_m", "ref_theta_rad"):
            run.log[name] = run.log[name][::-1].copy()
        run.end = np.array([run.log[name][-1] for name in ("ref_x_m", "ref_y_m", "ref_theta_rad")])


def _marker_turned(recording: Recording) -> None:
    """The marker is glued on at 40 degrees and its yaw is given as the vehicle's at the end, not at the start."""
    for run in recording.runs:
        run.log["ref_theta_rad"][1:] += 0.7
        run.end = run.end + np.array([0.0, 0.0, 0.7])


def _with_play(play_rad: float) -> Change:
    """Return steering whose wheel follows its sensor with a play: the sensor is ahead of it by half of that."""

    def ahead(angle: Array) -> Array:
        change = np.diff(angle, prepend=0.0)
        last = np.maximum.accumulate(np.where(change != 0.0, np.arange(len(angle)), 0))
        return angle + 0.5 * play_rad * np.sign(change[last])

    return each_column(("steer_rad",), ahead)


_METRES_PER_COUNT: Final = 2 * np.pi * NOMINAL_RADIUS_M / COUNTS_PER_REV
_RADIANS_PER_COUNT: Final = 2 * np.pi / COUNTS_PER_REV

#: blunders of a differential drive
DIFFERENTIAL: Final[dict[str, Change]] = {
    "axes turned by 30 degrees": axes_turned(30.0),
    "axes turned by 10 degrees": axes_turned(10.0),
    "axes turned by 2 degrees": axes_turned(2.0),
    "axes turned by 90 degrees": axes_turned(90.0),
    "axes turned by 180 degrees": axes_turned(180.0),
    "y mirrored": columns_times(1.0, -1.0, 1.0),
    "x mirrored": columns_times(-1.0, 1.0, 1.0),
    "y and heading mirrored": columns_times(1.0, -1.0, -1.0),
    "heading clockwise": columns_times(1.0, 1.0, -1.0),
    "x and y exchanged": each_reference(lambda p: p[:, [1, 0, 2]]),
    "positions in millimetres": columns_times(1e3, 1e3, 1.0),
    "positions in centimetres": columns_times(1e2, 1e2, 1.0),
    "positions in feet": columns_times(1 / 0.3048, 1 / 0.3048, 1.0),
    "positions in inches": columns_times(1 / 0.0254, 1 / 0.0254, 1.0),
    "x alone in millimetres": columns_times(1e3, 1.0, 1.0),
    "heading in degrees": columns_times(1.0, 1.0, 180.0 / np.pi),
    "heading in turns": columns_times(1.0, 1.0, 0.5 / np.pi),
    "heading zero throughout": columns_times(1.0, 1.0, 0.0),
    "reference frozen": columns_times(0.0, 0.0, 0.0),
    "positions rounded to metres": _rounded_metres,
    "references of other runs": _references_of_other_runs,
    "reference 5 s late": _late(5.0),
    "wheel angles in radians read as counts": counts_times(_RADIANS_PER_COUNT, _RADIANS_PER_COUNT),
    "wheel ways in metres read as counts": counts_times(_METRES_PER_COUNT, _METRES_PER_COUNT),
    "wheel turns read as counts": counts_times(1 / COUNTS_PER_REV, 1 / COUNTS_PER_REV),
    "left wheel in radians": counts_times(_RADIANS_PER_COUNT, 1.0),
    "increments read as counts": each_column(COUNTS, lambda c: np.diff(c, prepend=c[0])),
    "increments of the left wheel": each_column(COUNTS[:1], lambda c: np.diff(c, prepend=c[0])),
    "absolute encoder, not unwrapped": _wrapped(COUNTS_PER_REV),
    "absolute encoder of the right wheel, not unwrapped": _wrapped(COUNTS_PER_REV, COUNTS[1:]),
    "16 bit counter, not unwrapped": _wrapped(2.0**14),
    "counts of left and right exchanged": _swapped,
    "left counts negative": counts_times(-1.0, 1.0),
    "both counts negative": counts_times(-1.0, -1.0),
    "counts per revolution half": counts_times(2.0, 2.0),
    "counts per revolution a quarter": counts_times(4.0, 4.0),
    "counts per revolution double": counts_times(0.5, 0.5),
    "left counts per revolution half": counts_times(2.0, 1.0),
    "counts per revolution 20 % off": counts_times(1.2, 1.2),
    "left counts stay at zero": counts_times(0.0, 1.0),
    "heading off by a turn in one run": _turn_in_one_run,
    "a robot that strafes": _strafing,
    "one bad run of five": _one_bad_run_of_five,
    "half the track as track": _setting("vehicle", "track_m", NOMINAL_TRACK_M / 2),
    "track in millimetres": _setting("vehicle", "track_m", NOMINAL_TRACK_M * 1e3),
    "diameter as radius": _setting("vehicle", "wheel_radius_m", NOMINAL_RADIUS_M * 2),
    "time in milliseconds": each_column(("t_s",), lambda t: t * 1e3),
    "every second run in millimetres": _half_of_the_runs(columns_times(1e3, 1e3, 1.0)),
    "heading of every second run in degrees": _half_of_the_runs(columns_times(1.0, 1.0, 180.0 / np.pi)),
    "wheels exchanged in every second run": _half_of_the_runs(_swapped),
    "y mirrored in every second run": _half_of_the_runs(columns_times(1.0, -1.0, -1.0)),
    "left wheel 5 % larger in every second run": _half_of_the_runs(counts_times(1 / 1.05, 1.0)),
    "counters reset halfway": _counter_reset,
    "a tenth of the counts lost": _samples_lost,
    "counts without direction": _unsigned,
    "right counts in both columns": _one_for_both,
    "reference by the vehicle's own odometry": _own_odometry,
    "end poses in the hall's frame": _in_a_map,
    "end poses of the start": _ends_at_the_start,
    "reference's clock 10 % slow": _slow_clock,
    "reference sorted backwards": _backwards_in_time,
    "marker turned after the start": _marker_turned,
    "heading as the quaternion's z": each_reference(lambda p: np.column_stack([p[:, :2], np.sin(0.5 * p[:, 2])])),
    "y of a camera squeezed by 8 %": columns_times(1.0, 0.92, 1.0),
    "positions in degrees of latitude": columns_times(1 / 111_111.0, 1 / 111_111.0, 1.0),
    "counts of the motor's shaft": counts_times(20.0, 20.0),
    "wheelbase as track": _setting("vehicle", "track_m", 0.40),
    "radius in inches": _setting("vehicle", "wheel_radius_m", NOMINAL_RADIUS_M / 0.0254),
    "signed 16 bit counter, not unwrapped": each_column(COUNTS, lambda c: np.mod(c + 2.0**15, 2.0**16) - 2.0**15),
}

#: blunders of a tricycle
TRICYCLE: Final[dict[str, Change]] = {
    "steering in degrees": each_column(("steer_rad",), np.degrees),
    "steering reversed": each_column(("steer_rad",), lambda a: -a),
    "steering in increments": each_column(("steer_rad",), lambda a: np.diff(a, prepend=a[0])),
    "absolute steering encoder that wraps": each_column(("steer_rad",), lambda a: np.mod(a, 0.5)),
    "front counts wrap": _wrapped(COUNTS_PER_REV, ("counts_front",)),
    "front counts in radians": each_column(("counts_front",), lambda c: c * _RADIANS_PER_COUNT),
    "tricycle axes turned by 30 degrees": axes_turned(30.0),
    "tricycle positions in millimetres": columns_times(1e3, 1e3, 1.0),
    "wheelbase in centimetres": _setting("vehicle", "wheelbase_m", 40.0),
    "steering stays at zero": each_column(("steer_rad",), lambda a: 0.0 * a),
    "steering of the motor's shaft": each_column(("steer_rad",), lambda a: 12.0 * a),
    "steering 0.3 rad off its zero": each_column(("steer_rad",), lambda a: a + 0.3),
    "steering as its tangent": each_column(("steer_rad",), np.tan),
    "steering with a play of 0.02 rad": _with_play(0.02),
    "steering with a play of 0.06 rad": _with_play(0.06),
}
