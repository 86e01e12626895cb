"""Campaigns by a script of its own: ``python -m tests.gap.workshop [--each 3] [--pairs 40] [--seed 11]``.

Shares no code with the package. An AGV with a known load law in a corridor and on mixed routes, and a small robot in a
lab, each with one known effect or two, are written as folders, diagnosed, and counted. Noise: the radius of each wheel
from run to run, a walk of the heading, Student's t (5) on what the instruments read.
"""

from __future__ import annotations

import argparse
import csv
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final

import numpy as np

Array = np.ndarray
QUARTER: Final = np.pi / 2
#: kind -> (length m, turn rad) of each piece
ROUTES: Final[dict[str, list[tuple[float, float]]]] = {
    "corridor": [(14.0, 0.0)],
    "corridor_long": [(28.0, 0.0)],
    "square_ccw": [(6.0, 0.0), (1.3, QUARTER)] * 4,
    "square_cw": [(6.0, 0.0), (1.3, -QUARTER)] * 4,
    "s_route": [(5.0, 0.0), (2.0, QUARTER), (4.0, 0.0), (2.6, -QUARTER), (5.0, 0.0), (1.6, -QUARTER / 2), (2.0, 0.0)],
    "line": [(3.0, 0.0)],
    "small_ccw": [(1.2, 0.0), (0.3, QUARTER)] * 4,
    "small_cw": [(1.2, 0.0), (0.3, -QUARTER)] * 4,
    "circle_ccw": [(2 * np.pi * 0.6, 2 * np.pi)],
    "circle_cw": [(2 * np.pi * 0.6, -2 * np.pi)],
    "eight": [(np.pi, 2 * np.pi), (np.pi, -2 * np.pi)],
}
#: design -> kinds, numbers of runs to draw from, speeds in m/s
DESIGNS: Final[dict[str, tuple[list[str], list[int], tuple[float, float]]]] = {
    "corridor": (["corridor", "corridor_long"], [36, 48, 60], (0.4, 0.8)),
    "mixed": (["corridor", "square_ccw", "corridor_long", "square_cw", "s_route"], [50, 70], (0.4, 0.8)),
    "lab": (["line", "small_ccw", "small_cw", "circle_ccw", "circle_cw", "eight"], [56], (0.15, 0.3)),
}
#: effect -> ids that answer it, range of its size by design; of either sign unless it is one of `POSITIVE`
EFFECTS: Final[dict[str, tuple[set[str], dict[str, tuple[float, float]]]]] = {
    "load_radius": (
        {"load_radius", "load_radius_nonlinear"},
        {"corridor": (0.4e-6, 1.5e-6), "mixed": (0.4e-6, 1.5e-6)},
    ),
    "radius_scale": ({"radius_scale"}, {"corridor": (1e-3, 5e-3), "mixed": (1e-3, 5e-3), "lab": (3e-3, 1e-2)}),
    "unequal_radii": ({"unequal_radii"}, {"corridor": (4e-4, 2e-3), "mixed": (4e-4, 2e-3), "lab": (2e-3, 8e-3)}),
    "track_width": ({"track_width"}, {"mixed": (3e-3, 1.5e-2), "lab": (8e-3, 3e-2)}),
    "temperature_radius": ({"temperature_radius"}, {"corridor": (4e-5, 1.5e-4), "mixed": (4e-5, 1.5e-4)}),
    "curve_scrub": ({"curve_scrub"}, {"mixed": (4e-3, 2e-2), "lab": (4e-3, 1.5e-2)}),
    "speed_radius": ({"speed_radius"}, {"corridor": (1e-3, 4e-3), "mixed": (1e-3, 4e-3)}),
    "rear_drag": ({"rear_drag"}, {"corridor": (5e-4, 2e-3), "mixed": (5e-4, 2e-3)}),
    "lost_counts": ({"lost_counts"}, {"corridor": (1e-3, 4e-3), "mixed": (1e-3, 4e-3), "lab": (1e-2, 3e-2)}),
    "side_slip": ({"side_slip"}, {"mixed": (1e-2, 3e-2)}),
    "curve_load_transfer": ({"curve_load_transfer"}, {"mixed": (4e-6, 1.2e-5)}),
    "payload_mass": ({"payload_mass"}, {"corridor": (0.1, 0.3), "mixed": (0.1, 0.3)}),
    "payload_position": ({"payload_position"}, {"corridor": (0.05, 0.12), "mixed": (0.05, 0.12)}),
    "reference_lever_arm": ({"reference_lever_arm"}, {"mixed": (1e-2, 5e-2), "lab": (8e-3, 3e-2)}),
    "reference_yaw": ({"reference_yaw"}, {"corridor": (2e-3, 8e-3), "mixed": (2e-3, 8e-3), "lab": (6e-3, 2e-2)}),
    "rangefinder_scale": (
        {"rangefinder_scale", "beam_misalignment"},
        {"corridor": (5e-4, 2e-3), "mixed": (5e-4, 2e-3)},
    ),
    "rangefinder_offset": ({"rangefinder_offset"}, {"corridor": (4e-3, 1.5e-2), "mixed": (4e-3, 1.5e-2)}),
}
POSITIVE: Final = {"side_slip", "curve_load_transfer", "curve_scrub", "lost_counts", "rangefinder_scale"}
#: what each session's left and right radius is off by, in sizes of a `session_step`
STEPS: Final = ((0.9, -0.4), (-1.1, 0.8), (0.3, -1.2))
STEP_S: Final = 0.005
#: slopes of the radii against load that the model knows, m/N, about 300 N
LAW: Final = (2.2e-6, 1.9e-6)
REFERENCE_N: Final = 300.0
G: Final = 9.81


@dataclass(frozen=True)
class Vehicle:
    """Radius, track, wheelbase, mass, centre of mass ahead of the axle and above the floor, sigma of position."""

    radius_m: float
    track_m: float
    wheelbase_m: float
    mass_kg: float
    ahead_m: float
    height_m: float
    drive: str
    sigma_m: float
    sigma_rad: float


AGV: Final = Vehicle(0.1, 0.7, 1.0, 100.0, 0.388, 0.4, "tricycle", 2e-3, 8e-4)
ROBOT: Final = Vehicle(0.033, 0.16, 0.1, 2.0, 0.01, 0.1, "differential", 1e-3, 1e-3)


@dataclass(frozen=True)
class Conditions:
    """What a run is driven under."""

    number: int
    kind: str
    session: int
    speed_mps: float
    payload_kg: float
    x_m: float
    y_m: float
    temperature_C: float
    back: bool


def _driven(kind: str, speed_mps: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return speed and turn rate at each fine step: ramps, curvature smoothed over a quarter second, a weave."""
    pieces = ROUTES[kind]
    whole, way, speed, speeds = sum(length for length, _ in pieces), 0.0, 0.0, []
    while way < whole - 1e-4:
        speed = min(speed + 0.35 * STEP_S, speed_mps, max(np.sqrt(max(0.7 * (whole - way), 0.0)), 0.01))
        way += speed * STEP_S
        speeds.append(speed)
    v = np.array(speeds) * whole / (np.sum(speeds) * STEP_S)
    edges = np.cumsum([length for length, _ in pieces])
    piece = np.minimum(np.searchsorted(edges, np.cumsum(v) * STEP_S), len(pieces) - 1)
    window = np.hanning(53)[1:-1]
    curvature = np.convolve(np.array([turn / length for length, turn in pieces])[piece], window / window.sum(), "same")
    weave = np.convolve(np.cumsum(rng.normal(0, 1, len(v) + 400)), np.ones(400) / 400, "valid")[: len(v)]
    weave -= weave.mean()
    bend = 4e-3 * np.gradient(weave / (np.abs(weave).max() + 1e-9)) / (v * STEP_S + 1e-4)
    return v, v * (curvature + bend)


def _loads_N(vehicle: Vehicle, payload_kg: float, x_m: float, y_m: float) -> tuple[float, float]:
    """Return the loads of the left and right rear wheel by the levers of the vehicle and its payload."""
    length = vehicle.wheelbase_m
    rear = G * (vehicle.mass_kg * (length - vehicle.ahead_m) + payload_kg * (length - x_m)) / length
    moment = G * payload_kg * y_m / vehicle.track_m
    return rear / 2 + moment, rear / 2 - moment


def _radii_m(vehicle: Vehicle, now: Conditions, sizes: Mapping[str, float], moved_N: Array) -> tuple[Array, Array]:
    """Return the effective radii of both wheels at each step; `moved_N` is what a turn moves from left to right."""

    def size(effect: str) -> float:
        return sizes.get(effect, 0.0)

    mass = now.payload_kg * (1.0 + size("payload_mass") * (now.payload_kg == 200.0))
    loads = _loads_N(vehicle, mass, now.x_m, now.y_m + size("payload_position") * (now.payload_kg > 0.0))
    radii = []
    for side, load in enumerate(loads):
        sign = (-1.0, 1.0)[side]
        radius = vehicle.radius_m - (LAW[side] * (load - REFERENCE_N) if vehicle is AGV else 0.0)
        # softer than linear
        radius -= size("load_radius") * REFERENCE_N * ((load / REFERENCE_N) ** 0.93 - 1.0)
        share = size("radius_scale") + 0.5 * sign * size("unequal_radii")
        share += size("temperature_radius") * (now.temperature_C - 20.0) + size("speed_radius") * (now.speed_mps - 0.5)
        share += size("rear_drag") * (side == 1 and not now.back)
        radii.append((radius - sign * size("curve_load_transfer") * moved_N) * (1.0 + share))
    return radii[0], radii[1]


def _run(
    vehicle: Vehicle, now: Conditions, sizes: Mapping[str, float], rng: np.random.Generator
) -> tuple[dict[str, Any], list[list[float]]]:
    """Return the row and the log of one run."""

    def size(effect: str) -> float:
        return sizes.get(effect, 0.0)

    v, omega = _driven(now.kind, now.speed_mps, rng)
    curvature = omega / np.maximum(v, 1e-6)
    mass = vehicle.mass_kg + now.payload_kg * (1.0 + size("payload_mass") * (now.payload_kg == 200.0))
    left_m, right_m = _radii_m(vehicle, now, sizes, mass * vehicle.height_m / vehicle.track_m * v * omega)
    bend = np.minimum(np.abs(curvature), 1.8 / vehicle.track_m)
    track = vehicle.track_m * (1.0 + size("track_width")) * (1.0 + size("curve_scrub") * bend)
    scatter = (1.0 + rng.normal(0, 1e-4, 2)) * (1.0 + size("session_step") * np.array(STEPS[now.session]))
    left_mps = v - omega * track / 2  # an encoder loses pulses by its own rate
    rates = (
        left_mps * (1.0 - size("lost_counts") * np.abs(left_mps) / 0.8) / left_m,
        (v + omega * track / 2) / right_m,
    )
    turns = [np.concatenate([[0.0], np.cumsum(rate / s)]) * STEP_S for rate, s in zip(rates, scatter, strict=True)]
    way = v * STEP_S
    theta = np.concatenate([[0.0], np.cumsum(omega * STEP_S + rng.normal(0, 3e-4, len(v)) * np.sqrt(way))])
    middle, aside = 0.5 * (theta[1:] + theta[:-1]), -size("side_slip") * v**2 * curvature * way
    x = float(np.sum(way * np.cos(middle) - aside * np.sin(middle)))
    y = float(np.sum(way * np.sin(middle) + aside * np.cos(middle)))
    end, turned = x + 1j * y, float(theta[-1])
    end += (np.exp(1j * turned) - 1.0) * size("reference_lever_arm") * (1.0 - 0.4j)
    end *= np.exp(1j * size("reference_yaw"))

    def read(value: float, sigma: float) -> float:
        return value + sigma * float(rng.standard_t(5)) / np.sqrt(5 / 3)

    at = np.unique(np.append(np.arange(0, len(theta), 20), len(theta) - 1))
    counts = [np.floor(turn[at] * 4096 / 2 / np.pi + 0.5) for turn in turns]
    loads = _loads_N(vehicle, now.payload_kg, now.x_m, now.y_m)
    row = {
        "run_id": f"q{now.number:03d}", "session": ("mon", "tue", "wed")[now.session], "kind": now.kind,
        "speed_mps": round(now.speed_mps, 3), "temperature_C": round(now.temperature_C, 1),
        "log": f"logs/q{now.number:03d}.csv", "counts_left": int(counts[0][-1]), "counts_right": int(counts[1][-1]),
        "ref_x_m": read(end.real, vehicle.sigma_m), "ref_y_m": read(end.imag, vehicle.sigma_m),
        "ref_theta_rad": read(turned, vehicle.sigma_rad),
    }  # fmt: skip
    if vehicle is AGV:
        row |= {"payload_kg": now.payload_kg, "payload_x_m": now.x_m, "payload_y_m": now.y_m}
        row |= {"load_left_N": round(loads[0], 1), "load_right_N": round(loads[1], 1)}
        row |= {"direction": "back" if now.back else "out", "distance_m": ""}
        if now.kind.startswith("corridor"):
            laser = x * (1.0 + size("rangefinder_scale")) + size("rangefinder_offset")
            row["distance_m"] = read(laser, 1.5e-3)
    return row, [[round(float(i) * STEP_S, 4), *each] for i, *each in zip(at, *counts, strict=True)]


def write(folder: Path, design: str, sizes: Mapping[str, float], rng: np.random.Generator) -> Path:
    """Write a campaign of a design with effects of known sizes, and return its folder."""
    kinds, numbers, speeds = DESIGNS[design]
    vehicle, n = ROBOT if design == "lab" else AGV, int(rng.choice(numbers))
    (folder / "logs").mkdir(parents=True)
    rows = []
    for number in range(n):
        turn, session = number // len(kinds), number * 3 // n
        payload = float(rng.choice([0.0, 100.0, 200.0])) if vehicle is AGV else 0.0
        now = Conditions(
            number, kinds[number % len(kinds)], session, speeds[turn % 2] * (1 + 0.02 * rng.standard_normal()), payload,
            (0.2, 0.35)[turn % 2], (0.0, 0.1, -0.1)[(turn + session) % 3] if payload else 0.0,
            15.0 + 6.0 * session + rng.normal() + 3 * np.sin(number), bool(rng.integers(2)),
        )  # fmt: skip
        row, log = _run(vehicle, now, sizes, rng)
        rows.append(row)
        with (folder / str(row["log"])).open("w", newline="", encoding="utf-8") as file:
            csv.writer(file).writerows([["t_s", "counts_left", "counts_right"], *log])
    with (folder / "runs.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, list(rows[0]))
        table.writeheader()
        table.writerows(rows)
    law = f"reference_load_N = {REFERENCE_N}\nslope_left_m_per_N = {-LAW[0]}\nslope_right_m_per_N = {-LAW[1]}\n"
    model = f"[model]\nradius_left_m = 0.1\nradius_right_m = 0.1\ntrack_m = 0.7\n{law}[rangefinder]\nsigma_m = 0.0015\n"
    (folder / "campaign.toml").write_text(
        f'format = "calib-campaign/1"\nname = "{folder.name}"\nsimulated = true\n[vehicle]\ndrive = "{vehicle.drive}"\n'
        f"track_m = {vehicle.track_m}\nwheelbase_m = {vehicle.wheelbase_m}\nwheel_radius_m = {vehicle.radius_m}\n"
        f"mass_kg = {vehicle.mass_kg}\ncog_x_m = {vehicle.ahead_m}\ncog_z_m = {vehicle.height_m}\n"
        f"[encoder]\ncounts_per_rev = 4096\n{model if vehicle is AGV else ''}"
        f"[reference]\nsigma_xy_m = {vehicle.sigma_m}\nsigma_theta_rad = {vehicle.sigma_rad}\n",
        "utf-8",
    )
    return folder


@dataclass(frozen=True)
class Case:
    """Effects of known sizes on a design; none: the model is right."""

    design: str
    sizes: Mapping[str, float]
    seed: tuple[int, ...]


def cases(each: int, pairs: int, seed: int) -> Iterator[Case]:
    """Yield `each` campaigns of each effect and design and of none, and pairs of effects drawn at random."""

    def sizes(effects: list[str], design: str, key: tuple[int, ...]) -> dict[str, float]:
        rng = np.random.default_rng(key)
        drawn = {}
        for effect in effects:
            low, high = np.log(EFFECTS[effect][1][design])
            sign = 1.0 if effect in POSITIVE else float(rng.choice([-1.0, 1.0]))
            drawn[effect] = sign * float(np.exp(rng.uniform(low, high)))
        return drawn

    for d, design in enumerate(DESIGNS):
        possible = [effect for effect, (_, designs) in EFFECTS.items() if design in designs]
        for number in range(each):
            yield Case(design, {}, (seed, d, 0, number, 1))
            for place, effect in enumerate(possible, 1):
                key = (seed, d, place, number)
                yield Case(design, sizes([effect], design, key), (*key, 1))
        for number in range(pairs // len(DESIGNS)):
            key = (seed, d, 99, number)
            both = list(np.random.default_rng((*key, 2)).choice(possible, 2, replace=False))
            yield Case(design, sizes(both, design, key), (*key, 1))


def judged(case: Case, place: str) -> tuple[str, Counter[str]]:
    """Diagnose a case, and return a line on it and what it counts."""
    from calib.campaign.read import read_campaign
    from calib.gap.diagnose import diagnose_in_full

    folder = Path(place) / "-".join(map(str, (case.design, *case.sizes, *case.seed)))
    found = diagnose_in_full(
        read_campaign(write(folder, case.design, case.sizes, np.random.default_rng(case.seed))), plan=False
    ).to_dict()
    named = [{cause["effect"], *cause["forms_open"]} for cause in found["causes"]]
    grouped = set().union(*map(set, found["indistinguishable"])) if found["indistinguishable"] else set()
    answers = [EFFECTS[effect][0] for effect in case.sizes]
    right = set().union(*answers) if answers else set()
    false = [one for one in named if not one & right and not (one & grouped and grouped & right)]
    group = ("nothing", "single", "pair")[len(case.sizes)]
    counts = Counter({group: 1})
    if not answers:
        counts[f"{group}, no gap"] += found["verdict"] == "no_gap"
    elif group == "single":
        counts[f"{group}, first"] += bool(named) and bool(named[0] & right)
    else:
        counts[f"{group}, both"] += all(any(one & (named_one | grouped) for named_one in named) for one in answers)
    counts[f"{group}, recommended"] += found["recommended"] and not false
    counts[f"{group}, another cause too"] += bool(false)
    counts[f"{group}, wrong fix"] += found["recommended"] and bool(false)
    sizes = " ".join(f"{effect} {size:+.2g}" for effect, size in case.sizes.items())
    causes = " ".join(f"{cause['effect']} {cause['probability']:.2f}" for cause in found["causes"])
    word = f"{found['verdict']}{', recommended' if found['recommended'] else ''}"
    return f"{case.design:9s} {sizes:44s} {word:30s} {causes}", counts


def main() -> None:
    """Print a line a case and the counts."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--each", type=int, default=3, help="campaigns of each effect and design")
    parser.add_argument("--pairs", type=int, default=40)
    parser.add_argument("--seed", type=int, default=11)
    given = parser.parse_args()
    total: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder, ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        for line, counts in pool.map(partial(judged, place=folder), cases(given.each, given.pairs, given.seed)):
            sys.stdout.write(f"{line}\n")
            sys.stdout.flush()
            total.update(counts)
    sys.stdout.write("".join(f"{name}: {count}\n" for name, count in sorted(total.items())))


if __name__ == "__main__":
    main()
