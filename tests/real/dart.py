# ruff: noqa: T201  (a script shows what it does)
"""An Ackermann car under motion capture: its geometry, and curvature against speed on recordings held out.

``python -m tests.real.dart ../shared/data``. Eight recordings with the steering held and the throttle ramped up (DART,
9 September 2024). The makers measured: wheelbase 0.1735 m, the reference point 0.115 m ahead of the rear axle and 0.010
m to the right of it, the command's zero shifted by -0.03 on that day, which is -0.0153 rad.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from calib.campaign.model import Campaign
from calib.campaign.settings import SPEED_COUNT_M, Encoder, FrontModel, OdometryModel, Reference
from calib.campaign.wheels import shaft_motion
from calib.kinematics.drives import SIDE_SLIP, UNDERSTEER
from calib.kinematics.estimate import estimate_geometry
from calib.types import FloatArray
from calib.vehicle import Vehicle
from tests.real.recordings import available, in_memory

#: the makers' figures
WHEELBASE_M = 0.1735
SENSOR_M = (0.115, -0.010)
#: their yaw of the reference point: its size, since they do not say which way it counts
SENSOR_YAW_RAD = 0.00769
STEERING_ZERO_RAD = -0.0153
#: tyres grip up to here: the distance by encoder is right within 2 % (README of the recordings)
GRIPS_MPS = 1.7
#: speed over which the drive is taken to have begun, and the bins of the table
MOVES_MPS, BIN_MPS = 0.05, 0.25
#: a recording's own steering zero is taken from its part below this speed
SLOW_MPS = 0.75
#: predictions of the curvature: nominal, geometry of the other recordings, the same with the own steering zero
ERRORS = ("before", "after", "by_own")
#: nominal; speeds are stated in m/s, so that it only scales the counts
RADIUS_M = 0.03


def steering_angle_rad(command: FloatArray) -> FloatArray:
    """Return the angle of a steering command by the makers' curve, two hyperbolic tangents joined at the zero."""
    shifted = command + 0.0030
    right = 0.5 * (np.tanh(30.0 * shifted) + 1.0)
    return right * 0.36576 * np.tanh(1.3929 * shifted) + (1.0 - right) * 0.51479 * np.tanh(1.02304 * shifted)


def dart(folder: Path, fastest_mps: float = GRIPS_MPS) -> Campaign:
    """Return the ramps as a campaign, each up to where it first drives faster than `fastest_mps`."""
    logs = []
    paths = sorted(available(folder, "dart").glob("*_ramp.csv"))
    for path in paths:
        table = pd.read_csv(path)
        speed = table["vel encoder"].to_numpy()
        begin = int(np.argmax(speed > MOVES_MPS))
        fast = np.flatnonzero(speed > fastest_mps)
        part = slice(begin, int(fast[0]) if len(fast) else len(speed))
        t_s = table["vicon time"].to_numpy()[part]
        speed = speed[part]
        way = np.concatenate(([0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(t_s))))
        logs.append(
            {
                "t_s": t_s - t_s[0],
                "counts_rear": way / SPEED_COUNT_M,
                "steer_rad": steering_angle_rad(table["steering"].to_numpy()[part]),
                "ref_x_m": table["vicon x"].to_numpy()[part],
                "ref_y_m": table["vicon y"].to_numpy()[part],
                "ref_theta_rad": np.unwrap(table["vicon yaw"].to_numpy()[part]),
            }
        )
    names = [f"ramp {number}" for number in range(len(logs))]
    labels = {"run_id": names, "session": ["9 September"] * len(logs), "kind": ["ramp"] * len(logs)}
    vehicle = Vehicle(0.15, WHEELBASE_M, RADIUS_M, 1.58, 0.093, drive="ackermann")
    model = OdometryModel(RADIUS_M, RADIUS_M, 0.15, vehicle.unladen_load_N)
    per_rev = 2.0 * np.pi * RADIUS_M / SPEED_COUNT_M
    reference = Reference(sigma_xy_m=1e-3, sigma_theta_rad=3e-3, frame="map")
    return in_memory(
        "DART", logs, labels, (vehicle, Encoder(per_rev, per_rev, kind="speed"), model, reference), end_poses=False
    )


def curvatures(campaign: Campaign, run: int, model: FrontModel) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return speed in m/s, and curvature in 1/m measured and by a model, in stretches of half a second of a run."""
    log = campaign.logs.of(run)
    rolled = np.diff(log["counts_rear"], prepend=0.0) * SPEED_COUNT_M / RADIUS_M
    ahead, _, turn = shaft_motion(model, rolled, log["steer_rad"], log["t_s"])
    edges = np.arange(0, len(ahead), 50)
    way, by_model = (np.add.reduceat(part, edges)[:-1] for part in (rolled * RADIUS_M, turn))
    measured = np.diff(log["ref_theta_rad"][edges])
    rolls = way > 0.05
    way = way[rolls]
    return way / np.diff(log["t_s"][edges])[rolls], measured[rolls] / way, by_model[rolls] / way


def held_out(campaign: Campaign) -> pd.DataFrame:
    """Return curvature over that by the nominal steering, measured and predicted, each recording held out in turn."""
    rows = []
    nominal = campaign.model.steered(campaign.vehicle)
    numbers = np.arange(len(campaign.runs))
    for run in numbers:
        values = estimate_geometry(campaign.select(numbers != run)).values
        fitted = FrontModel(
            values["rear_radius_m"],
            values["wheelbase_m"],
            values["steering_zero_rad"],
            values["steering_scale"],
            values.get(UNDERSTEER, 0.0),
            values.get(SIDE_SLIP, 0.0),
        )
        speed, measured, before = curvatures(campaign, int(run), nominal)
        after = curvatures(campaign, int(run), fitted)[2]
        # the servo's play: one angle a recording, from its own slow part alone
        slow = speed < SLOW_MPS
        angle = np.arctan(fitted.wheelbase_m * np.column_stack([measured, after])[slow])
        own = replace(fitted, zero_rad=fitted.zero_rad + float(np.median(angle[:, 0] - angle[:, 1])))
        by_own = np.where(slow, np.nan, curvatures(campaign, int(run), own)[2])
        columns = {"speed": speed, "measured": measured, "before": before, "after": after, "by_own": by_own}
        rows.append(pd.DataFrame(columns))
    return pd.concat(rows, ignore_index=True)


def _rms(errors: pd.Series) -> float:
    """Return the root mean square of the errors that are known."""
    return float(np.sqrt(np.mean(np.square(errors.dropna()))))


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the geometry of the ramps, and how well it predicts the curvature of recordings held out."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="folder of the recordings, ../shared/data")
    chosen = parser.parse_args(arguments)
    campaign = dart(chosen.folder)
    print(estimate_geometry(campaign).summary())
    table = held_out(campaign)
    print("\ncurvature of recordings held out, 1/m: root mean square error in each bin of speed")
    print(f"(own zero: steering zero of the recording itself, from speeds below {SLOW_MPS} m/s)")
    print("speed m/s   n  measured  nominal off  geometry off  own zero off")
    for low in np.arange(0.0, GRIPS_MPS, BIN_MPS):
        part = table[(table.speed >= low) & (table.speed < low + BIN_MPS)]
        if len(part) < 5:
            continue
        errors = [_rms(part[name] - part.measured) for name in ERRORS]
        middle = float(part.measured.abs().mean())
        figures = " ".join(f"{error:13.3f}" for error in errors)
        print(f"{low:4.2f}-{low + BIN_MPS:4.2f} {len(part):4d} {middle:9.3f} {figures}")
    for name in ERRORS:
        print(f"all, {name}: {_rms(table[name] - table.measured):.3f} 1/m")


if __name__ == "__main__":
    main()
