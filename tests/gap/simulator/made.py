"""Campaigns on disk whose reality is a simulator with a hidden change, and the simulator of the examples."""

from __future__ import annotations

import runpy
import sys
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np

from calib.campaign import write_campaign
from calib.campaign.model import Campaign
from calib.gap.simulator.runner import Job, SimulatorRunner
from examples.numpy_simulator.simulator import simulate
from tests.gap.effects.making import SQUARE, STRAIGHT, Run, campaign

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"
NUMPY = EXAMPLES / "numpy_simulator"
#: standard deviations that `Reference` and `Rangefinder` state: distance, x, y, heading
SIGMA = (0.0015, 0.002, 0.002, 0.0008)
TURN = [(2.0, 0.0), (0.5 * np.pi, 1.0), (2.0, 0.0)]


def runs(repeats: int = 2) -> list[Run]:
    """Corridors, squares both ways and a turn, empty and loaded, each several times in two sessions."""
    made = []
    for number in range(repeats):
        temperature = 12.0 + 16.0 * number
        for payload in (0.0, 200.0):
            numbers = {"payload_kg": payload, "payload_x_m": 0.4, "payload_y_m": 0.0, "temperature_C": temperature}
            for kind, pieces in (
                ("corridor", STRAIGHT),
                ("square_ccw", SQUARE),
                ("square_cw", [(length, -kappa) for length, kappa in SQUARE]),
                ("turn", TURN),
            ):
                load = 300.0 + 0.5 * 9.81 * payload
                made.append(
                    Run(
                        pieces,
                        session=f"s{1 + number % 2}",
                        kind=kind,
                        front=False,
                        load_left_N=load,
                        load_right_N=load,
                        numbers=numbers,
                    )
                )
    return made


def on_disk(folder: Path, made: Campaign, ends: np.ndarray, seed: int = 0) -> Path:
    """Write a campaign whose runs end at `ends` (n_runs, 4), as instruments of `SIGMA` read them."""
    rng = np.random.default_rng(seed)
    numbers = dict(made.runs.numbers)
    read = ends + rng.normal(0.0, SIGMA, ends.shape)
    corridor = made.runs.labels["kind"] == "corridor"
    numbers["distance_m"] = np.where(corridor, read[:, 0], np.nan)
    numbers["ref_x_m"], numbers["ref_y_m"], numbers["ref_theta_rad"] = read[:, 1:].T
    write_campaign(replace(made, runs=replace(made.runs, numbers=numbers)), folder)
    return folder


NOMINAL = {
    "wheel_radius_left": 0.1,
    "wheel_radius_right": 0.1,
    "track": 0.7,
    "load_slope": 0.0,
    "start_yaw": 0.0,
}
Hidden = Callable[[int], dict[str, float]]


def numpy_ends(made: Campaign, hidden: Hidden) -> np.ndarray:
    """Return where the runs end, (n_runs, 4), in the example's simulator with hidden parameters of each run."""
    ends = []
    for number in range(len(made.runs)):
        rows = slice(made.logs.offsets[number], made.logs.offsets[number + 1])
        counts = np.column_stack([made.logs.columns[f"counts_{side}"][rows] for side in ("left", "right")])
        loads = [float(made.runs.numbers[f"load_{side}_N"][number]) for side in ("left", "right")]
        x, y, theta = simulate(counts * 2 * np.pi / 4096, loads, NOMINAL | hidden(number))
        ends.append((x, x, y, theta))
    return np.array(ends)


def numpy_campaign(folder: Path, hidden: dict[str, float] | Hidden, seed: int = 0) -> Path:
    """Write a campaign whose reality is the example's simulator with hidden parameters."""
    made = campaign(runs())
    return on_disk(folder, made, numpy_ends(made, hidden if callable(hidden) else lambda _: hidden), seed)


def numpy_settings(folder: Path, **changes: tuple[str, str]) -> Path:
    """Write the example's SIM.toml with its paths whole and texts changed, old to new."""
    text = (NUMPY / "SIM.toml").read_text()
    text = text.replace('"python", "simulator.py"', f'"{sys.executable}", "{NUMPY / "simulator.py"}"')
    for old, new in changes.values():
        assert old in text
        text = text.replace(old, new)
    path = folder / "SIM.toml"
    path.write_text(text)
    return path


#: a script finds its arguments in a place of the whole process
ARGUMENTS = threading.Lock()


def called(runner: SimulatorRunner, arguments: list[str], _: Job) -> bytes:
    """Run the script of a simulator's command in this process: it reads and writes the same files, with no start."""
    _, script, *rest = arguments
    path = runner.settings.path.resolve().parent / script
    with ARGUMENTS, patch.object(sys, "argv", [script, *rest]), patch.object(sys, "path", [*sys.path]):
        runpy.run_path(str(path), run_name="__main__")
    return b""
