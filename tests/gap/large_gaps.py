"""Gaps as a first simulation has them: ``python -m tests.gap.large_gaps [--of 60] [--seed 20]``.

A vehicle of a few lines of numpy, which shares no code with the package, is driven with one to three large effects at
work: radii and track off by up to 10 %, a load law missing, a delay of 0.3 s, the sensor anywhere on the vehicle. Of
each campaign: are all effects named (or one that cannot be told from them), is the gap closed, is the fix recommended.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

import calib
from calib.challenge.score import wilson
from calib.gap.diagnose import diagnose_in_full
from calib.types import FloatArray

TRACK_M, RADIUS_M, COUNTS_PER_REV, STEP_S = 0.70, 0.10, 4096.0, 0.1
MASS_KG, COG_X_M, WHEELBASE_M, GRAVITY_MPS2 = 100.0, 0.388, 1.0, 9.81
REFERENCE_LOAD_N, MEAN_TEMPERATURE_C = 300.0, 20.0
#: what a run scatters by: relative radius of each wheel, start heading, end pose, laser
RADIUS_SD, START_SD_RAD, REF_SD_M, REF_SD_RAD, LASER_SD_M = 1e-4, 5e-4, 2e-3, 7e-4, 1.5e-3
#: a gap counts as closed where at least this share of it is gone on runs held out
CLOSED = 0.9
#: smallest and largest size of each effect; the sign is drawn
SIZES = {
    "load_radius": (5e-7, 3e-6),
    "track_width": (0.01, 0.10),
    "radius_scale": (0.01, 0.10),
    "unequal_radii": (0.004, 0.03),
    "reference_lever_arm": (0.15, 1.0),
    "reference_latency": (0.1, 0.3),
    "reference_yaw": (0.02, 0.15),
    "temperature_radius": (1e-4, 4e-4),
    "curve_scrub": (0.02, 0.1),
}
ALWAYS_POSITIVE = ("reference_latency", "curve_scrub", "temperature_radius")
#: of effects drawn together none hides in another: both radii, or a load law and both radii, look alike
ALIKE = ({"radius_scale", "load_radius"}, {"unequal_radii", "reference_yaw"}, {"track_width", "curve_scrub"})


@dataclass(frozen=True, slots=True)
class LargeGap:
    """One campaign: its effects and their sizes."""

    number: int
    sizes: dict[str, float]
    paper: bool  #: the paper's own case, load law and track missing together


@dataclass(frozen=True, slots=True)
class Answer:
    """How a campaign was answered."""

    case: LargeGap
    verdict: str
    named: tuple[str, ...]
    signal: float
    closure: float
    all_named: bool
    nothing_else: bool  #: no cause is named that is neither at work nor a form or member of the group of one that is
    closed: bool
    recommended: bool
    why: tuple[str, ...]


def draw(number: int, seed: int) -> LargeGap:
    """Return the effects of a campaign; every sixth is the paper's own case."""
    rng = np.random.default_rng([seed, number, 0])
    if number % 6 == 0:
        return LargeGap(
            number, {"load_radius": -_size("load_radius", rng), "track_width": _size("track_width", rng)}, True
        )
    while True:
        chosen = {str(name) for name in rng.choice(list(SIZES), 1 + number % 3, replace=False)}
        if not any(len(chosen & pair) > 1 for pair in ALIKE):
            break
    sizes = {}
    for name in sorted(chosen):
        sign = 1.0 if name in ALWAYS_POSITIVE or rng.random() < 0.5 else -1.0
        sizes[name] = sign * _size(name, rng)
    return LargeGap(number, sizes, False)


def _size(name: str, rng: np.random.Generator) -> float:
    low, high = SIZES[name]
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def motion(kind: str, speed_mps: float) -> tuple[FloatArray, FloatArray]:
    """Return speed and yaw rate in each step of a route: stretches of (length, turn), with ramps of 0.5 m/s2."""
    corner = [(0.6 * np.pi / 2, np.pi / 2), (2.0, 0.0)]
    sign = -1.0 if kind.endswith(("cw", "right")) and not kind.endswith("ccw") else 1.0
    legs = {
        "corridor": [(20.0, 0.0)],
        "square_ccw": [(2.0, 0.0), *corner * 3, corner[0]],
        "square_cw": [(2.0, 0.0), *corner * 3, corner[0]],
        "route_left": [(4.0, 0.0), (1.5, 1.2), (3.0, 0.0), (2.5, -0.7), (2.0, 0.0), (1.2, 1.9), (1.0, 0.0)],
        "route_right": [(4.0, 0.0), (1.5, 1.2), (3.0, 0.0), (2.5, -0.7), (2.0, 0.0), (1.2, 1.9), (1.0, 0.0)],
    }[kind]
    ends = np.cumsum([0.0, *(length for length, _ in legs)])
    ramp_s, total = speed_mps / 0.5, ends[-1]
    cruise_s = total / speed_mps - ramp_s
    n_steps = int(np.ceil((cruise_s + 2 * ramp_s) / STEP_S)) + 5
    t = STEP_S * np.arange(n_steps + 1)
    up = np.clip(t, 0, ramp_s)
    down = np.clip(t - ramp_s - cruise_s, 0, ramp_s)
    way = 0.25 * up**2 + speed_mps * np.clip(t - ramp_s, 0, cruise_s) + speed_mps * down - 0.25 * down**2
    heading = np.interp(way, ends, np.cumsum([0.0, *(sign * turn for _, turn in legs)]))
    return np.diff(way), np.diff(heading)


def path_of(way: FloatArray, turn: FloatArray) -> FloatArray:
    """Return the pose (x, y, heading) at each time, shape (n_steps + 1, 3), by exact arcs."""
    heading = np.concatenate([[0.0], np.cumsum(turn)])
    middle, chord = 0.5 * (heading[1:] + heading[:-1]), way * np.sinc(turn / (2 * np.pi))
    x, y = np.cumsum(chord * np.cos(middle)), np.cumsum(chord * np.sin(middle))
    return np.column_stack([np.concatenate([[0.0], x]), np.concatenate([[0.0], y]), heading])


def read_poses(path: FloatArray, sizes: dict[str, float], bearing: float, rng: np.random.Generator) -> FloatArray:
    """Return what the reference reads along the way: late, at the sensor's place, turned, with noise."""
    t = STEP_S * np.arange(len(path))
    late = np.maximum(t - sizes.get("reference_latency", 0.0), 0.0)
    x, y, heading = (np.interp(late, t, values) for values in path.T)
    arm = abs(sizes.get("reference_lever_arm", 0.0))
    # on the vehicle: up to a metre ahead or behind, less to the sides
    ahead, aside = arm * np.cos(bearing), 0.4 * arm * np.sin(bearing)
    place = (x + 1j * y) + (np.exp(1j * heading) - 1.0) * (ahead + 1j * aside)
    start = START_SD_RAD * rng.standard_normal()
    yaw, heading = sizes.get("reference_yaw", 0.0) + start, heading + start
    place = place * np.exp(1j * yaw)
    noise = rng.standard_normal((len(path), 3)) * [REF_SD_M, REF_SD_M, REF_SD_RAD]
    noise[0] = 0.0
    return np.column_stack([place.real, place.imag, heading]) + noise


def write(case: LargeGap, seed: int, folder: Path) -> float:
    """Drive a campaign and write its folder; return the gap's signal, roughly: shift over scatter of the end poses."""
    rng = np.random.default_rng([seed, case.number, 1])
    kinds = ["corridor", "corridor", "square_ccw", "square_cw", "route_left", "route_right"]
    payloads = [(0.0, 0.3, 0.0), (100.0, 0.3, 0.15), (200.0, 0.3, 0.0), (150.0, 0.2, -0.2)]
    n_runs, n_sessions = int(rng.choice([48, 72, 96])), int(rng.choice([2, 3, 5]))
    bearing = float(rng.uniform(-np.pi, np.pi))
    slope_ratio = float(rng.uniform(0.85, 1.15))
    (folder / "logs").mkdir(parents=True)
    rows, shifts = [], []
    for run in range(n_runs):
        kind, (payload_kg, place_x, place_y) = kinds[run % 6], payloads[(run // 6) % 4]
        session, speed = run * n_sessions // n_runs, (0.4, 0.6, 0.8)[int(rng.integers(3))]
        temperature = MEAN_TEMPERATURE_C + 6 * np.cos(2.1 * session) + 2 * rng.standard_normal()
        rear = 0.5 * GRAVITY_MPS2 * (MASS_KG * (1 - COG_X_M) + payload_kg * (1 - place_x))
        roll = payload_kg * place_y * GRAVITY_MPS2 / TRACK_M
        loads = np.array([rear + roll, rear - roll])
        way, turn = motion(kind, speed)
        path = path_of(way, turn)
        rolled = wheel_angles(way, turn, loads, temperature, case, slope_ratio, rng)
        counts = np.floor(rolled * COUNTS_PER_REV / (2 * np.pi) + rng.uniform(0, 1, 2))
        poses = read_poses(path, case.sizes, bearing, rng)
        if "reference_latency" in case.sizes and rng.random() < 0.5:
            # read on the move, before it brakes
            last = int(np.flatnonzero(np.abs(way - way.max()) < 1e-9)[-1]) - int(rng.integers(3))
            path, counts, poses, way = path[: last + 1], counts[: last + 1], poses[: last + 1], way[:last]
        name = f"r{run:03d}"
        table = np.column_stack([STEP_S * np.arange(len(path)), counts - counts[0], poses])
        header = "t_s,counts_left,counts_right,ref_x_m,ref_y_m,ref_theta_rad"
        np.savetxt(folder / "logs" / f"{name}.csv", table, "%.6g", ",", header=header, comments="")
        distance = path[-1, 0] + LASER_SD_M * rng.standard_normal() if kind == "corridor" else np.nan
        end = [*(counts[-1] - counts[0]), *poses[-1].round(5), f"logs/{name}.csv"]
        load = [payload_kg, place_x, place_y, *loads.round(2), speed, round(temperature, 2)]
        rows.append([name, f"s{session}", kind, *load, "" if np.isnan(distance) else round(distance, 4), *end])
        believed = np.diff(counts, axis=0) * 2 * np.pi / COUNTS_PER_REV * RADIUS_M
        own = path_of(believed.mean(axis=1), (believed[:, 1] - believed[:, 0]) / TRACK_M)[-1]
        shifts.append((poses[-1] - own) / [REF_SD_M + 1e-4 * way.sum(), 0.01, 2 * START_SD_RAD])
    columns = "run_id,session,kind,payload_kg,payload_x_m,payload_y_m,load_left_N,load_right_N,speed_mps,temperature_C"
    columns += ",distance_m,counts_left,counts_right,ref_x_m,ref_y_m,ref_theta_rad,log"
    text = "\n".join([columns, *(",".join(map(str, row)) for row in rows)])
    (folder / "runs.csv").write_text(text + "\n", encoding="utf-8")
    (folder / "campaign.toml").write_text(CAMPAIGN, encoding="utf-8")
    return float(np.sqrt((np.array(shifts) ** 2).sum()))


def wheel_angles(
    way: FloatArray,
    turn: FloatArray,
    loads_N: FloatArray,
    temperature_C: float,
    case: LargeGap,
    slope_ratio: float,
    rng: np.random.Generator,
) -> FloatArray:
    """Return how far the left and the right wheel have rolled at each time, in radians, shape (n_steps + 1, 2)."""
    sizes = case.sizes
    with np.errstate(divide="ignore", invalid="ignore"):
        curvature = np.where(way > 1e-9, np.abs(turn) / way, 0.0)
    # the widening is relative per curvature, the track grows in turns
    track = TRACK_M * (1 + sizes.get("track_width", 0.0)) * (1 + sizes.get("curve_scrub", 0.0) * curvature)
    travel = np.column_stack([way - 0.5 * turn * track, way + 0.5 * turn * track])
    split = sizes.get("unequal_radii", 0.0)
    radii = RADIUS_M * (1 + sizes.get("radius_scale", 0.0)) * np.array([1 - 0.5 * split, 1 + 0.5 * split])
    radii = radii * (1 + sizes.get("temperature_radius", 0.0) * (temperature_C - MEAN_TEMPERATURE_C))
    radii = radii + sizes.get("load_radius", 0.0) * np.array([1.0, slope_ratio]) * (loads_N - REFERENCE_LOAD_N)
    radii = radii * (1 + RADIUS_SD * rng.standard_normal(2))
    return np.concatenate([np.zeros((1, 2)), np.cumsum(travel / radii, axis=0)])


CAMPAIGN = f"""format = "calib-campaign/1"
name = "large gap"
simulated = true
[vehicle]
track_m = {TRACK_M}
wheelbase_m = {WHEELBASE_M}
wheel_radius_m = {RADIUS_M}
mass_kg = {MASS_KG}
cog_x_m = {COG_X_M}
[encoder]
counts_per_rev = {COUNTS_PER_REV}
[model]
radius_left_m = {RADIUS_M}
radius_right_m = {RADIUS_M}
track_m = {TRACK_M}
reference_load_N = {REFERENCE_LOAD_N}
[rangefinder]
sigma_m = {LASER_SD_M}
[reference]
sigma_xy_m = {REF_SD_M}
sigma_theta_rad = {REF_SD_RAD}
"""


def covered(effect: str, verdict: dict[str, Any]) -> bool:
    """Return whether an effect is named, or one that these runs cannot tell from it."""
    named = {cause["effect"] for cause in verdict["causes"]}
    forms = {form for cause in verdict["causes"] for form in cause.get("forms_open", ())}
    groups = [set(group) for group in verdict["indistinguishable"]]
    return effect in named | forms or any(effect in group and group & named for group in groups)


def belongs(cause: dict[str, Any], case: LargeGap, verdict: dict[str, Any]) -> bool:
    """Return whether a named cause is at work, or cannot be told from one that is."""
    alike = {cause["effect"], *cause.get("forms_open", ())}
    groups = [set(group) for group in verdict["indistinguishable"] if cause["effect"] in group]
    return not alike.union(*groups).isdisjoint(case.sizes)


def answer(number: int, seed: int) -> Answer:
    """Make a campaign, diagnose it, judge the answer."""
    case = draw(number, seed)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "campaign"
        signal = write(case, seed, folder)
        verdict = diagnose_in_full(calib.read(folder), plan=False).to_dict()
    closure = verdict["closure"]
    closed = float(closure["fraction"]) if closure and closure["fraction"] is not None else float("nan")
    return Answer(
        case=case,
        verdict=str(verdict["verdict"]),
        named=tuple(cause["effect"] for cause in verdict["causes"]),
        signal=signal,
        closure=closed,
        all_named=all(covered(effect, verdict) for effect in case.sizes),
        nothing_else=all(belongs(cause, case, verdict) for cause in verdict["causes"]),
        closed=closed >= CLOSED,
        recommended=bool(verdict["fix"]["recommended"]) if verdict["fix"] else False,
        why=tuple(verdict["fix"]["why"]) if verdict["fix"] else (),
    )


def table(answers: list[Answer]) -> str:
    """Return the table, campaign by campaign, and its totals."""
    lines = ["| n | effects | signal | verdict | named | closed | recommended |", "|---|---|---|---|---|---|---|"]
    for one in answers:
        effects = ", ".join(f"{name} {size:.3g}" for name, size in one.case.sizes.items())
        named = ", ".join(one.named) or "nothing"
        mark = "" if one.all_named and one.nothing_else else " (!)"
        lines.append(
            f"| {one.case.number} | {effects} | {one.signal:.0f} | {one.verdict} | {named}{mark} | {one.closure:.3f} "
            f"| {'yes' if one.recommended else 'no: ' + '; '.join(one.why)[:160]} |"
        )
    for label, hits in (
        ("all named", [one.all_named for one in answers]),
        ("nothing else named", [one.nothing_else for one in answers]),
        ("closed", [one.closed for one in answers]),
        ("recommended", [one.recommended for one in answers]),
    ):
        low, high = wilson(sum(hits), len(hits))
        lines.append(f"{label}: {sum(hits)} of {len(hits)} (95 %: {100 * low:.0f} to {100 * high:.0f})")
    return "\n".join(lines)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--of", type=int, default=60, help="campaigns")
    parser.add_argument("--seed", type=int, default=20)
    parser.add_argument("--only", type=int, nargs="*", help="these numbers alone")
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    numbers = given.only or range(given.of)
    with ProcessPoolExecutor(given.workers, mp_context=get_context("spawn")) as pool:
        answers = list(pool.map(partial(answer, seed=given.seed), numbers))
    sys.stdout.write(table(answers) + "\n")


if __name__ == "__main__":
    main()
