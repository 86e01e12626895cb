"""A differential drive, a tricycle, a car and a mecanum in numpy, written as campaign folders: no code of calib."""

from __future__ import annotations

import csv
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

COUNTS_PER_REV: Final = 4096.0
#: what the campaign states, and what the vehicle has
NOMINAL_RADIUS_M: Final = 0.05
NOMINAL_TRACK_M: Final = 0.30
RADIUS_LEFT_M: Final = 0.0502
RADIUS_RIGHT_M: Final = 0.0501
TRACK_M: Final = 0.303
WHEELBASE_M: Final = 0.40
#: half the length plus half the width of the mecanum, as stated and as it is
NOMINAL_ARM_M, ARM_M = 0.36, 0.3636
#: noise of the reference, and of each wheel's radius from run to run (relative)
SIGMA_XY_M: Final = 0.002
SIGMA_THETA_RAD: Final = 0.001
SIGMA_RADIUS: Final = 2e-4
RATE_HZ: Final = 20.0
SPEED_MPS: Final = 0.4
#: a steering angle is logged at the beginning of the step that it is driven with: half a step before its middle
STEERING_DELAY_S: Final = -0.5 / RATE_HZ


@dataclass
class Run:
    """One run: its log (columns of equal length) and its end pose."""

    run_id: str
    kind: str
    log: dict[str, Array]
    end: Array  #: x, y, theta of the reference at the end

    def copy(self) -> Run:
        """Return a run of its own arrays."""
        return replace(self, log={name: column.copy() for name, column in self.log.items()}, end=self.end.copy())


@dataclass
class Recording:
    """A set of runs with the settings that go into ``campaign.toml``."""

    runs: list[Run]
    drive: str = "differential"
    settings: dict[str, dict[str, object]] = field(default_factory=dict)

    def copy(self) -> Recording:
        """Return a recording whose arrays can be altered."""
        settings = {section: dict(keys) for section, keys in self.settings.items()}
        return Recording([run.copy() for run in self.runs], self.drive, settings)


#: kind -> (speed factor, curvature 1/m, duration s) of each piece
ROUTES: Final[dict[str, tuple[tuple[float, float, float], ...]]] = {
    "line": ((1.0, 0.0, 12.0),),
    "square_ccw": ((1.0, 0.0, 5.0), (0.0, 1.0, 2.6)) * 4,
    "square_cw": ((1.0, 0.0, 5.0), (0.0, -1.0, 2.6)) * 4,
    "circle_ccw": ((1.0, 1.0, 16.0),),
    "circle_cw": ((1.0, -1.0, 16.0),),
    "eight": ((1.0, 0.8, 20.0), (1.0, -0.8, 20.0)),
    # each curvature is reached from either side
    "winding": tuple((1.0, curvature, 4.0) for curvature in (0.3, 0.9, 0.3, -0.3, -0.9, -0.3)),
}
#: routes of a vehicle that turns on the spot
FREE: Final = ("line", "square_ccw", "square_cw", "circle_ccw", "circle_cw", "eight")


def _velocities(kind: str) -> tuple[Array, Array]:
    """Return speed and turn rate at each sample; speed 0 is a turn on the spot."""
    v, w = [], []
    for factor, curvature, seconds in ROUTES[kind]:
        n = round(seconds * RATE_HZ)
        v.append(np.full(n, factor * SPEED_MPS))
        w.append(np.full(n, curvature * (SPEED_MPS if factor else 0.6)))
    smooth = np.hanning(9) / np.hanning(9).sum()
    return (np.convolve(np.concatenate(part), smooth, mode="full") for part in (v, w))  # type: ignore[return-value]


def _path(v: Array, w: Array) -> Array:
    """Return poses (n + 1, 3) by fine integration of speed and turn rate."""
    dt, fine = 1.0 / RATE_HZ, 20
    theta = np.concatenate([[0.0], np.cumsum(np.repeat(w, fine)) * dt / fine])
    middle = 0.5 * (theta[1:] + theta[:-1])
    speed = np.repeat(v, fine)
    x = np.concatenate([[0.0], np.cumsum(speed * np.cos(middle)) * dt / fine])
    y = np.concatenate([[0.0], np.cumsum(speed * np.sin(middle)) * dt / fine])
    return np.stack([x, y, theta], axis=1)[::fine]


def _measured(path: Array, rng: np.random.Generator) -> Array:
    noise = rng.normal(0.0, (SIGMA_XY_M, SIGMA_XY_M, SIGMA_THETA_RAD), path.shape)
    noise[0] = 0.0
    return path + noise


def differential(rng: np.random.Generator, repeats: int = 3, kinds: tuple[str, ...] = FREE) -> Recording:
    """Return runs of a differential drive: counts of both wheels and the reference along the path."""
    runs = []
    for repeat in range(repeats):
        for kind in kinds:
            v, w = _velocities(kind)
            scatter = 1.0 + rng.normal(0.0, SIGMA_RADIUS, 2)
            left = (v - 0.5 * TRACK_M * w) / (RADIUS_LEFT_M * scatter[0])
            right = (v + 0.5 * TRACK_M * w) / (RADIUS_RIGHT_M * scatter[1])
            ref = _measured(_path(v, w), rng)
            log = {"t_s": np.arange(len(ref)) / RATE_HZ}
            log["counts_left"], log["counts_right"] = _counted(left), _counted(right)
            log |= dict(zip(("ref_x_m", "ref_y_m", "ref_theta_rad"), ref.T, strict=True))
            runs.append(Run(f"{kind}_{repeat}", kind, log, ref[-1]))
    return Recording(runs, "differential", _settings("differential"))


#: routes of a vehicle that cannot turn on the spot
DRIVEN: Final = ("line", "circle_ccw", "circle_cw", "eight", "winding")


def tricycle(rng: np.random.Generator, repeats: int = 3) -> Recording:
    """Return runs of a tricycle whose odometry has the front wheel's counts and its steering angle."""
    return _steered(rng, repeats, "tricycle", "counts_front")


def ackermann(rng: np.random.Generator, repeats: int = 3) -> Recording:
    """Return runs of a car whose odometry has the drive shaft's counts and the steering angle."""
    return _steered(rng, repeats, "ackermann", "counts_rear")


def _steered(rng: np.random.Generator, repeats: int, drive: str, column: str) -> Recording:
    runs = []
    for repeat in range(repeats):
        for kind in DRIVEN:
            v, w = _velocities(kind)
            steer = np.arctan2(WHEELBASE_M * w, np.maximum(v, 1e-9)) * (v > 1e-6)
            rolled = np.hypot(v, WHEELBASE_M * w) if column == "counts_front" else v
            rate = rolled / (RADIUS_LEFT_M * (1.0 + rng.normal(0.0, SIGMA_RADIUS)))
            ref = _measured(_path(v, w), rng)
            log = {
                "t_s": np.arange(len(ref)) / RATE_HZ,
                column: _counted(rate),
                "steer_rad": np.append(steer, steer[-1]),
            }
            log |= dict(zip(("ref_x_m", "ref_y_m", "ref_theta_rad"), ref.T, strict=True))
            runs.append(Run(f"{kind}_{repeat}", kind, log, ref[-1]))
    return Recording(runs, drive, _settings(drive))


def mecanum(rng: np.random.Generator, repeats: int = 3) -> Recording:
    """Return runs of four mecanum wheels of one radius, with turns on the spot."""
    runs = []
    for repeat in range(repeats):
        for kind in FREE:
            v, w = _velocities(kind)
            radius = RADIUS_LEFT_M * (1.0 + rng.normal(0.0, SIGMA_RADIUS))
            ref = _measured(_path(v, w), rng)
            log = {"t_s": np.arange(len(ref)) / RATE_HZ}
            for side, sign in (("left", -1.0), ("right", 1.0)):
                for end in ("front", "rear"):
                    log[f"counts_{end}_{side}"] = _counted((v + sign * ARM_M * w) / radius)
            log |= dict(zip(("ref_x_m", "ref_y_m", "ref_theta_rad"), ref.T, strict=True))
            runs.append(Run(f"{kind}_{repeat}", kind, log, ref[-1]))
    return Recording(runs, "mecanum", _settings("mecanum"))


def _counted(rate_radps: Array) -> Array:
    """Return the whole counts of an encoder by its rate of turning."""
    turns = np.concatenate([[0.0], np.cumsum(rate_radps)]) / RATE_HZ / (2 * np.pi)
    return np.round(turns * COUNTS_PER_REV)


def _settings(drive: str) -> dict[str, dict[str, object]]:
    vehicle = {"drive": drive, "track_m": NOMINAL_TRACK_M, "wheelbase_m": WHEELBASE_M, "mass_kg": 10.0}
    vehicle |= {"wheel_radius_m": NOMINAL_RADIUS_M, "front_wheel_radius_m": NOMINAL_RADIUS_M, "cog_x_m": 0.1}
    settings: dict[str, dict[str, object]] = {
        "vehicle": vehicle,
        "encoder": {"counts_per_rev": COUNTS_PER_REV, "counts_per_rev_front": COUNTS_PER_REV},
        "reference": {"sigma_xy_m": SIGMA_XY_M, "sigma_theta_rad": SIGMA_THETA_RAD},
    }
    if drive == "mecanum":
        vehicle["half_length_plus_half_width_m"] = NOMINAL_ARM_M
    source = {"tricycle": "front", "ackermann": "shaft"}.get(drive)
    if source is not None:
        settings["odometry"] = {"from": source}
    return settings


def _cell(name: str, value: float) -> str:
    """Return a number as a logger writes it: counts whole where they are."""
    return f"{int(value)}" if name.startswith("counts") and value == int(value) else f"{value:.9g}"


def write(recording: Recording, folder: Path, *, along: bool = True, heading: bool = True) -> Path:
    """Write a campaign folder; `along`: with the reference in the logs; `heading`: with its heading."""
    folder.mkdir(parents=True)
    (folder / "logs").mkdir()
    lines = ['format = "calib-campaign/1"', f'name = "{folder.name}"', "simulated = true"]
    for section, keys in recording.settings.items():
        lines.append(f"[{section}]")
        lines += [f"{key} = {value!r}".replace("'", '"') for key, value in keys.items()]
    (folder / "campaign.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    names = ["ref_x_m", "ref_y_m", *(["ref_theta_rad"] if heading else [])]
    with (folder / "runs.csv").open("w", newline="", encoding="utf-8") as stream:
        out = csv.writer(stream)
        totals = [name for name in ("counts_left", "counts_right") if name in recording.runs[0].log]
        out.writerow(["run_id", "session", "kind", *totals, *names, "log"])
        for run in recording.runs:
            ends = [_cell(name, run.log[name][-1]) for name in totals]
            out.writerow([run.run_id, "s1", run.kind, *ends, *run.end[: len(names)], f"logs/{run.run_id}.csv"])
    for run in recording.runs:
        columns = [name for name in run.log if along or not name.startswith("ref_")]
        columns = [name for name in columns if heading or name != "ref_theta_rad"]
        with (folder / "logs" / f"{run.run_id}.csv").open("w", newline="", encoding="utf-8") as stream:
            out = csv.writer(stream)
            out.writerow(columns)
            for row in zip(*(run.log[name] for name in columns), strict=True):
                out.writerow([_cell(name, value) for name, value in zip(columns, row, strict=True)])
    return folder
