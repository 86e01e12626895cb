"""`calib fleet simulate`: a fleet with known spread, outliers, drift and a common cause."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calib.cli.options import Seed
from calib.cli.terminal import waiting, wrote

__all__ = ["EPILOG", "run"]

EPILOG = "Example: calib fleet simulate vehicles --vehicles 400 --seed 1"


def run(
    folder: Annotated[Path, typer.Argument(help="New folder for the dataset.")],
    vehicles: Annotated[int, typer.Option("--vehicles", min=1, help="How many vehicles.")] = 400,
    runs: Annotated[int, typer.Option("--runs", min=6, help="Runs a vehicle.")] = 60,
    months: Annotated[int, typer.Option("--months", min=1, help="Months that they are spread over.")] = 6,
    outliers: Annotated[int, typer.Option("--outliers", min=0, help="Vehicles with a wheel of their own.")] = 20,
    drifting: Annotated[int, typer.Option("--drifting", min=0, help="Vehicles whose radius drifts.")] = 5,
    common: Annotated[int, typer.Option("--common", min=0, help="Vehicles in hall B, whose floor shows.")] = 40,
    seed: Seed = 0,
) -> None:
    """Write a simulated fleet as Parquet, partitioned by vehicle and month, and what was planted as truth.json."""
    from numpy.random import default_rng

    from calib.errors import would_overwrite
    from calib.plant.fleet import make_fleet

    if folder.exists():
        raise would_overwrite(folder)
    with waiting("driving"):
        make_fleet(
            folder,
            default_rng(seed),
            n_vehicles=vehicles,
            n_runs=runs,
            n_months=months,
            n_outliers=min(outliers, vehicles),
            n_drifting=min(drifting, vehicles - min(outliers, vehicles)),
            n_common=min(common, vehicles),
        )
    wrote([folder])
