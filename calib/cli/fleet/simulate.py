"""`calib fleet simulate`: a fleet with known spread, outliers, drift and a common cause."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calib.cli.options import Force, JsonTarget, Seed
from calib.cli.terminal import emit_json, waiting, wrote
from calib.files import refuse_existing

EPILOG = "Example: calib fleet simulate --into vehicles --vehicles 400 --seed 1"


def run(
    into: Annotated[Path, typer.Option(metavar="FOLDER", help="New folder for the dataset.")],
    vehicles: Annotated[int, typer.Option(min=1, help="How many vehicles.")] = 400,
    runs: Annotated[int, typer.Option(min=6, help="Runs a vehicle.")] = 60,
    months: Annotated[int, typer.Option(min=1, help="Months that they are spread over.")] = 6,
    outliers: Annotated[int, typer.Option(min=0, help="Vehicles with a wheel of their own.")] = 20,
    drifting: Annotated[int, typer.Option(min=0, help="Vehicles whose radius drifts.")] = 5,
    common: Annotated[int, typer.Option(min=0, help="Vehicles in hall B, whose floor shows.")] = 40,
    poses: Annotated[
        bool,
        typer.Option(
            "--poses", help="A campaign folder a vehicle, with logs and end poses, for geometry and diagnose."
        ),
    ] = False,
    seed: Seed = 0,
    json: JsonTarget = None,
    force: Force = False,
) -> None:
    """Write a simulated fleet as Parquet, partitioned by vehicle and month, and what was planted as truth.json.

    With --poses each vehicle has a folder with logs and end poses instead: outliers have a track of their own, and the
    floor of hall B has a zone that turns what crosses it; --months and --drifting do nothing there.

    With --force the files of the same vehicles and months are replaced in a folder that exists.
    """
    from dataclasses import asdict

    from numpy.random import default_rng

    from calib.plant.fleet import FleetSize, FleetTruth, make_fleet
    from calib.plant.posed_fleet import PosedTruth, make_posed_fleet

    # a folder that is there may be added to
    refuse_existing([None if force and into.is_dir() else into], force=force)
    odd, in_hall = min(outliers, vehicles), min(common, vehicles)
    truth: FleetTruth | PosedTruth
    with waiting("driving"):
        if poses:
            truth = make_posed_fleet(into, default_rng(seed), vehicles, runs, odd, in_hall)
        else:
            size = FleetSize(vehicles, runs, months, odd, min(drifting, vehicles - odd), in_hall)
            truth = make_fleet(into, default_rng(seed), size)
    wrote([into], target=json)
    emit_json(asdict(truth), json, force=force)
