"""Make ``sample_runs/yard``: corridor, square and paper-route runs of a vehicle in which one thing is wrong.

What it is stands in ``sample_runs/truth/yard.json`` only, sealed in base64 so that nobody reads it by accident; this
script reads it from there. ``python sample_runs/make_yard.py`` makes the same bytes again; ``--signal`` says how
strongly the effect shows, by the plant's own measure.
"""

from __future__ import annotations

import argparse
import base64
import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from calib.campaign import write_campaign
from calib.campaign.model import Campaign
from calib.campaign.settings import OdometryModel
from calib.plant import Cause, Noise
from calib.plant.design import Design
from calib.plant.make import make_campaign
from calib.plant.signal import alternatives, rivals, strengths
from calib.vehicle import Vehicle

HERE = Path(__file__).resolve().parent
SEED = 4711

#: route, direction, payload in kg, x and y of its centre in m, speed in m/s; each driven in every session
CONDITIONS = (
    ("corridor", "out", 0.0, 0.0, 0.0, 0.3),
    ("corridor", "back", 0.0, 0.0, 0.0, 0.5),
    ("corridor", "out", 100.0, 0.3, 0.1, 0.5),
    ("corridor", "back", 100.0, 0.3, -0.1, 0.3),
    ("corridor", "out", 200.0, 0.2, 0.0, 0.6),
    ("corridor", "back", 200.0, 0.2, 0.0, 0.6),
    ("corridor_short", "out", 100.0, 0.3, 0.0, 0.5),
    ("corridor_short", "back", 0.0, 0.0, 0.0, 0.5),
    ("square_cw", "", 0.0, 0.0, 0.0, 0.5),
    ("square_ccw", "", 0.0, 0.0, 0.0, 0.3),
    ("square_cw", "", 200.0, 0.2, 0.0, 0.3),
    ("square_ccw", "", 200.0, 0.2, 0.0, 0.5),
    ("square_cw", "", 100.0, 0.3, 0.1, 0.6),
    ("square_ccw", "", 100.0, 0.3, -0.1, 0.6),
    ("route_left", "", 0.0, 0.0, 0.0, 0.6),
    ("route_right", "", 0.0, 0.0, 0.0, 0.3),
    ("route_left", "", 200.0, 0.2, 0.0, 0.3),
    ("route_right", "", 200.0, 0.2, 0.0, 0.6),
)
SESSIONS = ("mon", "tue", "wed", "thu")
#: hall temperature of each session's first and second half, degrees Celsius
TEMPERATURES = ((14.0, 22.0), (21.0, 13.0), (16.0, 25.0), (24.0, 15.0))

NOISE = Noise(
    texture_m=1.4e-4,
    common=3e-5,
    differential=1.2e-5,
    start_heading_rad=2e-4,
    laser_m=1.4e-3,
    ref_xy_m=2e-3,
    ref_theta_rad=7e-4,
    tail=6.0,
)
MODEL = OdometryModel(
    radius_left_m=0.0994,
    radius_right_m=0.0993,
    track_m=0.701,
    reference_load_N=300.0,
    slope_left_m_per_N=-1.1e-6,
    slope_right_m_per_N=-1.0e-6,
)


def design() -> Design:
    """Return the runs: every condition once a session, in another order each time."""
    rng = np.random.default_rng([SEED, 0])
    rows = []
    for number, session in enumerate(SESSIONS):
        order = rng.permutation(len(CONDITIONS))
        for place, condition in enumerate(order):
            half = int(2 * place / len(order))
            temperature = TEMPERATURES[number][half] + rng.uniform(-0.3, 0.3)
            minutes = float(rng.choice([3.0, 15.0, 40.0])) if CONDITIONS[condition][2] else 0.0
            rows.append((*CONDITIONS[condition], session, round(temperature, 1), minutes))
    kind, direction, payload, x, y, speed, session, temperature, minutes = (
        list(column) for column in zip(*rows, strict=True)
    )
    return Design(
        kind=np.array(kind),
        direction=np.array(direction),
        session=np.array(session),
        payload_kg=np.array(payload),
        payload_x_m=np.array(x),
        payload_y_m=np.array(y),
        speed_mps=np.array(speed),
        temperature_C=np.array(temperature),
        minutes_under_load=np.array(minutes),
        flying=np.zeros(len(rows), dtype=bool),
        stops=np.zeros(len(rows), dtype=np.int64),
        length_m=20.0,
        side_m=3.0,
        radius_m=1.1,
        vehicle=Vehicle(),
        slope_per_N=1.1e-5,
        log_period_s=0.2,
    )


def truth() -> list[Cause]:
    """Return what is wrong, from its sealed file."""
    sealed = json.loads((HERE / "truth" / "yard.json").read_text(encoding="utf-8"))["sealed"]
    return [Cause(**one) for one in json.loads(base64.b64decode(sealed))["causes"]]


def yard() -> Campaign:
    """Return the campaign."""
    made = make_campaign(design(), truth(), np.random.default_rng([SEED, 1]), noise=NOISE, model=MODEL, name="yard")
    return replace(made, simulated=True)


def main() -> None:
    """Write the campaign, or say how strongly its effect shows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--into", type=Path, default=HERE / "yard", help="folder of the campaign")
    parser.add_argument("--signal", action="store_true", help="say how strongly the effect shows; writes nothing")
    given = parser.parse_args()
    if given.signal:
        found = strengths(design(), MODEL, NOISE, truth())
        (_, distance), *_ = rivals(alternatives(design(), MODEL, NOISE, truth()[0]))
        print(f"signal {found.alone[0]:.1f}; nearest other effect {distance:.1f} sigma away")
        return
    digits = {"t_s": 2}
    write_campaign(yard(), given.into, force=True, log_decimals=digits)
    print(f"written: {given.into}")


if __name__ == "__main__":
    main()
