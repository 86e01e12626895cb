"""The vehicle that a user means: of a campaign, of a coefficient file, or the nominal one with some values changed."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

from calib.errors import BadInputError
from calib.vehicle import Vehicle


def vehicle_of(source: Path | None, **changes: float | None) -> Vehicle:
    """Return the vehicle of a campaign folder or coefficient file (None: the nominal one), with the changes given."""
    vehicle = Vehicle()
    if source is not None:
        if source.is_dir():
            from calib.campaign.read import read_campaign

            vehicle = read_campaign(source, logs=False).vehicle
        else:
            from calib.coefficients.file import load_coefficients

            vehicle = load_coefficients(source).geometry
    given: dict[str, Any] = {name: value for name, value in changes.items() if value is not None}
    for name, value in given.items():
        if not math.isfinite(value) or (not name.startswith("cog") and value <= 0.0):
            raise BadInputError(f"{name}: found {value!r}; expected a finite number above 0; correct it")
    return replace(vehicle, **given)
