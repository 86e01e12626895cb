"""Coverage of the intervals over simulated campaigns: ``python -m tests.kinematics.coverage squares arcs windows``.

``gyro_alone`` and ``gyro_and_loops`` are campaigns without motion capture.

Each campaign draws its own geometry and noise: squares both ways and arcs with a random walk of the true heading, and
one long recording whose reference has noise that stays alike for seconds, as scan matching has. Printed for each
parameter: the share of campaigns whose 95 % interval holds the truth.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from calib.campaign.model import Campaign
from calib.kinematics.drives import GYRO_SCALE_STD
from calib.kinematics.estimate import estimate_geometry
from calib.kinematics.joint_fit import NOMINAL_STD
from tests.kinematics.campaigns import Leg, Truth, campaign, square
from tests.kinematics.unaided import Drive, Gyro, unaided

#: of the true heading, rad per root metre
WALK = 0.003
#: how long the reference's noise stays alike, in samples, and what part of its variance does
ALIKE, SHARE = 10.0, 0.8


def _truth(rng: np.random.Generator) -> Truth:
    # the mean radius is off by 1 %, neither more nor less: it is what closed paths leave open, and what the intervals
    # take for granted of the nominal value
    mean = 0.05 * (1.0 + NOMINAL_STD * rng.normal())
    half = 0.0035 * rng.normal()
    return Truth(mean * (1.0 - half), mean * (1.0 + half), 8.0 * mean * (1.0 + 0.02 * rng.normal()))


def squares(rng: np.random.Generator) -> tuple[Truth, Campaign]:
    """Twelve squares of each sense."""
    truth = _truth(rng)
    routes = [(f"square{sense}", square(2.0, sense)) for sense in (1, -1) for _ in range(12)]
    return truth, campaign(routes, truth, rng, walk=WALK)


def arcs(rng: np.random.Generator) -> tuple[Truth, Campaign]:
    """Twenty-four arcs of several radii, both ways."""
    truth = _truth(rng)
    routes = [(f"arc{turn:g}", [(3.0, turn)]) for turn in (-3.0, -1.5, 1.5, 3.0) for _ in range(6)]
    return truth, campaign(routes, truth, rng, walk=WALK)


def windows(rng: np.random.Generator) -> tuple[Truth, Campaign]:
    """One recording of 60 legs along the way, with a sensor off the axle and noise that stays alike.

    Legs of unlike lengths: turns that change at once just where windows of equal travel meet would bias the track.
    """
    truth = replace(_truth(rng), sensor=(0.1, 0.02, 0.05), delay_s=0.05)
    legs: list[Leg] = list(zip(rng.uniform(0.6, 1.4, 60), rng.uniform(-1.5, 1.5, 60), strict=True))
    made = campaign(
        [("free", legs)], truth, rng, sigma=(1e-4, 1e-4), walk=5e-4, along=True, duration_s=200.0, samples=2000
    )
    columns = dict(made.logs.columns)
    n = len(columns["t_s"])
    keep = np.exp(-1.0 / ALIKE)
    for name, size in (("ref_x_m", 0.003), ("ref_y_m", 0.003), ("ref_theta_rad", 0.002)):
        fresh = rng.normal(size=n)
        alike = np.empty(n)
        alike[0] = rng.normal()
        for at in range(1, n):
            alike[at] = keep * alike[at - 1] + np.sqrt(1.0 - keep**2) * fresh[at]
        noise = np.sqrt(SHARE) * alike + np.sqrt(1.0 - SHARE) * rng.normal(size=n)
        columns[name] = columns[name] + size * noise
    return truth, replace(made, logs=replace(made.logs, columns=columns))


def gyro_alone(rng: np.random.Generator) -> tuple[Truth, Campaign]:
    """Twelve free routes whose turn a gyro measured, six straights along a tape; its scale is off as its maker says."""
    return _unaided(rng, loops=0)


def gyro_and_loops(rng: np.random.Generator) -> tuple[Truth, Campaign]:
    """The same, and four squares of each sense that end on their mark: these tell the track from the gyro's scale."""
    return _unaided(rng, loops=4)


def _unaided(rng: np.random.Generator, loops: int) -> tuple[Truth, Campaign]:
    truth, gyro = _truth(rng), Gyro(scale=1.0 + GYRO_SCALE_STD * rng.normal())
    free: list[list[Leg]] = [[(rng.uniform(0.5, 1.5), rng.uniform(-1.5, 1.5)) for _ in range(8)] for _ in range(12)]
    runs = [Drive("free", legs, frozenset({"gyro"})) for legs in free]
    runs += [Drive("corridor", [(8.0, 0.0)], frozenset({"gyro", "tape"})) for _ in range(6)]
    runs += [
        Drive(f"square{sense}", square(2.0, sense), frozenset({"loop"})) for sense in (1, -1) for _ in range(loops)
    ]
    return truth, unaided(runs, truth, gyro, rng)


KINDS: dict[str, Callable[[np.random.Generator], tuple[Truth, Campaign]]] = {
    "squares": squares,
    "arcs": arcs,
    "windows": windows,
    "gyro_alone": gyro_alone,
    "gyro_and_loops": gyro_and_loops,
}


def held(kind: str, seed: int) -> dict[str, bool]:
    """Return for each parameter of one campaign whether its interval holds the truth."""
    truth, made = KINDS[kind](np.random.default_rng([seed, list(KINDS).index(kind)]))
    found = estimate_geometry(made)
    true = {name: getattr(truth, name) for name in ("radius_left_m", "radius_right_m", "track_m", "delay_s")}
    true |= dict(zip(("sensor_x_m", "sensor_y_m", "sensor_yaw_rad"), truth.sensor, strict=True))
    inside = {e.name: e.ci95[0] <= true[e.name] <= e.ci95[1] for e in found.estimates if e.name in true}
    if {"radius_left_m", "radius_right_m", "track_m"} <= set(inside):
        ratio = found.ratio("radius_right_m", "radius_left_m")
        wide = found.track_over_radius()
        mean = 0.5 * (truth.radius_left_m + truth.radius_right_m)
        inside["right over left"] = ratio.ci95[0] <= truth.radius_right_m / truth.radius_left_m <= ratio.ci95[1]
        inside["track over radius"] = wide.ci95[0] <= truth.track_m / mean <= wide.ci95[1]
    return inside


def coverage(kind: str, n: int, first: int = 0) -> dict[str, tuple[float, int]]:
    """Return the share of `n` campaigns whose interval holds the truth, by parameter, and how many had one."""
    counts: dict[str, list[bool]] = defaultdict(list)
    for seed in range(first, first + n):
        for name, inside in held(kind, seed).items():
            counts[name].append(inside)
    return {name: (float(np.mean(values)), len(values)) for name, values in counts.items()}


if __name__ == "__main__":
    asked = [word for word in sys.argv[1:] if not word.isdigit()] or list(KINDS)
    size = next((int(word) for word in sys.argv[1:] if word.isdigit()), 1000)
    for wanted in asked:
        sys.stdout.write(f"{wanted}, {size} campaigns\n")
        for parameter, (share, number) in coverage(wanted, size).items():
            sys.stdout.write(f"  {parameter:20s} {100 * share:5.1f} % of {number}\n")
