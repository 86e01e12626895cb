"""`calib fit`, `geometry`: the law of the radii; radii, track and sensor; `export`, `report`: what is made of them."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from calib import cli
from calib.cli import Number, Place, Text, Texts, arg, opt
from calib.coefficients.formats import FORMATS, PATCHING, Artifact, ExportOptions, parse_loads, place, refuse_loads
from calib.errors import BadInputError
from calib.reporting import drawn
from calib.reporting.exports import BINARY, export_from
from calib.reporting.exports import FORMATS as OTHER_FORMATS

if TYPE_CHECKING:
    from calib.campaign.model import Campaign
    from calib.radius.result import Fit
    from calib.reporting.content import Report
    from calib.types import Progress


_REFERENCE = "Load on which the coefficients are centred; without it: reference_load_N of campaign.toml."
_MODEL = "Coefficient file whose law the fitted one is held against, at that law's reference load."


def fit(
    campaign: cli.CampaignOrRecording,
    into: Annotated[Place, opt("FOLDER", "Result folder: fit.json and runs.csv, for report and export.")] = None,
    reference_load: Annotated[Number, opt("N", _REFERENCE)] = None,
    model: Annotated[Place, opt("FILE", _MODEL)] = None,
    runs: Annotated[bool, opt(None, "List the radius of every run.", "--runs")] = False,
    figures: cli.Figures = None,
    mapping: cli.MappingOption = None,
) -> int:
    """Fit each wheel's effective radius against its load.

    The intervals allow for what runs of one session have in common. Exit status 1 where a check says that the law
    should not be used as it is; what --model shows is told, and does not change it.

    Example: calib fit sample_runs/corridor --into results/corridor
    """
    from calib.campaign.read import read_or_ingest
    from calib.radius.fit import fit_campaign
    from calib.radius.result import FIT_FILE, RUNS_FILE, compare_laws, provenance, write_result
    from calib.reporting.topics.fit import FIT_PICTURES, after_fit, comparison_content, fit_content, fit_pictures

    results = [] if into is None else [into / FIT_FILE, into / RUNS_FILE]
    cli.refuse_outputs(*results, figures=figures, names=FIT_PICTURES)
    believed = None
    if model is not None:
        from calib.coefficients.build import coefficients_of

        if reference_load is not None:
            expected = "one of them, since the model brings its own"
            raise BadInputError(f"--reference-load: found with --model; expected {expected}; leave one out")
        believed = coefficients_of(model)
        reference_load = believed.file.law.left.reference_load_N
    with cli.progress("fitting") as tick:
        read = read_or_ingest(campaign, mapping=mapping, progress=tick)
        fitted = fit_campaign(read, reference_load_N=reference_load)
    arguments = {"campaign": campaign.name, "reference_load_N": reference_load}
    fitted = replace(fitted, provenance=provenance(read, arguments))
    document, content = fitted.to_dict(), fit_content(fitted, runs=runs)
    if believed is not None:
        from calib.coefficients.file import effects_left_out

        notes = (*believed.notes, *effects_left_out(believed.file, "not compared"))
        compared = compare_laws(fitted.left, fitted.right, believed.file.law)
        document["model_comparison"] = compared.to_dict() | {"notes": list(notes)}
        content = (*content[:-1], *comparison_content(compared, notes), content[-1])
    if not cli.wants_stdout():
        cli.show(content)
    cli.wrote([] if into is None else [write_result(fitted, into, force=cli.forced())])
    cli.draw(figures, lambda: {one.name: one.draw() for one in fit_pictures(fitted)}, simulated=fitted.simulated)
    cli.emit_json(document)
    cli.then(after_fit(fitted), c=campaign)
    return 0 if fitted.passed else 1


USING = {"end-poses": "end_poses", "windows": "windows"}
LEAVE_OUT = {"session": "session", "kind": "kind", "run": "run_id"}
PICTURE = "geometry_paths"


def geometry(
    campaign: cli.CampaignOrRecording,
    using: Annotated[Text, opt("WHAT", "end-poses or windows; without it what the campaign has.")] = None,
    kind: Annotated[Texts, opt("KIND", "Use runs of this kind alone; may be given again.")] = None,
    leave_out: Annotated[Text, opt("WHAT", "Leave each session, kind or run out in turn: end errors.")] = None,
    into: Annotated[Place, opt("FOLDER", "Write the result there (geometry.json).")] = None,
    output: Annotated[Place, opt("COEFFICIENTS", "Write a coefficient file.")] = None,
    figures: cli.Figures = None,
    mapping: cli.MappingOption = None,
    accept_implausible: cli.AcceptImplausible = "",
) -> int:
    """Estimate radii, track and the reference's sensor together, with intervals.

    From end poses (any routes; squares both ways by UMBmark too) or by windows along the way. The result's folder and
    the coefficient file are what export, diagnose --model and simulate take. The result is judged by what it leaves on
    held-out runs beside the noise. Status 1, and no coefficients without a reason, where it is doubtful or wrong.

    Example: calib geometry my_squares --figures pictures --output coefficients.json
    """
    from calib.campaign.check import assumed_notes
    from calib.campaign.read import read_or_ingest
    from calib.coefficients.build import from_geometry, geometry_document
    from calib.coefficients.file import GEOMETRY_FILE
    from calib.kinematics.estimate import estimate_geometry
    from calib.reporting.topics.geometry import after_geometry, geometry_content

    way, left_out = _choice("--using", using, USING), _choice("--leave-out", leave_out, LEAVE_OUT)
    result = into / GEOMETRY_FILE if into is not None else None
    cli.refuse_outputs(output, result, figures=figures, names=[PICTURE])
    with cli.progress("estimating") as tick:
        read = read_or_ingest(campaign, mapping=mapping, progress=tick)
        estimated = estimate_geometry(read, using=way, kinds=kind or (), leave_out=left_out, progress=tick)
        estimated = replace(estimated, notes=(*estimated.notes, *assumed_notes(read)))
    cli.show(geometry_content(estimated))
    accept = accept_implausible.strip()
    document = geometry_document(estimated, read, accept)
    cli.save(result, document)
    if figures is not None:
        from calib.kinematics.assemble import traces_of

        paths = traces_of(read, estimated)
        cli.draw(figures, lambda: {PICTURE: drawn("calibration.draw_paths", paths)}, simulated=read.simulated)
    cli.emit_json(document)
    if output is not None:
        cli.save(output, from_geometry(estimated, read, accept=accept).to_bytes())
    cli.then(after_geometry(estimated, output), c=campaign, file=output or "")
    return 0 if estimated.passed else 1


def _choice(option: str, text: str | None, known: dict[str, str]) -> Any:
    if text is not None and text not in known:
        near = cli.nearest(text, known)
        raise BadInputError(f"{option}: found {text!r}; expected one of {', '.join(known)}; choose one of them{near}")
    return None if text is None else known[text]


_LOAD = "Load point, N for both wheels or LEFT,RIGHT; may be given again (ros2, csv)."
_CONTROLLER = "ROS 2 controller, may be given again; without it those of the vehicle's drive."
_VELOCITIES = "ROS 2: the joints report velocities, not positions."
_COMMANDS = "ROS 2: odometry from the commands, not from the encoders."
KNOWN = (*FORMATS, *OTHER_FORMATS)


def export(
    source: Annotated[
        Path, arg("CAMPAIGN|FIT", "Campaign, result folder of calib fit or geometry, its JSON, or coefficients.json.")
    ],
    to: Annotated[str, opt("FORMAT", f"{', '.join(KNOWN)}; json is the master.")],
    output: Annotated[
        Place, opt(None, "File, or folder where several files are made; without it, or '-': standard output.")
    ] = None,
    load: Annotated[Texts, opt("N", _LOAD)] = None,
    outside: Annotated[Text, opt("RULE", "Loads that were not measured: refuse (the default) or clamp.")] = None,
    date: Annotated[Text, opt("YYYY-MM-DD", "Date written into the file.")] = None,
    controller: Annotated[Texts, opt("NAME", _CONTROLLER)] = None,
    model: Annotated[
        Place, opt("MODEL", "Your simulator's model; a copy is patched (mjcf, urdf, sdf).", "--into")
    ] = None,
    left: Annotated[str, opt("NAME", "Joint, body or link of the left rear wheel in MODEL.")] = "",
    right: Annotated[str, opt("NAME", "The same of the right rear wheel.")] = "",
    velocity_feedback: Annotated[bool, opt(None, _VELOCITIES, "--velocity-feedback")] = False,
    open_loop: Annotated[bool, opt(None, _COMMANDS, "--open-loop")] = False,
    accept_implausible: cli.AcceptImplausible = "",
) -> None:
    """Write the coefficients for a vehicle, a controller, a simulator's model, or a calibration certificate.

    Example: calib export sample_runs/corridor --to ros2 --load 300 --load 500,700 --output params
    """
    from calib.coefficients.build import coefficients_of, export

    output = None if output == Path("-") else output
    cli.refuse_outputs(None if output is not None and output.is_dir() else output)
    accept = accept_implausible.strip()
    notes: list[str] = []
    head: dict[str, object] = {"to": to}
    if to not in KNOWN:
        raise BadInputError(f"--to: found {to!r}; expected one of {', '.join(KNOWN)}{cli.nearest(to, KNOWN)}")
    refuse_loads(load, to)
    unused: dict[str, object] = {} if to in PATCHING else {"--into": model, "--left": left, "--right": right}
    if to in OTHER_FORMATS:
        unused |= {"--date": date, "--outside": outside, "--controller": controller}
        unused |= {"--velocity-feedback": velocity_feedback, "--open-loop": open_loop}
    cli.refuse_options(f"with --to {to}", unused)
    artifacts: Sequence[Artifact]
    if to in BINARY and output is None:
        raise BadInputError(f"--output: found none; expected a file, since {to} is no text; give --output FILE.{to}")
    if to in OTHER_FORMATS:
        with cli.progress(to) as tick:
            artifacts = export_from(source, to, accept=accept, progress=tick)
    else:
        coefficients = coefficients_of(source, outside=outside, created=date, accept=accept)
        chosen = ExportOptions(parse_loads(load or []), tuple(controller or ()), model=model, left=left, right=right)
        options = replace(chosen, position_feedback=not velocity_feedback, open_loop=open_loop)
        artifacts = export(coefficients.file, to, options=options)
        notes += coefficients.notes
        head |= {name: getattr(coefficients.file, name) for name in ("checksum", "outside", "simulated")}
    notes += [text for artifact in artifacts for text in artifact.notes]
    files = _written(artifacts, output)
    cli.emit_json({**head, "files": files, "notes": notes})
    for text in notes:
        cli.note(text)
    if output is not None:
        # where the files went to standard output, nothing is added to them
        cli.then(f"export {to}", c=source, file=files[0]["path"])


def _written(artifacts: Sequence[Artifact], output: Path | None) -> list[dict[str, str]]:
    if output is not None:
        files = place(artifacts, output, force=cli.forced())
        cli.wrote([written["path"] for written in files])
        return files
    if cli.wants_stdout():
        return [{"name": artifact.name, "text": artifact.data.decode("utf-8")} for artifact in artifacts]
    cli.emit_text("---\n".join(artifact.data.decode("utf-8") for artifact in artifacts))
    return []


def report(
    source: Annotated[Path, arg("CAMPAIGN|RESULT", "Campaign folder, or result folder of calib fit, or its fit.json.")],
    into: Annotated[
        Place, opt("FILE|FOLDER", "PDF file, or folder for it; without it: reports/<campaign>.pdf.")
    ] = None,
    date: cli.Date = None,
    figures: cli.Figures = None,
    html: Annotated[Place, opt("FILE", "Write the same as one HTML page, too; with --diagnosis interactive.")] = None,
    diagnosis: Annotated[
        bool, opt(None, "Add the diagnosis of the gap between measured and simulated motion.", "--diagnosis")
    ] = False,
    seed: cli.Seed = 0,
    accept_implausible: cli.AcceptImplausible = "",
) -> int:
    """Write the report on a campaign as PDF/A-3, the coefficient file attached.

    The [report] section of campaign.toml states laboratory, customer, vehicle, instruments and dates. Exit status 1
    where a check says that the law should not be used as it is; the report is written all the same and says so, but
    numbers that cannot be are refused without --accept-implausible.
    Runs that allow no law, as loops do, give a report of their geometry.

    Example: calib report sample_runs/corridor_crossed --into corridor_crossed.pdf --date 2025-03-31
    """
    from calib.io import write_bytes, write_text
    from calib.reporting.content import place_of, report_of
    from calib.reporting.figures import write_figures
    from calib.reporting.pages import to_pdf
    from calib.reporting.source import issue_date, opened

    cli.refuse_outputs(html, into if into and into.suffix.lower() == ".pdf" and not into.is_dir() else None)
    issued, force, drawn = issue_date(date), cli.forced(), list[Path]()
    _refuse_targets(source, into, figures)
    with cli.progress("report") as tick:
        subject = opened(source, progress=tick)
        accept, drawn_by = accept_implausible.strip(), seed if diagnosis else None
        report = report_of(subject, issued=issued, accept=accept, seed=drawn_by, where=source, progress=tick)
        target = place_of(report.name, into, force=force)
        if figures is not None:
            drawn = write_figures(report.figures(), figures, simulated=report.simulated, force=force, progress=tick)
        page = "" if html is None else _page(report, subject, tick)
        write_bytes(target, to_pdf(report, tick), force=force)
    if html is not None:
        write_text(html, page, force=force)
    marked = ", simulated data" if report.simulated else ""
    cli.wrote([], what=f"{target} (report {report.report_id}{marked})")
    cli.wrote([] if html is None else [html])
    if drawn:
        cli.wrote([], what=f"{len(drawn)} figure files to {figures}")
    if not report.passed:
        what = "law" if report.geometry is None else "geometry"
        cli.say(f"A check failed: the {what} should not be used as it is; the report says why.")
    cli.then(_next_step(report, subject), c=source)
    cli.emit_json({"file": str(target), "figures": [str(path) for path in drawn], **report.to_dict()})
    return 0 if report.passed else 1


def _next_step(report: "Report", subject: "Fit | Campaign") -> str:
    from calib.campaign.model import Campaign

    if report.diagnosis is not None:
        from calib.reporting.topics.diagnosis import after_diagnosis

        return after_diagnosis(report.diagnosis)
    if report.geometry is not None:
        from calib.reporting.topics.geometry import after_geometry

        step = after_geometry(report.geometry, None)
        return "fit lacks runs" if step == "geometry lengths" else step
    stated = subject.extra if isinstance(subject, Campaign) else subject.provenance
    return ("report" if "certificate" in stated else "report unstated") if report.passed else "report failed"


def _refuse_targets(source: Path, into: Path | None, figures: Path | None) -> None:
    from calib.campaign.settings_file import read_settings
    from calib.reporting.content import place_of

    settings = source / "campaign.toml"
    if settings.is_file():
        place_of(read_settings(settings, str(settings)).name, into, force=cli.forced())
    if figures is not None:
        from calib.reporting.pages import GAP_PICTURES
        from calib.reporting.topics.fit import FIT_PICTURES

        cli.refuse_outputs(figures=figures, names=(*FIT_PICTURES, *GAP_PICTURES))


def _page(report: "Report", subject: "Fit | Campaign", tick: "Progress") -> str:
    from calib.campaign.model import Campaign
    from calib.reporting.pages import to_html

    tick(0, 0, "page")
    if report.diagnosis is None or not isinstance(subject, Campaign):
        return to_html(report)
    from calib.reporting.interactive import interactive_panels

    return to_html(report, interactive_panels(report.diagnosis, subject))
