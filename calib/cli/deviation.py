"""`calib deviation`: what a path beside the line does to a radius (Figs 8 and 9); `calib loads`: static wheel loads."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final

from calib.cli import terminal
from calib.cli.terminal import arg, opt
from calib.errors import BadInputError

DISTANCE_M: Final = 40.0
AMPLITUDES_M: Final = (0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 1.0)
WAVELENGTHS_M: Final = (40.0, 5.0)


def deviation(
    campaign: Annotated[
        Path | None, arg("[CAMPAIGN]", "Campaign whose runs are judged; without it only the table is made.")
    ] = None,
    tolerance: Annotated[float, opt("SHARE", "Largest relative error of a radius.")] = 0.0005,
    amplitude: Annotated[
        list[float] | None, opt("M", "Amplitude of the weave in the table; may be given again.")
    ] = None,
    wavelength: Annotated[
        list[float] | None, opt("M", "Wavelength of the weave in the table; may be given again.")
    ] = None,
    distance: Annotated[float | None, opt("M", "Distance S_O of the table; 40 m, or the campaign's median.")] = None,
    track: Annotated[float | None, opt("M", "Distance between the wheels; 0.7 m, or the campaign's.")] = None,
    radius_ratio: Annotated[
        float | None, opt("E_R", "Also show the steady arc of wheels with r_R / r_L = E_R.")
    ] = None,
) -> int:
    """Show the error that a woven path or a steady arc adds to a radius, and judge each run.

    Exit status 1 where a run's path moved a radius by more than the tolerance.

    Example: calib deviation sample_runs/corridor --tolerance 0.0005; calib deviation --amplitude 0.5 --wavelength 5
    """
    from calib.campaign.read import read_campaign
    from calib.radius import deviation as table
    from calib.radius.run_deviation import judge_runs
    from calib.reporting.topics.runs import arc_content, runs_content, weave_content

    with terminal.waiting("reading"):
        read = None if campaign is None else read_campaign(campaign)
        judged = None if read is None else judge_runs(read, tolerance)
    distance_m, track_m = table.table_setting(read, distance, track, default_distance_m=DISTANCE_M)
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
    terminal.then("deviation CAMPAIGN" if campaign else "deviation", c=campaign or "")
    return 0 if judged is None or judged.passed else 1


COLUMNS: Final = {"payload": "payload_kg", "x": "payload_x_m", "y": "payload_y_m"}
#: what is swept -> name of the figure's files
STEMS: Final = {"payload": "fig3b", "y": "fig3a"}


def loads(
    payload: Annotated[float, opt("KG", "Mass of the payload.")] = 0.0,
    x: Annotated[float, opt("M", "Its centre of mass ahead of the rear axle.")] = 0.0,
    y: Annotated[float, opt("M", "Its centre of mass left of the centre line.")] = 0.0,
    sweep: Annotated[str | None, opt("WHAT", "Vary payload, x or y (Fig. 3).")] = None,
    first: Annotated[float | None, opt(None, "First value of the sweep.", "--from")] = None,
    last: Annotated[float | None, opt(None, "Last value of the sweep.", "--to")] = None,
    steps: Annotated[int, opt(None, "Values of the sweep.")] = 21,
    weighed: Annotated[
        str | None, opt("F,L,R", "Weighed loads in N (front,left,right): find the payload instead.")
    ] = None,
    sigma: Annotated[float, opt("N", "Standard uncertainty of each weighing.")] = 0.0,
    vehicle: Annotated[Path | None, opt("CAMPAIGN|COEFFICIENTS", "Take the vehicle from there.")] = None,
    mass: Annotated[float | None, opt("KG", "Mass of the vehicle.")] = None,
    cog_x: Annotated[float | None, opt("M", "Its centre of mass, ahead of the axle.")] = None,
    cog_y: Annotated[float | None, opt("M", "Its centre of mass, left positive.")] = None,
    track: Annotated[float | None, opt("M", "Track.")] = None,
    wheelbase: Annotated[float | None, opt("M", "Wheelbase.")] = None,
    max_load: Annotated[float | None, opt("N", "Permissible wheel load.")] = None,
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
    written: list[Path] = []
    if figures is not None:
        from calib.reporting.figures.motion import load_figure

        written = terminal.draw(lambda: {stem: load_figure(swept)}, figures)
    document = {"vehicle": asdict(meant), "swept": swept.swept or None, "loads": swept.rows()}
    terminal.answer(document | {"figures": list(map(str, written))}, loads_content(meant, swept))
    terminal.then("loads")
