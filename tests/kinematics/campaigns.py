"""Campaigns of known geometry, made by an integration of its own: small steps at the heading before each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.campaign.model import Campaign, Logs, RunTable
from calib.campaign.settings import Encoder, Odometry, OdometryModel, OdometrySource, Rangefinder, Reference
from calib.campaign.wheels import WHEEL_COLUMNS
from calib.vehicle import Vehicle

Leg = tuple[float, float]  # way ahead in m, turn in rad

#: fine enough that Euler's rule is good to micrometres
FINE = 4000
SAMPLES = 200


def square(side_m: float, sense: int) -> list[Leg]:
    """Four sides, each followed by a quarter turn on the spot."""
    return [leg for _ in range(4) for leg in ((side_m, 0.0), (0.0, sense * np.pi / 2))]


@dataclass(frozen=True)
class Truth:
    """What the vehicle really is."""

    radius_left_m: float = 0.0505
    radius_right_m: float = 0.0498
    track_m: float = 0.412
    slope_left: float = 0.0
    slope_right: float = 0.0
    sensor: tuple[float, float, float] = (0.0, 0.0, 0.0)
    delay_s: float = 0.0
    #: how much faster the reference's clock runs, and what the wheels slip per rad/s and per m/s
    clock_rate: float = 0.0
    slip_s_per_rad: float = 0.0
    slip_s_per_m: float = 0.0
    #: speed outward over the acceleration in turns
    side_slip_s: float = 0.0


def driven(legs: Sequence[Leg]) -> tuple[np.ndarray, np.ndarray]:
    """Body motion (way, turn) in fine steps."""
    way = np.concatenate([np.full(FINE // len(legs), leg[0] / (FINE // len(legs))) for leg in legs])
    turn = np.concatenate([np.full(FINE // len(legs), leg[1] / (FINE // len(legs))) for leg in legs])
    return way, turn


def path(way: np.ndarray, turn: np.ndarray, left: np.ndarray | float = 0.0) -> np.ndarray:
    """x, y, heading at all fine steps, start included; each step straight at the heading in its middle."""
    heading = np.concatenate(([0.0], np.cumsum(turn)))
    middle = 0.5 * (heading[1:] + heading[:-1])
    x = np.concatenate(([0.0], np.cumsum(way * np.cos(middle) - left * np.sin(middle))))
    y = np.concatenate(([0.0], np.cumsum(way * np.sin(middle) + left * np.cos(middle))))
    return np.stack([x, y, heading])


def seen_from(pose: np.ndarray, sensor: tuple[float, float, float]) -> np.ndarray:
    """Poses of a sensor on the vehicle, in the frame of its own first pose."""
    sx, sy, yaw = sensor
    c, s = np.cos(pose[2]), np.sin(pose[2])
    x, y, theta = pose[0] + c * sx - s * sy, pose[1] + s * sx + c * sy, pose[2] + yaw
    dx, dy = x - x[0], y - y[0]
    c0, s0 = np.cos(theta[0]), np.sin(theta[0])
    return np.stack([c0 * dx + s0 * dy, c0 * dy - s0 * dx, theta - theta[0]])


def campaign(
    routes: Sequence[tuple[str, Sequence[Leg]]],
    truth: Truth,
    rng: np.random.Generator,
    *,
    sigma: tuple[float, float] = (0.002, 0.001),
    walk: float = 0.0,
    scatter: float = 0.0,
    loads: np.ndarray | None = None,
    along: bool = False,
    nominal: tuple[float, float, float] = (0.05, 0.05, 0.4),
    duration_s: float = 20.0,
    samples: int = SAMPLES,
) -> Campaign:
    """Return a campaign of a two-wheeled vehicle.

    `walk` is a random walk of the true heading (rad per root metre), `scatter` of each radius from run to run
    (relative), `loads` one row of wheel loads a run, `along`
    whether the reference follows along the way; the nominal radii and track are what the settings say.
    """
    per_rev = 20000.0
    logs, ends = [], []
    for number, (_, legs) in enumerate(routes):
        way, turn = driven(legs)
        load = np.zeros(2) if loads is None else loads[number] - 300.0
        left = truth.radius_left_m + truth.slope_left * load[0]
        right = truth.radius_right_m + truth.slope_right * load[1]
        if scatter:
            left, right = np.array([left, right]) * (1.0 + scatter * rng.normal(size=2))
        phi = np.stack([(way - 0.5 * truth.track_m * turn) / left, (way + 0.5 * truth.track_m * turn) / right])
        per_s = len(turn) / duration_s
        phi *= 1.0 + (truth.slip_s_per_rad * np.abs(turn) + truth.slip_s_per_m * np.abs(way)) * per_s
        noisy = turn + rng.normal(size=len(turn)) * walk * np.sqrt(np.abs(way) + 0.1 * np.abs(turn))
        pose = seen_from(path(way, noisy, -truth.side_slip_s * per_s * way * turn), truth.sensor)
        t = np.linspace(0.0, duration_s, len(way) + 1)
        at = np.linspace(0, len(way), samples + 1).round().astype(int)
        counts = np.rint(np.concatenate([np.zeros((2, 1)), np.cumsum(phi, axis=1)], axis=1) / (2 * np.pi) * per_rev)
        log = {"t_s": t[at], "counts_left": counts[0, at], "counts_right": counts[1, at]}
        noise = np.array([sigma[0], sigma[0], sigma[1]])
        if along:
            late = np.stack([np.interp(t[at] * (1.0 - truth.clock_rate) - truth.delay_s, t, axis) for axis in pose])
            late = late + noise[:, None] * rng.normal(size=late.shape)
            log |= dict(zip(("ref_x_m", "ref_y_m", "ref_theta_rad"), late, strict=True))
        logs.append(log)
        ends.append(pose[:, -1] + noise * rng.normal(size=3))
    return _assembled(routes, logs, np.array(ends), sigma, nominal, loads, per_rev, along)


def _assembled(
    routes: Sequence[tuple[str, Sequence[Leg]]],
    logs: list[dict[str, np.ndarray]],
    ends: np.ndarray,
    sigma: tuple[float, float],
    nominal: tuple[float, float, float],
    loads: np.ndarray | None,
    per_rev: float,
    along: bool,
) -> Campaign:
    n = len(routes)
    numbers = {
        "counts_left": np.array([log["counts_left"][-1] for log in logs]),
        "counts_right": np.array([log["counts_right"][-1] for log in logs]),
    }
    if not along:
        numbers |= dict(zip(("ref_x_m", "ref_y_m", "ref_theta_rad"), ends.T, strict=True))
    if loads is not None:
        numbers |= {"load_left_N": loads[:, 0], "load_right_N": loads[:, 1]}
    labels = {
        "run_id": np.array([f"r{number:03d}" for number in range(n)]),
        "session": np.array(["s"] * n),
        "kind": np.array([kind for kind, _ in routes]),
    }
    offsets = np.concatenate(([0], np.cumsum([len(log["t_s"]) for log in logs]))).astype(np.int64)
    columns = {name: np.concatenate([log[name] for log in logs]) for name in logs[0]}
    vehicle = Vehicle(track_m=nominal[2], wheel_radius_m=nominal[0], wheelbase_m=0.6, cog_x_m=0.1, drive="differential")
    return Campaign(
        root=None,
        name="made",
        simulated=True,
        vehicle=vehicle,
        encoder=Encoder(per_rev, per_rev),
        model=OdometryModel(nominal[0], nominal[1], nominal[2], 300.0),
        rangefinder=Rangefinder(),
        reference=Reference(sigma_xy_m=sigma[0], sigma_theta_rad=sigma[1]),
        runs=RunTable(labels, numbers, np.zeros(n, dtype=bool), np.arange(n) + 2),
        logs=Logs(offsets, columns),
        odometry=Odometry("rear"),
    )


def both_ways(n: int, side_m: float = 2.0) -> list[tuple[str, list[Leg]]]:
    """N squares of each sense."""
    return [("square_ccw", square(side_m, 1))] * n + [("square_cw", square(side_m, -1))] * n


def mixed(n: int) -> list[tuple[str, list[Leg]]]:
    """N runs each of squares both ways, arcs both ways, and a line."""
    arcs = [("arc_left", [(3.0, np.pi)])] * n + [("arc_right", [(3.0, -np.pi)])] * n
    return [*both_ways(n), *arcs, *([("line", [(4.0, 0.0)])] * n)]


def tricycle(
    rng: np.random.Generator,
    *,
    sign_front: float = 1.0,
    sign_steer: float = 1.0,
    hooks: bool = False,
    eights: bool = False,
) -> Campaign:
    """A steered front wheel of radius 0.102 m, wheelbase 1.03 m, zero 0.012 rad: lines, arcs both ways, weaves.

    `hooks`: instead of arcs and weaves, two opposite bends about a straight: they end behind the start; `eights`:
    nothing but eights, which end where they began.
    """
    radius, wheelbase, zero, per_rev = 0.102, 1.03, 0.012, 4096.0
    logs, ends = [], []
    kinds = [("line", 0.0), ("left", 0.5), ("right", -0.5), ("weave", 0.3)] * 3
    if hooks:
        kinds = [("line", 0.0), *([("hook", 0.9), ("hook", -0.9)] * 2)] * 2
    if eights:
        kinds = [("eight", 0.5), ("eight", -0.5)] * 5
    of_eight = 4.0 * np.pi * wheelbase / np.sin(0.5)
    for kind, angle in kinds:
        phi = np.full(FINE, {"hook": 14.0, "eight": of_eight}.get(kind, 6.0) / radius / FINE)
        bends = np.linspace(0.0, np.pi, FINE)
        shape = {"weave": np.sin(4.0 * bends), "hook": np.clip(1.5 * np.cos(bends), -1.0, 1.0) + 0.15}
        shape["eight"] = np.sign(np.cos(bends))
        angles = angle * shape.get(kind, np.ones(FINE))
        pose = path(radius * phi * np.cos(angles), radius * phi * np.sin(angles) / wheelbase)
        at = np.linspace(0, FINE, SAMPLES + 1).round().astype(int)
        counts = np.rint(np.concatenate(([0.0], np.cumsum(phi))) / (2 * np.pi) * per_rev)
        steer = np.concatenate((angles[:1], angles)) - zero
        logs.append({"t_s": at * 0.005, "counts_front": sign_front * counts[at], "steer_rad": sign_steer * steer[at]})
        ends.append(pose[:, -1] + np.array([0.002, 0.002, 0.001]) * rng.normal(size=3))
    vehicle = Vehicle(wheelbase_m=1.0, front_wheel_radius_m=0.1, drive="tricycle")
    return _posed("tricycle", vehicle, "front", per_rev, [kind for kind, _ in kinds], logs, np.array(ends))


def mecanum(
    rng: np.random.Generator,
    *,
    left: float = 0.0,
    strafe: float = 0.0,
    nominal: tuple[float, float] = (0.07, 0.369),
    positions: bool = False,
) -> Campaign:
    """Four mecanum wheels of radius 0.068 m with l + w = 0.36 m: lines, strafes, diagonals, spins, arcs.

    `left`: by how much the radii of the left wheels are larger; `strafe`: share that slips to the side; `nominal`:
    radius and l + w of the settings, whose track is that of the wheels, half the sum of both; `positions`: along the
    way, too.
    """
    radius, arm, per_rev = 0.068, 0.36, 20000.0
    motions = {
        "line": (3.0, 0.0, 0.0),
        "strafe_left": (0.0, 2.0, 0.0),
        "strafe_right": (0.0, -2.0, 0.0),
        "diagonal": (2.0, 2.0, 0.0),
        "spin_left": (0.0, 0.0, 6.0),
        "spin_right": (0.0, 0.0, -6.0),
        "arc_left": (2.0, 0.5, 2.0),
        "arc_right": (2.0, -0.5, -2.0),
    }
    kinds, logs, ends = list(motions) * 3, [], []
    for kind in kinds:
        ahead, aside, turn = (np.full(FINE, total / FINE) for total in motions[kind])
        heading = np.concatenate(([0.0], np.cumsum(turn)))
        middle = 0.5 * (heading[1:] + heading[:-1])
        moved = (ahead + 1j * (1.0 - strafe) * aside) * np.exp(1j * middle)
        path = np.concatenate(([0.0], np.cumsum(moved)))
        end = np.array([path[-1].real, path[-1].imag, heading[-1]])
        # front left, front right, rear left, rear right
        rolled = [ahead - aside - arm * turn, ahead + aside + arm * turn, ahead + aside - arm * turn]
        rolled.append(ahead - aside + arm * turn)
        rolled = [way / (1.0 + left * (at % 2 == 0)) for at, way in enumerate(rolled)]
        at = np.linspace(0, FINE, SAMPLES + 1).round().astype(int)
        counts = [np.rint(np.concatenate(([0.0], np.cumsum(w))) / radius / (2 * np.pi) * per_rev)[at] for w in rolled]
        log = {"t_s": at * 0.005, **dict(zip(WHEEL_COLUMNS["wheels"], counts, strict=True))}
        if positions:
            noise = 0.002 * rng.normal(size=(2, len(at)))
            log |= {"ref_x_m": path[at].real + noise[0], "ref_y_m": path[at].imag + noise[1]}
        logs.append(log)
        ends.append(end + np.array([0.002, 0.002, 0.001]) * rng.normal(size=3))
    vehicle = Vehicle(
        wheel_radius_m=nominal[0],
        half_length_plus_half_width_m=nominal[1],
        track_m=nominal[1],
        cog_x_m=0.2,
        drive="mecanum",
    )
    return _posed("mecanum", vehicle, "wheels", per_rev, kinds, logs, np.array(ends))


def _posed(
    name: str,
    vehicle: Vehicle,
    source: OdometrySource,
    per_rev: float,
    kinds: list[str],
    logs: list[dict[str, np.ndarray]],
    ends: np.ndarray,
) -> Campaign:
    """Runs with logs and end poses of a vehicle without rear encoders, judged against its nominal lengths."""
    n = len(logs)
    labels = {"run_id": np.array([f"r{at:03d}" for at in range(n)]), "kind": np.array(kinds)}
    labels["session"] = np.array(["s"] * n)
    offsets = np.concatenate(([0], np.cumsum([len(log["t_s"]) for log in logs]))).astype(np.int64)
    return Campaign(
        root=None,
        name=name,
        simulated=True,
        vehicle=vehicle,
        encoder=Encoder(per_rev, per_rev, counts_per_rev_front=per_rev),
        model=OdometryModel(vehicle.wheel_radius_m, vehicle.wheel_radius_m, vehicle.track_m, 300.0),
        rangefinder=Rangefinder(),
        reference=Reference(sigma_xy_m=0.002, sigma_theta_rad=0.001),
        runs=RunTable(
            labels,
            dict(zip(("ref_x_m", "ref_y_m", "ref_theta_rad"), ends.T, strict=True)),
            np.zeros(n, dtype=bool),
            np.arange(n) + 2,
        ),
        logs=Logs(offsets, {name: np.concatenate([log[name] for log in logs]) for name in logs[0]}),
        odometry=Odometry(source),
    )
