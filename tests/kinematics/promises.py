"""Promised intervals against the scatter of estimates: ``python -m tests.kinematics.promises [CAMPAIGNS]``.

Labs without motion capture plan some runs; the promise is made before they are driven. Then campaigns of the same runs
are simulated by no code of calib's, vehicle and noise drawn anew each time, and their geometry is estimated. Printed
are, for each parameter, the standard deviation promised, the root mean square of the errors over it, and the median
half width of the 95 % intervals over the one promised.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.campaign.model import Campaign
from calib.gap.plan.planned_runs import Dimensions, Measured, PlannedRun, drive, route_of
from calib.kinematics.assemble import Promise, promised
from calib.kinematics.drives import GYRO_SCALE_STD
from calib.kinematics.estimate import estimate_geometry
from calib.kinematics.joint_fit import NOMINAL_STD
from tests.kinematics.campaigns import Leg, Truth, campaign
from tests.kinematics.unaided import PLACED, TAPE_M, WALK, Drive, Gyro, unaided

CORRIDOR_M = 8.0
#: what a gyro's turn is off by without its scale, of `unaided`: the bias from 4 s at rest over 16 s, and its own noise
GYRO_RAD = 2.5e-3
#: of the end poses of a reference: m, rad
SIGMA = (0.002, 0.001)


@dataclass(frozen=True)
class Lab:
    """Runs that a lab plans, and what it measures."""

    runs: Sequence[PlannedRun]
    measured: Measured
    #: standard uncertainty of position and heading at the end of a run
    sigma: tuple[float, float]


NOTHING = Measured(distance=False, position=False, heading=False)
TAPED = [PlannedRun("corridor", "out", tape=True)] * 4
LOOPS = [PlannedRun(kind, loop="closed") for kind in ("square_ccw", "square_cw") for _ in range(6)]
ROUTES = [PlannedRun(kind) for kind in ("route_left", "route_right", "square_ccw", "square_cw") for _ in range(4)]
LABS = {
    "gyro and tape": Lab([*ROUTES, *TAPED], replace(NOTHING, gyro=True), (TAPE_M, GYRO_RAD)),
    "closed loops and tape": Lab([*LOOPS, *TAPED], NOTHING, PLACED),
    "closed loops": Lab(LOOPS, NOTHING, PLACED),
    "headings": Lab(ROUTES, replace(NOTHING, heading=True), SIGMA),
    "positions": Lab(ROUTES, replace(NOTHING, position=True), SIGMA),
}


def promise(lab: Lab) -> Promise:
    """Return what the runs promise, at the noise that `simulated` has."""
    nominal = campaign([("corridor", [(1.0, 0.0)])], Truth(0.05, 0.05, 0.4), np.random.default_rng(0))
    planned = drive(nominal, lab.runs, lab.measured, Dimensions(CORRIDOR_M))
    # at the end alone, while the noise of a reference is counted at both ends
    variances = 0.5 * np.square(lab.sigma)
    return promised(planned, np.array([*variances, WALK**2, 1e-10]))


def simulated(lab: Lab, rng: np.random.Generator) -> tuple[Truth, Campaign]:
    """Return a vehicle, its mean radius within what is taken for known, and the campaign that it drives."""
    mean = 0.05 * (1.0 + NOMINAL_STD * rng.normal())
    half = 0.0035 * rng.normal()
    truth = Truth(mean * (1.0 - half), mean * (1.0 + half), 8.0 * mean * (1.0 + 0.02 * rng.normal()))
    drives = []
    for run in lab.runs:
        route = route_of(run.kind, Dimensions(CORRIDOR_M))
        legs: list[Leg] = [(float(a), float(b)) for a, b in zip(route.length_m, route.turn_rad, strict=True)]
        by = {"loop"} if run.loop else {"tape"} if run.tape else set()
        drives.append(Drive(run.kind, legs, frozenset(by | ({"gyro"} if lab.measured.gyro else set()))))
    if not (lab.measured.position or lab.measured.heading):
        return truth, unaided(drives, truth, Gyro(scale=1.0 + GYRO_SCALE_STD * rng.normal()), rng)
    made = campaign([(one.kind, one.legs) for one in drives], truth, rng, sigma=SIGMA, walk=WALK)
    hidden = {"ref_theta_rad"} if lab.measured.position else {"ref_x_m", "ref_y_m"}
    numbers = {name: column for name, column in made.runs.numbers.items() if name not in hidden}
    return truth, replace(made, runs=replace(made.runs, numbers=numbers))


@dataclass(frozen=True)
class Kept:
    """How a promise was kept: parameter by parameter."""

    sd: dict[str, float]  #: promised
    error: dict[str, float]  #: root mean square over the campaigns, of the promised sd
    width: dict[str, float]  #: median half width of the intervals, of the promised one
    undetermined: tuple[str, ...]  #: promised to be left open
    as_said: float  #: share of campaigns that determine the same parameters


def kept(lab: Lab, campaigns: int) -> Kept:
    """Simulate campaigns and hold them against the promise."""
    said = promise(lab)
    sd, half = ({each.name: getattr(each, kind) for each in said.estimates} for kind in ("std", "half_width"))
    errors, widths, same = defaultdict(list), defaultdict(list), []
    for seed in range(campaigns):
        truth, made = simulated(lab, np.random.default_rng([seed, 25]))
        found = estimate_geometry(made)
        same.append({each.name for each in found.estimates} == set(sd))
        for each in found.estimates:
            if each.name in sd and hasattr(truth, each.name):
                errors[each.name].append((each.value - getattr(truth, each.name)) / sd[each.name])
                widths[each.name].append(each.half_width / half[each.name])
    return Kept(
        sd,
        {name: float(np.sqrt(np.mean(np.square(values)))) for name, values in errors.items()},
        {name: float(np.median(values)) for name, values in widths.items()},
        said.undetermined,
        float(np.mean(same)),
    )


if __name__ == "__main__":
    number = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    for name, each in LABS.items():
        done = kept(each, number)
        sys.stdout.write(f"{name}: open {', '.join(done.undetermined) or 'nothing'}, as said {done.as_said:.2f}\n")
        for parameter, value in done.error.items():
            sys.stdout.write(
                f"  {parameter:15s} sd {done.sd[parameter]:.3g}, error {value:.2f}, width {done.width[parameter]:.2f}\n"
            )
        sys.stdout.flush()
