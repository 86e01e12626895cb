"""`calib loads`: static wheel loads of a payload or a sweep, or the payload from three weighed wheels."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer

from calib.cli.output import FORCE, JSON, emit_json, say, table, wants_stdout

__all__ = ["register"]

EPILOG = "Example: calib loads --payload 100 --x 0.5 --sweep y --from -0.2333 --to 0.2333 --figures loads"

COLUMNS = {"payload": "payload_kg", "x": "payload_x_m", "y": "payload_y_m"}


def register(application: typer.Typer, name: str) -> None:
    """Add the command to `application`."""

    @application.command(name, epilog=EPILOG)
    def loads(
        payload: float = typer.Option(0.0, "--payload", metavar="KG", help="Mass of the payload."),
        x: float = typer.Option(0.0, "--x", metavar="M", help="Its centre of mass ahead of the rear axle."),
        y: float = typer.Option(0.0, "--y", metavar="M", help="Its centre of mass left of the centre line."),
        sweep: str | None = typer.Option(None, "--sweep", metavar="WHAT", help="Vary payload, x or y (Fig. 3)."),
        first: float | None = typer.Option(None, "--from", help="First value of the sweep."),
        last: float | None = typer.Option(None, "--to", help="Last value of the sweep."),
        steps: int = typer.Option(21, "--steps", help="Values of the sweep."),
        weighed: str | None = typer.Option(
            None, "--weighed", metavar="F,L,R", help="Weighed loads in N (front,left,right): find the payload instead."
        ),
        sigma: float = typer.Option(0.0, "--sigma", metavar="N", help="Standard uncertainty of each weighing."),
        vehicle: Path | None = typer.Option(
            None, "--vehicle", metavar="CAMPAIGN|COEFFICIENTS", help="Take the vehicle from there."
        ),
        mass: float | None = typer.Option(None, "--mass", metavar="KG", help="Mass of the vehicle."),
        cog_x: float | None = typer.Option(None, "--cog-x", metavar="M", help="Its centre of mass, ahead of the axle."),
        cog_y: float | None = typer.Option(None, "--cog-y", metavar="M", help="Its centre of mass, left positive."),
        track: float | None = typer.Option(None, "--track", metavar="M", help="Track."),
        wheelbase: float | None = typer.Option(None, "--wheelbase", metavar="M", help="Wheelbase."),
        max_load: float | None = typer.Option(None, "--max-load", metavar="N", help="Permissible wheel load."),
        figures: Path | None = typer.Option(None, "--figures", metavar="FOLDER", help="Write the figure there."),
        json: str | None = JSON,
        force: bool = FORCE,
    ) -> None:
        """Compute static wheel loads (Eqs 1 and 2 with the force balance), or the payload from weighed wheels.

        A payload under which a wheel would lift or carry more than is permitted is refused.
        """
        from calib.errors import BadInputError
        from calib.motion.studies.vehicle_source import vehicle_of

        found = vehicle_of(
            vehicle,
            mass_kg=mass,
            cog_x_m=cog_x,
            cog_y_m=cog_y,
            track_m=track,
            wheelbase_m=wheelbase,
            max_wheel_load_N=max_load,
        )
        if weighed is not None:
            _weighed(found, weighed, sigma, json, force)
            return
        if sweep is not None and (sweep not in COLUMNS or first is None or last is None):
            raise BadInputError(
                f"--sweep: found {sweep!r}; expected payload, x or y, with --from and --to; give all three"
            )
        _loads(found, (payload, x, y), (sweep, first or 0.0, last or 0.0, steps), figures, json, force)


def _loads(
    vehicle: Any,
    payload: tuple[float, float, float],
    sweep: tuple[str | None, float, float, int],
    figures: Path | None,
    json: str | None,
    force: bool,
) -> None:
    from dataclasses import asdict

    from calib.motion.studies.load_sweep import sweep_loads

    what, first, last, steps = sweep
    made = sweep_loads(vehicle, *payload, swept=COLUMNS[what] if what else "", span=(first, last), steps=steps)
    rows = made.rows()
    written: list[str] = []
    if figures is not None:
        from calib.report.figures.motion import load_figure, save

        stem = "fig3b" if what == "payload" else "fig3a" if what == "y" else "loads"
        written = [str(path) for path in save(load_figure(made), figures, stem, force=force)]
    emit_json(
        {"vehicle": asdict(vehicle), "swept": made.swept or None, "loads": rows, "figures": written}, json, force=force
    )
    if wants_stdout(json):
        return
    header = ("payload", "x", "y", "front", "left", "right", "sum")
    table(
        f"Wheel loads (track {vehicle.track_m:g} m, wheelbase {vehicle.wheelbase_m:g} m, mass {vehicle.mass_kg:g} kg)",
        header,
        (
            (
                f"{row['payload_kg']:.4g} kg",
                f"{row['payload_x_m']:.4f} m",
                f"{row['payload_y_m']:.4f} m",
                *(f"{row[key]:.2f} N" for key in ("front_N", "left_N", "right_N", "total_N")),
            )
            for row in rows
        ),
    )
    for path in written:
        say(f"wrote {path}")


def _weighed(vehicle: Any, text: str, sigma: float, json: str | None, force: bool) -> None:
    from dataclasses import asdict

    from calib.motion.studies.numbers import numbers
    from calib.vehicle import payload_from_wheel_loads

    front, left, right = numbers(text, 3, "--weighed")
    found = payload_from_wheel_loads(vehicle, front, left, right, sigma_N=sigma)
    emit_json({"vehicle": asdict(vehicle), **asdict(found), "sigma_N": sigma}, json, force=force)
    if wants_stdout(json):
        return
    rows = [
        ("mass", f"{found.payload_kg:.3f} kg", f"{2 * found.payload_std_kg:.2g} kg"),
        ("ahead of the rear axle, x", f"{found.payload_x_m:.4f} m", f"{2 * found.payload_x_std_m:.2g} m"),
        ("left of the centre line, y", f"{found.payload_y_m:.4f} m", f"{2 * found.payload_y_std_m:.2g} m"),
    ]
    table(
        "Payload from three weighed wheels",
        ("quantity", "value", "± (k = 2)"),
        rows if sigma else [(*row[:2], "not given") for row in rows],
    )
