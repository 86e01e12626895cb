"""Campaigns without motion capture: turns by a gyro, closed loops, straight runs along a tape measure.

Integrated in fine steps, by no code of calib's; the gyro has a bias, a scale and noise, and stands still at both ends.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.campaign.model import Border, Campaign, Logs, RunTable
from calib.campaign.read import with_references
from calib.campaign.settings import Encoder, OdometryModel, Rangefinder, Reference
from calib.vehicle import Vehicle
from tests.kinematics.campaigns import Leg, Truth, driven

PER_REV = 20000.0
#: placing the vehicle on its mark again: in m and rad
PLACED = (0.002, 0.002)
#: reading a tape measure
TAPE_M = 0.002
#: of the heading, rad per root metre, that the wheels do not see
WALK = 0.002
#: time at rest at either end, time of the drive, and samples a second
REST_S, DRIVE_S, RATE_HZ = 2.0, 16.0, 50.0


@dataclass(frozen=True)
class Gyro:
    """What is wrong with a gyro: scale, standard deviation of its bias from run to run, and of one sample."""

    scale: float = 1.0
    bias_radps: float = 0.01
    noise_radps: float = 0.002


@dataclass(frozen=True)
class Drive:
    """A run: its route, what measures it (``gyro``, ``loop``, ``tape``, several), and the kind."""

    kind: str
    legs: Sequence[Leg]
    by: frozenset[str]


def unaided(runs: Sequence[Drive], truth: Truth, gyro: Gyro, rng: np.random.Generator) -> Campaign:
    """Return a campaign of a two-wheeled vehicle, nominal radii 0.05 m and track 0.4 m, as it is read."""
    logs = [_log(run, truth, gyro, rng) for run in runs]
    n = len(runs)
    tape = [sum(leg[0] for leg in run.legs) + TAPE_M * rng.normal() if "tape" in run.by else np.nan for run in runs]
    names = sorted({name for log in logs for name in log})
    columns = {
        name: np.concatenate([log.get(name, np.full(len(log["t_s"]), np.nan)) for log in logs]) for name in names
    }
    campaign = Campaign(
        root=None,
        name="unaided",
        simulated=True,
        vehicle=Vehicle(track_m=0.4, wheel_radius_m=0.05, wheelbase_m=0.6, cog_x_m=0.1, drive="differential"),
        encoder=Encoder(PER_REV, PER_REV),
        model=OdometryModel(0.05, 0.05, 0.4, 100.0),
        rangefinder=Rangefinder(sigma_m=TAPE_M),
        reference=Reference(*PLACED),
        runs=RunTable(
            labels={
                "run_id": np.array([f"r{number:03d}" for number in range(n)]),
                "session": np.array(["s"] * n),
                "kind": np.array([run.kind for run in runs]),
                "loop": np.array(["closed" if "loop" in run.by else "" for run in runs]),
            },
            numbers={
                "distance_m": np.array(tape),
                "counts_left": np.array([log["counts_left"][-1] for log in logs]),
                "counts_right": np.array([log["counts_right"][-1] for log in logs]),
            },
            excluded=np.zeros(n, dtype=bool),
            line=np.arange(n) + 2,
        ),
        logs=Logs(np.concatenate(([0], np.cumsum([len(log["t_s"]) for log in logs]))).astype(np.int64), columns),
    )
    return with_references(campaign, "runs.csv", Border(lenient=False))


def _log(run: Drive, truth: Truth, gyro: Gyro, rng: np.random.Generator) -> dict[str, np.ndarray]:
    way, turn = (part.copy() for part in driven(run.legs))
    if "loop" in run.by:
        # set down beside its mark
        way[-1] += PLACED[0] * rng.normal()
        turn[-1] += PLACED[1] * rng.normal()
    slipped = turn + rng.normal(size=len(turn)) * WALK * np.sqrt(np.abs(way) + 0.1 * np.abs(turn))
    phi = np.stack(
        [
            (way - 0.5 * truth.track_m * slipped) / truth.radius_left_m,
            (way + 0.5 * truth.track_m * slipped) / truth.radius_right_m,
        ]
    )
    wheels = np.concatenate([np.zeros((2, 1)), np.cumsum(phi, axis=1)], axis=1) / (2.0 * np.pi) * PER_REV
    heading = np.concatenate(([0.0], np.cumsum(turn)))
    t_s = np.arange(0.0, DRIVE_S + 2.0 * REST_S, 1.0 / RATE_HZ)
    at = (np.clip(t_s - REST_S, 0.0, DRIVE_S) / DRIVE_S) * len(way)
    counts = np.rint([np.interp(at, np.arange(len(way) + 1), wheel) for wheel in wheels])
    log = {"t_s": t_s, "counts_left": counts[0], "counts_right": counts[1]}
    if "gyro" in run.by:
        # what a gyro says is the mean rate about the sample
        edges = np.concatenate((t_s - 0.5 / RATE_HZ, t_s[-1:] + 0.5 / RATE_HZ))
        along = (np.clip(edges - REST_S, 0.0, DRIVE_S) / DRIVE_S) * len(way)
        rate = np.diff(np.interp(along, np.arange(len(way) + 1), heading)) * RATE_HZ
        bias = gyro.bias_radps * rng.normal()
        log["gyro_z_radps"] = gyro.scale * rate + bias + gyro.noise_radps * rng.normal(size=len(t_s))
    return log
