"""`calib fleet simulate`: a fleet with known spread, outliers, drift and a common cause."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calib.cli.options import Force, JsonTarget, Seed, refuse_existing
from calib.cli.terminal import emit_json, waiting, wrote

__all__ = ["EPILOG", "run"]

EPILOG = "Example: calib fleet simulate --into vehicles --vehicles 400 --seed 1"


def run(
    into: Annotated[Path, typer.Option("--into", metavar="FOLDER", help="New folder for the dataset.")],
    vehicles: Annotated[int, typer.Option("--vehicles", min=1, help="How many vehicles.")] = 400,
    runs: Annotated[int, typer.Option("--runs", min=6, help="Runs a vehicle.")] = 60,
    months: Annotated[int, typer.Option("--months", min=1, help="Months that they are spread over.")] = 6,
    outliers: Annotated[int, typer.Option("--outliers", min=0, help="Vehicles with a wheel of their own.")] = 20,
    drifting: Annotated[int, typer.Option("--drifting", min=0, help="Vehicles whose radius drifts.")] = 5,
    common: Annotated[int, typer.Option("--common", min=0, help="Vehicles in hall B, whose floor shows.")] = 40,
    seed: Seed = 0,
    json: JsonTarget = None,
    force: Force = False,
) -> None:
    """Write a simulated fleet as Parquet, partitioned by vehicle and month, and what was planted as truth.json.

    With --force the files of the same vehicles and months are replaced in a folder that exists.
    """
    from dataclasses import asdict

    from numpy.random import default_rng

    from calib.plant.fleet import FleetSize, make_fleet

    # a folder that is there may be added to
    refuse_existing([json, None if force and into.is_dir() else into], force=force)
    with waiting("driving"):
        odd = min(outliers, vehicles)
        size = FleetSize(vehicles, runs, months, odd, min(drifting, vehicles - odd), min(common, vehicles))
        truth = make_fleet(into, default_rng(seed), size)
    wrote([into], target=json)
    emit_json(asdict(truth), json, force=force)
