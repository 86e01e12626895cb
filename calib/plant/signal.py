"""The signal of an effect, and what else could leave the same.

It is the whitened norm of what an effect does in noise-free drives, beside a recalibration.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Final

import numpy as np

from calib.campaign.settings import OdometryModel
from calib.plant import Cause, Causes, Noise, NoiseDraw, World, build_world, quiet
from calib.plant.design import Design
from calib.plant.drive import Record, drive, reference_poses, simulated_poses, steering_readings
from calib.plant.effects import ALL, find
from calib.plant.make import apply_causes
from calib.types import FloatArray, floats, grouped

#: effects that a recalibration absorbs: their signal is without one
CALIBRATION: Final = ("radius_scale", "unequal_radii", "track_width")
#: these act with the square of their size
_SQUARED: Final = ("beam_misalignment", "path_weave")
_ABSORBED = 1e-2  # share of a change's norm below which the recalibration absorbs it
_LARGEST, _SMALLEST = 3.0, 0.05


def is_calibration(cause: Cause) -> bool:
    """Return whether a recalibration absorbs a cause; see `CALIBRATION`."""
    return cause.effect in CALIBRATION or (cause.effect, cause.form) == ("lost_counts", "constant")


def outputs(world: World, draw: NoiseDraw, record: Record, *, quantise: bool = False) -> FloatArray:
    """Return measured minus odometry, (n_runs, 6), NaN where a run lacks the channel.

    Laser distance; end x, y, theta in the start's frame; front wheel's distance and heading.
    """
    design, end = world.design, record.end
    poses = reference_poses(world, draw, end)[:, 0] + draw.pose.T
    own = end.odo[:, 0]
    if design.outside:
        own = np.concatenate([simulated_poses(world, record), own[3:]])
    laser = world.laser_scale * end.x_m[0] + world.laser_offset_m + draw.laser_m
    out = np.full((len(design), 6), np.nan)
    corridor = design.corridor
    if design.laser:
        believed = own[0] if design.log_period_s > 0 else own[3]
        out[corridor, 0] = (laser - believed)[corridor]
    posed = design.posed
    out[posed, 1:4] = (poses - own[:3]).T[posed]
    if design.front and design.log_period_s > 0:
        steer = steering_readings(world, draw, record, quantise=quantise)
        rolled = np.diff(record.counts[2], axis=0) * (2 * np.pi / design.counts_per_rev) * design.vehicle.wheel_radius_m
        angle = 0.5 * (steer[1:] + steer[:-1])
        out[:, 4] = np.sum(rolled * np.cos(angle), axis=0) - own[3]
        out[:, 5] = np.sum(rolled * np.sin(angle), axis=0) / design.vehicle.wheelbase_m - own[2]
    return out


def _levers(record: Record) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    # change of the outputs by a metre of path error and by a radian of heading error, (n_steps, n_runs, 6); way and
    # turn of each step, (n_steps, n_runs)
    x, y, theta, s = record.odo
    way, turned = np.diff(s, axis=0), np.diff(theta, axis=0)
    middle = 0.5 * (theta[1:] + theta[:-1])
    end_x, end_y = record.last(x), record.last(y)
    across, along = -(end_y - 0.5 * (y[1:] + y[:-1])), end_x - 0.5 * (x[1:] + x[:-1])
    one, zero = np.ones_like(middle), np.zeros_like(middle)
    cos, sin = np.cos(middle), np.sin(middle)
    path = np.stack([cos, cos, sin, zero, one, zero], axis=-1)
    turn = np.stack([across, across, along, one, zero, one], axis=-1)
    return path, turn, way, turned


def covariance(world: World, noise: Noise, record: Record) -> FloatArray:
    """Return the covariance of `outputs`, shape (n_runs, 6, 6), by linear propagation."""
    (path, turn, way, turned), track = _levers(record), world.model.track_m
    variance = noise.texture_m**2 * np.abs(way)
    total = np.einsum("kr,krc,krd->rcd", 0.5 * variance, path, path)
    total += np.einsum("kr,krc,krd->rcd", 2 / track**2 * variance, turn, turn)
    common = np.einsum("kr,krc->rc", way, path) + np.einsum("kr,krc->rc", turned, turn)
    split = np.einsum("kr,krc->rc", way / track, turn)
    total += noise.common**2 * common[:, :, None] * common[:, None, :]
    total += noise.differential**2 * split[:, :, None] * split[:, None, :]
    end_x, end_y, end_theta, length = record.last(record.odo)
    n_runs = len(end_x)
    zero, one = np.zeros(n_runs), np.ones(n_runs)
    start = np.stack([zero, -end_y, end_x, one, zero, zero], axis=1) * noise.start_heading_rad
    # a steering zero: less forward by L theta, more heading by S / L
    wheelbase = world.design.vehicle.wheelbase_m
    steer = np.stack([zero, zero, zero, zero, -wheelbase * end_theta, length / wheelbase], axis=1) * noise.steer_rad
    spacing = world.design.speed_mps * (world.design.log_period_s or 0.1)
    front = np.stack([zero, zero, zero, zero, length, end_theta], axis=1) * noise.front
    for run in (start, steer, front):
        total += run[:, :, None] * run[:, None, :]
    instruments = (one * sigma**2 for sigma in (noise.laser_m, noise.ref_xy_m, noise.ref_xy_m, noise.ref_theta_rad))
    counted = (noise.texture_m**2 * length + 1e-8, (noise.reading_rad / wheelbase) ** 2 * length * spacing + 1e-8)
    return np.asarray(total + np.stack([*instruments, *counted], axis=1)[:, :, None] * np.eye(6))


def recalibration(world: World, record: Record) -> FloatArray:
    """Return what changes of the two radii and of the track do to `outputs`, shape (n_runs, 6, 3)."""
    (path, turn, way, turned), track = _levers(record), world.model.track_m
    left, right = way - 0.5 * track * turned, way + 0.5 * track * turned

    def to(further: FloatArray, turning: FloatArray) -> FloatArray:
        return np.asarray(np.einsum("kr,krc->rc", further, path) + np.einsum("kr,krc->rc", turning, turn))

    parts = (to(0.5 * left, -left / track), to(0.5 * right, right / track), to(0 * left, -turned))
    return np.stack(parts, axis=-1)


def strength(change: FloatArray, cov: FloatArray, absorbed: FloatArray | None) -> float:
    """Return the whitened norm of a change (n_runs, 6), NaN where a run lacks the channel.

    `cov`: (n_runs, 6, 6), of the noise; `absorbed`: (n_runs, 6, n), projected out.
    """
    return float(np.linalg.norm(_left_of(change, cov, absorbed)))


def _left_of(change: FloatArray, cov: FloatArray, absorbed: FloatArray | None) -> FloatArray:
    present = np.isfinite(change)
    both = present[:, :, None] & present[:, None, :]
    root = np.linalg.cholesky(np.where(both, cov, np.where(np.eye(6, dtype=bool), 1.0, 0.0)))
    white = np.linalg.solve(root, np.where(present, change, 0.0)[:, :, None])[:, :, 0].ravel()
    if absorbed is None:
        return floats(white)
    directions = np.linalg.solve(root, np.where(present[:, :, None], absorbed, 0.0)).reshape(len(white), -1)
    scale = np.linalg.norm(directions, axis=0)
    unit = directions / np.where(scale > 0, scale, 1.0)
    return floats(white - unit @ np.linalg.lstsq(unit, white, rcond=1e-10)[0])


@dataclass(frozen=True, slots=True, eq=False)
class Strength:
    """How strongly causes show on a design."""

    alone: tuple[float, ...]  #: signal of each cause by itself
    beside: tuple[float, ...]  #: the same beside what the others could imitate
    change: FloatArray  #: shape (n_causes, n_runs, 6): what each does to the outputs
    cov: FloatArray  #: shape (n_runs, 6, 6): covariance of the noise
    absorbed: FloatArray  #: shape (n_runs, 6, 3): what a recalibration does


def strengths(
    design: Design, model: OdometryModel, noise: Noise, causes: Causes, *, step_s: float = 0.02, weigh: bool = True
) -> Strength:
    """Drive without noise, without and with each cause; see `Strength`; `weigh`: fill `alone` and `beside`."""
    n_runs, n_causes = len(design), len(causes)
    if design.log_period_s and not design.front:
        design = replace(design, log_period_s=0.24)
    world = build_world(design.select(np.tile(np.arange(n_runs), n_causes + 1)), model)
    # the first block without any cause, the next with the first alone, and so on
    blocks = np.repeat(np.eye(n_causes, n_causes + 1, 1), n_runs, axis=1)
    apply_causes(world, causes, blocks)
    still = quiet(n_runs).tile(n_causes + 1)
    logged = None if design.front or design.outside else n_runs
    record = drive(world, still, quantise=False, step_s=step_s, logged=logged)
    out = outputs(world, still, record).reshape(n_causes + 1, n_runs, 6)
    change = out[1:] - out[0]
    base_world = build_world(design, model)
    first = Record(*(getattr(record, field.name)[..., :n_runs] for field in fields(record)))
    cov, absorbed = covariance(base_world, noise, first), recalibration(base_world, first)
    if not weigh:
        return Strength((), (), change, cov, absorbed)
    taken_up = [None if is_calibration(cause) else absorbed for cause in causes]
    both = [(strength(one, cov, None), strength(one, cov, by)) for one, by in zip(change, taken_up, strict=True)]
    alone = tuple(left if left > _ABSORBED * whole else whole for whole, left in both)
    beside = list(alone)
    for number, by in enumerate(taken_up) if n_causes > 1 else ():
        others = np.nan_to_num(np.moveaxis(np.delete(change, number, axis=0), 0, -1))
        directions = others if by is None else np.concatenate([by, others], axis=2)
        beside[number] = strength(change[number], cov, directions)
    return Strength(alone, tuple(beside), change, cov, absorbed)


def to_signal(
    design: Design, model: OdometryModel, noise: Noise, causes: Causes, targets: Sequence[float]
) -> tuple[list[Cause], Noise, Strength]:
    """Scale causes to wanted signals, each alone (NaN: as it is), the noise first; see `Strength`."""
    wanted = floats(targets)
    sizes = np.array([cause.size for cause in causes])
    typical = np.array([find(cause.effect, cause.form).typical for cause in causes])
    scaled = list(causes)
    for attempt in range(3):
        reached_by = strengths(design, model, noise, scaled, step_s=0.04)
        reached = np.array(reached_by.alone)
        factor = np.where(np.isfinite(wanted) & (reached > 0), wanted / np.maximum(reached, 1e-12), 1.0)
        if attempt == 0 and len(causes):
            ratio = float(np.max(np.abs(sizes * factor) / typical))
            quieter = np.clip(_LARGEST / ratio, 0.25, 1.0) if ratio > _LARGEST else 1.0
            louder = np.clip(_SMALLEST / ratio, 1.0, 3.0) if ratio < _SMALLEST else 1.0
            noise = noise.times(float(quieter * louder))
            factor = np.where(np.isfinite(wanted), factor * quieter * louder, factor)
        if np.all(np.abs(factor - 1) < 0.02):
            if attempt:
                return scaled, noise, reached_by
            break
        sizes = sizes * factor ** np.array([0.5 if cause.effect in _SQUARED else 1.0 for cause in causes])
        scaled = [replace(cause, size=float(f"{size:.5g}")) for cause, size in zip(causes, sizes, strict=True)]
    return scaled, noise, strengths(design, model, noise, scaled, step_s=0.04)


_EXPONENTS = {"hertz": 2 / 3, "root": 0.5, "quadratic": 2.0, "power": 0.87, "running_in": 0.8}
_SKIPPED = ("encoder_gross", "integration_scheme", "path_weave", "floor_zone")
#: effect -> knobs whose sums span what it can do
_KNOBS: Final[dict[str, list[dict[str, float]]]] = {
    "load_creep": [{"tau_min": 15.0}],
    "wheel_eccentricity": [{"left_rad": a, "right_rad": b} for a, b in ((0.0, 0.0), (1.57, 0.0), (0.0, 1.57))],
    **{effect: [{"right": 0.0}, {"right": 1.0}] for effect in ("rear_drag", "lost_counts")},
    "reference_lever_arm": [{"towards_rad": 0.0}, {"towards_rad": np.pi / 2}],
    "floor_slope": [{"downhill_rad": 0.0}, {"downhill_rad": np.pi / 2}],
}


def lacks(design: Design, needs: Iterable[str]) -> list[str]:
    """Return what a design lacks of an effect's needs."""
    turning = bool((~design.corridor).any())
    has = {
        "loads": len(np.unique(design.payload_kg)) > 1,
        "offsets": len(np.unique(design.payload_kg)) > 2 and len(np.unique(design.payload_y_m)) > 1,
        "turns": turning,
        "bends": len(set(design.kind[~design.corridor])) > 2,
        "speeds": len(np.unique(design.speed_mps)) > 1,
        "three_speeds": len(np.unique(design.speed_mps)) > 2,
        "temperatures": float(np.ptp(design.temperature_C)) > 5.0,
        "dwell": len(np.unique(design.minutes_under_load)) > 2,
        "sessions": len(set(design.session)) > 1,
        "directions": len(set(design.direction) & {"out", "back"}) > 1,
        "corridor": bool(design.corridor.any()),
        "laser": design.laser and bool(design.corridor.any()),
        "poses": design.poses == "all" or (design.poses == "turning" and turning),
        "front": design.front,
        "flying": bool(design.flying.any()),
        "stops": bool(design.stops.any()),
        "slope": design.slope_per_N != 0.0,
        "trace": design.trace,
        "lengths": bool((design.kind == "corridor_short").any()),
        "lanes": bool(np.char.endswith(design.kind, "_b").any()),
        "outside": design.outside,
        "no_logs": design.log_period_s == 0.0,
    }
    return sorted(
        one for one in needs if not (one.partition(":")[2] in design.columns if one.startswith("column:") else has[one])
    )


def _variants(design: Design, slope_per_N: float) -> list[Cause]:
    n_sessions = len(set(design.session))
    variants: list[Cause] = []
    for form in ALL:
        if form.effect in _SKIPPED or form.effect.startswith("outside:"):
            continue
        if lacks(design, form.needs - {"slope", "offsets"}) or ("slope" in form.needs and slope_per_N == 0.0):
            continue
        size = 0.2 * form.typical
        knobs = _KNOBS.get(form.effect, [{}])
        if form.effect.startswith(("load_radius", "wear")):
            exponent = _EXPONENTS.get(form.form, 1.0)
            knobs = [{"right_ratio": ratio, "exponent": exponent} for ratio in (0.0, 1.0)]
        elif form.effect == "session_step":
            knobs = [{f"step_{knob}": 1.0} for knob in range(1, n_sessions)] if form.form == "plain" else []
        elif form.effect.startswith("covariate:"):
            knobs = [form.knobs(np.random.default_rng(0), design)]
        variants.extend(Cause(form.effect, size, form.form, knob) for knob in knobs)
    return variants


@dataclass(frozen=True, slots=True, eq=False)
class Alternatives:
    """A cause, and small sizes of everything that the effects can do on its runs."""

    cause: Cause
    variants: list[Cause]
    driven: Strength  #: of the cause first, then of each variant

    def families(self) -> dict[tuple[str, str], list[int]]:
        """Return the numbers of the variants of each form of an effect; the cause is number 0."""
        numbered = enumerate(self.variants, start=1)
        return grouped(((one.effect, f"{one.form}{one.knobs.get('right', '')}"), number) for number, one in numbered)

    def left(self, number: int) -> FloatArray:
        """Return what one leaves, whitened, beside a recalibration."""
        return _left_of(self.driven.change[number], self.driven.cov, self.driven.absorbed)


def alternatives(design: Design, model: OdometryModel, noise: Noise, cause: Cause) -> Alternatives:
    """Drive a cause and all that the design can show."""
    variants = _variants(design, model.slope_left_m_per_N)
    driven = strengths(design, model, noise, [cause, *variants], step_s=0.08, weigh=False)
    return Alternatives(cause, variants, driven)


def rivals(among: Alternatives) -> list[tuple[str, float]]:
    """Return the other effects, nearest first, each with the norm of what it cannot imitate of the cause."""
    driven = among.driven
    nearest: dict[str, float] = {}
    base = [] if is_calibration(among.cause) else [driven.absorbed]
    for (effect, _), numbers in among.families().items():
        if effect == among.cause.effect:
            continue
        columns = np.stack([np.nan_to_num(driven.change[number]) for number in numbers], axis=-1)
        distance = strength(driven.change[0], driven.cov, np.concatenate((*base, columns), axis=-1))
        nearest[effect] = min(nearest.get(effect, np.inf), distance)
    return [(effect, round(nearest[effect], 3)) for effect in sorted(nearest, key=nearest.__getitem__)]


def signatures(among: Alternatives) -> dict[str, list[FloatArray]]:
    """Return what each form of an effect can do, whitened, beside a recalibration."""
    return grouped(
        (effect, np.stack([among.left(number) for number in numbers], axis=1))
        for (effect, _), numbers in among.families().items()
        if not is_calibration(among.variants[numbers[0] - 1])
    )
