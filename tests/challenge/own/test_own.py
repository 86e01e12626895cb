"""Known effects planted on a campaign's own noise: the replay, the noise, the judgement, and the whole way through."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import pytest

from calib.campaign.model import Campaign
from calib.challenge.judge import answer_of
from calib.challenge.own_replay import Replay, own_noise, true_angles
from calib.challenge.own_runs import challenge_own, parse_sizes, plants_of
from calib.errors import BadInputError
from calib.gap.decision.diagnosis import Diagnosis
from calib.gap.diagnose import diagnose_in_full
from calib.plant import World
from calib.plant.design import good_design
from calib.plant.make import make_campaign
from tests.kinematics.campaigns import tricycle

#: two integrators of the same counts, exact arcs each, differ by how the curvature changes within a step
ARCS_M, ARCS_RAD = 2e-3, 1e-9
#: the track enters a turn by its inverse: second order at one per cent
SECOND_ORDER = 2e-4


@pytest.fixture(scope="module")
def campaign() -> Campaign:
    rng = np.random.default_rng(3)
    return make_campaign(good_design(rng, n_runs=30), {}, rng, name="calibrated")


@pytest.fixture(scope="module")
def diagnosis(campaign: Campaign) -> Diagnosis:
    return diagnose_in_full(campaign, plan=False)


@pytest.fixture(scope="module")
def steered() -> Diagnosis:
    """A vehicle on its front wheel alone."""
    return diagnose_in_full(tricycle(np.random.default_rng(1)), plan=False)


def test_the_replay_goes_where_the_diagnosis_predicts(diagnosis: Diagnosis) -> None:
    """Without any cause the plant's step-by-step drive and the diagnosis' integration end at the same poses."""
    replay = Replay.of(diagnosis.observations)
    ours, theirs = replay.readings(None), diagnosis.nominal.reading
    np.testing.assert_allclose(ours[:, 1:3], theirs[:, 1:3], atol=ARCS_M)
    np.testing.assert_allclose(ours[:, 3], theirs[:, 3], atol=ARCS_RAD)


def test_a_wider_track_turns_less(diagnosis: Diagnosis) -> None:
    """One per cent of track is one per cent of every turn, for any route."""

    def wider(world: World) -> None:
        world.track = world.track * 1.01

    replay = Replay.of(diagnosis.observations)
    turn = replay.readings(None)[:, 3]
    np.testing.assert_allclose(replay.change(wider)[:, 3], -0.01 * turn, rtol=0.011, atol=SECOND_ORDER)


def test_a_front_wheel_is_replayed_at_its_true_angle(steered: Diagnosis) -> None:
    """A vehicle on its front wheel alone: at a constant angle d read, zero z and scale k turn it by travel sin / L."""
    replay = Replay.of(steered.observations)
    zero, scale = 5e-3, 1.01

    def other(world: World) -> None:
        world.steer_zero_rad, world.steer_scale = world.steer_zero_rad + zero, world.steer_scale * scale

    # lines, left and right arcs have one angle each, their own; the fourth kind weaves
    constant = np.array([not kind.startswith("weave") for kind in steered.observations.labels["kind"]])
    read = replay.steps["steer_rad"][1][constant]
    travel = replay.steps["front_m"].sum(axis=0)[constant]
    wheelbase_m = steered.observations.vehicle.wheelbase_m
    wanted = travel * (np.sin((read - zero) / scale) - np.sin(read)) / wheelbase_m
    np.testing.assert_allclose(replay.change(other)[constant, 3], wanted, atol=1e-9)
    names = ("steering_zero", "steering_scale", "steering_backlash", "steering_delay", "drive_slip")
    plants, left_out = plants_of(steered, replay, names, parse_sizes("10s"), np.random.default_rng(0))
    assert {plant.effect for plant in plants} | set(left_out) == set(names)
    assert {plant.effect for plant in plants} >= {"steering_zero", "steering_scale", "steering_backlash"}, left_out
    assert not any("only the front wheel" in reason for reason in left_out.values())
    for plant in plants:
        # what a delay does to whole periods of a weave has a bound, and its signal is said as it is
        bounded = plant.effect == "steering_delay" and plant.signal < 10.0
        assert bounded or plant.signal == pytest.approx(10.0, rel=0.02), plant.effect


def test_true_angles_are_those_that_a_late_sensor_with_play_would_read(steered: Diagnosis) -> None:
    """The plant's own sensor, fed with the true angles, reads what was logged: late by 0.1 s, play of 0.02 rad."""
    replay = Replay.of(steered.observations)
    time_s = replay.steps["time_s"]
    read = 0.3 * np.sin(0.3 * time_s)
    worlds = [World.__new__(World) for _ in range(2)]
    for world, (play, delay) in zip(worlds, ((0.02, 0.0), (0.0, 0.1)), strict=True):
        world.steer_zero_rad, world.steer_scale = 0.0, 1.0
        world.steer_backlash_rad, world.steer_delay_s = np.full(read.shape[1], play), np.full(read.shape[1], delay)
    with_play = true_angles(read, time_s, replay.last, worlds[0])
    shown, at = np.empty_like(read), read[0]
    for step, angle in enumerate(with_play):
        at = shown[step] = np.clip(at, angle - 0.01, angle + 0.01)
    # until 2 mrad of a move are over, its side is not known
    np.testing.assert_allclose(shown, read, atol=2.1e-3)
    assert np.abs(with_play - read).max() == pytest.approx(0.01)
    late = true_angles(read, time_s, replay.last, worlds[1])
    middle = slice(10, int(replay.last.min()) - 10)
    np.testing.assert_allclose(late[middle], 0.3 * np.sin(0.3 * (time_s[middle] + 0.1)), atol=1e-4)


def test_a_slipping_front_wheel_counts_more_than_the_way(steered: Diagnosis) -> None:
    """A share of one in a hundred beyond the way: the vehicle ends a hundredth short, for any path."""
    replay = Replay.of(steered.observations)

    def slips(world: World) -> None:
        world.during.append(lambda now: np.add(now.drive, 0.01, out=now.drive))

    plain, slipped = replay.readings(None), replay.readings(slips)
    np.testing.assert_allclose(slipped[:, 4], plain[:, 4] / 1.01, rtol=1e-9)
    np.testing.assert_allclose(slipped[:, 3], plain[:, 3] / 1.01, atol=1e-9)


def test_the_noise_is_the_campaigns_own(diagnosis: Diagnosis) -> None:
    """Every drawn unit is some unit of its group, all channels together; the mean square over many draws is kept."""
    covariance = diagnosis.noise.covariance
    noise = own_noise(diagnosis.observations, diagnosis.fitted.left, covariance)
    drawn = np.stack([noise.draw(np.random.default_rng(number)) for number in range(200)])
    white = np.linalg.solve(noise.root, drawn[0][:, :, None])[:, :, 0]
    for unit, row in enumerate(white):
        members = noise.whitened[noise.group == noise.group[unit]]
        assert min(np.abs(np.abs(members) - np.abs(row)).max(axis=1)) < 1e-9
    squares = np.linalg.solve(noise.root, drawn[:, :, :, None]) ** 2
    # 200 draws of 30 units and a few channels: the mean square is known to some 3 %
    assert squares.mean() == pytest.approx(np.mean(noise.whitened**2), rel=0.1)


def test_a_planted_size_has_its_signal(diagnosis: Diagnosis) -> None:
    """A size asked for by its signal shows by that much; one that cannot be shown is omitted with the reason."""
    replay = Replay.of(diagnosis.observations)
    names = ("track_width", "load_radius", "steering_zero")
    plants, left_out = plants_of(diagnosis, replay, names, parse_sizes("10s,2x,0.01"), np.random.default_rng(0))
    by_signal = [plant for plant in plants if plant.signal == pytest.approx(10.0, rel=0.02)]
    assert {plant.effect for plant in by_signal} >= {"track_width", "load_radius"}
    assert 0.02 in [plant.size for plant in plants if plant.effect == "track_width"]  # twice the typical 1 %
    assert "steering_zero" in left_out
    with pytest.raises(BadInputError, match="name one of these"):
        plants_of(diagnosis, replay, ("track_with",), parse_sizes("10s"), np.random.default_rng(0))


@pytest.mark.parametrize("text", ["", "10q", "s", "0", "1,,2", "1e999x,a"])
def test_sizes_that_are_none_are_refused(text: str) -> None:
    with pytest.raises(BadInputError, match="sizes"):
        parse_sizes(text)


@pytest.mark.parametrize(
    ("planted", "family", "verdict", "expected"),
    [
        ("wear", "drift", {"verdict": "no_gap"}, (False, False, False)),
        ("wear", "drift", {"verdict": "explained", "causes": [{"effect": "wear"}]}, (True, True, False)),
        (
            "wear",
            "drift",
            {"verdict": "explained", "causes": [{"effect": "session_step", "family": "drift"}]},
            (False, True, False),
        ),
        (
            "wear",
            "drift",
            {
                "verdict": "ambiguous",
                "causes": [{"effect": "load_radius", "family": "load"}],
                "indistinguishable": [["load_radius", "wear"]],
            },
            (False, True, False),
        ),
        (
            "wear",
            "drift",
            {"verdict": "explained", "causes": [{"effect": "load_radius", "family": "load"}]},
            (False, False, True),
        ),
        ("wear", "drift", {"verdict": "unknown", "causes": []}, (False, False, False)),
        ("", "", {"verdict": "explained", "causes": [{"effect": "wear"}], "recommended": True}, (False, False, True)),
        ("", "", {"verdict": "partly_explained", "causes": [{"effect": "wear"}]}, (False, False, False)),
    ],
)
def test_an_answer_is_first_in_its_group_or_wrong(
    planted: str, family: str, verdict: dict[str, object], expected: tuple[bool, bool, bool]
) -> None:
    """By hand: named first; in its group or family; something else named (of an outsider: a fix recommended)."""
    answer = answer_of(planted, family, verdict)
    assert (answer.first, answer.in_group, answer.wrong) == expected


def test_any_number_of_workers_gives_the_same_table(campaign: Campaign, monkeypatch: pytest.MonkeyPatch) -> None:
    """A strong track width is found on a calibrated campaign's own noise; nothing depends on the processes."""
    monkeypatch.setattr("calib.challenge.own_runs.EMPTY_EACH", 2)
    asked = {"effects": ("track_width",), "sizes": parse_sizes("25s"), "planted": 1, "seed": 1}
    one, two = (challenge_own(campaign, workers=workers, **asked) for workers in (1, 2))
    assert one.done == one.asked == 3
    documents = [{k: v for k, v in own.to_dict().items() if k != "seconds"} for own in (one, two)]
    assert documents[0] == documents[1]
    row = documents[0]["effects"]["track_width"][0]
    assert (row["planted"], row["in_group"], row["wrong"]) == (1, 1, 0)
    assert documents[0]["false_alarms"]["tried"] == 2
    assert all(asdict(answer)["verdict"] for answer in one.empty)


def test_the_time_is_kept(campaign: Campaign) -> None:
    """With no time at all nothing is begun, and the table says so."""
    own = challenge_own(campaign, ("track_width",), workers=1, seconds=0.0)
    assert (own.done, own.wrong.total, own.alarms.total) == (0, 0, 0)
    assert own.asked > 0
    assert own.trusted
