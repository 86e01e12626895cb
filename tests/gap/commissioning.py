"""Campaigns as a commissioning engineer meets them: ``python -m tests.gap.commissioning [--each 1] [--seed 3]``.

A world of its own, which shares no code with the package: a warehouse AGV with a laser in the corridor and end poses on
routes, the same with few runs, the same by its steered front wheel alone, a robot driven by hand under motion capture,
and an Ackermann vehicle. Each has one fault, two or none, also such as no library has, at signals of 5 to 1000. A line
each says what the diagnosis named; the end counts what was right. ``--keep FOLDER`` leaves the campaigns there.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from tests.gap.commissioning_world import (
    LAW,
    REFERENCE_N,
    SITES,
    Array,
    Run,
    Site,
    Wrong,
    drive_all,
    loads_N,
    path_of,
    plan_runs,
    turned,
    write,
)

#: fault -> effects that answer it, the size to begin with, the sites where it is tried, and the printed parameter whose
#: value is the fault's size, where there is one
FAULTS: Final[dict[str, tuple[set[str], float, str, str]]] = {
    "radius": ({"radius_scale"}, 2e-3, "hall few lab front car", "relative"),
    "difference": ({"unequal_radii"}, 1e-3, "hall few lab", "relative"),
    "track": ({"track_width"}, 5e-3, "hall few lab", "relative"),
    "law": ({"load_radius", "load_radius_nonlinear"}, -1e-6, "hall", ""),
    "soft_law": ({"load_radius", "load_radius_nonlinear"}, -1e-6, "hall", ""),
    "payload_left_m": ({"payload_position"}, 0.05, "hall", "dy"),
    "light_label": ({"payload_mass"}, 0.2, "hall", ""),
    "temperature": ({"temperature_radius"}, 8e-5, "hall", "alpha"),
    "wear_per_km": ({"wear"}, -1e-3, "hall", ""),
    "new_wheel": ({"session_step"}, 1e-3, "hall", ""),
    "side_slip": ({"side_slip"}, 1e-2, "hall lab", ""),
    "scrub": ({"curve_scrub"}, 8e-3, "hall lab", ""),
    "lost_fast": ({"lost_counts"}, 5e-3, "hall", ""),
    "skid": ({"braking_skid"}, 3e-3, "hall", ""),
    "yaw": ({"reference_yaw"}, 5e-3, "hall few lab", "yaw"),
    "lever_x": ({"reference_lever_arm"}, 0.02, "hall few lab car", "lever_x"),
    "laser_scale": ({"rangefinder_scale", "beam_misalignment"}, 1e-3, "hall", ""),
    "laser_offset": ({"rangefinder_offset"}, 8e-3, "hall", "offset"),
    "drag": ({"rear_drag", "travel_direction", "floor_slope"}, 8e-4, "hall", ""),
    "slope": ({"travel_direction", "floor_slope", "rear_drag"}, 8e-4, "hall", ""),
    "transfer": ({"curve_load_transfer"}, -6e-6, "hall", ""),
    "late": ({"reference_latency"}, 0.05, "lab car", "latency"),
    "eccentric_m": ({"wheel_eccentricity"}, 3e-4, "lab", ""),
    "steer_zero": ({"steering_zero"}, 6e-3, "front car", "zero"),
    "steer_scale": ({"steering_scale"}, 1e-2, "front car", ""),
    "wheelbase": ({"steering_scale"}, 1e-2, "front car", ""),
    "steer_play": ({"steering_backlash"}, 8e-3, "front car", ""),
    "steer_late": ({"steering_delay"}, 0.08, "front car", "delay"),
    "understeer": ({"understeer"}, 1e-2, "front car", "per_speed_squared"),
    # in no library
    "caster": (set(), 3e-3, "hall lab", ""),
    "belt": (set(), 4e-3, "hall lab", ""),
    "reflector": (set(), 1e-2, "hall", ""),
    "one_bad_run": (set(), 3e-2, "hall few", ""),
    "joint": ({"floor_zone"}, 4e-3, "hall", ""),
    "left_only": (set(), 1e-2, "hall", ""),
    "warm_wheel": (set(), 1.5e-3, "hall", ""),  # radii off in the mean, too
}
SIGNALS: Final = (5.0, 10.0, 30.0, 100.0, 1000.0)
#: faults of one sign by their nature
ONE_SIGN: Final = {
    *("law", "soft_law", "side_slip", "scrub", "lost_fast", "skid", "wear_per_km", "transfer", "steer_play"),
    *("steer_late", "understeer", "late", "eccentric_m", "belt", "warm_wheel"),
}


def odometry(site: Site, run: Run, log: Mapping[str, Array]) -> Array:
    """Return the poses that the model computes from a log, shape (n_ticks + 1, 3)."""
    unit = 2.0 * np.pi / site.per_rev * site.radius_m
    if site.front:
        shaft = site.drive == "ackermann"
        way = unit * np.diff(log["counts_rear" if shaft else "counts_front"])
        delta = 0.5 * (log["steer_rad"][1:] + log["steer_rad"][:-1])
        ahead = way if shaft else way * np.cos(delta)
        return path_of(ahead, ahead * np.tan(delta) / site.wheelbase_m, np.zeros(len(way)))
    radius = np.full(2, site.radius_m)
    if not site.recorded:
        radius = radius + np.array(LAW) * (loads_N(run.payload_kg, 0.0) - REFERENCE_N)
    left, right = (
        2.0 * np.pi / site.per_rev * r * np.diff(log[f"counts_{side}"])
        for r, side in zip(radius, ("left", "right"), strict=True)
    )
    return path_of(0.5 * (left + right), (right - left) / site.track_m, np.zeros(len(left)))


def gap(site: Site, run: Run, log: Mapping[str, Array], reading: Array) -> Array:
    """Return measured less computed motion, shape (n_rows, n_channels): of a run, or of windows of four seconds."""
    path = odometry(site, run, log)
    if not site.recorded:
        return np.atleast_2d(reading - (path[-1, :1] if len(reading) == 1 else path[-1]))
    seen = np.flatnonzero(np.isfinite(log["ref_x_m"]))
    at = seen[np.unique(np.searchsorted(seen, np.arange(0, seen[-1], 200)))]
    seen_at = np.stack([log[name][at] for name in ("ref_x_m", "ref_y_m", "ref_theta_rad")], axis=1)

    def moved(pose: Array) -> Array:
        step = np.diff(pose, axis=0)
        return np.column_stack([turned(step[:, :2], -pose[:-1, 2]), step[:, 2]])

    return np.asarray(moved(seen_at) - moved(path[at]))


class Scale:
    """What a campaign's readings scatter by, so that faults can be made of a known signal."""

    def __init__(self, site: Site, runs: Sequence[Run], seed: int) -> None:
        self.site, self.runs, self.seed = site, runs, seed
        self.null = self.gaps({}, seed)
        draws = [self.gaps({}, seed + 1000 + k) for k in range(6)]
        self.whiten: dict[str, Array] = {}
        for kind in {run.kind for run in runs}:
            rows = np.concatenate(
                [
                    one - one.mean(axis=0)
                    for n, run in enumerate(runs)
                    if run.kind == kind
                    for one in [np.concatenate([draw[n] for draw in draws])]
                ]
            )
            self.whiten[kind] = np.linalg.inv(np.linalg.cholesky(np.cov(rows.T).reshape(rows.shape[1], -1) * 1.2))
        names = ["radius"] if site.front else ["radius", "difference", "track"]
        sizes = {"radius": 1e-3, "difference": 1e-3, "track": 1e-3}
        self.calibration = np.stack([self.white({name: sizes[name]}) for name in names], axis=1)

    def gaps(self, wrong: Wrong, seed: int) -> list[Array]:
        """Return the gap of each run."""
        return [gap(self.site, *driven) for driven in drive_all(self.site, self.runs, wrong, seed)]

    def white(self, wrong: Wrong) -> Array:
        """Return what faults change, in units of the noise."""
        changed = [one - none for one, none in zip(self.gaps(wrong, self.seed), self.null, strict=True)]
        return np.concatenate(
            [(self.whiten[run.kind] @ one.T).ravel() for run, one in zip(self.runs, changed, strict=True)]
        )

    def signal(self, wrong: Wrong) -> float:
        """Return the signal of faults; of other faults than radii and track what a recalibration leaves."""
        white = self.white(wrong)
        if not set(wrong) & {"radius", "difference", "track"}:
            white = white - self.calibration @ np.linalg.lstsq(self.calibration, white, rcond=None)[0]
        return float(np.linalg.norm(white))

    def sized(self, name: str, wanted: float, sign: float) -> float | None:
        """Return the size at which a fault has a signal; None where these runs cannot show it."""
        size = sign * FAULTS[name][1]
        for _ in range(3):
            signal = self.signal({name: size})
            if signal < 0.3:
                return None
            size *= wanted / signal
        return size


def cases(each: int, pairs: int, seed: int) -> Iterator[tuple[str, dict[str, float], int]]:
    """Yield site, faults with their signals, and seed."""
    number = seed * 10_000
    for name in SITES:
        for _ in range(2 * each):
            number += 1
            yield name, {}, number
        fitting = [fault for fault, (*_, where, _) in FAULTS.items() if name in where.split()]
        for k in range(each):
            for j, fault in enumerate(fitting):
                number += 1
                yield name, {fault: SIGNALS[(j + 2 * k + seed) % len(SIGNALS)]}, number
        rng = np.random.default_rng(seed)
        inside = [fault for fault in fitting if FAULTS[fault][0]]
        for _ in range(pairs if name in ("hall", "lab", "car") else 0):
            number += 1
            one, other = rng.choice(inside, 2, replace=False)
            yield (
                name,
                {str(one): float(rng.choice([10, 30, 100])), str(other): float(rng.choice([10, 30, 100]))},
                number,
            )


@dataclass(frozen=True)
class Outcome:
    """What a diagnosis said of a case."""

    line: str
    marks: tuple[str, ...]


def judge(site: Site, faults: Mapping[str, float], sizes: Mapping[str, float], found: Any) -> Outcome:
    """Compare a diagnosis with the faults."""
    document = found.to_dict()
    verdict, named = document["verdict"], [cause["effect"] for cause in document["causes"]]
    # forms of one family that these runs leave open are no wrong answer
    groups = [*document["indistinguishable"], *([c["effect"], *c["forms_open"]] for c in document["causes"])]
    answers = [FAULTS[fault][0] for fault in faults]
    true = set().union(*answers) if answers else set()

    def answered(effects: set[str]) -> bool:
        reached = set(named).union(*[group for group in groups if set(group) & set(named)])
        return bool(effects & reached)

    marks = []
    right = bool(answers) and all(answers) and all(map(answered, answers))
    corrected = document["fix"]["corrects"] or named
    wrong = [name for name in corrected if name not in true]
    wrong = [name for name in wrong if not any(name in group and set(group) & true for group in groups)]
    if not faults:
        marks.append("quiet" if verdict == "no_gap" else "FALSE ALARM")
    elif not all(answers):
        marks.append("outside")
        if verdict == "no_gap" and max(faults.values()) >= 10:
            marks.append("NO GAP")
    elif verdict == "no_gap":
        marks.append("NO GAP" if max(faults.values()) >= 10 else "unseen")
    else:
        marks.append("right" if right else "MISSED")
        if named and len(faults) == 1:
            marks.append(
                "first" if named[0] in true or any(named[0] in g and set(g) & true for g in groups) else "NOT FIRST"
            )
    if document["recommended"]:
        marks.append("WRONG FIX" if wrong else "fix")
    held = []
    for cause in document["causes"]:
        for fault in faults:
            if cause["effect"] in FAULTS[fault][0] and FAULTS[fault][3] in cause["parameters"]:
                low, high = cause["parameters"][FAULTS[fault][3]]["ci95"]
                value = sizes[fault] if low * sizes[fault] + high * sizes[fault] >= 0.0 else -sizes[fault]
                held.append(
                    "holds" if low <= value <= high else f"INTERVAL {low:.4g}..{high:.4g} of {sizes[fault]:.4g}"
                )
    marks += held
    probable = " ".join(f"{cause['effect']}:{cause['probability']:.2f}" for cause in document["causes"])
    said = " ".join(f"{fault}@{signal:g}({sizes[fault]:.3g})" for fault, signal in faults.items()) or "none"
    tied = " ".join("|".join(group) for group in document["indistinguishable"])
    return Outcome(f"{site.name:5} {said:44} {verdict:16} {probable} [{tied}] {' '.join(marks)}", tuple(marks))


def diagnosed(name: str, faults: Mapping[str, float], seed: int, folder: Path) -> Outcome | None:
    """Write a case and diagnose it; None where these runs cannot show a fault."""
    import calib

    rng = np.random.default_rng(seed)
    site = SITES[name]
    runs = plan_runs(site, rng)
    sizes: dict[str, float] = {}
    if faults:
        scale = Scale(site, runs, seed)
        for fault, signal in faults.items():
            sign = 1.0 if fault in ONE_SIGN or rng.random() < 0.5 else -1.0
            size = scale.sized(fault, signal, sign)
            if size is None:
                return None
            sizes[fault] = size
    write(folder, site, drive_all(site, runs, sizes, seed))
    return judge(site, faults, sizes, calib.diagnose(calib.read(folder)))


def main() -> None:
    """Drive, diagnose and count."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--each", type=int, default=1)
    parser.add_argument("--pairs", type=int, default=6)
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--site", choices=SITES)
    parser.add_argument("--only", help="a fault")
    parser.add_argument("--keep", type=Path)
    arguments = parser.parse_args()
    counted: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as temporary:
        root = arguments.keep or Path(temporary)
        for number, (name, faults, seed) in enumerate(cases(arguments.each, arguments.pairs, arguments.seed)):
            if arguments.site not in (None, name) or (arguments.only and arguments.only not in faults):
                continue
            outcome = diagnosed(name, faults, seed, root / f"c{number:03d}_{name}_{'_'.join(faults) or 'none'}")
            if outcome is None:
                continue
            sys.stdout.write(f"c{number:03d} {outcome.line}\n")
            sys.stdout.flush()
            counted.update(mark.split()[0] if mark.startswith("INTERVAL") else mark for mark in outcome.marks)
    sys.stdout.write("".join(f"{mark}: {count}\n" for mark, count in sorted(counted.items())))


if __name__ == "__main__":
    main()
