"""How far the estimated noise is from the true: ``python -m tests.gap.noise_bias [--draws 20] [--seed 7]``.

Runs scatter in five known ways. The true variance of each channel is that of 1,500 runs of each route whose every
parameter is known; the estimate is the mean over draws of a campaign. Printed: estimated over true variance, the mean
and the extremes over routes and channels.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import product
from multiprocessing import get_context

import numpy as np

from calib.gap.inference.noise import estimate_noise
from calib.gap.predict import predict, residuals
from calib.types import FloatArray
from tests.gap.effects.making import ROUTE, SQUARE, Motion, Run, situation

ROUTES = {
    "corridor": [(12.0, 0.0)],
    "square_ccw": SQUARE,
    "square_cw": [(length, -kappa) for length, kappa in SQUARE],
    "route_left": ROUTE,
}
DESIGNS = {
    "corridors": ["corridor"],
    "squares": ["square_ccw", "square_cw"],
    "mixed": ["corridor", "square_ccw", "square_cw", "route_left"],
    # few runs of one load and speed
    "varied": ["corridor", "square_ccw", "square_cw", "route_left"],
}
#: standard deviations as stated of the instruments; the scatter comes on top
LASER_M, XY_M, HEADING_RAD = 0.0015, 0.002, 0.0008
RADIUS, WALK_RAD, START_RAD, START_M, SESSION = 1.5e-4, 3e-4, 1e-3, 2e-3, 2e-4
SCATTERS = ("radius", "heading walk", "start pose", "session", "heavy tails")
RUNS = (20, 60, 200)
N_TRUE = 1500
CHANNELS = ("distance", "along", "lateral", "heading")


def runs_of(design: str, n_runs: int) -> list[Run]:
    """Return runs in turn over routes, three loads and two speeds, in sessions of a quarter of the campaign.

    Varied runs have one of five loads and four speeds, by chance: hardly two are alike.
    """
    kinds, runs = DESIGNS[design], []
    varied = np.random.default_rng(n_runs).random((n_runs, 2)) if design == "varied" else None
    for number in range(n_runs):
        kind, turn = kinds[number % len(kinds)], number // len(kinds)
        share, pace = (
            (turn % 3 / 2, float(turn // 3 % 2)) if varied is None else np.floor(varied[number] * (5, 4)) / (4, 3)
        )
        run = Run(
            ROUTES[kind],
            steps=60,
            kind=kind,
            session=f"s{4 * number // n_runs}",
            speed_mps=0.4 + 0.4 * float(pace),
            load_left_N=300.0 + 400.0 * float(share),
            load_right_N=300.0 + 360.0 * float(share),
        )
        run.front = False
        runs.append(run)
    return runs


def truth_of(scatter: str, rng: np.random.Generator) -> Callable[[Run, Motion], None]:
    """Return what happens to a run: the instruments' noise, and one kind of scatter."""
    sessions: dict[str, FloatArray] = {}

    def truth(run: Run, now: Motion) -> None:
        now.laser_m, now.end_x_m, now.end_y_m = rng.normal(0, [LASER_M, XY_M, XY_M])
        now.end_rad = rng.normal(0, HEADING_RAD)
        if scatter == "radius":
            now.left, now.right = RADIUS * rng.standard_normal(2)
        elif scatter == "heavy tails":
            # three degrees of freedom have a variance of 3
            now.left, now.right = RADIUS * rng.standard_t(3, 2) / np.sqrt(3)
        elif scatter == "session":
            now.left, now.right = sessions.setdefault(run.session, SESSION * rng.standard_normal(2))
        elif scatter == "heading walk":
            now.yaw_rad = WALK_RAD * np.sqrt(np.abs(now.ds_m)) * rng.standard_normal(len(now.ds_m))
        else:
            turned = START_RAD * rng.standard_normal()
            heading = np.cumsum(now.turn_rad) - 0.5 * now.turn_rad
            end = np.sum(now.ds_m * np.exp(1j * heading)) * np.expm1(1j * turned)
            now.end_x_m += end.real + START_M * rng.standard_normal()
            now.end_y_m += end.imag + START_M * rng.standard_normal()
            now.end_rad += turned

    return truth


def variances(design: str, n_runs: int, scatter: str, seed: list[int], *, estimated: bool) -> FloatArray:
    """Return the variance of each route and channel, estimated or that of the gap itself, shape (n_routes, 4)."""
    kinds = DESIGNS[design]
    observations = situation(runs_of(design, n_runs), truth=truth_of(scatter, np.random.default_rng(seed)))
    path = predict(observations)
    gap = residuals(path, path)
    if estimated:
        covariance = estimate_noise(path, gap).covariance
        square = np.where(observations.usable, np.diagonal(covariance, axis1=1, axis2=2), np.nan)
    else:
        exact = situation(runs_of(design, n_runs))
        # what is left with no scatter at all is rounding of the corners by steps, no noise
        clean = predict(exact)
        rounding = residuals(clean, clean)
        square = np.where(observations.usable, (gap - rounding) ** 2, np.nan)
    kind = np.arange(n_runs) % len(kinds)
    return np.array(
        [
            np.where(observations.usable[kind == k].any(axis=0), np.mean(square[kind == k], axis=0), np.nan)[:4]
            for k in range(len(kinds))
        ]
    )


def ratio(case: tuple[str, str, int], draws: int, seed: int, n_true: int = N_TRUE) -> FloatArray:
    """Return estimated over true variance of each route and channel of a design, shape (n_routes, 4)."""
    design, scatter, n_runs = case
    number = [list(DESIGNS).index(design), SCATTERS.index(scatter), n_runs]
    # many short sessions are so many draws of one
    parts = [
        variances(design, 40 * len(DESIGNS[design]), scatter, [seed, *number, 0, part], estimated=False)
        for part in range(n_true // 40 if scatter != "session" else 300)
    ]
    estimates = [variances(design, n_runs, scatter, [seed, *number, 1, k], estimated=True) for k in range(draws)]
    quotient: FloatArray = np.mean(estimates, axis=0) / np.mean(parts, axis=0)
    return quotient


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--runs", type=int, nargs="*", default=list(RUNS))
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    cases = list(product(DESIGNS, SCATTERS, given.runs))
    with ProcessPoolExecutor(given.workers, mp_context=get_context("spawn")) as pool:
        ratios = list(pool.map(partial(ratio, draws=given.draws, seed=given.seed), cases))
    lines = ["| design | scatter | runs | mean | least | most |", "|---|---|---|---|---|---|"]
    for (design, scatter, n_runs), values in zip(cases, ratios, strict=True):
        low, high = (
            np.unravel_index(np.nanargmin(values), values.shape),
            np.unravel_index(np.nanargmax(values), values.shape),
        )
        lines.append(
            f"| {design} | {scatter} | {n_runs} | {np.exp(np.nanmean(np.log(values))):.2f} "
            f"| {values[low]:.2f} {CHANNELS[low[1]]} | {values[high]:.2f} {CHANNELS[high[1]]} |"
        )
    sys.stdout.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
