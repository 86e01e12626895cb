"""What a simulator does about its nominal parameters, and how it is found to repeat itself."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import patch

import numpy as np
import pytest

from calib.gap.predict import predict
from calib.gap.simulator import RunCache, read_settings
from calib.gap.simulator.runner import Differences, Job, SimulatorRunner, differences_of
from calib.types import silent
from tests.gap.effects.making import Run, situation

SIGMA = np.array([0.002, 0.002, 0.002, 0.001])
NAMES = ("a", "b")


def found(folder: Path, digits: int, noise_m: float = 0.0) -> tuple[Differences, int]:
    """Differences of a simulator whose parameter a moves x and b the rest, written to so many digits; and its runs."""
    tables = "".join(f'[[parameter]]\nname = "{n}"\nnominal = 1.0\nstep = 0.01\nlargest = 0.1\n' for n in NAMES)
    path = folder / "SIM.toml"
    path.write_text(f'command = ["true", "{{campaign}}", "{{parameters}}", "{{out}}"]\n{tables}')
    rng, count = np.random.default_rng(1), 0

    def one(_: object, __: object, job: Job) -> np.ndarray:
        nonlocal count
        count += 1
        by_a, by_b = (np.outer([np.pi, -np.e, 7.7], each) for each in ([1.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.5, 0.1]))
        ends = by_a * job.parameters["a"] + by_b * job.parameters["b"]
        return np.round(ends + noise_m * rng.standard_normal(ends.shape), digits)

    runner = SimulatorRunner(read_settings(path), folder, ["r1", "r2", "r3"], RunCache(None, ""), 1, silent)
    with patch.object(SimulatorRunner, "_one", one):
        return differences_of(runner, SIGMA), count


@pytest.mark.parametrize(
    ("digits", "noise_m", "runs", "repeats"),
    [
        (15, 0.0, 3, 1),  # each number comes again with the parameter a step off that does not act on it
        (3, 0.0, 4, 1),  # millimetres hide a scatter that matters: nominal again
        (15, 2e-3, 13, 4),  # more than the uncertainty: each four times, and b at a longer step too
        (15, 1e-6, 4, 1),  # too small to matter, found by the second nominal run
    ],
)
def test_a_second_nominal_run_only_where_the_others_do_not_tell(
    tmp_path: Path, digits: int, noise_m: float, runs: int, repeats: int
) -> None:
    differences, count = found(tmp_path, digits, noise_m)
    assert (count, differences.repeats) == (runs, repeats)
    assert bool(differences.scatter.any()) == (repeats > 1)


def test_the_change_is_per_unit(tmp_path: Path) -> None:
    differences, _ = found(tmp_path, 15)
    assert differences.change["a"][:, 1] == pytest.approx([np.pi, -np.e, 7.7])
    assert differences.change["b"][:, 3] == pytest.approx([0.1 * np.pi, -0.1 * np.e, 0.77])
    assert not differences.change["a"][:, 2:].any()


def test_a_simulated_laser_reads_a_length_of_a_run_driven_backward_too() -> None:
    """Along the start heading, though the measured one reads chords: the model alone simulates it without a gap."""
    measured = situation([Run([(-8.0 if n % 3 else 8.0, 0.1)], front=False) for n in range(9)])
    x_m, y_m, theta_rad = predict(measured).end.T
    measured = replace(measured, axis=np.full(9, 2.0))
    nominal = np.stack([np.abs(x_m), x_m, y_m, theta_rad], axis=1)
    runner = SimpleNamespace(run_ids=measured.labels["run_id"].tolist())
    simulated = Differences(runner, nominal, {}, {}, 0.0 * nominal, 1, axis=1.0).simulated(measured)  # type: ignore[arg-type]
    # the wheels that an outside simulator implies are found to about a nanometre
    np.testing.assert_allclose(predict(simulated).reading[:, 0], np.abs(x_m), atol=1e-6)
