"""Encoders: eccentric wheels, lost counts, and blunders (wrong factor, side or sign)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Final
from weakref import WeakKeyDictionary

import numpy as np

from calib.gap import Perturbation
from calib.gap.effects import Effect, Family, Form, Parameter, Perturbations, acting_on, varies
from calib.gap.effects.quantities import PAPER_RADIUS_M, mean_radius_m
from calib.gap.observations import Observations
from calib.gap.predict import Path, predict, residuals
from calib.types import FloatArray

#: counters that begin within a hundredth of a turn in all runs are set back before each
SAME_PHASE_RAD: Final = 0.06


class WheelEccentricity(Effect):
    """The travel of a wheel gains e [sin(phi + phi_0) - sin(phi_0)], never more than 2 e.

    Linear in e cos(phi_0) and e sin(phi_0). phi_0 is common to runs only where the counter keeps its place between
    them; else it is assumed.
    """

    id = "wheel_eccentricity"
    title = "an eccentric wheel"
    implausible = "a slipping encoder coupling"
    family = Family.COUNTS
    of_rear_wheels = True
    needs = "logs"
    separates = "the log within a run"

    def forms(self, observations: Observations) -> list[Form]:
        """See `Effect`."""
        if not observations.from_log.any():
            return []

        kept: WeakKeyDictionary[Path, dict[str, list[Perturbation]]] = WeakKeyDictionary()

        def perturbations(path: Path, sides: Sequence[str]) -> list[Perturbation]:
            if path not in kept:
                s = path.s
                lefts = _eccentric(s, s.phase_left_rad, s.roll_left_rad, s.radius_left_m)
                rights = _eccentric(s, s.phase_right_rad, s.roll_right_rad, s.radius_right_m)
                kept[path] = {
                    "left": [Perturbation(left=part) for part in lefts],
                    "right": [Perturbation(right=part) for part in rights],
                }
            return [perturbation for side in sides for perturbation in kept[path][side]]

        typical = 2e-4 * min(1.0, mean_radius_m(observations) / PAPER_RADIUS_M)

        def form(label: str, sides: Sequence[str]) -> Form:
            names = [f"{side}_{part}" for side in sides for part in ("cos", "sin")]
            parameters = tuple(Parameter(name, "m", typical=typical, largest=10.0 * typical) for name in names)
            return Form(self.id, label, parameters, lambda path: perturbations(path, sides), tries=3, by_parts=True)

        return [form("left wheel", ["left"]), form("right wheel", ["right"]), form("both wheels", ["left", "right"])]

    def assumption(self, observations: Observations) -> str:
        """Say where all counters begin alike in every run, which wheels do not.

        All ends of a route then have one phase, and the effect is a constant of each route, as any cause may have.
        """
        s, first = observations, observations.starts[:-1][observations.from_log]
        rolled = ((s.phase_left_rad, s.roll_left_rad), (s.phase_right_rad, s.roll_right_rad))
        begun = np.array([phase[first] - roll[first] for phase, roll in rolled])
        if s.windowed or len(first) < 2 or float(np.ptp(begun, axis=1).max()) >= SAME_PHASE_RAD:
            return ""
        return (
            "all counters begin alike, so each run is taken to begin at one angle of the wheels; unless they were set "
            "so, it is another cause, alike on each route: keep the counters running"
        )


def _eccentric(
    s: Observations, angle: FloatArray, roll: FloatArray, radius_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    middle, half = angle - 0.5 * roll, 0.5 * roll
    # sin(a) - sin(b) = 2 cos(middle) sin(half), so the quotient by the roll stays finite at rest
    share = np.where(s.from_log[s.unit], np.sinc(half / np.pi), 0.0) / radius_m[s.unit]
    return np.cos(middle) * share, -np.sin(middle) * share


class LostCounts(Effect):
    """One wheel travels a share p more than its counts say: p constant, or growing with its own speed above v_0.

    A constant share is an exact alias of that wheel's radius.
    """

    id = "lost_counts"
    title = "counts lost by one encoder"
    implausible = "the radius of that wheel, or a wrong count per revolution"
    family = Family.COUNTS
    of_rear_wheels = True
    needs = "headings or distances; two speeds for a share that grows"
    separates = "the front wheel as a second counter, at several speeds"
    shifts = ("radius_scale", "unequal_radii")

    def forms(self, observations: Observations) -> list[Form]:
        """See `Effect`."""
        ones = np.ones(len(observations))
        constant = Parameter("share", "1", typical=2e-3, largest=2e-2, sign=1)
        shapes: list[tuple[str, Parameter, dict[str, float]]] = [("constant share", constant, {})]
        speed = _wheels_mps(observations)
        if varies(speed, 0.02, observations):
            growing = Parameter("share_per_mps", "s/m", typical=5e-3, largest=5e-2, sign=1)
            # from rest on, or above a frequency that the counter still follows
            above = {
                " with speed": 0.0,
                " above the least speed": speed.min(),
                " above the median speed": np.median(speed),
            }
            for which, v_0 in above.items():
                if varies(np.maximum(speed - v_0, 0.0), 0.02, observations):
                    shapes.append((f"share growing{which}", growing, {"speed_mps": float(v_0)}))

        def form(side: str, label: str, parameter: Parameter, settings: dict[str, float]) -> Form:
            def at(stated: Mapping[str, float]) -> Perturbations:
                v_0 = stated.get("speed_mps")
                if v_0 is None:
                    return lambda path: [acting_on(path, side, ones)]
                # slow reversing and spins turn a counter, too
                return lambda path: [Perturbation(**{side: np.maximum(_wheel_mps(path.s, side) - v_0, 0.0)})]

            label, tries = f"{side} wheel, {label}", 2 * len(shapes)
            return Form(self.id, label, (parameter,), at(settings), settings, tries, at=at, by_parts=True)

        return [form(side, *shape) for shape in shapes for side in ("left", "right")]


def _wheel_mps(observations: Observations, side: str) -> FloatArray:
    with np.errstate(divide="ignore", invalid="ignore"):
        logged = np.abs(getattr(observations, f"travel_{side}_m")) / observations.duration_s
    known = observations.from_log[observations.unit] & np.isfinite(logged)
    return np.where(known, logged, np.abs(observations.speed_mps))


def _wheels_mps(observations: Observations) -> FloatArray:

    def mean(part: Observations) -> FloatArray:
        ways = [np.abs(part.travel_left_m), np.abs(part.travel_right_m)]
        over_way = ways[0] * _wheel_mps(part, "left") + ways[1] * _wheel_mps(part, "right")
        with np.errstate(divide="ignore", invalid="ignore"):
            return part.total(over_way) / part.total(ways[0] + ways[1])

    logged = observations.of_parts(mean)
    return np.where(observations.from_log & (logged > 0.0), logged, np.abs(observations.number("speed_mps")))


FACTORS: Final = {"2": 2.0, "4": 4.0, "pi": np.pi, "1/2": 0.5, "1/4": 0.25, "1/pi": 1 / np.pi, "10": 10.0, "1/10": 0.1}
_SWAPPED: Final = "swapped wheels"
#: where a front wheel drives the odometry
_REVERSED: Final = "the steering angle has the other sign"
#: a blunder leaves runs off by more than this share of their length on average
BLUNDER_MISFIT: Final = 0.08
#: and a correction is believed where it leaves less than this share of that
BLUNDER_RESIDUAL_SHARE: Final = 0.2
#: a run off by this share of its length, so many times what all but so few are, is not itself
BAD_RUN_MISFIT: Final = 0.2
BAD_RUN_RATIO: Final = 3.0
MOST_BAD_RUNS: Final = 0.25
#: rise over run, and radians, within which a run is straight
_STRAIGHT_ANGLE_RAD: Final = 0.2


class EncoderBlunder(Effect):
    """Factors of 2, 4, 10, pi on one wheel or both, swapped wheels, a sign."""

    id = "encoder_gross"
    title = "a blunder of the encoders"
    implausible = "a reference that was read in other units or axes"
    family = Family.COUNTS
    needs = "distances or end poses"
    separates = "any run: nothing else is so large"
    found_before_search = True

    def forms(self, observations: Observations) -> list[Form]:  # noqa: ARG002
        """See `Effect`."""
        return []


@dataclass(frozen=True, slots=True)
class Blunder:
    """What the counts have to be multiplied by to be right; sides swapped first where `swapped`."""

    effect = EncoderBlunder
    probability: ClassVar[float] = 1.0

    label: str
    left: float
    right: float
    swapped: bool = False

    @property
    def remark(self) -> str:
        """What to do about it."""
        axes = "or the reference's axes (y to the left, angles counter-clockwise), " if self.swapped else ""
        return f"correct it, {axes}then diagnose again"

    @property
    def sizes(self) -> Mapping[str, tuple[float, tuple[float, float], str]]:
        """Value, 95 % interval and unit of each factor: plain numbers that are sure."""
        return {name: (factor, (factor, factor), "1") for name, factor in self.factors.items()}

    @property
    def factors(self) -> dict[str, float]:
        """The factors, as a verdict and a coefficient file show them."""
        return {"factor_left": self.left, "factor_right": self.right}

    @classmethod
    def from_factors(cls, label: str, factors: Mapping[str, float]) -> "Blunder | None":
        """Return the fault of a label and its `factors`, None where one is missing or 0."""
        left, right = factors.get("factor_left"), factors.get("factor_right")
        return cls(label, left, right, swapped=label.startswith((_SWAPPED, _REVERSED))) if left and right else None


def _candidates() -> list[Blunder]:
    wheels = (("both wheels'", 1, 1), ("the left wheel's", 1, 0), ("the right wheel's", 0, 1))
    return [
        Blunder(_SWAPPED, 1.0, 1.0, swapped=True),
        *(
            Blunder(f"{whose} counts are to be multiplied by {label}", factor**left, factor**right)
            for label, factor in FACTORS.items()
            for whose, left, right in wheels
        ),
        Blunder("the left wheel counts backwards", -1.0, 1.0),
        Blunder("the right wheel counts backwards", 1.0, -1.0),
        Blunder("both wheels count backwards", -1.0, -1.0),
        Blunder(f"{_SWAPPED}, both counting backwards", -1.0, -1.0, swapped=True),
    ]


def corrected(observations: Observations, fault: Blunder) -> Observations:
    """Return the observations with the counts corrected."""
    left, right = ("right", "left") if fault.swapped else ("left", "right")
    counted = {
        f"{angle}_{side}_rad": getattr(observations, f"{angle}_{of}_rad") * factor
        for angle in ("roll", "phase")
        for side, of, factor in (("left", left, fault.left), ("right", right, fault.right))
    }
    if observations.by_front and fault.swapped:
        counted |= {name: -getattr(observations, name) for name in ("steer_rad", "steer_change_rad")}
    return replace(observations, **counted)


def bad_runs(nominal: Path) -> dict[str, float]:
    """Return the few runs that end off by a share of their length that no others come near, by id."""
    off, kind = misfit(nominal, by_kind=True), nominal.s.labels["kind"]
    order = np.argsort(-off, kind="stable")
    worst = off[order[: int(MOST_BAD_RUNS * len(off)) + 1]]
    apart = (worst[:-1] > BAD_RUN_MISFIT) & (worst[:-1] > BAD_RUN_RATIO * worst[1:])
    if nominal.s.windowed or not apart.any():
        return {}
    number = int(np.flatnonzero(apart)[-1]) + 1
    bad, others = np.sort(order[:number]), order[number:]
    if not np.isin(kind[bad], kind[others]).all():
        return {}
    return dict(zip(nominal.s.labels["run_id"][bad].tolist(), off[bad].tolist(), strict=True))


def misfit(path: Path, nominal: Path | None = None, *, by_kind: bool = False, by_extent: bool = False) -> FloatArray:
    """Return how far each observation is off, as a share of its length and of its turns, 1 at most, shape (n_obs,).

    The length is the way driven, or from start to end where that is more; turns of less than a radian count as one.
    Simulated motion: by the change from the `nominal` path. `by_kind`: of the middle run of its kind; `by_extent`: by
    the distance of a run that ends away from its start, and a radian.
    """
    observations = path.s
    about = path if nominal is None or not np.isfinite(observations.simulated).any() else nominal
    gap = np.where(observations.usable, np.abs(residuals(path, about)), 0.0)
    length = np.maximum(
        np.hypot(observations.measured[:, 1], observations.measured[:, 2]), np.nan_to_num(observations.measured[:, 0])
    )
    way, turned = observations.length_m, observations.of_parts(lambda part: part.total(np.abs(part.turn_rad)))
    for kind in np.unique(observations.labels["kind"]) if by_kind else ():
        mine = observations.labels["kind"] == kind
        way, turned = (np.where(mine, np.median(values[mine]), values) for values in (way, turned))
    away = np.isfinite(length) & (length > 0.5) & by_extent
    length = np.where(away, length, np.fmax(length, np.maximum(way, 0.5)))
    measured, usable = observations.measured, observations.usable
    aside = usable[:, 2] & ~(np.abs(measured[:, 2]) < _STRAIGHT_ANGLE_RAD * np.abs(measured[:, 1]))
    straight = ~aside & ~(usable[:, 3] & ~(np.abs(measured[:, 3]) < _STRAIGHT_ANGLE_RAD))
    ways = np.where(straight, gap[:, :2].max(axis=1), gap[:, :3].max(axis=1)) / length
    per_turn = np.where(
        straight, observations.model.track_m / length, 1.0 / np.maximum(0.0 if by_extent else turned, 1.0)
    )
    return np.asarray(np.minimum(np.maximum(ways, per_turn * gap[:, 3]), 1.0))


def find_blunder(observations: Observations, nominal: Path) -> Blunder | None:
    """Return the blunder that corrects the counts, None where they are roughly right or nothing helps."""
    if np.isfinite(observations.simulated).any():
        return None
    now = float(np.mean(misfit(nominal)))
    if now < BLUNDER_MISFIT:
        return None
    candidates = _candidates()
    if observations.by_front:
        candidates = [c for c in candidates if c.left == c.right and not c.swapped]
        candidates.append(Blunder(_REVERSED, 1.0, 1.0, swapped=True))
    left = [float(np.mean(misfit(predict(corrected(observations, fault))))) for fault in candidates]
    best = min(left)
    return candidates[left.index(best)] if best < min(BLUNDER_RESIDUAL_SHARE * now, BLUNDER_MISFIT) else None
