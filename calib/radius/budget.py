"""Uncertainty budget of a radius: scatter observed, and declared parts that are the same in every run.

No number of runs makes the latter smaller. They are declared in ``campaign.toml``, since no run shows them::

    [uncertainty.rangefinder]
    scale = {half_width = 5e-5, distribution = "rectangular"}    # of the distance
    offset_m = {std = 5e-4}                                      # normal unless stated
    beam_rad = {half_width = 2e-3, distribution = "rectangular"} # between beam and path

    [uncertainty.weighing]
    scale = {std = 1e-3}                                         # of the wheel load
    offset_N = {std = 1.0}

Each entry has ``std``, or ``half_width`` with a ``distribution`` (``rectangular``, ``triangular``, ``normal``: a 95 %
half width), and may have ``type`` (``A`` or ``B``, the default) and ``dof`` for type A.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from calib.campaign.model import Campaign
from calib.errors import BadFileError
from calib.radius.effective import Component, EffectiveRadii
from calib.radius.regression import WheelFit
from calib.types import FloatArray

#: half width over standard deviation; that of a normal distribution holds 95 %
_DIVISORS: Final[Mapping[str, float]] = {"rectangular": math.sqrt(3.0), "triangular": math.sqrt(6.0), "normal": 1.96}
#: fourth moment over the squared variance: the error of a distance is of second order in the angle of the beam
_KURTOSIS: Final[Mapping[str, float]] = {"rectangular": 9.0 / 5.0, "triangular": 12.0 / 5.0, "normal": 3.0}


@dataclass(frozen=True, slots=True)
class SystematicSource:
    """A declared part of the uncertainty."""

    #: section and key below ``[uncertainty]``: ``rangefinder``, ``scale``
    section: str
    key: str
    #: standard uncertainty
    std: float
    #: ``normal``, ``rectangular`` or ``triangular``
    distribution: str
    #: GUM evaluation, ``A`` or ``B``
    kind: str
    #: degrees of freedom; infinite for type B
    dof: float

    @property
    def name(self) -> str:
        """Name in the budget."""
        return f"{self.section}: {self.key.rpartition('_')[0] or self.key}"

    @property
    def words(self) -> str:
        """Description with its standard uncertainty."""
        what, unit, factor = _WORDS[self.section, self.key]
        return f"{what}, u = {factor * self.std:.2g} {unit}, the same in every run"


def _along(wheel: WheelFit, sensitivity: FloatArray) -> FloatArray:
    """Return the change of the coefficients with a common change of the radii, shape (2,)."""
    if wheel.model != "line":
        return np.array([float(sensitivity.mean()), 0.0])
    x = wheel.load_N - wheel.law.reference_load_N
    slope = float(np.sum((x - x.mean()) * sensitivity) / np.sum((x - x.mean()) ** 2))
    return np.array([float(sensitivity.mean()) - slope * float(x.mean()), slope])


_WORDS: Final[Mapping[tuple[str, str], tuple[str, str, float]]] = {
    ("rangefinder", "scale"): ("scale of the distance", "ppm", 1e6),
    ("rangefinder", "offset_m"): ("offset of the distance", "mm", 1e3),
    ("rangefinder", "beam_rad"): ("angle of the beam to the path", "mrad", 1e3),
    ("weighing", "scale"): ("scale of the wheel load", "%", 1e2),
    ("weighing", "offset_N"): ("offset of the wheel load", "N", 1.0),
}


def declared_sources(campaign: Campaign) -> tuple[SystematicSource, ...]:
    """Return the systematic parts that a campaign declares under ``[uncertainty]``.

    Raises BadFileError where a section or key is unknown, or an entry has no size.
    """
    declared = campaign.extra.get("uncertainty")
    if declared is None:
        return ()
    where = "campaign.toml" if campaign.root is None else campaign.root / "campaign.toml"
    known = ", ".join(f"{section}.{key}" for section, key in _WORDS)
    sources = []
    for section, entries in _mapping(declared, where, "uncertainty").items():
        for key, entry in _mapping(entries, where, f"uncertainty.{section}").items():
            if (section, key) not in _WORDS:
                raise BadFileError(
                    where, "an unknown key", f"one of {known}", "correct it", column=f"uncertainty.{section}.{key}"
                )
            sources.append(_source(section, key, entry, where))
    return tuple(sources)


def _mapping(value: Any, where: Path | str, column: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise BadFileError(where, type(value).__name__, "a section", "see the campaign format", column=column)
    return value


def _source(section: str, key: str, entry: Any, where: Path | str) -> SystematicSource:
    column = f"uncertainty.{section}.{key}"
    values = dict(_mapping(entry, where, column))
    distribution, kind = str(values.pop("distribution", "normal")), str(values.pop("type", "B")).upper()
    dof = values.pop("dof", math.inf)
    size, divisor = values.pop("std", None), 1.0
    if size is None:
        size, divisor = values.pop("half_width", None), _DIVISORS.get(distribution, math.nan)
    numbers = all(isinstance(number, int | float) and number > 0 for number in (size, dof))
    if values or not numbers or math.isinf(size) or distribution not in _DIVISORS or kind not in {"A", "B"}:
        found = ", ".join(f"{name} = {value!r}" for name, value in entry.items()) or "nothing"
        expected = f"std or half_width above 0, distribution ({', '.join(_DIVISORS)}), type A or B, and dof"
        remedy = 'write {std = 1e-4} or {half_width = 1e-4, distribution = "rectangular"}'
        raise BadFileError(where, column=column, found=found, expected=expected, remedy=remedy)
    return SystematicSource(section, key, float(size) / divisor, distribution, kind, float(dof))


def with_systematic(wheel: WheelFit, radii: EffectiveRadii, sources: tuple[SystematicSource, ...]) -> WheelFit:
    """Return a wheel's fit with the systematic parts in the covariance of its law and in every interval."""
    if not sources:
        return wheel
    systematic = np.array([_gradient(source, wheel, radii.distance_m) for source in sources])
    dof = np.array([source.dof for source in sources])
    estimate = replace(wheel.estimate, systematic=systematic, systematic_dof=dof)
    return replace(wheel, estimate=estimate)


def systematic_components(
    wheels: Mapping[str, WheelFit], radii: EffectiveRadii, sources: tuple[SystematicSource, ...]
) -> tuple[Component, ...]:
    """Return the lines of the budget of a single radius, at the middle of the loads driven."""
    lines = []
    for source in sources:
        sizes = []
        for wheel in wheels.values():
            gradient = _gradient(source, wheel, radii.distance_m)
            middle = float(np.mean(wheel.load_N)) - wheel.law.reference_load_N if wheel.model == "line" else 0.0
            sizes.append(abs(float(gradient[0] + middle * gradient[1])))
        dof = source.dof if math.isfinite(source.dof) else None
        lines.append(Component(source.name, source.kind, source.distribution, source.words, sizes[0], sizes[1], dof))
    return tuple(lines)


def _gradient(source: SystematicSource, wheel: WheelFit, distance_m: FloatArray) -> FloatArray:
    """Return the change of the coefficients by one standard uncertainty of a source, shape (2,)."""
    law, std = wheel.law, source.std
    match source.section, source.key:
        case "rangefinder", "scale":
            return std * _along(wheel, wheel.radius_m)
        case "rangefinder", "offset_m":
            return std * _along(wheel, wheel.radius_m / distance_m)
        case "rangefinder", "beam_rad":
            # a beam at the angle a measures the distance over cos a: root mean square of a^2 / 2
            return 0.5 * math.sqrt(_KURTOSIS[source.distribution]) * std**2 * _along(wheel, wheel.radius_m)
        case "weighing", "scale":
            return -std * law.slope_m_per_N * np.array([law.reference_load_N, 1.0])
        case _:
            return np.array([-std * law.slope_m_per_N, 0.0])


def observed_components(radii: EffectiveRadii, left: WheelFit, right: WheelFit) -> tuple[Component, ...]:
    """Return the type A lines of the budget: scatter of the runs beyond that of the instruments."""
    instruments = [float(np.sqrt(np.mean(np.nan_to_num(std) ** 2))) for std in (radii.std_left_m, radii.std_right_m)]
    unexplained = [
        float(np.sqrt(max(wheel.run_std_m**2 - known**2, 0.0)))
        for wheel, known in zip((left, right), instruments, strict=True)
    ]
    what = "scatter of runs within a session beyond the above"
    lines = [Component("other_run_to_run", "A", "t", what, unexplained[0], unexplained[1], left.estimate.dof_within)]
    if left.estimate.dof_between > 0:
        what, std = "scatter of sessions beyond their runs", (left.session_std_m, right.session_std_m)
        lines.append(Component("session_to_session", "A", "t", what, *std, left.estimate.dof_between))
    return tuple(lines)
