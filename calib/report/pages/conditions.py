"""Instruments, place, dates and conditions."""

from __future__ import annotations

from calib.report.blocks import Facts, Section, Text
from calib.report.numbers import span
from calib.report.source import Source
from calib.report.statements.assumed import assumed_text

_CONDITIONS = {
    "temperature_C": ("Temperature of the hall", "°C", ".1f"),
    "speed_mps": ("Set speed", "m/s", ".3g"),
    "distance_m": ("Length of the runs", "m", ".2f"),
    "payload_kg": ("Payload", "kg", ".4g"),
    "payload_x_m": ("Payload ahead of the rear axle", "m", ".3f"),
    "payload_y_m": ("Payload left of the centre line", "m", ".3f"),
    "load_left_N": ("Load of the left wheel", "N", ".0f"),
    "load_right_N": ("Load of the right wheel", "N", ".0f"),
    "minutes_under_load": ("Time under load before a run", "min", ".3g"),
}


def section(source: Source) -> Section:
    """Return what the runs were measured with and under."""
    setup, radii = source.fit.setup, source.fit.radii
    sessions = len(set(radii.session.tolist()))
    out, back = int((radii.direction == "out").sum()), int((radii.direction == "back").sum())
    rows = [
        ("Place", source.said("place")),
        ("Floor", source.said("floor")),
        ("Dates of measurement", source.said("measured")),
        ("Sessions", str(sessions)),
        ("Instruments", source.said("instruments")),
    ]
    if setup is not None:
        rows.append(
            ("Laser rangefinder", f"standard uncertainty of a distance {1e3 * setup.rangefinder.sigma_m:.2g} mm")
        )
        if any("heading" in text for text in radii.path_source.tolist()):
            milli = 1e3 * setup.reference.sigma_theta_rad
            rows.append(("Heading reference", f"standard uncertainty of a heading {milli:.2g} mrad"))
        rows += [
            (title, span(*setup.conditions[name], unit, form))
            for name, (title, unit, form) in _CONDITIONS.items()
            if name in setup.conditions
        ]
    if out + back:
        rows.append(("Direction of driving", f"{out} runs out, {back} back"))
    blocks: list[Facts | Text] = [Facts(tuple(rows))]
    traceable = (
        "Traceability to the SI rests on the instruments' certificates as named above."
        if "instruments" in source.stated
        else "No calibration certificates of the instruments are stated; traceability to the SI is not shown by this "
        "report."
    )
    blocks.append(Text(traceable + " The standard uncertainties of the instruments are as stated by the campaign."))
    if setup is not None:
        blocks.append(assumed_text(setup.assumed))
    if "remarks" in source.stated:
        blocks.append(Text(f"Remarks: {source.stated['remarks']}"))
    return Section("Instruments and conditions", tuple(blocks))
