"""A description proposes what the files hold: no mapping without a number, no counter out of a letter."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from calib.campaign.ingest.build import ingest
from calib.campaign.ingest.describe import describe
from calib.errors import BadFileError, CalibError


def _write_bag(folder: Path, messages: list[tuple[str, str, dict[str, object]]]) -> Path:
    """Write a rosbag2 of the given topics, types and fields, a message each 20 ms."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        kinds = {topic: kind for topic, kind, _ in messages}
        topics = {topic: bag.add_connection(topic, kind, typestore=store) for topic, kind in kinds.items()}
        for number, (topic, kind, fields) in enumerate(messages):
            bag.write(topics[topic], 20_000_000 * (number + 1), store.serialize_cdr(store.types[kind](**fields), kind))
    return folder


def _joint_states(velocity: np.ndarray) -> list[tuple[str, str, dict[str, object]]]:
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS2_HUMBLE).types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](0, 0), "")
    fields = {"header": header, "name": ["left", "right"], "position": np.zeros(0), "effort": np.zeros(0)}
    return [("/joints", "sensor_msgs/msg/JointState", {**fields, "velocity": row}) for row in velocity]


def _log(path: Path, columns: dict[str, np.ndarray]) -> Path:
    rows = [",".join(columns), *(",".join(map(repr, map(float, row))) for row in zip(*columns.values(), strict=True))]
    path.write_text("\n".join(rows) + "\n")
    return path


@pytest.mark.parametrize("mapped", ["", 'counts_left = "/joints:position.left"\n'])
def test_a_bag_of_other_messages_is_refused_by_their_types(mapped: str, tmp_path: Path) -> None:
    """Neither a description nor ingest goes on without a number: one line names the types and what is read."""
    bag = _write_bag(tmp_path / "bag", [("/chatter", "std_msgs/msg/String", {"data": "hello"})] * 3)
    mapping = tmp_path / "m.toml"
    mapping.write_text(f'[log]\n{mapped}[cut]\nby = "stops"\n')
    for attempt in (lambda: describe([bag]), lambda: ingest([bag], tmp_path / "c", mapping=mapping)):
        with pytest.raises(
            CalibError, match=r"std_msgs/msg/String; expected wheels \(JointState.*record these"
        ) as caught:
            attempt()
        assert "\n" not in str(caught.value)


def test_an_empty_bag_says_so(tmp_path: Path) -> None:
    with pytest.raises(CalibError, match=r"no messages or samples at all.*record again"):
        describe([_write_bag(tmp_path / "bag", [])])


def test_folders_of_folders_are_named(tmp_path: Path) -> None:
    (tmp_path / "day" / "first").mkdir(parents=True)
    with pytest.raises(CalibError, match=r"day, which holds first/; .*the folder that holds them itself"):
        describe([tmp_path / "day"])


def test_a_letter_makes_no_counter(tmp_path: Path) -> None:
    """`r` that is no whole number may be a range; what is missing is asked for instead."""
    time = np.arange(100) / 10
    text = describe([_log(tmp_path / "log.csv", {"t_s": time, "r": 4.0 - 0.1234 * time})]).to_toml()
    assert "counts_right" not in text.replace('#counts_right = ""', "")
    assert "no column looks like a wheel" in text
    text = describe([_log(tmp_path / "log.csv", {"l": 1.0 + np.arange(100), "r": np.arange(100)})]).to_toml()
    assert 'counts_right = "r"' in text
    assert '#t_s = ""' in text


@pytest.mark.parametrize(
    ("wheels", "expected"),
    [
        (("counts_front", "steer_rad"), ('drive = "tricycle"', "#front_wheel_radius_m", "#counts_per_rev_front")),
        (
            tuple(f"counts_{end}_{side}" for end in ("front", "rear") for side in ("left", "right")),
            ('drive = "mecanum"', "#half_length_plus_half_width_m"),
        ),
    ],
)
def test_the_vehicle_is_asked_for_what_its_wheels_need(
    wheels: tuple[str, ...], expected: tuple[str, ...], tmp_path: Path
) -> None:
    count = np.arange(100)
    text = describe([_log(tmp_path / "log.csv", {"t_s": count / 10, **dict.fromkeys(wheels, count)})]).to_toml()
    for key in expected:
        assert f"\n{key}" in text, text


def test_rates_are_proposed_where_there_are_no_positions(tmp_path: Path) -> None:
    """A JointState of velocities alone gives wheels by their rates."""
    bag = _write_bag(tmp_path / "bag", _joint_states(np.full((50, 2), 3.0) + np.arange(50)[:, None] / 7))
    text = describe([bag]).to_toml()
    assert 'counts_left = {column = "/joints:velocity.left", unit = "rad/s"}' in text


def test_a_file_without_names_is_read_by_its_columns_numbers(tmp_path: Path) -> None:
    """Numbers alone: the clock rises in even steps, the counters in whole ones; ingest takes the names proposed."""
    time = np.arange(200) / 20
    rng = np.random.default_rng(1)
    counts = [np.cumsum(rng.integers(20, 30, 200)) for _ in range(2)]
    rows = zip(time, *counts, strict=True)
    (tmp_path / "log.csv").write_text("".join(f"{t:.2f}   {a} {b}\n" for t, a, b in rows))
    text = describe([tmp_path / "log.csv"]).to_toml()
    for words in (
        't_s = {column = "column 1", unit = "s"}',
        'counts_left = "column 2"',
        "which side it is on is not said",
    ):
        assert words in text, text
    mapping = tmp_path / "m.toml"
    mapping.write_text(text)
    made = ingest([tmp_path / "log.csv"], tmp_path / "c", mapping=mapping).campaign
    np.testing.assert_array_equal(made.logs.columns["counts_right"], counts[1])
    np.testing.assert_allclose(made.logs.columns["t_s"], time)


def test_a_skid_steered_robot_is_proposed_with_its_drive(tmp_path: Path) -> None:
    """Four joints, those of a side alike, and a tracker's transform: drive, angles and the units of the messages."""
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS2_HUMBLE).types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](0, 0), "map")
    names = [f"{end}_{side}_wheel_joint" for end in ("front", "rear") for side in ("left", "right")]
    still = {"velocity": np.zeros(0), "effort": np.zeros(0)}
    messages: list[tuple[str, str, dict[str, object]]] = []
    for k in range(80):
        turned = np.asarray([0.1 * k, 0.12 * k] * 2)
        joints = {"header": header, "name": names, "position": turned, **still}
        messages.append(("/platform/joint_states", "sensor_msgs/msg/JointState", joints))
        place = types["geometry_msgs/msg/Transform"](
            types["geometry_msgs/msg/Vector3"](0.01 * k, 0.0, 0.2),
            types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
        )
        pose = {"header": header, "child_frame_id": "jackal", "transform": place}
        messages.append(("/vicon/jackal", "geometry_msgs/msg/TransformStamped", pose))
    text = describe([_write_bag(tmp_path / "bag", messages)]).to_toml()
    for line in (
        'drive = "skid"   # both wheels of a side turn alike',
        "counts_per_rev = 4096   # no wheel gives counts: the resolution that they are kept in",
        'ref_x_m = "/vicon/jackal[map>jackal]:x"',
        "#     /vicon/jackal[map>jackal]:x: 0 to 0.79 m",
    ):
        assert line in text.splitlines(), text


def test_wheels_in_topics_of_their_own_begin_apart(tmp_path: Path) -> None:
    """The samples at which both are known are kept, and that is said."""
    kind = "std_msgs/msg/Int32"
    messages: list[tuple[str, str, dict[str, object]]] = []
    for k in range(200):
        messages.append(("/left_wheel_ticks", kind, {"data": 10 * k}))
        messages += [("/right_wheel_ticks", kind, {"data": 11 * k})] if k > 4 else []
    bag = _write_bag(tmp_path / "bag", messages)
    text = (
        describe([bag])
        .to_toml()
        .replace('by = "stops"', 'by = "times"\ntimes = [[0.5, 6.0]]')
        .replace("min_stop_s", "#")
    )
    (tmp_path / "m.toml").write_text(text)
    made = ingest([bag], tmp_path / "c", mapping=tmp_path / "m.toml")
    log = made.campaign.logs.of(0)
    slope = np.polyfit(log["counts_left"], log["counts_right"], 1)[0]
    assert slope == pytest.approx(1.1, abs=0.01)
    assert any("another wheel has none near in time" in note.text for note in made.notes)


def _drive(heading: np.ndarray) -> dict[str, np.ndarray]:
    """Times and counts beside x and y of a vehicle, a sample each 20 ms."""
    at = np.arange(len(heading)) * 0.02
    return {
        "t [s]": at,
        "enc_left": np.floor(500 * at),
        "enc_right": np.floor(510 * at),
        "X [mm]": 400 * at,
        "Y [mm]": at,
    }


def _as_proposed(
    folder: Path, columns: dict[str, np.ndarray], change: tuple[str, str] = ("", "")
) -> dict[str, np.ndarray]:
    """Return the log that the proposal gives, with `change` of it."""
    source = _log(folder / "r1.csv", columns)
    mapping = folder / "m.toml"
    mapping.write_text(describe([source]).to_toml().replace(*change))
    return dict(ingest([source], folder / "c", mapping=mapping, dry_run=True).campaign.logs.columns)


@pytest.mark.parametrize("name", ["Winkel [°]", "Kurs [°]", "Cap [deg]", "angle [deg]"])
def test_a_bearing_beside_x_and_y_is_the_reference_heading(name: str, tmp_path: Path) -> None:
    """Alone, or beside a wheel that steers, the same name may be any angle."""
    heading = np.linspace(-30.0, 200.0, 200)
    columns = {**_drive(heading), name: heading}
    np.testing.assert_allclose(_as_proposed(tmp_path, columns)["ref_theta_rad"], np.radians(heading), atol=1e-9)
    assert "ref_theta_rad" not in _as_proposed(tmp_path, {k: v for k, v in columns.items() if k[0] not in "XY"})
    steered = {key.replace("enc_left", "enc_front"): cells for key, cells in columns.items() if key != "enc_right"}
    assert "ref_theta_rad = " not in describe([_log(tmp_path / "s.csv", steered)]).to_toml()


@pytest.mark.parametrize("names", [("v links [km/h]", "v rechts [km/h]"), ("v_l [km/h]", "v_r [km/h]")])
def test_wheel_speeds_are_proposed_as_such(names: tuple[str, str], tmp_path: Path) -> None:
    """A speed is no count, nor is one wheel's a vehicle's; beside counts they are not needed."""
    speed = 3.6 * np.linspace(0.5, 1.0, 200)
    columns = {"t [s]": np.arange(200) * 0.02, names[0]: speed, names[1]: 2 * speed}
    logs = _as_proposed(tmp_path, columns)
    np.testing.assert_allclose(logs["speed_right_mps"], 2 * speed / 3.6, atol=1e-6)
    text = describe([tmp_path / "r1.csv"]).to_toml()
    assert 'kind = "speed"' in text
    del columns[names[1]]
    assert "speed_left_mps = " not in describe([_log(tmp_path / "r1.csv", columns)]).to_toml()
    assert (
        "speed_left_mps = " not in describe([_log(tmp_path / "r1.csv", {**_drive(speed), names[0]: speed})]).to_toml()
    )


def test_a_quaternion_of_a_table_gives_the_heading(tmp_path: Path) -> None:
    """Of a turn about the vertical z and w say all, in either sign and beyond a turn; z alone says nothing."""
    heading = np.linspace(-4.0, 9.0, 300)
    sign = np.where(np.arange(300) % 7 == 0, -1.0, 1.0)
    columns = {
        **{name.replace("X [mm]", "pose.position.x"): cells for name, cells in _drive(heading).items()},
        "pose.orientation.z": sign * np.sin(heading / 2),
        "pose.orientation.w": sign * np.cos(heading / 2),
    }
    logs = _as_proposed(tmp_path, columns)
    np.testing.assert_allclose(logs["ref_theta_rad"] - logs["ref_theta_rad"][0], heading - heading[0], atol=1e-9)
    np.testing.assert_array_equal(logs["ref_x_m"], columns["pose.position.x"])
    with pytest.raises(CalibError, match=r"no column 'qw'"):
        _as_proposed(tmp_path, columns, ('w = "pose.orientation.w"', 'w = "qw"'))
    del columns["pose.orientation.w"]
    assert "its w is needed too" in describe([_log(tmp_path / "r1.csv", columns)]).to_toml()


def test_odometry_of_the_wheels_is_marked_as_no_reference(tmp_path: Path) -> None:
    columns = {name.replace("X [mm]", "pose.pose.position.x"): v for name, v in _drive(np.zeros(50)).items()}
    assert "wheel odometry is no reference" in describe([_log(tmp_path / "r1.csv", columns)]).to_toml()


@pytest.mark.parametrize(
    "line",
    ['ref_x_m = {column = "X [mm]", w = "t [s]"}', 'ref_theta_rad = {column = "t [s]", w = "t [s]", unit = "deg"}'],
)
def test_w_of_a_quaternion_belongs_to_the_heading_of_a_log(line: str, tmp_path: Path) -> None:
    source = _log(tmp_path / "r1.csv", _drive(np.zeros(50)))
    for section in ("log", "table"):
        (tmp_path / "m.toml").write_text(f"[{section}]\n{line}\n")
        with pytest.raises(CalibError, match=r"ref_theta_rad in \[log\] alone"):
            ingest([source], tmp_path / "c", mapping=tmp_path / "m.toml", dry_run=True)


def test_a_header_without_rows_is_said_to_have_none(tmp_path: Path) -> None:
    """Alone nothing can be proposed of it; among others it is named."""
    empty = tmp_path / "empty.csv"
    empty.write_text("t_s,counts_left,counts_right\n")
    with pytest.raises(CalibError, match=r"empty\.csv: found a header and no rows"):
        describe([empty])
    _log(tmp_path / "other.csv", {**_drive(np.zeros(50)), "T": np.zeros(50)})
    said = re.sub(r"\n#\s+", " ", describe([tmp_path]).to_toml())
    assert "empty.csv: a log, 0 rows: a header alone" in said


def test_of_many_files_alike_it_says_how_many_were_read(tmp_path: Path) -> None:
    for number in range(42):
        _log(tmp_path / f"run_{number:02}.csv", {"t_s": np.arange(5) * 0.1, "counts_left": np.arange(5)})
    text = describe([tmp_path]).to_toml().replace("\n#   ", " ")
    assert "42 files, 2 of them read, alike: a log, 5 rows" in text


def test_angles_within_a_turn_are_no_counters(tmp_path: Path) -> None:
    """Without names a heading that rises and an angle that steers look alike: wheels roll on."""
    rows = np.column_stack([np.arange(60) * 0.05, np.linspace(0.0, 12.5, 60), np.linspace(-0.9, 0.6, 60)])
    np.savetxt(tmp_path / "a.csv", rows, delimiter=",", fmt="%.5f")
    text = describe([tmp_path]).to_toml()
    assert not re.search(r"^counts_", text, re.MULTILINE)


def test_a_file_without_any_column_of_the_mapping_is_told_from_the_logs(tmp_path: Path) -> None:
    """What lies beside logs is not taken for one with a wrong name: which file, and what to write."""
    (tmp_path / "a").mkdir()
    _log(tmp_path / "a" / "run_1.csv", {"zeit": np.arange(9) * 0.1, "counts_left": np.arange(9)})
    (tmp_path / "a" / "about.csv").write_text("type,diff\nngear,43.7\nencRes,64\n")
    mapping = tmp_path / "m.toml"
    mapping.write_text('[log]\nt_s = {column = "zeit", unit = "s"}\n')
    with pytest.raises(CalibError, match=r"about.csv.*nor any of the others.*name the logs alone \(.*/run\*\.csv\)"):
        ingest([tmp_path / "a"], tmp_path / "c", mapping=mapping)


def test_files_of_a_run_with_clocks_of_their_own_are_joined_as_proposed(tmp_path: Path) -> None:
    """Each file's times and their unit have a place; a text beside the runs called `Strecke` is the route."""
    time = np.arange(200) * 0.02
    for run in (1, 2, 3):
        wheels = {
            "Zeit [ns]": 1e9 * time + 5e18,
            "Impulse L": 50.0 * np.arange(200),
            "Impulse R": 50.0 * np.arange(200),
        }
        _log(tmp_path / f"Fahrt_{run:02}_enc.csv", wheels)
        camera = {"Zeitstempel [ms]": 1e3 * time + 5e12, "X [mm]": 500.0 * time, "Y [mm]": 0.0 * time}
        _log(tmp_path / f"Fahrt_{run:02}_kamera.csv", camera)
    (tmp_path / "runs.csv").write_text("Fahrt Nr.;Strecke\n1;Quadrat\n2;Gerade\n3;Quadrat\n")
    mapping = tmp_path / "m.toml"
    mapping.write_text(describe([tmp_path]).to_toml())
    assert 'clocks = {enc = "Zeit [ns]", kamera = "Zeitstempel [ms]"}' in mapping.read_text()
    built = ingest([tmp_path], tmp_path / "c", mapping=mapping).campaign
    assert built.runs.label("kind").tolist() == ["Quadrat", "Gerade", "Quadrat"]
    log = built.logs.of(0)
    assert np.nanmax(np.abs(log["ref_x_m"] - 0.5 * log["t_s"])) < 1e-6


def test_joints_and_stamps_of_an_echoed_topic_are_proposed(tmp_path: Path) -> None:
    """`rostopic echo -p`: name0 says what position0 is of, and the stamp is the time, not the sequence number."""
    stamp, angle = 1_700_000_000_000_000_000 + 20_000_000 * np.arange(50), np.linspace(0.1, 9.3, 50)
    head = "%time,field.header.seq,field.header.stamp,field.name0,field.name1,field.position0,field.position1\n"
    rows = (
        f"{t + 900},{k},{t},wheel_right_joint,wheel_left_joint,{a:.5f},{1.01 * a:.5f}\n"
        for k, (t, a) in enumerate(zip(stamp, angle, strict=True))
    )
    pose = (f"{t},{k},{t},{a:.4f},0.0\n" for k, (t, a) in enumerate(zip(stamp, angle, strict=True)))
    (tmp_path / "run1_joints.csv").write_text(head + "".join(rows))
    head = "%time,field.header.seq,field.header.stamp,field.pose.position.x,field.pose.position.y\n"
    (tmp_path / "run1_mocap.csv").write_text(head + "".join(pose))
    proposed = describe([tmp_path]).to_toml()
    assert 't_s = {column = "field.header.stamp", unit = "ns"}' in proposed
    assert 'counts_left = {column = "joints:field.position1", unit = "rad"}' in proposed
    assert 'counts_right = {column = "joints:field.position0", unit = "rad"}' in proposed


def test_a_camera_and_a_truck_propose_their_reference(tmp_path: Path) -> None:
    """A unit at the end of a name is converted, proposed or not; a counted shaft is the rear axle's."""
    time, n = np.arange(200) * 0.02, np.arange(200.0)
    camera = {"cam.x_mm": 500.0 * time, "cam.y_mm": 0.0 * time, "cam.yaw_deg": 10.0 * time}
    log = _log(tmp_path / "a.csv", {"t_s": time, "L_ticks": 50.0 * n, "R_ticks": 50.0 * n, **camera})
    proposed = describe([log]).to_toml()
    assert all(f'ref_{name} = {{column = "cam.{of}"' in proposed for name, of in (("x_m", "x_mm"), ("y_m", "y_mm")))
    mapping = tmp_path / "m.toml"
    lines = 'counts_left = "L_ticks"\ncounts_right = "R_ticks"\nref_x_m = "cam.x_mm"\nref_theta_rad = "cam.yaw_deg"\n'
    mapping.write_text(f'[log]\n{lines}ref_y_m = {{column = "cam.y_mm", factor = 0.001}}\n[cut]\nby = "stops"\n')
    read = ingest([log], tmp_path / "c", mapping=mapping).campaign.logs.of(0)
    assert np.nanmax(np.abs(np.diff(read["ref_x_m"]) / np.diff(read["t_s"]) - 0.5)) < 1e-6
    assert np.nanmax(read["ref_theta_rad"]) < 0.8
    truck = {"Time [s]": time, "Shaft ticks": 50.0 * n, "Steer angle [deg]": n, "Pos E [m]": n, "Hdg [rad]": n}
    proposed = describe([_log(tmp_path / "b.csv", truck | {"Pos N [m]": n})]).to_toml()
    assert all(f'{name} = "' in proposed for name in ("counts_rear", "ref_x_m", "ref_y_m", "ref_theta_rad"))


def test_files_of_a_run_keep_their_names_and_columns_their_units(tmp_path: Path) -> None:
    """Headings that jump at half a turn in one file are degrees in all; letters before the number are no number."""
    t = np.linspace(0.0, 10.0, 101)
    for n, turned in enumerate((90.0, 300.0)):
        yaw = (turned * t / 10.0 + 180.0) % 360.0 - 180.0
        rate = 40.0 + 20.0 * np.sin(t)
        _log(tmp_path / f"odom_{n}.csv", {"t_s": t, "wL_rpm": rate, "wR_rpm": rate})
        _log(tmp_path / f"slam_{n}_6D.csv", {"t_s": t, "x": t, "y": t, "yaw": yaw})
    lines = describe([tmp_path]).to_toml().splitlines()
    assert any('odom = "odom_{n}.csv", slam_6D = "slam_{n}_6D.csv"' in line for line in lines)
    assert 'ref_theta_rad = {column = "slam_6D:yaw", unit = "deg"}' in lines
    assert 'counts_left = {column = "odom:wL_rpm", unit = "rpm"}' in lines


def test_distances_among_other_cells_are_no_route(tmp_path: Path) -> None:
    """The proposal can be used as it is: the bad cell is then named."""
    cells = ["40.0", "40.01", "n/a", "-", "#REF!", "40.02"]
    rows = [f"r{number},{cell},{260000 + number},{260100 + number}" for number, cell in enumerate(cells)]
    (tmp_path / "runs.csv").write_text("run,distance_m,counts_left,counts_right\n" + "\n".join(rows) + "\n")
    (tmp_path / "mapping.toml").write_text(text := describe([tmp_path / "runs.csv"]).to_toml())
    assert 'kind = {value = "corridor"}' in text
    with pytest.raises(BadFileError, match="row 6, column distance_m: found '#REF!'"):
        ingest([tmp_path / "runs.csv"], tmp_path / "made", mapping=tmp_path / "mapping.toml")
