"""What a computation of wheel loads says."""

from __future__ import annotations

from calib.motion.studies.load_sweep import LoadSweep
from calib.report.blocks import Block, Column, Table
from calib.report.numbers import fixed, left, measured
from calib.vehicle import Vehicle, WeighedPayload


def loads_content(vehicle: Vehicle, sweep: LoadSweep) -> tuple[Block, ...]:
    """Return the wheel loads of a payload or a sweep."""
    columns = (
        Column("mass", "kg", group="Payload"),
        Column("x", "m", group="Payload"),
        Column("y", "m", group="Payload"),
        *(Column(title, "N", group="Wheel load") for title in ("front", "left", "right", "sum")),
    )
    rows = tuple(
        (
            f"{row['payload_kg']:.4g}",
            fixed(row["payload_x_m"], 4),
            fixed(row["payload_y_m"], 4),
            *(fixed(row[key], 2) for key in ("front_N", "left_N", "right_N", "total_N")),
        )
        for row in sweep.rows()
    )
    caption = (
        f"Wheel loads (track {vehicle.track_m:g} m, wheelbase {vehicle.wheelbase_m:g} m, mass {vehicle.mass_kg:g} kg)."
    )
    return (Table(caption, columns, rows),)


def weighed_content(payload: WeighedPayload, *, known: bool) -> tuple[Block, ...]:
    """Return the payload found from three weighed wheels."""
    rows = []
    for title, unit, value, std, decimals in (
        ("mass", "kg", payload.payload_kg, payload.payload_std_kg, 3),
        ("ahead of the rear axle, x", "m", payload.payload_x_m, payload.payload_x_std_m, 4),
        ("left of the centre line, y", "m", payload.payload_y_m, payload.payload_y_std_m, 4),
    ):
        cells = measured(value, 2 * std) if known else (fixed(value, decimals), "not given")
        rows.append((title, unit, *cells))
    columns = (left("Quantity"), left("Unit"), Column("Value"), Column("±"))
    return (Table("Payload from three weighed wheels; ± is 95 % (k = 2).", columns, tuple(rows)),)
