"""One long recording of a whole campaign, run after run with stands between, in every format."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.campaign.model import Campaign
from tests.campaign.making import campaign
from tests.campaign.readers.recordings import EPOCH_NS, Drive

RATE_HZ = 5.0
STAND_S = 4.0
#: the reflector's distance where a run begins
WALL_M = 45.0


@dataclass(frozen=True)
class Recorded:
    """What was driven, and what the sensors gave."""

    truth: Campaign
    drive: Drive
    table: Path


def recorded(folder: Path, *, runs: int = 10, seed: int = 4) -> Recorded:
    """Lay the logs of a corridor campaign end to end on one clock, the vehicle standing between runs."""
    truth = campaign(runs_per_load=runs // 5, rate_hz=RATE_HZ, seed=seed)
    step = int(1e9 / RATE_HZ)
    stand = int(STAND_S * RATE_HZ)
    left, right, path = [np.zeros(stand)], [np.zeros(stand)], [np.zeros(stand)]
    for run in range(len(truth.runs)):
        log = truth.logs.of(run)
        share = log["counts_left"] / log["counts_left"][-1]
        left += [left[-1][-1] + log["counts_left"], np.full(stand, left[-1][-1] + log["counts_left"][-1])]
        right += [right[-1][-1] + log["counts_right"], np.full(stand, right[-1][-1] + log["counts_right"][-1])]
        distance = truth.runs.number("distance_m")[run]
        # carried back halfway through the stand
        path += [distance * share, np.where(np.arange(stand) < stand // 2, distance, 0.0)]
    n = sum(map(len, left))
    time_ns = EPOCH_NS + np.arange(n) * step
    along = np.concatenate(path)
    # the other sensors run on clocks of their own, between the wheels' samples
    fine = EPOCH_NS + 10_000_000 + np.arange(n - 1) * step
    index = np.arange(n - 1)
    between = along[index] + (along[index + 1] - along[index]) * 0.05
    between[np.abs(along[index + 1] - along[index]) > 1.0] = 0.0
    drive = Drive(
        wheels=(time_ns, np.concatenate(left), np.concatenate(right)),
        range_m=(fine, WALL_M - between),
        poses=(fine, between, np.zeros(n - 1), np.zeros(n - 1)),
    )
    table = folder / "runs.csv"
    columns = ("run_id", "session", "kind", "direction", "payload_kg", "payload_x_m", "payload_y_m", "speed_mps")
    rows = [",".join(columns)]
    for run in range(len(truth.runs)):
        cells = [str(truth.runs.label(name)[run]) for name in columns[:4]]
        cells += [f"{truth.runs.number(name)[run]:g}" for name in columns[4:]]
        rows.append(",".join(cells))
    table.write_text("\n".join(rows) + "\n")
    return Recorded(truth, drive, table)


SETTINGS = """
[vehicle]
track_m = 0.7
wheelbase_m = 1.0
wheel_radius_m = 0.1
mass_kg = 100
cog_x_m = 0.388
[encoder]
counts_per_rev = 4096
[rangefinder]
sigma_m = 0.0015
[cut]
by = "stops"
min_stop_s = 2.0
"""

ROS = """[log]
counts_left = {column = "/joint_states:position.left", unit = "rad"}
counts_right = {column = "/joint_states:position.right", unit = "rad"}
range_m = "/range:range"
"""
LOGS = {
    "csv": '[log]\nt_s = "time_s"\ncounts_left = "left"\ncounts_right = "right"\nrange_m = "range"\n',
    "mat": '[log]\nt_s = "t"\ncounts_left = "left"\ncounts_right = "right"\nrange_m = "range"\n',
    "tdms": '[log]\ncounts_left = "Encoder/left"\ncounts_right = "Encoder/right"\nrange_m = "Laser/distance"\n',
    "mcap": ROS,
    "sqlite3": ROS,
    "bag": ROS,
    "parquet": '[log]\nt_s = "time_s"\ncounts_left = "left"\ncounts_right = "right"\nrange_m = "range"\n',
}


def mapping_text(kind: str) -> str:
    """The mapping of a recording of one format."""
    return LOGS[kind] + SETTINGS


def write(drive: Drive, folder: Path, kind: str) -> Path:
    """Write the recording; tables of one clock hold the range as interpolated at the wheels' times."""
    from tests.campaign.readers import recordings

    path = folder / f"drive.{kind}"
    if kind in {"mcap", "sqlite3"}:
        return recordings.write_rosbag2(drive, folder / f"drive_{kind}", kind)
    if kind == "bag":
        return recordings.write_rosbag1(drive, path)
    if kind == "tdms":
        return recordings.write_tdms(drive, path)
    time_ns, left, right = drive.wheels
    time_s = (time_ns - time_ns[0]) / 1e9
    distance = np.interp(
        (time_ns - EPOCH_NS).astype(float), (drive.range_m[0] - EPOCH_NS).astype(float), drive.range_m[1]
    )
    if kind == "mat":
        import scipy.io

        scipy.io.savemat(path, {"t": time_s, "left": left, "right": right, "range": distance})
        return path
    if kind == "parquet":
        import pyarrow as pa
        import pyarrow.parquet as pq

        pq.write_table(pa.table({"time_s": time_s, "left": left, "right": right, "range": distance}), path)
        return path
    rows = "\n".join(
        f"{t:.9f},{a:.0f},{b:.0f},{d!r}" for t, a, b, d in zip(time_s, left, right, map(float, distance), strict=True)
    )
    path.write_text("time_s,left,right,range\n" + rows + "\n")
    return path
