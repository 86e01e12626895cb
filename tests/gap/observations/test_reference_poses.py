"""References as they are: in a map, off the axle, turned about, without a heading, over a part of the run only."""

from __future__ import annotations

import numpy as np
import pytest

from calib.campaign.check import notes_for_results
from calib.campaign.settings import Reference
from calib.errors import RefusedError
from calib.gap.diagnose import diagnose_in_full
from calib.gap.effects.floor import common_frame, far_end_m, floor_place, map_heading_rad
from calib.gap.effects.library import effect_class
from calib.gap.observations.from_campaign import observations_of
from calib.gap.predict import predict, residuals
from tests.gap.observations.paths import ROUTE, Truth, campaign_of, seen

#: sums of some hundred exact arcs in double precision
ROUNDING = 1e-9
STARTS = [(0.3 + 0.7 * k - 1j * k, 0.4 * k - 2.0) for k in range(15)]


def routes(n: int = 15) -> list[Truth]:
    return [Truth(ROUTE, start, heading) for start, heading in STARTS[:n]]


@pytest.mark.parametrize("frame", ["map", None])
@pytest.mark.parametrize("n", [15, 1])
def test_runs_anywhere_in_a_map_end_as_seen_from_their_own_start(frame: str | None, n: int) -> None:
    """Wherever and however a run begins in the map, and however many there are, its unit ends where the truth says."""
    truths = routes(n)
    logs = [truth.counts() | seen(truth, in_map=True) for truth in truths]
    observations = observations_of(campaign_of(logs, Reference(frame=frame)))  # type: ignore[arg-type]
    assert observations.common_frame
    whole = observations.window == 0
    np.testing.assert_allclose(observations.start_pose[whole, 2], [h for _, h in STARTS[:n]], atol=ROUNDING)
    if n >= 12:
        np.testing.assert_allclose(observations.measured[:, 1:4], [t.end() for t in truths], atol=ROUNDING)
    else:
        # few runs are cut into windows: the turns of all windows add up to the whole
        assert observations.windowed
        assert observations.measured[:, 3].sum() == pytest.approx(truths[0].end()[2], abs=ROUNDING)


@pytest.mark.parametrize("frame", ["map", "start", "vehicle"])
@pytest.mark.parametrize(("place", "yaw"), [(0.4 - 0.25j, 0.0), (0.0, 1.55), (-1.2 + 0.3j, -3.0)])
def test_a_sensor_anywhere_on_the_vehicle_tells_the_axle(frame: str, place: complex, yaw: float) -> None:
    """The sensor's own motion, or its place in the map, gives the axle's motion once its pose is stated.

    So does its place in the frame of the vehicle's start: the first pose is the stated one.
    """
    in_map = frame == "map"
    truths = [Truth(ROUTE) for _ in STARTS] if frame == "vehicle" else routes()
    logs = [truth.counts() | seen(truth, place, yaw, in_map=frame != "start") for truth in truths]
    where = {"sensor_x_m": complex(place).real, "sensor_y_m": complex(place).imag, "sensor_yaw_rad": yaw}
    observations = observations_of(campaign_of(logs, Reference(frame="map" if in_map else "start", **where)))
    np.testing.assert_allclose(observations.measured[:, 1:4], [t.end() for t in truths], atol=ROUNDING)
    assert observations.common_frame == in_map


def test_end_poses_of_the_table_know_the_sensor_too() -> None:
    """Without a log of poses the row's end pose, since the sensor's own start, is turned into the axle's."""
    truths = routes()
    ends = [seen(truth, 0.4j, 1.5, in_map=False) for truth in truths]
    numbers = {name: np.array([end[name][-1] for end in ends]) for name in ends[0]}
    where = Reference(sensor_y_m=0.4, sensor_yaw_rad=1.5)
    observations = observations_of(campaign_of([t.counts() for t in truths], where, numbers))
    np.testing.assert_allclose(observations.measured[:, 1:4], [t.end() for t in truths], atol=ROUNDING)


@pytest.mark.parametrize("place", [0.0, 0.3 + 0.2j])
def test_positions_alone_give_headings_by_the_course(place: complex) -> None:
    """Without headings the course stands in, less what the wheels say of heading against course: exact data, exact."""
    truths = routes()
    logs = []
    for truth in truths:
        poses = seen(truth, place, in_map=True)
        del poses["ref_theta_rad"]
        logs.append(truth.counts() | poses)
    where = Reference(frame="map", sensor_x_m=complex(place).real, sensor_y_m=complex(place).imag)
    observations = observations_of(campaign_of(logs, where))
    # chords of the steps, half a centimetre of an arc of 1 m radius, differ from the arcs by 1e-6 of their length
    np.testing.assert_allclose(observations.measured[:, 1:4], [t.end() for t in truths], atol=2e-5)
    assert (observations.sigma_start_rad > 0).all()
    assert any("without a heading" in note for note in observations.notes)


#: of what the fault moves, root mean square: turns of 0.1 rad to first order, a tenth of 0.1 s of a weave of 5 m
COURSE_SHARE = 0.08


@pytest.mark.parametrize(
    ("place", "late_s", "effect", "size", "n"),
    [
        (0.1 - 0.05j, 0.0, "reference_lever_arm", (0.1, -0.05), 15),
        (0.1 - 0.05j, 0.0, "reference_lever_arm", (0.1, -0.05), 6),
        (0.0, 0.2, "reference_latency", (0.2,), 6),
    ],
)
def test_a_place_or_a_delay_turns_headings_taken_from_the_course(
    place: complex, late_s: float, effect: str, size: tuple[float, ...], n: int
) -> None:
    """A sensor off its stated place, or late, takes another course in curves, as the effect of its size says."""
    weave, logs = [(0.1, 0.8 * float(np.sin(0.4 * np.pi * 0.1 * k))) for k in range(100)], []
    for start, heading in STARTS[:n]:
        truth = Truth(weave, start, heading)
        poses = seen(truth, place, in_map=True)
        late = {name: np.interp(truth.t - late_s, truth.t, poses[name]) for name in ("ref_x_m", "ref_y_m")}
        # recorded on the move
        logs.append({name: values[60:] for name, values in (truth.counts() | late).items()})
    observations = observations_of(campaign_of(logs, Reference(frame="map")))
    nominal = predict(observations)
    form = effect_class(effect)().forms(observations)[0]
    moves = [push.scaled(one) for push, one in zip(form.perturbations(nominal), size, strict=True)]
    off, left = (residuals(path, nominal)[:, 1:4] for path in (nominal, predict(observations, moves)))
    assert (np.sqrt(np.mean(left**2, axis=0)) < COURSE_SHARE * np.sqrt(np.mean(off**2, axis=0))).all()


def test_the_stated_heading_of_a_course_is_that_of_monte_carlo() -> None:
    """With scatter of 2 mm the headings at both ends scatter as stated."""
    rng = np.random.default_rng(8)
    logs, truths = [], []
    for k in range(60):
        truth = Truth([(4.0, 0.1)], 1j * k, 0.1 * k)
        poses = seen(truth, in_map=True)
        del poses["ref_theta_rad"]
        for name in poses:
            poses[name] = poses[name] + rng.normal(0, 0.002, len(truth.t))
        truths.append(truth)
        logs.append(truth.counts() | poses)
    observations = observations_of(campaign_of(logs, Reference(frame="map")))
    off = observations.measured[:, 3] - np.array([t.end()[2] for t in truths])
    stated = np.hypot(observations.sigma[:, 3], observations.sigma_start_rad)
    # 60 draws: the standard deviation scatters by 1 / sqrt(120) = 9 %; four of these
    assert np.sqrt(np.mean((off / stated) ** 2)) == pytest.approx(1.0, abs=0.37)


def test_a_reference_that_sees_a_part_of_the_run_is_compared_with_that_part() -> None:
    """Counts before the first and after the last pose are omitted, and so is the distance of the whole."""
    truth = Truth(ROUTE, 2.0 + 1j, 0.7)
    poses = seen(truth, in_map=True)
    part = slice(100, 450)
    for name, column in poses.items():
        kept = np.full(len(column), np.nan)
        kept[part] = column[part]
        poses[name] = kept
    logs = [truth.counts() | poses] * 12
    observations = observations_of(campaign_of(logs, Reference(frame="map"), {"distance_m": np.full(12, 7.0)}))
    turned = truth.heading[part][-1] - truth.heading[part][0]
    np.testing.assert_allclose(observations.measured[:, 3], turned, atol=ROUNDING)
    np.testing.assert_allclose(observations.total(observations.turn_rad), turned, atol=1e-6)
    assert np.isnan(observations.measured[:, 0]).all()


def test_an_end_pose_in_a_map_without_the_start_is_not_used() -> None:
    truths = routes()
    numbers = {
        "ref_x_m": np.array([t.place[-1].real for t in truths]),
        "ref_y_m": np.array([t.place[-1].imag for t in truths]),
        "distance_m": np.full(15, 7.5),
    }
    observations = observations_of(campaign_of([t.counts() for t in truths], Reference(frame="map"), numbers))
    assert np.isnan(observations.measured[:, 1:4]).all()
    assert observations.usable[:, 0].all()


@pytest.mark.parametrize("n", [15, 3])
def test_places_on_the_floor_are_those_of_the_map(n: int) -> None:
    """In a map every step of every run, whole or window, stands where the truth was on the floor, heading included."""
    truths = routes(n)
    logs = [truth.counts() | seen(truth, in_map=True) for truth in truths]
    observations = observations_of(campaign_of(logs, Reference(frame="map")))
    assert common_frame(observations)
    path = predict(observations)
    x, y = floor_place(path, far_end_m(path.s))
    heading = map_heading_rad(path)
    for run, truth in enumerate(truths):
        mine = observations.run[observations.unit] == run
        away = np.abs((x + 1j * y)[mine][:, None] - truth.place[None, :])
        # thinned steps of two centimetres, told at their middle
        assert away.min(axis=1).max() < 0.02
        turned = heading[mine] - truth.heading[away.argmin(axis=1)]
        assert np.abs(turned).max() < 0.05


def test_starts_of_their_own_have_no_common_floor() -> None:
    truths = routes()
    logs = [truth.counts() | seen(truth, in_map=False) for truth in truths]
    for frame, direction, common in (("start", "out", False), (None, "", False), (None, "out", True)):
        made = campaign_of(logs, Reference(frame=frame), direction=[direction] * 15)  # type: ignore[arg-type]
        assert common_frame(observations_of(made)) is common


def test_journeys_of_which_none_was_driven_twice_are_cut_into_windows() -> None:
    """Fifteen free drives, each its own route, say nothing of a floor as runs; repeated ones stay whole."""
    free = [Truth([(2.0 + 0.7 * k, 0.0), (1.5, (-1) ** k * (0.3 + 0.1 * k)), (1.0 + 0.5 * k, 0.0)]) for k in range(15)]
    for truths, windowed in ((free, True), (routes(), False)):
        logs = [truth.counts() | seen(truth, in_map=True) for truth in truths]
        assert observations_of(campaign_of(logs, Reference(frame="map"))).windowed is windowed


@pytest.mark.parametrize(("sigma_m", "least_m"), [(0.002, 3.0), (0.08, 6.4)])
def test_windows_are_as_long_as_the_reference_is_noisy(sigma_m: float, least_m: float) -> None:
    """Ways of 26 m a run, cut where one of a window is known to 1 % (8 m) but at 4 m at least."""
    free = [Truth([(20.0 + 0.7 * k, 0.0), (1.5, (-1) ** k * (0.3 + 0.1 * k)), (4.0, 0.0)]) for k in range(15)]
    logs = [truth.counts() | seen(truth, in_map=True) for truth in free]
    observations = observations_of(campaign_of(logs, Reference(frame="map", sigma_xy_m=sigma_m)), into_windows=True)
    way_m = np.bincount(observations.unit, observations.travel_left_m)
    # whole windows fit a run: a fifth less at most
    assert least_m <= way_m.min() and way_m.mean() < 1.5 * least_m / 0.8


@pytest.mark.parametrize("end_in_table", [False, True])
def test_start_and_end_in_a_map_are_enough(end_in_table: bool) -> None:
    """A log with the start pose, and the end in the log or in the table: whole turns are those of the wheels."""
    turns = np.tile([0.55, 1.1, 1.1], 5)
    truths = [Truth([(2.0, 0.0), (2 * np.pi, turn)], *start) for turn, start in zip(turns, STARTS, strict=True)]
    logs, ends = [], []
    for truth in truths:
        poses = seen(truth, in_map=True)
        ends.append([column[-1] for column in poses.values()])
        for name, column in poses.items():
            middle = slice(1, None if end_in_table else -1)
            poses[name] = column.copy()
            poses[name][middle] = np.nan
        logs.append(truth.counts() | poses)
    numbers = dict(zip(poses, np.array(ends).T, strict=True))
    made = campaign_of(logs, Reference(frame="map"), numbers)
    observations = observations_of(made)
    np.testing.assert_allclose(observations.measured[:, 1:4], [t.end() for t in truths], atol=ROUNDING)
    np.testing.assert_allclose(observations.start_pose[:, 2], [h for _, h in STARTS], atol=ROUNDING)
    assert not any("swapped" in note or "turn(s) off" in note for note in notes_for_results(made))


def test_what_lacks_for_an_end_pose_in_a_map_is_said() -> None:
    truths = routes()
    ends = [seen(truth, in_map=True) for truth in truths]
    numbers = {name: np.array([end[name][-1] for end in ends]) for name in ends[0]}
    with pytest.raises(RefusedError, match=r"15 runs have an end pose in a map, .* where they begin"):
        observations_of(campaign_of([t.counts() for t in truths], Reference(frame="map"), numbers))


#: rad, m: of the stated sigmas
NOISE = 1e-3


@pytest.mark.parametrize(
    ("moved_m", "in_one", "verdict"), [(0.08, False, "undecided"), (0.0, False, "no_gap"), (0.08, True, None)]
)
def test_repeats_that_share_no_session_support_no_noise_level_far_beyond_the_stated_one(
    moved_m: float, in_one: bool, verdict: str | None
) -> None:
    """A sensor that was moved between sessions is no noise: beside one route a session it may be all that differs."""
    rng, logs, sessions = np.random.default_rng(3), [], []
    for session in range(3):
        for bend in (0.0, 0.5, -0.5, 0.8, -0.8) * (1 + in_one):
            truth = Truth([(2.0, 0.0), (2.0, bend), (2.0, 0.0)], steps=60)
            poses = seen(truth, complex(moved_m * (session - 1), 0.5 * moved_m * (session == 2)), in_map=False)
            noisy = {name: values + rng.normal(0, NOISE, len(values)) for name, values in poses.items()}
            logs.append(truth.counts() | noisy)
            sessions.append(f"s{session}")
    campaign = campaign_of(logs, Reference(frame="start", sigma_xy_m=NOISE, sigma_theta_rad=NOISE), session=sessions)
    found = diagnose_in_full(campaign, plan=False)
    assert found.kind.value == verdict or (verdict is None and found.kind.value not in ("no_gap", "explained"))


def test_windows_in_which_the_reference_leaps_are_omitted() -> None:
    """A stretch of positions half a metre aside spoils the windows at its ends; all others are as without it."""
    truth = routes(1)[0]
    log = truth.counts() | seen(truth, in_map=True)
    n = len(log["ref_x_m"])
    inside = (np.arange(n) > 0.3 * n) & (np.arange(n) < 0.7 * n)
    moved = log | {name: log[name] + 0.5 * inside for name in ("ref_x_m", "ref_y_m")}
    whole, seen_off = (
        observations_of(campaign_of([each], Reference(frame="map")), into_windows=True) for each in (log, moved)
    )
    kept = np.isin(whole.window, seen_off.window)
    assert 0 < len(whole) - kept.sum() <= 2 and any("omitted" in note for note in seen_off.notes)
    np.testing.assert_allclose(seen_off.measured[:, 1:4], whole.measured[kept, 1:4], atol=ROUNDING)
