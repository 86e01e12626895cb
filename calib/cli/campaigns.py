"""`calib init`, `ingest`, `check`: a campaign, what is wrong with it; its paths (`deviation`), `loads`; `fleet`."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Final

from calib import cli
from calib.cli import Count, Number, Numbers, Place, Text, arg, opt
from calib.errors import BadInputError, refuse_more, refuse_workers
from calib.reporting import drawn

#: runs cut out of a recording that are listed
_LISTED_RUNS = 8


def init(folder: Annotated[Path, arg("FOLDER", "Campaign folder to make.")]) -> None:
    """Make an empty campaign to fill in by hand: campaign.toml with remarks, runs.csv with its header, logs.

    What a laboratory has already, in spreadsheets, loggers or recordings, goes in with 'calib ingest' instead.

    Example: calib init hall3
    """
    from calib.campaign.ingest.describe import write_blank

    written = write_blank(folder, force=cli.forced())
    cli.emit_json({"campaign": str(folder), "written": [str(path) for path in written]})
    if not cli.wants_stdout():
        cli.wrote(written)
        cli.then("init", c=folder)


def ingest(
    sources: Annotated[
        list[Path], arg("SOURCE", "Run table first, where there is one; then logs, recordings or folders of them.")
    ],
    into: Annotated[Place, opt("CAMPAIGN", "Campaign folder to make.")] = None,
    mapping: Annotated[Place, opt("FILE", "TOML that names the columns.")] = None,
    describe: Annotated[bool, opt(None, "Describe the files and propose a mapping, as TOML.", "--describe")] = False,
    dry_run: Annotated[bool, opt(None, "Do everything but write.", "--dry-run")] = False,
) -> None:
    """Make a campaign out of raw lab files; the sources are hashed and left untouched.

    First 'calib ingest --describe FILE... > lab.toml': it lists the contents and proposes a mapping. Edit it, try it
    with --dry-run, and ingest. Its sections [table] and [log] say which source column is which (run_id = "Run no.";
    distance_m = {column = "Distance", unit = "mm"}); log.file = "Run_{n:02}.csv" names a run's log; [cut] cuts a
    recording into runs. All else goes into campaign.toml.

    Example: calib ingest export.xlsx logger/ --mapping lab.toml --into hall3
    """
    if describe:
        cli.refuse_options("with --describe", {"--into": into, "--mapping": mapping, "--dry-run": dry_run})
        _describe(sources)
        return
    if into is None:
        raise BadInputError(
            "--into: found no campaign folder to make; expected one; give --into FOLDER, or --describe to look first"
        )
    from calib.campaign.checks import listed
    from calib.campaign.ingest import build
    from calib.documents import plain

    with cli.progress("reading") as tick:
        ingested = build.ingest(sources, into, mapping=mapping, force=cli.forced(), dry_run=dry_run, progress=tick)
    document = {
        "campaign": str(ingested.folder),
        "n_runs": ingested.n_runs,
        "n_logs": ingested.n_logs,
        "written": not dry_run,
        "assumed": list(ingested.campaign.assumed),
        "sources": dict(ingested.sources),
        "cuts": plain(ingested.cuts),
        "notes": [{name: getattr(note, name) for name in ("level", "where", "text")} for note in ingested.notes],
    }
    cli.emit_json(document)
    if cli.wants_stdout():
        return
    for note in build.merged_notes(ingested.notes):
        cli.say(f"{note.where}: {note.text}")
    if cuts := ingested.cuts:
        shown = listed([f"{cut.run_id} {cut.start_s:.1f}-{cut.end_s:.1f} s" for cut in cuts], _LISTED_RUNS)
        cli.say(f"Cut into runs: {shown}.")
    end = "; nothing was written" if dry_run else ""
    cli.say(f"{ingested.folder}: {ingested.n_runs} runs, {ingested.n_logs} logs{end}")
    cli.then("ingest --dry-run" if dry_run else "ingest", c=ingested.folder)


def _describe(sources: list[Path]) -> None:
    from calib.campaign.ingest.describe import describe

    with cli.progress("looking"):
        description = describe(sources)
    cli.emit_json(description.to_dict())
    if not cli.wants_stdout():
        cli.emit_text(description.to_toml())
        cli.then("ingest --describe", aside=True, sources=description.sources)


def check(
    campaign: Annotated[Path, arg("CAMPAIGN", "Campaign folder (campaign.toml, runs.csv, logs), or a recording.")],
    strict: Annotated[bool, opt(None, "Exit status 1 on suspicious things, too.", "--strict")] = False,
    mapping: cli.MappingOption = None,
) -> int:
    """Say what was found in a campaign, what is wrong and what is suspicious; nothing is changed.

    It ends in one of three verdicts: sound, look at this (something is suspicious), or wrong. The exit status is 1
    where something is wrong, 0 otherwise (with --strict only where nothing is suspicious either), 2 where the campaign
    cannot be read at all.

    Example: calib check sample_runs/corridor --json -
    """
    from calib.campaign.check import check_campaign
    from calib.campaign.read import read_or_ingest
    from calib.documents import plain
    from calib.reporting.source import refused_settings
    from calib.reporting.topics.runs import after_check, check_content

    with cli.progress("checking") as tick:
        read = read_or_ingest(campaign, mapping=mapping, lenient=True, progress=tick)
        report = check_campaign(read, tick, refused_settings(read))
    parts = ("campaign", "simulated", "sound", "verdict", "found", "wrong", "suspicious", "info")
    cli.answer({part: plain(getattr(report, part)) for part in parts}, check_content(report))
    cli.then(after_check(report, {*read.logs.columns, *read.runs.labels, *read.runs.numbers}), c=campaign)
    return 1 if report.verdict == "wrong" or (strict and report.verdict != "sound") else 0


AMPLITUDES_M: Final = (0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 1.0)
WAVELENGTHS_M: Final = (40.0, 5.0)


def deviation(
    campaign: Annotated[
        Place, arg("CAMPAIGN", "Campaign whose runs are judged; without it only the table is made.")
    ] = None,
    tolerance: Annotated[float, opt("SHARE", "Largest relative error of a radius.")] = 0.0005,
    amplitude: Annotated[Numbers, opt("M", "Amplitude of the weave in the table; may be given again.")] = None,
    wavelength: Annotated[Numbers, opt("M", "Wavelength of the weave in the table; may be given again.")] = None,
    distance: Annotated[Number, opt("M", "Distance S_O of the table; 40 m, or the campaign's median.")] = None,
    track: Annotated[Number, opt("M", "Distance between the wheels; 0.7 m, or the campaign's.")] = None,
    radius_ratio: Annotated[Number, opt("E_R", "Also show the steady arc of wheels with r_R / r_L = E_R.")] = None,
) -> int:
    """Show the error that a woven path or a steady arc adds to a radius, and judge each run.

    Exit status 1 where a run's path moved a radius by more than the tolerance.

    Example: calib deviation sample_runs/corridor --tolerance 0.0005; calib deviation --amplitude 0.5 --wavelength 5
    """
    from calib.campaign.read import read_campaign
    from calib.radius import deviation as table
    from calib.reporting.topics.runs import arc_content, runs_content, weave_content

    with cli.progress("reading"):
        read = None if campaign is None else read_campaign(campaign)
        judged = None if read is None else table.judge_runs(read, tolerance)
    distance_m, track_m = table.table_setting(read, distance, track)
    rows = table.deviation_rows(amplitude or AMPLITUDES_M, wavelength or WAVELENGTHS_M, distance_m, track_m, tolerance)
    arc = None if radius_ratio is None else table.arc_row(radius_ratio, distance_m, track_m)
    document: dict[str, object] = {"tolerance": tolerance, "track_m": track_m, "table": rows, "arc": arc}
    content = weave_content(rows, tolerance, track_m) if judged is None or amplitude or wavelength else ()
    content += () if arc is None else arc_content(arc)
    if judged is not None and read is not None:
        content += runs_content(read.name, read.simulated, judged)
        document |= {
            "campaign": read.name,
            "simulated": read.simulated,
            "runs": judged.rows(),
            "left_out": [{"run_id": run.run_id, "reason": run.reason} for run in judged.left_out],
            "notes": list(judged.notes),
            "passed": judged.passed,
        }
    cli.answer(document, content)
    unknown = judged is not None and "unknown" in judged.verdict
    cli.then("deviation unknown" if unknown else "deviation CAMPAIGN" if campaign else "deviation", c=campaign or "")
    return 0 if judged is None or judged.passed else 1


COLUMNS: Final = {"payload": "payload_kg", "x": "payload_x_m", "y": "payload_y_m"}
#: what is swept -> name of the figure's files
STEMS: Final = {"payload": "fig3b", "y": "fig3a"}


def loads(
    payload: Annotated[Number, opt("KG", "Mass of the payload (0).")] = None,
    x: Annotated[Number, opt("M", "Its centre of mass ahead of the rear axle (0).")] = None,
    y: Annotated[Number, opt("M", "Its centre of mass left of the centre line (0).")] = None,
    sweep: Annotated[Text, opt("WHAT", "Vary payload, x or y (Fig. 3).")] = None,
    first: Annotated[Number, opt(None, "First value of the sweep.", "--from")] = None,
    last: Annotated[Number, opt(None, "Last value of the sweep.", "--to")] = None,
    steps: Annotated[Count, opt(None, "Values of the sweep (21).")] = None,
    weighed: Annotated[Text, opt("F,L,R", "Weighed loads in N (front,left,right): find the payload instead.")] = None,
    sigma: Annotated[Number, opt("N", "Standard uncertainty of each weighing (0).")] = None,
    vehicle: Annotated[Place, opt("CAMPAIGN|COEFFICIENTS", "Take the vehicle from there.")] = None,
    mass: Annotated[Number, opt("KG", "Mass of the vehicle.")] = None,
    cog_x: Annotated[Number, opt("M", "Its centre of mass, ahead of the axle.")] = None,
    cog_y: Annotated[Number, opt("M", "Its centre of mass, left positive.")] = None,
    track: Annotated[Number, opt("M", "Track.")] = None,
    wheelbase: Annotated[Number, opt("M", "Wheelbase.")] = None,
    max_load: Annotated[Number, opt("N", "Permissible wheel load.")] = None,
    figures: cli.Figures = None,
) -> None:
    """Compute static wheel loads (Eqs 1 and 2 with the force balance), or the payload from weighed wheels.

    A payload under which a wheel would lift or carry more than is permitted is refused.

    Example: calib loads --payload 100 --x 0.5 --sweep y --from -0.2333 --to 0.2333 --figures loads
    """
    from dataclasses import asdict

    from calib.odometry.law_path import vehicle_of
    from calib.reporting.topics.simulation import loads_content, weighed_content
    from calib.vehicle import payload_from_wheel_loads, sweep_loads

    lengths = {"cog_x_m": cog_x, "cog_y_m": cog_y, "track_m": track, "wheelbase_m": wheelbase}
    meant = vehicle_of(vehicle, mass_kg=mass, max_wheel_load_N=max_load, **lengths)
    at = {"--payload": payload, "--x": x, "--y": y}
    swept_by = {"--from": first, "--to": last, "--steps": steps}
    if weighed is not None:
        cli.refuse_options("with --weighed", {**at, "--sweep": sweep, **swept_by, "--figures": figures})
        front, left, right = cli.numbers(weighed, 3, "--weighed")
        known = payload_from_wheel_loads(meant, front, left, right, sigma_N=sigma or 0.0)
        document = {"vehicle": asdict(meant), **asdict(known), "sigma_N": sigma or 0.0}
        cli.answer(document, weighed_content(known, known=bool(sigma)))
        cli.then("loads --weighed")
        return
    cli.refuse_options("without --weighed", {"--sigma": sigma})
    if sweep is None:
        cli.refuse_options("without --sweep", swept_by)
    elif sweep in COLUMNS:
        cli.refuse_options(f"with --sweep {sweep}", {f"--{sweep}": at[f"--{sweep}"]})
    if sweep is not None and (sweep not in COLUMNS or first is None or last is None):
        near = "" if sweep in COLUMNS else cli.nearest(sweep, COLUMNS)
        raise BadInputError(f"--sweep: found {sweep!r}; expected payload, x or y, with --from and --to{near}")
    stem = STEMS.get(sweep or "", "loads")
    cli.refuse_outputs(figures=figures, names=[stem])
    swept_column, span = COLUMNS[sweep] if sweep else "", (first or 0.0, last or 0.0)
    placed = (value or 0.0 for value in at.values())
    swept = sweep_loads(meant, *placed, swept=swept_column, span=span, steps=21 if steps is None else steps)
    written = cli.draw(figures, lambda: {stem: drawn("studies.load_figure", swept)})
    document = {"vehicle": asdict(meant), "swept": swept.swept or None, "loads": swept.rows()}
    cli.answer(document | {"figures": list(map(str, written))}, loads_content(meant, swept))
    cli.then("loads")


def run(
    folder: Annotated[Path, arg("FOLDER", "One campaign folder a vehicle, or a dataset partitioned by vehicle.")],
    into: Annotated[Path, opt("FOLDER", "Result folder; a later run goes on there.")],
    what: Annotated[str, opt(None, "fit, check, geometry or diagnose.")] = "fit",
    workers: cli.Workers = 1,
    scheduler: Annotated[str, opt("TCP", "Dask scheduler, tcp://host:port.")] = "",
    date: cli.Date = None,
) -> int:
    """Do a task for every vehicle of a fleet: fit, check, geometry or diagnosis; then say what the fleet shows.

    The result folder holds what was read, the result as JSON, PDF and HTML page, and, for a fit, vehicles.csv and
    figures. Only files that are new or have changed are read again; an interrupted run goes on where it was, a
    complete one with --force. Exit status 1: a vehicle failed.

    Example: calib fleet run vehicles --into fleet --workers 2
    """
    refuse_workers(workers)
    from calib.fleet.run import Fleet, Survey, fit_fleet, survey_fleet
    from calib.reporting.pages import write_fleet
    from calib.reporting.source import issue_date
    from calib.reporting.topics.geometry import fleet_content

    issued, stem = issue_date(date), "fleet" if what == "fit" else what
    names = [f"{stem}.json", f"{stem}.pdf", f"{stem}.html", *(["vehicles.csv"] if what == "fit" else [])]
    cli.refuse_outputs(*(into / name for name in names))
    cli.keep(f"what was read so far, in {into}; the same command goes on")
    with cli.progress("fleet") as tick:
        do: Callable[..., Fleet | Survey] = fit_fleet if what == "fit" else partial(survey_fleet, what=what)
        fleet = do(folder, into, workers=workers, scheduler=scheduler, progress=tick)
        document = fleet.to_dict()
        written = write_fleet(fleet, into, name=folder.resolve().name, issued=issued, force=cli.forced())
    cli.answer(document, fleet_content(fleet))
    cli.wrote(written)
    failed = [folder / str(vehicle["id"]) for vehicle in document["vehicles"] if vehicle["status"] == "failed"]
    campaigns = [vehicle for vehicle in failed if vehicle.is_dir()]
    posed = any((folder / str(vehicle["id"])).is_dir() for vehicle in document["vehicles"])
    step = "fleet" if posed else "fleet table"
    if failed:
        step = "fleet vehicle failed" if campaigns else "fleet file failed"
    other = "diagnose" if what in {"fit", "geometry"} else "fit"
    cli.then(step, c=folder, what=what, other=other, first=campaigns[:1], into=into)
    return int(bool(failed))


def _some(number: int | None, usual: int, most: int, name: str) -> int:
    if number is not None:
        refuse_more(f"--{name}", number, most, "give fewer, or more --vehicles")
    return min(usual if number is None else number, most)


def simulate(
    into: Annotated[Path, opt("FOLDER", "New folder for the dataset.")],
    vehicles: Annotated[int, opt(None, "How many vehicles.", min=1)] = 400,
    runs: Annotated[int, opt(None, "Runs a vehicle.", min=6)] = 60,
    months: Annotated[int, opt(None, "Months that they are spread over.", min=1)] = 6,
    outliers: Annotated[Count, opt(None, "Vehicles with a wheel of their own (20).", min=0)] = None,
    drifting: Annotated[Count, opt(None, "Vehicles whose radius drifts (5).", min=0)] = None,
    common: Annotated[Count, opt(None, "Vehicles in hall B, whose floor shows (40).", min=0)] = None,
    poses: Annotated[
        bool, opt(None, "A campaign folder a vehicle, with logs and end poses, for geometry and diagnose.", "--poses")
    ] = False,
    seed: cli.Seed = 0,
) -> None:
    """Write a simulated fleet as Parquet, partitioned by vehicle and month, and what was planted as truth.json.

    With --poses each vehicle has a folder with logs and end poses instead: outliers have a track of their own, and the
    floor of hall B has a zone that turns what crosses it; --months and --drifting do nothing there.

    With --force the files of the same vehicles and months are replaced in a folder that exists.

    Example: calib fleet simulate --into vehicles --vehicles 400 --seed 1
    """
    from dataclasses import asdict

    from numpy.random import default_rng

    from calib.plant.make import FleetSize, FleetTruth, PosedTruth, make_fleet, make_posed_fleet

    if into.is_dir() and not cli.forced():
        raise BadInputError(f"{into}: found a folder; expected a new one; give --force to replace files in it")
    cli.refuse_outputs(None if into.is_dir() else into)
    odd, in_hall = _some(outliers, 20, vehicles, "outliers"), _some(common, 40, vehicles, "common")
    slow = _some(drifting, 5, vehicles - odd, "drifting")
    truth: FleetTruth | PosedTruth
    with cli.progress("driving"):
        if poses:
            size = FleetSize(vehicles, runs, n_outliers=odd, n_common=in_hall)
            truth = make_posed_fleet(into, default_rng(seed), size)
        else:
            size = FleetSize(vehicles, runs, months, odd, slow, in_hall)
            truth = make_fleet(into, default_rng(seed), size)
    cli.wrote([into])
    cli.then("fleet simulate --poses" if poses else "fleet simulate", c=into)
    cli.emit_json(asdict(truth))
