"""Values that nobody stated: a program filled them in, and results lean on them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from calib.campaign.model import Campaign, Note

#: keys that every radius or path scales with
WEIGHTY: Final = ("vehicle.track_m", "vehicle.wheel_radius_m", "encoder.counts_per_rev")
#: section -> columns of the run table or of logs that make its values matter
_NEEDED_BY: Final = {"rangefinder": ("distance_m",), "reference": ("ref_x_m", "ref_y_m", "ref_theta_rad")}


def relevant(campaign: Campaign) -> tuple[str, ...]:
    """Return the assumed keys that matter for what the campaign holds."""
    columns = {*campaign.runs.numbers, *campaign.logs.columns}
    return tuple(
        key
        for key in campaign.assumed
        if (needed := _NEEDED_BY.get(key.partition(".")[0])) is None or columns.intersection(needed)
    )


def stand_ins(campaign: Campaign) -> dict[str, str]:
    """Return the assumed keys that matter, each with the value that stands in."""
    return {key: value_of(campaign, key) for key in relevant(campaign)}


def value_of(campaign: Campaign, key: str) -> str:
    """Return an assumed value as text; empty where the key is none of the campaign's."""
    section, _, name = key.partition(".")
    part = getattr(campaign, section, None)
    value = getattr(part, "counts_per_rev_left" if name == "counts_per_rev" else name, None)
    return f"{value:.6g}" if isinstance(value, int | float) else ""


def assumed_values(campaign: Campaign) -> Iterator[Note]:
    """Name what nobody stated, with the values that stand in."""
    keys = stand_ins(campaign)
    if not keys:
        return
    listed = ", ".join(f"{key} = {value}" for key, value in keys.items())
    text = (
        f"assumed, since nobody stated: {listed}; give the vehicle's and the instruments' own and take them out of "
        "'assumed'"
    )
    yield Note("suspicious" if any(key in WEIGHTY for key in keys) else "info", "campaign.toml", text, "assumed")
