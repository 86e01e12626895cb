"""From a campaign to its situation: long recordings cut into units, the steps of each, what was measured at its end."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt

from calib.arrays import BoolArray, FloatArray, IntArray
from calib.campaign.model import Campaign
from calib.campaign.settings import OdometryModel
from calib.errors import RefusedError
from calib.gap.data.observations import CHANNELS, STRAIGHT_RAD, Observations
from calib.vehicle import wheel_loads_N

__all__ = ["observations_of"]

MAX_STEPS: Final = 400
STEPS_WITHOUT_LOG: Final = 40
FEW_RUNS: Final = 12
WINDOW_M: Final = 4.0


def _filled_loads(campaign: Campaign) -> tuple[FloatArray, FloatArray, bool]:
    """Return the wheel loads of all runs, each shape (n_runs,), and whether any of them is known."""
    runs, vehicle = campaign.runs, campaign.vehicle
    left, right = runs.number("load_left_N").copy(), runs.number("load_right_N").copy()
    known = bool(np.isfinite(left).any() and np.isfinite(right).any())
    payload = runs.number("payload_kg")
    known = known or bool(np.isfinite(payload).any())
    x, y = runs.number("payload_x_m"), runs.number("payload_y_m")
    _, by_left, by_right = wheel_loads_N(
        vehicle,
        np.nan_to_num(payload),
        np.where(np.isnan(x), vehicle.cog_x_m, x),
        np.nan_to_num(y),
    )
    return np.where(np.isnan(left), by_left, left), np.where(np.isnan(right), by_right, right), known


def _conditions(columns: list[npt.NDArray[np.generic]]) -> IntArray:
    """Return a number for each distinct row of several columns, shape (n_units,)."""
    code = np.zeros(len(columns[0]), dtype=np.int64)
    for column in columns:
        _, part = np.unique(column, return_inverse=True)
        _, code = np.unique(code * (part.max() + 1) + part, return_inverse=True)
    return code


def _binned(values: FloatArray, width: float) -> FloatArray:
    """Round to a width so that set values that differ only by noise are alike; NaN counts as a value."""
    return np.where(np.isnan(values), -1e9, np.round(values / width))


@dataclass(slots=True)
class _Unit:
    run: int
    time: FloatArray
    left: FloatArray
    right: FloatArray
    front: FloatArray | None
    steer: FloatArray | None
    logged: bool
    measured: FloatArray
    simulated: FloatArray
    pose_ok: bool


def observations_of(campaign: Campaign, model: OdometryModel | None = None) -> Observations:
    """Arrange a campaign for the diagnosis.

    Excluded rows are left out. A recording with a continuous pose reference is cut into windows where there are fewer
    than a dozen runs. A run without a log counts with what its row says.

    Parameters
    ----------
    campaign : Campaign
        What was driven.
    model : OdometryModel, optional
        What the simulator believes; the campaign's own by default.

    Returns
    -------
    Observations
        Units, steps, measurements.

    Raises
    ------
    RefusedError
        Where no run has both counts and something measured.
    """
    campaign = campaign.included()
    model = model or campaign.model
    runs, logs = campaign.runs, campaign.logs
    encoder = campaign.encoder
    per_rad = (encoder.counts_per_rev_left / (2 * np.pi), encoder.counts_per_rev_right / (2 * np.pi))
    notes: list[str] = []
    distance = runs.number("distance_m")
    ref = np.stack([runs.number(c) for c in ("ref_x_m", "ref_y_m", "ref_theta_rad")], axis=1)
    sim = np.stack([runs.number(c) for c in ("sim_distance_m", "sim_x_m", "sim_y_m", "sim_theta_rad")], axis=1)
    units: list[_Unit] = []
    without_counts = 0
    windowed = len(runs) < FEW_RUNS
    cut = 0
    for run in range(len(runs)):
        log = logs.of(run)
        unit = _from_log(run, log, per_rad) or _from_row(run, runs, per_rad)
        if unit is None:
            without_counts += 1
            continue
        unit.measured = np.array([distance[run], *ref[run]])
        unit.simulated = sim[run].copy()
        continuous = _continuous(log)
        if continuous is not None and np.isnan(unit.measured[1:]).all():
            # the end pose by the log's own reference
            unit.measured[1:] = continuous[-1]
        if np.isnan(distance[run]) and "range_m" in log and np.isfinite(log["range_m"][-1]):
            unit.measured[0] = log["range_m"][-1]
        if continuous is not None and windowed:
            pieces = _windows(unit, log, continuous, per_rad, model)
            if len(pieces) > 1:
                cut += 1
                units.extend(pieces)
                continue
        units.append(unit)
    if without_counts:
        notes.append(f"{without_counts} runs have no encoder counts and were left out")
    if cut:
        notes.append(f"{cut} recordings with a continuous reference were cut into windows of about {WINDOW_M:g} m")
    units = [u for u in units if np.isfinite(u.measured).any() or u.front is not None]
    if not units:
        raise RefusedError(
            f"{campaign.name}: no run has both encoder counts and a measured distance or end pose; "
            "nothing can be said of a gap; measure distance_m or ref_x_m, ref_y_m, ref_theta_rad"
        )
    return _assemble(campaign, model, units, notes, per_rad, windowed and cut > 0)


def _from_log(run: int, log: dict[str, FloatArray], per_rad: tuple[float, float]) -> _Unit | None:
    """Make a unit of a log, thinned to `MAX_STEPS` steps; None where the log has no usable counts."""
    if not {"t_s", "counts_left", "counts_right"} <= log.keys():
        return None
    good = np.isfinite(log["t_s"]) & np.isfinite(log["counts_left"]) & np.isfinite(log["counts_right"])
    index = np.flatnonzero(good)
    if len(index) < 2:
        return None
    if len(index) > MAX_STEPS + 1:
        index = index[np.unique(np.linspace(0, len(index) - 1, MAX_STEPS + 1).astype(np.int64))]
    front = log.get("counts_front")
    steer = log.get("steer_rad")
    return _Unit(
        run=run,
        time=log["t_s"][index],
        left=log["counts_left"][index] / per_rad[0],
        right=log["counts_right"][index] / per_rad[1],
        front=None if front is None or np.isnan(front[index]).any() else front[index] / per_rad[0],
        steer=None if steer is None or np.isnan(steer[index]).any() else steer[index],
        logged=True,
        measured=np.full(4, np.nan),
        simulated=np.full(4, np.nan),
        pose_ok=True,
    )


def _from_row(run: int, runs: object, per_rad: tuple[float, float]) -> _Unit | None:
    """Make a unit of a row's totals, as one arc; None where the row has no counts."""
    number = runs.number  # type: ignore[attr-defined]
    left, right = number("counts_left")[run], number("counts_right")[run]
    if not (np.isfinite(left) and np.isfinite(right)):
        return None
    share = np.linspace(0.0, 1.0, STEPS_WITHOUT_LOG + 1)
    return _Unit(
        run=run,
        time=np.full(STEPS_WITHOUT_LOG + 1, np.nan),
        left=share * left / per_rad[0],
        right=share * right / per_rad[1],
        front=None,
        steer=None,
        logged=False,
        measured=np.full(4, np.nan),
        simulated=np.full(4, np.nan),
        pose_ok=False,
    )


def _continuous(log: dict[str, FloatArray]) -> FloatArray | None:
    """Return the log's reference poses, shape (n_samples, 3), where it has a continuous one."""
    if not {"ref_x_m", "ref_y_m", "ref_theta_rad"} <= log.keys():
        return None
    poses = np.stack([log["ref_x_m"], log["ref_y_m"], log["ref_theta_rad"]], axis=1)
    if np.isfinite(poses).all(axis=1).sum() < 10 or not np.isfinite(poses[-1]).all():
        return None
    return poses


def _windows(
    whole: _Unit, log: dict[str, FloatArray], poses: FloatArray, per_rad: tuple[float, float], model: OdometryModel
) -> list[_Unit]:
    """Cut a recording into windows of about `WINDOW_M`, each in the frame of its own start."""
    good = np.flatnonzero(
        np.isfinite(poses).all(axis=1) & np.isfinite(log["counts_left"]) & np.isfinite(log["counts_right"])
    )
    if len(good) < 20:
        return [whole]
    left, right = log["counts_left"][good] / per_rad[0], log["counts_right"][good] / per_rad[1]
    step = 0.5 * np.abs(np.diff(left) * model.radius_left_m + np.diff(right) * model.radius_right_m)
    travelled = np.concatenate(([0.0], np.cumsum(step)))
    n_windows = int(max(1, round(travelled[-1] / WINDOW_M)))
    edges = np.unique(np.searchsorted(travelled, np.linspace(0.0, travelled[-1], n_windows + 1)))
    edges = np.minimum(edges, len(good) - 1)
    pieces = []
    pose = poses[good]
    heading = np.unwrap(pose[:, 2])
    for first, last in pairwise(edges):
        if last - first < 3:
            continue
        rows = np.arange(first, last + 1)
        if len(rows) > MAX_STEPS + 1:
            rows = rows[np.unique(np.linspace(0, len(rows) - 1, MAX_STEPS + 1).astype(np.int64))]
        dx, dy = pose[last, 0] - pose[first, 0], pose[last, 1] - pose[first, 1]
        c, s = np.cos(heading[first]), np.sin(heading[first])
        pieces.append(
            _Unit(
                run=whole.run,
                time=log["t_s"][good][rows],
                left=left[rows],
                right=right[rows],
                front=None,
                steer=None,
                logged=True,
                measured=np.array([np.nan, c * dx + s * dy, -s * dx + c * dy, heading[last] - heading[first]]),
                simulated=np.full(4, np.nan),
                pose_ok=True,
            )
        )
    return pieces or [whole]


def _assemble(
    campaign: Campaign,
    model: OdometryModel,
    units: list[_Unit],
    notes: list[str],
    per_rad: tuple[float, float],
    windowed: bool,
) -> Observations:
    """Lay the units end to end and settle which channels each of them has."""
    runs = campaign.runs
    index = np.array([u.run for u in units])
    lengths = np.array([len(u.left) - 1 for u in units])
    starts = np.concatenate(([0], np.cumsum(lengths))).astype(np.int64)
    roll_left = np.concatenate([np.diff(u.left) for u in units])
    roll_right = np.concatenate([np.diff(u.right) for u in units])
    duration = np.concatenate([np.diff(u.time) for u in units])
    front = np.concatenate([np.full(len(u.left) - 1, np.nan) if u.front is None else np.diff(u.front) for u in units])
    steer = np.concatenate(
        [np.full(len(u.left) - 1, np.nan) if u.steer is None else 0.5 * (u.steer[1:] + u.steer[:-1]) for u in units]
    )
    turned = np.concatenate([np.full(len(u.left) - 1, np.nan) if u.steer is None else np.diff(u.steer) for u in units])
    measured = np.full((len(units), 6), np.nan)
    simulated = np.full((len(units), 6), np.nan)
    measured[:, :4] = [u.measured for u in units]
    simulated[:, :4] = [u.simulated for u in units]
    path = np.add.reduceat(0.5 * (roll_left * model.radius_left_m + roll_right * model.radius_right_m), starts[:-1])
    turn = np.add.reduceat((roll_right * model.radius_right_m - roll_left * model.radius_left_m), starts[:-1])
    turn = turn / model.track_m
    # a reference heading may come wrapped, then all of them lie within half a turn: bring it next to the wheels'
    with np.errstate(invalid="ignore"):
        if np.isfinite(measured[:, 3]).any() and np.nanmax(np.abs(measured[:, 3])) <= np.pi + 0.05:
            wraps = 2 * np.pi * np.round((turn - measured[:, 3]) / (2 * np.pi))
            # but only where the two then agree: with swapped or halved counts it is the wheels that are wrong
            measured[:, 3] += np.where(np.abs(turn - measured[:, 3] - wraps) < 1.0, wraps, 0.0)
        chord = np.hypot(measured[:, 1], measured[:, 2])
        straight = (np.abs(turn) < STRAIGHT_RAD) & ~(chord < 0.9 * np.abs(path))
    logged = np.array([u.logged for u in units])
    pose_ok = logged | straight
    usable = np.isfinite(measured)
    usable[:, 1:3] &= pose_ok[:, None] & usable[:, 1:2] & usable[:, 2:3]
    # along and lateral are read in the frame of the measured heading; without one, of the wheels' heading
    with np.errstate(invalid="ignore"):
        # without a log the distance says itself whether the run was led along a line: wheels of unlike radii that
        # roll a straight line seem to turn
        led = np.abs(np.abs(measured[:, 0]) - np.abs(path)) < 0.05 * np.abs(path)
    usable[:, 0] &= logged | led | (np.abs(turn) < STRAIGHT_RAD)
    left_out = int((~pose_ok & np.isfinite(measured[:, 1])).sum())
    if left_out:
        notes.append(f"{left_out} runs have an end pose but no log of a curved path: only their heading counts")
    has_front = np.isfinite(np.add.reduceat(front, starts[:-1])) & np.isfinite(np.add.reduceat(steer, starts[:-1]))
    measured[has_front, 4:] = 0.0
    usable[:, 4:] = has_front[:, None]
    outside = np.isfinite(simulated) & usable
    for channel in range(4):
        if outside[:, channel].any() and not outside[:, channel][usable[:, channel]].all():
            missing = int((usable[:, channel] & ~outside[:, channel]).sum())
            notes.append(
                f"{missing} runs have no sim_ value for {CHANNELS[channel]}: judged against calib's own odometry"
            )
    load_left, load_right, loads_known = _filled_loads(campaign)
    numbers = {name: runs.number(name)[index] for name in runs.numbers}
    numbers["load_left_N"], numbers["load_right_N"] = load_left[index], load_right[index]
    if not loads_known:
        notes.append("no payload or wheel load is given: every run is taken as unladen")
    numbers["travelled_km"] = np.concatenate(([0.0], np.cumsum(np.abs(path))[:-1])) / 1000.0
    labels = {name: runs.label(name)[index] for name in ("run_id", "session", "kind", "direction")}
    place = np.concatenate([np.arange((index == run).sum()) for run in np.unique(index)]) if windowed else 0 * index
    alike: list[npt.NDArray[np.generic]] = [labels["kind"], labels["direction"], place]
    driven = [
        *alike,
        _binned(numbers["load_left_N"], 5.0),
        _binned(numbers["load_right_N"], 5.0),
        _binned(runs.number("speed_mps")[index], 0.05),
    ]
    surroundings = [
        labels["session"],
        _binned(runs.number("temperature_C")[index], 4.0),
        _binned(runs.number("minutes_under_load")[index], 10.0),
        *(_binned(numbers[name], _width(numbers[name])) for name in runs.covariates),
    ]
    return Observations(
        vehicle=campaign.vehicle,
        model=model,
        starts=starts,
        roll_left_rad=roll_left,
        roll_right_rad=roll_right,
        phase_left_rad=np.concatenate([u.left[1:] for u in units]),
        phase_right_rad=np.concatenate([u.right[1:] for u in units]),
        time_s=np.concatenate([u.time[1:] for u in units]),
        duration_s=duration,
        front_roll_rad=front,
        steer_rad=steer,
        steer_change_rad=turned,
        from_log=logged,
        measured=measured,
        simulated=np.where(outside, simulated, np.nan),
        usable=usable,
        numbers=numbers,
        labels=labels,
        condition=_conditions(driven),
        cell=_conditions([*driven, *surroundings]),
        kind=_conditions(alike),
        axis=_laser_axis(measured, usable),
        sigma_distance_m=campaign.rangefinder.sigma_m,
        sigma_xy_m=campaign.reference.sigma_xy_m,
        sigma_theta_rad=campaign.reference.sigma_theta_rad,
        count_rad=(1 / per_rad[0], 1 / per_rad[1]),
        windowed=windowed,
        notes=tuple(notes),
    )


def _width(values: FloatArray) -> float:
    """Bin width that tells set values of a further column apart: a fifth of its spread."""
    spread = float(np.nanmax(values) - np.nanmin(values)) if np.isfinite(values).any() else 0.0
    return spread / 5.0 if spread > 0 else 1.0


def _laser_axis(measured: FloatArray, usable: BoolArray) -> FloatArray:
    """Say for each unit what the laser's distance is the length of.

    Where an end pose was measured too, it tells whether the laser looks along the start heading (1) or at the end
    point (2); without one, the length of the line that the run was led along is all that can be said (0).
    """
    both = usable[:, 0] & usable[:, 1] & usable[:, 2]
    axis = np.zeros(len(measured))
    if both.any():
        gap_x = np.median(np.abs(measured[both, 0] - measured[both, 1]))
        gap_chord = np.median(np.abs(measured[both, 0] - np.hypot(measured[both, 1], measured[both, 2])))
        axis[both] = 1.0 if gap_x <= gap_chord else 2.0
    return axis
