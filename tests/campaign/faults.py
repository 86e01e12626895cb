"""Faults of a campaign, each a change of a sound one, beside the check that must find it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from calib.campaign.model import Campaign, Logs
from calib.campaign.settings import WHEEL_LOADS, Encoder
from tests.campaign.making import campaign, wandering, with_log_columns, with_numbers

Fault = Callable[[Campaign], Campaign]


def number(name: str, change: Callable[[np.ndarray], object], run: int | None = None) -> Fault:
    def make(made: Campaign) -> Campaign:
        column = made.runs.number(name).copy()
        if run is None:
            column = np.asarray(change(column), dtype=float)
        else:
            column[run] = change(column[run])
        return with_numbers(made, **{name: column})

    return make


def _log(name: str, change: Callable[[np.ndarray], None], run: int = 3) -> Fault:
    def make(made: Campaign) -> Campaign:
        column = made.logs.columns[name].copy()
        change(column[made.logs.offsets[run] : made.logs.offsets[run + 1]])
        return with_log_columns(made, **{name: column})

    return make


def _loads(first: int, value: float, *sides: str) -> Fault:
    def make(made: Campaign) -> Campaign:
        names = [f"load_{side}_N" for side in sides or ("left", "right")]
        columns = {name: np.repeat(made.runs.number(name), made.logs.lengths) for name in names}
        for column in columns.values():
            column[made.logs.offsets[3] + first : made.logs.offsets[4]] = value
        return replace(made, logs=replace(made.logs, columns={**made.logs.columns, **columns}))

    return make


def without_logs(made: Campaign) -> Campaign:
    return replace(made, logs=Logs.empty(len(made.runs)))


def _labelled(made: Campaign, **labels: np.ndarray) -> Campaign:
    return replace(made, runs=replace(made.runs, labels={**made.runs.labels, **labels}))


def steered_by_itself(made: Campaign) -> Campaign:
    """Both wheels alike to within a count at all loads."""
    return with_numbers(
        without_logs(made), counts_right=made.runs.number("counts_left") + np.arange(len(made.runs)) % 2
    )


def _law_of_others(made: Campaign) -> Campaign:
    """A model with the law of rear wheels, of which none is counted."""
    logs = made.logs.columns
    steer = {"counts_front": logs["counts_left"], "steer_rad": np.zeros(len(logs["t_s"]))}
    blank = {f"counts_{side}": np.full(len(made.runs), np.nan) for side in ("left", "right")}
    kept = {name: column for name, column in logs.items() if name not in blank}
    model = replace(made.model, slope_left_m_per_N=1e-6, slope_right_m_per_N=1e-6)
    return with_numbers(replace(made, model=model, logs=replace(made.logs, columns=kept | steer)), **blank)


def warmer_each_session(made: Campaign, within_K: float = 0.0) -> Campaign:
    """Each session 2 K warmer than the one before, the runs within it by `within_K`."""
    number = np.arange(len(made.runs))
    return with_numbers(made, temperature_C=18.0 + 2.0 * (number // 6) + within_K * (number % 6 - 2.5))


def faster_back(made: Campaign) -> Campaign:
    return with_numbers(made, speed_mps=np.where(made.runs.label("direction") == "back", 0.6, 0.3))


def _swap(made: Campaign, runs: slice, names: tuple[str, str] = ("counts_left", "counts_right")) -> Campaign:
    left, right = (made.runs.number(name).copy() for name in names)
    left[runs], right[runs] = right[runs].copy(), left[runs].copy()
    return with_numbers(made, **dict(zip(names, (left, right), strict=True)))


def _heading_a_turn_off(made: Campaign) -> Campaign:
    """Squares of one turn each, and one heading without it."""
    turn = np.full(len(made.runs), 2 * np.pi)
    per_rad = made.encoder.counts_per_rev_left / (2 * np.pi)
    more = turn * made.vehicle.track_m / made.vehicle.wheel_radius_m * per_rad
    heading = turn.copy()
    heading[4] = 0.0
    return with_numbers(made, counts_right=made.runs.number("counts_left") + more, ref_theta_rad=heading)


def _single_precision(made: Campaign) -> Campaign:
    """Positions about a map's origin 5,500 km away, as a log of single precision holds them."""
    east_m = 5.5e6 + np.linspace(0.0, 7.0, len(made.runs)) ** 2
    return with_numbers(made, ref_x_m=np.asarray(east_m, dtype=np.float32).astype(np.float64))


def _two_places(made: Campaign) -> Campaign:
    """Positions in single precision of which half a metre is the last digit: two values for all runs."""
    return with_numbers(made, ref_x_m=40.0 + 0.5 * (np.arange(len(made.runs)) % 2))


def _wrapped(made: Campaign) -> Campaign:
    return with_numbers(without_logs(made), counts_left=np.mod(made.runs.number("counts_left"), 2**16))


def scaled(factor: float) -> Fault:
    return lambda made: with_numbers(without_logs(made), counts_right=made.runs.number("counts_right") * factor)


def turning(sign: float) -> Fault:
    def make(made: Campaign) -> Campaign:
        n = len(made.runs)
        left = np.full(n, 4096.0 * 5)
        return with_numbers(
            without_logs(made),
            counts_left=left,
            counts_right=left + 4096 * 0.7 * 1.6 / (2 * np.pi * 0.1),
            ref_theta_rad=np.full(n, sign * 1.6),
            distance_m=np.full(n, np.nan),
            ref_x_m=np.full(n, 2.0),
        )

    return make


def _clockwise_by_name(made: Campaign) -> Campaign:
    turned = with_numbers(turning(1.0)(made), ref_theta_rad=np.full(len(made.runs), np.nan))
    return _labelled(turned, kind=np.full(len(made.runs), "square_cw"))


def _steered(made: Campaign) -> Campaign:
    """Left arcs of 1 m/s, with the steering angle of right arcs."""
    time = made.logs.columns["t_s"]
    left = np.floor(time * 6000)
    return with_log_columns(
        made, counts_left=left, counts_right=left + np.floor(time * 900), steer_rad=np.full(len(time), -0.3)
    )


def _sessions_of_one_load(_: Campaign) -> Campaign:
    return campaign(crossed=False)


def _one_session_rising(_: Campaign) -> Campaign:
    made = campaign(crossed=False)
    return _labelled(made, session=np.full(len(made.runs), "s1"))


def _sessions_rising(_: Campaign) -> Campaign:
    """Three sessions, each with all loads in rising order."""
    made = without_logs(campaign(crossed=False))
    third = np.arange(len(made.runs)) % 3
    made = _labelled(made, session=np.char.add("s", third.astype(str)))
    order = np.argsort(third, kind="stable")
    runs = replace(
        made.runs,
        labels={name: column[order] for name, column in made.runs.labels.items()},
        numbers={name: column[order] for name, column in made.runs.numbers.items()},
    )
    return replace(made, runs=runs)


def _gap(made: Campaign) -> Campaign:
    keep = np.ones(int(made.logs.offsets[-1]), dtype=bool)
    keep[made.logs.offsets[3] + 400 : made.logs.offsets[3] + 460] = False
    lengths = np.add.reduceat(keep, made.logs.offsets[:-1])
    return replace(
        made,
        logs=Logs(
            np.concatenate(([0], np.cumsum(lengths))).astype(np.int64),
            {name: column[keep] for name, column in made.logs.columns.items()},
        ),
    )


def _jump_later(amount: float) -> Callable[[np.ndarray], None]:
    def change(time: np.ndarray) -> None:
        time[700:] += amount

    return change


def _count_jump(counts: np.ndarray) -> None:
    counts[700:] += 5000


def _pasted(made: Campaign) -> Campaign:
    columns = {name: made.runs.number(name).copy() for name in ("distance_m", "counts_left", "counts_right")}
    for column in columns.values():
        column[7] = column[2]
    return with_numbers(made, **columns)


def _track_in_mm(made: Campaign) -> Campaign:
    return replace(made, model=replace(made.model, track_m=700.0))


def _ranged(made: Campaign, *, cut: float) -> Campaign:
    lengths = made.logs.lengths
    share = np.concatenate([np.linspace(0, 1, m) for m in lengths])
    return with_log_columns(made, range_m=share * np.repeat(made.runs.number("distance_m"), lengths) * cut)


def _mirrored(made: Campaign) -> Campaign:
    return with_numbers(made, ref_y_m=-made.runs.number("ref_y_m"))


def _longer(made: Campaign) -> Campaign:
    made = wandering(made)
    return with_numbers(made, distance_m=made.runs.number("distance_m") + 0.05)


def _longer_in_a_session(made: Campaign) -> Campaign:
    made = wandering(made)
    longer = np.where(made.runs.label("session") == "s2", 1.01, 1.0)
    return with_numbers(made, distance_m=made.runs.number("distance_m") * longer)


def _poses_of_two_runs(made: Campaign) -> Campaign:
    """The end pose of run 4 lies where a run 0.4 m longer ends."""
    made = wandering(made)
    x = made.runs.number("ref_x_m").copy()
    x[4] += 0.4
    return with_numbers(made, ref_x_m=x)


def _with_sigma(**sigma: float) -> Fault:
    return lambda made: replace(wandering(made), reference=replace(made.reference, **sigma))


def _with_reference_load(load_N: float) -> Fault:
    return lambda made: replace(made, model=replace(made.model, reference_load_N=load_N))


def _exchanged_axes(made: Campaign) -> Campaign:
    made = wandering(made)
    return with_numbers(made, ref_x_m=made.runs.number("ref_y_m"), ref_y_m=made.runs.number("ref_x_m"))


def _headings_off(made: Campaign) -> Campaign:
    """By 0.02 rad, in one session."""
    made = wandering(made)
    more = np.where(made.runs.label("session") == "s2", 0.02, 0.0)
    return with_numbers(made, ref_theta_rad=made.runs.number("ref_theta_rad") + more)


def _sensor_said_to_be_turned(made: Campaign) -> Campaign:
    return replace(wandering(made), reference=replace(made.reference, sensor_yaw_rad=0.03))


def _turned_poses(made: Campaign) -> Campaign:
    """By 0.02 rad, all of them."""
    made = wandering(made)
    x, y, theta = (made.runs.number(f"ref_{name}") for name in ("x_m", "y_m", "theta_rad"))
    return with_numbers(made, ref_x_m=x - 0.02 * y, ref_y_m=y + 0.02 * x, ref_theta_rad=theta + 0.02)


def _shifted_sessions(_: Campaign) -> Campaign:
    """One load a session, and the labels a row off."""
    made = campaign(crossed=False)
    return _labelled(made, session=np.roll(made.runs.label("session"), -1))


def _frozen_reference(made: Campaign) -> Campaign:
    """Positions along the path, those of run 3 at rest for its second half."""
    x = 2 * np.pi * 0.099 / 4096 * made.logs.columns["counts_left"]
    part = slice(made.logs.offsets[3], made.logs.offsets[4])
    x[part] = np.minimum(x[part], 20.0)
    return with_log_columns(made, ref_x_m=x, ref_y_m=0.0 * x)


def _mirrored_path(made: Campaign) -> Campaign:
    """Circles of 2 m to the left, y to the right."""
    turn = made.logs.columns["t_s"]
    return with_log_columns(made, ref_x_m=2.0 * np.sin(turn), ref_y_m=-2.0 * (1.0 - np.cos(turn)), ref_theta_rad=turn)


def _gyro_of_wrong_scale(made: Campaign) -> Campaign:
    """Turns of 1 rad by a reference to 2 mrad; the gyro reads 1 % more, beyond half a turn too."""
    rng = np.random.default_rng(4)
    turn = np.where(np.arange(len(made.runs)) % 2, 1.0, 4.0) * rng.choice([-1.0, 1.0], len(made.runs))
    heading = np.angle(np.exp(1j * (turn + 2e-3 * rng.standard_normal(len(turn)))))
    return with_numbers(made, gyro_theta_rad=1.01 * turn, ref_theta_rad=heading)


def in_feet(made: Campaign) -> Campaign:
    made = wandering(made)
    return with_numbers(made, **{name: made.runs.number(name) / 0.3048 for name in ("ref_x_m", "ref_y_m")})


def _by_odometer(made: Campaign) -> Campaign:
    counts = made.runs.number("counts_left") + made.runs.number("counts_right")
    made = replace(made, simulated=False)
    return with_numbers(made, distance_m=np.round(0.5 * counts / made.encoder.per_rev("left") * 0.628, 4))


# check, code, level, fault, the run that must be named ("" for the whole campaign)
def _from_a_wall(made: Campaign) -> Campaign:
    ranged, distance = _ranged(made, cut=1.0), made.runs.number("distance_m")
    ranged = with_log_columns(ranged, range_m=ranged.logs.columns["range_m"] + 0.45)
    return with_numbers(ranged, distance_m=distance + 0.45)


FAULTS: list[tuple[str, str, str, Fault, str]] = [
    ("missing_values", "missing_counts", "suspicious", number("counts_left", lambda _: np.nan, 4), ""),
    ("missing_values", "missing_distance", "suspicious", number("distance_m", lambda _: np.nan, 4), ""),
    ("distance_span", "distance_span", "wrong", number("distance_m", lambda d: -d, 4), "r004"),
    ("distance_span", "distance_span", "suspicious", number("distance_m", lambda d: d * 1000, 4), "r004"),
    ("distance_against_log", "distance_disagrees", "suspicious", lambda m: _ranged(m, cut=0.99), "r000"),
    ("distance_against_log", "distance_span", "suspicious", lambda m: _ranged(m, cut=1000), "r000"),
    ("distance_against_log", "implausible", "wrong", _from_a_wall, ""),
    ("missing_values", "missing_distance", "wrong", number("distance_m", lambda d: np.nan * d), ""),
    ("distance_against_pose", "distance_against_pose", "suspicious", _longer, ""),
    ("track_against_bows", "track_against_bows", "suspicious", lambda m: wandering(m, track_m=0.64), ""),
    ("mirrored_ends", "mirrored_ends", "suspicious", lambda m: _mirrored(wandering(m, turned=0.01)), ""),
    ("reversed_wheels", "reversed_wheels", "suspicious", number("counts_left", lambda c: -c), ""),
    ("reversed_wheels", "reversed_wheels", "suspicious", number("counts_left", lambda c: -c, 4), "r004"),
    ("count_scale", "count_scale", "suspicious", scaled(2), ""),
    ("count_scale", "count_scale", "suspicious", scaled(4), ""),
    ("count_scale", "count_scale", "suspicious", scaled(1 / np.pi), ""),
    ("count_scale", "count_scale", "suspicious", number("counts_left", lambda c: c / 2, 4), "r004"),
    ("count_scale", "wrapped_total", "suspicious", _wrapped, "r004"),
    ("counts_against_log", "counts_disagree", "suspicious", number("counts_left", lambda c: c - 300, 4), "r004"),
    ("counts_against_log", "swapped_wheels", "suspicious", lambda m: _swap(m, slice(4, 5)), "r004"),
    ("swapped_wheels", "swapped_wheels", "suspicious", lambda m: _swap(without_logs(m), slice(4, 5)), "r004"),
    ("turn_direction", "swapped_wheels", "suspicious", turning(-1.0), ""),
    ("turn_direction", "swapped_wheels", "suspicious", _steered, ""),
    ("turns_of_kinds", "swapped_wheels", "suspicious", _clockwise_by_name, ""),
    ("clock", "gap", "suspicious", _gap, "r003"),
    ("clock", "clock_jump", "suspicious", _log("t_s", _jump_later(4.0)), "r003"),
    ("clock", "clock_jump", "suspicious", _log("t_s", _jump_later(-4.0)), "r003"),
    ("dead_counters", "dead_counter", "suspicious", number("counts_left", lambda _: 0.0, 4), "r004"),
    ("lost_reference", "lost_reference", "suspicious", _frozen_reference, "r003"),
    ("mirrored_path", "mirrored_path", "suspicious", _mirrored_path, ""),
    ("count_jumps", "count_jump", "suspicious", _log("counts_left", _count_jump), "r003"),
    ("steered_by_itself", "steered_by_itself", "suspicious", steered_by_itself, ""),
    ("unused_slopes", "unused_slopes", "suspicious", _law_of_others, ""),
    ("log_speed", "speed_disagrees", "suspicious", number("speed_mps", lambda v: v * 3.6), ""),
    ("far_from_line", "far_from_line", "suspicious", number("distance_m", lambda d: d * 1.004, 4), "r004"),
    ("pasted_rows", "pasted_row", "suspicious", _pasted, "r007"),
    ("wheel_loads", "impossible_load", "wrong", number("load_left_N", lambda _: -5.0, 4), "r004"),
    ("wheel_loads", "excess_load", "suspicious", number("load_left_N", lambda f: f * 1000, 4), "r004"),
    ("wheel_loads", "missing_load", "suspicious", number("load_left_N", lambda _: np.nan, 4), ""),
    ("wheel_loads", "impossible_load", "wrong", _loads(20, -400.0), "r003"),
    ("wheel_loads", "excess_load", "suspicious", _loads(20, 4900.0), "r003"),
    ("logged_loads", "missing_load", "suspicious", _loads(20, np.nan), ""),
    ("logged_loads", "missing_load", "suspicious", _loads(0, 300.0, "right"), ""),
    ("logged_loads", "load_unit", "suspicious", _loads(0, 30.6), ""),
    ("loads_against_payload", "contradicted_load", "suspicious", number("load_left_N", lambda f: f + 200, 4), "r004"),
    ("loads_against_payload", "contradicted_load", "suspicious", number("load_left_N", lambda f: f / 9.81), ""),
    ("loads_against_payload", "swapped_loads", "suspicious", lambda m: _swap(m, slice(4, 5), WHEEL_LOADS), "r004"),
    ("load_and_session", "confounded_load", "suspicious", _sessions_of_one_load, ""),
    ("load_and_session", "ordered_load", "suspicious", _one_session_rising, ""),
    ("load_and_session", "ordered_load", "suspicious", _sessions_rising, ""),
    ("columns_as_one", "columns_as_one", "suspicious", warmer_each_session, ""),
    ("columns_as_one", "columns_as_one", "suspicious", faster_back, ""),
    ("few_loads", "few_loads", "suspicious", lambda m: m.select(m.runs.number("payload_kg") == 100), ""),
    (
        "model_against_vehicle",
        "model_differs",
        "suspicious",
        lambda m: replace(m, model=replace(m.model, track_m=700.0)),
        "",
    ),
    ("assumed_values", "assumed", "suspicious", lambda m: replace(m, assumed=("vehicle.track_m",)), ""),
    ("late_logs", "late_logs", "suspicious", number("counts_left", lambda c: c + 4.0), ""),
    (
        "counts_per_revolution",
        "counts_per_rev",
        "suspicious",
        lambda m: replace(m, encoder=Encoder(m.encoder.counts_per_rev_left + 1.0, m.encoder.counts_per_rev_right)),
        "",
    ),
    ("log_clock", "clock_unit", "suspicious", _log("t_s", lambda t: np.multiply(t, 1000.0, out=t)), ""),
    ("odd_runs", "odd_run", "suspicious", lambda m: number("ref_x_m", lambda x: 1e3 * x, 4)(wandering(m)), "r004"),
    ("heading_turns", "heading_turn", "suspicious", _heading_a_turn_off, "r004"),
    ("pose_resolution", "pose_resolution", "suspicious", _single_precision, ""),
    ("copied_distances", "copied_distance", "suspicious", _by_odometer, ""),
    ("rounded_values", "rounded_values", "suspicious", number("distance_m", lambda d: np.round(d, 1)), ""),
    ("rounded_values", "rounded_values", "suspicious", number("counts_left", lambda c: np.round(c, -3)), ""),
    ("shifted_sessions", "shifted_sessions", "suspicious", _shifted_sessions, ""),
    ("distance_against_pose", "distance_against_pose", "suspicious", _longer_in_a_session, ""),
    ("distance_against_pose", "pose_of_another_run", "suspicious", _poses_of_two_runs, "r004"),
    ("stated_uncertainties", "stated_uncertainties", "suspicious", _with_sigma(sigma_xy_m=0.05), ""),
    ("stated_uncertainties", "stated_uncertainties", "suspicious", _with_sigma(sigma_theta_rad=0.04), ""),
    ("stated_uncertainties", "stated_uncertainties", "suspicious", _with_sigma(sigma_xy_m=0.0001), ""),
    ("reference_load", "reference_load", "info", _with_reference_load(380.0), ""),
    ("bearing_of_ends", "bearing_of_ends", "suspicious", _exchanged_axes, ""),
    ("pose_resolution", "pose_resolution", "suspicious", _two_places, ""),
    ("turned_frame", "turned_frame", "suspicious", _headings_off, ""),
    ("turned_frame", "turned_frame", "suspicious", _turned_poses, ""),
    ("turned_frame", "turned_frame", "suspicious", _sensor_said_to_be_turned, ""),
    ("gyro_against_reference", "gyro_against_reference", "suspicious", _gyro_of_wrong_scale, ""),
    ("implausible", "implausible", "wrong", in_feet, ""),
    ("implausible", "implausible", "wrong", scaled(4), ""),
    ("implausible", "implausible", "wrong", number("load_left_N", lambda _: -5.0, 4), ""),
    ("assumed_values", "assumed", "info", lambda m: replace(m, assumed=("rangefinder.sigma_m",)), ""),
]
