"""Routes with offsets of their own: ``python -m tests.gap.route_offsets [--of 16]``.

Places on a route take its runs off by the same millimetres and milliradians in any of its runs: no effect of
the library is at work. Of campaigns with few routes that turn: how many fixes are recommended. The vehicle is that of
`tests.gap.large_gaps`, which shares no code with the package.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final

import numpy as np

import calib
from calib.gap.diagnose import diagnose_in_full
from calib.types import FloatArray
from tests.gap import large_gaps

#: number of routes that turn -> kinds, a corridor that has no offset first
ROUTES: Final = {
    2: ("corridor", "square_ccw", "route_left"),
    3: ("corridor", "square_ccw", "square_cw", "route_left"),
    4: ("corridor", "square_ccw", "square_cw", "route_left", "route_right"),
}
#: spread of a route's own offset: along, lateral (m) and heading (rad)
OFFSET_SD: Final = (0.03, 0.03, 0.005)
N_RUNS: Final = 48
COLUMNS: Final = (
    "run_id,session,kind,payload_kg,payload_x_m,payload_y_m,load_left_N,load_right_N,speed_mps,temperature_C,"
    "counts_left,counts_right,ref_x_m,ref_y_m,ref_theta_rad,log"
)


def write(
    folder: Path,
    kinds: tuple[str, ...],
    seed: list[int],
    *,
    offset_sd: tuple[float, float, float] = OFFSET_SD,
    sizes: dict[str, float] | None = None,
    traced: bool = False,
    turned: float = 1.0,
) -> Path:
    """Drive a campaign and write its folder.

    Parameters
    ----------
    folder, kinds, seed
    offset_sd
        Of each route but the first.
    sizes
        Of effects that the reference of the run table has, by `large_gaps.read_poses`; none by default.
    traced
        Whether the logs have the poses of the rear axle, without offsets and these effects.
    turned
        Share of every turn that is driven.
    """
    rng = np.random.default_rng(seed)
    offsets = {kinds[0]: np.zeros(3)} | {kind: rng.standard_normal(3) * offset_sd for kind in kinds[1:]}
    (folder / "logs").mkdir(parents=True)
    case, rows = large_gaps.LargeGap(0, {}, paper=False), [COLUMNS]
    for run in range(N_RUNS):
        kind, speed = kinds[run % len(kinds)], (0.4, 0.7)[int(rng.integers(2))]
        payload_kg, place_x, place_y = ((0.0, 0.3, 0.0), (100.0, 0.3, 0.1))[(run // len(kinds)) % 2]
        loads, temperature = _loads_N(payload_kg, place_x, place_y), 20.0 + 2.0 * rng.standard_normal()
        way, turn = large_gaps.motion(kind, speed)
        turn = turn * turned
        path = large_gaps.path_of(way, turn)
        rolled = large_gaps.wheel_angles(way, turn, loads, temperature, case, 1.0, rng)
        counts = np.floor(rolled * large_gaps.COUNTS_PER_REV / (2 * np.pi) + rng.uniform(0, 1, 2))
        end = large_gaps.read_poses(path, sizes or {}, 0.0, rng)[-1] + offsets[kind]
        poses = [large_gaps.read_poses(path, {}, 0.0, rng)] * traced
        table = np.column_stack([large_gaps.STEP_S * np.arange(len(path)), counts - counts[0], *poses])
        name, more = f"r{run:03d}", ",ref_x_m,ref_y_m,ref_theta_rad" * traced
        header = f"t_s,counts_left,counts_right{more}"
        np.savetxt(folder / "logs" / f"{name}.csv", table, "%.6g", ",", header=header, comments="")
        load = (payload_kg, place_x, place_y, *loads.round(2), speed, round(temperature, 2))
        given = (
            name,
            f"s{2 * run // N_RUNS}",
            kind,
            *load,
            *(counts[-1] - counts[0]),
            *end.round(5),
            f"logs/{name}.csv",
        )
        rows.append(",".join(map(str, given)))
    (folder / "runs.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    (folder / "campaign.toml").write_text(large_gaps.CAMPAIGN, encoding="utf-8")
    return folder


def _loads_N(payload_kg: float, place_x: float, place_y: float) -> FloatArray:
    axle = 0.5 * large_gaps.GRAVITY_MPS2
    rear = axle * (large_gaps.MASS_KG * (1 - large_gaps.COG_X_M) + payload_kg * (1 - place_x))
    roll = payload_kg * place_y * large_gaps.GRAVITY_MPS2 / large_gaps.TRACK_M
    return np.array([rear + roll, rear - roll])


def verdict_of(number: int, n_routes: int) -> dict[str, Any]:
    """Make a campaign without an effect of the library and diagnose it."""
    with tempfile.TemporaryDirectory() as temporary:
        made = write(Path(temporary) / "campaign", ROUTES[n_routes], [5, number, n_routes])
        return diagnose_in_full(calib.read(made), plan=False).to_dict()


def main() -> None:
    """Print a line a number of routes."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--of", type=int, default=16, help="campaigns of each number of routes")
    given = parser.parse_args()
    sys.stdout.write("| routes that turn | recommended | named above even odds |\n|---|---|---|\n")
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        for n_routes in ROUTES:
            verdicts = list(pool.map(partial(verdict_of, n_routes=n_routes), range(given.of)))
            fixes = sum(bool(verdict["recommended"]) for verdict in verdicts)
            sure = sum(any(cause["probability"] > 0.5 for cause in verdict["causes"]) for verdict in verdicts)
            sys.stdout.write(f"| {n_routes} | {fixes} of {given.of} | {sure} of {given.of} |\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
