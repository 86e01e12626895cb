"""Writing what a simulation or a replay found: figures, tables, trajectories."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from calib.arrays import FloatArray
from calib.campaign.model import Campaign
from calib.campaign.wheels import without_rear_wheels
from calib.coefficients.believed import believed_model
from calib.coefficients.file import CoefficientFile
from calib.files import csv_text, refuse_existing, write_json, write_text
from calib.motion.odometry.integrate import integrate
from calib.motion.odometry.loaded import loads_in_steps, radii_under_load, travel_from_counts
from calib.motion.poses import Poses
from calib.motion.studies.replay import Replay
from calib.motion.studies.run import SHOWN, LawPart, Simulation
from calib.motion.studies.stood_in import stood_in
from calib.motion.trajectory import write_tum
from calib.report.figures.files import write_figures


def write_simulation(simulation: Simulation, folder: Path, *, force: bool) -> list[Path]:
    """Write the figures of a simulation with their numbers as CSV beside them, and everything as JSON.

    Raises BadInputError where a file exists and `force` is False; nothing is then written.
    """
    figures, tables = _sweep_files(simulation)
    if simulation.law is not None:
        law_figures, law_tables = _law_files(simulation.law)
        figures, tables = figures | law_figures, tables | law_tables
    document = folder / f"{simulation.study}.json"
    refuse_existing([document, *(folder / f"{name}.csv" for name in tables)], force=force)
    written = write_figures(figures, folder, force=force)
    written += [_csv(folder / f"{name}.csv", rows, force=force) for name, rows in tables.items()]
    return [write_json(document, simulation.document(), force=force), *written]


def _sweep_files(simulation: Simulation) -> tuple[dict[str, Figure], dict[str, Sequence[Mapping[str, Any]]]]:
    from calib.report.figures.motion import sweep_figure
    from calib.report.figures.motion_path import sweep_errors_figure

    figures: dict[str, Figure] = {}
    tables: dict[str, Sequence[Mapping[str, Any]]] = {}
    for name, sweep in simulation.sweeps.items():
        figures[name] = sweep_figure(sweep, error=SHOWN.get(name, "lateral_m"), title=simulation.title)
        figures[f"{name}_errors"] = sweep_errors_figure(sweep, title=simulation.title)
        tables |= {name: sweep.ends(), f"{name}_errors": sweep.along()}
    return figures, tables


def _law_files(part: LawPart) -> tuple[dict[str, Figure], dict[str, Sequence[Mapping[str, Any]]]]:
    from calib.report.figures.motion import ratio_figure
    from calib.report.figures.motion_path import law_errors_figure, law_path_figure

    law, path = part.law, part.path
    measured = ((law.left.load_min_N, law.left.load_max_N), (law.right.load_min_N, law.right.load_max_N))
    title = f"Under the fitted law, {path.loading_text}: single runs, track, floor and encoders"
    figures = {
        "fig15": ratio_figure(part.table, measured=measured),
        "band": law_path_figure(path, title=title),
        "errors": law_errors_figure(path, title=title),
    }
    radii = [{field: getattr(row, field) for field in row.__slots__} for row in part.table]
    return figures, {"table1": radii, "band": path.covariance_rows(), "errors": path.error_rows()}


def simulation_trajectories(simulation: Simulation, folder: Path, *, speed_mps: float, force: bool) -> list[Path]:
    """Write each vehicle's path and the route as TUM files, timed by a constant speed along the route."""
    written = []
    for name, sweep in simulation.sweeps.items():
        t = sweep.distance_m / speed_mps
        written.append(write_tum(folder / f"{name}_route.tum", t, sweep.reference, force=force))
        for number, case in enumerate(sweep.cases):
            stem = f"{name}_{case.which}_{case.ratio:g}.tum"
            written.append(write_tum(folder / stem, t, sweep.poses[number], force=force))
    return written


def write_replay(replay: Replay, folder: Path, document: Mapping[str, Any], *, force: bool) -> list[Path]:
    """Write the figure of a replay, its table as CSV and everything as JSON."""
    from calib.report.figures.motion import replay_figure

    written = write_figures({"replay": replay_figure(replay)}, folder, force=force)
    table = _csv(folder / "replay.csv", document["runs"], force=force)
    return [write_json(folder / "replay.json", document, force=force), *written, table]


def replay_trajectories(campaign: Campaign, coefficients: CoefficientFile, folder: Path, *, force: bool) -> list[Path]:
    """Write the odometry of each logged run with its radii under load, and its reference where logged, as TUM files."""
    written = []
    runs = campaign.runs
    for run in np.flatnonzero(campaign.logs.present).tolist():
        log = campaign.logs.of(run)
        driven = _driven(campaign.select([run]), log, coefficients)
        if driven is None:
            continue
        stem = "".join(c if c.isalnum() or c in "-_" else "_" for c in str(runs.run_id[run]))
        written.append(write_tum(folder / f"{stem}.tum", log["t_s"], driven, force=force))
        if {"ref_x_m", "ref_y_m", "ref_theta_rad"} <= log.keys():
            poses = Poses(log["ref_x_m"], log["ref_y_m"], log["ref_theta_rad"])
            fine = np.isfinite(poses.stacked()).all(axis=1)
            written.append(write_tum(folder / f"{stem}_ref.tum", log["t_s"][fine], poses[fine], force=force))
    return written


def _driven(campaign: Campaign, log: Mapping[str, FloatArray], coefficients: CoefficientFile) -> Poses | None:
    """Return the odometry of a campaign of one run; None where its counts or its loads are not known."""
    if without_rear_wheels(campaign):
        poses, _ = stood_in(campaign, believed_model(coefficients, campaign.model.reference_load_N))
        return poses if np.isfinite(poses.stacked()).all() else None
    if not {"t_s", "counts_left", "counts_right"} <= log.keys():
        return None
    loads = (
        loads_in_steps(campaign.runs.number(name), log.get(name), campaign.logs.offsets)
        for name in ("load_left_N", "load_right_N")
    )
    radii = radii_under_load(coefficients.law, *loads)
    if not np.isfinite(radii).all():
        return None
    left, right = travel_from_counts(log["counts_left"], log["counts_right"], campaign.encoder, *radii)
    return integrate(left, right, coefficients.geometry.track_m)


def _csv(path: Path, rows: Sequence[Mapping[str, Any]], *, force: bool) -> Path:
    columns = list(rows[0]) if rows else []
    return write_text(path, csv_text(columns, ([row[name] for name in columns] for row in rows)), force=force)
