"""Recordings of free drives with poses along the path, by a world that shares no code with the package.

``python -m tests.gap.free_drives [--each 2] [--scatter 5e-4] [--seed 72] [--positions]`` writes campaigns of six
recordings of 90 s of a differential robot, a tricycle and an Ackermann vehicle, with one effect or none, diagnoses them
and prints a line each. The wheels' radii scatter from recording to recording.
"""

from __future__ import annotations

import argparse
import csv
import sys
import tempfile
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
STEP_S: Final = 0.01
LOGGED_EVERY: Final = 5
RECORDINGS: Final = 6
LASTS_S: Final = 90.0
SIGMA: Final = 1.5e-3  # m and rad, of each pose
COUNTS: Final = 4096
#: wheelbase, track, radius in m, speed in m/s, curvature in 1/m, at most
SHAPE: Final = {
    "differential": (0.3, 0.3, 0.05, 0.4, 2.2),
    "tricycle": (0.8, 0.5, 0.1, 0.8, 0.8),
    "ackermann": (0.8, 0.5, 0.1, 0.8, 0.8),
}
#: drive -> effect -> range of its sizes; of either sign but for those of `POSITIVE`
EFFECTS: Final[dict[str, dict[str, tuple[float, float]]]] = {
    "differential": {
        "radius_scale": (3e-3, 1e-2), "unequal_radii": (2e-3, 1e-2), "track_width": (5e-3, 3e-2),
        "curve_scrub": (1e-2, 4e-2), "side_slip": (0.05, 0.2), "reference_latency": (0.03, 0.15),
        "reference_lever_arm": (0.03, 0.15),
    },
    "tricycle": {
        "radius_scale": (3e-3, 1e-2), "steering_zero": (3e-3, 1e-2), "steering_scale": (8e-3, 3e-2),
        "steering_delay": (0.03, 0.15), "steering_backlash": (8e-3, 3e-2), "understeer": (0.03, 0.1),
        "reference_latency": (0.03, 0.15), "reference_lever_arm": (0.05, 0.3),
    },
    "ackermann": {
        "radius_scale": (3e-3, 1e-2), "steering_zero": (3e-3, 1e-2), "steering_scale": (8e-3, 3e-2),
        "steering_delay": (0.03, 0.15), "understeer": (0.03, 0.1), "reference_lever_arm": (0.05, 0.3),
    },
}  # fmt: skip
POSITIVE: Final = {"curve_scrub", "side_slip", "understeer", "steering_backlash", "steering_delay", "reference_latency"}


def _driven(drive: str, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return speed and curvature at each step: pieces of some seconds, rates limited, a stand at both ends."""
    _, _, _, fastest, tightest = SHAPE[drive]
    n = int(LASTS_S / STEP_S)
    wanted = np.zeros((2, n))
    first, last = int(1.0 / STEP_S), n - int(1.5 / STEP_S)
    while first < last:
        behind = min(first + int(rng.uniform(2.5, 6.0) / STEP_S), last)
        wanted[0, first:behind] = 0.0 if rng.random() < 0.12 else rng.choice([0.5, 0.75, 1.0]) * fastest
        wanted[1, first:behind] = rng.choice([0.0, 0.0, 0.4, -0.4, 1.0, -1.0, 0.7, -0.7]) * tightest
        first = behind
    rate = np.array([0.5, 1.2 * tightest]) * STEP_S
    made = np.zeros((2, n))
    for k in range(1, n):
        made[:, k] = made[:, k - 1] + np.clip(wanted[:, k] - made[:, k - 1], -rate, rate)
    return made[0], made[1]


def _steered(drive: str, v: Array, k: Array, sizes: Mapping[str, float], scatter: float) -> dict[str, Array]:
    """Return the counter of the driven wheel or axle and the steering angle as logged."""

    def size(effect: str) -> float:
        return sizes.get(effect, 0.0)

    wheelbase, _, radius, _, _ = SHAPE[drive]
    time = np.arange(len(v) + 1) * STEP_S
    angle = np.arctan(wheelbase * k * (1.0 + size("understeer") * v**2))
    sensed = angle / (1.0 + size("steering_scale")) - size("steering_zero")
    moved = np.sign(np.diff(sensed, prepend=sensed[0]))
    # the motor, whose angle is logged, leads the wheel by half the play on the side of its last move
    last = np.maximum.accumulate(np.where(moved != 0.0, np.arange(len(moved)), 0))
    sensed = sensed + 0.5 * size("steering_backlash") * moved[last]
    steps = np.concatenate([sensed[:1], 0.5 * (sensed[1:] + sensed[:-1]), sensed[-1:]])
    way = v
    if drive == "tricycle":
        way = np.hypot(v, wheelbase * v * k) * np.cos(angle - np.arctan(wheelbase * k))
    turns = way / (radius * (1.0 + size("radius_scale")) * scatter) / (2 * np.pi)
    name = "counts_front" if drive == "tricycle" else "counts_rear"
    return {
        name: np.round(np.concatenate([[0.0], np.cumsum(turns)]) * STEP_S * COUNTS),
        "steer_rad": np.interp(time - size("steering_delay"), time, steps),
    }


def _two_wheels(v: Array, k: Array, sizes: Mapping[str, float], scatter: Array) -> dict[str, Array]:
    """Return the counters of both wheels of a differential robot."""

    def size(effect: str) -> float:
        return sizes.get(effect, 0.0)

    _, track, radius, _, _ = SHAPE["differential"]
    bend = np.minimum(np.abs(k), 3.0) / 3.0
    half = 0.5 * track * (1.0 + size("track_width")) * (1.0 + size("curve_scrub") * bend)
    columns = {}
    for side, sign, factor in (("left", -1.0, scatter[0]), ("right", 1.0, scatter[1])):
        effective = radius * (1.0 + size("radius_scale") + 0.5 * sign * size("unequal_radii")) * factor
        turns = np.cumsum((v + sign * v * k * half) / effective) * STEP_S / (2 * np.pi)
        columns[f"counts_{side}"] = np.round(np.concatenate([[0.0], turns]) * COUNTS)
    return columns


def _recording(drive: str, sizes: Mapping[str, float], scatter: float, rng: np.random.Generator) -> dict[str, Array]:
    """Return the columns of one log."""

    def size(effect: str) -> float:
        return sizes.get(effect, 0.0)

    v, k = _driven(drive, rng)
    n = len(v)
    time = np.arange(n + 1) * STEP_S
    walk = rng.normal(0.0, 2.5e-4, n) * np.sqrt(np.abs(v) * STEP_S)
    heading = np.concatenate([[0.0], np.cumsum(v * k * STEP_S + walk)])
    middle, aside = 0.5 * (heading[1:] + heading[:-1]), -size("side_slip") * v**2 * k
    way = np.cumsum((v + 1j * aside) * np.exp(1j * middle)) * STEP_S
    factors = 1.0 + rng.normal(0.0, scatter, 2)
    counted = _two_wheels(v, k, sizes, factors) if drive == "differential" else None
    columns = counted or _steered(drive, v, k, sizes, float(factors[0]))
    place = np.concatenate([[0.0], way]) + size("reference_lever_arm") * (1.0 + 0.3j) * np.exp(1j * heading)
    late = time - size("reference_latency")
    read = {"ref_x_m": place.real, "ref_y_m": place.imag, "ref_theta_rad": heading}
    poses = {name: np.interp(late, time, values) + rng.normal(0.0, SIGMA, n + 1) for name, values in read.items()}
    return {"t_s": time, **columns, **poses}


def write(
    folder: Path,
    drive: str,
    sizes: Mapping[str, float],
    scatter: float,
    rng: np.random.Generator,
    *,
    headings: bool = True,
) -> Path:
    """Write a campaign with effects of known sizes, and return its folder.

    `scatter` is the standard deviation of each radius from recording to recording, relative; without `headings` the
    reference is one of positions alone.
    """
    (folder / "logs").mkdir(parents=True)
    rows = ["run_id,session,kind,log"]
    for number in range(RECORDINGS):
        columns = _recording(drive, sizes, scatter, rng)
        if not headings:
            del columns["ref_theta_rad"]
        with (folder / "logs" / f"rec{number}.csv").open("w", newline="", encoding="utf-8") as file:
            table = csv.writer(file)
            table.writerow(columns)
            logged = [values[::LOGGED_EVERY].round(6).tolist() for values in columns.values()]
            table.writerows(zip(*logged, strict=True))
        rows.append(f"rec{number},d{number // 3},free,logs/rec{number}.csv")
    (folder / "runs.csv").write_text("\n".join(rows) + "\n", "utf-8")
    wheelbase, track, radius, _, _ = SHAPE[drive]
    front = 'counts_per_rev_front = 4096\n[odometry]\nfrom = "front"\n' if drive == "tricycle" else ""
    (folder / "campaign.toml").write_text(
        f'format = "calib-campaign/1"\nname = "{folder.name}"\nsimulated = true\n[vehicle]\ndrive = "{drive}"\n'
        f"track_m = {track}\nwheelbase_m = {wheelbase}\nwheel_radius_m = {radius}\nfront_wheel_radius_m = {radius}\n"
        f"mass_kg = 40.0\ncog_x_m = 0.2\n[encoder]\ncounts_per_rev = {COUNTS}\n{front}"
        f'[reference]\nsigma_xy_m = {SIGMA}\nsigma_theta_rad = {SIGMA}\nframe = "map"\n',
        "utf-8",
    )
    return folder


def main() -> None:
    """Print a line a campaign and the counts."""
    import calib

    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--each", type=int, default=2, help="campaigns of each drive and effect")
    parser.add_argument("--scatter", type=float, default=5e-4)
    parser.add_argument("--seed", type=int, default=72)
    parser.add_argument("--positions", action="store_true", help="a reference without headings")
    given = parser.parse_args()
    total: Counter[str] = Counter()
    drawn = [(d, e, number) for d in EFFECTS for e in ("", *EFFECTS[d]) for number in range(given.each)]
    for drive, effect, number in drawn:
        place = (list(EFFECTS).index(drive), ["", *EFFECTS[drive]].index(effect), number)
        rng = np.random.default_rng([given.seed, *place])
        low, high = np.log(EFFECTS[drive].get(effect, (1.0, 1.0)))
        size = float(np.exp(rng.uniform(low, high))) * (1.0 if effect in POSITIVE else float(rng.choice([-1.0, 1.0])))
        with tempfile.TemporaryDirectory() as folder:
            sizes, into = {effect: size} if effect else {}, Path(folder) / "free"
            campaign = write(into, drive, sizes, given.scatter, rng, headings=not given.positions)
            found = calib.diagnose(campaign).to_dict()
        named = [cause["effect"] for cause in found["causes"]]
        right = found["verdict"] == "no_gap" if not effect else named[:1] == [effect]
        group = "effect" if effect else "nothing"
        total.update({group: 1, f"{group}, right": right})
        total[f"{group}, right and recommended"] += bool(effect) and right and found["recommended"]
        total[f"{group}, another cause too"] += bool(set(named) - {effect})
        total[f"{group}, wrong fix"] += found["recommended"] and bool(set(named) - {effect})
        causes = " ".join(f"{cause['effect']} {cause['probability']:.2f}" for cause in found["causes"])
        fix = ", recommended" if found["recommended"] else ""
        sys.stdout.write(f"{drive:13s} {effect:20s} {size:+.2g} {found['verdict']}{fix}: {causes}\n")
        sys.stdout.flush()
    sys.stdout.write("".join(f"{name}: {count}\n" for name, count in sorted(total.items())))


if __name__ == "__main__":
    main()
