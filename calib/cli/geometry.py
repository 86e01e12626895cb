"""`calib geometry`: radii and track together, with the reference's sensor, from end poses or along the way."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from calib.cli import terminal
from calib.errors import BadInputError

USING = {"end-poses": "end_poses", "windows": "windows"}
LEAVE_OUT = {"session": "session", "kind": "kind", "run": "run_id"}
#: the result, and the picture, in their folders
RESULT_FILE, PICTURE = "geometry.json", "geometry_paths"


def run(
    campaign: terminal.CampaignOrRecording,
    using: Annotated[
        str | None, typer.Option(metavar="WHAT", help="end-poses or windows; without it what the campaign has.")
    ] = None,
    kind: Annotated[
        list[str] | None, typer.Option(metavar="KIND", help="Use runs of this kind alone; may be given again.")
    ] = None,
    leave_out: Annotated[
        str | None, typer.Option(metavar="WHAT", help="Leave each session, kind or run out in turn: end errors.")
    ] = None,
    into: Annotated[Path | None, typer.Option(metavar="FOLDER", help="Write the result there (geometry.json).")] = None,
    output: Annotated[Path | None, typer.Option(metavar="COEFFICIENTS", help="Write a coefficient file.")] = None,
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
    from calib.reporting.next_step import after_geometry
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
