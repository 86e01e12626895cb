"""A fleet whose runs have logs and end poses, one campaign folder a vehicle: for geometry and diagnosis."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

import numpy as np

from calib.campaign.write import write_campaign
from calib.limits import FLEET_RUNS, refuse_more
from calib.plant.effects.form import Cause
from calib.plant.make import make_campaign, random_model
from calib.plant.plans import good_design

#: what each metre of the zone takes from the way of one wheel and adds to the other's
ZONE_SHARE: Final = 5e-3


@dataclass(frozen=True, slots=True)
class PosedTruth:
    """What was planted."""

    track_m: dict[str, float]  #: track of each vehicle
    #: track_mean_m, track_spread_m: normal population that the tracks of all but the outliers were drawn from
    track_mean_m: float
    track_spread_m: float
    #: outliers, common: vehicles whose track is one per cent off, and those of hall B, whose floor turns what crosses
    #: it
    outliers: tuple[str, ...]
    common: tuple[str, ...]
    #: zone_at_m, zone_long_m: where that zone begins on the floor, and how long it is
    zone_at_m: float = 11.0
    zone_long_m: float = 2.0


def make_posed_fleet(
    folder: Path, rng: np.random.Generator, n_vehicles: int, n_runs: int, n_outliers: int, n_common: int
) -> PosedTruth:
    """Write a fleet of one type: a folder a vehicle, ``vehicles.csv`` with their halls, and ``truth.json``.

    Parameters
    ----------
    folder : Path
        New folder.
    rng : numpy.random.Generator
        Chance.
    n_vehicles, n_runs : int
        Vehicles, and runs of each.
    n_outliers, n_common : int
        Vehicles with a track of their own, and in hall B.
    """
    refuse_more("runs of all vehicles", n_vehicles * n_runs, FLEET_RUNS, "simulate a smaller fleet")
    design = good_design(rng, n_runs=n_runs, needs={"corridor", "directions", "turns"})
    model = random_model(design, rng)
    names = [f"v{number:05d}" for number in range(n_vehicles)]
    odd = rng.permutation(n_vehicles)[:n_outliers]
    in_hall = np.sort(rng.permutation(n_vehicles)[:n_common])
    relative = rng.normal(0.0, 5e-4, n_vehicles)
    relative[odd] += rng.choice((-1e-2, 1e-2), n_outliers)
    track = model.track_m * (1.0 + relative)
    truth = PosedTruth(
        {name: float(value) for name, value in zip(names, track, strict=True)},
        model.track_m,
        5e-4 * model.track_m,
        tuple(sorted(names[number] for number in odd)),
        tuple(names[number] for number in in_hall),
    )
    place = {"at_m": truth.zone_at_m, "long_m": truth.zone_long_m}
    zone = Cause("floor_zone", ZONE_SHARE, "heading", place)
    lines = ["vehicle,hall"]
    for number, name in enumerate(names):
        causes = [Cause("track_width", float(relative[number]), "plain", {})]
        in_b = number in in_hall
        campaign = make_campaign(design, [*causes, zone] if in_b else causes, rng, model=model, name=name)
        write_campaign(campaign, Path(folder) / name)
        lines.append(f"{name},{'B' if in_b else 'A'}")
    (Path(folder) / "vehicles.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (Path(folder) / "truth.json").write_text(json.dumps(asdict(truth), indent=2) + "\n", encoding="utf-8")
    return truth
