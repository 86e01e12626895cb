"""``calib fleet``: a task for every vehicle and the view of the fleet, and a fleet with known truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from calib.cli import terminal
from calib.cli.terminal import arg, opt
from calib.errors import refuse_workers


def run(
    folder: Annotated[Path, arg(None, "One campaign folder a vehicle, or a dataset partitioned by vehicle.")],
    into: Annotated[Path, opt("FOLDER", "Result folder; a later run goes on there.")],
    what: Annotated[str, opt(None, "fit, check, geometry or diagnose.")] = "fit",
    workers: terminal.Workers = 1,
    scheduler: Annotated[str, opt("TCP", "Dask scheduler, tcp://host:port.")] = "",
    date: terminal.Date = None,
) -> int:
    """Do a task for every vehicle of a fleet: fit, check, geometry or diagnosis; then say what the fleet shows.

    The result folder holds what was read, the result as JSON, PDF and HTML page, and, for a fit, vehicles.csv and
    figures. Only files that are new or have changed are read again; an interrupted run goes on where it was. Exit
    status 1: a vehicle failed.

    Example: calib fleet run vehicles --into fleet --workers 2
    """
    refuse_workers(workers)
    from calib.fleet.store import any_simulated
    from calib.reporting.files import Heads, write_fleet, write_survey
    from calib.reporting.source import issue_date
    from calib.reporting.topics.fleet import fleet_content, survey_content

    issued = issue_date(date)
    terminal.keep(f"what was read so far, in {into}; the same command goes on")
    with terminal.progress("fleet") as tick:
        if what == "fit":
            from calib.fleet.run import fit_fleet

            fleet = fit_fleet(folder, into, workers=workers, scheduler=scheduler, progress=tick)
            heads = Heads(folder.resolve().name, issued, any_simulated(folder))
            document, blocks, written = fleet.to_dict(), fleet_content(fleet), write_fleet(fleet, into, heads)
        else:
            from calib.fleet.run import survey_fleet

            survey = survey_fleet(folder, into, what, workers=workers, scheduler=scheduler, progress=tick)
            heads = Heads(folder.resolve().name, issued, any_simulated(folder))
            document, blocks, written = survey.to_dict(), survey_content(survey), write_survey(survey, into, heads)
    terminal.answer(document, blocks)
    terminal.wrote(written)
    failed = [folder / str(vehicle["id"]) for vehicle in document["vehicles"] if vehicle["status"] == "failed"]
    campaigns = [vehicle for vehicle in failed if vehicle.is_dir()]
    step = "fleet vehicle failed" if campaigns else "fleet file failed" if failed else "fleet"
    other = "diagnose" if what in {"fit", "geometry"} else "fit"
    terminal.then(step, c=folder, what=what, other=other, first=campaigns[:1])
    return int(bool(failed))


def simulate(
    into: Annotated[Path, opt("FOLDER", "New folder for the dataset.")],
    vehicles: Annotated[int, opt(None, "How many vehicles.", min=1)] = 400,
    runs: Annotated[int, opt(None, "Runs a vehicle.", min=6)] = 60,
    months: Annotated[int, opt(None, "Months that they are spread over.", min=1)] = 6,
    outliers: Annotated[int, opt(None, "Vehicles with a wheel of their own.", min=0)] = 20,
    drifting: Annotated[int, opt(None, "Vehicles whose radius drifts.", min=0)] = 5,
    common: Annotated[int, opt(None, "Vehicles in hall B, whose floor shows.", min=0)] = 40,
    poses: Annotated[
        bool, opt(None, "A campaign folder a vehicle, with logs and end poses, for geometry and diagnose.", "--poses")
    ] = False,
    seed: terminal.Seed = 0,
) -> None:
    """Write a simulated fleet as Parquet, partitioned by vehicle and month, and what was planted as truth.json.

    With --poses each vehicle has a folder with logs and end poses instead: outliers have a track of their own, and the
    floor of hall B has a zone that turns what crosses it; --months and --drifting do nothing there.

    With --force the files of the same vehicles and months are replaced in a folder that exists.

    Example: calib fleet simulate --into vehicles --vehicles 400 --seed 1
    """
    from dataclasses import asdict

    from numpy.random import default_rng

    from calib.plant.fleet import FleetSize, FleetTruth, PosedTruth, make_fleet, make_posed_fleet

    # a folder that is there may be added to
    terminal.refuse_outputs(None if terminal.forced() and into.is_dir() else into)
    odd, in_hall = min(outliers, vehicles), min(common, vehicles)
    truth: FleetTruth | PosedTruth
    with terminal.waiting("driving"):
        if poses:
            truth = make_posed_fleet(into, default_rng(seed), vehicles, runs, odd, in_hall)
        else:
            size = FleetSize(vehicles, runs, months, odd, min(drifting, vehicles - odd), in_hall)
            truth = make_fleet(into, default_rng(seed), size)
    terminal.wrote([into])
    terminal.then("fleet simulate --poses" if poses else "fleet simulate", c=into)
    terminal.emit_json(asdict(truth))
