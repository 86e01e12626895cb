"""The estimate finds the geometry that runs were made with, says how well, and names what it cannot find."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calib.campaign import write_campaign
from calib.campaign.model import Campaign
from calib.campaign.read import read_campaign
from calib.errors import RefusedError
from calib.gap.plan.planned_runs import joined
from calib.kinematics import estimate, recording_of
from calib.kinematics.drives import NOMINAL_STD, nominal_motion
from calib.kinematics.estimate import estimate_geometry
from calib.kinematics.joint_fit import Fitted, drive_of
from calib.reporting.topics.geometry import geometry_sentences
from tests.kinematics.campaigns import Truth, both_ways, campaign, mixed, tricycle

TRUTH = Truth()
NAMES = ("radius_left_m", "radius_right_m", "track_m")
#: a true value lies within this many standard deviations; one in 15,000 does not
SIGMAS = 4.0
#: fine steps of the generator and counts are good to this part of a length without noise
EXACT = 2e-5


def _swap(made: Campaign) -> Campaign:
    numbers, columns = dict(made.runs.numbers), dict(made.logs.columns)
    for table in (numbers, columns):
        table["counts_left"], table["counts_right"] = table["counts_right"], table["counts_left"]
    return replace(made, runs=replace(made.runs, numbers=numbers), logs=replace(made.logs, columns=columns))


def test_without_noise_every_length_comes_back() -> None:
    """Squares, arcs and lines determine both radii and the track, for any nominal values were."""
    made = campaign(mixed(2), TRUTH, np.random.default_rng(1), sigma=(1e-7, 1e-7), nominal=(0.047, 0.053, 0.44))
    found = estimate_geometry(made)
    for name in NAMES:
        assert found[name].value == pytest.approx(getattr(TRUTH, name), rel=EXACT)
    assert found.passed and not found.undetermined


def test_a_gross_error_is_named_and_hardly_moves_the_result() -> None:
    """One end pose that is 0.3 m off is listed by its run id; the estimate stays within its interval."""
    made = campaign(mixed(4), TRUTH, np.random.default_rng(2))
    numbers = dict(made.runs.numbers)
    numbers["ref_x_m"] = numbers["ref_x_m"] + 0.3 * (np.arange(len(made.runs)) == 5)
    spoiled = replace(made, runs=replace(made.runs, numbers=numbers))
    found = estimate_geometry(spoiled)
    assert found.outliers == ("r005",)
    for name in NAMES:
        assert abs(found[name].value - getattr(TRUTH, name)) < SIGMAS * found[name].std


@pytest.mark.parametrize("along", [True, False])
def test_runs_recorded_twice_count_once(along: bool) -> None:
    """Under other names: values, intervals and verdict are those of the runs once, and they are said to be copies."""
    once = campaign(mixed(3), TRUTH, np.random.default_rng(7), along=along)
    both = once.select(np.tile(np.arange(len(once.runs)), 2))
    names = np.array([*once.runs.run_id, *(f"again_{name}" for name in once.runs.run_id)])
    twice = replace(both, runs=replace(both.runs, labels={**both.runs.labels, "run_id": names}))
    single, found = estimate_geometry(once), estimate_geometry(twice)
    assert found.estimates == single.estimates
    assert (found.passed, found.n_runs) == (single.passed, len(once.runs))
    assert any(f"Omitted: {len(once.runs)} runs; the first, again_" in note for note in found.notes)


def test_sensor_pose_and_delay_are_found_along_the_way() -> None:
    """Windows determine where the sensor sits and how late its stamps are, together with the wheels."""
    truth = Truth(sensor=(0.11, -0.04, 0.3), delay_s=0.12)
    made = campaign(mixed(1), truth, np.random.default_rng(3), sigma=(5e-4, 3e-4), along=True)
    made = replace(made, reference=replace(made.reference, sensor_yaw_rad=0.1))
    found = estimate_geometry(made, using="windows")
    wanted = {name: getattr(truth, name) for name in NAMES}
    wanted |= dict(zip(("sensor_x_m", "sensor_y_m", "sensor_yaw_rad"), truth.sensor, strict=True))
    wanted["delay_s"] = truth.delay_s
    for name, value in wanted.items():
        # five runs are few blocks: Student's t rather than sigmas
        low, high = found[name].ci95
        assert low - (high - low) < value < high + (high - low), name


def test_straight_lines_leave_the_track_open_and_say_so() -> None:
    """Without turns neither the track nor the lever arm can be known: they are named and omitted."""
    made = campaign([("line", [(4.0, 0.0)])] * 10, TRUTH, np.random.default_rng(4))
    found = estimate_geometry(made, sensor=True)
    assert {"track_m", "sensor_x_m", "sensor_y_m"} <= set(found.undetermined)
    assert "track_m" not in found.to_dict()["parameters"]
    assert found.values["track_m"] == pytest.approx(0.4)


def test_swapped_columns_are_recognised() -> None:
    """Left and right exchanged turn every turn round; the estimate says so and still finds the vehicle."""
    made = _swap(campaign(mixed(2), TRUTH, np.random.default_rng(5)))
    found = estimate_geometry(made)
    assert [fault.code for fault in found.faults] == ["swapped_wheels"]
    assert not found.passed
    assert found["track_m"].value == pytest.approx(TRUTH.track_m, rel=5e-3)


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_counter_that_runs_backwards_is_recognised(side: str) -> None:
    made = campaign(mixed(2), TRUTH, np.random.default_rng(6))
    columns = dict(made.logs.columns)
    columns[f"counts_{side}"] = -columns[f"counts_{side}"]
    found = estimate_geometry(replace(made, logs=replace(made.logs, columns=columns)))
    assert [fault.code for fault in found.faults] == [f"reversed_{side}"]


@pytest.mark.parametrize(("nominal", "code"), [((0.05, 0.05, 0.2), "half_track"), ((0.1, 0.1, 0.4), "radius_factor")])
def test_half_a_track_and_a_diameter_for_a_radius_are_said(nominal: tuple[float, float, float], code: str) -> None:
    made = campaign(mixed(2), TRUTH, np.random.default_rng(7), nominal=nominal)
    found = estimate_geometry(made)
    assert {fault.code for fault in found.faults} == {code}
    assert found["track_m"].value == pytest.approx(TRUTH.track_m, rel=1e-2)


@pytest.mark.parametrize(("gear", "said"), [(4.0, False), (4.2, True)])
def test_a_gear_near_a_usual_factor_is_named_beside_it(gear: float, said: bool) -> None:
    """Counts of a shaft before a gear: 4.2 is no quadrature, whose radius would be 5 % off."""
    nominal = (gear * TRUTH.radius_left_m, gear * TRUTH.radius_right_m, 0.4)
    made = campaign(mixed(2), TRUTH, np.random.default_rng(7), nominal=nominal)
    texts = [fault.text for fault in estimate_geometry(made).faults]
    assert any(f"a gear of {gear:.3g}" in text for text in texts) == said, texts


def test_umbmark_and_least_squares_agree_on_squares_both_ways() -> None:
    """E_d and E_b of UMBmark are the ratio of the radii, and the track over the nominal one at the mean radius."""
    truth = Truth(radius_left_m=0.0501, radius_right_m=0.05, track_m=0.402)
    made = campaign(both_ways(5), truth, np.random.default_rng(8), sigma=(2e-4, 1e-4))
    estimated = estimate_geometry(made)
    found = estimated.umbmark
    assert found.applies and (found.n_cw, found.n_ccw) == (5, 5)
    mean = 0.5 * (truth.radius_left_m + truth.radius_right_m)
    # UMBmark is linear: its terms of second order are a few per cent of errors of 0.2 and 0.5 %
    assert pytest.approx(truth.radius_right_m / truth.radius_left_m, abs=1e-4) == found.E_d
    assert pytest.approx(truth.track_m / 0.4 * 0.05 / mean, abs=3e-4) == found.E_b
    assert found.c_left == pytest.approx(2 / (found.E_d + 1))
    assert estimated.undetermined == ("mean_radius_m",)
    ratio = estimated.ratio("radius_right_m", "radius_left_m")
    assert abs(ratio.value - truth.radius_right_m / truth.radius_left_m) < SIGMAS * ratio.std + EXACT


def test_umbmark_does_not_apply_to_one_sense_alone() -> None:
    made = campaign(mixed(2), TRUTH, np.random.default_rng(9))
    ccw = made.select(made.runs.label("kind") != "square_cw")
    found = estimate_geometry(ccw).umbmark
    assert not found.applies and "clockwise" in found.why


def test_umbmark_says_which_condition_squares_with_round_corners_fail() -> None:
    """Arcs of 1 m radius instead of turns on the spot: straight sides are less of the way than a square's."""
    side, arc = (2.0, 0.0), (0.5 * np.pi, 0.5 * np.pi)
    runs = [(kind, [side, (arc[0], sign * arc[1])] * 4) for kind, sign in (("square_ccw", 1.0), ("square_cw", -1.0))]
    found = estimate_geometry(campaign(runs * 5, TRUTH, np.random.default_rng(9))).umbmark
    assert not found.applies
    # of each arc two parts of 0.35 rad point along a side; the share is that of sides and these
    share = 100.0 * (2.0 + 2.0 * 0.35) / (2.0 + arc[0])
    assert found.why.startswith("no squares among the runs: straight sides are")
    assert abs(float(found.why.partition("sides are ")[2].partition(" %")[0]) - share) < 3.0


def test_loads_and_geometry_come_from_one_fit() -> None:
    """Radius at the reference load, slope and track of both wheels, with the terms that couple left and right."""
    truth = Truth(slope_left=2e-6, slope_right=-1e-6)
    rng = np.random.default_rng(10)
    loads = np.tile([[200.0, 250.0], [400.0, 300.0], [600.0, 700.0]], (10, 1))
    found = estimate_geometry(campaign(mixed(6), truth, rng, loads=loads))
    assert [estimate.name for estimate in found.estimates] == [*NAMES, "slope_left_m_per_N", "slope_right_m_per_N"]
    for name, value in ((NAMES[2], truth.track_m), ("slope_left_m_per_N", 2e-6), ("slope_right_m_per_N", -1e-6)):
        assert abs(found[name].value - value) < SIGMAS * found[name].std
    assert abs(found.correlation()[0, 1]) > 0.3


def test_a_route_that_pulls_alike_widens_the_intervals() -> None:
    """What all runs of a route share is no noise that repeats would average: the routes become the groups."""
    routes = [(f"arc{size}", [(3.0, size * 0.7)]) for size in (-4, -3, -2, 2, 3, 4) for _ in range(4)]
    made = campaign(routes, TRUTH, np.random.default_rng(11), sigma=(1e-3, 1e-3))
    plain = estimate_geometry(made)
    numbers = dict(made.runs.numbers)
    shift = dict(zip(dict.fromkeys(made.runs.label("kind")), (1, -1, 1, -1, 1, 1), strict=True))
    sign = np.array([shift[kind] for kind in made.runs.label("kind")])
    for name, size in (("ref_x_m", 0.02), ("ref_y_m", 0.03), ("ref_theta_rad", 0.02)):
        numbers[name] = numbers[name] + size * sign
    shared = estimate_geometry(replace(made, runs=replace(made.runs, numbers=numbers)))
    assert (plain.clusters[0], shared.clusters[0]) == ("run", "route")
    assert shared["track_m"].std > 3 * plain["track_m"].std


@pytest.mark.parametrize(("sizes", "said"), [((-4, 4), True), ((-4, -2, 2, 4), False)])
def test_intervals_of_few_routes_do_not_hold_for_others(sizes: tuple[int, ...], said: bool) -> None:
    """What the runs of a route share can be told from the parameters from four routes on."""
    routes = [(f"arc{size}", [(3.0, size * 0.7)]) for size in sizes for _ in range(6)]
    found = estimate_geometry(campaign(routes, TRUTH, np.random.default_rng(11), sigma=(1e-3, 1e-3)))
    assert any(note.startswith("The intervals are of 2 routes: ") for note in found.notes) is said


def test_nothing_to_go_by_is_refused_in_one_line() -> None:
    made = campaign(both_ways(2), TRUTH, np.random.default_rng(12))
    numbers = {name: column for name, column in made.runs.numbers.items() if not name.startswith("ref_")}
    with pytest.raises(RefusedError, match="found no run with wheels and a reference pose"):
        estimate_geometry(replace(made, runs=replace(made.runs, numbers=numbers)))


def test_recordings_left_out_are_met_better_than_before() -> None:
    made = campaign(mixed(2), TRUTH, np.random.default_rng(13))
    rows = estimate_geometry(made, leave_out="kind").transfer
    assert {row.left_out for row in rows} == {"square_ccw", "square_cw", "arc_left", "arc_right", "line"}
    assert all(row.after_rms_m < 0.4 * row.before_rms_m for row in rows)


@pytest.mark.parametrize("bits", [13, 16, 32])
def test_counters_that_overflow_change_nothing(bits: int, tmp_path: Path) -> None:
    """A counter of 13, 16 or 32 bits that begins near its end wraps in the logs; read back, nothing changes."""
    made = campaign(mixed(1), TRUTH, np.random.default_rng(14), samples=800)
    full = 2.0**bits
    columns = dict(made.logs.columns)
    for name in ("counts_left", "counts_right"):
        columns[name] = np.mod(columns[name] + full - 1000.0, full)
    wrapped = replace(made, logs=replace(made.logs, columns=columns), encoder=replace(made.encoder, wrap_bits=bits))
    write_campaign(wrapped, tmp_path / "wrapped")
    write_campaign(made, tmp_path / "plain")
    found, wanted = (estimate_geometry(read_campaign(tmp_path / name)) for name in ("wrapped", "plain"))
    for name in NAMES:
        assert found[name].value == pytest.approx(wanted[name].value, rel=1e-9)


def test_a_mirrored_tricycle_is_turned_round() -> None:
    """A front counter that runs backwards and a steering of the other sign: recognised, and the lengths come back."""
    rng = np.random.default_rng(15)
    found = estimate_geometry(tricycle(rng, sign_front=-1.0, sign_steer=-1.0))
    assert {fault.code for fault in found.faults} == {"reversed_front", "reversed_steering"}
    assert found.mirrored
    for name, value in (("front_radius_m", 0.102), ("wheelbase_m", 1.03), ("steering_zero_rad", 0.012)):
        assert abs(found[name].value - value) < SIGMAS * found[name].std, name
    plain = estimate_geometry(tricycle(np.random.default_rng(15)))
    assert not plain.mirrored and plain.passed


def _together(parts: list[Campaign]) -> Campaign:
    """Runs of several recordings as one campaign, each recording a session."""
    whole = parts[0]
    for part in parts[1:]:
        whole = joined(whole, part)
    n = [len(part.runs) for part in parts]
    labels = dict(whole.runs.labels)
    labels["session"] = np.repeat([f"day {at}" for at in range(len(parts))], n)
    labels["run_id"] = np.array([f"r{at:03d}" for at in range(sum(n))])
    return replace(whole, runs=replace(whole.runs, labels=labels))


@pytest.mark.parametrize("later_s", [0.05, 0.2])
def test_recordings_of_different_delays_get_one_each(later_s: float) -> None:
    """Two recordings whose stamps lag by 0.05 and 0.2 s: each delay is found and said; of one delay only one is."""
    rng = np.random.default_rng(16)
    truths = [replace(TRUTH, sensor=(0.1, 0.0, 0.0), delay_s=delay) for delay in (0.05, later_s)]
    legs = [(1.0, turn) for turn in rng.uniform(-1.5, 1.5, 16)]
    made = [campaign([("free", legs)], truth, rng, sigma=(5e-4, 3e-4), along=True, samples=400) for truth in truths]
    found = estimate_geometry(_together(made), using="windows")
    if later_s == 0.05:
        # a hundredth of a sample: before the log begins the generator holds the pose still
        assert not found.delays and found["delay_s"].value == pytest.approx(0.05, abs=5e-4)
        return
    assert [one.label for one in found.delays] == ["day 0", "day 1"]
    for one, truth in zip(found.delays, truths, strict=True):
        # a tenth of a sample: before the log begins the generator holds the pose still
        assert one.value_s == pytest.approx(truth.delay_s, abs=5e-3)
    assert "a delay of its own in each recording" in " ".join(geometry_sentences(found))
    assert found["track_m"].value == pytest.approx(TRUTH.track_m, rel=3e-3)


def test_measured_lengths_of_straight_runs_and_end_poses_of_squares_are_one_fit() -> None:
    """Squares hold no scale and corridors no track: together they give both laws and the track, with one covariance."""
    truth = Truth(slope_left=2e-6, slope_right=-1e-6)
    rng = np.random.default_rng(17)
    loads = np.tile([[200.0, 250.0], [400.0, 300.0], [600.0, 700.0]], (10, 1))
    routes = [*both_ways(9), *([("corridor", [(4.0, 0.0)])] * 12)]
    made = campaign(routes, truth, rng, loads=loads)
    corridor = made.runs.label("kind") == "corridor"
    numbers = dict(made.runs.numbers)
    numbers["distance_m"] = np.where(corridor, numbers["ref_x_m"], np.nan)
    for name in ("ref_x_m", "ref_y_m", "ref_theta_rad"):
        numbers[name] = np.where(corridor, np.nan, numbers[name])
    found = estimate_geometry(replace(made, runs=replace(made.runs, numbers=numbers)))
    assert not found.undetermined and found.n_runs == 30
    wanted = {
        **{name: getattr(truth, name) for name in NAMES},
        "slope_left_m_per_N": 2e-6,
        "slope_right_m_per_N": -1e-6,
    }
    for name, value in wanted.items():
        assert abs(found[name].value - value) < SIGMAS * found[name].std, name
    squares = replace(made, runs=replace(made.runs, numbers=numbers)).select(~corridor)
    # without the corridors the lengths are known to the nominal 1 % only, or not determined at all
    alone = estimate_geometry(squares)
    assert alone.undetermined or alone["track_m"].std > 3.0 * found["track_m"].std


def test_an_interval_holds_what_an_open_parameter_leaves() -> None:
    """Turns on the spot tell the track over the mean radius: the track is no better known than the radius is."""
    truth = Truth(radius_left_m=0.0506, radius_right_m=0.0506, track_m=0.405)
    made = campaign(
        [("left", [(1e-6, 9.0)]), ("right", [(1e-6, -9.0)])],
        truth,
        np.random.default_rng(11),
        along=True,
        # the mean radius is as open with any number of them
        samples=30,
    )
    found = estimate_geometry(made, using="windows")
    track = found["track_m"]
    assert "mean_radius_m" in found.undetermined
    assert track.std > 0.9 * NOMINAL_STD * track.value and track.ci95[0] < truth.track_m < track.ci95[1]


def test_one_run_that_its_parameters_fit_exactly_shows_nothing() -> None:
    made = campaign(both_ways(1), TRUTH, np.random.default_rng(12))
    one = estimate_geometry(made.select(np.arange(len(made.runs)) == 0))
    assert not one.passed and any("fitted exactly" in why for why in one.why)


def test_readings_that_agree_by_chance_leave_the_stated_noise() -> None:
    """Readings without any noise, and one as stated: their mean square is the stated one over their number."""
    n, stated_m = 8, 1e-3
    made = campaign(both_ways(n // 2), TRUTH, np.random.default_rng(2), sigma=(1e-7, 1e-7))
    found = estimate_geometry(
        replace(made, reference=replace(made.reference, sigma_xy_m=stated_m, sigma_theta_rad=1e-3))
    )
    least_m = stated_m / np.sqrt(1 + 3 * n)
    assert found.noise["reference_xy"] > least_m
    # over squares of 8 m or more
    assert all(each.half_width > 0.05 * least_m / 8.0 * each.value for each in found.estimates)


def test_runs_without_the_loads_that_others_have_are_omitted_where_a_law_is_believed() -> None:
    """At the reference load a law would have them carry what they did not."""
    truth = Truth(slope_left=2e-6, slope_right=-1e-6)
    loads = np.tile([[200.0, 250.0], [400.0, 300.0], [600.0, 700.0]], (10, 1))
    made = campaign(mixed(6), truth, np.random.default_rng(10), loads=loads)
    numbers = {
        name: np.where(np.arange(30) % 5 == 0, np.nan, values) if name.startswith("load_") else values
        for name, values in made.runs.numbers.items()
    }
    model = replace(made.model, slope_left_m_per_N=2e-6, slope_right_m_per_N=-1e-6)
    found = estimate_geometry(replace(made, model=model, runs=replace(made.runs, numbers=numbers)))
    assert found.n_runs == 24
    assert any("Omitted: 6 runs" in note and "though other runs have them" in note for note in found.notes)


def test_a_heading_lost_in_a_turn_and_found_a_turn_off_is_no_mistyped_one() -> None:
    """Turns that the reference did not follow are those of the wheels; its run is not named."""
    made = campaign(mixed(2), TRUTH, np.random.default_rng(11), along=True)
    columns, first, last = dict(made.logs.columns), *made.logs.offsets[:2].tolist()
    heading = columns["ref_theta_rad"].copy()
    quarter = (last - first) // 4
    heading[first + quarter : first + 3 * quarter] = np.nan
    heading[first + 3 * quarter : last] += 2.0 * np.pi
    recording = recording_of(
        replace(made, logs=replace(made.logs, columns=columns | {"ref_theta_rad": heading})), "rear"
    )
    turn = nominal_motion(drive_of(made, "rear", recording), recording.steps)[2]
    corrected, off = recording.with_whole_turns(turn)
    assert off == []
    assert corrected.end_pose[0, 2] == pytest.approx(2.0 * np.pi, abs=0.5)


def test_headings_of_an_effective_track_far_from_the_nominal_one_are_no_turns_off() -> None:
    """A skid-steered vehicle that turns half as far as its nominal track says: where that is two turns, it is one."""
    made = campaign(mixed(4)[6:], TRUTH, np.random.default_rng(12))
    recording = recording_of(made, "rear")
    turn = 2.0 * nominal_motion(drive_of(made, "rear", recording), recording.steps)[2]
    assert recording.with_whole_turns(turn)[1] == []
    end_pose = recording.end_pose.copy()
    end_pose[0, 2] += 2.0 * np.pi
    off = replace(recording, end_pose=end_pose).with_whole_turns(turn)
    assert off[1] == [str(recording.run_id[0])]
    assert off[0].end_pose[0, 2] == pytest.approx(recording.end_pose[0, 2])
    # of headings within half a turn, by the runs that turn by less
    turned = recording.end_pose[:, 2]
    within = (turned + np.pi) % (2.0 * np.pi) - np.pi
    end_pose = np.column_stack([recording.end_pose[:, :2], within])
    unwrapped, _ = replace(recording, end_pose=end_pose).with_whole_turns(0.75 * turn)
    assert unwrapped.end_pose[:, 2] == pytest.approx(turned)


def test_windows_that_no_lengths_solve_leave_the_fit_of_coarser_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of wrong readings a search may end at lengths of zero."""
    made = campaign(mixed(1), TRUTH, np.random.default_rng(13), along=True)
    fit, sizes = estimate.fit_parameters, list[int]()

    def first_alone(*given: Any) -> Fitted:
        sizes.append(len(given[3]))
        if sizes[-1] > sizes[0]:
            raise np.linalg.LinAlgError
        return fit(*given)

    monkeypatch.setattr(estimate, "fit_parameters", first_alone)
    assert estimate_geometry(made, using="windows").passed
    assert max(sizes) > sizes[0]
