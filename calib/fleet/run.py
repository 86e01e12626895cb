"""A fleet's fit: runs to sums by session, to each vehicle's record, and what the fleet shows."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.special import stdtr, stdtrit

from calib import fleet
from calib.campaign import run_table
from calib.campaign.model import Border, Campaign, Logs
from calib.campaign.read import completed, read_campaign
from calib.campaign.readers import read_table
from calib.campaign.settings_file import read_settings
from calib.documents import plain, plain_fields
from calib.errors import BadInputError, CalibError, RefusedError
from calib.fleet import Labels, Quantities, VehicleResult, quantities_of
from calib.fleet.store import SUMS, Kept, Keys, Member, Part, any_simulated, labels_of, members_of, one_line, renewed
from calib.fleet.vehicle import WHEELS, Drift, PartSums, VehicleRecord, WheelLine, WheelSums, record_of
from calib.fleet.workers import engine
from calib.radius.effective import declared_sources, effective_radii
from calib.radius.fit import fit_campaign
from calib.types import FloatArray, Progress, silent

#: the day of a run, from any origin
DAY: Final = "day"


def _sums_of_parts(parts: Sequence[Part]) -> list[Kept]:
    settings, keys = dict[Path, Campaign](), Keys()
    return [Kept.of(_sums_of_part(part, settings, keys)) for part in parts]


def _sums_of_part(part: Part, settings: dict[Path, Campaign], keys: Keys) -> PartSums:
    key = ""
    try:
        key = keys.of(part)
        campaign = campaign_of(part, settings)
        sources = declared_sources(campaign)
        fit = fit_campaign(campaign, noted=False) if part.whole else None
        radii = fit.radii if fit else effective_radii(campaign)
    except (CalibError, OSError) as error:
        return PartSums(part.name, key, 0.0, 0.0, why=one_line(error))
    days = campaign.runs.number(DAY)[np.isin(campaign.runs.run_id, radii.run_id)]
    day = np.where(np.isfinite(days), days, 0.0 if part.day is None else part.day)
    reference, nominal = campaign.model.reference_load_N, campaign.vehicle.wheel_radius_m
    session = np.where(radii.session == "", part.name, radii.session)
    sums = []
    for load, radius in ((radii.load_left_N, radii.radius_left_m), (radii.load_right_N, radii.radius_right_m)):
        reach = radius / radii.distance_m
        sums.append(WheelSums.from_runs(session, load - reference, radius - nominal, day, reach))
    wheels = list(zip(fit.wheels.values(), sums, strict=True)) if fit else []
    if any(wheel.model != "line" for wheel, _ in wheels):
        wheels = []
    lines = [WheelLine.of(wheel.estimate, getattr(wheel.autocorrelation, "rho", 0.0), one) for wheel, one in wheels]
    return PartSums(part.name, key, reference, nominal, sums, "", fit.failed if fit else (), sources, lines)


def campaign_of(part: Part, known: dict[Path, Campaign], *, lenient: bool = False) -> Campaign:
    """Return the campaign of a file, without a dataset's logs; `known`: settings read."""
    if part.whole:
        return read_campaign(part.settings, lenient=lenient)
    if part.settings not in known:
        known[part.settings] = read_settings(part.settings / "campaign.toml", "campaign.toml")
    shared = known[part.settings]
    border = Border(lenient=False)
    runs = run_table(read_table(part.path, part.name), part.name, border)
    campaign = replace(shared, root=part.settings, runs=runs, logs=Logs.empty(len(runs)))
    return replace(completed(campaign, part.name, border), notes=tuple(border.notes))


Vehicle = tuple[str, Sequence[Kept]]


def records_of(vehicles: Sequence[Vehicle]) -> list[VehicleRecord]:
    """See `record_of`."""
    return [record_of(name, [PartSums.from_dict(kept.values()) for kept in parts]) for name, parts in vehicles]


@dataclass(frozen=True, slots=True)
class Fleet:
    """A fleet's vehicles and view."""

    records: tuple[VehicleRecord, ...]
    view: "FleetView"
    n_read: int
    n_kept: int
    simulated: bool = False

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        outliers = {outlier.vehicle: outlier.why for outlier in self.view.outliers}
        vehicles = []
        for one in self.records:
            why = {"outlier": one.vehicle in outliers, "why": one.why or outliers.get(one.vehicle, "")}
            vehicles.append(one.to_dict() | why)
        head = {"format": "calib-fleet/1", "simulated": self.simulated}
        return {**head, "vehicles": vehicles, "fleet": plain(self.view)}


def fit_fleet(folder: Path, into: Path, *, workers: int = 1, scheduler: str = "", progress: Progress = silent) -> Fleet:
    """Fit every vehicle of a fleet.

    `folder`, `workers`, `scheduler`: see `members_of` and `engine`; `into`: result folder, which keeps what was read.
    """
    with engine(workers, scheduler) as opened:
        members = members_of(folder)
        parts = {part.name: part for member in members for part in member.parts}

        def given_up(part: Part, why: str) -> Kept:  # without a key: the next run tries it again
            return Kept.of(PartSums(part.name, "", 0.0, 0.0, why=why))

        sums, n_new = renewed(into / SUMS, parts, opened, _sums_of_parts, given_up, progress, "files")
        vehicles = [(member.vehicle, [sums[part.name] for part in member.parts]) for member in members]
        done = opened.run(records_of, vehicles, lambda one, why: VehicleRecord(one[0], 0, None, None, why))
        records = {record.vehicle: record for record in done}
    by_id = tuple(records[member.vehicle] for member in members)
    return Fleet(by_id, view_of(by_id, labels_of(folder, members)), n_new, len(parts) - n_new, any_simulated(folder))


#: change of a radius by which recalibration is due: 5 mm over 10 m
DUE_RELATIVE: Final = 5e-4


@dataclass(frozen=True, slots=True)
class DriftingVehicle:
    """A vehicle whose radius drifts, and when its recalibration is due."""

    vehicle: str = field(metadata={"json": "id"})
    wheel: str
    per_day_m: float
    half_width_m: float = field(metadata={"json": "half_width95_m"})
    due_day: float


@dataclass(frozen=True, slots=True)
class FleetView:
    """What the fleet shows, see `calib.fleet.Quantities`; drifting vehicles soonest due first."""

    n_vehicles: int
    n_fitted: int
    n_failed: int
    populations: Mapping[str, fleet.Population]
    outliers: tuple[fleet.Outlier, ...]
    drifting: tuple[DriftingVehicle, ...]
    common: tuple[fleet.LabelDifference, ...]

    def to_dict(self) -> dict[str, object]:
        """Return it as plain JSON values."""
        split = [(plain(outlier), *outlier.quantity.split("_", 2)) for outlier in self.outliers]
        outliers = [one | {"wheel": wheel, "quantity": f"{stem}_{unit}"} for one, stem, wheel, unit in split]
        return plain_fields(self, outliers=outliers)


def view_of(records: Sequence[VehicleRecord], labels: Labels) -> FleetView:
    """Return the fleet's view of all its vehicles."""
    fitted = sorted((record for record in records if record.status == "fitted"), key=lambda record: record.vehicle)
    drifting = _drifting(fitted)
    values, std = dict[str, FloatArray](), dict[str, FloatArray]()
    for side in WHEELS:
        for what, unit in (("radius", "ref_m"), ("slope", "m_per_N")):
            name, of_unit = f"{what}_{side}_{unit}", unit.removeprefix("ref_")
            lines = [getattr(record, side) for record in fitted]
            values[name] = np.array([getattr(line, f"{what}_{unit}") for line in lines])
            std[name] = np.array([getattr(line, f"{what}_std_{of_unit}") for line in lines])
    names, drift = [record.vehicle for record in fitted], frozenset(one.vehicle for one in drifting)
    view = quantities_of(names, values, std, labels, drift)
    n_failed = len(records) - len(fitted)
    return FleetView(len(records), len(fitted), n_failed, view.populations, view.outliers, drifting, view.common)


def drifts_of(fitted: Sequence[VehicleRecord]) -> list[tuple[VehicleRecord, str, Drift]]:
    """Return the wheels' drifts, the scatter of sessions as `moderated`."""
    lines = [(record, side, getattr(record, side).drift) for record in fitted for side in WHEELS]
    lines = [line for line in lines if line[2] is not None and line[2].std_m > 0]
    variance, dof = (np.array([getattr(line[2], name) for line in lines]) for name in ("variance_m2", "dof"))
    known = zip(lines, *fleet.moderated(variance, dof), strict=True)
    return [
        (record, side, replace(drift, std_m=drift.std_m * np.sqrt(now / drift.variance_m2), dof=float(of)))
        for (record, side, drift), now, of in known
    ]


def _drifting(fitted: Sequence[VehicleRecord]) -> tuple[DriftingVehicle, ...]:
    lines = drifts_of(fitted)
    p = np.array([2.0 * stdtr(drift.dof, -abs(drift.per_day_m) / drift.std_m) for _, _, drift in lines])
    drifting: dict[str, DriftingVehicle] = {}
    for (record, side, drift), stands in zip(lines, fleet.familywise(p), strict=True):
        if not stands:
            continue
        due = drift.last_day + DUE_RELATIVE * getattr(record, side).radius_ref_m / abs(drift.per_day_m)
        half = float(stdtrit(drift.dof, 0.975)) * drift.std_m
        new = DriftingVehicle(record.vehicle, side, drift.per_day_m, half, float(due))
        drifting[record.vehicle] = min(drifting.get(record.vehicle, new), new, key=lambda one: one.due_day)
    return tuple(sorted(drifting.values(), key=lambda one: (one.due_day, one.vehicle)))


#: of a vehicle's task beside reading a file
WEIGHT: Final = 64


@dataclass(frozen=True, slots=True)
class Survey:
    """A task's records, and what they share; `quantities` where it estimates some."""

    what: str
    records: tuple[VehicleResult, ...]
    shared: tuple[fleet.SharedCause, ...]
    n_done: int
    n_kept: int
    quantities: Quantities | None = None
    simulated: bool = False

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        vehicles = [{"id": one.name, "status": one.status, **one.values, "why": one.why} for one in self.records]
        failed = sum(bool(one.why) for one in self.records)
        shown = {"n_vehicles": len(self.records), "n_failed": failed, "shared": plain(self.shared)}
        shown |= {} if self.quantities is None else plain(self.quantities)
        head = {"format": "calib-fleet/1", "what": self.what, "simulated": self.simulated}
        return {**head, "vehicles": vehicles, "fleet": shown}


def survey_fleet(
    folder: Path, into: Path, what: str, *, workers: int = 1, scheduler: str = "", progress: Progress = silent
) -> Survey:
    """Do a task of `TASKS` for every vehicle; see `fit_fleet`."""
    if what not in TASKS:
        raise BadInputError(f"what: found {what!r}; expected fit or one of {', '.join(TASKS)}; choose one")
    members = {member.vehicle: member for member in members_of(folder)}
    with engine(workers, scheduler) as opened:
        path, task = into / f"{what}.jsonl", partial(_results, what)

        def given_up(member: Member, why: str) -> Kept:
            return Kept.of(VehicleResult(member.vehicle, "", why=why))

        kept, n_new = renewed(path, members, opened, task, given_up, progress, "vehicles", lambda _member: WEIGHT)
    records = tuple(VehicleResult(**kept[name].values()) for name in members)
    labels = labels_of(folder, tuple(members.values()))
    shared = fleet.shared_causes(records, labels)
    quantities = _quantities(records, labels)
    return Survey(what, records, shared, n_new, len(members) - n_new, quantities, any_simulated(folder))


def _results(what: str, members: Sequence[Member]) -> list[Kept]:
    kept, keys = [], Keys()
    for member in members:
        key = ""
        try:
            key = keys.of(member)
            result = VehicleResult(member.vehicle, key, TASKS[what](member))
        except (CalibError, OSError) as error:
            result = VehicleResult(member.vehicle, key, why=one_line(error))
        kept.append(Kept.of(result))
    return kept


def _quantities(records: Sequence[VehicleResult], labels: Labels) -> Quantities | None:
    done = [record for record in records if "estimates" in record.values]
    if not done:
        return None
    estimates = [record.values["estimates"] for record in done]
    names = list(dict.fromkeys(name for one in estimates for name in one))
    values, std = (
        {name: np.array([one.get(name, {}).get(key, np.nan) for one in estimates]) for name in names}
        for key in ("value", "sd")
    )
    return quantities_of([record.name for record in done], values, std, labels)


def _campaign(member: Member, *, lenient: bool = False) -> Campaign:
    if len(member.parts) != 1:
        raise RefusedError(
            f"{member.vehicle}: found {len(member.parts)} files of journeys; expected one for this task; "
            "put a vehicle's journeys into one campaign folder"
        )
    return campaign_of(member.parts[0], {}, lenient=lenient)


def _check(member: Member) -> dict[str, object]:
    from calib.campaign.check import check_campaign

    report = check_campaign(_campaign(member, lenient=True))
    codes = {level: [note.code for note in getattr(report, level)] for level in ("wrong", "suspicious")}
    return {"verdict": report.verdict, "sound": report.sound, **codes}


def _diagnose(member: Member) -> dict[str, object]:
    from calib.gap.diagnose import diagnose_in_full

    verdict = diagnose_in_full(_campaign(member), plan=False)
    causes = []
    for cause in verdict.causes:
        place = {key: cause.settings[key] for key in ("x_m", "size_m") if key in cause.settings}
        causes.append({"effect": cause.effect, "probability": cause.probability} | (place if len(place) == 2 else {}))
    return {"verdict": str(verdict.kind), "sentence": verdict.sentence, "causes": causes}


def _geometry(member: Member) -> dict[str, object]:
    from calib.kinematics.estimate import estimate_geometry

    geometry = estimate_geometry(_campaign(member))
    # what rests on the nominal radius is no result; its ratios are
    rows = [*(one for one in geometry.estimates if one not in geometry.scaled), *geometry.ratios]
    return {
        "verdict": geometry.verdict.value,
        "passed": geometry.passed,
        "using": geometry.using,
        "estimates": {one.name: plain_fields(one) for one in rows},
        "undetermined": list(geometry.undetermined),
        "wrong": [fault.code for fault in geometry.faults],
        "reasons": list(geometry.why),
    }


#: a new task is a function and an entry here
TASKS: Final = {"check": _check, "geometry": _geometry, "diagnose": _diagnose}
