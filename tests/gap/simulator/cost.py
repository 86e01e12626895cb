"""What a diagnosis in a simulator's parameters costs: ``python -m tests.gap.simulator.cost [PARAMETERS [RUNS]]``.

A campaign of RUNS (160) is made by the simulator of `twenty` with two hidden changes, and diagnosed in processes of
their own: without a simulator, and with PARAMETERS (20) of it, nothing kept from before. Printed are the runs of the
simulator and the process time of one and of both diagnoses, medians of rounds in which they take turns. Asked for are
at most (parameters + 3) runs and what the diagnosis takes without.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.gap.effects.making import campaign
from tests.gap.simulator import twenty
from tests.gap.simulator.made import on_disk, runs

HIDDEN = {"wheel_radius_left": 0.0996, "track": 0.707}
#: runs of `made.runs` for one repeat
RUNS_PER_REPEAT = 8
FURTHER_RUNS = 3
#: rounds of the timing: the process time of one differs by 5 % on a busy machine
ROUNDS = 5


@dataclass(frozen=True)
class Cost:
    """Runs of the simulator, and process time of everything that a command started."""

    parameters: int
    runs: int
    ran: int  #: runs of the simulator
    one_s: float  #: one of them
    without_s: float  #: the diagnosis without a simulator
    with_s: float  #: the diagnosis with it, runs of the simulator among it
    set_to: dict[str, float]

    @property
    def allowed_s(self) -> float:
        """Time for the runs that are asked for and for the diagnosis without."""
        return (self.parameters + FURTHER_RUNS) * self.one_s + self.without_s

    def __str__(self) -> str:
        """The cost beside what is asked for."""
        return (
            f"{self.parameters} parameters, {self.runs} runs, process time: the simulator ran {self.ran} times "
            f"(at most {self.parameters + FURTHER_RUNS}), {self.one_s:.3f} s each\n"
            f"diagnosis without it {self.without_s:.2f} s, with it {self.with_s:.2f} s "
            f"(at most {self.allowed_s:.2f} s)\n"
            f"hidden {HIDDEN}; set to {self.set_to}\n"
        )


def settings(folder: Path, parameters: int) -> Path:
    """Write SIM.toml for the first of the parameters."""
    command = [sys.executable, str(twenty.__file__), "{campaign}", "{parameters}", "{out}"]
    lines = [f"command = {json.dumps(command)}"]
    for name, (nominal, step, largest, unit) in list(twenty.PARAMETERS.items())[:parameters]:
        lines += ["[[parameter]]", f'name = "{name}"', f"nominal = {nominal}", f"step = {step}"]
        lines += [f"largest = {largest}", f'unit = "{unit}"']
    path = folder / "SIM.toml"
    path.write_text("\n".join(lines) + "\n")
    return path


def made(folder: Path, n_runs: int) -> Path:
    """Write a campaign of the hidden changes."""
    whole = campaign(runs(n_runs // RUNS_PER_REPEAT))
    nominal = on_disk(folder / "nominal", whole, np.zeros((len(whole.runs), 4)))
    x, y, theta = np.array(list(twenty.ends(nominal, HIDDEN).values())).T
    return on_disk(folder / "campaign", whole, np.column_stack([x, x, y, theta]))


def timed(folder: Path, *command: str) -> float:
    """Run Python in a process of its own; return the process time of it and of what it started."""
    environment = os.environ | {"CALIB_CACHE": str(folder / "cache")}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run([sys.executable, *command], env=environment, capture_output=True, text=True, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode not in {0, 1}:
        raise RuntimeError(done.stderr)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def measured(parameters: int, n_runs: int) -> Cost:
    """Make the campaign and diagnose it with and without the simulator, one process at a time."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        data, out, nominal = made(folder, n_runs), folder / "out.json", folder / "nominal.json"
        nominal.write_text("{}")
        call = ("-m", "calib", "diagnose", str(data), "--json", str(out), "--force")
        one = (str(twenty.__file__), str(data), str(nominal), str(folder / "out.csv"))
        with_it = (*call, "--simulator", str(settings(folder, parameters)))
        rounds = []
        for _ in range(ROUNDS):
            shutil.rmtree(folder / "cache", ignore_errors=True)
            rounds.append([timed(folder, *command) for command in (one, call, one, with_it, one)])
        times = np.array(rounds)
        ran = len(list((folder / "cache").rglob("*.json")))
        set_to = json.loads(out.read_text())["fix"]["parameters"]
        one_s, (without_s, with_s) = np.median(times[:, ::2]), np.median(times[:, 1::2], axis=0)
        return Cost(parameters, n_runs, ran, float(one_s), float(without_s), float(with_s), set_to)


if __name__ == "__main__":
    asked = [int(word) for word in sys.argv[1:]]
    sys.stdout.write(str(measured(*(asked + [20, 160][len(asked) :]))))
