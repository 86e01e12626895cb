"""The registry of effects: adding one means a file of its own and one line here."""

from __future__ import annotations

import importlib
from typing import Final

from calib.gap.effects.effect import Effect

__all__ = ["REGISTRY", "library"]

#: id -> (module, class); the order is the order of listings
REGISTRY: Final[dict[str, tuple[str, str]]] = {
    "radius_scale": ("radius_scale", "RadiusScale"),
    "unequal_radii": ("unequal_radii", "UnequalRadii"),
    "track_width": ("track_width", "TrackWidth"),
    "load_radius": ("load_radius", "LoadRadius"),
    "reference_yaw": ("reference_yaw", "ReferenceYaw"),
}


def library(exclude: tuple[str, ...] = ()) -> list[Effect]:
    """Return one of each registered effect, without those whose id is in `exclude`."""
    made: list[Effect] = []
    for name, (module, kind) in REGISTRY.items():
        if name not in exclude:
            made.append(getattr(importlib.import_module(f"calib.gap.effects.{module}"), kind)())
    return made
