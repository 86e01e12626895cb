"""Verdicts with a noisy simulator: ``python -m tests.gap.simulator.noisy [SEEDS]``.

Three changes hidden in the numpy simulator, SEEDS (20) campaigns each. The ends that the simulator writes scatter by
2 mm from run to run, as much as the reference does. Printed are the verdicts: the changed parameter named alone, with
a further cause beside it, not named, how often the 95 % interval of its size has the truth, and the root mean square
of the errors over the half widths (0.51 where intervals are exact). The same campaigns with a simulator that repeats
itself tell what of that is the scatter's doing.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections import Counter
from collections.abc import Mapping
from itertools import product
from pathlib import Path
from unittest.mock import patch

import numpy as np

from calib.campaign.read import read_campaign
from calib.gap.simulator import read_settings
from calib.gap.simulator.diagnose import SimulatorDiagnosis, diagnose_simulator
from calib.gap.simulator.runner import Job, SimulatorRunner
from tests.gap.effects.making import campaign
from tests.gap.simulator.made import numpy_campaign, numpy_ends, numpy_settings, runs

CHANGES = {"track": 0.712, "load_slope": 1.5e-6, "wheel_radius_left": 0.0994}
#: of the ends' distance, x and y from run to run
SCATTER_M = 2e-3


def diagnosed(folder: Path, hidden: Mapping[str, float], seed: int, scatter_m: float = SCATTER_M) -> SimulatorDiagnosis:
    """Diagnose a hidden change, the simulator called in this process: a start of it costs more than a diagnosis."""
    made, rng = campaign(runs()), np.random.default_rng([seed, 1])
    scatter = np.array([scatter_m, scatter_m, scatter_m, 0.0])

    def simulated(_: SimulatorRunner, __: object, job: Job) -> np.ndarray:
        ends = numpy_ends(made, lambda _: job.parameters)
        return ends + scatter * rng.standard_normal(ends.shape)

    data = read_campaign(numpy_campaign(folder / "campaign", dict(hidden), seed))
    with patch.dict(os.environ, CALIB_CACHE="off"), patch.object(SimulatorRunner, "_one", simulated):
        return diagnose_simulator(data, read_settings(numpy_settings(folder)))


def outcome(done: SimulatorDiagnosis, name: str, value: float, counts: Counter[str], errors: list[float]) -> str:
    """Count how the verdict stands to the truth, and whether the interval has it; return it in a word.

    `errors` takes that of the size over the half width of its interval.
    """
    causes = {cause.effect: cause for cause in done.diagnosis.causes}
    right = causes.get(f"simulator:{name}")
    word = "wrong" if right is None else "alone" if len(causes) == 1 else "beside"
    counts[word] += 1
    counts["runs"] += done.runs.asked
    if right is not None:
        quantity = right.parameters[name]
        nominal = done.diagnosis.fix.parameters[name] - quantity.value
        low, high = quantity.ci95
        counts["inside"] += low <= value - nominal <= high
        errors.append((value - nominal - quantity.value) / (0.5 * (high - low)))
    return f"{word} {done.diagnosis.kind} {', '.join(causes)}"


def main(seeds: int) -> None:
    """Print a row for each change."""
    for scatter_m, (name, value) in product((SCATTER_M, 0.0), CHANGES.items()):
        counts: Counter[str] = Counter()
        errors: list[float] = []
        for seed in range(seeds):
            with tempfile.TemporaryDirectory() as folder:
                done = diagnosed(Path(folder), {name: value}, seed, scatter_m)
            words = outcome(done, name, value, counts, errors)
            if not words.startswith("alone"):
                sys.stdout.write(f"  {name}, seed {seed}: {words}\n")
        sys.stdout.write(
            f"{name} = {value:g}, scatter {1e3 * scatter_m:g} mm: of {seeds} campaigns named alone {counts['alone']}, "
            f"with a further cause {counts['beside']}, not named {counts['wrong']}; interval has the truth "
            f"{counts['inside']}, error over half width {np.sqrt(np.mean(np.square(errors))):.2f}; "
            f"{counts['runs'] / seeds:.0f} runs of the simulator each\n"
        )
        sys.stdout.flush()


if __name__ == "__main__":
    main(*(int(word) for word in sys.argv[1:] or ["20"]))
