"""A design and a truth make a campaign: a drive, read by instruments."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from calib.campaign.model import REFERENCE_POSE, SIMULATED_POSE, Campaign, Logs, RunTable
from calib.campaign.settings import Encoder, OdometryModel, Rangefinder, Reference
from calib.plant.design import REFERENCE_LOAD_N, Design
from calib.plant.drive import Record, drive
from calib.plant.effects import find
from calib.plant.world import Cause, Noise, NoiseDraw, World, build_world, draw_noise, random_noise, wheel_loads
from calib.types import FloatArray

_STEER_STEP_RAD = 5e-4


def reference_poses(world: World, noise: NoiseDraw, record: Record) -> FloatArray:
    """Return the pose reference without reading noise, shape (3, n_frames, n_runs)."""
    late = world.latency_s * record.v_mps
    late = np.minimum(late, np.hypot(record.x_m, record.y_m))
    curvature = record.omega_radps / np.where(record.v_mps > 1e-9, record.v_mps, 1.0)
    theta = record.theta_rad - np.where(record.v_mps > 0, late * curvature, 0.0)
    x, y = record.x_m - late * np.cos(record.theta_rad), record.y_m - late * np.sin(record.theta_rad)
    x, y = world.seen_target(x, y, theta, world.ref_yaw_rad + noise.start_heading_rad)
    return np.stack([x, y, theta + noise.start_heading_rad])


def steering_readings(world: World, noise: NoiseDraw, record: Record, *, quantise: bool = True) -> FloatArray:
    """Return steering readings, shape (n_frames, n_runs)."""
    steer = record.late_rad
    if world.steer_backlash_rad.any():
        half = 0.5 * world.steer_backlash_rad
        shown = np.empty_like(steer)
        at = steer[0]
        for number, angle in enumerate(steer):
            at = np.clip(at, angle - half, angle + half)
            shown[number] = at
        steer = shown
    steer = world.steer_scale * steer + world.steer_zero_rad + noise.steer_rad
    if noise.reading_rad:
        steer = steer + noise.reading_rad * np.random.default_rng([noise.seed, 8]).standard_normal(steer.shape)
    return np.round(steer / _STEER_STEP_RAD) * _STEER_STEP_RAD if quantise else steer


def _with_blunder(world: World, counts: FloatArray) -> FloatArray:
    if not world.blunder:
        return counts
    struck = world.blunder_runs > 0
    left, right, front = counts
    faulty = {
        "double_left": (2 * left, right),
        "quad_both": (4 * left, 4 * right),
        "pi_right": (left, np.round(np.pi * right)),
        "swapped": (right, left),
        "sign_left": (-left, right),
        "half_right": (left, np.floor(0.5 * right)),
    }[world.blunder]
    return np.stack([np.where(struck, faulty[0], left), np.where(struck, faulty[1], right), front])


def simulated_poses(world: World, record: Record) -> FloatArray:
    """Return an outside simulator's end poses, shape (3, n_runs), by exact arcs or (`world.euler`) Euler steps."""
    per_rad = world.design.counts_per_rev / (2 * np.pi)
    left, right = (record.counts[side] / per_rad for side in (0, 1))
    left_m, right_m = left * world.believed_left_m, right * world.believed_right_m
    theta = (right_m - left_m) / world.model.track_m
    way = np.diff(0.5 * (left_m + right_m), axis=0)
    turn = np.diff(theta, axis=0)
    heading = np.where(world.euler > 0, theta[1:], 0.5 * (theta[1:] + theta[:-1]))
    chord = np.where(world.euler > 0, way, way * np.sinc(turn / (2 * np.pi)))
    x, y = np.sum(chord * np.cos(heading), axis=0), np.sum(chord * np.sin(heading), axis=0)
    return np.stack([x, y, theta[-1]])


def _columns(
    world: World, draw: NoiseDraw, record: Record, end_counts: FloatArray, end_pose: FloatArray
) -> dict[str, FloatArray]:
    design = world.design
    laser = world.laser_scale * record.last(record.x_m) + world.laser_offset_m + draw.laser_m
    posed = design.posed
    stated = ("payload_kg", "payload_x_m", "payload_y_m", "speed_mps", "temperature_C", "minutes_under_load")
    numbers: dict[str, FloatArray] = {name: getattr(design, name) for name in stated}
    numbers |= {"counts_left": end_counts[0], "counts_right": end_counts[1]}
    reported = wheel_loads(design.vehicle, design.payload_kg, design.payload_x_m, design.payload_y_m)
    weighed = (world.load_left_N, world.load_right_N) if design.weighed else reported
    numbers["load_left_N"], numbers["load_right_N"] = (np.round(load, 2) for load in weighed)
    if design.laser and design.corridor.any():
        numbers["distance_m"] = np.where(design.corridor, np.round(laser, 4), np.nan)
    if posed.any():
        measured = np.where(posed, np.round(end_pose, 5), np.nan)
        numbers |= dict(zip(REFERENCE_POSE, measured, strict=True))
    if design.outside:
        simulated = np.round(simulated_poses(world, record), 5)
        names = SIMULATED_POSE
        numbers |= dict(zip(names, np.where(posed, simulated, np.nan), strict=True))
        if "distance_m" in numbers:
            numbers["sim_distance_m"] = np.where(design.corridor, simulated[0], np.nan)
    if world.weave_m.any():
        numbers["amplitude_m"] = np.round(world.weave_m, 4)
        numbers["wavelength_m"] = np.where(world.weave_m > 0, np.round(world.wavelength_m, 3), np.nan)
    return numbers | dict(design.columns)


def campaign_of(world: World, noise: Noise, draw: NoiseDraw, record: Record, n_runs: int) -> Campaign:
    """Return the campaign; after `n_runs` names and lines begin again; see `make_campaign`."""
    design = world.design
    counts = _with_blunder(world, record.counts)
    poses = reference_poses(world, draw, record)
    numbers = _columns(world, draw, record, record.last(counts), record.last(poses) + draw.pose.T)
    width = max(3, len(str(n_runs)))
    logged = design.log_period_s > 0
    number = np.arange(len(design)) % n_runs
    run_id = np.array([f"r{one:0{width}d}" for one in number])
    labels = {"run_id": run_id} | {name: getattr(design, name) for name in ("session", "kind", "direction")}
    if logged:
        labels["log"] = np.array([f"logs/{run}.csv" for run in run_id])
    given = {column: values.astype(np.float64) for column, values in numbers.items()}
    table = RunTable(labels=labels, numbers=given, excluded=np.zeros(len(design), dtype=bool), line=number + 2)
    sigmas = (noise.laser_m, noise.ref_xy_m, noise.ref_theta_rad)
    laser_m, xy_m, theta_rad = (float(f"{sigma * noise.stated_ratio:.2g}") for sigma in sigmas)
    return Campaign(
        root=None,
        name="campaign",
        simulated=True,
        vehicle=design.vehicle,
        encoder=Encoder(design.counts_per_rev, design.counts_per_rev),
        model=world.model,
        rangefinder=Rangefinder(sigma_m=laser_m),
        reference=Reference(sigma_xy_m=xy_m, sigma_theta_rad=theta_rad),
        runs=table,
        logs=_logs(world, noise, draw, record, counts, poses) if logged else Logs.empty(len(design)),
    )


def _logs(world: World, noise: Noise, draw: NoiseDraw, record: Record, counts: FloatArray, poses: FloatArray) -> Logs:
    design = world.design
    columns = {"t_s": np.round(record.t_s, 3), "counts_left": counts[0], "counts_right": counts[1]}
    if design.front:
        columns["steer_rad"] = np.round(steering_readings(world, draw, record), 4)
        columns["counts_front"] = counts[2]
    if design.trace:
        rng = np.random.default_rng([draw.seed, 7])
        scale = np.array([noise.ref_xy_m, noise.ref_xy_m, noise.ref_theta_rad])[:, None, None]
        read = poses + scale * rng.standard_normal(poses.shape)
        read[:, 0] = 0.0
        read[:, record.frames - 1, np.arange(len(design))] = record.last(poses) + draw.pose.T
        columns |= dict(zip(REFERENCE_POSE, np.round(read, 5), strict=True))
    kept = (np.arange(record.t_s.shape[0])[:, None] < record.frames).T  # (n_runs, n_frames)
    offsets = np.concatenate(([0], np.cumsum(kept.sum(axis=1)))).astype(np.int64)
    return Logs(offsets, {name: np.ascontiguousarray(values.T[kept]) for name, values in columns.items()})


def random_model(design: Design, rng: np.random.Generator) -> OdometryModel:
    """Return what the simulator believes: a calibrated vehicle."""
    vehicle = design.vehicle
    radius = vehicle.wheel_radius_m * (1 + 2e-3 * rng.uniform(-1, 1, 2) - 5e-3)
    slopes = design.slope_per_N * radius * np.array([1.0, rng.uniform(0.85, 1.15)])
    return OdometryModel(
        radius_left_m=round(float(radius[0]), 6),
        radius_right_m=round(float(radius[1]), 6),
        track_m=round(vehicle.track_m * (1 + 5e-3 * float(rng.uniform(-1, 1))), 5),
        reference_load_N=REFERENCE_LOAD_N,
        slope_left_m_per_N=float(f"{slopes[0]:.6g}"),
        slope_right_m_per_N=float(f"{slopes[1]:.6g}"),
    )


def as_causes(truth: Mapping[str, float] | Sequence[Cause], design: Design, rng: np.random.Generator) -> list[Cause]:
    """Return causes with all their knobs drawn; for `truth` see `make_campaign`."""
    if not isinstance(truth, Mapping):
        return list(truth)
    causes = []
    for key, size in truth.items():
        known = find(*key.split("/"))
        size = float(known.typical if np.isnan(size) else size)
        causes.append(Cause(known.effect, size, known.form, known.knobs(rng, design)))
    return causes


def apply_causes(world: World, causes: Sequence[Cause], blocks: FloatArray | None = None) -> World:
    """Let causes change a world in place, and return it.

    `blocks` (n_causes, n_runs): share of each cause's size that acts on each run.
    """
    n_runs = len(world.design)
    for number, cause in enumerate(causes):
        share = np.ones(n_runs) if blocks is None else blocks[number]
        find(cause.effect, cause.form).act(world, cause.size * share, cause.knobs)
    return world


def make_campaign(
    design: Design,
    truth: Mapping[str, float] | Sequence[Cause],
    rng: np.random.Generator,
    *,
    noise: Noise | None = None,
    model: OdometryModel | None = None,
    name: str = "campaign",
) -> Campaign:
    """Drive a design in a world with a known truth, in memory; see `calib.campaign.tables.write_campaign`.

    `truth`: ``{effect: size}`` or ``{"effect/form": size}``; NaN is the typical size. `noise`, `model` (what the
    simulator believes): drawn at random where missing.
    """
    return make_campaigns(design, truth, rng, noise=noise, model=model, names=(name,))[0]


def make_campaigns(
    design: Design,
    truth: Mapping[str, float] | Sequence[Cause],
    rng: np.random.Generator,
    *,
    noise: Noise | None = None,
    model: OdometryModel | None = None,
    names: Sequence[str] = ("campaign",),
) -> tuple[Campaign, ...]:
    """Drive a design as often as there are names, each time with other noise; see `make_campaign`."""
    noise = noise or random_noise(rng)
    model = model or random_model(design, rng)
    causes = as_causes(truth, design, rng)
    n_runs, times = len(design), len(names)
    stacked = design if times == 1 else design.select(np.tile(np.arange(n_runs), times))
    world = apply_causes(build_world(stacked, model), causes)
    draw = draw_noise(noise, n_runs * times, rng)
    driven = campaign_of(world, noise, draw, drive(world, draw), n_runs)
    parts = np.split(np.arange(n_runs * times), times)
    return tuple(replace(driven.select(part), name=name) for part, name in zip(parts, names, strict=True))
