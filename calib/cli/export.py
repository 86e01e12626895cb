"""`calib export`: the coefficients in the form that vehicle, controller or colleague needs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib.cli import terminal
from calib.coefficients.formats import FORMATS
from calib.errors import BadInputError
from calib.reporting.exports import BINARY
from calib.reporting.exports import FORMATS as OTHER_FORMATS

if TYPE_CHECKING:
    from calib.coefficients.formats import Artifact


Loads = Annotated[
    list[str] | None,
    typer.Option(
        "--load", metavar="N", help="Load point, N for both wheels or LEFT,RIGHT; may be given again (ros2, csv)."
    ),
]
Controllers = Annotated[
    list[str] | None,
    typer.Option(
        "--controller",
        metavar="NAME",
        help="ROS 2 controller, may be given again; without it those of the vehicle's drive.",
    ),
]
VelocityFeedback = Annotated[
    bool, typer.Option("--velocity-feedback", help="ROS 2: the joints report velocities, not positions.")
]
OpenLoop = Annotated[
    bool, typer.Option("--open-loop", help="ROS 2: odometry from the commands, not from the encoders.")
]

Output = Annotated[
    Path | None, typer.Option(help="File, or folder where several files are made; without it, or '-': standard output.")
]
Outside = Annotated[
    str | None, typer.Option(metavar="RULE", help="Loads that were not measured: refuse (the default) or clamp.")
]
Model = Annotated[
    Path | None,
    typer.Option("--into", metavar="MODEL", help="Your simulator's model; a copy is patched (mjcf, urdf, sdf)."),
]
Left = Annotated[str, typer.Option(metavar="NAME", help="Joint, body or link of the left rear wheel in MODEL.")]
Right = Annotated[str, typer.Option(metavar="NAME", help="The same of the right rear wheel.")]


def run(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="CAMPAIGN|FIT", help="Campaign, result folder of calib fit, its fit.json, or coefficients.json."
        ),
    ],
    to: Annotated[
        str, typer.Option(metavar="FORMAT", help=f"{', '.join((*FORMATS, *OTHER_FORMATS))}; json is the master.")
    ],
    output: Output = None,
    load: Loads = None,
    outside: Outside = None,
    date: Annotated[str | None, typer.Option(metavar="YYYY-MM-DD", help="Date written into the file.")] = None,
    controller: Controllers = None,
    model: Model = None,
    left: Left = "",
    right: Right = "",
    velocity_feedback: VelocityFeedback = False,
    open_loop: OpenLoop = False,
    accept_implausible: terminal.AcceptImplausible = "",
) -> None:
    """Write the coefficients for a vehicle, a controller, a simulator's model, or a calibration certificate.

    Example: calib export sample_runs/corridor --to ros2 --load 300 --load 500,700 --output params
    """
    from calib.coefficients.export import coefficients_of, export, parse_loads
    from calib.coefficients.formats import ExportOptions

    # a dash is standard output, as for --json
    output = None if output == Path("-") else output
    terminal.refuse_outputs(output if output is not None and output.is_file() else None)
    accept = accept_implausible.strip()
    notes: list[str] = []
    head: dict[str, object] = {"to": to}
    if to in OTHER_FORMATS:
        artifacts = _of_other_format(source, to, output, accept)
    else:
        coefficients = coefficients_of(source, outside=outside, created=date, accept=accept)
        options = ExportOptions(
            loads=parse_loads(load or []),
            controllers=tuple(controller or ()),
            position_feedback=not velocity_feedback,
            open_loop=open_loop,
            model=model,
            left=left,
            right=right,
        )
        artifacts = export(coefficients.file, to, options=options)
        notes += coefficients.notes
        head |= {name: getattr(coefficients.file, name) for name in ("checksum", "outside", "simulated")}
    notes += [text for artifact in artifacts for text in artifact.notes]
    for text in notes:
        terminal.note(text)
    files = _written(artifacts, output)
    if output is not None:
        # where the files went to standard output, nothing is added to them
        terminal.then(f"export {to}", c=source, file=output)
    terminal.emit_json({**head, "files": files, "notes": notes})


def _of_other_format(source: Path, to: str, output: Path | None, accept: str) -> Sequence[Artifact]:
    """Return the files of a format that needs the fit or the runs beside the coefficients."""
    from calib.reporting.exports import export_from

    if to in BINARY and output is None:
        raise BadInputError(f"--output: found none; expected a file, since {to} is no text; give --output FILE.{to}")
    with terminal.progress(to) as tick:
        return export_from(source, to, accept=accept, progress=tick)


def _written(artifacts: Sequence[Artifact], output: Path | None) -> list[dict[str, str]]:
    """Write the files, or their text to standard output, or into the JSON where that goes there."""
    from calib.coefficients.export import place

    if output is not None:
        files = place(artifacts, output, force=terminal.forced())
        terminal.wrote([written["path"] for written in files])
        return files
    if terminal.wants_stdout():
        return [{"name": artifact.name, "text": artifact.data.decode("utf-8")} for artifact in artifacts]
    terminal.emit_text("---\n".join(artifact.data.decode("utf-8") for artifact in artifacts))
    return []
