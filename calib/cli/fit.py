"""`calib fit`: the radius law of each wheel, with intervals, checks and budget."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib.cli.options import Force, JsonTarget, MappingOption, refuse_existing
from calib.cli.terminal import emit_json, progress, show, wants_stdout, wrote
from calib.errors import BadInputError

if TYPE_CHECKING:
    from calib.radius.fitted import Fit

__all__ = ["EPILOG", "run"]

EPILOG = "Example: calib fit sample_runs/corridor --into results/corridor"


def run(
    campaign: Annotated[
        Path, typer.Argument(metavar="CAMPAIGN", help="Folder with campaign.toml and runs.csv, or a recording.")
    ],
    into: Annotated[
        Path | None,
        typer.Option("--into", metavar="FOLDER", help="Result folder: fit.json and runs.csv, for report and export."),
    ] = None,
    reference_load: Annotated[
        float | None,
        typer.Option(
            "--reference-load",
            metavar="N",
            help="Load on which the coefficients are centred; without it: reference_load_N of campaign.toml.",
        ),
    ] = None,
    model: Annotated[
        Path | None,
        typer.Option(
            "--model",
            metavar="FILE",
            help="Coefficient file whose law the fitted one is held against, at that law's reference load.",
        ),
    ] = None,
    runs: Annotated[bool, typer.Option("--runs", help="List the radius of every run.")] = False,
    figures: Annotated[
        Path | None,
        typer.Option("--figures", metavar="FOLDER", help="Write the report's figures there as PNG, SVG and PDF."),
    ] = None,
    mapping: MappingOption = None,
    json: JsonTarget = None,
    force: Force = False,
) -> int:
    """Fit each wheel's effective radius against its load.

    The intervals allow for what runs of one session have in common. Exit status 1 where a check says that the law
    should not be used as it is; what --model shows is told, and does not change it.
    """
    from dataclasses import replace

    from calib import __version__
    from calib.campaign.opening import read_or_ingest
    from calib.coefficients.source import coefficients_of, effects_left_out
    from calib.radius.comparison import compare_laws
    from calib.radius.fit import fit_campaign
    from calib.radius.result import FIT_FILE, RUNS_FILE, provenance, write_result
    from calib.report.statements.fit import comparison_content, fit_content

    results = (into / FIT_FILE, into / RUNS_FILE) if into else ()
    refuse_existing([json, *results, *_pictures(figures)], force=force)
    believed = None
    if model is not None:
        if reference_load is not None:
            raise BadInputError(
                "--reference-load: found with --model; expected one of them, since the model brings its own; leave one "
                "out"
            )
        believed = coefficients_of(model)
        reference_load = believed.file.law.left.reference_load_N
    with progress("fitting") as tick:
        read = read_or_ingest(campaign, mapping=mapping, progress=tick)
        fitted = fit_campaign(read, reference_load_N=reference_load)
    arguments = {"campaign": campaign.name, "reference_load_N": reference_load}
    fitted = replace(fitted, provenance=provenance(read, version=__version__, arguments=arguments))
    document = fitted.to_dict()
    content = fit_content(fitted, runs=runs)
    if believed is not None:
        compared = compare_laws(fitted.left, fitted.right, believed.file.law)
        left_out = (*believed.notes, *effects_left_out(believed.file, "not compared"))
        document["model_comparison"] = compared.to_dict() | {"notes": list(left_out)}
        content = (*content[:-1], *comparison_content(compared, left_out), content[-1])
    if not wants_stdout(json):
        show(content)
    if into is not None:
        wrote([write_result(fitted, into, force=force)], target=json)
    if figures is not None:
        _draw(fitted, figures, json, force=force)
    emit_json(document, json, force=force)
    return 0 if fitted.passed else 1


def _pictures(folder: Path | None) -> list[Path]:
    """Return the files of the figures, so that existing ones are refused before the work."""
    if folder is None:
        return []
    from calib.report.figures.files import figure_paths
    from calib.report.statements.fit_pictures import FIT_PICTURES

    return figure_paths(folder, FIT_PICTURES)


def _draw(fitted: Fit, folder: Path, json: str | None, *, force: bool) -> None:
    from calib.report.figures.files import write_figures
    from calib.report.statements.fit_pictures import fit_pictures

    with progress("drawing") as tick:
        drawn = {picture.name: picture.draw() for picture in fit_pictures(fitted)}
        written = write_figures(drawn, folder, force=force, progress=tick)
    wrote(written, target=json, what=f"{len(written)} figure files to {folder}")
