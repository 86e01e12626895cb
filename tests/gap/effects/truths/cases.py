"""What a truth is: an effect at a size, and what it does to a run; and the runs that truths are tried on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from calib.campaign.settings import OdometryModel
from calib.vehicle import Vehicle
from tests.gap.effects.making import MODEL, RADIUS_M, TRACK_M, Run, Truth, rich_runs

G = 9.81
RUNS = rich_runs()
HUMID = [run.numbers["humidity"] for run in RUNS]
LOGGED = [replace(run, log=True) for run in RUNS]
FORWARD = [replace(run, pieces=[(abs(length), kappa) for length, kappa in run.pieces]) for run in RUNS]
ROLLING = [replace(run, log=True, stops=False) for run in RUNS]
SLOPED = OdometryModel(RADIUS_M, RADIUS_M, TRACK_M, 300.0, 1.2e-6, 1.2e-6)


def mean(runs: list[Run], what: Callable[[Run], float]) -> float:
    return float(np.mean([what(run) for run in runs]))


@dataclass
class Case:
    """An effect, its size, the truth, and how closely it has to close the gap (share of the largest gap)."""

    effect: str
    label: str
    sizes: list[float]
    truth: Truth
    within: float = 5e-3
    runs: list[Run] | None = None
    model: OdometryModel = MODEL
    vehicle: Vehicle | None = None


CASES: list[Case] = []


def case(effect: str, label: str, *sizes: float, **settings: object) -> Callable[[Truth], Truth]:
    """Register a truth, written as a function of the run and its motion."""

    def register(truth: Truth) -> Truth:
        CASES.append(Case(effect, label, list(sizes), truth, **settings))  # type: ignore[arg-type]
        return truth

    return register
