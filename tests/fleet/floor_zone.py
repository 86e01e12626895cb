"""A zone of the floor that the vehicles of one hall share, from planted campaigns to the fleet's sentence.

``python -m tests.fleet.floor_zone FOLDER`` makes vehicles with logs and end poses by the independent plant, lets the
floor of hall B turn what crosses it between 11 and 13 m, diagnoses every vehicle and prints what the fleet shares.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path
from typing import Any, Final

import numpy as np

from calib.campaign import write_campaign
from calib.fleet import VehicleResult
from calib.fleet.run import survey_fleet
from calib.plant import Cause
from calib.plant.design import good_design
from calib.plant.make import make_campaign

#: where the zone begins and how long it is, on the map's x
BEGIN_M: Final = 11.0
LONG_M: Final = 2.0
#: what each metre of it takes from the way of one wheel and adds to the other's
SHARE: Final = 5e-3
N_RUNS: Final = 40
SEED: Final = 7


def make(folder: Path, n_vehicles: int, n_in_hall: int) -> None:
    """Write the vehicles and their halls; those of hall B come last."""
    lines = ["vehicle,hall"]
    for number in range(n_vehicles):
        in_hall = number >= n_vehicles - n_in_hall
        rng = np.random.default_rng([SEED, number])
        design = good_design(rng, n_runs=N_RUNS, needs={"corridor", "directions"})
        zone = Cause("floor_zone", SHARE, "heading", {"at_m": BEGIN_M, "long_m": LONG_M})
        write_campaign(make_campaign(design, [zone] if in_hall else [], rng), folder / f"v{number:02d}")
        lines.append(f"v{number:02d},{'B' if in_hall else 'A'}")
    (folder / "vehicles.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


def main() -> None:
    """Make the fleet where it is not there yet, diagnose it, and print each verdict and what is shared."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--vehicles", type=int, default=11)
    parser.add_argument("--in-hall", type=int, default=5)
    parser.add_argument("--workers", type=int, default=1)
    given = parser.parse_args()
    fleet = given.folder / "vehicles"
    if not (fleet / "vehicles.csv").is_file():
        make(fleet, given.vehicles, given.in_hall)
    begun, load = time.perf_counter(), os.getloadavg()[0]
    survey = survey_fleet(fleet, given.folder / "out", "diagnose", workers=given.workers)
    for record in survey.records:
        causes = [f"{cause['effect']} {cause['probability']:.2f} {cause.get('x_m', '')}" for cause in _causes(record)]
        sys.stdout.write(f"{record.name}: {record.values.get('verdict', record.why)}: {'; '.join(causes)}\n")
    sys.stdout.write("\n".join(f"shared: {cause.sentence}" for cause in survey.shared) + "\n")
    sys.stdout.write(f"{time.perf_counter() - begun:.0f} s at load {load:.1f}\n")


def _causes(record: VehicleResult) -> list[dict[str, Any]]:
    return list(record.values.get("causes", ()))


if __name__ == "__main__":
    main()
