"""What parameters of a simulator do is theirs: far off, beside a scatter, a small one, or one that does the same."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest

from calib.campaign.read import read_campaign
from calib.errors import RefusedError
from calib.gap.decision.diagnosis import Diagnosis, VerdictKind
from calib.gap.simulator import read_settings
from calib.gap.simulator.diagnose import diagnose_simulator
from calib.gap.simulator.fix import parameters_to_set
from calib.gap.simulator.runner import Job, SimulatorRunner
from tests.gap.effects.making import campaign
from tests.gap.simulator.made import NOMINAL, numpy_ends, on_disk, runs

Law = Callable[[Mapping[str, float]], dict[str, float]]
#: name -> nominal value, step, largest plausible deviation
LEFT, RIGHT, TRACK = ((0.1, 2e-4, 0.01), (0.1, 2e-4, 0.01), (0.7, 2e-3, 0.1))
SLOPE = (0.0, 2e-7, 2e-5)
#: standard deviations within which an estimate is of its truth: a chance of some 1 in 4000 of more
SPREAD = 3.7


def diagnosed(
    folder: Path,
    parameters: Mapping[str, tuple[float, float, float]],
    law: Law,
    hidden: Mapping[str, float],
    scatter: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0),
    seed: int = 0,
    warm: float = 0.0,
) -> Diagnosis:
    """Diagnose hidden values of parameters that act by a law on those of the example, called in this process.

    `warm`: by which the radii of the second half are larger, what no parameter does.
    """
    # the load on one side, then on the other
    uneven = [
        replace(run, load_left_N=run.load_left_N + (-1) ** (number // 2) * 0.4 * (run.load_left_N - 300.0))
        for number, run in enumerate(runs())
    ]
    made, rng = campaign(uneven), np.random.default_rng([seed, 1])
    nominal = {name: value for name, (value, *_) in parameters.items()}

    def ends(values: Mapping[str, float], warm: float = 0.0) -> np.ndarray:
        p = NOMINAL | law(values)
        radii = {name: value * (1.0 + warm) for name, value in p.items() if name.startswith("wheel_radius")}
        return numpy_ends(made, lambda number: p | radii if number >= len(made.runs) // 2 else p)

    def simulated(_: SimulatorRunner, __: object, job: Job) -> np.ndarray:
        table = ends(job.parameters)
        return table + scatter * rng.standard_normal(table.shape)

    on_disk(folder / "campaign", made, ends(nominal | dict(hidden), warm), seed)
    tables = [f"command = {json.dumps(['true', '{campaign}', '{parameters}', '{out}'])}"]
    for name, values in parameters.items():
        numbers = zip(("nominal", "step", "largest"), values, strict=True)
        tables += ["[[parameter]]", f'name = "{name}"', *(f"{key} = {number}" for key, number in numbers)]
    (folder / "SIM.toml").write_text("\n".join(tables))
    with patch.dict("os.environ", CALIB_CACHE="off"), patch.object(SimulatorRunner, "_one", simulated):
        found = diagnose_simulator(read_campaign(folder / "campaign"), read_settings(folder / "SIM.toml"))
    return found.diagnosis


def holds(found: Diagnosis, hidden: Mapping[str, float]) -> bool:
    """Return whether the verdict names the hidden parameters alone, each with its value."""
    if {cause.effect for cause in found.causes} != {f"simulator:{name}" for name in hidden}:
        return False
    ends = {name: quantity.ci95 for cause in found.causes for name, quantity in cause.parameters.items()}
    half = {name: 0.5 * (high - low) for name, (low, high) in ends.items()}
    return all(abs(found.fix.parameters[name] - hidden[name]) < SPREAD / 1.96 * half[name] for name in hidden)


def test_the_scatter_of_a_simulator_bends_no_path(tmp_path: Path) -> None:
    """Headings scatter, too: a slope of the load is all of the gap, and no law of the library takes a part of it."""
    parameters = {"wheel_radius_left": LEFT, "wheel_radius_right": RIGHT, "track": TRACK, "load_slope": SLOPE}
    hidden = {"load_slope": -1.5e-6}
    found = diagnosed(tmp_path, parameters, dict, hidden, (0.003, 0.005, 0.01, 0.0025), 4)
    assert holds(found, hidden)
    assert found.recommended


def test_a_parameter_that_is_flat_about_nominal_acts_further_off(tmp_path: Path) -> None:
    """A grip above what the runs ask for: a step to either side shows nothing, and the hidden value much."""

    def law(p: Mapping[str, float]) -> dict[str, float]:
        return {"wheel_radius_left": 0.1 - 2e-3 * max(0.5 - p["grip"], 0.0), "track": p["track"]}

    hidden = {"grip": 0.25}
    found = diagnosed(tmp_path, {"grip": (1.0, 0.05, 0.99), "track": TRACK}, law, hidden)
    assert holds(found, hidden)
    assert found.recommended


def test_a_small_parameter_beside_a_large_one_is_set_as_well(tmp_path: Path) -> None:
    """A slope of a few per cent of the gap: that a law of the library does the same is no reason to leave it out."""
    parameters = {"wheel_radius_left": LEFT, "wheel_radius_right": RIGHT, "track": TRACK, "load_slope": SLOPE}
    hidden = {"wheel_radius_left": 0.0996, "load_slope": -3e-7}
    found = diagnosed(tmp_path, parameters, dict, hidden)
    assert holds(found, hidden)


def tyre(p: Mapping[str, float]) -> dict[str, float]:
    """Counts a metre and the tyre multiply."""
    radius = 0.1 * p["tyre"] / p["counts"]
    return {"wheel_radius_left": radius, "wheel_radius_right": radius, "track": p["track"]}


TYRE = {"tyre": (100.0, 0.2, 10.0), "counts": (100.0, 0.15, 10.0), "track": TRACK}


def test_a_parameter_that_does_the_same_stays_in_the_verdict(tmp_path: Path) -> None:
    """A run with one of two that do the same, further off, does not exclude the other."""
    found = diagnosed(tmp_path, TYRE, tyre, {"tyre": 100.6, "track": 0.695})
    assert found.kind is VerdictKind.AMBIGUOUS
    assert {"simulator:tyre", "simulator:counts"} in [set(group) for group in found.groups]


def test_what_two_parameters_may_do_in_part_is_no_whole_explanation(tmp_path: Path) -> None:
    """That the runs cannot tell two parameters apart does not hide that either of them leaves most of the gap."""
    found = diagnosed(tmp_path, TYRE, tyre, {"tyre": 100.6}, warm=2e-3)
    assert any(not cause.effect.startswith("simulator:") for cause in found.causes)
    assert found.kind is VerdictKind.PARTLY_EXPLAINED


def test_a_fix_by_which_ends_get_further_off_is_not_written(tmp_path: Path) -> None:
    """Headings that come right outweigh ends in the closure."""
    found = diagnosed(tmp_path, {"wheel_radius_left": LEFT, "track": TRACK}, dict, {"wheel_radius_left": 0.1003})
    assert parameters_to_set(found).keys() == {"wheel_radius_left"}
    further = replace(found.closure, before_rms_m=0.38, after_rms_m=0.51)
    with pytest.raises(RefusedError, match="510 mm off, 380 mm without"):
        parameters_to_set(replace(found, closure=further))
