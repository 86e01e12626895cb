"""Campaigns in memory for the tests of the diagnosis: true paths given, counts worked out from them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from calib.campaign.model import Campaign, Logs, RunTable
from calib.campaign.settings import Encoder, OdometryModel, Rangefinder, Reference
from calib.gap import Perturbation
from calib.gap.observations import Observations
from calib.gap.observations.from_campaign import observations_of
from calib.gap.predict import predict
from calib.vehicle import Vehicle

TRACK_M, RADIUS_M, WHEELBASE_M = 0.7, 0.1, 1.0
MODEL = OdometryModel(RADIUS_M, RADIUS_M, TRACK_M, 300.0)
COUNTS = 4096.0
DIFFERENTIAL = Vehicle(track_m=TRACK_M, drive="differential")
#: of the instruments, standard deviations
XY_M, HEADING_RAD, LASER_M = 2e-3, 1e-3, 1.5e-3
Piece = tuple[float, float]


@dataclass
class Run:
    """One run: pieces of (length_m, curvature_per_m), negative lengths backward, at a constant speed.

    `ramp`: the speed is reached from rest; `stops`: the log goes on for a second at rest.
    """

    pieces: list[Piece]
    speed_mps: float = 0.5
    steps: int = 100
    session: str = "s1"
    kind: str = "corridor"
    direction: str = "out"
    load_left_N: float = 300.0
    load_right_N: float = 300.0
    log: bool = True
    front: bool = True
    stops: bool = False
    ramp: bool = False
    numbers: dict[str, float] = field(default_factory=dict)


STRAIGHT: list[Piece] = [(10.0, 0.0)]
ROUTE: list[Piece] = [(5.0, 0.0), (0.5 * np.pi * 3.0, 1 / 3.0), (5.0, 0.0)]
SQUARE: list[Piece] = [(2.0, 0.0), (0.5 * np.pi * 0.5, 2.0)] * 4


@dataclass
class Motion:
    """What truly happens in each step of a run, and what an effect makes of it.

    The upper fields say how the vehicle moves, the lower ones are for a truth to fill: relative change of the radii and
    of the track, turn, way along and sideways that no wheel sees, what instruments add at the end.
    """

    ds_m: np.ndarray
    turn_rad: np.ndarray
    dt_s: np.ndarray
    t_s: np.ndarray
    v_mps: np.ndarray
    kappa: np.ndarray
    steer_rad: np.ndarray
    x_m: np.ndarray
    y_m: np.ndarray
    theta_rad: np.ndarray
    left: np.ndarray | float = 0.0
    right: np.ndarray | float = 0.0
    track: np.ndarray | float = 0.0
    yaw_rad: np.ndarray | float = 0.0
    along_m: np.ndarray | float = 0.0
    lateral_m: np.ndarray | float = 0.0
    left_m: np.ndarray | float = 0.0
    right_m: np.ndarray | float = 0.0
    front: np.ndarray | float = 0.0
    steer_error_rad: np.ndarray | float = 0.0
    laser_m: float = 0.0
    end_x_m: float = 0.0
    end_y_m: float = 0.0
    end_rad: float = 0.0
    swapped: bool = False


def motion_of(run: Run) -> Motion:
    """The plan of a run, stops added, places at the middle of each step by exact arcs."""
    ds, turn, dt = steps_of(run)
    if run.stops:
        ds, turn, dt = (np.concatenate([a, [b, b]]) for a, b in ((ds, 0.0), (turn, 0.0), (dt, 0.5)))
    kappa = np.where(ds != 0.0, turn / np.where(ds == 0, 1.0, ds), 0.0)
    heading = np.concatenate([[0.0], np.cumsum(turn)])
    middle = 0.5 * (heading[1:] + heading[:-1])
    place = np.concatenate([[0.0], np.cumsum(ds * np.sinc(0.5 * turn / np.pi) * np.exp(1j * middle))])
    half = 0.5 * (place[1:] + place[:-1])
    return Motion(
        ds, turn, dt, np.cumsum(dt), ds / dt, kappa, np.arctan(WHEELBASE_M * kappa), half.real, half.imag, middle
    )


Truth = Callable[[Run, Motion], None]


def steps_of(run: Run) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Path and turn of every step, and its duration; each piece in equal steps, so that steps are whole arcs."""
    ds, turn = [], []
    whole = sum(abs(length) for length, _ in run.pieces)
    for length, kappa in run.pieces:
        n = max(1, round(run.steps * abs(length) / whole))
        ds.append(np.full(n, length / n))
        turn.append(np.full(n, abs(length) * kappa / n))
    ds_m, turn_rad = np.concatenate(ds), np.concatenate(turn)
    speed = np.full(len(ds_m), run.speed_mps)
    if run.ramp:
        # from rest at constant acceleration over the first fifth of the way
        way = np.cumsum(np.abs(ds_m)) - 0.5 * np.abs(ds_m)
        speed *= np.sqrt(np.minimum(1.0, way / (0.2 * whole)))
    return ds_m, turn_rad, np.abs(ds_m) / speed


def end_pose(ds_m: np.ndarray, turn_rad: np.ndarray, lateral_m: np.ndarray | float = 0.0) -> np.ndarray:
    """End pose of exact arcs, by turning complex numbers."""
    before = np.cumsum(turn_rad) - turn_rad
    chord = ds_m * np.sinc(turn_rad / (2.0 * np.pi))
    place = np.sum((chord + 1j * np.asarray(lateral_m)) * np.exp(1j * (before + 0.5 * turn_rad)))
    return np.array([place.real, place.imag, np.sum(turn_rad)])


def campaign(
    runs: list[Run], *, vehicle: Vehicle | None = None, model: OdometryModel = MODEL, truth: Truth | None = None
) -> Campaign:
    """The campaign of runs in which the model is right but for what `truth` does; counts are not rounded."""
    n = len(runs)
    lengths = []
    columns: dict[str, list[np.ndarray]] = {
        name: [] for name in ("t_s", "counts_left", "counts_right", "counts_front", "steer_rad")
    }
    numbers: dict[str, np.ndarray] = {}
    extra = sorted({name for run in runs for name in run.numbers})
    known = ("load_left_N", "load_right_N", "speed_mps", "distance_m", "counts_left", "counts_right")
    for name in (*known, "ref_x_m", "ref_y_m", "ref_theta_rad", *extra):
        numbers[name] = np.full(n, np.nan)
    for i, run in enumerate(runs):
        now = motion_of(run)
        if truth is not None:
            truth(run, now)
        rad_left = model.radius_left_m + model.slope_left_m_per_N * (run.load_left_N - model.reference_load_N)
        rad_right = model.radius_right_m + model.slope_right_m_per_N * (run.load_right_N - model.reference_load_N)
        per = COUNTS / (2 * np.pi)
        # what the wheels roll: the true way and turn less what no wheel sees
        rolled, half = now.ds_m - now.along_m, 0.5 * (now.turn_rad - now.yaw_rad) * model.track_m * (1.0 + now.track)
        left_roll = (rolled - half - now.left_m) / (rad_left * (1.0 + now.left))
        right_roll = (rolled + half - now.right_m) / (rad_right * (1.0 + now.right))
        if now.swapped:
            left_roll, right_roll = right_roll, left_roll
        left, right = (np.concatenate([[0.0], np.cumsum(roll)]) * per for roll in (left_roll, right_roll))
        steer = now.steer_rad + now.steer_error_rad
        front_way = now.ds_m / np.cos(now.steer_rad) * (1.0 + now.front)
        front = np.concatenate([[0.0], np.cumsum(front_way)]) / RADIUS_M * per
        if run.log:
            columns["t_s"].append(np.concatenate([[0.0], now.t_s]))
            columns["counts_left"].append(left)
            columns["counts_right"].append(right)
            columns["counts_front"].append(front if run.front else np.full(len(front), np.nan))
            padded = np.concatenate([steer[:1], 0.5 * (steer[1:] + steer[:-1]), steer[-1:]])
            columns["steer_rad"].append(padded if run.front else np.full(len(front), np.nan))
            lengths.append(len(left))
        else:
            lengths.append(0)
        x, y, theta = end_pose(now.ds_m, now.turn_rad, now.lateral_m)
        laser = abs(x) + now.laser_m
        x, y, theta = x + now.end_x_m, y + now.end_y_m, theta + now.end_rad
        row = {
            "load_left_N": run.load_left_N,
            "load_right_N": run.load_right_N,
            "speed_mps": run.speed_mps,
            "counts_left": left[-1],
            "counts_right": right[-1],
            "ref_x_m": x,
            "ref_y_m": y,
            "ref_theta_rad": theta,
            "distance_m": laser if run.kind.startswith("corridor") else np.nan,
            **run.numbers,
        }
        for name, value in row.items():
            numbers[name][i] = value
    return Campaign(
        root=None,
        name="made",
        simulated=True,
        vehicle=vehicle or Vehicle(track_m=TRACK_M, wheelbase_m=WHEELBASE_M),
        encoder=Encoder(COUNTS, COUNTS),
        model=model,
        rangefinder=Rangefinder(),
        reference=Reference(),
        runs=RunTable(
            labels={
                "run_id": np.array([f"r{i:03d}" for i in range(n)]),
                "session": np.array([run.session for run in runs]),
                "kind": np.array([run.kind for run in runs]),
                "direction": np.array([run.direction for run in runs]),
            },
            numbers=numbers,
            excluded=np.zeros(n, dtype=bool),
            line=np.arange(n) + 2,
        ),
        logs=Logs(
            offsets=np.concatenate(([0], np.cumsum(lengths))).astype(np.int64),
            columns={name: np.concatenate(parts) for name, parts in columns.items() if parts},
        ),
    )


def situation(runs: list[Run], **settings: object) -> Observations:
    """The campaign as the diagnosis sees it."""
    return observations_of(campaign(runs, **settings))  # type: ignore[arg-type]


def gap(s: Observations, perturbations: list[Perturbation] | None = None) -> np.ndarray:
    """Measured less predicted under a hypothesis, shape (n_obs, 6); 0 where a channel was not measured."""
    return np.where(s.usable, s.measured - predict(s, perturbations).reading, 0.0)


def rich_runs() -> list[Run]:
    """Runs that vary everything: routes, loads, speeds, temperatures, sessions, directions, dwell, a column."""
    runs = []
    rng = np.random.default_rng(3)
    for i in range(24):
        pieces, kind = [(STRAIGHT, "corridor"), (ROUTE, "route_left"), (SQUARE, "square_ccw")][i % 3]
        if i % 6 == 5:
            pieces, kind = [(length, -kappa) for length, kappa in pieces], "square_cw"
        if i == 7:
            pieces = [(3.0, 0.0), (-2.0, 0.3), (4.0, 0.2)]
        payload = [0.0, 100.0, 200.0, 150.0][i // 3 % 4]
        share = 9.81 * payload / 2
        runs.append(
            Run(
                pieces,
                steps=400,
                speed_mps=[0.3, 0.6, 0.9][i // 2 % 3],
                session=f"s{1 + i // 8}",
                kind=kind,
                direction="back" if i % 2 else "out",
                load_left_N=300.0 + 0.6 * share,
                load_right_N=300.0 + 0.5 * share,
                log=i != 9,
                stops=i % 4 != 0,
                numbers={
                    "payload_kg": payload,
                    "payload_x_m": 0.3,
                    "payload_y_m": 0.02,
                    "temperature_C": float(rng.uniform(10, 30)),
                    "minutes_under_load": float(rng.uniform(0, 60)),
                    "humidity": float(rng.uniform(0.2, 0.8)),
                    "amplitude_m": 0.05,
                    "wavelength_m": 5.0,
                },
            )
        )
    return runs


def with_outside_simulator(made: Campaign, off_m: float = 0.01) -> Campaign:
    """The same campaign with an outside simulator's end poses, off by a constant."""
    numbers = dict(made.runs.numbers)
    numbers["sim_x_m"] = numbers["ref_x_m"] + off_m
    numbers["sim_y_m"] = numbers["ref_y_m"] - off_m
    numbers["sim_theta_rad"] = numbers["ref_theta_rad"].copy()
    numbers["sim_distance_m"] = numbers["distance_m"].copy()
    return replace(made, runs=replace(made.runs, numbers=numbers))


def noisy(truth: Truth, seed: int) -> Truth:
    """A truth, with the noise of the instruments and of the wheels."""
    rng = np.random.default_rng(seed)

    def both(run: Run, now: Motion) -> None:
        truth(run, now)
        now.end_x_m, now.end_y_m, now.end_rad = rng.normal(0.0, (XY_M, XY_M, HEADING_RAD))
        now.laser_m += rng.normal(0.0, LASER_M)
        now.yaw_rad = now.yaw_rad + rng.normal(0.0, 2e-4, len(now.ds_m)) * np.sqrt(np.abs(now.ds_m))

    return both


def turned(pieces: list[tuple[float, float]]) -> list[tuple[float, float]]:
    return [(length, -kappa) for length, kappa in pieces]


def loaded(n_runs: int = 24) -> list[Run]:
    """Squares either way and straights, three payloads in each session, twice each."""
    routes = [(SQUARE, "square_ccw"), (turned(SQUARE), "square_cw"), (STRAIGHT, "corridor")]
    runs = []
    for number in range(n_runs):
        pieces, kind = routes[number % 3]
        payload_kg = (0.0, 50.0, 100.0)[number // 3 % 3]
        load_N = 300.0 + 0.4 * 9.81 * payload_kg
        run = Run(pieces, kind=kind, load_left_N=load_N, load_right_N=load_N, session=f"s{1 + 2 * number // n_runs}")
        runs.append(replace(run, front=False, numbers={"payload_kg": payload_kg}))
    return runs
