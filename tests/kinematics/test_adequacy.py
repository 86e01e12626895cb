"""A geometry is believed only where its residuals on held-out runs are near the noise."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import calib
from calib.campaign.model import Campaign
from calib.campaign.read import read_campaign
from calib.coefficients.build import from_geometry
from calib.errors import ImplausibleError, RefusedError
from calib.gap.plan.planned_runs import joined
from calib.kinematics import recording_of
from calib.kinematics.adequacy import GeometryVerdict, Residuals, judge
from calib.kinematics.blunder_search import find_blunder
from calib.kinematics.estimate import Using, _told_by, estimate_geometry
from calib.kinematics.model import window_segments
from calib.reporting.topics.geometry import verdict_sentences
from tests.blunders import plant
from tests.blunders.blunders import DIFFERENTIAL
from tests.kinematics import steered
from tests.kinematics.campaigns import Truth, campaign, mixed, square
from tests.kinematics.test_named_blunders import in_map

TRUTH = {
    "radius_left_m": plant.RADIUS_LEFT_M,
    "radius_right_m": plant.RADIUS_RIGHT_M,
    "track_m": plant.TRACK_M,
}
SOUND = plant.differential(np.random.default_rng(1))


def recorded(folder: Path, *, along: bool = False, heading: bool = True, blunder: str = "") -> calib.Campaign:
    """Return a campaign of the independent plant."""
    recording = SOUND.copy()
    if blunder:
        DIFFERENTIAL[blunder](recording)
    return read_campaign(plant.write(recording, folder / "c", along=along, heading=heading))


@pytest.mark.parametrize(
    ("before", "size", "level"),
    [
        (0.900, 0.100, GeometryVerdict.CALIBRATED),
        (0.095, 0.100, GeometryVerdict.CALIBRATED),  # calibrated before: nothing is left to explain
        (0.110, 0.110, GeometryVerdict.CALIBRATED),  # of its square four fifths are noise
        (0.160, 0.160, GeometryVerdict.DOUBTFUL),  # of its square most is none
        (0.800, 0.800, GeometryVerdict.DOUBTFUL),  # 8 % of the way by wheels that tell nothing of it
    ],
)
def test_wheels_tell_how_a_vehicle_moved_calibrated_or_not(before: float, size: float, level: GeometryVerdict) -> None:
    """Of a way of 10 m; replicates scatter by more than usual wheels do."""
    noise = min(max(0.1, 0.5 * size), size)
    assert judge(Residuals(before, size, size, noise, travelled=10.0, usual_noise=0.03))[0] is level


@pytest.mark.parametrize(
    ("before", "after", "held_out", "level"),
    [
        (0.100, 0.004, 0.005, GeometryVerdict.CALIBRATED),  # at the noise
        (0.100, 0.100, 0.100, GeometryVerdict.WRONG),  # explains nothing
        (0.900, 0.200, 0.300, GeometryVerdict.DOUBTFUL),  # helps, and leaves 75 times the noise
        (9.000, 0.800, 0.900, GeometryVerdict.WRONG),  # 9 % of the way
        (0.003, 0.003, 0.003, GeometryVerdict.CALIBRATED),  # nothing to explain
    ],
)
def test_levels_follow_residuals_noise_and_way(
    before: float, after: float, held_out: float, level: GeometryVerdict
) -> None:
    """Of a way of 10 m with noise of 4 mm."""
    found, why = judge(Residuals(before, after, held_out, noise=0.004, travelled=10.0, usual_noise=0.03))
    assert found is level
    assert bool(why) == (level is not GeometryVerdict.CALIBRATED)


@pytest.mark.parametrize(("what", "wider"), [("speed", 1.04), ("load", 1.04), ("speed", 1.0), ("load", 1.0)])
def test_what_another_speed_or_load_does_is_no_scatter(what: str, wider: float) -> None:
    """A track 4 % wider at the other one turns squares by 0.25 rad: replicates are runs of one speed and load."""
    rng, routes = np.random.default_rng(2), mixed(2)
    parts = []
    for number, track_m in enumerate((0.41, wider * 0.41)):
        loads = np.full((len(routes), 2), 300.0 + 200.0 * number * (what == "load"))
        lasted_s = 20.0 * (1.0 + number * (what == "speed"))
        parts.append(campaign(routes, replace(Truth(), track_m=track_m), rng, loads=loads, duration_s=lasted_s))
    found = estimate_geometry(joined(*parts))
    assert (found.verdict is GeometryVerdict.CALIBRATED) == (wider == 1.0)


@pytest.mark.parametrize("along", [False, True])
def test_positions_alone_determine_radii_and_track(along: bool, tmp_path: Path) -> None:
    """Intervals hold the truth of the plant."""
    using: Using = "windows" if along else "end_poses"
    found = estimate_geometry(recorded(tmp_path, along=along, heading=False), using=using)
    assert found.passed
    for name, truth in TRUTH.items():
        low, high = found[name].ci95
        assert low < truth < high


def test_headings_alone_leave_the_scale_open(tmp_path: Path) -> None:
    """Ratio of the radii and track over radius follow from headings; the mean radius does not."""
    recorded(tmp_path, along=True)
    folder = tmp_path / "c"
    for path in (folder / "runs.csv", *(folder / "logs").glob("*.csv")):
        path.write_text(path.read_text().replace("ref_x_m", "note_a").replace("ref_y_m", "note_b"))
    found = estimate_geometry(read_campaign(folder), using="windows")
    assert "mean_radius_m" in found.undetermined
    assert any("Headings alone" in note for note in found.notes)
    ratio = found["radius_left_m"].value / found["radius_right_m"].value
    assert ratio == pytest.approx(TRUTH["radius_left_m"] / TRUTH["radius_right_m"], rel=RATIO)
    track = found["track_m"].value / found["radius_left_m"].value
    assert track == pytest.approx(TRUTH["track_m"] / TRUTH["radius_left_m"], rel=TRACK)


#: five standard deviations: the plant's radii scatter by 0.1 % a run, over 18 runs
RATIO, TRACK = 2e-3, 5e-3


def test_a_heading_that_never_changes_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RefusedError, match=r"found 0 throughout, although the wheels turn .* leave the column empty"):
        estimate_geometry(recorded(tmp_path, blunder="heading zero throughout"))


def _in_a_map(made: Campaign, every: int = 1) -> Campaign:
    """Every run turned, and begun elsewhere; the first one near the origin. Every so manieth position is kept."""
    rng, columns = np.random.default_rng(7), {name: column.copy() for name, column in made.logs.columns.items()}
    for number, (first, last) in enumerate(pairwise(made.logs.offsets)):
        turned = (columns["ref_x_m"][first:last] + 1j * columns["ref_y_m"][first:last]) * np.exp(
            1j * rng.uniform(-3, 3)
        )
        turned += number * (1.0 + 2.0j)
        turned[np.arange(last - first) % every > 0] = np.nan
        columns["ref_x_m"][first:last], columns["ref_y_m"][first:last] = turned.real, turned.imag
    return replace(made, logs=replace(made.logs, columns=columns))


def test_positions_alone_in_a_map_determine_radii_and_track(tmp_path: Path) -> None:
    """The course tells what headings do not, also of a run that begins near the origin; none tells the sensor's yaw."""
    found = estimate_geometry(_in_a_map(recorded(tmp_path, along=True, heading=False)))
    assert found.passed
    assert found.undetermined == ("sensor_yaw_rad",)
    for name, truth in TRUTH.items():
        low, high = found[name].ci95
        assert low < truth < high


@pytest.mark.parametrize("exchanged", [True, False])
def test_a_mirror_of_positions_alone_in_a_map_is_named_with_all_it_may_be(exchanged: bool, tmp_path: Path) -> None:
    """Wheels exchanged and an axis mirrored are the same to the course: one name for both."""
    made = _in_a_map(recorded(tmp_path, along=True, heading=False))
    made = made.select(np.arange(len(made.runs)) < 4)
    columns = dict(made.logs.columns)
    if exchanged:
        columns["counts_left"], columns["counts_right"] = columns["counts_right"], columns["counts_left"]
    else:
        columns["ref_y_m"] = -columns["ref_y_m"]
    wrong = replace(made, logs=replace(made.logs, columns=columns))
    found = find_blunder(wrong, recording_of(wrong, "rear"), "rear", lambda _, read: window_segments(read, 3))
    assert found is not None
    assert found[2].code == "mirrored"
    assert "wheels are exchanged" in found[2].text


def test_a_long_axis_of_positions_alone_in_a_map_is_named(tmp_path: Path) -> None:
    """By 5 %: it would lengthen the radii by half as much."""
    made = _in_a_map(recorded(tmp_path, along=True, heading=False))
    columns = {**made.logs.columns, "ref_x_m": 1.05 * made.logs.columns["ref_x_m"]}
    found = estimate_geometry(replace(made, logs=replace(made.logs, columns=columns)))
    assert "axis_scale" in {fault.code for fault in found.faults}


def test_few_positions_in_a_map_say_what_is_missing(tmp_path: Path) -> None:
    """Ends alone have no course; no blunder of the counts is named in their place."""
    with pytest.raises(RefusedError, match="positions alone, not from the start pose"):
        estimate_geometry(_in_a_map(recorded(tmp_path, along=True, heading=False), every=10**6))


def test_end_poses_in_a_map_are_seen_from_where_the_log_began(tmp_path: Path) -> None:
    """Every run from another place and heading of the map: the same vehicle as from the start pose."""
    campaign = recorded(tmp_path, along=True)
    rng, numbers, columns = np.random.default_rng(5), dict(campaign.runs.numbers), dict(campaign.logs.columns)
    names = ("ref_x_m", "ref_y_m", "ref_theta_rad")
    for table in (numbers, columns):
        table.update({name: table[name].copy() for name in names})
    for run in range(len(campaign.runs)):
        x_m, y_m, heading_rad = rng.uniform(-9.0, 9.0, 3)
        rows = slice(campaign.logs.offsets[run], campaign.logs.offsets[run + 1])
        for table, at in ((numbers, slice(run, run + 1)), (columns, rows)):
            place = (table["ref_x_m"][at] + 1j * table["ref_y_m"][at]) * np.exp(1j * heading_rad) + x_m + 1j * y_m
            table["ref_x_m"][at], table["ref_y_m"][at] = place.real, place.imag
            table["ref_theta_rad"][at] += heading_rad
    mapped = replace(
        campaign,
        reference=replace(campaign.reference, frame="map"),
        runs=replace(campaign.runs, numbers=numbers),
        logs=replace(campaign.logs, columns=columns),
    )
    found = estimate_geometry(mapped)
    assert found.passed
    for name, truth in TRUTH.items():
        low, high = found[name].ci95
        assert low < truth < high


def test_a_doubtful_geometry_gives_no_coefficients_without_a_reason(tmp_path: Path) -> None:
    """And the reason stands in the file, with what it sets aside."""
    campaign = recorded(tmp_path, blunder="a robot that strafes")
    found = estimate_geometry(campaign)
    assert found.verdict is GeometryVerdict.DOUBTFUL
    assert any("strafes" in reason for reason in found.why)
    with pytest.raises(ImplausibleError, match="strafes"):
        from_geometry(found, campaign)
    accepted = from_geometry(found, campaign, accept="wheels are omnidirectional").accepted_implausible
    assert accepted is not None
    assert accepted.reason == "wheels are omnidirectional"
    assert any("strafes" in finding for finding in accepted.findings)


@pytest.mark.parametrize(("radius_m", "gained"), [(steered.RADIUS_M, False), (1.005 * steered.RADIUS_M, True)])
def test_a_calibration_that_gains_nothing_says_so(radius_m: float, gained: bool, tmp_path: Path) -> None:
    """A vehicle as it is stated, beside one whose radius is off by half a per cent."""
    found = estimate_geometry(read_campaign(steered.write(tmp_path / "c", lambda angle, _: angle, radius_m=radius_m)))
    assert found.passed
    assert any("no better than the nominal values" in each for each in verdict_sentences(found)) is not gained


def test_a_small_share_of_the_way_far_beyond_the_noise_is_said(tmp_path: Path) -> None:
    """20 mm beside a noise of 3 mm: calibrated where the way is long enough, with where to look for the cause."""
    found = estimate_geometry(read_campaign(steered.write(tmp_path / "c", lambda angle, _: angle)))
    position = replace(found.judgement.position, before=0.02, after=0.02, held_out=0.02, noise=0.003)
    for after, said in ((0.02, True), (0.008, False)):
        judgement = replace(found.judgement, position=replace(position, after=after))
        sentences = verdict_sentences(replace(found, judgement=judgement))
        assert any("The position error left is 6.7 times the noise" in each for each in sentences) is said


@pytest.mark.parametrize(("senses", "told"), [((1, -1), False), ((1, -1, 1), False), ((1, -1, 1, -1), True)])
def test_few_runs_are_held_out_only_where_the_others_tell_as_much(senses: tuple[int, ...], told: bool) -> None:
    """The only square of its sense leaves radii and track to the nominal values: its error is no one's but theirs."""
    routes = [("square", square(2.0, sense)) for sense in senses]
    found = estimate_geometry(campaign(routes, Truth(), np.random.default_rng(1)))
    adequacy = found.to_dict()["adequacy"]
    assert found.passed and adequacy["held_out_rms_m"] != adequacy["after_rms_m"]
    assert (adequacy["held_out_rms_m"] is not None) is told
    assert ("too few runs to hold one out" in verdict_sentences(found)[0]) is not told
    assert "nothing is gained" not in " ".join(verdict_sentences(found))


def test_a_run_that_the_result_leads_aside_is_no_chance() -> None:
    """A route of its own ends right without the result: of 400 sound results one in a hundred, at most ten, says so."""
    from calib.kinematics.adequacy import _harmed

    run_id, way_m = np.array(["r0", "r1", "r2"]), np.full(3, 8.0)
    before, after = np.zeros((3, 3)), np.array([[0.01, 0.0, 0.0], [0.0, 0.142, 0.0], [0.0, 0.03, 0.0]])
    assert ["run r1 ends 142 mm" in text for text in _harmed(run_id, before, after, way_m, 0.009, 2)] == [True]
    # lengths alike, and without exponents
    (far,) = _harmed(run_id, before + np.array([0.166, 0.0, 0.0]), 10.0 * after, way_m, 0.009, 2)
    assert "run r1 ends 1420 mm off with the result and 166 mm without it" in far
    # as small as calibrated odometry leaves, or scattered as much
    assert not [*_harmed(run_id, before, after, 5.0 * way_m, 0.009, 2)]
    assert not [*_harmed(run_id, before, after, way_m, 0.05, 2)]
    rng, said = np.random.default_rng(1), 0
    for _ in range(400):
        replicates, noise = rng.normal(size=(3, 2)), np.zeros((3, 3))
        noise[:, :2] = rng.normal(size=(3, 2))
        scatter_m = float(np.sqrt(3.0 * replicates.var(axis=0).sum() / 2.0))
        said += len([*_harmed(run_id, before, noise, 1e-3 * way_m, scatter_m, 2)])
    assert said <= 10


def test_the_number_of_outliers_is_that_of_the_list(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where some of those listed are off by less than calibrated odometry is: their number is told beside it."""
    from calib.kinematics import adequacy

    monkeypatch.setattr(adequacy, "_along", lambda *_: iter(()))
    names, seen = np.array([f"r{n}" for n in range(24)]), np.ones((24, 3), dtype=bool)
    recording = SimpleNamespace(run_id=names, lengths_alone=False)
    model: Any = SimpleNamespace(segments=SimpleNamespace(run=np.arange(24), seen=seen), recording=recording)
    fitted: Any = SimpleNamespace(model=model, parameters=SimpleNamespace(free=np.ones(3)), zero_spread_rad=0.0)
    left = Residuals(0.1, 0.05, 0.05, 0.05, 8.0)
    for n_large, beside in ((10, ""), (9, ", 9 by more than 0.5 % of way or rotation")):
        said = [*adequacy._further(fitted, model, names[:10], np.arange(24) < n_large, left, left)]
        assert said == [f"10 of 24 runs are outliers{beside}: look at their references, times and counts"]


def test_the_noise_of_whole_runs_is_that_of_their_windows_where_none_was_driven_twice() -> None:
    """Of sound recordings of unlike routes the ends leave their noise, which is less than the usual drift of wheels."""
    judgement = estimate_geometry(in_map(8)).judgement
    for of in (judgement.position, judgement.heading):
        # both are known to a third of themselves by so few ends
        assert of.noise / 2.0 < of.after < 2.0 * of.noise < of.usual_noise


def test_what_windows_show_is_told_beside_end_poses_that_are_taken() -> None:
    """A clock or a sensor that was moved hardly shows at ends: the result is theirs, the remark that of the windows."""
    ends = estimate_geometry(campaign(mixed(1), Truth(), np.random.default_rng(5), samples=50), using="end_poses")
    windows: Any = SimpleNamespace(verdict=GeometryVerdict.WRONG, why=("t_s: the clock runs fast.", "more"))
    told = _told_by(windows, ends)
    assert told.notes[len(ends.notes) :] == (
        "By windows of the recordings the result is wrong: t_s: the clock runs fast.",
    )


def test_a_reference_computed_from_the_counts_is_none_however_it_was_rounded(tmp_path: Path) -> None:
    """Poses of the nominal odometry, written to 0.1 mm: they are off by less than two counts of 0.08 mm."""
    recording = plant.differential(np.random.default_rng(0))
    DIFFERENTIAL["reference by the vehicle's own odometry"](recording)
    for run in recording.runs:
        run.log |= {name: np.round(run.log[name], 4) for name in ("ref_x_m", "ref_y_m")}
        run.log["ref_theta_rad"] = np.round(run.log["ref_theta_rad"], 5)
    found = estimate_geometry(read_campaign(plant.write(recording, tmp_path / "c")))
    assert found.verdict is not GeometryVerdict.CALIBRATED
    assert "computed from the counts" in " ".join(found.why)
