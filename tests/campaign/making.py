"""Campaigns made in memory for the tests of this room."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.campaign.model import Campaign, Logs, RunTable
from calib.campaign.settings import Encoder, OdometryModel, Rangefinder, Reference
from calib.vehicle import Vehicle, wheel_loads_N

PAYLOADS_KG = (0.0, 50.0, 100.0, 150.0, 200.0)


def campaign(
    *, runs_per_load: int = 6, crossed: bool = True, rate_hz: float = 20.0, logs: bool = True, seed: int = 5
) -> Campaign:
    """A sound corridor campaign: five loads, five sessions, 40 m runs at 0.5 m/s, out and back."""
    rng = np.random.default_rng(seed)
    vehicle, encoder = Vehicle(), Encoder()
    n = runs_per_load * len(PAYLOADS_KG)
    order = np.arange(n)
    block = order // runs_per_load
    payload = np.asarray(PAYLOADS_KG)[(order + block) % 5 if crossed else block]
    _, left, right = wheel_loads_N(vehicle, payload, 0.3, 0.02)
    left, right = np.round(left, 1), np.round(right, 1)
    radius = {"left": 0.0990 + 1.3e-6 * (left - 300.0), "right": 0.0993 + 1.2e-6 * (right - 300.0)}
    distance = np.round(rng.uniform(37.0, 42.0, n), 3)
    length = np.floor(distance / 0.5 * rate_hz).astype(int) + 1
    offsets = np.concatenate(([0], np.cumsum(length)))
    time = np.concatenate([np.arange(m) / rate_hz for m in length])
    share = np.concatenate([np.linspace(0.0, 1.0, m) for m in length])
    total = {
        side: distance / (2 * np.pi * r) * 4096 * (1 + 2e-5 * rng.standard_normal(n)) for side, r in radius.items()
    }
    columns = {"t_s": time}
    for side in ("left", "right"):
        columns[f"counts_{side}"] = np.floor(share * np.repeat(total[side], length))
    numbers = {
        "payload_kg": payload,
        "payload_x_m": np.full(n, 0.3),
        "payload_y_m": np.full(n, 0.02),
        "load_left_N": left,
        "load_right_N": right,
        "speed_mps": np.full(n, 0.5),
        "distance_m": distance,
        "counts_left": np.floor(total["left"]),
        "counts_right": np.floor(total["right"]),
    }
    return Campaign(
        root=None,
        name="made",
        simulated=True,
        vehicle=vehicle,
        encoder=encoder,
        model=OdometryModel(0.1, 0.1, 0.7, 300.0),
        rangefinder=Rangefinder(),
        reference=Reference(),
        runs=RunTable(
            labels={
                "run_id": np.asarray([f"r{i:03d}" for i in order]),
                "session": np.asarray([f"s{b + 1}" for b in block]),
                "kind": np.full(n, "corridor"),
                "direction": np.where(order % 2 == 0, "out", "back"),
            },
            numbers=numbers,
            excluded=np.zeros(n, dtype=bool),
            line=order + 2,
        ),
        logs=Logs(offsets=offsets.astype(np.int64), columns=columns) if logs else Logs.empty(n),
    )


def with_numbers(made: Campaign, **columns: np.ndarray) -> Campaign:
    """The same campaign with columns of the run table replaced."""
    return replace(made, runs=replace(made.runs, numbers={**made.runs.numbers, **columns}))


def with_log_columns(made: Campaign, **columns: np.ndarray) -> Campaign:
    """The same campaign with columns of the logs replaced."""
    return replace(made, logs=replace(made.logs, columns={**made.logs.columns, **columns}))


def wandering(made: Campaign, *, track_m: float = 0.7, seed: int = 3, turned: float = 0.0) -> Campaign:
    """Nearly straight runs of a vehicle of this track, with end poses; wheels that differ anew in every run.

    The heading is ``A sin(pi s / d)`` with another A in every run, and the wheels' difference is in the counts alone;
    `turned`: standard deviation of a turn to the end, rad.
    """
    rng = np.random.default_rng(seed)
    runs, logs = made.runs, made.logs
    left, right = logs.columns["counts_left"].copy(), logs.columns["counts_right"].copy()
    pose = np.zeros((3, len(runs)))
    per_m = 4096 / (2 * np.pi * 0.1)
    for run, distance in enumerate(runs.number("distance_m")):
        here = slice(logs.offsets[run], logs.offsets[run + 1])
        along = np.linspace(0.0, distance, logs.lengths[run])
        heading = 0.02 * rng.standard_normal() * np.sin(np.pi * along / distance)
        if turned:
            heading += turned * rng.standard_normal() * along / distance
        middle = (heading[1:] + heading[:-1]) / 2
        pose[:, run] = np.sum(np.diff(along) * np.cos(middle)), np.sum(np.diff(along) * np.sin(middle)), heading[-1]
        apart = track_m * heading + 1e-3 * rng.standard_normal() * along
        left[here], right[here] = np.floor(per_m * (along - apart / 2)), np.floor(per_m * (along + apart / 2))
    pose += np.array([[2e-3], [2e-3], [8e-4]]) * rng.standard_normal(pose.shape)
    ends = logs.offsets[1:] - 1
    made = with_log_columns(made, counts_left=left, counts_right=right)
    return with_numbers(
        made,
        counts_left=left[ends],
        counts_right=right[ends],
        **dict(zip(("ref_x_m", "ref_y_m", "ref_theta_rad"), pose, strict=True)),
    )
