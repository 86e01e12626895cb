"""Make the sample campaigns: `python sample_runs/make_samples.py [--into FOLDER] [--force]`.

The numbers come from a small simulation that shares nothing with the fit: wheels roll along a woven path, integrated in
steps of millimetres, under counters that show whole counts.

- ``corridor``: 60 runs in five sessions, one load a session; radii grow with load.
- ``corridor_crossed``: the same effort, every load in every session, some payloads off the centre line; radii shrink.

The same seed gives the same files, byte for byte.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from calib.campaign import write_campaign
from calib.campaign.model import Campaign, Logs, RunTable
from calib.campaign.settings import Encoder, OdometryModel, Rangefinder, Reference
from calib.vehicle import Vehicle, wheel_loads_N

SEED: Final = 20190615
VEHICLE: Final = Vehicle()
ENCODER: Final = Encoder()
NOMINAL_RADIUS_M: Final = 0.1
REFERENCE_LOAD_N: Final = 300.0
SPEED_MPS: Final = 0.5
ACCELERATION_MPS2: Final = 0.25
LOG_RATE_HZ: Final = 10.0
STEP_M: Final = 0.004
RANGEFINDER: Final = Rangefinder(sigma_m=0.0015)
REFERENCE: Final = Reference(sigma_xy_m=0.002, sigma_theta_rad=0.0008)


@dataclass(frozen=True)
class Truth:
    """What is true in a simulated campaign: radii, their change with load, and how they scatter.

    Parameters
    ----------
    mounting_left, mounting_right : float
        Relative deviation of the radius at the reference load from the nominal one.
    beta_left_per_N, beta_right_per_N : float
        Relative change of the radius a newton.
    session_scatter, run_scatter, wheel_scatter : float
        Relative standard deviations: both wheels for a session, both wheels for a run, each wheel for a run.
    """

    mounting_left: float
    mounting_right: float
    beta_left_per_N: float
    beta_right_per_N: float
    session_scatter: float
    run_scatter: float = 1.6e-4
    wheel_scatter: float = 0.6e-4


@dataclass(frozen=True)
class Plan:
    """Runs in the order driven: payloads (kg, x, y), sessions, and the temperature of each session's hall."""

    name: str
    payloads: tuple[tuple[float, float, float], ...]
    sessions: tuple[str, ...]
    temperatures_C: dict[str, float]
    truth: Truth


def corridor() -> Plan:
    """Return the plan of one load a session."""
    masses = (0.0, 100.0, 200.0, 50.0, 150.0)
    names = [f"s{number + 1}" for number in range(5)]
    return Plan(
        name="corridor",
        payloads=tuple((mass, 0.1845, 0.0) for mass in masses for _ in range(12)),
        sessions=tuple(name for name in names for _ in range(12)),
        temperatures_C=dict(zip(names, (20.1, 19.8, 20.3, 20.0, 19.9), strict=True)),
        truth=Truth(0.8e-4, -0.7e-4, +1.4862e-5, +1.2996e-5, session_scatter=1.0e-5),
    )


def corridor_crossed(generator: np.random.Generator) -> Plan:
    """Return the plan of six payloads in every session, in shuffled order, each driven out and back."""
    conditions = (
        (0.0, 0.1845, 0.0),
        (60.0, 0.1845, 0.0),
        (100.0, 0.1845, 0.0),
        (200.0, 0.1845, 0.0),
        (120.0, 0.35, 0.20),
        (120.0, 0.35, -0.20),
    )
    names = [f"s{number + 1}" for number in range(5)]
    orders = [generator.permutation(len(conditions)) for _ in names]
    return Plan(
        name="corridor_crossed",
        payloads=tuple(conditions[index] for order in orders for index in order for _ in range(2)),
        sessions=tuple(name for name in names for _ in range(12)),
        temperatures_C=dict(zip(names, (18.4, 20.6, 22.3, 19.2, 21.1), strict=True)),
        truth=Truth(0.0, 0.0, -1.4688e-5, -1.2863e-5, session_scatter=0.4e-5),
    )


@dataclass(frozen=True)
class Drive:
    """One run as it was: path on fine steps, in a frame along the corridor."""

    along_m: np.ndarray
    lateral_m: np.ndarray
    heading_rad: np.ndarray
    rolled_m: np.ndarray


def drive(distance_m: float, generator: np.random.Generator) -> Drive:
    """Return a run along a corridor that weaves a little about the line, in two waves."""
    along = np.linspace(0.0, distance_m, int(distance_m / STEP_M) + 1)
    lateral, slope = np.zeros_like(along), np.zeros_like(along)
    for amplitude, wavelength in (
        (generator.uniform(0.006, 0.022), generator.uniform(7.0, 14.0)),
        (generator.uniform(0.0005, 0.0015), generator.uniform(3.0, 5.0)),
    ):
        wave_number, phase = 2 * np.pi / wavelength, generator.uniform(0, 2 * np.pi)
        lateral += amplitude * np.sin(wave_number * along + phase)
        slope += amplitude * wave_number * np.cos(wave_number * along + phase)
    length = np.hypot(1.0, slope)
    rolled = np.concatenate(([0.0], np.cumsum(0.5 * (length[1:] + length[:-1]) * np.diff(along))))
    return Drive(along, lateral - lateral[0], np.arctan(slope), rolled)


def rolled_at(times_s: np.ndarray, length_m: float) -> np.ndarray:
    """Return the path rolled at each time: ramp up, set speed, ramp down."""
    ramp_s = SPEED_MPS / ACCELERATION_MPS2
    ramp_m = 0.5 * SPEED_MPS * ramp_s
    end_s = 2 * ramp_s + (length_m - 2 * ramp_m) / SPEED_MPS
    up = 0.5 * ACCELERATION_MPS2 * np.minimum(times_s, ramp_s) ** 2
    level = SPEED_MPS * np.clip(times_s - ramp_s, 0.0, end_s - 2 * ramp_s)
    left = np.clip(end_s - times_s, 0.0, ramp_s)
    down = np.where(times_s > end_s - ramp_s, ramp_m - 0.5 * ACCELERATION_MPS2 * left**2, 0.0)
    return np.minimum(up + level + down, length_m)


def simulate(plan: Plan, generator: np.random.Generator) -> Campaign:
    """Return the campaign that a plan would measure."""
    n = len(plan.sessions)
    truth = plan.truth
    mass, x, y = (np.array(column) for column in zip(*plan.payloads, strict=True))
    _, load_left, load_right = wheel_loads_N(VEHICLE, mass, x, y)
    shift = {name: generator.normal(0.0, truth.session_scatter) for name in dict.fromkeys(plan.sessions)}
    common = np.array([shift[name] for name in plan.sessions]) + generator.normal(0.0, truth.run_scatter, n)
    radius = {
        "left": NOMINAL_RADIUS_M
        * (1 + truth.mounting_left + truth.beta_left_per_N * (load_left - REFERENCE_LOAD_N))
        * (1 + common + generator.normal(0.0, truth.wheel_scatter, n)),
        "right": NOMINAL_RADIUS_M
        * (1 + truth.mounting_right + truth.beta_right_per_N * (load_right - REFERENCE_LOAD_N))
        * (1 + common + generator.normal(0.0, truth.wheel_scatter, n)),
    }
    numbers: dict[str, list[float]] = {}
    logs: list[dict[str, np.ndarray]] = []
    for run in range(n):
        row, log = measure(radius["left"][run], radius["right"][run], generator)
        logs.append(log)
        row["temperature_C"] = round(plan.temperatures_C[plan.sessions[run]] + generator.normal(0.0, 0.08), 1)
        for name, value in row.items():
            numbers.setdefault(name, []).append(value)
    columns = {
        "payload_kg": mass,
        "payload_x_m": x,
        "payload_y_m": y,
        "load_left_N": np.round(load_left, 1),
        "load_right_N": np.round(load_right, 1),
        "speed_mps": np.full(n, SPEED_MPS),
        **{name: np.array(values, dtype=np.float64) for name, values in numbers.items()},
    }
    lengths = [len(log["t_s"]) for log in logs]
    return Campaign(
        root=None,
        name=plan.name,
        simulated=True,
        vehicle=VEHICLE,
        encoder=ENCODER,
        model=OdometryModel(NOMINAL_RADIUS_M, NOMINAL_RADIUS_M, VEHICLE.track_m, REFERENCE_LOAD_N, 0.0, 0.0),
        rangefinder=RANGEFINDER,
        reference=REFERENCE,
        runs=RunTable(
            labels={
                "run_id": np.array([f"r{run:03d}" for run in range(n)]),
                "session": np.array(plan.sessions),
                "kind": np.full(n, "corridor"),
                "direction": np.array(["out", "back"] * (n // 2)),
            },
            numbers=columns,
            excluded=np.zeros(n, dtype=np.bool_),
            line=np.arange(2, n + 2),
        ),
        logs=Logs(
            offsets=np.concatenate(([0], np.cumsum(lengths))).astype(np.int64),
            columns={name: np.concatenate([log[name] for log in logs]) for name in logs[0]},
        ),
    )


def measure(
    radius_left_m: float, radius_right_m: float, generator: np.random.Generator
) -> tuple[dict[str, float], dict[str, np.ndarray]]:
    """Drive one run and return its row of the run table and its log."""
    distance = generator.uniform(37.0, 42.0)
    path = drive(distance, generator)
    turned = path.heading_rad - path.heading_rad[0]
    ramp_s = SPEED_MPS / ACCELERATION_MPS2
    duration = path.rolled_m[-1] / SPEED_MPS + ramp_s
    times = np.arange(0.0, duration + 1.0 / LOG_RATE_HZ, 1.0 / LOG_RATE_HZ)
    rolled = rolled_at(times, path.rolled_m[-1])
    heading = np.interp(rolled, path.rolled_m, turned)
    counts = {}
    for side, radius, per_rev, sign in (
        ("left", radius_left_m, ENCODER.counts_per_rev_left, -1.0),
        ("right", radius_right_m, ENCODER.counts_per_rev_right, +1.0),
    ):
        wheel = rolled + sign * 0.5 * VEHICLE.track_m * heading
        start = generator.uniform()
        counts[side] = np.floor(start + wheel / (2 * np.pi * radius) * per_rev)
    # the frame of a run stands at its own start pose
    first = path.heading_rad[0]
    ahead, aside = path.along_m[-1], path.lateral_m[-1]
    row = {
        "distance_m": round(distance + generator.normal(0.0, RANGEFINDER.sigma_m), 4),
        "counts_left": counts["left"][-1],
        "counts_right": counts["right"][-1],
        "ref_x_m": round(
            ahead * np.cos(first) + aside * np.sin(first) + generator.normal(0.0, REFERENCE.sigma_xy_m), 4
        ),
        "ref_y_m": round(
            aside * np.cos(first) - ahead * np.sin(first) + generator.normal(0.0, REFERENCE.sigma_xy_m), 4
        ),
        "ref_theta_rad": round(turned[-1] + generator.normal(0.0, REFERENCE.sigma_theta_rad), 5),
    }
    log = {"t_s": np.round(times, 3), "counts_left": counts["left"], "counts_right": counts["right"]}
    return row, log


def main() -> None:
    """Write both campaigns."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--into", type=Path, default=Path(__file__).resolve().parent, help="folder that receives them")
    parser.add_argument("--force", action="store_true", help="replace campaigns that stand there")
    arguments = parser.parse_args()
    first, second = (np.random.default_rng(stream) for stream in np.random.SeedSequence(SEED).spawn(2))
    for campaign in (simulate(corridor(), first), simulate(corridor_crossed(second), second)):
        print(write_campaign(campaign, arguments.into / campaign.name, force=arguments.force))


if __name__ == "__main__":
    main()
