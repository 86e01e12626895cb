"""`calib loads`: static wheel loads of a payload or a sweep, or the payload from three weighed wheels."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from calib.cli import terminal
from calib.errors import BadInputError

if TYPE_CHECKING:
    from calib.odometry.law_journey import LoadSweep

COLUMNS: Final = {"payload": "payload_kg", "x": "payload_x_m", "y": "payload_y_m"}
#: what is swept -> name of the figure's files
STEMS: Final = {"payload": "fig3b", "y": "fig3a"}


def run(
    payload: Annotated[float, typer.Option(metavar="KG", help="Mass of the payload.")] = 0.0,
    x: Annotated[float, typer.Option(metavar="M", help="Its centre of mass ahead of the rear axle.")] = 0.0,
    y: Annotated[float, typer.Option(metavar="M", help="Its centre of mass left of the centre line.")] = 0.0,
    sweep: Annotated[str | None, typer.Option(metavar="WHAT", help="Vary payload, x or y (Fig. 3).")] = None,
    first: Annotated[float | None, typer.Option("--from", help="First value of the sweep.")] = None,
    last: Annotated[float | None, typer.Option("--to", help="Last value of the sweep.")] = None,
    steps: Annotated[int, typer.Option(help="Values of the sweep.")] = 21,
    weighed: Annotated[
        str | None,
        typer.Option(metavar="F,L,R", help="Weighed loads in N (front,left,right): find the payload instead."),
    ] = None,
    sigma: Annotated[float, typer.Option(metavar="N", help="Standard uncertainty of each weighing.")] = 0.0,
    vehicle: Annotated[
        Path | None, typer.Option(metavar="CAMPAIGN|COEFFICIENTS", help="Take the vehicle from there.")
    ] = None,
    mass: Annotated[float | None, typer.Option(metavar="KG", help="Mass of the vehicle.")] = None,
    cog_x: Annotated[float | None, typer.Option(metavar="M", help="Its centre of mass, ahead of the axle.")] = None,
    cog_y: Annotated[float | None, typer.Option(metavar="M", help="Its centre of mass, left positive.")] = None,
    track: Annotated[float | None, typer.Option(metavar="M", help="Track.")] = None,
    wheelbase: Annotated[float | None, typer.Option(metavar="M", help="Wheelbase.")] = None,
    max_load: Annotated[float | None, typer.Option(metavar="N", help="Permissible wheel load.")] = None,
    figures: terminal.Figures = None,
) -> None:
    """Compute static wheel loads (Eqs 1 and 2 with the force balance), or the payload from weighed wheels.

    A payload under which a wheel would lift or carry more than is permitted is refused.

    Example: calib loads --payload 100 --x 0.5 --sweep y --from -0.2333 --to 0.2333 --figures loads
    """
    from dataclasses import asdict

    from calib.odometry.law_journey import sweep_loads, vehicle_of
    from calib.reporting.topics.simulation import loads_content, weighed_content
    from calib.vehicle import payload_from_wheel_loads

    meant = vehicle_of(
        vehicle,
        mass_kg=mass,
        cog_x_m=cog_x,
        cog_y_m=cog_y,
        track_m=track,
        wheelbase_m=wheelbase,
        max_wheel_load_N=max_load,
    )
    if weighed is not None:
        front, left, right = terminal.numbers(weighed, 3, "--weighed")
        known = payload_from_wheel_loads(meant, front, left, right, sigma_N=sigma)
        document = {"vehicle": asdict(meant), **asdict(known), "sigma_N": sigma}
        terminal.answer(document, weighed_content(known, known=sigma > 0))
        terminal.then("loads")
        return
    if sweep is not None and (sweep not in COLUMNS or first is None or last is None):
        near = "" if sweep in COLUMNS else terminal.nearest(sweep, COLUMNS)
        raise BadInputError(f"--sweep: found {sweep!r}; expected payload, x or y, with --from and --to{near}")
    stem = STEMS.get(sweep or "", "loads")
    terminal.refuse_outputs(*terminal.figure_files(figures, [stem]))
    swept_column, span = COLUMNS[sweep] if sweep else "", (first or 0.0, last or 0.0)
    swept = sweep_loads(meant, payload, x, y, swept=swept_column, span=span, steps=steps)
    written = [] if figures is None else _drawn(stem, swept, figures)
    document = {"vehicle": asdict(meant), "swept": swept.swept or None, "loads": swept.rows()}
    terminal.answer(document | {"figures": list(map(str, written))}, loads_content(meant, swept))
    terminal.then("loads")


def _drawn(stem: str, swept: LoadSweep, folder: Path) -> list[Path]:
    from calib.reporting.figures.motion import load_figure

    return terminal.draw(lambda: {stem: load_figure(swept)}, folder)
