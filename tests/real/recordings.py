"""Campaigns from recordings that others made on real vehicles, for tests that plant, diagnose and compare.

Every function takes the folder of the recordings (the fixture ``shared_data``) and returns a `Campaign` in memory.
`available` skips a test, with the reason, where a recording is absent.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

from calib.campaign.model import Campaign, Logs, RunTable
from calib.campaign.settings import Encoder, Odometry, OdometryModel, Rangefinder, Reference
from calib.campaign.wheels import WHEEL_COLUMNS
from calib.types import FloatArray
from calib.vehicle import Vehicle
from tests.campaign.straightline import convert

Log = dict[str, FloatArray]

#: what OptiTrack states of a rigid body's pose, and a 4 cm body's heading
OPTITRACK = Reference(sigma_xy_m=5e-4, sigma_theta_rad=2e-3)


def available(folder: Path, name: str) -> Path:
    """Return a recording's path; skip the test, saying why, where it is absent."""
    path = folder / name
    if not path.exists():
        pytest.skip(f"real recordings are not here: {name} does not exist in shared/data")
    return path


def in_memory(
    name: str,
    logs: Sequence[Mapping[str, FloatArray]],
    labels: Mapping[str, Sequence[str]],
    settings: tuple[Vehicle, Encoder, OdometryModel, Reference],
    *,
    numbers: Mapping[str, FloatArray] | None = None,
    odometry: Odometry | None = None,
    end_poses: bool = True,
) -> Campaign:
    """Return a campaign of one log a run; its end poses, where wanted, and counts are what the logs end with."""
    vehicle, encoder, model, reference = settings
    lengths = [len(log["t_s"]) for log in logs]
    names = sorted({column for log in logs for column in log})
    columns = {
        column: np.concatenate([log.get(column, np.full(n, np.nan)) for log, n in zip(logs, lengths, strict=True)])
        for column in names
    }
    ends = {column: np.array([log.get(column, np.full(1, np.nan))[-1] for log in logs]) for column in names}
    given = {column: ends[column] for column in ("counts_left", "counts_right") if column in ends}
    if end_poses:
        given |= {column: ends[column] for column in ("ref_x_m", "ref_y_m", "ref_theta_rad") if column in ends}
    return Campaign(
        root=None,
        name=name,
        simulated=False,
        vehicle=vehicle,
        encoder=encoder,
        model=model,
        rangefinder=Rangefinder(),
        reference=reference,
        runs=RunTable(
            labels={column: np.asarray(values) for column, values in labels.items()},
            numbers={**given, **(numbers or {})},
            excluded=np.zeros(len(logs), dtype=bool),
            line=np.arange(len(logs)) + 2,
        ),
        logs=Logs(offsets=np.concatenate(([0], np.cumsum(lengths))).astype(np.int64), columns=columns),
        odometry=odometry or Odometry(),
    )


def optiodom_differential(folder: Path, recordings: Sequence[str] | None = None) -> Campaign:
    """Squares, circles, half circles, lines and turns on the spot of a differential drive: 102 runs of 14 recordings.

    Parameters
    ----------
    folder : Path
        Folder of the recordings.
    recordings : sequence of str, optional
        Names of the recordings wanted, all by default; the names are the campaign's sessions.

    Returns
    -------
    Campaign
        Judged against a wheel radius of 0.042 m and a track of 0.2 m.
    """
    logs, labels = [], {"run_id": [], "session": [], "kind": []}
    per_rad = 43.7 * 64 / (2 * np.pi)
    radius_m, track_m = 0.042, 0.2
    for path in sorted(available(folder, "optiodom/diff").glob("*/*/*_run-*.csv")):
        recording = path.parent.name
        if recordings is not None and recording not in recordings:
            continue
        t, x, y, theta, right, left = np.loadtxt(path, delimiter=",").T
        left, right = np.cumsum(left), np.cumsum(right)
        logs.append(
            {
                "t_s": t - t[0],
                "counts_left": left,
                "counts_right": right,
                "ref_x_m": x,
                "ref_y_m": y,
                "ref_theta_rad": np.unwrap(theta),
            }
        )
        turn = (right[-1] - left[-1]) / per_rad * radius_m / track_m
        way = 0.5 * (right[-1] + left[-1]) / per_rad * radius_m
        labels["run_id"].append(path.stem)
        labels["session"].append(recording)
        labels["kind"].append(_kind(path.parts[-3], way, turn))
    vehicle = Vehicle(
        track_m=track_m, wheelbase_m=0.2, wheel_radius_m=radius_m, mass_kg=2.5, cog_x_m=0.05, drive="differential"
    )
    model = OdometryModel(radius_m, radius_m, track_m, vehicle.unladen_load_N)
    return in_memory("optiodom, differential", logs, labels, (vehicle, Encoder(43.7 * 64, 43.7 * 64), model, OPTITRACK))


def _kind(route: str, way_m: float, turn_rad: float) -> str:
    """Return what was driven: the test's name, and the sense of its turn."""
    if route == "ivanjko":
        route = "spin" if abs(way_m) < 0.1 else "line"
    sense = "" if route == "line" else "_cw" if turn_rad < 0 else "_ccw"
    return route + sense


def optiodom_tricycle(folder: Path) -> Campaign:
    """Circles and squares of a vehicle with a driven, steered front wheel and no rear encoders: 10 runs."""
    logs, labels = [], {"run_id": [], "session": [], "kind": []}
    for path in sorted(available(folder, "optiodom/tricyc").glob("*/*/*_run-*.csv")):
        t, x, y, theta, front, steer = np.loadtxt(path, delimiter=",").T
        heading = np.unwrap(theta)
        logs.append(
            {
                "t_s": t - t[0],
                "counts_front": np.cumsum(front),
                "steer_rad": steer,
                "ref_x_m": x,
                "ref_y_m": y,
                "ref_theta_rad": heading,
            }
        )
        labels["run_id"].append(path.stem)
        labels["session"].append(path.parent.name)
        labels["kind"].append(_kind(path.parts[-3], 1.0, float(heading[-1])))
    vehicle = Vehicle(
        track_m=0.15,
        wheelbase_m=0.15,
        wheel_radius_m=0.0325,
        mass_kg=2.5,
        cog_x_m=0.07,
        drive="tricycle",
        front_wheel_radius_m=0.0325,
    )
    encoder = Encoder(1600, 1600, counts_per_rev_front=1600)
    model = OdometryModel(0.0325, 0.0325, 0.15, vehicle.unladen_load_N)
    return in_memory(
        "optiodom, tricycle", logs, labels, (vehicle, encoder, model, OPTITRACK), odometry=Odometry("front")
    )


def khepera(folder: Path, name: str, *, tuples_per_run: int | None = None, sensor_known: bool = True) -> Campaign:
    """A Khepera III with a laser scan matcher; `name` is ``lstraight``, ``l90`` or a third of one (``l90_0``).

    Parameters
    ----------
    folder : Path
        Folder of the recordings.
    name : str
        File's stem. Steps at which the scan matcher failed (1 to 4 %, off by a quarter of a radian) are omitted, as
        those who recorded it did.
    tuples_per_run : int, optional
        Steps (of about 0.8 s) a run; one continuous recording by default. The scan matcher gives the laser's motion in
        each step, chained here from the run's start, so that its errors add up along a run.
    sensor_known : bool
        State the published place and yaw of the laser; else the settings say nothing of it.

    Returns
    -------
    Campaign
        Judged against wheels of 0.0205 m and a track of 0.0885 m.
    """
    source = available(folder, f"khepera_{name.split('_', maxsplit=1)[0]}/{name}.tuple")
    tuples = _matched(_json_objects(source.read_text(encoding="utf-8")))
    duration = np.array([one["T"] for one in tuples])
    # counts fine enough that rounding is no noise of their own
    counts_per_rev = 100_000.0
    left, right = (
        np.cumsum([one[key] * one["T"] for one in tuples]) / (2 * np.pi) * counts_per_rev for key in ("phi_l", "phi_r")
    )
    moves = np.array([one["sm"] for one in tuples])
    size = tuples_per_run or len(tuples)
    logs, labels = [], {"run_id": [], "session": []}
    for number, first in enumerate(range(0, len(tuples) - size + 1, size)):
        rows = slice(first, first + size)
        poses = _chained(moves[rows])
        logs.append(
            {
                "t_s": np.concatenate(([0.0], np.cumsum(duration[rows]))),
                "counts_left": _from_zero(left, rows),
                "counts_right": _from_zero(right, rows),
                **dict(zip(("ref_x_m", "ref_y_m", "ref_theta_rad"), poses.T, strict=True)),
            }
        )
        labels["run_id"].append(f"{name}_{number:03d}")
        labels["session"].append(name)
    sensor = {}
    if sensor_known:
        published = json.loads(source.with_name(f"{name}_results.json").read_text(encoding="utf-8"))
        sensor = {f"sensor_{to}": published[key] for to, key in _LASER.items()}
    # the scan matcher's scatter of one step, by what is left of a step after the published calibration
    reference = Reference(sigma_xy_m=2e-3, sigma_theta_rad=5e-3, frame="start", **sensor)
    vehicle = Vehicle(
        track_m=0.0885, wheelbase_m=0.06, wheel_radius_m=0.0205, mass_kg=0.7, cog_x_m=0.01, drive="differential"
    )
    model = OdometryModel(0.0205, 0.0205, 0.0885, vehicle.unladen_load_N)
    return in_memory(
        f"khepera {name}", logs, labels, (vehicle, Encoder(counts_per_rev, counts_per_rev), model, reference)
    )


def _matched(tuples: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the steps whose turn by the scan matcher is that of the wheels, to within ten robust deviations."""
    wheels = np.array([[one["phi_l"] * one["T"], one["phi_r"] * one["T"]] for one in tuples])
    turn = np.array([one["sm"][2] for one in tuples])
    kept = np.ones(len(tuples), dtype=bool)
    for _ in range(6):
        by_wheels = np.linalg.lstsq(wheels[kept], turn[kept], rcond=None)[0]
        off = np.abs(turn - wheels @ by_wheels)
        kept = off < 10 * 1.4826 * np.median(off)
    return [one for one, keep in zip(tuples, kept, strict=True) if keep]


_LASER = {"x_m": "l_x", "y_m": "l_y", "yaw_rad": "l_theta"}


def _json_objects(text: str) -> list[dict[str, Any]]:
    """Return the objects of a file that holds them one after the other."""
    decoder, place, objects = json.JSONDecoder(), 0, []
    while True:
        while place < len(text) and text[place].isspace():
            place += 1
        if place == len(text):
            return objects
        value, place = decoder.raw_decode(text, place)
        objects.append(value)


def _chained(moves: FloatArray) -> FloatArray:
    """Return the poses that a chain of moves, each in the frame of the pose before, leads through, from zero."""
    heading = np.concatenate(([0.0], np.cumsum(moves[:, 2])))
    c, s = np.cos(heading[:-1]), np.sin(heading[:-1])
    x = np.concatenate(([0.0], np.cumsum(c * moves[:, 0] - s * moves[:, 1])))
    y = np.concatenate(([0.0], np.cumsum(s * moves[:, 0] + c * moves[:, 1])))
    return np.stack([x, y, heading], axis=1)


def _from_zero(totals: FloatArray, rows: slice) -> FloatArray:
    before = totals[rows.start - 1] if rows.start else 0.0
    return np.rint(np.concatenate(([0.0], totals[rows] - before)))


def straight_line(folder: Path, by: Literal["laser", "motion_capture"] = "laser") -> Campaign:
    """A robot driven back and forth past a laser: 194 one-way segments with a distance and no end pose."""
    return convert(available(folder, "straightline_laser/dataset1.mat"), by=by)


@cache
def _mecanum_log(folder: Path, bag: str) -> Mapping[str, FloatArray]:
    """Ticks of the four wheels from zero, and the reference's poses at their times."""
    pytest.importorskip("rosbags")
    from rosbags.highlevel import AnyReader

    ticks, poses = [], []
    with AnyReader([available(folder, f"mecanum_optitrack/{bag}.bag")]) as reader:
        wanted = [one for one in reader.connections if one.topic in {"/wheel_states", "/robot/pose"}]
        for connection, _, raw in reader.messages(wanted):
            message = reader.deserialize(raw, connection.msgtype)
            stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
            if connection.topic == "/wheel_states":
                ticks.append([stamp, *message.position])
            else:
                place, q = message.pose.position, message.pose.orientation
                yaw = np.arctan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y * q.y + q.z * q.z))
                poses.append([stamp, place.x, place.y, yaw])
    wheels, seen = np.array(ticks), np.array(poses)
    seen[:, 3] = np.unwrap(seen[:, 3])
    wheels = wheels[(wheels[:, 0] >= seen[0, 0]) & (wheels[:, 0] <= seen[-1, 0])]
    wheels = wheels[np.concatenate(([True], np.diff(wheels[:, 0]) > 0))]
    t = wheels[:, 0]
    log = {name: wheels[:, at] - wheels[0, at] for at, name in enumerate(WHEEL_COLUMNS["wheels"], start=1)}
    for at, name in enumerate(("ref_x_m", "ref_y_m", "ref_theta_rad"), start=1):
        log[name] = np.interp(t, seen[:, 0], seen[:, at])
    return {"t_s": t - t[0], **log}


#: counts a turn: 38 a turn of the motor, gear 5 to 1
_MECANUM_TURN = 190.0
_MECANUM_REFERENCE = Reference(sigma_xy_m=1e-3, sigma_theta_rad=2e-3, frame="map")


def mecanum(folder: Path, bag: str) -> Campaign:
    """One continuous run of a mecanum robot by its four wheels: ``bag1`` with next to no rotation, or ``bag2``."""
    vehicle = Vehicle(
        wheel_radius_m=0.07, half_length_plus_half_width_m=0.369, wheelbase_m=0.4, cog_x_m=0.2, drive="mecanum"
    )
    model = OdometryModel(0.07, 0.07, 0.738, 100.0)
    return in_memory(
        f"mecanum {bag}",
        [_mecanum_log(folder, bag)],
        {"run_id": [bag], "session": [bag], "kind": ["free"]},
        (vehicle, Encoder(_MECANUM_TURN, _MECANUM_TURN), model, _MECANUM_REFERENCE),
        odometry=Odometry("wheels"),
        end_poses=False,
    )


def mecanum_as_differential(folder: Path, bag: str) -> Campaign:
    """One continuous run of a mecanum robot, taken for a differential drive: its strafing is what no wheel explains.

    Parameters
    ----------
    folder : Path
        Folder of the recordings.
    bag : str
        ``bag1`` (strafing, next to no rotation) or ``bag2``.

    Returns
    -------
    Campaign
        One run. The mean of the wheels of a side is its count; radius 0.07 m, track 2 x 0.369 m, 190 counts a turn.
    """
    log = dict(_mecanum_log(folder, bag))
    front_left, front_right, rear_left, rear_right = (log.pop(name) for name in WHEEL_COLUMNS["wheels"])
    log |= {"counts_left": 0.5 * (front_left + rear_left), "counts_right": 0.5 * (front_right + rear_right)}
    vehicle = Vehicle(
        track_m=0.738, wheelbase_m=0.4, wheel_radius_m=0.07, mass_kg=25.0, cog_x_m=0.2, drive="differential"
    )
    model = OdometryModel(0.07, 0.07, 0.738, vehicle.unladen_load_N)
    labels = {"run_id": [bag], "session": [bag], "kind": ["free"]}
    settings = (vehicle, Encoder(_MECANUM_TURN, _MECANUM_TURN), model, _MECANUM_REFERENCE)
    return in_memory(f"mecanum {bag}, as a differential drive", [log], labels, settings)
