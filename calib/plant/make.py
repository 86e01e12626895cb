"""A design and a truth make a campaign: a drive, read by instruments; many make a fleet of known spread."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from calib.campaign import write_campaign
from calib.campaign.model import REFERENCE_POSE, SIMULATED_POSE, Campaign, Logs, RunTable
from calib.campaign.settings import Encoder, OdometryModel, Rangefinder, Reference
from calib.errors import FLEET_MONTHS, FLEET_RUNS, MissingExtraError, refuse_more
from calib.io import write_bytes
from calib.plant import Cause, Causes, Noise, NoiseDraw, World, build_world, draw_noise, random_noise, wheel_loads
from calib.plant.design import REFERENCE_LOAD_N, Design, good_design
from calib.plant.drive import Record, drive, reference_poses, simulated_poses, steering_readings, with_blunder
from calib.plant.effects import find
from calib.types import FloatArray, IntArray


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
        numbers |= dict(zip(SIMULATED_POSE, np.where(posed, simulated, np.nan), strict=True))
        if "distance_m" in numbers:
            numbers["sim_distance_m"] = np.where(design.corridor, simulated[0], np.nan)
    if world.weave_m.any():
        numbers["amplitude_m"] = np.round(world.weave_m, 4)
        numbers["wavelength_m"] = np.where(world.weave_m > 0, np.round(world.wavelength_m, 3), np.nan)
    return numbers | dict(design.columns)


def campaign_of(world: World, noise: Noise, draw: NoiseDraw, record: Record, n_runs: int) -> Campaign:
    """Return the campaign; after `n_runs` names and lines begin again; see `make_campaign`."""
    design = world.design
    counts = with_blunder(world, record.counts)
    poses = reference_poses(world, draw, record)
    numbers = _columns(world, draw, record, record.last(counts), record.last(poses) + draw.pose.T)
    width = max(3, len(str(n_runs)))
    logged = design.log_period_s > 0
    number = np.arange(len(design)) % n_runs
    run_id = np.array([f"r{one:0{width}d}" for one in number])
    labels = {"run_id": run_id} | {name: getattr(design, name) for name in ("session", "kind", "direction")}
    if logged:
        labels["log"] = np.array([f"logs/{run}.csv" for run in run_id])
    columns = {column: values.astype(np.float64) for column, values in numbers.items()}
    table = RunTable(labels=labels, numbers=columns, excluded=np.zeros(len(design), dtype=bool), line=number + 2)
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
    left_m, right_m = (round(one, 6) for one in radius.tolist())
    track_m = round(vehicle.track_m * (1 + 5e-3 * float(rng.uniform(-1, 1))), 5)
    left_m_per_N, right_m_per_N = (float(f"{one:.6g}") for one in slopes)
    return OdometryModel(left_m, right_m, track_m, REFERENCE_LOAD_N, left_m_per_N, right_m_per_N)


def as_causes(truth: Mapping[str, float] | Causes, design: Design, rng: np.random.Generator) -> list[Cause]:
    """Return causes with all their knobs drawn; for `truth` see `make_campaign`."""
    if not isinstance(truth, Mapping):
        return list(truth)
    causes = []
    for key, size in truth.items():
        known = find(*key.split("/"))
        size = float(known.typical if np.isnan(size) else size)
        causes.append(Cause(known.effect, size, known.form, known.knobs(rng, design)))
    return causes


def apply_causes(world: World, causes: Causes, blocks: FloatArray | None = None) -> World:
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
    truth: Mapping[str, float] | Causes,
    rng: np.random.Generator,
    *,
    noise: Noise | None = None,
    model: OdometryModel | None = None,
    name: str = "campaign",
) -> Campaign:
    """Drive a design in a world with a known truth, in memory; see `calib.campaign.write_campaign`.

    `truth`: ``{effect: size}`` or ``{"effect/form": size}``; NaN is the typical size. `noise`, `model` (what the
    simulator believes): drawn at random where missing.
    """
    return make_campaigns(design, truth, rng, noise=noise, model=model, names=(name,))[0]


def make_campaigns(
    design: Design,
    truth: Mapping[str, float] | Causes,
    rng: np.random.Generator,
    *,
    noise: Noise | None,
    model: OdometryModel | None,
    names: Sequence[str],
) -> tuple[Campaign, ...]:
    """Drive a design as often as there are names, with other noise each; see `make_campaign`."""
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


Table = dict[str, FloatArray | IntArray | list[str]]

COUNTS_PER_REV: Final = 4096
FIRST_MONTH: Final = (2025, 1)
LOADS_N: Final = (300.0, 500.0, 700.0, 900.0, 1100.0)
SETTINGS: Final = """\
format = "calib-campaign/1"
name = "fleet"
simulated = true

[vehicle]
track_m = 0.7
wheelbase_m = 1.0
wheel_radius_m = 0.1

[encoder]
counts_per_rev = 4096

[model]
radius_left_m = 0.1
radius_right_m = 0.1
track_m = 0.7
reference_load_N = 300.0
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetTruth:
    """What was planted."""

    #: normal population of each wheel's radius at 300 N and slope
    radius_mean_m: float = 0.0995
    radius_spread_m: float = 6e-5
    slope_mean_m_per_N: float = -1.2e-6
    slope_spread_m_per_N: float = 6e-8
    #: vehicles off in a radius or slope, drifting, and of hall B
    outliers: tuple[str, ...]
    drifting: tuple[str, ...]
    common: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class FleetSize:
    """How large a fleet is, and what its vehicles get; see `FleetTruth`."""

    n_vehicles: int = 400
    n_runs: int = 60
    n_months: int = 6
    n_outliers: int = 20
    n_drifting: int = 5
    n_common: int = 40

    def __post_init__(self) -> None:
        refuse_more("runs of all vehicles", self.n_vehicles * self.n_runs, FLEET_RUNS, "simulate a smaller fleet")
        refuse_more("months", self.n_months, FLEET_MONTHS, "spread the runs over fewer")


@dataclass(frozen=True, slots=True, eq=False)
class PlannedFleet:
    """A fleet drawn, its journeys still to be driven."""

    size: FleetSize
    truth: FleetTruth
    names: tuple[str, ...]
    #: shape (n_vehicles, 2): of the left and right wheel: radius at 300 N, its change with load and with time
    radius_m: FloatArray
    slope_m_per_N: FloatArray
    rate_m_per_day: FloatArray
    in_hall: IntArray  #: shape (n_common,): numbers of the vehicles in hall B

    @property
    def labels(self) -> dict[str, dict[str, str]]:
        """The hall of each vehicle."""
        return {"hall": _halls(self.names, self.truth.common)}

    def months(self, rng: np.random.Generator, row: int) -> list[Table]:
        """Drive the journeys of vehicle number `row`, a run table a month."""
        tables: list[Table] = []
        for month, share in enumerate(np.array_split(np.arange(self.size.n_runs), self.size.n_months)):
            n = len(share)
            day = 30.0 * month + np.sort(rng.integers(0, 28, 2))[np.arange(n) * 2 // max(n, 1)]
            session = [f"m{month}-{int(value)}" for value in day]
            load = rng.choice(LOADS_N, (n, 2))
            shift = {label: rng.normal(0.0, 4e-6, 2) for label in sorted(set(session))}
            lawful = self.radius_m[row] + self.slope_m_per_N[row] * (load - 300.0)
            true = lawful + np.outer(day, self.rate_m_per_day[row])
            true = true + np.array([shift[label] for label in session]) + rng.normal(0.0, 1.5e-5, (n, 2))
            way = rng.uniform(37.0, 42.0, n)
            counts = np.round(way[:, None] / (2 * np.pi * true) * COUNTS_PER_REV).astype(np.int64)
            table: Table = {"run_id": [f"r{int(k):03d}" for k in share], "session": session, "kind": ["corridor"] * n}
            table |= {"load_left_N": load[:, 0], "load_right_N": load[:, 1]}
            table |= {"distance_m": np.round(way + rng.normal(0.0, 0.0015, n), 5)}
            table |= {"counts_left": counts[:, 0], "counts_right": counts[:, 1], "day": day.astype(np.float64)}
            tables.append(table)
        return tables


def plan_fleet(rng: np.random.Generator, size: FleetSize) -> PlannedFleet:
    """Draw a fleet; see `FleetTruth`."""
    n_vehicles, n_outliers, n_drifting = size.n_vehicles, size.n_outliers, size.n_drifting
    names = tuple(f"v{k:05d}" for k in range(n_vehicles))
    order = rng.permutation(n_vehicles)
    odd, drifting = order[:n_outliers], order[n_outliers : n_outliers + n_drifting]
    in_hall = rng.permutation(n_vehicles)[: size.n_common]
    outliers, slow, common = (tuple(sorted(names[k] for k in group)) for group in (odd, drifting, in_hall))
    truth = FleetTruth(outliers=outliers, drifting=slow, common=common)
    radius = rng.normal(truth.radius_mean_m, truth.radius_spread_m, (n_vehicles, 2))
    slope = rng.normal(truth.slope_mean_m_per_N, truth.slope_spread_m_per_N, (n_vehicles, 2))
    wheel = rng.integers(0, 2, n_outliers)
    sign = rng.choice((-1.0, 1.0), n_outliers)
    by_radius = rng.random(n_outliers) < 0.5
    radius[odd, wheel] += np.where(by_radius, sign * rng.uniform(8, 15, n_outliers) * truth.radius_spread_m, 0.0)
    slope[odd, wheel] += np.where(by_radius, 0.0, sign * rng.uniform(8, 15, n_outliers) * truth.slope_spread_m_per_N)
    radius[in_hall, 1] += 2.0 * truth.radius_spread_m
    rate = np.zeros((n_vehicles, 2))
    rate[drifting, rng.integers(0, 2, n_drifting)] = -rng.uniform(1.5e-6, 3e-6, n_drifting)
    return PlannedFleet(size, truth, names, radius, slope, rate, in_hall)


def make_fleet(folder: Path, rng: np.random.Generator, size: FleetSize) -> FleetTruth:
    """Write a fleet as a Parquet dataset ``vehicle=ID/month=YYYY-MM/runs.parquet``, two sessions a month."""
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError as error:
        raise MissingExtraError("a Parquet dataset", "pyarrow", "parquet") from error
    fleet = plan_fleet(rng, size)
    folder.mkdir(parents=True, exist_ok=True)
    for row, name in enumerate(fleet.names):
        for month, table in enumerate(fleet.months(rng, row)):
            year, number = divmod(FIRST_MONTH[1] - 1 + month, 12)
            where = folder / f"vehicle={name}" / f"month={FIRST_MONTH[0] + year}-{number + 1:02d}"
            where.mkdir(parents=True, exist_ok=True)
            # a path would count as a store's address, and may be no UTF-8
            sink = pa.BufferOutputStream()
            pq.write_table(pa.table(table), sink)
            write_bytes(where / "runs.parquet", sink.getvalue().to_pybytes(), force=True)
    (folder / "campaign.toml").write_bytes(SETTINGS.encode())
    _write_beside(folder, fleet.names, fleet.truth)
    return fleet.truth


def _halls(names: Sequence[str], common: Sequence[str]) -> dict[str, str]:
    inside = set(common)
    return {name: "B" if name in inside else "A" for name in names}


def _write_beside(folder: Path, names: Sequence[str], truth: "FleetTruth | PosedTruth") -> None:
    lines = ["vehicle,hall", *(f"{name},{hall}" for name, hall in _halls(names, truth.common).items())]
    (folder / "vehicles.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (folder / "truth.json").write_text(json.dumps(asdict(truth), indent=2) + "\n", encoding="utf-8")


#: what a metre of the zone takes from one wheel's way and adds to the other's
ZONE_SHARE: Final = 5e-3


@dataclass(frozen=True, slots=True)
class PosedTruth:
    """What was planted."""

    track_m: dict[str, float]
    #: normal population that the tracks of all but the outliers were drawn from
    track_mean_m: float
    track_spread_m: float
    #: vehicles whose track is one per cent off, and of hall B, whose floor turns what crosses it
    outliers: tuple[str, ...]
    common: tuple[str, ...]
    #: begin of that zone on the floor, and length
    zone_at_m: float = 11.0
    zone_long_m: float = 2.0


def make_posed_fleet(folder: Path, rng: np.random.Generator, size: FleetSize) -> PosedTruth:
    """Write a fleet of one type, a campaign folder a vehicle, none of them drifting; see `PosedTruth`."""
    design = good_design(rng, n_runs=size.n_runs, needs={"corridor", "directions", "turns"})
    model = random_model(design, rng)
    names = [f"v{number:05d}" for number in range(size.n_vehicles)]
    odd = rng.permutation(size.n_vehicles)[: size.n_outliers]
    in_hall = np.sort(rng.permutation(size.n_vehicles)[: size.n_common])
    relative = rng.normal(0.0, 5e-4, size.n_vehicles)
    relative[odd] += rng.choice((-1e-2, 1e-2), size.n_outliers)
    track_m = dict(zip(names, (model.track_m * (1.0 + relative)).tolist(), strict=True))
    outliers, common = (tuple(sorted(names[number] for number in group)) for group in (odd, in_hall))
    truth = PosedTruth(track_m, model.track_m, 5e-4 * model.track_m, outliers, common)
    zone = Cause("floor_zone", ZONE_SHARE, "heading", {"at_m": truth.zone_at_m, "long_m": truth.zone_long_m})
    for number, name in enumerate(names):
        causes = [Cause("track_width", float(relative[number]), "plain", {}), *([zone] if number in in_hall else ())]
        write_campaign(make_campaign(design, causes, rng, model=model, name=name), folder / name)
    _write_beside(folder, names, truth)
    return truth
