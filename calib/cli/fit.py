"""`calib fit`, `geometry`, `deviation`, `loads`: the radius law and what it rests on; radii, track and sensor."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from calib.cli import terminal
from calib.cli.terminal import Count, Number, Numbers, Place, Text, Texts, arg, opt
from calib.errors import BadInputError
from calib.reporting.blocks import drawn

if TYPE_CHECKING:
    from calib.coefficients.build import Source
    from calib.radius.result import Fit
    from calib.reporting.blocks import Block


_REFERENCE = "Load on which the coefficients are centred; without it: reference_load_N of campaign.toml."
_MODEL = "Coefficient file whose law the fitted one is held against, at that law's reference load."


def fit(
    campaign: terminal.CampaignOrRecording,
    into: Annotated[Place, opt("FOLDER", "Result folder: fit.json and runs.csv, for report and export.")] = None,
    reference_load: Annotated[Number, opt("N", _REFERENCE)] = None,
    model: Annotated[Place, opt("FILE", _MODEL)] = None,
    runs: Annotated[bool, opt(None, "List the radius of every run.", "--runs")] = False,
    figures: terminal.Figures = None,
    mapping: terminal.MappingOption = None,
) -> int:
    """Fit each wheel's effective radius against its load.

    The intervals allow for what runs of one session have in common. Exit status 1 where a check says that the law
    should not be used as it is; what --model shows is told, and does not change it.

    Example: calib fit sample_runs/corridor --into results/corridor
    """
    from dataclasses import replace

    from calib.campaign.read import read_or_ingest
    from calib.radius.fit import fit_campaign
    from calib.radius.result import FIT_FILE, RUNS_FILE, provenance, write_result
    from calib.reporting.topics.fit import FIT_PICTURES, after_fit, fit_content, fit_pictures

    results = [] if into is None else [into / FIT_FILE, into / RUNS_FILE]
    terminal.refuse_outputs(*results, figures=figures, names=FIT_PICTURES)
    believed, reference_load = _believed(model, reference_load)
    with terminal.progress("fitting") as tick:
        read = read_or_ingest(campaign, mapping=mapping, progress=tick)
        fitted = fit_campaign(read, reference_load_N=reference_load)
    arguments = {"campaign": campaign.name, "reference_load_N": reference_load}
    fitted = replace(fitted, provenance=provenance(read, arguments))
    document, content = fitted.to_dict(), fit_content(fitted, runs=runs)
    if believed is not None:
        comparison, blocks = _compared(fitted, believed)
        document["model_comparison"] = comparison
        content = (*content[:-1], *blocks, content[-1])
    if not terminal.wants_stdout():
        terminal.show(content)
    terminal.wrote([] if into is None else [write_result(fitted, into, force=terminal.forced())])
    terminal.draw(figures, lambda: {one.name: one.draw() for one in fit_pictures(fitted)})
    terminal.emit_json(document)
    terminal.then(after_fit(fitted), c=campaign)
    return 0 if fitted.passed else 1


def _believed(model: Path | None, reference_load: float | None) -> "tuple[Source | None, float | None]":
    if model is None:
        return None, reference_load
    from calib.coefficients.build import coefficients_of

    if reference_load is not None:
        raise BadInputError(
            "--reference-load: found with --model; expected one of them, since the model brings its own; leave one out"
        )
    source = coefficients_of(model)
    return source, source.file.law.left.reference_load_N


def _compared(fitted: "Fit", believed: "Source") -> "tuple[dict[str, object], tuple[Block, ...]]":
    from calib.coefficients.file import effects_left_out
    from calib.radius.result import compare_laws
    from calib.reporting.topics.fit import comparison_content

    notes = (*believed.notes, *effects_left_out(believed.file, "not compared"))
    compared = compare_laws(fitted.left, fitted.right, believed.file.law)
    return compared.to_dict() | {"notes": list(notes)}, comparison_content(compared, notes)


USING = {"end-poses": "end_poses", "windows": "windows"}
LEAVE_OUT = {"session": "session", "kind": "kind", "run": "run_id"}
#: of the figures' folder
PICTURE = "geometry_paths"


def geometry(
    campaign: terminal.CampaignOrRecording,
    using: Annotated[Text, opt("WHAT", "end-poses or windows; without it what the campaign has.")] = None,
    kind: Annotated[Texts, opt("KIND", "Use runs of this kind alone; may be given again.")] = None,
    leave_out: Annotated[Text, opt("WHAT", "Leave each session, kind or run out in turn: end errors.")] = None,
    into: Annotated[Place, opt("FOLDER", "Write the result there (geometry.json).")] = None,
    output: Annotated[Place, opt("COEFFICIENTS", "Write a coefficient file.")] = None,
    figures: terminal.Figures = None,
    mapping: terminal.MappingOption = None,
    accept_implausible: terminal.AcceptImplausible = "",
) -> int:
    """Estimate radii, track and the reference's sensor together, with intervals.

    From end poses (any routes; squares both ways by UMBmark too) or by windows along the way. The result's folder and
    the coefficient file are what export, diagnose --model and simulate take. The result is judged by what it leaves on
    held-out runs beside the noise. Status 1, and no coefficients without a reason, where it is doubtful or wrong.

    Example: calib geometry my_squares --figures pictures --output coefficients.json
    """
    from dataclasses import replace

    from calib.campaign.check import assumed_notes
    from calib.campaign.read import read_or_ingest
    from calib.coefficients.build import from_geometry, geometry_document
    from calib.coefficients.file import GEOMETRY_FILE
    from calib.kinematics.estimate import estimate_geometry
    from calib.reporting.topics.geometry import after_geometry, geometry_content

    way, left_out = _choice("--using", using, USING), _choice("--leave-out", leave_out, LEAVE_OUT)
    result = into / GEOMETRY_FILE if into is not None else None
    terminal.refuse_outputs(output, result, figures=figures, names=[PICTURE])
    with terminal.progress("estimating") as tick:
        read = read_or_ingest(campaign, mapping=mapping, progress=tick)
        estimated = estimate_geometry(read, using=way, kinds=kind or (), leave_out=left_out, progress=tick)
        estimated = replace(estimated, notes=(*estimated.notes, *assumed_notes(read)))
    terminal.show(geometry_content(estimated))
    accept = accept_implausible.strip()
    document = geometry_document(estimated, read, accept)
    terminal.save(result, document)
    if figures is not None:
        from calib.kinematics.assemble import traces_of

        paths = traces_of(read, estimated)
        terminal.draw(figures, lambda: {PICTURE: drawn("calibration.draw_paths", paths, simulated=estimated.simulated)})
    terminal.emit_json(document)
    if output is not None:
        terminal.save(output, from_geometry(estimated, read, accept=accept).to_bytes())
    terminal.then(after_geometry(estimated, output), c=campaign, file=output or "")
    return 0 if estimated.passed else 1


def _choice(option: str, given: str | None, known: dict[str, str]) -> Any:
    if given is not None and given not in known:
        near = terminal.nearest(given, known)
        raise BadInputError(f"{option}: found {given!r}; expected one of {', '.join(known)}; choose one of them{near}")
    return None if given is None else known[given]


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

    with terminal.progress("reading"):
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
    terminal.answer(document, content)
    unknown = judged is not None and "unknown" in judged.verdict
    step = "deviation unknown" if unknown else "deviation CAMPAIGN" if campaign else "deviation"
    terminal.then(step, c=campaign or "")
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
    figures: terminal.Figures = None,
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
        terminal.refuse_options("with --weighed", {**at, "--sweep": sweep, **swept_by, "--figures": figures})
        front, left, right = terminal.numbers(weighed, 3, "--weighed")
        known = payload_from_wheel_loads(meant, front, left, right, sigma_N=sigma or 0.0)
        document = {"vehicle": asdict(meant), **asdict(known), "sigma_N": sigma or 0.0}
        terminal.answer(document, weighed_content(known, known=bool(sigma)))
        terminal.then("loads --weighed")
        return
    terminal.refuse_options("without --weighed", {"--sigma": sigma})
    if sweep is None:
        terminal.refuse_options("without --sweep", swept_by)
    elif sweep in COLUMNS:
        terminal.refuse_options(f"with --sweep {sweep}", {f"--{sweep}": at[f"--{sweep}"]})
    if sweep is not None and (sweep not in COLUMNS or first is None or last is None):
        near = "" if sweep in COLUMNS else terminal.nearest(sweep, COLUMNS)
        raise BadInputError(f"--sweep: found {sweep!r}; expected payload, x or y, with --from and --to{near}")
    stem = STEMS.get(sweep or "", "loads")
    terminal.refuse_outputs(figures=figures, names=[stem])
    swept_column, span = COLUMNS[sweep] if sweep else "", (first or 0.0, last or 0.0)
    placed = (value or 0.0 for value in at.values())
    swept = sweep_loads(meant, *placed, swept=swept_column, span=span, steps=21 if steps is None else steps)
    written = terminal.draw(figures, lambda: {stem: drawn("motion.load_figure", swept)})
    document = {"vehicle": asdict(meant), "swept": swept.swept or None, "loads": swept.rows()}
    terminal.answer(document | {"figures": list(map(str, written))}, loads_content(meant, swept))
    terminal.then("loads")
