"""Wheels are found by the names that robots and laboratories give them, or by what they do: both sides or neither."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib.campaign.checks.counts import count_jumps
from calib.campaign.ingest.build import ingest
from calib.campaign.ingest.describe import describe
from calib.campaign.ingest.guesses import guessed_log_column, side_of
from calib.campaign.read import log_totals
from calib.errors import BadFileError

TWO = "counts_left", "counts_right"
FOUR = "counts_front_left", "counts_front_right", "counts_rear_left", "counts_rear_right"
#: names of two joints of robots and laboratories
PAIRS = [
    ("left_wheel_joint", "right_wheel_joint"),
    ("wheel_left_joint", "wheel_right_joint"),
    ("front_left_wheel", "front_right_wheel"),
    ("rear_left_joint", "rear_right_joint"),
    ("left_joint", "right_joint"),
    ("wheel_joint_left", "wheel_joint_right"),
    ("base_l_drive_wheel_joint", "base_r_drive_wheel_joint"),
    ("left_wheel", "right_wheel"),
    ("l_wheel_joint", "r_wheel_joint"),
    ("fl_wheel_joint", "fr_wheel_joint"),
    ("Geber_links", "Geber_rechts"),
    ("encoder_left_ticks", "encoder_right_ticks"),
    ("Enc L [cnt]", "Enc R [cnt]"),
]
#: names in any order of words, and the line that a log of numbers with decimals is to have
IN_ANY_ORDER = {
    "left wheel angle [deg]": 'counts_left = "left wheel angle [deg]"',
    "angle_wheel_l_rad": 'counts_left = "angle_wheel_l_rad"',
    "position left wheel [rad]": 'counts_left = "position left wheel [rad]"',
    "Radwinkel links [°]": 'counts_left = "Radwinkel links [°]"',
    "Umdrehungen links": 'counts_left = {column = "Umdrehungen links", unit = "turns"}',
    "wheel_left_turns": 'counts_left = {column = "wheel_left_turns", unit = "turns"}',
    "giri ruota sx": 'counts_left = {column = "giri ruota sx", unit = "turns"}',
    "Drehzahl links [1/min]": 'counts_left = "Drehzahl links [1/min]"',
    "rpm_left": 'counts_left = {column = "rpm_left", unit = "rpm"}',
    "left wheel speed [rad/s]": 'counts_left = "left wheel speed [rad/s]"',
    "wheel_l_rad_s": 'counts_left = {column = "wheel_l_rad_s", unit = "rad/s"}',
    "Weg links [mm]": 'counts_left = "Weg links [mm]"',
    "cumulative distance left wheel (m)": 'counts_left = "cumulative distance left wheel (m)"',
    "v_left_mm_s": 'speed_left_mps = {column = "v_left_mm_s", unit = "mmps"}',
    "left_wheel_velocity": 'speed_left_mps = {column = "left_wheel_velocity", unit = "mps"}',
}
#: with a side, and no wheel
NO_WHEELS = (
    "distance left [m]",
    "Abstand links [mm]",
    "force left wheel [N]",
    "motor temperature left",
    "theta_r [rad]",
)


def _log(path: Path, columns: dict[str, np.ndarray], form: str = ".6f") -> Path:
    rows = [",".join(columns), *(",".join(f"{x:{form}}" for x in row) for row in zip(*columns.values(), strict=True))]
    path.write_text("\n".join(rows) + "\n")
    return path


def _turned(n: int = 400, seed: int = 2) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, and counts of two wheels that drive at changing speed."""
    rng = np.random.default_rng(seed)
    speed = 250 + 60 * np.sin(np.arange(n) / 30)
    left, right = (np.cumsum(np.rint(speed + 8 * rng.standard_normal(n))) for _ in range(2))
    return np.arange(n) / 20, left, right


def _wheel_lines(text: str) -> list[str]:
    return [line for line in text.splitlines() if line.startswith("counts_") and "_per_rev" not in line]


@pytest.mark.parametrize("names", PAIRS)
def test_two_wheels_are_found_by_their_names(names: tuple[str, str], tmp_path: Path) -> None:
    time, left, right = _turned()
    lines = _wheel_lines(
        describe([_log(tmp_path / "l.csv", dict(zip(("t_s", *names), (time, left, right), strict=True)))]).to_toml()
    )
    assert [line.split(" = ")[0] for line in lines] == list(TWO)
    assert names[0] in lines[0] and names[1] in lines[1]


def test_what_wheels_turn_or_roll_is_found_in_any_order_of_words(tmp_path: Path) -> None:
    time, left, right = _turned()
    others = {"left": "right", "links": "rechts", "_l": "_r", "sx": "dx"}
    for number, (name, line) in enumerate(IN_ANY_ORDER.items()):
        other = next(name.replace(side, opposite) for side, opposite in others.items() if side in name)
        columns = {"t_s": time, name: 0.0123 * left, other: 0.0123 * right}
        text = describe([_log(tmp_path / f"{number}.csv", columns)]).to_toml()
        assert line in text, name
        assert other in next(each for each in text.splitlines() if each.startswith(line.replace("left", "right")[:12]))
    assert not [name for name in NO_WHEELS if (guessed_log_column(name) or "").startswith(("counts_", "speed_"))]


def test_what_no_instrument_measured_is_no_distance(tmp_path: Path) -> None:
    """An odometer's distances, and commanded ones, give way to the laser's; the unit of small loads is to be stated."""
    table = (
        "Run;dist_odo_m;Sollstrecke [m];{};Last links;Last rechts\nr1;9.9;10;9.95;21.4;19.3\nr2;8.9;9;8.95;36.7;34.6\n"
    )
    (tmp_path / "runs.csv").write_text(table.format("dist_laser_m"))
    proposed = describe([tmp_path / "runs.csv"]).to_toml()
    assert 'distance_m = {column = "dist_laser_m", unit = "m"}' in proposed
    assert '#load_left_N = {column = "Last links", unit = "N"}   # names no unit: kg, g' in proposed
    (tmp_path / "runs.csv").write_text(table.format("Remark"))
    assert "\ndistance_m" not in describe([tmp_path / "runs.csv"]).to_toml()
    time, left, right = _turned()
    log = {
        "t_s": time,
        "enc_l": left,
        "enc_r": right,
        "distance": 1e-3 * left,
        "laser": 1e-3 * left + 0.3,
        "x": left,
        "y": right,
    }
    text = describe([_log(tmp_path / "l.csv", log)]).to_toml()
    assert 'range_m = {column = "laser"' in text
    assert "# wheel odometry is no reference: keep these lines only if it measures from outside" in text
    log |= {"yaw": 1e-3 * left, "gt_x": left, "gt_y": right, "gt_yaw": 1e-3 * left}
    text = describe([_log(tmp_path / "tracked.csv", log)]).to_toml()
    assert [name for name in ("gt_x", "gt_y", "gt_yaw") if f'{{column = "{name}", unit = ' not in text] == []


def test_speed_and_rate_of_the_vehicle_are_taken_where_no_wheel_is(tmp_path: Path) -> None:
    """Both or neither: beside counts the one is a set speed, the other a gyro's rate."""
    time, left, right = _turned()
    twist = {"t_s": time, "speed": 0.5 + 0.01 * np.sin(time), "yaw_rate": 0.3 * np.sin(time)}
    text = describe([_log(tmp_path / "twist.csv", twist)]).to_toml()
    assert 'v_mps = {column = "speed", unit = "mps"}' in text
    assert 'omega_radps = {column = "yaw_rate", unit = "radps"}' in text
    assert 'kind = "speed"' in text
    text = describe([_log(tmp_path / "both.csv", twist | {"enc_l": left, "enc_r": right})]).to_toml()
    assert "v_mps" not in text
    assert 'gyro_z_radps = {column = "yaw_rate", unit = "radps"}' in text


@pytest.mark.parametrize("unit", ["m", "cm", "mm"])
def test_what_wheels_rolled_becomes_counts_of_the_nominal_radius(unit: str, tmp_path: Path) -> None:
    """A wheel of 0.08 m and 4096 counts rolls 2 pi 0.08 m a revolution, in logs and in run tables."""
    scale, n = {"m": 1.0, "cm": 100.0, "mm": 1000.0}[unit], 50
    way_m = np.linspace(0.0, 10.0, n)
    _log(tmp_path / "r1.csv", {"t_s": np.arange(n) / 5, "L": scale * way_m, "R": 1.001 * scale * way_m}, ".9f")
    (tmp_path / "runs.csv").write_text(f"run_id,distance_m,L,R\nr1,10.0,{10.0 * scale},{10.01 * scale}\n")
    wheels = "\n".join(
        f'counts_{side} = {{column = "{side[0].upper()}", unit = "{unit}"}}' for side in ("left", "right")
    )
    mapping = tmp_path / "mapping.toml"
    mapping.write_text(
        'name = "rolled"\n[vehicle]\ndrive = "differential"\nwheel_radius_m = 0.08\n[encoder]\ncounts_per_rev = 4096\n'
        f'[table]\n{wheels}\n[log]\nfile = "{{run_id}}.csv"\n{wheels}\n'
    )
    sources = [tmp_path / "runs.csv", tmp_path / "r1.csv"]
    campaign = ingest(sources, tmp_path / "c", mapping=mapping).campaign
    expected = 10.0 / (2.0 * np.pi * 0.08) * 4096.0
    for found in (campaign.runs.number, lambda name: log_totals(campaign.logs, name)):
        assert found("counts_left") == pytest.approx([expected], rel=1e-9)
        assert found("counts_right") == pytest.approx([1.001 * expected], rel=1e-9)
    assert any("by the nominal radius" in note.text for note in campaign.notes)


@pytest.mark.parametrize("name", ["front_left_wheel", "front_left_wheel_joint", "wheel_front_left_joint", "fl_wheel"])
def test_a_wheel_at_a_corner_is_one(name: str) -> None:
    assert guessed_log_column(f"/joint_states:position.{name}") == "counts_front_left"


@pytest.mark.parametrize("coupled", [True, False])
def test_four_wheels_are_skid_steer_where_those_of_a_side_turn_alike(coupled: bool, tmp_path: Path) -> None:
    """Husky and Jackal: one wheel of each side; of a mecanum drive all four."""
    time, left, right = _turned()
    rear = (left, right) if coupled else (0.6 * left, 1.4 * right)
    names = ("front_left_wheel", "front_right_wheel", "rear_left_wheel", "rear_right_wheel")
    columns = dict(zip(("t_s", *names), (time, left, right, *rear), strict=True))
    text = describe([_log(tmp_path / "l.csv", columns)]).to_toml()
    assert [line.split(" = ")[0] for line in _wheel_lines(text)] == list(TWO if coupled else FOUR)
    assert ("skid steer" in text) == coupled
    assert ('drive = "mecanum"   #' in text) == (not coupled)


def test_one_side_alone_is_none(tmp_path: Path) -> None:
    time, left, _ = _turned()
    text = describe([_log(tmp_path / "l.csv", {"t_s": time, "wheel_left": left, "voltage": 24 + 0 * time})]).to_toml()
    assert _wheel_lines(text) == []
    assert '#counts_left = "wheel_left"   # looks like a wheel, but no column looks like counts_right' in text


@pytest.mark.parametrize(
    ("names", "first"), [(("K7", "K3"), "K7"), (("QR", "QL"), "QL"), (("ch_re", "ch_li"), "ch_li")]
)
def test_counters_that_overflow_are_the_wheels(names: tuple[str, str], first: str, tmp_path: Path) -> None:
    """Of any name; the side by what the name says of it, else in their order with a remark."""
    time, one, other = _turned()
    path = _log(tmp_path / "l.csv", {"t_s": time, names[0]: one % 2**16, names[1]: other % 2**16, "n": time * 20})
    text = describe([path]).to_toml()
    [left, right] = _wheel_lines(text)
    assert left.startswith(f'counts_left = "{first}"') and right.startswith("counts_right = ")
    assert ("not said: check" in left) == (names[0] == "K7")
    assert "wrap_bits = 16" in text


@pytest.mark.parametrize(
    ("make", "unit"),
    [
        (lambda counts: np.diff(counts, prepend=0.0), "counts/sample"),
        (lambda counts: np.diff(counts, prepend=counts[0]), "counts/sample"),
        (lambda counts: counts / 4096 * 2 * np.pi, "rad"),
        (lambda counts: np.angle(np.exp(1j * counts / 4096 * 2 * np.pi)), "rad"),
        (lambda counts: (counts / 4096 * 360) % 360, "deg"),
    ],
    ids=["increments", "increments from a stand", "radians", "radians of one turn", "degrees of one turn"],
)
def test_what_wheels_give_is_proposed_with_its_unit_and_ingested(make, unit: str, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    """The proposal goes in as it is, and the counts are those driven."""
    time, left, right = _turned()
    path = _log(tmp_path / "l.csv", {"t_s": time, "wheel_left": make(left), "wheel_right": make(right)}, ".9f")
    text = describe([path]).to_toml()
    assert [f'unit = "{unit}"' in line for line in _wheel_lines(text)] == [True, True], text
    mapping = tmp_path / "m.toml"
    mapping.write_text(text.replace("#counts_per_rev =   #", "counts_per_rev = 4096   #"))
    made = ingest([path], tmp_path / "c", mapping=mapping).campaign
    got = made.logs.columns["counts_right"]
    np.testing.assert_allclose(got - got[0], right - right[0], atol=1e-3)


def test_a_counter_that_goes_there_and_back_is_no_increment(tmp_path: Path) -> None:
    time, left, right = _turned()
    back = {name: np.concatenate([counts, counts[::-1]]) for name, counts in (("Enc_L", left), ("Enc_R", right))}
    path = _log(tmp_path / "l.csv", {"t_s": np.arange(2 * len(time)) / 20, **back})
    assert not any("unit" in line for line in _wheel_lines(describe([path]).to_toml()))


@pytest.mark.parametrize(
    ("name", "side"),
    [("Geber_links", "left"), ("QR", None), ("encoderRight", "right"), ("x", None), ("re_raw", "right")],
)
def test_a_side_is_read_from_a_name(name: str, side: str | None) -> None:
    assert side_of(name) == side


def _overflowing(at: np.ndarray) -> dict[str, np.ndarray]:
    """A 16-bit counter at times `at`, of wheels that drive 10 s at 6500 counts/s and stand 5 s, in turn."""
    driven = 6500.0 * sum(np.clip(at - 15.0 * number - 5.0, 0.0, 10.0) for number in range(6))
    return {"t_s": at, "Enc L": np.rint(driven + 60000) % 65536, "Enc R": np.rint(driven + 100) % 65536}


@pytest.mark.parametrize("clock", ["t_s", "tick"])
def test_a_gap_in_time_hides_no_overflow(clock: str, tmp_path: Path) -> None:
    """A step over 1.5 s without samples may hold more than an eighth of the counter: the overflows beside it count."""
    at = np.arange(0.0, 95.0, 0.05)
    at = at[(at < 6.0) | (at > 7.5)]
    columns = _overflowing(at)
    source = _log(tmp_path / "w.csv", {clock if name == "t_s" else name: cells for name, cells in columns.items()})
    lines = _wheel_lines(describe([source]).to_toml())
    assert [line.split(" = ")[0] for line in lines] == list(TWO)
    assert not any("counts/sample" in line for line in lines)
    if clock == "t_s":
        mapping = tmp_path / "m.toml"
        mapping.write_text(
            '[vehicle]\ndrive = "differential"\n[encoder]\ncounts_per_rev = 8192\n[log]\ncounts_left = "Enc L"\n'
            'counts_right = "Enc R"\n[cut]\nby = "stops"\nmin_stop_s = 2.0\n'
        )
        campaign = ingest([source], tmp_path / "c", mapping=mapping).campaign
        assert log_totals(campaign.logs, "counts_left") == pytest.approx(np.full(6, 65000.0), abs=2)
        assert not list(count_jumps(campaign))


def test_wheels_of_one_vehicle_have_one_unit(tmp_path: Path) -> None:
    """An angle that falls where the other wheel's rises is no rate (radians beside radians per second, proposed)."""
    t = np.linspace(0.0, 40.0, 401)
    right = 30.0 * t / 40.0
    left = np.where(t < 20.0, right, 30.0 - right)
    log = _log(tmp_path / "run.csv", {"t": t, "enc_l": left, "enc_r": right})
    lines = [line for line in describe([log]).to_toml().splitlines() if line.startswith(TWO)]
    assert len(lines) == 2 and all('unit = "rad"' in line for line in lines)


def test_one_column_is_no_two_wheels(tmp_path: Path) -> None:
    log = _log(tmp_path / "run.csv", {"t_s": np.arange(9.0), "left": np.arange(9.0), "right": np.arange(9.0)})
    (mapping := tmp_path / "m.toml").write_text('[log]\ncounts_left = "left"\ncounts_right = "left"\n')
    with pytest.raises(BadFileError, match="another column than that of counts_left"):
        ingest([log], tmp_path / "c", mapping=mapping)
