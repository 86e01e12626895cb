"""Effective radius of each wheel and run, r_e = S / (2 pi n) (Eq. 6), and its budget."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from calib.campaign.checks import line_residuals, turned_rad
from calib.campaign.model import Campaign
from calib.campaign.settings import WHEEL_LOADS
from calib.campaign.wheels import SOURCE_NAMES, WHEEL_COLUMNS, odometry_source, without_rear_wheels
from calib.errors import BadFileError, RefusedError
from calib.radius.path_length import correct_paths
from calib.radius.regression import WheelFit
from calib.types import FloatArray, StrArray, floats

#: standard deviation, in counts, of the difference of two readings in whole counts
QUANTISATION_COUNTS: Final = (1.0 / 6.0) ** 0.5
#: largest turn of a straight run by its counts: radii 1.5 % apart show 0.9 rad over 42 m
STRAIGHT_TURN_RAD: Final = 1.2
#: largest measured turn of a straight run
STRAIGHT_HEADING_RAD: Final = 0.5
#: shortest run used: below, a radius is uncertain by more than 0.1 %
SHORTEST_M: Final = 1.0


@dataclass(frozen=True, slots=True)
class UnusedRun:
    """A run that the fit does not use, and why."""

    run_id: str
    reason: str


@dataclass(frozen=True, slots=True)
class Component:
    """One line of the uncertainty budget of a single effective radius (GUM)."""

    #: ``rangefinder``, ``quantisation``, ``path``, ``weave`` (of logs), ``other_run_to_run``, ``session_to_session``
    name: str
    #: GUM: ``A`` from repeats, ``B`` from other knowledge
    kind: str
    distribution: str
    what: str
    #: contribution to the standard uncertainty of a typical (root mean square) run's radius
    std_left_m: float
    std_right_m: float
    #: None for type B
    dof: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class EffectiveRadii:
    """Effective radii of a campaign, arrays over the runs used, in the order driven."""

    #: as in the run table, shape (n_runs,)
    run_id: StrArray
    session: StrArray
    direction: StrArray
    load_left_N: FloatArray
    load_right_N: FloatArray
    distance_m: FloatArray  #: S_O along the corridor, shape (n_runs,)
    #: effective radii, corrected for the path, shape (n_runs,)
    radius_left_m: FloatArray
    radius_right_m: FloatArray
    #: standard uncertainties from rangefinder, quantisation and path (type B, random from run to run), shape (n_runs,)
    std_left_m: FloatArray
    std_right_m: FloatArray
    #: relative excess of the wheel's path over S_O, shape (n_runs,); the uncorrected radius is ``radius / (1 + path)``
    path_left: FloatArray
    path_right: FloatArray
    #: source of the correction, see `calib.radius.path_length.RunPaths`, shape (n_runs,)
    path_source: StrArray
    #: weave about the line, estimated or as measured; NaN where unknown, shape (n_runs,)
    amplitude_m: FloatArray
    wavelength_m: FloatArray
    #: of a typical run's radius
    budget: tuple[Component, ...] = ()
    left_out: tuple[UnusedRun, ...] = ()
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.run_id)


def usable_runs(campaign: Campaign, *, need_load: bool = True) -> tuple[Campaign, tuple[UnusedRun, ...], list[str]]:
    """Return the runs whose radii can be computed, the others, and what was assumed.

    `need_load`: leave out runs without a wheel load; where no run has one or a payload, all count as unladen. Raises
    RefusedError where none can be used.
    """
    if without_rear_wheels(campaign):
        wheels = SOURCE_NAMES[odometry_source(campaign)]
        raise RefusedError(
            f"{campaign.root or campaign.name}: found odometry from {wheels} alone; expected counts_left and "
            "counts_right of two wheels on one axle, with distance_m and wheel loads; log them, or run "
            "'calib geometry' for the radius and the lengths of this vehicle"
        )
    runs, notes = campaign.runs, []
    # left and right wheel, shape (2, n_runs)
    loads, counts = (np.stack([*map(runs.number, of)]) for of in (WHEEL_LOADS, WHEEL_COLUMNS["rear"]))
    unladen = not np.isfinite(loads).any() and not np.any(runs.number("payload_kg") > 0)
    if need_load and unladen:
        own_N = campaign.vehicle.unladen_load_N
        notes.append(
            f"No run has wheel loads or a payload: all are taken as unladen ({own_N:.0f} N a wheel), which "
            "they may not have been; add payload_kg, or load_left_N and load_right_N, to runs.csv."
        )
        loads = np.full_like(loads, own_N)
    turn = turned_rad(campaign)
    # turns that go with the load difference are of the radii, equal ones of counts_per_rev
    unusual = line_residuals(loads[0] - loads[1], turn)
    kind = np.char.lower(runs.label("kind"))
    straight = np.char.startswith(kind, "corridor") | np.char.startswith(kind, "straight")
    straight |= not straight.any()
    distance = runs.number("distance_m")
    unloaded, backward = need_load & ~np.isfinite(loads).all(axis=0), counts.prod(axis=0) < 0
    turns = (np.abs(turn) > STRAIGHT_TURN_RAD) & (np.abs(unusual) > STRAIGHT_TURN_RAD)
    turns |= np.abs(runs.number("ref_theta_rad")) > STRAIGHT_HEADING_RAD
    reasons = (
        (runs.excluded, "flagged as excluded in runs.csv"),
        (~straight, "not a corridor run by its kind"),
        (~np.isfinite(distance), "has no distance_m"),
        (np.abs(distance) < SHORTEST_M, f"is shorter than {SHORTEST_M} m"),
        (np.isnan(counts).all(axis=0), "has no counts"),
        (~np.isfinite(counts[0]), "has no counts_left"),
        (~np.isfinite(counts[1]), "has no counts_right"),
        ((counts == 0).any(axis=0), "has a wheel without a single count"),
        (backward, "has counts of opposite sign: one encoder runs backwards, or the vehicle turned on the spot"),
        (unloaded, "has no load_left_N, load_right_N, nor a payload with payload_x_m"),
        (turns, "is not a straight run: its heading changed too much"),
    )
    hits = np.stack([hit for hit, _ in reasons])
    keep, first_reason = ~hits.any(axis=0), hits.argmax(axis=0)
    left_out = tuple(UnusedRun(str(runs.run_id[run]), reasons[first_reason[run]][1]) for run in np.flatnonzero(~keep))
    if not keep.any():
        first = left_out[0] if left_out else UnusedRun("(none)", "the run table is empty")
        raise RefusedError(
            f"{campaign.root or campaign.name}: found no run that can be used; expected straight runs with a distance, "
            f"counts and a load; run {first.run_id} {first.reason}"
        )
    numbers = {**runs.numbers, **dict(zip(WHEEL_LOADS, loads, strict=True))}
    return replace(campaign, runs=replace(runs, numbers=numbers)).select(keep), left_out, notes


def effective_radii(campaign: Campaign) -> EffectiveRadii:
    """Return the effective radius of each wheel and run that can be used; RefusedError where none can.

    The path is corrected by the weave in a run's log, the measured heading at its end, or measured amplitude and
    wavelength; never by total counts, which would make the radii equal.
    """
    campaign, left_out, notes = usable_runs(campaign)
    runs, encoder, path = campaign.runs, campaign.encoder, correct_paths(campaign)
    distance = np.abs(runs.number("distance_m"))
    # of left and right wheel, shape (2, n_runs)
    counts = np.abs([runs.number(name) for name in WHEEL_COLUMNS["rear"]])
    per_rev = np.array([[encoder.counts_per_rev_left], [encoder.counts_per_rev_right]])
    excess = np.stack((path.left, path.right))
    radius = distance * (1 + excess) / (2 * np.pi * counts / per_rev)
    off = radius * np.hypot(0.5 * campaign.vehicle.track_m * path.yaw_std_rad / distance, path.centre_std)
    parts = {
        "rangefinder": radius * campaign.rangefinder.sigma_m / distance,
        "quantisation": radius * QUANTISATION_COUNTS / counts,
        "path": np.where(path.source == "log", 0.0, off),
        "weave": np.where(path.source == "log", off, 0.0),
    }
    std = np.sqrt(sum(part**2 for part in parts.values()))
    return EffectiveRadii(
        run_id=runs.run_id,
        session=runs.label("session"),
        direction=runs.label("direction"),
        distance_m=distance,
        path_source=path.source,
        amplitude_m=path.amplitude_m,
        wavelength_m=path.wavelength_m,
        budget=_budget(parts, campaign),
        left_out=left_out,
        notes=(*notes, *path.notes),
        **{name: runs.number(name) for name in WHEEL_LOADS},
        radius_left_m=radius[0],
        radius_right_m=radius[1],
        std_left_m=std[0],
        std_right_m=std[1],
        path_left=excess[0],
        path_right=excess[1],
    )


def _budget(parts: Mapping[str, FloatArray], campaign: Campaign) -> tuple[Component, ...]:
    end = "and heading at the end" if np.isfinite(campaign.runs.number("ref_theta_rad")).any() else "taken for straight"
    what = {
        "rangefinder": ("normal", f"distance S_O, u = {1e3 * campaign.rangefinder.sigma_m:.2g} mm"),
        "quantisation": ("triangular", f"counts of a run, u = {QUANTISATION_COUNTS:.2f} counts"),
        "path": ("normal", f"length of each wheel's path against S_O, {end}"),
        "weave": ("normal", "the same by logs, where every run may be off alike"),
    }
    return tuple(
        Component(name, "B", distribution, text, *np.sqrt(np.mean(parts[name] ** 2, axis=1)).tolist())
        for name, (distribution, text) in what.items()
        if name != "weave" or parts[name].any()
    )


#: half width over standard deviation; of a normal distribution by its 95 % interval
_DIVISORS: Final[Mapping[str, float]] = {"rectangular": math.sqrt(3.0), "triangular": math.sqrt(6.0), "normal": 1.96}
#: fourth moment over the squared variance
_KURTOSIS: Final[Mapping[str, float]] = {"rectangular": 9.0 / 5.0, "triangular": 12.0 / 5.0, "normal": 3.0}


@dataclass(frozen=True, slots=True)
class SystematicSource:
    """A declared error that is the same in every run."""

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
        what, unit, factor = _DESCRIPTIONS[self.section, self.key]
        return f"{what}, u = {factor * self.std:.2g} {unit}, the same in every run"


def _line_over_load(wheel: WheelFit, sensitivity: FloatArray) -> FloatArray:
    # value at the reference load and slope, as a change of each run's radius moves the law
    if wheel.model != "line":
        return np.array([sensitivity.mean(), 0.0])
    return floats(np.polynomial.polynomial.polyfit(wheel.load_N - wheel.law.reference_load_N, sensitivity, 1))


_DESCRIPTIONS: Final[Mapping[tuple[str, str], tuple[str, str, float]]] = {
    ("rangefinder", "scale"): ("scale of the distance", "ppm", 1e6),
    ("rangefinder", "offset_m"): ("offset of the distance", "mm", 1e3),
    ("rangefinder", "beam_rad"): ("angle of the beam to the path", "mrad", 1e3),
    ("path", "apart_m"): ("by how much the wheels' paths differ", "mm", 1e3),
    ("weighing", "scale"): ("scale of the wheel load", "%", 1e2),
    ("weighing", "offset_N"): ("offset of the wheel load", "N", 1.0),
}


def declared_sources(campaign: Campaign) -> tuple[SystematicSource, ...]:
    """Return the systematic sources that a campaign declares under ``[uncertainty]``.

    Raises BadFileError where a section or key is unknown, or an entry has no size.
    """
    declared = campaign.extra.get("uncertainty")
    if declared is None:
        return ()
    where = "campaign.toml" if campaign.root is None else campaign.root / "campaign.toml"
    known = ", ".join(f"{section}.{key}" for section, key in _DESCRIPTIONS)
    sources = []
    for section, entries in _mapping(declared, where, "uncertainty").items():
        for key, entry in _mapping(entries, where, f"uncertainty.{section}").items():
            column = f"uncertainty.{section}.{key}"
            if (section, key) not in _DESCRIPTIONS:
                raise BadFileError(where, "an unknown key", f"one of {known}", "correct it", column=column)
            sources.append(_source(section, key, _mapping(entry, where, column), where))
    return tuple(sources)


def _mapping(value: Any, where: Path | str, column: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise BadFileError(where, type(value).__name__, "a section", "see the campaign format", column=column)
    return value


def _source(section: str, key: str, entry: Mapping[str, Any], where: Path | str) -> SystematicSource:
    values = dict(entry)
    distribution, kind = str(values.pop("distribution", "normal")), str(values.pop("type", "B")).upper()
    dof = values.pop("dof", math.inf)
    size, divisor = values.pop("std", None), 1.0
    if size is None:
        size, divisor = values.pop("half_width", None), _DIVISORS.get(distribution, math.nan)
    numbers = all(isinstance(number, int | float) and number > 0 for number in (size, dof))
    if values or not numbers or math.isinf(size) or distribution not in _DIVISORS or kind not in {"A", "B"}:
        actual = ", ".join(f"{name} = {value!r}" for name, value in entry.items()) or "nothing"
        expected = f"std or half_width above 0, distribution ({', '.join(_DIVISORS)}), type A or B, and dof"
        remedy = 'write {std = 1e-4} or {half_width = 1e-4, distribution = "rectangular"}'
        raise BadFileError(where, actual, expected, remedy, column=f"uncertainty.{section}.{key}")
    return SystematicSource(section, key, float(size) / divisor, distribution, kind, float(dof))


def with_systematic(wheel: WheelFit, radii: EffectiveRadii, sources: tuple[SystematicSource, ...]) -> WheelFit:
    """Return a wheel's fit with systematic sources in its covariance and intervals.

    The weave by logs is one: the trend that is taken out may hold a part of it that every run has alike.
    """
    weaves = [getattr(part, f"std_{wheel.wheel}_m") for part in radii.budget if part.name == "weave"]
    if not sources and not weaves:
        return wheel
    rows = [_shift_of_law(source, wheel, radii.distance_m) for source in sources]
    rows += [np.array([_side_sign(wheel.wheel) * std, 0.0]) for std in weaves]
    dof = np.array([*(source.dof for source in sources), *(math.inf for _ in weaves)])
    return replace(wheel, estimate=replace(wheel.estimate, systematic=np.array(rows), systematic_dof=dof))


def systematic_components(
    wheels: Mapping[str, WheelFit], radii: EffectiveRadii, sources: tuple[SystematicSource, ...]
) -> tuple[Component, ...]:
    """Return the budget's lines of systematic sources, at the mean of the loads driven."""
    lines = []
    for source in sources:
        sizes = []
        for wheel in wheels.values():
            radius, slope = _shift_of_law(source, wheel, radii.distance_m).tolist()
            middle = float(np.mean(wheel.load_N)) - wheel.law.reference_load_N if wheel.model == "line" else 0.0
            sizes.append(abs(radius + middle * slope))
        dof = source.dof if math.isfinite(source.dof) else None
        lines.append(Component(source.name, source.kind, source.distribution, source.words, sizes[0], sizes[1], dof))
    return tuple(lines)


def _side_sign(wheel: str) -> float:
    return -1.0 if wheel == "left" else 1.0


def _shift_of_law(source: SystematicSource, wheel: WheelFit, distance_m: FloatArray) -> FloatArray:
    lines = (_line_over_load(wheel, wheel.radius_m), _line_over_load(wheel, wheel.radius_m / distance_m))
    return systematic_shift(source, wheel.wheel, wheel.law.reference_load_N, wheel.law.slope_m_per_N, *lines)


def systematic_shift(
    source: SystematicSource,
    wheel: str,
    reference_load_N: float,
    slope_m_per_N: float,
    radius: FloatArray,
    offset_gain: FloatArray,
) -> FloatArray:
    """Return the change of radius_ref and slope, shape (2,), by one standard uncertainty.

    `source`: see `SystematicSource`; `radius`, `offset_gain`: value at the reference load and slope of radius and of
    radius over distance, shape (2,).
    """
    std = source.std
    match source.section, source.key:
        case "rangefinder", "scale":
            return std * radius
        case "rangefinder", "offset_m":
            return std * offset_gain
        case "path", "apart_m":
            return 0.5 * _side_sign(wheel) * std * offset_gain
        case "rangefinder", "beam_rad":
            # a beam at angle a measures distance / cos(a), too much by a^2 / 2: its root mean square
            return 0.5 * math.sqrt(_KURTOSIS[source.distribution]) * std**2 * radius
        case "weighing", "scale":
            return -std * slope_m_per_N * np.array([reference_load_N, 1.0])
        case _:
            return np.array([-std * slope_m_per_N, 0.0])


def observed_components(radii: EffectiveRadii, left: WheelFit, right: WheelFit) -> tuple[Component, ...]:
    """Return the budget's type A lines: scatter of runs beyond the instruments', and of sessions."""
    instruments = [float(np.sqrt(np.mean(np.nan_to_num(std) ** 2))) for std in (radii.std_left_m, radii.std_right_m)]
    scatter = zip((left.run_std_m, right.run_std_m), instruments, strict=True)
    unexplained = [float(np.sqrt(max(observed**2 - known**2, 0.0))) for observed, known in scatter]
    what = "scatter of runs within a session beyond the above"
    lines = [Component("other_run_to_run", "A", "t", what, unexplained[0], unexplained[1], left.estimate.dof_within)]
    if left.estimate.dof_between > 0:
        what, std = "scatter of sessions beyond their runs", (left.session_std_m, right.session_std_m)
        lines.append(Component("session_to_session", "A", "t", what, *std, left.estimate.dof_between))
    return tuple(lines)
