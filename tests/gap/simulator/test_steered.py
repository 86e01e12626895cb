"""A simulator that is far from linear: a tricycle driven by its front wheel, with play and lag in the steering."""

from __future__ import annotations

import json
from collections.abc import Mapping
from itertools import product
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest

from calib.campaign.read import read_campaign
from calib.gap.decision.diagnosis import VerdictKind
from calib.gap.simulator import read_settings
from calib.gap.simulator.diagnose import SimulatorDiagnosis, diagnose_simulator
from calib.gap.simulator.runner import Job, SimulatorRunner

#: name -> nominal value, step, largest plausible deviation
PARAMETERS = {
    "front_radius": (0.125, 5e-4, 0.01),
    "wheelbase": (1.0, 5e-3, 0.1),
    "zero": (0.0, 1e-3, 0.05),
    "play": (0.0, 2e-3, 0.05),
    "lag": (0.05, 0.01, 0.5),
}
NOMINAL = {name: nominal for name, (nominal, *_) in PARAMETERS.items()}
COUNTS, DT_S, RADIUS_M = 8192, 0.02, 1.5
SIGMA = np.array([0.002, 0.002, 0.0008])
QUARTER = 0.5 * np.pi * RADIUS_M
ROUTES = {
    "corridor": [(15.0, 0)],
    "left": [(4.0, 0), (QUARTER, 1), (4.0, 0)],
    "right": [(4.0, 0), (QUARTER, -1), (4.0, 0)],
    "bend": [(3.0, 0), (QUARTER, 1), (1.5, 0), (QUARTER, -1), (3.0, 0)],
    "square_ccw": [(3.0, 0), (QUARTER, 1)] * 4,
    "square_cw": [(3.0, 0), (QUARTER, -1)] * 4,
}
#: standard deviations within which an estimate is of its truth: a chance of some 1 in 4000 of more
SPREAD = 3.7
#: a closed gap is at its noise within the scatter of a root mean square over some hundred readings
CLOSED = 1.2
CAMPAIGN = """format = "calib-campaign/1"
name = "steered"
simulated = true
[vehicle]
drive = "tricycle"
front_wheel_radius_m = 0.125
[encoder]
counts_per_rev = 4096
counts_per_rev_front = 8192
[odometry]
from = "front"
[reference]
sigma_xy_m = 0.002
sigma_theta_rad = 0.0008
"""


def log_of(kind: str, speed_mps: float) -> np.ndarray:
    """Time, counts of the front wheel and steering angle of a route, shape (n, 3)."""
    asked = np.concatenate(
        [np.full(round(length / speed_mps / DT_S), np.arctan(side / RADIUS_M)) for length, side in ROUTES[kind]]
    )
    time = DT_S * np.arange(len(asked) + 1)
    front = np.cumsum(np.append(0.0, speed_mps * DT_S / np.cos(asked))) / NOMINAL["front_radius"]
    # a driver's small corrections
    steer = np.append(0.0, asked) + 0.004 * np.sin(2 * np.pi * time / 3.1)
    return np.column_stack([time, np.round(front * COUNTS / (2 * np.pi)), steer])


def motion(log: np.ndarray, p: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """Return way and turn of the rear axle's middle in each step."""
    # plain numbers: some hundred thousand steps a diagnosis
    at, half, zero, share = float(log[0, 2]), 0.5 * p["play"], p["zero"], float(1.0 - np.exp(-DT_S / p["lag"]))
    late, steps = at + zero, []
    for asked in log[:, 2].tolist():
        at = min(max(at, asked - half), asked + half)
        late += (at + zero - late) * share
        steps.append(late)
    steer = np.array(steps)
    way = np.diff(log[:, 1]) * 2 * np.pi / COUNTS * p["front_radius"]
    middle = 0.5 * (steer[1:] + steer[:-1]) * p.get("gain", 1.0)
    return way * np.cos(middle), way * np.sin(middle) / p["wheelbase"]


def driven(log: np.ndarray, p: Mapping[str, float]) -> tuple[float, float, float]:
    """Return where a run ends."""
    way, turn = motion(log, p)
    heading = np.cumsum(turn) - 0.5 * turn
    x, y = (float(way @ f(heading)) for f in (np.cos, np.sin))
    return x, y, float(turn.sum())


def with_rear_wheels(log: np.ndarray, p: Mapping[str, float]) -> np.ndarray:
    """Return the log with the counts of two rear wheels of 0.1 m on a track of 0.7 m."""
    way, turn = motion(log, p)
    rolled = [np.append(0.0, np.cumsum(way + side * turn)) / 0.1 for side in (-0.35, 0.35)]
    return np.column_stack([log, *np.round(np.array(rolled) * 4096 / (2 * np.pi))])


def diagnosed(folder: Path, hidden: Mapping[str, float], *, rear: bool = False) -> SimulatorDiagnosis:
    """Diagnose a campaign of a tricycle with hidden parameters, the simulator called in this process."""
    rng, logs, rows = np.random.default_rng(3), [], []
    (folder / "logs").mkdir()
    (folder / "campaign.toml").write_text(CAMPAIGN)
    for number, (day, kind, speed) in enumerate(product("abc", ROUTES, (0.4, 0.8))):
        log = log_of(kind, speed)
        logs.append(log)
        whole = with_rear_wheels(log, NOMINAL | dict(hidden)) if rear else log
        names = "t_s,counts_front,steer_rad" + (",counts_left,counts_right" if rear else "")
        np.savetxt(folder / f"logs/{number}.csv", whole, "%.9g", ",", header=names, comments="")
        end = driven(log, NOMINAL | dict(hidden)) + SIGMA * rng.standard_normal(3)
        rows.append(f"r{number},{day},{kind},{speed},{','.join(map(str, end))},logs/{number}.csv")
    header = "run_id,session,kind,speed_mps,ref_x_m,ref_y_m,ref_theta_rad,log"
    (folder / "runs.csv").write_text("\n".join([header, *rows]))
    command = json.dumps(["true", "{campaign}", "{parameters}", "{out}"])
    tables = [f"command = {command}"]
    for name, (nominal, step, largest) in PARAMETERS.items():
        tables += [
            "[[parameter]]",
            f'name = "{name}"',
            f"nominal = {nominal}",
            f"step = {step}",
            f"largest = {largest}",
        ]
    (folder / "SIM.toml").write_text("\n".join(tables))

    def simulated(_: SimulatorRunner, __: object, job: Job) -> np.ndarray:
        return np.array([(x, x, y, theta) for x, y, theta in (driven(log, job.parameters) for log in logs)])

    with patch.dict("os.environ", CALIB_CACHE="off"), patch.object(SimulatorRunner, "_one", simulated):
        return diagnose_simulator(read_campaign(folder), read_settings(folder / "SIM.toml"))


@pytest.mark.parametrize(
    ("hidden", "kind"),
    [
        ({"wheelbase": 1.02, "zero": 0.004}, VerdictKind.EXPLAINED),
        # of the wheel that counts a steady slip is its radius
        ({"front_radius": 0.1247, "play": 0.01}, VerdictKind.EXPLAINED),
    ],
    ids=["two that multiply", "one beside a play"],
)
def test_a_curve_is_no_cause_of_its_own(tmp_path: Path, hidden: dict[str, float], kind: VerdictKind) -> None:
    """A play swallows small corrections, two parameters multiply: no effect of the library stands for that."""
    done = diagnosed(tmp_path, hidden).diagnosis
    assert done.kind is kind and done.recommended
    assert {cause.effect for cause in done.causes} == {f"simulator:{name}" for name in hidden}
    for cause in done.causes:
        ((name, quantity),) = cause.parameters.items()
        low, high = quantity.ci95
        assert abs(done.fix.parameters[name] - hidden[name]) < SPREAD * (high - low) / (2 * 1.96)
    after, floor = done.closure.after_rms_m, done.closure.floor_rms_m
    assert after is not None and floor is not None and after < CLOSED * floor


def test_what_the_front_wheel_is_off_by_is_found_beside_rear_wheels(tmp_path: Path) -> None:
    """The odometry is stated to run on the front wheel: so does the simulator, which has no scale of the angle."""
    done = diagnosed(tmp_path, {"gain": 1.03}, rear=True).diagnosis
    assert [cause.effect for cause in done.causes] == ["steering_scale"]
    # of what the sensor says; the square of it, 0.0009, is not the same in all forms of an error
    assert done.causes[0].parameters["relative"].value == pytest.approx(-0.03, abs=0.03**2)


def test_a_play_at_nominal_hides_no_parameter(tmp_path: Path) -> None:
    """Beside a play its slope is another to either side: the parameters are tried by themselves, from nominal."""
    play, hidden = (0.004, 2e-3, 0.05), 0.02
    with patch.dict(PARAMETERS, play=play), patch.dict(NOMINAL, play=play[0]):
        done = diagnosed(tmp_path, {"play": hidden}).diagnosis
    assert [cause.effect for cause in done.causes] == ["simulator:play"]
    low, high = done.causes[0].parameters["play"].ci95
    assert abs(done.fix.parameters["play"] - hidden) < SPREAD * (high - low) / (2 * 1.96)
