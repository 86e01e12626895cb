"""Trajectories in the TUM format: lines of ``timestamp tx ty tz qx qy qz qw``, with ``#`` before remarks."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np

from calib.campaign.readers.recording import Recording, Stream
from calib.campaign.readers.ros_messages import POSE, finished
from calib.campaign.readers.times import decimal_ns
from calib.errors import BadFileError

_WIDTH: Final = 1 + len(POSE)


def record(path: Path, shown: str, wanted: Callable[[str], bool] | None) -> Recording:
    """Read a trajectory: x, y, z, yaw, times exact to the nanosecond; see `calib.campaign.readers`."""
    times: list[int] = []
    poses: list[list[float]] = []
    with path.open(encoding="utf-8", errors="replace") as lines:
        for number, line in enumerate(lines, start=1):
            cells = line.split("#", 1)[0].replace(",", " ").split()
            if not cells:
                continue
            try:
                if len(cells) != _WIDTH:
                    raise ValueError(f"{len(cells)} numbers")
                time = decimal_ns(cells[0])
                pose = [float(cell) for cell in cells[1:]]
                if not np.isfinite(pose).all():
                    raise ValueError("a number that is not finite")
            except ValueError as error:
                expected = f"the {_WIDTH} numbers: timestamp {' '.join(POSE)}"
                remedy = "correct or remove the line; the file may have been cut"
                raise BadFileError(shown, str(error)[:80], expected, remedy, row=number) from error
            times.append(time)
            poses.append(pose)
    if not times:
        raise BadFileError(shown, found="no poses", expected="lines of 8 numbers", remedy="export it again")
    columns = finished(dict(zip(POSE, np.asarray(poses).T.copy(), strict=True)))
    kept = {name: values for name, values in columns.items() if wanted is None or wanted(name)}
    units = {"x": "m", "y": "m", "z": "m", "yaw": "rad"}
    stream = Stream("poses", "poses", kept, np.asarray(times, dtype=np.int64), "timestamps of the lines", units)
    return Recording((stream,) if kept else ())
