"""Whether intervals of a simulator's parameters hold the truth.

``python -m tests.gap.simulator.coverage [CAMPAIGNS [REPEATS]]``: three changes hidden in the numpy simulator,
CAMPAIGNS (100) of 8 REPEATS (2) runs each, in five realities: without random walks of distance and heading, with
small and with larger ones, and with radii that step between the two sessions, too. The simulator repeats itself.
Printed are the campaigns whose 95 % interval has the truth, and the root mean square of the errors over the half
widths (0.51 where intervals are exact) with their mean.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Mapping
from itertools import product
from pathlib import Path
from unittest.mock import patch

import numpy as np

from calib.campaign.model import Campaign
from calib.campaign.read import read_campaign
from calib.gap.simulator import read_settings
from calib.gap.simulator.diagnose import diagnose_simulator
from calib.gap.simulator.runner import Job, SimulatorRunner
from tests.gap.effects.making import campaign
from tests.gap.simulator.made import NOMINAL, numpy_ends, numpy_settings, on_disk, runs
from tests.gap.simulator.noisy import CHANGES

#: growth of distance (m) and heading (rad) a root metre, and the scatter of each radius between sessions
WALKS = {
    "no walks": (0.0, 0.0, 0.0),
    "small walks": (2e-4, 1.5e-4, 0.0),
    "walks": (4e-4, 3e-4, 0.0),
    "small walks, steps": (2e-4, 1.5e-4, 3e-5),
    "small walks, large steps": (2e-4, 1.5e-4, 1e-4),
}
WHEELS = ("left", "right")
RAD_PER_COUNT = 2 * np.pi / 4096


def walked(
    made: Campaign, hidden: Mapping[str, float], walk: tuple[float, float, float], rng: np.random.Generator
) -> np.ndarray:
    """Return where the runs end, (n_runs, 4), in the example's simulator with hidden parameters and random walks."""
    p, ends = NOMINAL | dict(hidden), []
    _, session = np.unique(made.runs.labels["session"], return_inverse=True)
    steps = 1.0 + walk[2] * rng.standard_normal((session.max() + 1, len(WHEELS)))
    for number in range(len(made.runs)):
        rows = slice(made.logs.offsets[number], made.logs.offsets[number + 1])
        angles = np.column_stack([made.logs.columns[f"counts_{side}"][rows] for side in WHEELS]) * RAD_PER_COUNT
        loads_N = np.array([float(made.runs.numbers[f"load_{side}_N"][number]) for side in WHEELS])
        radii = np.array([p[f"wheel_radius_{side}"] for side in WHEELS]) + p["load_slope"] * (loads_N - 300.0)
        travel = np.diff(angles, axis=0) * radii * steps[session[number]]
        way, turn = travel.mean(axis=1), (travel[:, 1] - travel[:, 0]) / p["track"]
        root = np.sqrt(np.abs(way))
        way, turn = (
            one + size * root * rng.standard_normal(len(root)) for one, size in zip((way, turn), walk[:2], strict=True)
        )
        heading = np.cumsum(turn) - 0.5 * turn + p["start_yaw"]
        chord = way * np.sinc(0.5 * turn / np.pi)
        x = chord @ np.cos(heading)
        ends.append((x, x, chord @ np.sin(heading), turn.sum()))
    return np.array(ends)


def error(folder: Path, name: str, walk: tuple[float, float, float], repeats: int, seed: int) -> float:
    """Return the error of a hidden change over the half width of its interval; NaN where it is not named."""
    made, hidden = campaign(runs(repeats)), {name: CHANGES[name]}
    on_disk(folder / "campaign", made, walked(made, hidden, walk, np.random.default_rng([seed, 7])), seed)

    def simulated(_: SimulatorRunner, __: object, job: Job) -> np.ndarray:
        return numpy_ends(made, lambda _: job.parameters)

    with patch.dict(os.environ, CALIB_CACHE="off"), patch.object(SimulatorRunner, "_one", simulated):
        done = diagnose_simulator(read_campaign(folder / "campaign"), read_settings(numpy_settings(folder)))
    named = {cause.effect: cause for cause in done.diagnosis.causes}
    if f"simulator:{name}" not in named:
        return float("nan")
    quantity = named[f"simulator:{name}"].parameters[name]
    low, high = quantity.ci95
    return (CHANGES[name] - NOMINAL[name] - quantity.value) / (0.5 * (high - low))


def main(campaigns: int, repeats: int) -> None:
    """Print a row for each reality and change."""
    for (words, walk), name in product(WALKS.items(), CHANGES):
        errors = np.empty(campaigns)
        for seed in range(campaigns):
            with tempfile.TemporaryDirectory() as folder:
                errors[seed] = error(Path(folder), name, walk, repeats, seed)
        known = errors[np.isfinite(errors)]
        sys.stdout.write(
            f"{words}, {name}: of {campaigns} campaigns named {len(known)}; interval has the truth "
            f"{np.sum(np.abs(known) < 1.0)}, error over half width {np.sqrt(np.mean(known**2)):.2f}, "
            f"mean {known.mean():+.2f}\n"
        )
        sys.stdout.flush()


if __name__ == "__main__":
    main(*([int(word) for word in sys.argv[1:]] + [100, 2][len(sys.argv) - 1 :]))
