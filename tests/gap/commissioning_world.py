"""The world of `tests.gap.commissioning`: vehicles, instruments and faults, written as campaign folders.

It shares no code with the package. A guided vehicle drives routes with ramps of speed and curvature; what its wheels
count for that follows from radii, track and faults of each run, in steps of 20 ms.
"""

from __future__ import annotations

import csv
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

Array = np.ndarray
G: Final = 9.81
TICK_S: Final = 0.02
#: kind -> (length m, turn rad) of each piece
ROUTES: Final[dict[str, list[tuple[float, float]]]] = {
    "corridor": [(24.0, 0.0)],
    "corridor_half": [(12.0, 0.0)],
    "loop_left": [(5.0, 0.0), (1.8, np.pi / 2), (3.0, 0.0), (1.8, np.pi / 2)] * 2,
    "loop_right": [(5.0, 0.0), (1.8, -np.pi / 2), (3.0, 0.0), (1.8, -np.pi / 2)] * 2,
    "aisle": [(8.0, 0.0), (2.5, np.pi / 2), (6.0, 0.0)],
    "dock": [(6.0, 0.0), (2.2, -np.pi / 3), (3.0, 0.0), (1.6, np.pi / 2), (4.0, 0.0)],
}


@dataclass(frozen=True)
class Site:
    """A vehicle, its instruments and how it is driven."""

    name: str
    drive: str
    track_m: float
    wheelbase_m: float
    radius_m: float
    per_rev: int
    recorded: bool = False  # poses along the path
    front: bool = False  # the steered wheel drives the odometry
    scatter: float = 1.2e-4  # of each radius from run to run
    walk: float = 4e-4  # rad per root metre
    position_m: float = 2e-3
    heading_rad: float = 1e-3
    laser_m: float = 2e-3


HALL: Final = Site("hall", "tricycle", 0.62, 1.1, 0.085, 8192)
SITES: Final = {
    "hall": HALL,
    "few": replace(HALL, name="few"),
    "front": replace(HALL, name="front", front=True),
    "lab": Site("lab", "differential", 0.26, 0.2, 0.035, 5760, True, False, 2e-4, 8e-4, 6e-4, 3e-3),
    "car": Site("car", "ackermann", 0.24, 0.32, 0.05, 16384, True, True, 2e-4, 8e-4, 6e-4, 3e-3),
}
#: slopes of the radii that the model knows, m/N, about a load in N
LAW: Final = (-0.9e-6, -0.8e-6)
REFERENCE_N: Final = 500.0
MASS_KG, COG_X_M = 180.0, 0.45

Wrong = Mapping[str, float]


@dataclass(frozen=True)
class Run:
    """What was reported of a run."""

    run_id: str
    session: str
    kind: str
    direction: str = ""
    payload_kg: float = 0.0
    speed_mps: float = 0.5
    temperature_C: float = 20.0
    day: int = 0
    number: int = 0


def loads_N(payload_kg: float, left_m: float, track_m: float = HALL.track_m) -> Array:
    """Return the loads of the left and right rear wheel, the payload half a metre ahead of the rear axle."""
    base, x = HALL.wheelbase_m, 0.5
    half = 0.5 * G * (MASS_KG * (base - COG_X_M) / base + payload_kg * (base - x) / base)
    shift = G * payload_kg * (base - x) / base * left_m / track_m
    return np.array([half + shift, half - shift])


def plan_runs(site: Site, rng: np.random.Generator) -> list[Run]:
    """Return the runs of a campaign in the order driven."""
    if site.recorded:
        return [Run(f"rec{n}", f"s{n // 4}", "by_hand", day=n // 4, number=n) for n in range(8)]
    few = site.name == "few"
    n = int(rng.integers(12, 26)) if few else int(rng.integers(40, 81 if site.front else 121))
    kinds = ["corridor", "loop_left", "loop_right", "aisle"] if few else list(ROUTES)
    kinds = [kind for kind in kinds if not (site.front and kind.startswith("corridor"))]
    days = 1 if few else int(rng.integers(2, 4))
    payloads, speeds = ([150.0], [0.7]) if few else ([0.0, 150.0, 300.0], [0.4, 0.7, 1.1])
    runs = []
    for k in range(n):
        day = k * days // n
        hour = (k - day * n / days) / (n / days)
        kind = kinds[int(rng.integers(len(kinds)))]
        runs.append(
            Run(
                f"R{k + 1:03d}",
                f"day{day + 1}",
                kind,
                str(rng.choice(["out", "back"])) if kind.startswith("corridor") else "",
                float(rng.choice(payloads)),
                float(rng.choice(speeds)),
                round(15.0 + 1.5 * day + 6.0 * hour + 0.3 * rng.standard_normal(), 1),
                day,
                k,
            )
        )
    return runs


def motion(site: Site, run: Run, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return speed in m/s and curvature in 1/m of what is driven, each (n_ticks,)."""
    if site.recorded:
        fast, tight = (0.45, 2.5) if site.drive == "differential" else (1.3, 1.0)
        v, kappa = np.zeros(25), np.zeros(25)
        while len(v) < 45.0 / TICK_S:
            hold = int(rng.uniform(1.2, 4.0) / TICK_S)
            v = np.append(v, np.full(hold, rng.uniform(0.35, 1.0) * fast if rng.random() < 0.92 else 0.0))
            kappa = np.append(kappa, np.full(hold, rng.uniform(-tight, tight) if rng.random() < 0.65 else 0.0))
        window = np.hanning(33) / np.hanning(33).sum()
        stop = np.zeros(60)
        return (np.convolve(np.append(part, stop), window, "same") for part in (v, kappa))  # type: ignore[return-value]
    pieces = ROUTES[run.kind]
    lengths = np.array([length for length, _ in pieces])
    total, ramp = float(lengths.sum()), 0.4
    speeds, ways, here = [0.0], [0.0], 0.0
    while here < total - 1e-4:
        brake = np.sqrt(2.0 * ramp * max(total - here, 0.0))
        speeds.append(min(speeds[-1] + ramp * TICK_S, run.speed_mps, max(brake, 0.004)))
        here = min(here + speeds[-1] * TICK_S, total)
        ways.append(here)
    way = np.array(ways)
    edges = np.concatenate(([0.0], np.cumsum(lengths)))
    # heading along the way, rounded where a piece begins
    fine = np.arange(0.0, total + 0.01, 0.01)
    turn = np.interp(fine, edges, np.concatenate(([0.0], np.cumsum([turn for _, turn in pieces]))))
    kernel = np.ones(40) / 40.0
    turn = np.convolve(np.concatenate((np.full(20, turn[0]), turn, np.full(19, turn[-1]))), kernel, "valid")
    weave = 8e-3 * 2.0 * np.pi / 2.7 * np.sin(2.0 * np.pi * way / 2.7 + rng.uniform(0.0, 6.28))
    fade = np.clip(np.minimum(way, total - way) / 1.5, 0.0, 1.0)
    heading = np.interp(way, fine, turn) + weave * fade
    speed = np.diff(way) / TICK_S
    return speed, np.diff(heading) / np.maximum(np.diff(way), 1e-9)


def path_of(ds: Array, turn: Array, aside: Array) -> Array:
    """Return poses (n_ticks + 1, 3) from steps ahead, turned and aside."""
    theta = np.concatenate(([0.0], np.cumsum(turn)))
    middle = theta[:-1] + 0.5 * turn
    x = np.concatenate(([0.0], np.cumsum(ds * np.cos(middle) - aside * np.sin(middle))))
    y = np.concatenate(([0.0], np.cumsum(ds * np.sin(middle) + aside * np.cos(middle))))
    return np.stack([x, y, theta], axis=1)


def lagged(values: Array, seconds: float) -> Array:
    """Return values so many seconds before."""
    ticks = np.arange(len(values))
    return np.asarray(np.interp(ticks - seconds / TICK_S, ticks, values))


def radii_m(site: Site, run: Run, wrong: Wrong, rng: np.random.Generator) -> Array:
    """Return the rolling radii of the left and right wheel in a run."""
    carried = run.payload_kg * (1.0 + 0.02 * rng.standard_normal())
    if run.payload_kg == 150.0:
        carried *= 1.0 + wrong["light_label"]
    off = np.zeros(2) if site.recorded or site.front else loads_N(carried, wrong["payload_left_m"]) - REFERENCE_N
    soft = REFERENCE_N * ((np.maximum(off + REFERENCE_N, 1.0) / REFERENCE_N) ** 0.6 - 1.0) / 0.6
    law = np.array(LAW) * off + wrong["law"] * np.array([1.0, 0.8]) * off + wrong["soft_law"] * soft
    share = wrong["radius"] + np.array([-0.5, 0.5]) * wrong["difference"] + site.scatter * rng.standard_normal(2)
    share = share + (wrong["temperature"] + 1e-5) * (run.temperature_C - 19.0)
    share = share + wrong["wear_per_km"] * run.number * 0.02 * np.array([1.0, 0.7])
    share = share + (np.array([1.0, -0.6]) * wrong["new_wheel"] if run.day >= 1 else 0.0)
    sense = 1.0 if run.direction == "out" else -1.0
    share = share + (sense * wrong["slope"] if run.direction else 0.0)
    if wrong["warm_wheel"]:  # the tyre warms up within the first hour of each day and cools over night
        share = share + wrong["warm_wheel"] * (1.0 - np.exp(-(run.temperature_C - 15.0 - 1.5 * run.day) / 1.5))
    return np.asarray(site.radius_m * (1.0 + share) + law)


def drive(site: Site, run: Run, wrong: Wrong, seed: int) -> tuple[dict[str, Array], Array]:
    """Return the log of a run, and its reading: distance, or end pose, or nothing where the log has poses."""
    rng = np.random.default_rng([seed, run.number])
    v, kappa = motion(site, run, rng)
    ds, turn = v * TICK_S, kappa * v * TICK_S
    slip = site.walk * np.sqrt(np.abs(ds)) * rng.standard_normal(len(ds))
    radius = radii_m(site, run, wrong, rng)
    lateral = v * v * kappa
    accel = np.gradient(v, TICK_S)
    aside = -wrong["side_slip"] * lagged(lateral, 0.15) * ds
    track = site.track_m * (1.0 + wrong["track"]) + site.track_m * wrong["scrub"] * np.abs(lagged(kappa, 0.1))
    if wrong["left_only"]:
        track = track + site.track_m * wrong["left_only"] * (kappa > 0.2)
    # what the wheels roll for this motion
    counted = turn + slip
    if wrong["caster"]:  # the caster swings round after each change of the turn and drags until it has
        swing = np.convolve(np.diff(kappa, prepend=kappa[0]), np.exp(-np.arange(75) * TICK_S / 0.4), "full")[: len(ds)]
        counted = counted - wrong["caster"] * swing * np.abs(ds) / 0.2
    if wrong["joint"]:  # a joint across the hall, 3 m from the start: each crossing turns the vehicle a little
        x = path_of(ds, turn, aside)[:, 0]
        counted = counted - wrong["joint"] * (np.diff((x > 3.0).astype(float)) != 0.0)
    moved = wrong["transfer"] * (MASS_KG + run.payload_kg) * lateral * 0.4 / site.track_m
    rolled = np.stack([ds - 0.5 * track * counted, ds + 0.5 * track * counted])
    rolled = rolled / (radius[:, None] + np.stack([-moved, moved]))
    if run.direction == "back":
        rolled[0] /= 1.0 + wrong["drag"]
    if wrong["lost_fast"]:
        rolled[0] *= 1.0 - wrong["lost_fast"] * np.maximum(np.abs(v) - 0.5, 0.0)
    if wrong["belt"]:  # the belt creeps under the drive's force: the counters at the motors run ahead of the wheels
        rolled = rolled * (1.0 + wrong["belt"] * np.maximum(accel, 0.0))
    angle = np.concatenate((np.zeros((2, 1)), np.cumsum(rolled, axis=1)), axis=1)
    if wrong["eccentric_m"]:  # the right wheel, each recording begun at its index mark
        angle[1] = angle[1] - wrong["eccentric_m"] / site.radius_m * (np.sin(angle[1] + 0.7) - np.sin(0.7))
    stopped = np.concatenate(([False], (v[1:] < 0.01) & (v[:-1] >= 0.01)))
    stopped[-1] |= not site.recorded
    skid = wrong["skid"] * run.speed_mps**2 * stopped
    pose = path_of(ds + skid, turn + (slip if site.front else 0.0), aside)
    t = np.arange(len(pose)) * TICK_S
    log = {"t_s": t}
    unit = site.per_rev / (2.0 * np.pi)
    for name, wheel in zip(("counts_left", "counts_right"), angle, strict=True):
        log[name] = np.floor(unit * wheel + rng.random())
    if site.front:
        log = {"t_s": t, **steered(site, (ds, kappa, v), wrong, radius, rng)}
    if site.recorded:
        return recorded(site, log, pose, wrong, rng), np.empty(0)
    bad = wrong["one_bad_run"] * (run.number == 7)
    if run.kind.startswith("corridor"):
        laser = pose[-1, 0] * (1.0 + wrong["laser_scale"]) + wrong["laser_offset"] + wrong["reflector"] * (run.day == 1)
        return log, np.array([laser + bad + np.hypot(site.laser_m, 2e-3) * rng.standard_normal()])
    start = np.array([3e-3, 3e-3, 1.5e-3]) * rng.standard_normal(3)
    theta = pose[-1, 2] + start[2]
    xy = turned(pose[-1, :2], start[2]) + start[:2] + turned(np.array([wrong["lever_x"], 0.0]), theta)
    xy = turned(xy - np.array([wrong["lever_x"], 0.0]), -wrong["yaw"]) + bad
    return log, np.append(
        xy + site.position_m * rng.standard_normal(2), theta - wrong["yaw"] + site.heading_rad * rng.standard_normal()
    )


def turned(xy: Array, by_rad: float | Array) -> Array:
    """Return points (..., 2) turned."""
    c, s = np.cos(by_rad), np.sin(by_rad)
    return np.stack([c * xy[..., 0] - s * xy[..., 1], s * xy[..., 0] + c * xy[..., 1]], axis=-1)


def steered(
    site: Site, driven: tuple[Array, Array, Array], wrong: Wrong, radius: Array, rng: np.random.Generator
) -> dict[str, Array]:
    """Return counts and steering angle of a steered vehicle."""
    ds, kappa, v = driven
    base = site.wheelbase_m * (1.0 + wrong["wheelbase"])
    shaft = site.drive == "ackermann"
    delta = np.arctan(base * kappa * (1.0 + wrong["understeer"] * v * v))
    reading = delta * (1.0 + wrong["steer_scale"]) + wrong["steer_zero"]
    if wrong["steer_play"]:  # the motor is ahead of the wheel by half the play, on the side of the last move
        moves = np.sign(
            np.where(np.abs(np.diff(delta, prepend=delta[0])) > 2e-4, np.diff(delta, prepend=delta[0]), 0.0)
        )
        last = np.maximum.accumulate(np.where(moves != 0.0, np.arange(len(moves)), 0))
        reading = reading + 0.5 * wrong["steer_play"] * moves[last]
    reading = lagged(reading, wrong["steer_late"]) if wrong["steer_late"] else reading
    # the front wheel rolls along its own angle, at a slip angle to the way that it goes
    goes = np.arctan(base * kappa)
    way = ds if shaft else ds * np.cos(delta - goes) / np.cos(goes)
    counts = np.floor(site.per_rev / (2 * np.pi) * np.cumsum(way) / radius[0] + rng.random())
    name = "counts_rear" if shaft else "counts_front"
    # a step's angle is that of its middle, the sensor is read between two steps
    angle = 0.5 * (np.append(reading[0], reading) + np.append(reading, reading[-1])) + 5e-4 * rng.standard_normal(
        len(ds) + 1
    )
    return {name: np.concatenate(([0.0], counts)), "steer_rad": angle}


def recorded(
    site: Site, log: dict[str, Array], pose: Array, wrong: Wrong, rng: np.random.Generator
) -> dict[str, Array]:
    """Return the log with poses of motion capture in the room's frame: dropouts, noise, a delay, an offset marker."""
    pose = np.stack([lagged(column, wrong["late"]) for column in pose.T], axis=1) if wrong["late"] else pose
    xy = pose[:, :2] + turned(np.array([wrong["lever_x"], 0.0]), pose[:, 2])
    at = rng.uniform(-2.0, 2.0, 2)
    room = rng.uniform(-3.0, 3.0)
    xy = turned(xy, room) + at + site.position_m * rng.standard_normal(xy.shape)
    theta = pose[:, 2] + room - wrong["yaw"] + site.heading_rad * rng.standard_normal(len(pose))
    every = 5 if rng.random() < 0.5 else 1
    seen = (np.arange(len(pose)) % every == 0) & ~(
        np.convolve(rng.random(len(pose)) < 3e-3, np.ones(20), "full")[: len(pose)] > 0
    )
    seen[0] = True
    columns = {"ref_x_m": xy[:, 0], "ref_y_m": xy[:, 1], "ref_theta_rad": theta}
    return {**log, **{name: np.where(seen, column, np.nan) for name, column in columns.items()}}


Driven = list[tuple[Run, dict[str, Array], Array]]


def drive_all(site: Site, runs: Sequence[Run], wrong: Wrong, seed: int) -> Driven:
    """Return each run with its log and reading."""
    wrong = defaultdict(float, wrong)
    return [(run, *drive(site, run, wrong, seed)) for run in runs]


def write(folder: Path, site: Site, driven: Driven) -> None:
    """Write a campaign's files."""
    (folder / "logs").mkdir(parents=True)
    hall = not site.recorded
    vehicle = {
        "drive": f'"{site.drive}"',
        "track_m": site.track_m,
        "wheelbase_m": site.wheelbase_m,
        "wheel_radius_m": site.radius_m,
        "front_wheel_radius_m": site.radius_m,
    }
    vehicle |= {"mass_kg": MASS_KG, "cog_x_m": COG_X_M} if hall else {"mass_kg": 9.0, "cog_x_m": 0.1}
    model = {"radius_left_m": site.radius_m, "radius_right_m": site.radius_m, "track_m": site.track_m}
    if hall and not site.front:
        model |= {"reference_load_N": REFERENCE_N, "slope_left_m_per_N": LAW[0], "slope_right_m_per_N": LAW[1]}
    frame = '"map"' if site.recorded else '"start"'
    sections: dict[str, Mapping[str, Any]] = {
        "vehicle": vehicle,
        "encoder": {"counts_per_rev": site.per_rev, "counts_per_rev_front": site.per_rev},
        "model": model,
        "rangefinder": {"sigma_m": site.laser_m},
        "reference": {"sigma_xy_m": site.position_m, "sigma_theta_rad": site.heading_rad, "frame": frame},
    }
    if site.front and site.drive == "tricycle":
        sections["odometry"] = {"from": '"front"'}
    text = 'format = "calib-campaign/1"\nsimulated = true\n'
    for section, entries in sections.items():
        text += f"\n[{section}]\n" + "".join(f"{key} = {value}\n" for key, value in entries.items())
    (folder / "campaign.toml").write_text(text)
    rows = []
    for run, log, reading in driven:
        row: dict[str, Any] = {"run_id": run.run_id, "session": run.session, "kind": run.kind}
        if hall:
            loads = loads_N(run.payload_kg, 0.0)
            row |= {
                "direction": run.direction,
                "payload_kg": run.payload_kg,
                "payload_x_m": 0.5,
                "payload_y_m": 0.0,
                "load_left_N": f"{loads[0]:.1f}",
                "load_right_N": f"{loads[1]:.1f}",
                "speed_mps": run.speed_mps,
                "temperature_C": run.temperature_C,
            }
            names = ["distance_m"] if len(reading) == 1 else ["ref_x_m", "ref_y_m", "ref_theta_rad"]
            row |= {name: f"{value:.5f}" for name, value in zip(names, reading, strict=True)}
            if not site.front:
                row |= {name: int(log[name][-1] - log[name][0]) for name in ("counts_left", "counts_right")}
        row["log"] = f"logs/{run.run_id}.csv"
        rows.append(row)
        every = 1 if site.recorded else 2 if site.front else 5
        kept = np.unique(np.append(np.arange(0, len(log["t_s"]), every), len(log["t_s"]) - 1))
        with (folder / row["log"]).open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(log)
            for tick in kept:
                writer.writerow(
                    "" if not np.isfinite(x := column[tick]) else int(x) if name.startswith("counts") else f"{x:.5f}"
                    for name, column in log.items()
                )
    fields = list(dict.fromkeys(key for row in rows for key in row))
    with (folder / "runs.csv").open("w", newline="") as file:
        table = csv.DictWriter(file, fields)
        table.writeheader()
        table.writerows(rows)
