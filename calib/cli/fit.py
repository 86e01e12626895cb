"""`calib fit`: the radius law of each wheel; `calib geometry`: radii and track, with the reference's sensor."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from calib.cli import terminal
from calib.cli.terminal import opt
from calib.errors import BadInputError

if TYPE_CHECKING:
    from calib.coefficients.export import Source
    from calib.radius.result import Fit
    from calib.reporting.blocks import Block


def fit(
    campaign: terminal.CampaignOrRecording,
    into: Annotated[Path | None, opt("FOLDER", "Result folder: fit.json and runs.csv, for report and export.")] = None,
    reference_load: Annotated[
        float | None,
        opt("N", "Load on which the coefficients are centred; without it: reference_load_N of campaign.toml."),
    ] = None,
    model: Annotated[
        Path | None,
        opt("FILE", "Coefficient file whose law the fitted one is held against, at that law's reference load."),
    ] = None,
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

    from calib import __version__
    from calib.campaign.read import read_or_ingest
    from calib.radius.fit import fit_campaign
    from calib.radius.result import FIT_FILE, RUNS_FILE, provenance, write_result
    from calib.reporting.topics.fit import FIT_PICTURES, fit_content, fit_pictures

    results = [] if into is None else [into / FIT_FILE, into / RUNS_FILE]
    terminal.refuse_outputs(*results, *terminal.figure_files(figures, FIT_PICTURES))
    believed, reference_load = _believed(model, reference_load)
    with terminal.progress("fitting") as tick:
        read = read_or_ingest(campaign, mapping=mapping, progress=tick)
        fitted = fit_campaign(read, reference_load_N=reference_load)
    arguments = {"campaign": campaign.name, "reference_load_N": reference_load}
    fitted = replace(fitted, provenance=provenance(read, version=__version__, arguments=arguments))
    document, content = fitted.to_dict(), fit_content(fitted, runs=runs)
    if believed is not None:
        comparison, blocks = _compared(fitted, believed)
        document["model_comparison"] = comparison
        content = (*content[:-1], *blocks, content[-1])
    if not terminal.wants_stdout():
        terminal.show(content)
    terminal.wrote([] if into is None else [write_result(fitted, into, force=terminal.forced())])
    if figures is not None:
        terminal.draw(lambda: {one.name: one.draw() for one in fit_pictures(fitted)}, figures)
    terminal.emit_json(document)
    terminal.then("fit" if fitted.passed else "fit failed", c=campaign)
    return 0 if fitted.passed else 1


def _believed(model: Path | None, reference_load: float | None) -> tuple[Source | None, float | None]:
    """Return the coefficients that a simulator believes, and the load to fit at."""
    if model is None:
        return None, reference_load
    from calib.coefficients.export import coefficients_of

    if reference_load is not None:
        raise BadInputError(
            "--reference-load: found with --model; expected one of them, since the model brings its own; leave one out"
        )
    source = coefficients_of(model)
    return source, source.file.law.left.reference_load_N


def _compared(fitted: Fit, believed: Source) -> tuple[dict[str, object], tuple[Block, ...]]:
    """Return the fit held against the model, as plain values and as blocks."""
    from calib.coefficients.export import effects_left_out
    from calib.radius.comparison import compare_laws
    from calib.reporting.topics.fit import comparison_content

    notes = (*believed.notes, *effects_left_out(believed.file, "not compared"))
    compared = compare_laws(fitted.left, fitted.right, believed.file.law)
    return compared.to_dict() | {"notes": list(notes)}, comparison_content(compared, notes)


USING = {"end-poses": "end_poses", "windows": "windows"}
LEAVE_OUT = {"session": "session", "kind": "kind", "run": "run_id"}
#: the result, and the picture, in their folders
RESULT_FILE, PICTURE = "geometry.json", "geometry_paths"


def geometry(
    campaign: terminal.CampaignOrRecording,
    using: Annotated[str | None, opt("WHAT", "end-poses or windows; without it what the campaign has.")] = None,
    kind: Annotated[list[str] | None, opt("KIND", "Use runs of this kind alone; may be given again.")] = None,
    leave_out: Annotated[str | None, opt("WHAT", "Leave each session, kind or run out in turn: end errors.")] = None,
    into: Annotated[Path | None, opt("FOLDER", "Write the result there (geometry.json).")] = None,
    output: Annotated[Path | None, opt("COEFFICIENTS", "Write a coefficient file.")] = None,
    figures: terminal.Figures = None,
    mapping: terminal.MappingOption = None,
    accept_implausible: terminal.AcceptImplausible = "",
) -> int:
    """Estimate radii, track and the reference's sensor together, with intervals.

    From end poses (any routes; squares both ways by UMBmark too) or by windows along the way. The coefficient file is
    what export, diagnose --model and simulate take. The result is judged by what it leaves on held-out runs beside the
    noise. Status 1, and no coefficient file without a reason, where it is doubtful or wrong.

    Example: calib geometry my_squares --figures pictures --output coefficients.json
    """
    from calib.campaign.read import read_or_ingest
    from calib.kinematics.estimate import estimate_geometry
    from calib.reporting.present import after_geometry
    from calib.reporting.topics.geometry import geometry_content

    way, left_out = _choice("--using", using, USING), _choice("--leave-out", leave_out, LEAVE_OUT)
    result = into / RESULT_FILE if into is not None else None
    terminal.refuse_outputs(output, result, *terminal.figure_files(figures, [PICTURE]))
    with terminal.progress("estimating") as tick:
        read = read_or_ingest(campaign, mapping=mapping, progress=tick)
        estimated = estimate_geometry(read, using=way, kinds=kind or (), leave_out=left_out, progress=tick)
    terminal.show(geometry_content(estimated))
    document = estimated.to_dict()
    terminal.save(result, document)
    if figures is not None:
        from calib.kinematics.estimate import traces_of
        from calib.reporting.figures.geometry import draw_paths

        paths = traces_of(read, estimated)
        terminal.draw(lambda: {PICTURE: draw_paths(paths, simulated=estimated.simulated)}, figures)
    terminal.emit_json(document)
    if output is not None:
        from calib.coefficients.build import from_geometry

        terminal.save(output, from_geometry(estimated, read, accept=accept_implausible.strip()).to_bytes())
    terminal.then(after_geometry(estimated, output), c=campaign, file=output or "")
    return 0 if estimated.passed else 1


def _choice(option: str, given: str | None, known: dict[str, str]) -> Any:
    if given is not None and given not in known:
        near = terminal.nearest(given, known)
        raise BadInputError(f"{option}: found {given!r}; expected one of {', '.join(known)}; choose one of them{near}")
    return None if given is None else known[given]
