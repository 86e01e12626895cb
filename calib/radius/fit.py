"""From a campaign to the laws of both wheels, and the budget of a radius."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from calib.campaign.check import implausible, notes_for_results
from calib.campaign.checks.design import assumed_settings
from calib.campaign.checks.measurements import factor_reason, off
from calib.campaign.model import Campaign
from calib.campaign.wheels import steered_itself_m
from calib.errors import BadFileError, BadInputError, ImplausibleError, RefusedError
from calib.radius.checks import on_one_load, with_checks
from calib.radius.effective import Component, EffectiveRadii, effective_radii
from calib.radius.instrument_checks import (
    held_against_residuals,
    with_instrument_checks,
    with_path_check,
    with_temperature_check,
)
from calib.radius.regression import FAILED, OK, Check, WheelFit, fit_wheel
from calib.radius.result import PLAUSIBLE, Fit, Setup
from calib.types import FloatArray, StrArray

#: largest reference load over the largest driven; further out the line has no digits left
MAX_REFERENCE_RATIO: Final = 1e4
#: share of the radius by which load may change it over the measured range, and by which single runs may scatter
MAX_LOAD_CHANGE: Final = 0.2
MAX_SCATTER: Final = 0.03
#: columns whose span is reported
CONDITIONS: Final = (
    "distance_m", "speed_mps", "temperature_C", "payload_kg", "payload_x_m", "payload_y_m", "minutes_under_load",
    "load_left_N", "load_right_N",
)  # fmt: skip


def fit_law(radii: EffectiveRadii, *, reference_load_N: float, name: str = "", simulated: bool = False) -> Fit:
    """Fit both wheels' laws to effective radii, with their checks.

    `reference_load_N`: load on which the coefficients are centred; `name`, `simulated`: the campaign's. Raises
    RefusedError with fewer than three runs.
    """
    wheels = []
    for side in ("left", "right"):
        load, radius, std = (getattr(radii, name.format(side)) for name in ("load_{}_N", "radius_{}_m", "std_{}_m"))
        unchecked = fit_wheel(side, load, radius, radii.session, reference_load_N=reference_load_N)
        checked = with_checks(unchecked, radii.session, radii.direction, radii.run_id)
        wheels.append(with_instrument_checks(checked, radii.distance_m, std, radii.session))
    wheels = held_against_residuals(radii, wheels)
    radii = replace(radii, budget=(*radii.budget, *observed_components(radii, *wheels)))
    return Fit(name, simulated, wheels[0], wheels[1], radii, notes=radii.notes)


def fit_campaign(campaign: Campaign, *, reference_load_N: float | None = None) -> Fit:
    """Return the fit of a campaign: radii, both laws, static radii where measured.

    Static radii are the columns ``static_radius_left_m`` and ``static_radius_right_m``; `reference_load_N`: see
    `fit_law`; None: the model's. Raises RefusedError where fewer than three runs can be used; ImplausibleError where
    units or settings that cannot be are the reason.
    """
    reference = campaign.model.reference_load_N if reference_load_N is None else reference_load_N
    if not np.isfinite(reference) or reference < 0:
        raise BadInputError(f"reference load: found {reference:g} N; expected a load of zero or more; correct it")
    findings = [f"{note.where}: {note.text}" for note in implausible(campaign)]
    try:
        radii = effective_radii(campaign)
        loads = np.append(radii.load_left_N, radii.load_right_N)
        largest = float(np.max(loads[np.isfinite(loads)], initial=1.0))
        if reference > MAX_REFERENCE_RATIO * largest:
            expected = f"a load near those driven, up to {largest:g} N"
            raise BadInputError(f"reference load: found {reference:g} N; expected {expected}; correct it")
        fit = fit_law(radii, reference_load_N=reference, name=campaign.name, simulated=campaign.simulated)
    except RefusedError as error:
        if findings:
            raise ImplausibleError(campaign.name, findings) from error
        raise
    sources = declared_sources(campaign)
    used = campaign.select(np.isin(campaign.runs.run_id, radii.run_id)).runs
    nominal = None if "vehicle.wheel_radius_m" in campaign.assumed else campaign.vehicle.wheel_radius_m
    given = any(np.isfinite(campaign.runs.number(f"load_{side}_N")).any() for side in ("left", "right"))
    wheels = {}
    for name, line in fit.wheels.items():
        wheel = with_systematic(line if given else _without_loads(line), radii, sources)
        wheel = replace(wheel, checks=(*_implausible(wheel, findings, nominal, radii.run_id), *wheel.checks))
        wheel = with_temperature_check(wheel, used.number("temperature_C"), used.label("session"))
        if not any(source.section == "path" for source in sources) and np.isnan(used.number("ref_theta_rad")).all():
            # two wheels' paths to a bow: b times its turn of 8 h / S, half of it each
            per_bow = 4.0 * campaign.vehicle.track_m * wheel.radius_m / radii.distance_m**2
            wheel = with_path_check(wheel, float(per_bow.mean()), steered_itself_m(campaign))
        wheels[name] = wheel
    static, notes = _static(campaign, reference)
    stated = (campaign.vehicle, campaign.encoder, campaign.model, campaign.rangefinder, campaign.reference)
    driven = {name: column for name in CONDITIONS if np.isfinite(column := used.number(name)).any()}
    conditions = {name: (float(np.nanmin(column)), float(np.nanmax(column))) for name, column in driven.items()}
    return replace(
        fit,
        left=wheels["left"],
        right=wheels["right"],
        radii=replace(fit.radii, budget=(*fit.radii.budget, *systematic_components(wheels, radii, sources))),
        static=static,
        notes=(*notes_for_results(campaign), *fit.notes, *notes),
        setup=Setup(*stated, conditions, assumed_settings(campaign)),
    )


def _without_loads(wheel: WheelFit) -> WheelFit:
    words = "No run's load is given: add load_left_N and load_right_N to runs.csv."

    def changed(check: Check) -> Check:
        if check.name == "design":
            return replace(check, sentence=check.sentence.replace(on_one_load(wheel), words))
        if check.name == "scatter" and check.level != OK:
            return replace(check, level=FAILED, sentence=f"{words} Loads may differ. {check.sentence}")
        return check

    return replace(wheel, checks=tuple(map(changed, wheel.checks)))


def _static(campaign: Campaign, reference_load_N: float) -> tuple[dict[str, WheelFit], tuple[str, ...]]:
    runs = campaign.included().runs
    fits, notes = {}, []
    for wheel in ("left", "right"):
        radius, load = runs.number(f"static_radius_{wheel}_m"), runs.number(f"load_{wheel}_N")
        good = np.isfinite(radius) & np.isfinite(load)
        if not good.any():
            continue
        session = runs.label("session")[good]
        try:
            unchecked = fit_wheel(wheel, load[good], radius[good], session, reference_load_N=reference_load_N)
        except RefusedError as error:
            notes.append(f"Static radius not fitted: {error}.")
            continue
        fits[wheel] = with_checks(unchecked, session, runs.label("direction")[good], runs.run_id[good])
    return fits, tuple(notes)


def _implausible(wheel: WheelFit, findings: list[str], nominal_m: float | None, runs: StrArray) -> tuple[Check, ...]:
    """Return a failed check ``plausible`` for each finding; `nominal_m`: None where assumed; `runs`: their ids."""
    other = "right" if wheel.wheel == "left" else "left"
    own = [text for text in findings if f"the {other} wheel" not in text]
    radius_named = any(f"the {wheel.wheel} wheel's radius" in text for text in own)
    texts = dict.fromkeys([*own, *_beyond_bounds(wheel, nominal_m, runs, radius_named=radius_named)])
    return tuple(Check(PLAUSIBLE, FAILED, text if text.endswith((".", "?")) else f"{text}.") for text in texts)


def _beyond_bounds(wheel: WheelFit, nominal_m: float | None, runs: StrArray, *, radius_named: bool) -> Iterator[str]:
    radius = wheel.law.radius_ref_m
    if not (np.isfinite(radius) and radius > 0):
        yield f"the radius at the reference load comes out as {radius:.4g} m; expected one above zero; check the loads"
        return
    if nominal_m is not None and off(radius / nominal_m) and not radius_named:
        yield (
            f"the radius comes out {radius / nominal_m:.2f} times nominal ({1e3 * radius:.4g} mm for "
            f"{1e3 * nominal_m:.4g} mm): {factor_reason(radius / nominal_m)}"
        )
    change = wheel.law.slope_m_per_N * (wheel.law.load_max_N - wheel.law.load_min_N) / radius
    if wheel.model == "line" and abs(change) > MAX_LOAD_CHANGE:
        yield (
            f"load changes the radius by {100 * change:.3g} % over the loads driven; expected less than "
            f"{100 * MAX_LOAD_CHANGE:.0f} %; check loads and distances"
        )
    if wheel.run_std_m > MAX_SCATTER * radius:
        yield (
            f"single runs scatter by {100 * wheel.run_std_m / radius:.2g} % of the radius; expected less than "
            f"{100 * MAX_SCATTER:.0f} %; check distances, counts and loads, first of "
            f"{runs[int(np.argmax(np.abs(wheel.residual_m)))]}, or exclude it"
        )


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
    std: float
    #: ``normal``, ``rectangular`` or ``triangular``
    distribution: str
    #: GUM: ``A`` or ``B``
    kind: str
    #: infinite for type B
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
    mean, x = sensitivity.mean(), wheel.load_N - wheel.law.reference_load_N
    if wheel.model != "line":
        return np.array([mean, 0.0])
    slope = np.sum((x - x.mean()) * sensitivity) / np.sum((x - x.mean()) ** 2)
    return np.array([mean - slope * x.mean(), slope])


_WORDS: Final[Mapping[tuple[str, str], tuple[str, str, float]]] = {
    ("rangefinder", "scale"): ("scale of the distance", "ppm", 1e6),
    ("rangefinder", "offset_m"): ("offset of the distance", "mm", 1e3),
    ("rangefinder", "beam_rad"): ("angle of the beam to the path", "mrad", 1e3),
    ("path", "apart_m"): ("by how much the wheels' paths differ", "mm", 1e3),
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
    """Return a wheel's fit with systematic parts in its covariance and intervals.

    The weave by logs is one: its course at start and end, which every run may have alike, hides in the trend.
    """
    rows = [_gradient(source, wheel, radii.distance_m) for source in sources]
    weaves = [getattr(part, f"std_{wheel.wheel}_m") for part in radii.budget if part.name == "weave"]
    rows += [np.array([_side(wheel) * std, 0.0]) for std in weaves]
    if not rows:
        return wheel
    systematic = np.array(rows)
    dof = np.array([source.dof for source in sources] + [math.inf] * (len(rows) - len(sources)))
    return replace(wheel, estimate=replace(wheel.estimate, systematic=systematic, systematic_dof=dof))


def systematic_components(
    wheels: Mapping[str, WheelFit], radii: EffectiveRadii, sources: tuple[SystematicSource, ...]
) -> tuple[Component, ...]:
    """Return the budget of a single radius, in the middle of the loads driven."""
    lines = []
    for source in sources:
        sizes = []
        for wheel in wheels.values():
            radius, slope = _gradient(source, wheel, radii.distance_m).tolist()
            middle = float(np.mean(wheel.load_N)) - wheel.law.reference_load_N if wheel.model == "line" else 0.0
            sizes.append(abs(radius + middle * slope))
        dof = source.dof if math.isfinite(source.dof) else None
        lines.append(Component(source.name, source.kind, source.distribution, source.words, sizes[0], sizes[1], dof))
    return tuple(lines)


def _side(wheel: WheelFit) -> float:
    """Return the sign of what a turn of the path does to a wheel's radius."""
    return -1.0 if wheel.wheel == "left" else 1.0


def _gradient(source: SystematicSource, wheel: WheelFit, distance_m: FloatArray) -> FloatArray:
    law, std = wheel.law, source.std
    match source.section, source.key:
        case "rangefinder", "scale":
            return std * _along(wheel, wheel.radius_m)
        case "rangefinder", "offset_m":
            return std * _along(wheel, wheel.radius_m / distance_m)
        case "path", "apart_m":
            return 0.5 * _side(wheel) * std * _along(wheel, wheel.radius_m / distance_m)
        case "rangefinder", "beam_rad":
            # a beam at the angle a measures the distance over cos a: root mean square of a^2 / 2
            return 0.5 * math.sqrt(_KURTOSIS[source.distribution]) * std**2 * _along(wheel, wheel.radius_m)
        case "weighing", "scale":
            return -std * law.slope_m_per_N * np.array([law.reference_load_N, 1.0])
        case _:
            return np.array([-std * law.slope_m_per_N, 0.0])


def observed_components(radii: EffectiveRadii, left: WheelFit, right: WheelFit) -> tuple[Component, ...]:
    """Return the type A lines: scatter of the runs beyond the instruments'."""
    instruments = [float(np.sqrt(np.mean(np.nan_to_num(std) ** 2))) for std in (radii.std_left_m, radii.std_right_m)]
    scatter = zip((left.run_std_m, right.run_std_m), instruments, strict=True)
    unexplained = [float(np.sqrt(max(observed**2 - known**2, 0.0))) for observed, known in scatter]
    what = "scatter of runs within a session beyond the above"
    lines = [Component("other_run_to_run", "A", "t", what, unexplained[0], unexplained[1], left.estimate.dof_within)]
    if left.estimate.dof_between > 0:
        what, std = "scatter of sessions beyond their runs", (left.session_std_m, right.session_std_m)
        lines.append(Component("session_to_session", "A", "t", what, *std, left.estimate.dof_between))
    return tuple(lines)
