"""Whether the runs that a plan proposes tell apart what they promise to: ``python -m tests.gap.plan.driven [SEEDS]``.

Labs with different references drive a vehicle in which one of two confounded causes is at work. `next_runs` proposes
further runs, `tests.kinematics.unaided` drives them (no code of calib's), and the diagnosis of all runs has to name the
cause and no rival with it. Printed for each lab and cause: in how many campaigns it was ambiguous before, is told apart
and named after, and how many runs that took.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from calib.campaign.model import Campaign
from calib.gap.decision.confounding import apart_on
from calib.gap.diagnose import diagnose_in_full
from calib.gap.plan.next_runs import dimensions_of, next_runs
from calib.gap.plan.planned_runs import Dimensions, PlannedRun, joined, route_of
from tests.kinematics.campaigns import Leg, Truth, campaign, square
from tests.kinematics.unaided import Drive, Gyro, unaided

#: each a per cent off
CAUSES = {
    "track_width": (Truth(0.05, 0.05, 0.404), Gyro()),
    "radius_scale": (Truth(0.0505, 0.0505, 0.4), Gyro()),
    "gyro_scale": (Truth(0.05, 0.05, 0.4), Gyro(scale=1.01)),
}
CORRIDOR_M = 8.0


def free(rng: np.random.Generator, n: int = 12) -> list[list[Leg]]:
    """Routes of eight legs."""
    return [[(rng.uniform(0.5, 1.5), rng.uniform(-1.5, 1.5)) for _ in range(8)] for _ in range(n)]


def gyro(truth: Truth, off: Gyro, rng: np.random.Generator) -> Campaign:
    """Free routes whose turn a gyro measured, and nothing else."""
    return unaided([Drive("free", legs, frozenset({"gyro"})) for legs in free(rng)], truth, off, rng)


def gyro_and_tape(truth: Truth, off: Gyro, rng: np.random.Generator) -> Campaign:
    """The same, and six straights along a tape."""
    runs = [Drive("free", legs, frozenset({"gyro"})) for legs in free(rng)]
    runs += [Drive("corridor", [(CORRIDOR_M, 0.0)], frozenset({"gyro", "tape"})) for _ in range(6)]
    return unaided(runs, truth, off, rng)


def loops(truth: Truth, off: Gyro, rng: np.random.Generator) -> Campaign:
    """Squares that close on a mark, both ways."""
    runs = [Drive(f"square{sense}", square(2.0, sense), frozenset({"loop"})) for sense in (1, -1) for _ in range(6)]
    return unaided(runs, truth, off, rng)


def heading(truth: Truth, _: Gyro, rng: np.random.Generator) -> Campaign:
    """Squares and free routes whose heading alone was measured."""
    routes = [(f"square{sense}", square(2.0, sense)) for sense in (1, -1) for _ in range(8)]
    made = campaign([*routes, *(("free", legs) for legs in free(rng))], truth, rng, walk=0.002)
    numbers = {name: column for name, column in made.runs.numbers.items() if name not in {"ref_x_m", "ref_y_m"}}
    return replace(made, runs=replace(made.runs, numbers=numbers))


Lab = Callable[[Truth, Gyro, np.random.Generator], Campaign]
#: what a lab has, and which of the causes are confounded there
LABS: dict[str, tuple[Lab, tuple[str, ...]]] = {
    "gyro": (gyro, ("track_width", "gyro_scale")),
    "gyro and tape": (gyro_and_tape, ("track_width", "gyro_scale")),
    "closed loops": (loops, ("track_width", "radius_scale")),
    "heading": (heading, ("track_width", "radius_scale")),
}


def as_driven(run: PlannedRun, dimensions: Dimensions, *, by_gyro: bool) -> Drive:
    """Return a proposed run as the simulation takes it: its route's segments, and what measures it."""
    route = route_of(run.kind, dimensions)
    by = {"loop"} if run.loop else {"tape"} if run.kind.startswith("corridor") else set()
    legs = [(float(length), float(turn)) for length, turn in zip(route.length_m, route.turn_rad, strict=True)]
    return Drive(run.kind, legs, frozenset(by | ({"gyro"} if by_gyro else set())))


def with_runs(
    made: Campaign, runs: Sequence[PlannedRun], truth: Truth, off: Gyro, rng: np.random.Generator
) -> Campaign:
    """Return a campaign with proposed runs driven after it, in one session."""
    by_gyro = "gyro_z_radps" in made.logs.columns
    wanted = [run for run in runs for _ in range(run.count)]
    dimensions = dimensions_of(made)
    more = unaided([as_driven(run, dimensions, by_gyro=by_gyro) for run in wanted], truth, off, rng)
    n = len(wanted)
    labels = dict(more.runs.labels) | {
        "run_id": np.array([f"next{number:03d}" for number in range(n)]),
        "session": np.array(["next"] * n),
        "direction": np.array([run.direction for run in wanted]),
    }
    numbers = dict(more.runs.numbers) | {"payload_kg": np.array([run.payload_kg for run in wanted])}
    return joined(made, replace(more, runs=replace(more.runs, labels=labels, numbers=numbers)))


@dataclass(frozen=True)
class Outcome:
    """What the proposed runs did for some campaigns."""

    ambiguous: int  #: before they were driven
    told: int  #: of these, the cause is told from its rivals with them
    named: int  #: and it is the first one named
    runs: float  #: how many were proposed, on average

    def __str__(self) -> str:
        """The counts in words."""
        return f"ambiguous {self.ambiguous}, then told apart {self.told}, named {self.named}, runs {self.runs:.1f}"


def study(lab: str, cause: str, seeds: int) -> Outcome:
    """Plan, drive and diagnose campaigns of a lab with a cause at work."""
    make, rivals = LABS[lab]
    truth, off = CAUSES[cause]
    ambiguous, told, named, proposed = 0, 0, 0, []
    for seed in range(seeds):
        rng = np.random.default_rng([seed, list(LABS).index(lab)])
        made = make(truth, off, rng)
        before = diagnose_in_full(made, plan=False)
        if not before.groups:
            continue
        ambiguous += 1
        ties = [*before.groups]
        by = partial(apart_on, before.arrays)
        runs = next_runs(made, [*before.arrays.effects.values()], before.noise, ties, apart_on=by)
        proposed.append(sum(run.count for run in runs))
        after = diagnose_in_full(with_runs(made, runs, truth, off, rng), plan=False)
        told += not any(cause in group and set(rivals) & {*group} - {cause} for group in after.groups)
        named += [found.effect for found in after.causes][:1] == [cause]
    return Outcome(ambiguous, told, named, float(np.mean(proposed)) if proposed else 0.0)


if __name__ == "__main__":
    number = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    for lab_name, (_, causes) in LABS.items():
        for at_work in causes:
            sys.stdout.write(f"{lab_name}, {at_work}, {number} campaigns: {study(lab_name, at_work, number)}\n")
            sys.stdout.flush()
