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
