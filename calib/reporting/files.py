"""Result folders of simulations, replays and fleets: figures, tables, trajectories, pages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from calib.campaign.model import Campaign
from calib.campaign.wheels import without_rear_wheels
from calib.coefficients.file import CoefficientFile, believed_model
from calib.documents import csv_text, plain, to_json
from calib.fleet.run import Fleet, Survey
from calib.io import refuse_existing, write_files, write_json, write_text
from calib.odometry.integrate import integrate, radii_under_load, travel_from_counts
from calib.odometry.poses import Poses, write_tum
from calib.odometry.replay import Replay, carried_loads_N, stood_in
from calib.odometry.simulation import SHOWN, LawPart, Simulation
from calib.reporting.blocks import Block, Heading, Section
from calib.reporting.content import Attachment, Report
from calib.reporting.figures.style import write_figures
from calib.reporting.source import number_of
from calib.reporting.topics.fleet import fleet_content, survey_content
from calib.types import FloatArray


def write_simulation(simulation: Simulation, folder: Path, *, force: bool) -> list[Path]:
    """Write the figures of a simulation with their numbers as CSV beside them, and everything as JSON.

    Raises BadInputError where a file exists and `force` is False; nothing is then written.
    """
    figures, tables = _sweep_files(simulation)
    if simulation.law is not None:
        of_law = _law_files(simulation.law)
        figures, tables = figures | of_law[0], tables | of_law[1]
    document = folder / f"{simulation.study}.json"
    refuse_existing([document, *(folder / f"{name}.csv" for name in tables)], force=force)
    written = write_figures(figures, folder, force=force)
    written += [_csv(folder / f"{name}.csv", rows, force=force) for name, rows in tables.items()]
    return [write_json(document, simulation.to_dict(), force=force), *written]


def _sweep_files(simulation: Simulation) -> tuple[dict[str, Figure], dict[str, Sequence[Mapping[str, Any]]]]:
    from calib.reporting.figures.motion import sweep_errors_figure, sweep_figure

    figures: dict[str, Figure] = {}
    tables: dict[str, Sequence[Mapping[str, Any]]] = {}
    for name, sweep in simulation.sweeps.items():
        figures[name] = sweep_figure(sweep, error=SHOWN.get(name, "lateral_m"), title=simulation.title)
        figures[f"{name}_errors"] = sweep_errors_figure(sweep, title=simulation.title)
        tables |= {name: sweep.ends(), f"{name}_errors": sweep.along()}
    return figures, tables


def _law_files(part: LawPart) -> tuple[dict[str, Figure], dict[str, Sequence[Mapping[str, Any]]]]:
    from calib.reporting.figures.motion import law_errors_figure, law_path_figure, ratio_figure

    law, path = part.law, part.path
    measured = ((law.left.load_min_N, law.left.load_max_N), (law.right.load_min_N, law.right.load_max_N))
    title = f"Under the fitted law, {path.loading_text}: single runs, track, ground and encoders"
    figures = {
        "fig15": ratio_figure(part.table, measured=measured),
        "band": law_path_figure(path, title=title),
        "errors": law_errors_figure(path, title=title),
    }
    return figures, {"table1": plain(part.table), "band": path.covariance_rows(), "errors": path.error_rows()}


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
    from calib.reporting.figures.motion import replay_figure

    written = write_figures({"replay": replay_figure(replay)}, folder, force=force)
    table = _csv(folder / "replay.csv", document["runs"], force=force)
    return [write_json(folder / "replay.json", document, force=force), *written, table]


def replay_trajectories(campaign: Campaign, coefficients: CoefficientFile, folder: Path, *, force: bool) -> list[Path]:
    """Write the odometry of each logged run with its radii under load, and its reference where logged, as TUM files."""
    written = []
    for run in np.flatnonzero(campaign.logs.present).tolist():
        log = campaign.logs.of(run)
        driven = _driven(campaign.select([run]), log, coefficients)
        if driven is None:
            continue
        stem = "".join(c if c.isalnum() or c in "-_" else "_" for c in str(campaign.runs.run_id[run]))
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
    radii = radii_under_load(coefficients.law, *carried_loads_N(campaign))
    if not np.isfinite(radii).all():
        return None
    left, right = travel_from_counts(log["counts_left"], log["counts_right"], campaign.encoder, *radii)
    return integrate(left, right, coefficients.geometry.track_m)


def _csv(path: Path, rows: Sequence[Mapping[str, Any]], *, force: bool) -> Path:
    columns = list(rows[0]) if rows else []
    return write_text(path, csv_text(columns, ([row[name] for name in columns] for row in rows)), force=force)


FORMS = ("png", "svg")


@dataclass(frozen=True, slots=True)
class Heads:
    """What the pages of a fleet say beside its result: name, date of issue (YYYY-MM-DD), whether data are simulated."""

    name: str
    issued: str
    simulated: bool


def write_fleet(fleet: Fleet, into: Path, heads: Heads | None = None) -> list[Path]:
    """Write a fleet's result, all of it or none, in place of an earlier one; its pages where `heads` are given."""
    from calib.reporting.figures.challenge import fleet_distribution, fleet_drift
    from calib.reporting.figures.style import render_all

    document = fleet.to_dict()
    files = {"fleet.json": _bytes(to_json(document)), "vehicles.csv": _bytes(_table(document["vehicles"]))}
    if fleet.view.n_fitted:
        figures = {"distribution": fleet_distribution(fleet), "drift": fleet_drift(fleet)}
        files |= {
            f"{name}.{form}": data
            for name, figure in figures.items()
            if figure is not None
            for form, data in render_all(figure, FORMS).items()
        }
    return write_files(into, files | _pages(fleet_content(fleet, pictures=True), document, "fleet", heads), force=True)


def write_survey(survey: Survey, into: Path, heads: Heads | None = None) -> list[Path]:
    """Write the result of a task over a fleet; see `write_fleet`."""
    document = survey.to_dict()
    files = {f"{survey.what}.json": _bytes(to_json(document))}
    pages = _pages(survey_content(survey, page=True), document, survey.what, heads)
    return write_files(into, files | pages, force=True)


def _bytes(text: str) -> bytes:
    return text.encode("utf-8", "backslashreplace")


def _pages(blocks: Sequence[Block], document: Mapping[str, Any], stem: str, heads: Heads | None) -> dict[str, bytes]:
    """Return the report on a fleet: the blocks of the terminal with figures, the result attached as JSON."""
    if heads is None:
        return {}
    from calib.reporting.pages import to_html, to_pdf

    fleet = document["fleet"]
    failed = int(fleet["n_failed"])
    view = "Every vehicle and the fleet's view, as a program reads it"
    report = Report(
        report_id=number_of("FR", document),
        title="A fleet of vehicles",
        name=heads.name,
        issued=heads.issued,
        simulated=heads.simulated,
        passed=not failed,
        sections=_sections(blocks),
        attachments=(Attachment("fleet.json", to_json(document).encode(), view),),
        facts=(("Vehicles", f"{fleet['n_vehicles']}, of which {failed} failed"),),
    )
    return {f"{stem}.pdf": to_pdf(report), f"{stem}.html": _bytes(to_html(report))}


def _sections(blocks: Sequence[Block]) -> tuple[Section, ...]:
    starts = [number for number, block in enumerate(blocks) if isinstance(block, Heading)]
    parts = (blocks[first:last] for first, last in pairwise([*starts, len(blocks)]))
    return tuple(Section(head.text, tuple(inner)) for head, *inner in parts if isinstance(head, Heading))


def _table(vehicles: Sequence[Mapping[str, Any]]) -> str:
    """Return the vehicles as CSV; intervals as two columns."""
    columns = list(dict.fromkeys(name for vehicle in vehicles for name in vehicle))
    heads = [part for name in columns for part in ([f"{name}_low", f"{name}_high"] if "_ci95_" in name else [name])]
    rows = []
    for vehicle in vehicles:
        values = ((name, vehicle.get(name)) for name in columns)
        cells = ((value or ("", "")) if "_ci95_" in name else (value,) for name, value in values)
        rows.append([cell for some in cells for cell in some])
    return csv_text(heads, rows)
