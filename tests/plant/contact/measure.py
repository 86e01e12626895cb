"""What the instruments make of runs that were driven: counters, laser, pose reference, run table and logs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.campaign.model import Campaign, Logs, RunTable
from calib.campaign.settings import Encoder, OdometryModel, Rangefinder, Reference
from calib.types import FloatArray
from tests.plant.contact.machine import Payload
from tests.plant.contact.ride import COUNTS_PER_REV, Ride, Track
from tests.plant.contact.variants import sound_machine

__all__ = ["measured"]


#: the plant's 50 samples a second against a log's 10
_LOG_EVERY = 5


def measured(
    rng: np.random.Generator,
    name: str,
    model: OdometryModel,
    session: list[int],
    conditions: Sequence[tuple[str, str, Payload, float]],
    loads: Sequence[tuple[float, float]],
    rides: Sequence[Ride],
    tracks: Sequence[Track],
    *,
    trace: bool,
    front: bool,
) -> Campaign:
    """Return the campaign that the instruments make of what happened.

    Parameters
    ----------
    rng : numpy.random.Generator
        Noise of the instruments.
    name : str
        Name of the campaign.
    model : OdometryModel
        What the simulator believes.
    session : list of int
        Number of the session, a run each.
    conditions : sequence of (route, direction, payload, speed)
        As reported, a run each.
    loads : sequence of (float, float)
        Wheel loads left and right for the run table, in N.
    rides, tracks : sequence of Ride, sequence of Track
        What was driven, and what happened.
    trace : bool
        The logs have the rangefinder's distance and the reference's trajectory.
    front : bool
        The logs have the front wheel's counts and the steering angle.
    """
    laser, reference, vehicle = Rangefinder(), Reference(), sound_machine().vehicle
    n_runs = len(tracks)
    corridor = np.array([kind == "corridor" for kind, *_ in conditions])
    pose = np.array([(track.x_m[-1], track.y_m[-1], track.theta_rad[-1]) for track in tracks])
    pose += rng.normal(size=pose.shape) * (reference.sigma_xy_m, reference.sigma_xy_m, reference.sigma_theta_rad)
    distance = np.array([_along(track, ride)[-1] for track, ride in zip(tracks, rides, strict=True)])
    distance += rng.normal(0.0, laser.sigma_m, n_runs)
    session_temperature = rng.normal(20.0, 1.0, max(session) + 1)
    run_id = np.array([f"r{number:03d}" for number in range(n_runs)])
    payloads = [payload for _, _, payload, _ in conditions]
    table = RunTable(
        labels={
            "run_id": run_id,
            "session": np.array([f"s{number + 1}" for number in session]),
            "kind": np.array([kind for kind, *_ in conditions]),
            "direction": np.array([direction for _, direction, *_ in conditions]),
            "log": np.array([f"logs/{run}.csv" for run in run_id]),
        },
        numbers={
            "payload_kg": np.array([payload.mass_kg for payload in payloads]),
            "payload_x_m": np.array([payload.x_m if payload.mass_kg else 0.0 for payload in payloads]),
            "payload_y_m": np.array([payload.y_m for payload in payloads]),
            "load_left_N": np.round([left for left, _ in loads], 2),
            "load_right_N": np.round([right for _, right in loads], 2),
            "speed_mps": np.array([speed for *_, speed in conditions]),
            "temperature_C": np.round(session_temperature[session] + rng.normal(0.0, 0.3, n_runs), 1),
            "distance_m": np.where(corridor, np.round(distance, 4), np.nan),
            "counts_left": np.array([track.counts_left[-1] for track in tracks]),
            "counts_right": np.array([track.counts_right[-1] for track in tracks]),
            "ref_x_m": np.round(pose[:, 0], 5),
            "ref_y_m": np.round(pose[:, 1], 5),
            "ref_theta_rad": np.round(pose[:, 2], 6),
        },
        excluded=np.zeros(n_runs, dtype=bool),
        line=np.arange(2, n_runs + 2, dtype=np.int64),
    )
    return Campaign(
        root=None,
        name=name,
        simulated=True,
        vehicle=vehicle,
        encoder=Encoder(COUNTS_PER_REV, COUNTS_PER_REV),
        model=model,
        rangefinder=laser,
        reference=reference,
        runs=table,
        logs=_logs(rng, rides, tracks, pose, distance, laser, reference, trace=trace, front=front),
    )


def _along(track: Track, ride: Ride) -> FloatArray:
    """Return the way made along the axis of the hall since the start, shape (n,): what a laser at the wall sees."""
    cos, sin = np.cos(ride.heading_rad), np.sin(ride.heading_rad)
    return np.asarray(np.sign(cos) * (cos * track.x_m - sin * track.y_m))


def _logs(
    rng: np.random.Generator,
    rides: Sequence[Ride],
    tracks: Sequence[Track],
    pose: FloatArray,
    distance: FloatArray,
    laser: Rangefinder,
    reference: Reference,
    *,
    trace: bool,
    front: bool,
) -> Logs:
    """Return the logs; last readings are those of the run table, and first ones zero."""
    columns: dict[str, list[FloatArray]] = {}

    def put(column: str, values: FloatArray, decimals: int) -> None:
        columns.setdefault(column, []).append(np.round(values, decimals))

    lengths = []
    for ride, track, end, way in zip(rides, tracks, pose, distance, strict=True):
        kept = np.union1d(np.arange(0, len(track.t_s), _LOG_EVERY), [len(track.t_s) - 1])
        lengths.append(len(kept))
        put("t_s", track.t_s[kept], 3)
        put("counts_left", track.counts_left[kept], 0)
        put("counts_right", track.counts_right[kept], 0)
        if front:
            put("counts_front", track.counts_front[kept], 0)
            put("steer_rad", track.steer_rad[kept], 5)
        if not trace:
            continue
        ranged = _along(track, ride)[kept] + rng.normal(0.0, laser.sigma_m, len(kept))
        ranged[0], ranged[-1] = 0.0, way
        put("range_m", ranged if ride.kind == "corridor" else np.full(len(kept), np.nan), 4)
        for column, true, last, sigma, decimals in (
            ("ref_x_m", track.x_m, end[0], reference.sigma_xy_m, 5),
            ("ref_y_m", track.y_m, end[1], reference.sigma_xy_m, 5),
            ("ref_theta_rad", track.theta_rad, end[2], reference.sigma_theta_rad, 6),
        ):
            read = true[kept] + rng.normal(0.0, sigma, len(kept))
            read[0], read[-1] = 0.0, last
            put(column, read, decimals)
    return Logs(
        offsets=np.concatenate(([0], np.cumsum(lengths))).astype(np.int64),
        columns={column: np.concatenate(parts) for column, parts in columns.items()},
    )
