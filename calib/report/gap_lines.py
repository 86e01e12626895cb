"""Lines on single runs and places where the gap stands out, the same in terminal and report."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

__all__ = ["place_line", "run_line"]

_ANGLES = frozenset({"heading", "steering"})


def run_line(run: Mapping[str, Any]) -> str:
    """Return a run of the verdict's ``where.runs`` as a line: channel, gap, and how many floors that is."""
    parts = str(run.get("channel") or "")
    value, z = run.get("value"), run.get("z")
    if value is not None:
        milli = 1e3 * value
        shown = f"{milli:+.3g}" if abs(milli) < 999.5 else f"{milli:+.0f}"
        parts += f" {shown} {'mrad' if run.get('channel') in _ANGLES else 'mm'}"
    if z is not None:
        parts += f"{', ' if parts else ''}{abs(z):.0f} floors"
    return f"{run.get('run_id', 'a run')}: {parts.strip()}"


def place_line(place: Mapping[str, Any]) -> str:
    """Return a place of the verdict's ``where.places`` as a line: what opens there, how much, and from where to where.

    Stretches have their ends with 95 % intervals, turns and stops none.
    """
    size = f"{1e3 * place['size']:+.3g} m{place['unit']}"
    spread = " .. ".join(f"{1e3 * value:.3g}" for value in place["ci95"])
    if "place" not in place:
        return f"{place['where']}: {place['channel']} {size} {place.get('what', '')} (95 %: {spread})"
    (low, high), (first, last) = place["place"], place["place_ci95"]
    return (
        f"{place['where']} on {place['route']}: {place['channel']} {size} (95 %: {spread}) between {low:.2f} m "
        f"({first[0]:.2f} .. {first[1]:.2f}) and {high:.2f} m ({last[0]:.2f} .. {last[1]:.2f}), {place['coordinate']}"
    )
