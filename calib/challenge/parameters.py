"""What a verdict's parameters should be, where the truth has the form that they assume."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np

from calib.challenge.cases import Truth
from calib.plant.effects.form import Cause

Compared = tuple[str, float, float, float]  # parameter, truth, low, high

_Expected = Mapping[str, float]


def _size(name: str, factor: float = 1.0) -> Callable[[Truth, Cause], _Expected]:
    return lambda _truth, cause: {name: factor * cause.size}


def _load_slopes(truth: Truth, cause: Cause) -> _Expected:
    model = truth.model
    return {
        "slope_left": cause.size * model.radius_left_m,
        "slope_right": cause.size * cause.knobs["right_ratio"] * model.radius_right_m,
    }


def _beam(_truth: Truth, cause: Cause) -> _Expected:
    return {"excess": 1 / float(np.cos(cause.size)) - 1}


# the verdict's load is that of the axle, the plant's that of a wheel
#: (effect, form of the truth) -> parameter of the verdict -> its true value
_TRUE: Final[dict[tuple[str, str], Callable[[Truth, Cause], _Expected]]] = {
    ("radius_scale", "plain"): _size("relative"),
    ("unequal_radii", "plain"): _size("relative"),
    ("track_width", "plain"): _size("relative"),
    ("load_radius", "plain"): _load_slopes,
    ("load_dependent_track", "plain"): _size("per_N", 0.5),
    ("curve_scrub", "plain"): _size("widening"),
    ("rangefinder_scale", "plain"): _size("relative"),
    ("rangefinder_offset", "plain"): _size("offset"),
    ("beam_misalignment", "plain"): _beam,
    ("travel_direction", "plain"): _size("relative"),
    ("reference_yaw", "plain"): _size("yaw"),
    ("reference_latency", "plain"): _size("latency"),
    ("temperature_radius", "plain"): _size("alpha"),
    ("payload_mass", "plain"): _size("share"),
    ("floor_undulation", "plain"): _size("excess"),
    ("steering_zero", "plain"): _size("zero"),
    ("steering_scale", "plain"): _size("relative"),
    ("speed_radius", "plain"): _size("per_mps"),
    ("side_slip", "plain"): _size("slip_per_acceleration"),
    ("steering_delay", "plain"): _size("delay"),
}


def compare(truth: Truth, verdict: Mapping[str, Any]) -> list[Compared]:
    """Return (parameter, truth, low, high) for each interval of a verdict that can be held against the truth.

    Causes of other forms than the library's are left out.
    """
    named = {cause.get("effect"): cause for cause in verdict.get("causes", [])}
    compared: list[Compared] = []
    for cause in truth.causes:
        expected = _TRUE.get((cause.effect, cause.form))
        given = named.get(cause.effect)
        if expected is None or given is None:
            continue
        for name, value in expected(truth, cause).items():
            interval = given.get("parameters", {}).get(name, {}).get("ci95")
            if interval and None not in interval:
                compared.append((f"{cause.effect}.{name}", value, float(interval[0]), float(interval[1])))
    return compared
