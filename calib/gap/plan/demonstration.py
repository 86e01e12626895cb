"""A campaign without noise in which nearly every effect has something to show itself in."""

from __future__ import annotations

from typing import Final

import numpy as np

from calib.campaign.model import Campaign, Logs, RunTable
from calib.campaign.settings import Encoder, OdometryModel, Rangefinder, Reference
from calib.gap.plan.planned_runs import Measured, PlannedRun, drive
from calib.vehicle import Vehicle

CORRIDOR_M: Final = 20.0
#: route and direction of six runs, driven in three sessions under changing conditions
ROUTES: Final = (
    ("corridor", "out"),
    ("corridor", "back"),
    ("square_cw", ""),
    ("square_ccw", ""),
    ("route_left", ""),
    ("route_right", ""),
)
SESSIONS: Final = ("mon", "tue", "wed")
#: payload, its place ahead of the axle and left of the middle
PAYLOADS: Final = ((0.0, 0.0, 0.0), (100.0, 0.3, -0.1), (200.0, 0.2, 0.0), (100.0, 0.3, 0.1))
SPEEDS_MPS: Final = (0.3, 0.5, 0.6)
WARM_C: Final = (14.0, 18.0, 23.0)
UNDER_LOAD_MIN: Final = (0.0, 3.0, 15.0, 40.0)


def demonstration() -> Campaign:
    """Return 36 runs of a nominal vehicle: a corridor both ways, squares and curved routes.

    Loads, speeds, temperatures, time under load and stops vary; laser, end poses and the front wheel are measured, and
    one end in five is read while the vehicle rolls.
    """
    radius_m, track_m = 0.100, 0.700
    none = RunTable({"run_id": np.zeros(0, dtype=np.str_)}, {}, np.zeros(0, bool), np.zeros(0, np.int64))
    nominal = Campaign(
        root=None,
        name="demonstration",
        simulated=True,
        vehicle=Vehicle(track_m=track_m, wheelbase_m=1.0, wheel_radius_m=radius_m, mass_kg=100.0, cog_x_m=0.388),
        encoder=Encoder(),
        model=OdometryModel(radius_m, radius_m, track_m, reference_load_N=300.0),
        rangefinder=Rangefinder(),
        reference=Reference(),
        runs=none,
        logs=Logs.empty(0),
    )
    runs = []
    for number in range(2 * len(SESSIONS) * len(ROUTES)):
        turn, (kind, direction) = number // len(ROUTES), ROUTES[number % len(ROUTES)]
        # a second, shorter lane in every other turn
        kind += "_short" if kind == "corridor" and turn % 2 else ""
        payload_kg, payload_x_m, payload_y_m = PAYLOADS[(number + turn) % len(PAYLOADS)]
        runs.append(
            PlannedRun(
                kind=kind,
                direction=direction,
                session=SESSIONS[turn // 2],
                payload_kg=payload_kg,
                payload_x_m=payload_x_m,
                payload_y_m=payload_y_m,
                speed_mps=SPEEDS_MPS[(number + number // 4) % len(SPEEDS_MPS)],
                temperature_C=WARM_C[(turn + number // 3) % len(WARM_C)],
                minutes_under_load=UNDER_LOAD_MIN[(2 * turn + number) % len(UNDER_LOAD_MIN)],
                read_rolling=number % 5 == 0,
                stops=number % 3,
            )
        )
    return drive(nominal, runs, Measured(front=True), CORRIDOR_M)
