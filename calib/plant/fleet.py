"""Fleets with known spread, outliers, drift and a common cause."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

import numpy as np

from calib.campaign.tables import write_campaign
from calib.errors import FLEET_MONTHS, FLEET_RUNS, MissingExtraError, refuse_more
from calib.io import write_bytes
from calib.plant.design import good_design
from calib.plant.make import make_campaign, random_model
from calib.plant.world import Cause
from calib.types import FloatArray, IntArray

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
    #: vehicles with a radius or slope of its own, with a drifting radius, and of hall B, where the right wheel's radius
    #: seems larger
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
        hall = np.where(np.isin(np.arange(len(self.names)), self.in_hall), "B", "A")
        return {"hall": dict(zip(self.names, hall.tolist(), strict=True))}

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
    outliers, slow, common = (tuple(sorted(names[k] for k in some)) for some in (odd, drifting, in_hall))
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
    _write_beside(folder, fleet.labels["hall"], fleet.truth)
    return fleet.truth


def _write_beside(folder: Path, halls: Mapping[str, str], truth: "FleetTruth | PosedTruth") -> None:
    lines = ["vehicle,hall", *(f"{name},{hall}" for name, hall in halls.items())]
    (folder / "vehicles.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (folder / "truth.json").write_text(json.dumps(asdict(truth), indent=2) + "\n", encoding="utf-8")


#: what each metre of the zone takes from the way of one wheel and adds to the other's
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


def make_posed_fleet(
    folder: Path, rng: np.random.Generator, n_vehicles: int, n_runs: int, n_outliers: int, n_common: int
) -> PosedTruth:
    """Write a fleet of one type, a campaign folder a vehicle; see `PosedTruth`."""
    refuse_more("runs of all vehicles", n_vehicles * n_runs, FLEET_RUNS, "simulate a smaller fleet")
    design = good_design(rng, n_runs=n_runs, needs={"corridor", "directions", "turns"})
    model = random_model(design, rng)
    names = [f"v{number:05d}" for number in range(n_vehicles)]
    odd = rng.permutation(n_vehicles)[:n_outliers]
    in_hall = np.sort(rng.permutation(n_vehicles)[:n_common])
    relative = rng.normal(0.0, 5e-4, n_vehicles)
    relative[odd] += rng.choice((-1e-2, 1e-2), n_outliers)
    track_m = dict(zip(names, (model.track_m * (1.0 + relative)).tolist(), strict=True))
    outliers, common = (tuple(sorted(names[number] for number in some)) for some in (odd, in_hall))
    truth = PosedTruth(track_m, model.track_m, 5e-4 * model.track_m, outliers, common)
    zone = Cause("floor_zone", ZONE_SHARE, "heading", {"at_m": truth.zone_at_m, "long_m": truth.zone_long_m})
    for number, name in enumerate(names):
        causes = [Cause("track_width", float(relative[number]), "plain", {}), *([zone] if number in in_hall else ())]
        write_campaign(make_campaign(design, causes, rng, model=model, name=name), folder / name)
    _write_beside(folder, {name: "B" if name in truth.common else "A" for name in names}, truth)
    return truth
