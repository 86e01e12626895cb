"""`calib fleet FOLDER`: a task for every vehicle, and the fleet's view."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calib.cli.options import Date, Force, JsonTarget
from calib.cli.terminal import answer, keep, progress, wrote
from calib.cli.threads import one_blas_thread
from calib.limits import refuse_workers

EPILOG = "Example: calib fleet run vehicles --into fleet --workers 2"


def run(
    folder: Annotated[Path, typer.Argument(help="One campaign folder a vehicle, or a dataset partitioned by vehicle.")],
    into: Annotated[Path, typer.Option(metavar="FOLDER", help="Result folder; a later run goes on there.")],
    what: Annotated[str, typer.Option(help="fit, check, geometry or diagnose.")] = "fit",
    workers: Annotated[int, typer.Option(min=1, help="Processes of this machine.")] = 1,
    scheduler: Annotated[str, typer.Option(metavar="TCP", help="Dask scheduler, tcp://host:port.")] = "",
    date: Date = None,
    json: JsonTarget = None,
    force: Force = False,
) -> int:
    """Do a task for every vehicle of a fleet: fit, check, geometry or diagnosis; then say what the fleet shows.

    The result folder holds what was read, the result as JSON, PDF and HTML page, and, for a fit, vehicles.csv and
    figures. Only files that are new or have changed are read again; an interrupted run goes on where it was. Exit
    status 1: a vehicle failed.
    """
    one_blas_thread()
    refuse_workers(workers)
    from calib.fleet.members import any_simulated
    from calib.report.fleet_files import Heads, write_fleet, write_survey
    from calib.report.source import issue_date
    from calib.report.statements.fleet import fleet_content, survey_content

    issued = issue_date(date)
    keep(f"what was read so far, in {into}; the same command goes on")
    with progress("fleet") as tick:
        if what == "fit":
            from calib.fleet.run import fit_fleet

            fleet = fit_fleet(
                folder, into, workers=workers, scheduler=scheduler, progress=lambda done, n: tick(done, n, "files")
            )
            heads = Heads(folder.resolve().name, issued, any_simulated(folder))
            document, blocks, written = fleet.to_dict(), fleet_content(fleet), write_fleet(fleet, into, heads)
        else:
            from calib.fleet.survey import survey_fleet

            survey = survey_fleet(
                folder, into, what, workers=workers, scheduler=scheduler, progress=lambda k, n: tick(k, n, "vehicles")
            )
            heads = Heads(folder.resolve().name, issued, any_simulated(folder))
            document, blocks, written = survey.to_dict(), survey_content(survey), write_survey(survey, into, heads)
    answer(document, blocks, json=json, force=force)
    wrote(written, target=json)
    return int(any(vehicle["status"] == "failed" for vehicle in document["vehicles"]))
