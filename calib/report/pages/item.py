"""The item: which vehicle, in which condition, for whom."""

from __future__ import annotations

from calib.report.blocks import Facts, Section, Text
from calib.report.numbers import MISSING
from calib.report.source import Source
from calib.report.stated import OPTIONAL, STATED


def section(source: Source) -> Section:
    """Return the vehicle as the campaign states it."""
    setup = source.fit.setup
    rows = [
        ("Vehicle", source.said("item")),
        ("Identification", source.said("item_id")),
        ("Condition", source.said("item_condition")),
        ("Received", source.said("received")),
        ("Campaign", source.fit.name),
    ]
    if setup is not None:
        vehicle, encoder = setup.vehicle, setup.encoder
        per_rev = {encoder.counts_per_rev_left, encoder.counts_per_rev_right}
        counts = (
            f"{per_rev.pop():g} counts a revolution"
            if len(per_rev) == 1
            else f"{encoder.counts_per_rev_left:g} (left) and {encoder.counts_per_rev_right:g} (right) counts a "
            "revolution"
        )
        wrap = "" if encoder.wrap_bits is None else f", counters of {encoder.wrap_bits} bits"
        rows += [
            ("Track", f"{1e3 * vehicle.track_m:.1f} mm between the contact points of the rear wheels"),
            ("Wheelbase", f"{1e3 * vehicle.wheelbase_m:.1f} mm"),
            ("Nominal wheel radius", f"{1e3 * vehicle.wheel_radius_m:.2f} mm, free"),
            ("Mass", f"{vehicle.mass_kg:g} kg without payload, permissible wheel load {vehicle.max_wheel_load_N:g} N"),
            ("Wheel encoders", counts + wrap),
        ]
    missing = [what for key, what in STATED.items() if key not in source.stated and key not in OPTIONAL]
    blocks: list[Facts | Text] = [Facts(tuple((name, value or MISSING) for name, value in rows))]
    blocks.append(
        Text(
            "What the campaign states of laboratory, customer, vehicle, instruments and dates is carried over as "
            "given; geometry and counts a revolution are taken from it and were not measured here.",
            small=True,
        )
    )
    if missing:
        blocks.append(Text(f"The campaign does not state: {', '.join(missing)}.", small=True))
    return Section("Item", tuple(blocks))
