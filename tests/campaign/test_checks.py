"""Each check finds its fault and leaves a sound campaign alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calib.campaign.check import CHECKS, check_campaign
from calib.campaign.model import Campaign, Logs
from calib.campaign.settings import Encoder
from tests.campaign.making import campaign, with_log_columns, with_numbers

Fault = Callable[[Campaign], Campaign]


def _number(name: str, change: Callable[[np.ndarray], object], run: int | None = None) -> Fault:
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


def _without_logs(made: Campaign) -> Campaign:
    return replace(made, logs=Logs.empty(len(made.runs)))


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
    return with_numbers(_without_logs(made), counts_left=np.mod(made.runs.number("counts_left"), 2**16))


def _scaled(factor: float) -> Fault:
    return lambda made: with_numbers(_without_logs(made), counts_right=made.runs.number("counts_right") * factor)


def _turning(sign: float) -> Fault:
    def make(made: Campaign) -> Campaign:
        n = len(made.runs)
        left = np.full(n, 4096.0 * 5)
        return with_numbers(
            _without_logs(made),
            counts_left=left,
            counts_right=left + 4096 * 0.7 * 1.6 / (2 * np.pi * 0.1),
            ref_theta_rad=np.full(n, sign * 1.6),
            distance_m=np.full(n, np.nan),
            ref_x_m=np.full(n, 2.0),
        )

    return make


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
    labels = {**made.runs.labels, "session": np.full(len(made.runs), "s1")}
    return replace(made, runs=replace(made.runs, labels=labels))


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


def _wandering(made: Campaign, *, track_m: float = 0.7, seed: int = 3, turned: float = 0.0) -> Campaign:
    """Nearly straight runs of a vehicle of this track, with end poses; wheels that differ anew in every run.

    The heading is ``A sin(pi s / d)`` with another A in every run, and the wheels' difference is in the counts alone;
    `turned`: standard deviation of a turn to the end, rad.
    """
    rng = np.random.default_rng(seed)
    runs, logs = made.runs, made.logs
    left, right = logs.columns["counts_left"].copy(), logs.columns["counts_right"].copy()
    pose = np.zeros((3, len(runs)))
    per_m = 4096 / (2 * np.pi * 0.1)
    for run, distance in enumerate(runs.number("distance_m")):
        here = slice(logs.offsets[run], logs.offsets[run + 1])
        along = np.linspace(0.0, distance, logs.lengths[run])
        heading = 0.02 * rng.standard_normal() * np.sin(np.pi * along / distance)
        if turned:
            heading += turned * rng.standard_normal() * along / distance
        middle = (heading[1:] + heading[:-1]) / 2
        pose[:, run] = np.sum(np.diff(along) * np.cos(middle)), np.sum(np.diff(along) * np.sin(middle)), heading[-1]
        apart = track_m * heading + 1e-3 * rng.standard_normal() * along
        left[here], right[here] = np.floor(per_m * (along - apart / 2)), np.floor(per_m * (along + apart / 2))
    pose += np.array([[2e-3], [2e-3], [8e-4]]) * rng.standard_normal(pose.shape)
    ends = logs.offsets[1:] - 1
    made = with_log_columns(made, counts_left=left, counts_right=right)
    return with_numbers(
        made,
        counts_left=left[ends],
        counts_right=right[ends],
        **dict(zip(("ref_x_m", "ref_y_m", "ref_theta_rad"), pose, strict=True)),
    )


def _longer(made: Campaign) -> Campaign:
    made = _wandering(made)
    return with_numbers(made, distance_m=made.runs.number("distance_m") + 0.05)


def _longer_in_a_session(made: Campaign) -> Campaign:
    made = _wandering(made)
    longer = np.where(made.runs.label("session") == "s2", 1.01, 1.0)
    return with_numbers(made, distance_m=made.runs.number("distance_m") * longer)


def _poses_of_two_runs(made: Campaign) -> Campaign:
    """The end pose of run 4 lies where a run 0.4 m longer ends."""
    made = _wandering(made)
    x = made.runs.number("ref_x_m").copy()
    x[4] += 0.4
    return with_numbers(made, ref_x_m=x)


def _with_sigma(**sigma: float) -> Fault:
    return lambda made: replace(_wandering(made), reference=replace(made.reference, **sigma))


def _with_reference_load(load_N: float) -> Fault:
    return lambda made: replace(made, model=replace(made.model, reference_load_N=load_N))


def _exchanged_axes(made: Campaign) -> Campaign:
    made = _wandering(made)
    return with_numbers(made, ref_x_m=made.runs.number("ref_y_m"), ref_y_m=made.runs.number("ref_x_m"))


def _headings_off(made: Campaign) -> Campaign:
    """By 0.02 rad, in one session."""
    made = _wandering(made)
    more = np.where(made.runs.label("session") == "s2", 0.02, 0.0)
    return with_numbers(made, ref_theta_rad=made.runs.number("ref_theta_rad") + more)


def _sensor_said_to_be_turned(made: Campaign) -> Campaign:
    return replace(_wandering(made), reference=replace(made.reference, sensor_yaw_rad=0.03))


def _turned_poses(made: Campaign) -> Campaign:
    """By 0.02 rad, all of them."""
    made = _wandering(made)
    x, y, theta = (made.runs.number(f"ref_{name}") for name in ("x_m", "y_m", "theta_rad"))
    return with_numbers(made, ref_x_m=x - 0.02 * y, ref_y_m=y + 0.02 * x, ref_theta_rad=theta + 0.02)


def _shifted_sessions(_: Campaign) -> Campaign:
    """One load a session, and the labels a row off."""
    made = campaign(crossed=False)
    labels = {**made.runs.labels, "session": np.roll(made.runs.label("session"), -1)}
    return replace(made, runs=replace(made.runs, labels=labels))


# check, code, level, fault, the run that must be named ("" for the whole campaign)
FAULTS: list[tuple[str, str, str, Fault, str]] = [
    ("missing_values", "missing_counts", "suspicious", _number("counts_left", lambda _: np.nan, 4), ""),
    ("missing_values", "missing_distance", "suspicious", _number("distance_m", lambda _: np.nan, 4), ""),
    ("distance_span", "distance_span", "wrong", _number("distance_m", lambda d: -d, 4), "r004"),
    ("distance_span", "distance_span", "suspicious", _number("distance_m", lambda d: d * 1000, 4), "r004"),
    ("distance_against_log", "distance_disagrees", "suspicious", lambda m: _ranged(m, cut=0.99), "r000"),
    ("distance_against_log", "distance_span", "suspicious", lambda m: _ranged(m, cut=1000), "r000"),
    ("distance_against_pose", "distance_against_pose", "suspicious", _longer, ""),
    ("track_against_bows", "track_against_bows", "suspicious", lambda m: _wandering(m, track_m=0.64), ""),
    ("mirrored_ends", "mirrored_ends", "suspicious", lambda m: _mirrored(_wandering(m, turned=0.01)), ""),
    ("reversed_wheels", "reversed_wheels", "suspicious", _number("counts_left", lambda c: -c), ""),
    ("reversed_wheels", "reversed_wheels", "suspicious", _number("counts_left", lambda c: -c, 4), "r004"),
    ("count_scale", "count_scale", "suspicious", _scaled(2), ""),
    ("count_scale", "count_scale", "suspicious", _scaled(4), ""),
    ("count_scale", "count_scale", "suspicious", _scaled(1 / np.pi), ""),
    ("count_scale", "count_scale", "suspicious", _number("counts_left", lambda c: c / 2, 4), "r004"),
    ("count_scale", "wrapped_total", "suspicious", _wrapped, "r004"),
    ("counts_against_log", "counts_disagree", "suspicious", _number("counts_left", lambda c: c - 300, 4), "r004"),
    ("counts_against_log", "swapped_wheels", "suspicious", lambda m: _swap(m, slice(4, 5)), "r004"),
    ("swapped_wheels", "swapped_wheels", "suspicious", lambda m: _swap(_without_logs(m), slice(4, 5)), "r004"),
    ("turn_direction", "swapped_wheels", "suspicious", _turning(-1.0), ""),
    ("turn_direction", "swapped_wheels", "suspicious", _steered, ""),
    ("clock", "gap", "suspicious", _gap, "r003"),
    ("clock", "clock_jump", "suspicious", _log("t_s", _jump_later(4.0)), "r003"),
    ("clock", "clock_jump", "suspicious", _log("t_s", _jump_later(-4.0)), "r003"),
    ("dead_counters", "dead_counter", "suspicious", _number("counts_left", lambda _: 0.0, 4), "r004"),
    ("count_jumps", "count_jump", "suspicious", _log("counts_left", _count_jump), "r003"),
    ("log_speed", "speed_disagrees", "suspicious", _number("speed_mps", lambda v: v * 3.6), ""),
    ("far_from_repeats", "far_from_repeats", "suspicious", _number("distance_m", lambda d: d * 1.004, 4), "r004"),
    ("pasted_rows", "pasted_row", "suspicious", _pasted, "r007"),
    ("wheel_loads", "impossible_load", "wrong", _number("load_left_N", lambda _: -5.0, 4), "r004"),
    ("wheel_loads", "excess_load", "suspicious", _number("load_left_N", lambda f: f * 1000, 4), "r004"),
    ("wheel_loads", "missing_load", "suspicious", _number("load_left_N", lambda _: np.nan, 4), ""),
    ("loads_against_payload", "contradicted_load", "suspicious", _number("load_left_N", lambda f: f + 200, 4), "r004"),
    ("loads_against_payload", "contradicted_load", "suspicious", _number("load_left_N", lambda f: f / 9.81), ""),
    (
        "loads_against_payload",
        "swapped_loads",
        "suspicious",
        lambda m: _swap(m, slice(4, 5), ("load_left_N", "load_right_N")),
        "r004",
    ),
    ("load_and_session", "confounded_load", "suspicious", _sessions_of_one_load, ""),
    ("load_and_session", "ordered_load", "suspicious", _one_session_rising, ""),
    ("few_loads", "few_loads", "suspicious", lambda m: m.select(m.runs.number("payload_kg") == 100), ""),
    (
        "model_against_vehicle",
        "model_differs",
        "suspicious",
        lambda m: replace(m, model=replace(m.model, track_m=700.0)),
        "",
    ),
    ("assumed_values", "assumed", "suspicious", lambda m: replace(m, assumed=("vehicle.track_m",)), ""),
    ("late_logs", "late_logs", "suspicious", _number("counts_left", lambda c: c + 4.0), ""),
    (
        "counts_per_revolution",
        "counts_per_rev",
        "suspicious",
        lambda m: replace(m, encoder=Encoder(m.encoder.counts_per_rev_left + 1.0, m.encoder.counts_per_rev_right)),
        "",
    ),
    ("log_clock", "clock_unit", "suspicious", _log("t_s", lambda t: np.multiply(t, 1000.0, out=t)), ""),
    ("heading_turns", "heading_turn", "suspicious", _heading_a_turn_off, "r004"),
    ("pose_resolution", "pose_resolution", "suspicious", _single_precision, ""),
    ("rounded_values", "rounded_values", "suspicious", _number("distance_m", lambda d: np.round(d, 1)), ""),
    ("rounded_values", "rounded_values", "suspicious", _number("counts_left", lambda c: np.round(c, -3)), ""),
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
    ("implausible", "implausible", "wrong", _scaled(4), ""),
    ("implausible", "implausible", "wrong", _number("load_left_N", lambda _: -5.0, 4), ""),
    ("assumed_values", "assumed", "info", lambda m: replace(m, assumed=("rangefinder.sigma_m",)), ""),
]


def test_headings_on_a_map_are_absolute() -> None:
    """A turn to the left that ends at a negative heading is sound there; without a log nothing is known."""
    made = _turning(-1.0)(campaign())
    logs = campaign().logs
    heading = np.concatenate([np.linspace(-3.2, -1.6, length) for length in logs.lengths])
    here = replace(made, reference=replace(made.reference, frame="map"))
    assert not list(CHECKS["turn_direction"](here))
    columns = {"t_s": logs.columns["t_s"], "ref_theta_rad": heading}
    assert not list(CHECKS["turn_direction"](replace(here, logs=replace(logs, columns=columns))))
    columns["ref_theta_rad"] = -heading
    assert list(CHECKS["turn_direction"](replace(here, logs=replace(logs, columns=columns))))


def test_a_ratio_that_all_runs_of_such_loads_have_is_not_swapped() -> None:
    """Loads that lie mirrored beside a step of the radii, which the other runs do not know."""
    made = _without_logs(campaign(runs_per_load=4))
    payload = made.runs.number("payload_kg")
    heavy, light = payload == payload.max(), payload == 0
    kept = made.select((heavy & (np.cumsum(heavy) <= 2)) | (light & (np.cumsum(light) <= 4)))
    few = kept.runs.number("payload_kg") > 0
    left, right = (kept.runs.number(f"counts_{side}") for side in ("left", "right"))
    mirrored = left / np.median((right / left)[~few])
    stepped = with_numbers(kept, counts_right=np.where(few, mirrored, right))
    assert not list(CHECKS["swapped_wheels"](stepped))


@pytest.mark.parametrize(("check", "code", "level", "fault", "run_id"), FAULTS)
def test_a_fault_is_found_where_it_is(check: str, code: str, level: str, fault: Fault, run_id: str) -> None:
    found = list(CHECKS[check](fault(campaign())))
    assert [note for note in found if (note.code, note.level, note.run_id) == (code, level, run_id)], found
    if run_id and code not in {"distance_disagrees", "distance_span", "wrapped_total"}:
        # one spoilt run is not reported as many
        assert {note.run_id for note in found} == {run_id}


@pytest.mark.parametrize("check", CHECKS)
def test_every_check_has_a_fault_to_find(check: str) -> None:
    assert check in {name for name, *_ in FAULTS}


@pytest.mark.parametrize("seed", range(8))
def test_a_sound_campaign_is_left_alone(seed: int) -> None:
    report = check_campaign(campaign(seed=seed))
    assert report.sound
    assert (report.wrong, report.suspicious, report.info) == ((), (), ())


@pytest.mark.parametrize("seed", range(8))
def test_runs_that_wander_with_the_right_track_and_distance_are_left_alone(seed: int) -> None:
    """However the wheels differ from run to run: their difference leaves the bow alone."""
    report = check_campaign(_wandering(campaign(seed=seed), seed=seed))
    assert report.suspicious == ()


def test_the_track_that_the_bows_want_is_named() -> None:
    """Within the few percent that 30 runs tell."""
    (found,) = CHECKS["track_against_bows"](_wandering(campaign(), track_m=0.6))
    named = float(found.text.rsplit("is the track ", 1)[1].split(" m?")[0])
    assert abs(named / 0.6 - 1.0) < 0.05


def test_turns_that_agree_are_left_alone() -> None:
    assert list(CHECKS["turn_direction"](_turning(1.0)(campaign()))) == []


def test_the_reason_of_a_factor_is_named() -> None:
    """Counts a factor 2, 4 or pi off are told apart."""
    for factor, word in ((2.0, "twice"), (4.0, "four times"), (np.pi, "pi times too many"), (0.25, "quarter")):
        (found,) = CHECKS["count_scale"](_scaled(factor)(campaign()))
        assert word in found.text


def test_an_excluded_run_is_kept_and_not_complained_about() -> None:
    made = _number("counts_left", lambda c: c / 2, 4)(campaign())
    flagged = made.runs.excluded.copy()
    flagged[4] = True
    report = check_campaign(replace(made, runs=replace(made.runs, excluded=flagged)))
    assert report.suspicious == ()
    assert (report.found.n_runs, report.found.n_excluded) == (30, 1)


def test_one_load_a_session_is_said_to_be_inseparable() -> None:
    notes = [note.text for note in check_campaign(campaign(crossed=False)).suspicious]
    assert len(notes) == 1
    assert "cannot be told apart" in notes[0]


def test_the_summary_counts_what_is_there() -> None:
    found = check_campaign(campaign()).found
    assert (found.n_runs, found.n_logs, found.sessions["s1"]) == (30, 30, 6)
    assert found.payloads_kg == (0.0, 50.0, 100.0, 150.0, 200.0)
    assert found.rate_Hz == pytest.approx((20.0, 20.0), rel=1e-9)
