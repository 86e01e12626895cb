"""Turn a recording of a robot on a straight line past a laser (MATLAB v5 file) into a campaign.

The robot drives back and forth; its wheel odometry gives a speed only, so counts are made from it: the speed is
integrated by the trapezoidal rule over each stretch of one sign, from the sample before to the sample after it, and
divided by the circumference of a nominal wheel of 0.1 m with 100,000 counts a revolution (6.3 micrometres a count). A
stretch of at least 0.5 m by odometry becomes one run. Backward runs count positive too, and are told apart by
``direction``. The effective radius over 0.1 m is then the scale of the odometry.

Run as ``python -m tests.campaign.straightline dataset1.mat FOLDER [laser|motion_capture]``.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Literal

import numpy as np

from calib.campaign import write_campaign
from calib.campaign.model import Campaign, Logs, RunTable
from calib.campaign.settings import Encoder, OdometryModel, Rangefinder, Reference
from calib.vehicle import Vehicle

RADIUS_M = 0.1
COUNTS_PER_REV = 100_000
SHORTEST_M = 0.5


def convert(source: Path, *, by: Literal["laser", "motion_capture"]) -> Campaign:
    """Return the recording as a campaign, with distances by the laser or by motion capture."""
    from scipy.io import loadmat

    data = loadmat(source, variable_names=["t", "x_true", "r", "v", "r_var"])
    time, true, laser, speed = (data[name].ravel().astype(float) for name in ("t", "x_true", "r", "v"))
    driven = np.concatenate(([0.0], np.cumsum(np.diff(time) * (speed[1:] + speed[:-1]) / 2)))
    # the laser looks at a target ahead: its range shrinks as the robot drives forward
    place = -laser if by == "laser" else true
    sign = np.sign(speed)
    edge = np.concatenate(([0], np.flatnonzero(np.diff(sign)) + 1, [len(sign)]))
    first, last = np.maximum(edge[:-1] - 1, 0), np.minimum(edge[1:], len(sign) - 1)
    keep = (sign[edge[:-1]] != 0) & (np.abs(driven[last] - driven[first]) >= SHORTEST_M)
    first, last, way = first[keep], last[keep], sign[edge[:-1]][keep]
    lengths = last - first + 1
    offsets = np.concatenate(([0], np.cumsum(lengths)))
    index = np.arange(offsets[-1]) + np.repeat(first - offsets[:-1], lengths)

    def from_start(values: np.ndarray) -> np.ndarray:
        return (values[index] - np.repeat(values[first], lengths)) * np.repeat(way, lengths)

    counts = np.rint(from_start(driven) / (2 * np.pi * RADIUS_M) * COUNTS_PER_REV)
    distance = (place[last] - place[first]) * way
    n = len(first)
    columns = {
        "t_s": time[index] - np.repeat(time[first], lengths),
        "counts_left": counts,
        "counts_right": counts,
        "range_m": from_start(place),
    }
    return Campaign(
        root=None,
        name=f"straight line, by {by}",
        simulated=False,
        vehicle=Vehicle(wheel_radius_m=RADIUS_M),
        encoder=Encoder(COUNTS_PER_REV, COUNTS_PER_REV),
        model=OdometryModel(RADIUS_M, RADIUS_M, 0.7, 300.0),
        rangefinder=Rangefinder(sigma_m=float(np.sqrt(data["r_var"].item())) if by == "laser" else 1e-3),
        reference=Reference(),
        runs=RunTable(
            labels={
                "run_id": np.asarray([f"s{i:03d}" for i in range(n)]),
                "kind": np.full(n, "straight"),
                "direction": np.where(way > 0, "out", "back"),
            },
            numbers={
                "distance_m": distance,
                "counts_left": counts[offsets[1:] - 1],
                "counts_right": counts[offsets[1:] - 1],
            },
            excluded=np.zeros(n, dtype=bool),
            line=np.arange(n) + 2,
        ),
        logs=Logs(offsets.astype(np.int64), columns),
    )


if __name__ == "__main__":
    write_campaign(
        convert(Path(sys.argv[1]), by="motion_capture" if sys.argv[3:] == ["motion_capture"] else "laser"),
        Path(sys.argv[2]),
    )
