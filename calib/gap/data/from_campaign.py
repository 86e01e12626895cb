"""From a campaign to the units of the diagnosis: a run each, or windows of a long recording; then to arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from calib.arrays import FloatArray, IntArray
from calib.campaign.model import Campaign
from calib.campaign.settings import OdometryModel
from calib.campaign.wheels import on_one_axle, without_rear_wheels
from calib.errors import RefusedError
from calib.gap.data.assemble import assemble
from calib.gap.data.observations import Observations
from calib.gap.data.reference_poses import end_pose_of_vehicle, poses_are_in_a_map, reference_poses
from calib.gap.data.unit import CountsPerRadian, Setup, Unit, log_rows, unit_from_log, unit_from_row
from calib.gap.data.windows import FEW_RUNS, Recorded, cut, whole, window_length_m

#: what the wheels may still roll after the last pose of the reference, so that it counts as the end pose
AT_THE_END_M = 1e-3
#: with fewer runs than this driven like another one, recordings are cut into windows
FEW_REPEATED = 8


def observations_of(campaign: Campaign, model: OdometryModel | None = None) -> Observations:
    """Arrange a campaign for the diagnosis; `model` is what the simulator believes, by default the campaign's own.

    Excluded rows are left out. Recordings with a continuous pose reference are cut into windows where there are fewer
    than a dozen runs, or where hardly any was driven twice. A run without a log counts with what its row says. Refused
    where no run has both counts and something measured.
    """
    campaign = campaign.included()
    model = model or campaign.model
    stands_in = without_rear_wheels(campaign)
    if stands_in:
        # wheels that stand in for others do not carry a load of their own
        model = replace(model, slope_left_m_per_N=0.0, slope_right_m_per_N=0.0)
        campaign = on_one_axle(campaign, model)
    per_rad = CountsPerRadian.from_encoder(campaign.encoder)
    setup = Setup(campaign, model, per_rad, poses_are_in_a_map(campaign), stands_in)
    recorded = [_recorded(run, setup) for run in range(len(campaign.runs))]
    with_counts = [run for run in recorded if run is not None]
    few = len(recorded) < FEW_RUNS
    observations = _arranged(with_counts, setup, into_windows=few)
    if not few and any(run.reference is not None for run in with_counts) and _n_repeated(observations) < FEW_REPEATED:
        observations = _arranged(with_counts, setup, into_windows=True)
    return observations


def _n_repeated(observations: Observations) -> int:
    """Return how many units were driven like another one."""
    return int((np.bincount(observations.condition)[observations.condition] > 1).sum())


def _arranged(recorded: list[Recorded], setup: Setup, *, into_windows: bool) -> Observations:
    """Return the observations of all runs, whole or cut into windows."""
    campaign = setup.campaign
    units, notes = _units(recorded, setup, into_windows=into_windows)
    without_counts = len(campaign.runs) - len(recorded)
    if without_counts:
        notes.insert(0, f"{without_counts} runs have no encoder counts and were left out")
    units = [unit for unit in units if np.isfinite(unit.measured).any() or unit.front_rad is not None]
    if not units:
        raise RefusedError(
            f"{campaign.name}: no run has both encoder counts and a measured distance or end pose; "
            "nothing can be said of a gap; measure distance_m or ref_x_m, ref_y_m, ref_theta_rad"
        )
    return assemble(setup, units, notes)


def _recorded(run: int, setup: Setup) -> Recorded | None:
    """Return a run with what its row and log measured at its end; None where it has no counts."""
    campaign, per_rad = setup.campaign, setup.per_rad
    log = campaign.logs.of(run)
    rows = log_rows(log)
    runs = campaign.runs
    logged = len(rows) >= 2
    unit = unit_from_log(run, log, rows, per_rad) if logged else unit_from_row(run, runs, per_rad)
    if unit is None:
        return None
    distance = runs.number("distance_m")[run]
    if np.isnan(distance) and "range_m" in log and np.isfinite(log["range_m"][-1]):
        distance = log["range_m"][-1]
    pose = np.array([runs.number(name)[run] for name in ("ref_x_m", "ref_y_m", "ref_theta_rad")])
    # an end pose in a map says nothing without the pose at the start
    pose = np.full(3, np.nan) if setup.in_map else end_pose_of_vehicle(pose[None, :], campaign.reference)[0]
    simulated = [runs.number(f"sim_{name}")[run] for name in ("distance_m", "x_m", "y_m", "theta_rad")]
    unit = replace(unit, measured=np.array([distance, *pose]), simulated=np.array(simulated))
    return Recorded(unit, log, reference_poses(log, setup) if logged else None)


def _units(recorded: list[Recorded], setup: Setup, *, into_windows: bool) -> tuple[list[Unit], list[str]]:
    """Return the units of all runs, long recordings cut into windows, and what has to be said of it."""
    rolled = sum(float(run.reference.travelled_m[-1]) for run in recorded if run.reference is not None)
    length_m = window_length_m(rolled, setup.model.track_m)
    units: list[Unit] = []
    n_cut = 0
    for run in recorded:
        windows = cut(run, setup, length_m) if into_windows else []
        n_cut += bool(windows)
        units.extend(windows or [_by_log(run, setup)])
    notes = []
    if n_cut:
        notes.append(f"{n_cut} recordings with a continuous reference were cut into windows of about {length_m:.2g} m")
    if any(run.reference is not None and run.reference.course is not None for run in recorded):
        notes.append(
            "the reference measures positions without a heading: headings are taken from the course over ground"
        )
    return units, notes


def _by_log(run: Recorded, setup: Setup) -> Unit:
    """Return a run's unit with the end pose by its log's own reference, where its row has none."""
    unit, reference = run.unit, run.reference
    if reference is None or not np.isnan(unit.measured[1:]).all():
        return unit
    rows = log_rows(run.log)
    inside = rows[(rows >= (reference.rows[0] if reference.from_first else 0)) & (rows <= reference.rows[-1])]
    left_out = np.setdiff1d(rows, inside, assume_unique=True)
    if len(left_out) and _rolled_outside_m(run.log, rows, inside, setup) > AT_THE_END_M:
        # the reference saw a part of the run only: that part is what can be compared
        part = unit_from_log(unit.run, run.log, inside, setup.per_rad)
        unit = replace(part, measured=np.full(4, np.nan))
    return whole(unit, reference, setup.campaign.reference)


def _rolled_outside_m(log: Mapping[str, FloatArray], rows: IntArray, inside: IntArray, setup: Setup) -> float:
    """Return what the wheels rolled before the first and after the last of some samples, at most."""
    rolled = 0.0
    for name, scale in (("counts_left", setup.per_rad.left), ("counts_right", setup.per_rad.right)):
        angle = log[name] / scale
        rolled = max(rolled, abs(angle[inside[0]] - angle[rows[0]]), abs(angle[rows[-1]] - angle[inside[-1]]))
    return float(rolled * setup.campaign.vehicle.wheel_radius_m)
