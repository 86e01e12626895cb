"""`calib loads`: static wheel loads of a payload or a sweep, or the payload from three weighed wheels."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Final

import typer

from calib.cli.terminal import Figures, Force, JsonTarget, answer, nearest, numbers, wants_stdout, wrote
from calib.errors import BadInputError
from calib.io import refuse_existing

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
    figures: Figures = None,
    json: JsonTarget = None,
    force: Force = False,
) -> None:
    """Compute static wheel loads (Eqs 1 and 2 with the force balance), or the payload from weighed wheels.

    A payload under which a wheel would lift or carry more than is permitted is refused.

    Example: calib loads --payload 100 --x 0.5 --sweep y --from -0.2333 --to 0.2333 --figures loads
    """
    from calib.odometry.law_journey import vehicle_of

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
        _weighed(meant, weighed, sigma, json, force)
        return
    if sweep is not None and (sweep not in COLUMNS or first is None or last is None):
        raise BadInputError(
            f"--sweep: found {sweep!r}; expected payload, x or y, with --from and --to; give all three"
            + ("" if sweep in COLUMNS else nearest(sweep, COLUMNS))
        )
    _loads(meant, (payload, x, y), (sweep, first or 0.0, last or 0.0, steps), figures, json, force)


def _loads(
    vehicle: Any,
    payload: tuple[float, float, float],
    sweep: tuple[str | None, float, float, int],
    figures: Path | None,
    json: str | None,
    force: bool,
) -> None:
    from dataclasses import asdict

    from calib.odometry.law_journey import sweep_loads
    from calib.reporting.figures.style import FORMS, write_figures
    from calib.reporting.topics.simulation import loads_content

    what, first, last, steps = sweep
    stem = STEMS.get(what or "", "loads")
    refuse_existing([figures / f"{stem}.{form}" for form in FORMS] if figures else (), force=force)
    swept = sweep_loads(vehicle, *payload, swept=COLUMNS[what] if what else "", span=(first, last), steps=steps)
    written: list[Path] = []
    if figures is not None:
        from calib.reporting.figures.motion import load_figure

        written = write_figures({stem: load_figure(swept)}, figures, force=force)
    document = {
        "vehicle": asdict(vehicle),
        "swept": swept.swept or None,
        "loads": swept.rows(),
        "figures": [str(path) for path in written],
    }
    answer(document, loads_content(vehicle, swept), json=json, force=force)
    if not wants_stdout(json):
        wrote(written)


def _weighed(vehicle: Any, text: str, sigma: float, json: str | None, force: bool) -> None:
    from dataclasses import asdict

    from calib.reporting.topics.simulation import weighed_content
    from calib.vehicle import payload_from_wheel_loads

    front, left, right = numbers(text, 3, "--weighed")
    weighed = payload_from_wheel_loads(vehicle, front, left, right, sigma_N=sigma)
    document = {"vehicle": asdict(vehicle), **asdict(weighed), "sigma_N": sigma}
    answer(document, weighed_content(weighed, known=sigma > 0), json=json, force=force)
