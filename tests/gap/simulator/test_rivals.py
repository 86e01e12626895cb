"""A simulator driven by commands, in which two parameters do nearly the same: both are run before one is denied."""

from __future__ import annotations

import json
from collections.abc import Mapping
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast
from unittest.mock import patch

import numpy as np
import pytest

from calib.campaign.read import read_campaign
from calib.gap.decision.diagnosis import Cause, Diagnosis, VerdictKind
from calib.gap.simulator import diagnose as simulator_diagnosis
from calib.gap.simulator import read_settings
from calib.gap.simulator.diagnose import diagnose_simulator
from calib.gap.simulator.fix import SimulatorFix
from calib.gap.simulator.runner import Job, SimulatorRunner

#: name -> nominal value, step, largest plausible deviation: motors' gains and time constants
PARAMETERS = {
    "gain_left": (1.0, 5e-3, 0.05),
    "gain_right": (1.0, 5e-3, 0.05),
    "lag_left": (0.15, 0.03, 0.14),
    "lag_right": (0.15, 0.03, 0.14),
    "track": (0.56, 5e-3, 0.06),
}
NOMINAL = {name: nominal for name, (nominal, *_) in PARAMETERS.items()}
RADIUS_M, COUNTS, DT_S = 0.125, 4096, 0.02
SIGMA = np.array([0.003, 0.003, 0.001])
#: seconds, and shares of the speed that the left and the right wheel are commanded to
ROUTES = {
    "corridor": [(8.0, 1.0, 1.0)],
    "left": [(4.0, 1.0, 1.0), (2.5, 0.6, 1.2), (4.0, 1.0, 1.0)],
    "right": [(4.0, 1.0, 1.0), (2.5, 1.2, 0.6), (4.0, 1.0, 1.0)],
    "square_ccw": [(3.0, 1.0, 1.0), (2.3, 0.6, 1.2)] * 4,
    "square_cw": [(3.0, 1.0, 1.0), (2.3, 1.2, 0.6)] * 4,
}
#: standard deviations within which an estimate is of its truth: a chance of some 1 in 4000 of more
SPREAD = 3.7
CAMPAIGN = """format = "calib-campaign/1"
name = "commanded"
simulated = true
[vehicle]
drive = "differential"
track_m = 0.56
wheel_radius_m = 0.125
[encoder]
counts_per_rev = 4096
[reference]
sigma_xy_m = 0.003
sigma_theta_rad = 0.001
"""


def commands(kind: str, speed_mps: float) -> np.ndarray:
    """Commanded speeds of the two wheels, shape (n, 2); at rest in the end."""
    pieces = [np.tile([left, right], (round(time_s / DT_S), 1)) for time_s, left, right in ROUTES[kind]]
    return speed_mps * np.concatenate([*pieces, np.zeros((round(1.0 / DT_S), 2))])


def rolled(asked: np.ndarray, p: Mapping[str, float]) -> np.ndarray:
    """Way of each wheel in each step, (n, 2): motors follow by a first order."""
    way = np.empty_like(asked)
    for wheel, side in enumerate(("left", "right")):
        # plain numbers: some hundred thousand steps a diagnosis
        now, share, speeds = 0.0, float(1.0 - np.exp(-DT_S / p[f"lag_{side}"])), []
        for speed in (p[f"gain_{side}"] * asked[:, wheel]).tolist():
            now += (speed - now) * share
            speeds.append(now)
        way[:, wheel] = DT_S * np.array(speeds)
    return way


def end(asked: np.ndarray, p: Mapping[str, float]) -> np.ndarray:
    """Pose where a run ends."""
    left, right = rolled(asked, p).T
    turn = (right - left) / p["track"]
    heading = np.cumsum(turn) - 0.5 * turn
    along = 0.5 * (left + right)
    return np.array([along @ np.cos(heading), along @ np.sin(heading), turn.sum()])


def diagnosed(folder: Path, hidden: Mapping[str, float], seed: int) -> Diagnosis:
    """Diagnose a campaign of hidden parameters, the simulator called in this process."""
    rng, asked, rows, real = np.random.default_rng(seed), [], [], NOMINAL | dict(hidden)
    (folder / "logs").mkdir()
    (folder / "campaign.toml").write_text(CAMPAIGN)
    for number, (day, kind, speed) in enumerate(product("ab", ROUTES, (0.6, 0.9))):
        asked.append(commands(kind, speed))
        ways = np.vstack([np.zeros(2), np.cumsum(rolled(asked[-1], real), axis=0)])
        log = np.column_stack([DT_S * np.arange(len(ways)), np.round(ways / RADIUS_M * COUNTS / (2 * np.pi))])
        header = "t_s,counts_left,counts_right"
        np.savetxt(folder / f"logs/{number}.csv", log, "%.9g", ",", header=header, comments="")
        pose = end(asked[-1], real) + SIGMA * rng.standard_normal(3)
        rows.append(f"r{number},{day},{kind},{speed},{','.join(map(str, pose))},logs/{number}.csv")
    (folder / "runs.csv").write_text(
        "\n".join(["run_id,session,kind,speed_mps,ref_x_m,ref_y_m,ref_theta_rad,log", *rows])
    )
    tables = [f"command = {json.dumps(['true', '{campaign}', '{parameters}', '{out}'])}"]
    for name, values in PARAMETERS.items():
        numbers = zip(("nominal", "step", "largest"), values, strict=True)
        tables += ["[[parameter]]", f'name = "{name}"', *(f"{key} = {number}" for key, number in numbers)]
    (folder / "SIM.toml").write_text("\n".join(tables))

    def simulated(_: SimulatorRunner, __: object, job: Job) -> np.ndarray:
        return np.array([(pose[0], *pose) for pose in (end(each, job.parameters) for each in asked)])

    with patch.dict("os.environ", CALIB_CACHE="off"), patch.object(SimulatorRunner, "_one", simulated):
        return diagnose_simulator(read_campaign(folder), read_settings(folder / "SIM.toml")).diagnosis


@pytest.mark.parametrize(
    "hidden",
    [
        {"lag_right": 0.12},
        {"gain_left": 1.004, "lag_left": 0.2},
        {"gain_left": 1.003, "gain_right": 1.003},
        {"track": 0.57, "lag_left": 0.131},
    ],
    ids=["one of two lags", "gain and lag", "gains alike", "track and lag"],
)
def test_what_was_hidden_is_named_with_its_value_or_tied(tmp_path: Path, hidden: dict[str, float]) -> None:
    """No effect of the library and no other parameter is named in the place of one that was hidden, without a word."""
    found = diagnosed(tmp_path, hidden, 1)
    named = {cause.effect for cause in found.causes}
    for name, value in hidden.items():
        cause = f"simulator:{name}"
        tied = any(cause in group for group in found.groups)
        assert cause in named or tied
        if cause in named:
            ((low, high),) = (c.parameters[name].ci95 for c in found.causes if c.effect == cause)
            assert abs(found.fix.parameters[name] - value) < SPREAD * (high - low) / (2 * 1.96)
    assert found.recommended


def _fix(square: float, **deviation: float) -> SimulatorFix:
    return SimulatorFix(deviation, np.zeros((100, 4)), {}, {}, {}, settled=True, square=square)


def _verdict(*names: str, chi_square: float) -> Any:
    """A verdict on a hundred readings whose fit, about nominal, leaves `chi_square`."""
    usable = np.ones((100, 1), dtype=np.bool_)
    each = [(SimpleNamespace(effect=name), np.ones(1), slice(0)) for name in names]
    return SimpleNamespace(
        causes=[SimpleNamespace(effect=name) for name in names],
        nominal=SimpleNamespace(s=SimpleNamespace(usable=usable)),
        noise=SimpleNamespace(dof=30.0),
        fitted=SimpleNamespace(chi_square=chi_square, each=lambda: each),
    )


def test_what_bends_by_chance_is_no_evidence_for_an_effect_of_the_library() -> None:
    """A parameter and what the library has like it, each a part of one size, fit changes about nominal better.

    Run, the parameter alone leaves as little as run beside the effect, with a number fewer.
    """
    verdict, alone = _verdict("simulator:delay", "steering_delay", chi_square=90.0), {"simulator:delay": "delay"}
    differences = SimpleNamespace(by_cause=alone, repeats=1)
    with (
        patch.object(simulator_diagnosis, "_most_able", lambda *_: iter([alone])),
        patch.object(simulator_diagnosis, "run_alone", lambda *_, **__: _fix(101.0, delay=0.1)),
        patch.object(simulator_diagnosis, "_neighbours", lambda *_: iter(())),
    ):
        (best,) = simulator_diagnosis._rivals_of(verdict, cast("Any", differences), _fix(101.0, delay=0.06))
    assert best.names == {"simulator:delay"}


def test_one_parameter_fewer_is_run_however_much_its_change_about_nominal_leaves() -> None:
    """Of two that nearly do the same the path bends by more than either changes it."""
    rng = np.random.default_rng(5)
    columns = rng.standard_normal((100, 2))
    forms = [SimpleNamespace(effect=f"simulator:{name}") for name in ("gain", "wheelbase")]
    named = {form.effect: form.effect.removeprefix("simulator:") for form in forms}
    best = simulator_diagnosis._Rival(frozenset(named), 0.0, cast("Any", named), _fix(90.0, gain=0.01, wheelbase=0.04))
    # orthogonal to both: neither column alone, nor both, leaves less than all of it
    gap = rng.standard_normal(100) * 1e3
    with (
        patch.object(simulator_diagnosis, "scaled_signatures", lambda _: (forms, np.zeros(2), columns, gap)),
        patch.object(simulator_diagnosis, "bend", lambda *_: 0.0),
    ):
        differences = SimpleNamespace(by_cause=named)
        tried = [*simulator_diagnosis._neighbours(cast("Any", None), cast("Any", differences), best, 150.0)]
    assert [set(some) for some in tried] == [{"simulator:wheelbase"}, {"simulator:gain"}]


def test_parameters_that_do_the_same_share_the_probability_of_both() -> None:
    """Already shared in the search, it was shared again: 0.18 each of two that are at work for certain."""
    names = ("simulator:track", "simulator:gain")
    rivals = [
        simulator_diagnosis._Rival(
            frozenset({name}), 90.0, {name: cast("Any", SimpleNamespace(name="size"))}, _fix(90.0, size=0.1)
        )
        for name in names
    ]
    cause = Cause(names[0], "", "", 0.37, share=1.0, signal=30.0, parameters={})
    first = Diagnosis(VerdictKind.EXPLAINED, "", (cause,), groups=(names,), evidence=cast("Any", object()))
    with patch.object(simulator_diagnosis, "any_probability", lambda _, group: 0.96 if group == {*names} else 0.37):
        told = simulator_diagnosis._as_rivals(first, rivals)
    assert [cause.probability for cause in told.causes] == pytest.approx([0.48])
