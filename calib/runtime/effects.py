"""The named effects of a coefficient file on wheel motion, for the loop of any simulator.

Wheel angles in, wheel travel with the effects out::

    effects = Effects.from_file("corrected.json")
    effects.begin(Run(load_left_N=420.0, load_right_N=380.0, temperature_C=14.0))
    motion = effects.step(d_angle_left_rad, d_angle_right_rad, dt_s)
    heading += motion.turn_rad

Effects on readings, at places, at stops and of the steering do not act on the wheels: see `Effects.left_out`.
"""

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from .coefficients import CoefficientError, Coefficients  # noqa: TID252 the folder may be renamed

__all__ = ["Effects", "Motion", "Run"]

#: an effect depends on the path that it bends: so often it is computed
PASSES = 3
#: a shorter way has no curvature
SHORTEST_STEP_M = 1e-6


@dataclass(frozen=True, slots=True)
class Run:
    """What holds during a run: wheel loads, surroundings, and the numbers that effects act through.

    `speed_mps`: mean over the way; `minutes_under_load`: of the payload, in mid-run; `direction`: ``out`` or ``back``;
    `covariates`: further columns of the run table. What is NaN or missing is not known: what follows it is as in the
    mean of the runs diagnosed, see `Effects.unknown`.
    """

    load_left_N: float
    load_right_N: float
    payload_kg: float = 0.0
    temperature_C: float = math.nan
    speed_mps: float = math.nan
    travelled_km: float = math.nan
    minutes_under_load: float = math.nan
    direction: str = "out"
    phase_left_rad: float = 0.0
    phase_right_rad: float = 0.0
    covariates: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Motion:
    """Travel of the wheels, track, and motion to the left and turn beside these, in one step."""

    left_m: float
    right_m: float
    track_m: float
    aside_m: float = 0.0
    further_turn_rad: float = 0.0

    @property
    def way_m(self) -> float:
        """Way of the axle's middle."""
        return 0.5 * (self.left_m + self.right_m)

    @property
    def turn_rad(self) -> float:
        """Change of heading."""
        return (self.right_m - self.left_m) / self.track_m + self.further_turn_rad


@dataclass(slots=True)
class _Change:
    left: float = 0.0
    right: float = 0.0
    track: float = 0.0
    aside_m: float = 0.0
    turn_rad: float = 0.0

    def roll(self, left: float, right: float) -> None:
        self.left += left
        self.right += right


@dataclass(frozen=True, slots=True)
class _Step:
    run: Run
    nominal: Motion  #: without effects
    motion: Motion  #: with the effects of the pass before
    angles_rad: tuple[float, float]
    phases_rad: tuple[float, float]  #: at the end of the step
    radii_m: tuple[float, float]
    dt_s: float

    @property
    def speed_mps(self) -> float:
        return self.nominal.way_m / self.dt_s if self.dt_s > 0.0 else 0.0

    def curvature_per_m(self, motion: Motion) -> float:
        """Curvature, no tighter than a turn about one rear wheel."""
        way = abs(motion.way_m)
        curvature = motion.turn_rad / way if way > SHORTEST_STEP_M else 0.0
        return max(-2.0 / self.nominal.track_m, min(2.0 / self.nominal.track_m, curvature))


@dataclass(frozen=True, slots=True)
class _Effect:
    name: str
    form: str
    settings: dict[str, float]
    sizes: dict[str, float]
    vehicle: Coefficients
    cog_z_m: float

    @property
    def reference_load_N(self) -> float:
        return self.vehicle.left.reference_load_N

    def size(self, name: str) -> float:
        return self.sizes.get(name, 0.0)

    def deviation(self, value: float) -> float:
        """Return a covariate's distance from the effect's zero; 0 where unknown."""
        off = (value - self.settings.get("centre", 0.0)) / (self.settings.get("spread", 1.0) or 1.0)
        return off if math.isfinite(off) else 0.0


def _both(change: _Change, value: float) -> None:
    change.roll(value, value)


def _one(change: _Change, form: str, value: float) -> None:
    change.roll(*((value, 0.0) if form.startswith("left") else (0.0, value)))


def _temperature(effect: _Effect, step: _Step, change: _Change) -> None:
    _both(change, effect.size("alpha") * effect.deviation(step.run.temperature_C))


def _speed(effect: _Effect, step: _Step, change: _Change) -> None:
    _both(change, effect.size("per_mps") * effect.deviation(step.run.speed_mps))


def _wear(effect: _Effect, step: _Step, change: _Change) -> None:
    driven = effect.deviation(step.run.travelled_km)
    change.roll(effect.size("rate_left") * driven, effect.size("rate_right") * driven)


def _radius_scale(effect: _Effect, _step: _Step, change: _Change) -> None:
    _both(change, effect.size("relative"))


def _unequal(effect: _Effect, _step: _Step, change: _Change) -> None:
    half = 0.5 * effect.size("relative")
    change.roll(-half, half)


def _track_width(effect: _Effect, _step: _Step, change: _Change) -> None:
    change.track += effect.size("relative")


def _by_load(effect: _Effect, step: _Step, change: _Change, size: str, of: Callable[[float], float]) -> None:
    left, right = of(step.run.load_left_N), of(step.run.load_right_N)
    change.roll(
        effect.size(f"{size}_left") * left / step.radii_m[0], effect.size(f"{size}_right") * right / step.radii_m[1]
    )


def _load(effect: _Effect, step: _Step, change: _Change) -> None:
    _by_load(effect, step, change, "slope", lambda load_N: load_N - effect.reference_load_N)


def _load_curve(effect: _Effect, step: _Step, change: _Change) -> None:
    exponent = effect.settings["exponent"]
    reference = effect.settings.get("centre", effect.reference_load_N)

    def shape(load_N: float) -> float:
        return reference * (math.pow(max(load_N, 0.0) / reference, exponent) - 1.0) / exponent

    _by_load(effect, step, change, "slope", shape)


def _creep(effect: _Effect, step: _Step, change: _Change) -> None:
    gone = math.exp(-max(step.run.minutes_under_load, 0.0) / effect.settings["tau_min"])
    zero = effect.settings.get("centre", 0.0)
    crept = 1.0 - gone if math.isfinite(gone) else 0.0
    _by_load(effect, step, change, "creep", lambda load_N: -(load_N - zero) * crept)


def _load_track(effect: _Effect, step: _Step, change: _Change) -> None:
    over = step.run.load_left_N + step.run.load_right_N - 2.0 * effect.reference_load_N
    change.track += effect.size("per_N") * over


def _scrub(effect: _Effect, step: _Step, change: _Change) -> None:
    motion, half_m = step.motion, 0.5 * step.nominal.track_m
    curvature = abs(step.curvature_per_m(motion))
    if "spot" in effect.form:
        curvature = 1.0 / half_m if abs(motion.turn_rad) * half_m > abs(motion.way_m) else 0.0
    change.track += effect.size("widening") * curvature


def _curve_load(effect: _Effect, step: _Step, change: _Change) -> None:
    pull_mps2 = step.speed_mps * abs(step.speed_mps) * step.curvature_per_m(step.nominal)
    mass_kg = effect.vehicle.mass_kg + step.run.payload_kg
    moved_N = mass_kg * pull_mps2 * effect.cog_z_m / effect.vehicle.track_m
    grown_m = effect.size("slope") * moved_N
    change.roll(-grown_m / step.radii_m[0], grown_m / step.radii_m[1])


def _side_slip(effect: _Effect, step: _Step, change: _Change) -> None:
    turned = -step.nominal.turn_rad if step.nominal.way_m < 0.0 else step.nominal.turn_rad
    angle = effect.size("slip_per_acceleration") * step.speed_mps**2
    change.aside_m -= (angle + effect.size("speed_per_acceleration") * abs(step.speed_mps)) * turned


def _direction(effect: _Effect, step: _Step, change: _Change) -> None:
    rolls_back = max(step.nominal.left_m, step.nominal.right_m) < 0.0
    back = rolls_back if "rolling" in effect.form else step.run.direction == "back"
    _both(change, effect.size("relative") * (-1.0 if back else 1.0))


def _drag(effect: _Effect, step: _Step, change: _Change) -> None:
    outward = step.nominal.way_m >= 0.0 if "rolling" in effect.form else step.run.direction != "back"
    _one(change, effect.form, effect.size("relative") if outward != ("back" in effect.form) else 0.0)


def _lost(effect: _Effect, step: _Step, change: _Change) -> None:
    way_m = step.nominal.left_m if effect.form.startswith("left") else step.nominal.right_m
    speed_mps = abs(way_m) / step.dt_s if step.dt_s > 0.0 else 0.0
    over = max(speed_mps - effect.settings["speed_mps"], 0.0) if "speed_mps" in effect.settings else 1.0
    _one(change, effect.form, (effect.size("share") + effect.size("share_per_mps")) * over)


def _eccentric(effect: _Effect, step: _Step, change: _Change) -> None:
    for at, side in enumerate(("left", "right")):
        half = 0.5 * step.angles_rad[at]
        middle = step.phases_rad[at] - half
        share = (math.sin(half) / half if half else 1.0) / step.radii_m[at]
        _one(change, side, effect.size(f"{side}_cos") * math.cos(middle) * share)
        _one(change, side, -effect.size(f"{side}_sin") * math.sin(middle) * share)


def _covariate(effect: _Effect, step: _Step, change: _Change) -> None:
    off = effect.deviation(step.run.covariates.get(effect.name.partition(":")[2], math.nan))
    size = effect.size("relative_per_sd") * off
    if "both" in effect.form:
        _both(change, size)
    elif "relative_per_sd" in effect.sizes:
        _one(change, effect.form, size)
    change.turn_rad += effect.size("yaw_per_sd") * off * step.nominal.way_m


_ACTS: dict[str, Callable[[_Effect, _Step, _Change], None]] = {
    "temperature_radius": _temperature,
    "speed_radius": _speed,
    "wear": _wear,
    "radius_scale": _radius_scale,
    "unequal_radii": _unequal,
    "track_width": _track_width,
    "load_radius": _load,
    "load_radius_nonlinear": _load_curve,
    "load_creep": _creep,
    "load_dependent_track": _load_track,
    "curve_scrub": _scrub,
    "curve_load_transfer": _curve_load,
    "side_slip": _side_slip,
    "travel_direction": _direction,
    "rear_drag": _drag,
    "lost_counts": _lost,
    "wheel_eccentricity": _eccentric,
}
#: effect -> what of a run it follows
_FOLLOWS = {
    "temperature_radius": "temperature_C",
    "speed_radius": "speed_mps",
    "wear": "travelled_km",
    "load_creep": "minutes_under_load",
}
#: forms that act through what a single run does not know
_OTHER_FORMS = ("change of load", "per session", "along the corridor alone", "other routes", "distance")


class Effects:
    """The law and the named effects of a coefficient file, run by run and step by step.

    `document`: the file of `coefficients` as JSON; `left_out`: its effects that do not act on the wheels; `unknown`:
    those that do, but follow what is not known of the run begun.
    """

    def __init__(self, coefficients: Coefficients, document: dict[str, Any]) -> None:
        self.coefficients = coefficients
        self._effects: list[tuple[Callable[[_Effect, _Step, _Change], None], _Effect]] = []
        left_out: list[str] = []
        for section in document.get("effects", []):
            name, form = str(section["effect"]), str(section.get("form", ""))
            acts = _covariate if name.startswith("covariate:") else _ACTS.get(name)
            if acts is None or any(words in form for words in _OTHER_FORMS):
                left_out.append(name)
                continue
            effect = _Effect(
                name=name,
                form=form,
                settings={key: float(value) for key, value in section.get("settings", {}).items()},
                sizes={key: float(value["value"]) for key, value in section["parameters"].items()},
                vehicle=coefficients,
                cog_z_m=float(document["vehicle"]["cog_z"]["value"]),
            )
            self._effects.append((acts, effect))
        self.left_out = tuple(left_out)
        self._run: Run | None = None
        self.unknown: tuple[str, ...] = ()
        self._phases = (0.0, 0.0)

    @classmethod
    def from_file(cls, path: str | Path) -> "Effects":
        """Read and verify the file at `path`; raises CoefficientError where it cannot be used."""
        coefficients = Coefficients.read(path)
        document = json.loads(Path(path).read_bytes().decode("utf-8-sig"))
        try:
            return cls(coefficients, document)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise CoefficientError(f"{path}: effects: {type(error).__name__}: {error}") from error

    def begin(self, run: Run) -> None:
        """Begin a run: its loads and surroundings hold until the next one.

        Raises CoefficientError where a load is not finite, or not valid and not clamped by the file.
        """
        self._run, file = None, self.coefficients
        loads = {}
        for name, wheel in (("load_left_N", file.left), ("load_right_N", file.right)):
            load_N, low, high = getattr(run, name), wheel.load_min_N, wheel.load_max_N
            loads[name] = min(max(load_N, low), high)
            if not math.isfinite(load_N) or not file.takes([load_N], [loads[name]]):
                raise CoefficientError(f"begin: {name}: found {load_N:g}; expected {low:g} to {high:g} N")
        known = {name: getattr(run, column) for name, column in _FOLLOWS.items()}
        known |= {f"covariate:{name}": value for name, value in run.covariates.items()}
        names = [effect.name for _, effect in self._effects if effect.name in _FOLLOWS or ":" in effect.name]
        self.unknown = tuple(name for name in names if not math.isfinite(known.get(name, math.nan)))
        self._run = replace(run, **loads)
        self._phases = (run.phase_left_rad, run.phase_right_rad)

    def step(self, d_left_rad: float, d_right_rad: float, dt_s: float) -> Motion:
        """Return the motion of a step in which the wheels turn by these angles; CoefficientError without a run."""
        run = self._run
        if run is None:
            raise CoefficientError("step: found no run; expected begin(Run(...)) before it")
        file = self.coefficients
        radii = file.left.radius_m(run.load_left_N), file.right.radius_m(run.load_right_N)
        self._phases = self._phases[0] + d_left_rad, self._phases[1] + d_right_rad
        nominal = Motion(d_left_rad * radii[0], d_right_rad * radii[1], file.track_m)
        motion = nominal
        for _ in range(PASSES):
            step = _Step(run, nominal, motion, (d_left_rad, d_right_rad), self._phases, radii, dt_s)
            change = _Change()
            for acts, effect in self._effects:
                acts(effect, step, change)
            motion = Motion(
                left_m=nominal.left_m * (1.0 + change.left),
                right_m=nominal.right_m * (1.0 + change.right),
                track_m=nominal.track_m * (1.0 + change.track),
                aside_m=change.aside_m,
                further_turn_rad=change.turn_rad,
            )
        return motion
