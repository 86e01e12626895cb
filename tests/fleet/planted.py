"""Fleets with known truth, many of them: what is found, what is named wrongly, and how often intervals hold the truth.

``python -m tests.fleet.planted --fleets 100`` draws fleets of 400 vehicles and takes each from its run tables to the
fleet's view, in memory.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from calib.fleet.run import FleetView, view_of
from calib.fleet.vehicle import PartSums, VehicleRecord, WheelSums, record_of
from calib.plant.make import COUNTS_PER_REV, FleetSize, FleetTruth, PlannedFleet, plan_fleet

NOMINAL_M, REFERENCE_N = 0.1, 300.0


def records_of(fleet: PlannedFleet, rng: np.random.Generator) -> Iterator[VehicleRecord]:
    """Yield every vehicle's record from its journeys' distances and counts."""
    for row, name in enumerate(fleet.names):
        tables = fleet.months(rng, row)
        column = {key: np.concatenate([np.asarray(table[key]) for table in tables]) for key in tables[0]}
        sides = []
        for side in ("left", "right"):
            radius = column["distance_m"] / (2 * np.pi * column[f"counts_{side}"] / COUNTS_PER_REV)
            load = column[f"load_{side}_N"] - REFERENCE_N
            sides.append(
                WheelSums.from_runs(
                    column["session"], load, radius - NOMINAL_M, column["day"], radius / column["distance_m"]
                )
            )
        yield record_of(name, [PartSums(name, "", REFERENCE_N, NOMINAL_M, sides)])


@dataclass
class Score:
    """Counts over fleets."""

    planted: dict[str, int] = field(default_factory=lambda: {"outliers": 0, "drifting": 0, "common": 0})
    found: dict[str, int] = field(default_factory=lambda: {"outliers": 0, "drifting": 0, "common": 0})
    false: dict[str, int] = field(default_factory=lambda: {"outliers": 0, "drifting": 0, "common": 0})
    due_held: int = 0
    held: dict[str, list[bool]] = field(default_factory=dict)

    def add(self, fleet: PlannedFleet, view: FleetView) -> None:
        """Count one fleet."""
        named = {
            "outliers": {outlier.vehicle for outlier in view.outliers},
            "drifting": {drifting.vehicle for drifting in view.drifting},
            "common": {f"{cause.label} {cause.value} {cause.quantity}" for cause in view.common},
        }
        truth = fleet.truth
        hall = {"hall B radius_right_ref_m"} if truth.common else set()
        planted = {"outliers": set(truth.outliers), "drifting": set(truth.drifting), "common": hall}
        for kind, vehicles in planted.items():
            self.planted[kind] += len(vehicles)
            self.found[kind] += len(vehicles & named[kind])
            self.false[kind] += len(named[kind] - vehicles)
        for drifting in view.drifting:
            row = fleet.names.index(drifting.vehicle)
            rate = fleet.rate_m_per_day[row, ("left", "right").index(drifting.wheel)]
            self.due_held += bool(abs(rate - drifting.per_day_m) <= drifting.half_width_m and rate != 0)
        for name, found in view.populations.items():
            mean, spread = _truth_of(name, truth)
            self.held.setdefault(f"{name}: mean", []).append(bool(found.mean_ci95[0] <= mean <= found.mean_ci95[1]))
            self.held.setdefault(f"{name}: spread", []).append(
                bool(found.spread_ci95[0] <= spread <= found.spread_ci95[1])
            )


def _truth_of(name: str, truth: FleetTruth) -> tuple[float, float]:
    """Return mean and spread of the population; what hall B shares is no part of it."""
    if name.startswith("slope"):
        return truth.slope_mean_m_per_N, truth.slope_spread_m_per_N
    return truth.radius_mean_m, truth.radius_spread_m


def score(size: FleetSize, fleets: int, seed: int) -> Score:
    """Draw fleets, take each to its view, and count."""
    counts = Score()
    for number in range(fleets):
        rng = np.random.default_rng([seed, number])
        fleet = plan_fleet(rng, size)
        counts.add(fleet, view_of(tuple(records_of(fleet, rng)), fleet.labels))
    return counts


def main() -> None:
    """Print the counts of many fleets."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fleets", type=int, default=100)
    parser.add_argument("--vehicles", type=int, default=400)
    parser.add_argument("--outliers", type=int, default=20)
    parser.add_argument("--drifting", type=int, default=5)
    parser.add_argument("--common", type=int, default=40)
    parser.add_argument("--months", type=int, default=6)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    size = FleetSize(given.vehicles, 60, given.months, given.outliers, given.drifting, given.common)
    counts = score(size, given.fleets, given.seed)
    out = sys.stdout.write
    out(f"{given.fleets} fleets of {given.vehicles} vehicles\n")
    for kind, n in counts.planted.items():
        found, false = counts.found[kind], counts.false[kind]
        named = max(found + false, 1)
        out(f"{kind}: {found} of {n} found; {false} of {found + false} named are false ({100 * false / named:.1f} %)\n")
    out(f"rates of drift: {counts.due_held} of {counts.found['drifting'] + counts.false['drifting']} intervals hold\n")
    for name, held in counts.held.items():
        out(f"{name}: {sum(held)} of {len(held)} intervals hold the truth\n")


if __name__ == "__main__":
    main()
