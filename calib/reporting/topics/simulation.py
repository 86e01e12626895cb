"""Simulations of Section 7, replays, wheel loads: what is said of them, and their files; scores of a blind check."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from calib.campaign.model import REFERENCE_POSE, Campaign
from calib.campaign.wheels import without_rear_wheels
from calib.coefficients.file import CoefficientFile, believed_model
from calib.documents import csv_text, plain
from calib.gap.decision.sentences import SMALLER
from calib.io import refuse_existing, write_json, write_text
from calib.odometry import integrate
from calib.odometry.law_path import LawPath
from calib.odometry.poses import Poses, write_tum
from calib.odometry.replay import Replay, carried_loads_N, stood_in, with_loads
from calib.odometry.routes import radii_under_load, travel_from_counts
from calib.odometry.simulation import SHOWN, LawPart, Simulation, Sweep, paper_headline
from calib.reporting import Block, Items, Table, Text, caption, catalogue, paragraph, simulated_notice, table
from calib.reporting.formatting import MISSING, fixed, measured
from calib.types import FloatArray, few_digits
from calib.vehicle import LoadSweep, Vehicle, WeighedPayload

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from calib.challenge.own_runs import Own
    from calib.challenge.score import Score

#: component of the error -> factor for reading
_FACTORS: Final = {"along_m": 1.0, "lateral_m": 1.0, "heading_rad": 1e3, "global_x_m": 1.0, "global_y_m": 1.0}


def simulation_content(simulation: Simulation) -> tuple[Block, ...]:
    """Return what a simulation says."""
    law = simulation.law
    routes = [sweep.route.name for sweep in simulation.sweeps.values()]
    return (
        *([simulated_notice()] if simulation.simulated else ()),
        *(_sweep(name, sweep) for name, sweep in _sweeps(simulation)),
        *([_headline(simulation)] if simulation.headlines else ()),
        *(_law(law) if law else ()),
        *(_path(law.path, routes[-1]) if law and len(law.path.loading.from_m) > 1 else ()),
    )


def _sweeps(simulation: Simulation) -> list[tuple[str, Sweep]]:
    return [
        (name, sweep)
        for name, sweep in simulation.sweeps.items()
        if simulation.law is None or any((case.left, case.right) != (1.0, 1.0) for case in sweep.cases)
    ]


def _sweep(name: str, sweep: Sweep) -> Table:
    rows = [
        (
            str(row["case"]),
            fixed(float(row["end_x_m"]), 6),
            fixed(float(row["end_y_m"]), 6),
            fixed(math.degrees(float(row["end_theta_rad"])), 4),
            *(_signed(float(row[f"error_{key}_m"]), 5) for key in ("along", "lateral", "global_x", "global_y")),
            fixed(float(row["error_distance_m"]), 6),
        )
        for row in sweep.ends()
    ]
    poses = ("~End pose | x (m)", "~End pose | y (m)", "~End pose | θ (deg)")
    errors = (f"True minus intended | {at} (m)" for at in ("along", "left", "global x", "global y", "distance"))
    title = f"{name}: {sweep.route.name}, track {sweep.track_m:g} m; end of the route."
    return table(title, ("<Vehicle", *poses, *errors), rows)


def _headline(simulation: Simulation) -> Table:
    paper = paper_headline()
    of_paper = f"paper: {paper.before_m:g} m, {paper.after_m:g} m, about {paper.ratio:.0f}"
    title = f"Largest error in global x at the end, without and with the correction ({of_paper})."
    rows = [
        (line.which, fixed(line.without_m, 5), fixed(line.corrected_m, 5), fixed(line.ratio, 1))
        for line in simulation.headlines
    ]
    return table(title, ("<Wheel off", "Without (m)", "With (m)", "Times smaller"), rows)


def _law(part: LawPart) -> list[Table]:
    rows = []
    for row in part.table:
        left = (row.radius_left_m, row.mean_left_m, row.prediction_left_m)
        right = (row.radius_right_m, row.mean_right_m, row.prediction_right_m)
        outside = "*" if row.extrapolated_left or row.extrapolated_right else ""
        rows.append((f"{row.load_N:g}{outside}", *(fixed(1e3 * size, 4) for size in (*left, *right))))
    starred = " * outside the loads for which the law holds." if any(row[0].endswith("*") for row in rows) else ""
    sizes = ("radius", "± mean", "± run")
    heads = ("Load (N)", *(f"{side} wheel | {size} (mm)" for side in ("Left", "Right") for size in sizes))
    return [table(caption("table-law-loads", starred=starred), heads, rows), _journeys(part)]


def _journeys(part: LawPart) -> Table:
    rows = []
    for journey in part.journeys:
        lateral, (low, high) = journey.corrected["lateral_m"], journey.ratio_ci95
        halves = (0.5 * (end[1] - end[0]) for end in (lateral.linear, lateral.monte_carlo))
        sizes = (journey.without_rms_m, journey.corrected_rms_m, journey.corrected_95_m, *halves)
        loads = f"{journey.load_left_N:.0f} / {journey.load_right_N:.0f}"
        numbers = (fixed(journey.radius_ratio, 5), *(fixed(size, 4) for size in sizes))
        times_smaller = f"{journey.ratio:.1f} [{low:.1f}, {high:.1f}]"
        rows.append((f"{loads}, {'mean' if journey.band == 'mean' else 'run'}", *numbers, times_smaller))
    bands = ("e_y ± | linear (m)", "e_y ± | Monte Carlo (m)")
    errors = ("Without | rms (m)", "With | rms (m)", "With | 95 % (m)")
    heads = ("<Loads L / R, band", "E_r", *errors, *bands, "Times smaller [95 %]")
    return table(caption("table-journeys"), heads, rows)


def _path(path: LawPath, route: str) -> list[Block]:
    ends = {"of the reference load": path.without.end(), "that follow the load": path.corrected.end()}
    rows: list[tuple[str, ...]] = []
    for title, end in ends.items():
        errors = (_signed(factor * end[f"error_{key}"], 4) for key, factor in _FACTORS.items())
        rows.append((title, *errors, fixed(end["rms_m"], 4)))
        rows.append(("", *(f"± {factor * end[f'half_width95_{key}']:.4f}" for key, factor in _FACTORS.items()), ""))
    heads = ("<Radii", "along (m)", "left (m)", "heading (mrad)", "global x (m)", "global y (m)", "rms (m)")
    shown = table(caption("table-journey", route=route, loading=path.loading_text), heads, rows)
    return [shown, Text(f"Radii that follow the load make the end error {times(path.ratio, path.ratio_ci95)}.")]


def times(ratio: float, ci95: tuple[float, float] | None = None) -> str:
    """Return errors before over after in words, with the interval of what is said; 1.0 is no change."""
    if 1.0 / SMALLER < ratio < SMALLER:
        return f"neither smaller nor larger ({ratio:.2f} times)"
    size, *ends = (few_digits(one if ratio > 1.0 else 1.0 / one) for one in (ratio, *(ci95 or ())))
    interval = f" (95 % interval {min(ends, key=float)} to {max(ends, key=float)})" if ends else ""
    return f"{size} times {'smaller' if ratio > 1.0 else 'larger'}{interval}"


def _signed(value: float, decimals: int) -> str:
    text = fixed(value, decimals)
    return text if text.startswith("−") or float(text) == 0 else f"+{text}"


#: radii where a front wheel or four wheels drive the odometry
BY_GEOMETRY: Final = {"model": "as the simulator believes", "corrected": "the coefficients' radii and lengths"}


def replay_content(replay: Replay) -> tuple[Block, ...]:
    """Return what a replay says."""
    name = replay.campaign + (" (simulated)" if replay.simulated else "")
    rows = [
        (title, fixed(replay.rms_m[key], 4), fixed(1e3 * replay.rms_heading_rad[key], 2))
        for key, title in (BY_GEOMETRY if replay.by_geometry else catalogue()["radii"]).items()
    ]
    title = f"{name}: end error, odometry minus reference, of {int(replay.in_range.sum())} runs."
    errors = table(title, ("<Radii", "rms (m)", "rms heading (mrad)"), rows)
    left_out = [Text(f"{count} runs not used: {reason}.") for reason, count in replay.left_out.items() if count]
    if replay.by_geometry:
        return (errors, Text("The vehicle's runtime reads two wheels on one axle; so it was not checked."), *left_out)
    check = replay.runtime
    law = times(replay.rms_m["model"] / replay.rms_m["corrected"])
    largest = {"largest_m": check.largest_difference_m, "largest_rad": check.largest_difference_rad}
    sentences = (
        paragraph("replay", law=law, following=times(replay.ratio, replay.ratio_ci95)),
        paragraph("runtime", runs=check.runs, samples=check.samples, **largest),
        *(f"The runtime refused {count} times: {status}." for status, count in check.faults.items()),
    )
    return (errors, *map(Text, sentences), *left_out)


def loads_content(vehicle: Vehicle, sweep: LoadSweep) -> tuple[Block, ...]:
    """Return the wheel loads of a payload or a sweep."""
    payload = ("Payload | mass (kg)", "Payload | x (m)", "Payload | y (m)")
    loads = (f"Wheel load | {wheel} (N)" for wheel in ("front", "left", "right", "sum"))
    places = {"payload_x_m": 4, "payload_y_m": 4} | dict.fromkeys(("front_N", "left_N", "right_N", "total_N"), 2)
    rows = [
        (f"{row['payload_kg']:.4g}", *(fixed(row[key], most) for key, most in places.items())) for row in sweep.rows()
    ]
    built = f"track {vehicle.track_m:g} m, wheelbase {vehicle.wheelbase_m:g} m, mass {vehicle.mass_kg:g} kg"
    return (table(f"Wheel loads ({built}).", (*payload, *loads), rows),)


def weighed_content(payload: WeighedPayload, *, known: bool) -> tuple[Block, ...]:
    """Return the payload found from three weighed wheels."""
    rows = []
    for title, unit, value, std, decimals in (
        ("mass", "kg", payload.payload_kg, payload.payload_std_kg, 3),
        ("ahead of the rear axle, x", "m", payload.payload_x_m, payload.payload_x_std_m, 4),
        ("left of the centre line, y", "m", payload.payload_y_m, payload.payload_y_std_m, 4),
    ):
        cells = measured(value, 2 * std) if known else (fixed(value, decimals), "not given")
        rows.append((title, unit, *cells))
    return (table("Payload from three weighed wheels; ± is 95 % (k = 2).", ("<Quantity", "<Unit", "Value", "±"), rows),)


def write_simulation(simulation: Simulation, folder: Path, *, force: bool) -> list[Path]:
    """Write the figures of a simulation with their numbers as CSV beside them, and everything as JSON.

    Raises BadInputError where a file exists and `force` is False; nothing is then written.
    """
    from calib.reporting.figures import studies, write_figures

    figures: dict[str, Figure] = {}
    tables: dict[str, Sequence[Mapping[str, Any]]] = {}
    for name, sweep in _sweeps(simulation):
        figures[name] = studies.sweep_figure(sweep, error=SHOWN.get(name, "lateral_m"), title=simulation.title)
        figures[f"{name}_errors"] = studies.sweep_errors_figure(sweep, title=simulation.title)
        tables |= {name: sweep.ends(), f"{name}_errors": sweep.along()}
    if simulation.law is not None:
        rows, path = simulation.law.table, simulation.law.path
        title = f"Under the fitted law, {path.loading_text}: law, track, ground and encoders"
        figures |= {
            "fig15": studies.ratio_figure(rows, simulation.law.law.left, simulation.law.law.right),
            "band": studies.law_path_figure(path, title=title),
            "errors": studies.law_errors_figure(path, title=title),
        }
        tables |= {"table1": plain(rows), "band": path.covariance_rows(), "errors": path.error_rows()}
    document = folder / f"{simulation.study}.json"
    refuse_existing([document, *(folder / f"{name}.csv" for name in tables)], force=force)
    written = write_figures(figures, folder, simulated=simulation.simulated, force=force)
    written += [_csv(folder / f"{name}.csv", rows, force=force) for name, rows in tables.items()]
    return [write_json(document, simulation.to_dict(), force=force), *written]


def simulation_trajectories(simulation: Simulation, folder: Path, *, speed_mps: float, force: bool) -> list[Path]:
    """Write the route, which the odometry believes, and real paths as TUM files, timed by a constant speed along it.

    Real: each vehicle's; under a law those with radii of the reference load and with radii that follow the load, along
    the last route.
    """
    written, shown = [], dict(_sweeps(simulation))
    for name, sweep in simulation.sweeps.items():
        t = sweep.distance_m / speed_mps
        written.append(write_tum(folder / f"{name}_route.tum", t, sweep.reference, force=force))
        for number, case in enumerate(sweep.cases if name in shown else ()):
            stem = f"{name}_{case.which}_{case.ratio:g}.tum"
            written.append(write_tum(folder / stem, t, sweep.poses[number], force=force))
    if simulation.law is not None:
        path, last = simulation.law.path, list(simulation.sweeps)[-1]
        for stem, driven in (("without", path.without), ("corrected", path.corrected)):
            target = folder / f"{last}_{stem}.tum"
            written.append(write_tum(target, path.distance_m / speed_mps, driven.poses, force=force))
    return written


def write_replay(replay: Replay, folder: Path, document: Mapping[str, Any], *, force: bool) -> list[Path]:
    """Write the figure of a replay, its table as CSV and everything as JSON."""
    from calib.reporting.figures import studies, write_figures

    written = write_figures({"replay": studies.replay_figure(replay)}, folder, simulated=replay.simulated, force=force)
    table = _csv(folder / "replay.csv", document["runs"], force=force)
    return [write_json(folder / "replay.json", document, force=force), *written, table]


def replay_trajectories(campaign: Campaign, coefficients: CoefficientFile, folder: Path, *, force: bool) -> list[Path]:
    """Write the odometry of each logged run with its radii under load, and its reference where logged, as TUM files."""
    written, campaign = [], with_loads(campaign, coefficients.law)[0]
    for run in np.flatnonzero(campaign.logs.present).tolist():
        log = campaign.logs.of(run)
        driven = _driven(campaign.select([run]), log, coefficients)
        if driven is None:
            continue
        stem = "".join(c if c.isalnum() or c in "-_" else "_" for c in str(campaign.runs.run_id[run]))
        written.append(write_tum(folder / f"{stem}.tum", log["t_s"], driven, force=force))
        if set(REFERENCE_POSE) <= log.keys():
            poses = Poses(*(log[name] for name in REFERENCE_POSE))
            fine = np.isfinite(poses.stacked()).all(axis=1)
            written.append(write_tum(folder / f"{stem}_ref.tum", log["t_s"][fine], poses[fine], force=force))
    return written


def _driven(campaign: Campaign, log: Mapping[str, FloatArray], coefficients: CoefficientFile) -> Poses | None:
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
    return write_text(path, csv_text(list(rows[0]) if rows else [], (row.values() for row in rows)), force=force)


_MET: Final = {True: "met", False: "MISSED", None: ""}


def score_content(score: "Score") -> list[Block]:
    """Return what a score says."""
    summary = score.summary
    coverage = summary["interval_coverage"]
    sentences = [
        f"95 % set: {summary['median_set_size']} hypotheses (median)",
        f"95 % intervals that hold the truth: {coverage['hits']} of {coverage['total']}",
    ]
    if summary["closure_compared"]:
        difference = summary["closure_predicted_minus_achieved_median"]
        sentences.append(f"closure, predicted against achieved: {difference:.3f} apart (median)")
    if summary["crowded_stated_minus_true"] is not None:
        sentences.append(
            "crowded cases: stated probabilities less the share that is true: "
            f"{summary['crowded_stated_minus_true']:+.3f} (wanted within 0.05)"
        )
    return [_board(score), *_parts(score), Items(tuple(sentences)), _misses(score)]


def _board(score: "Score") -> Table:
    rows = []
    for name, line in score.board.items():
        rate = MISSING if line.rate is None else f"{line.rate:.1%}"
        spans = [f"{low:.1%}..{high:.1%}" for low, high in (line.wilson95, line.exact95)]
        target = "{1} {0:.0%}".format(*wanted) if (wanted := score.target(name)) else ""
        rows.append((name, f"{line.hits}/{line.total}", rate, *spans, target, _MET[score.meets(name)]))
    title = f"{len(score.cases)} sealed cases ({score.purpose}), truth {score.truth_sha256}"
    heads = ("95 % interval | Wilson", "95 % interval | Clopper-Pearson")
    return table(title, ("<Line", "Cases", "Share", *heads, "Target", "<"), rows)


def _parts(score: "Score") -> list[Table]:
    words = ("detected", "first", "in_group", "covered")
    titles = ("Signal", "A gap seen", "Named first", "Named or in its group", "In the 95 % set",
              "Ceiling", "First over ceiling", "Own ceiling", "First over own")  # fmt: skip
    ceilings = ("gated", "hits_over_gated", "own_gated", "hits_over_own_gated")
    by_signal = []
    for signal, row in score.by_signal.items():
        reached = (score.ceilings[signal][key] for key in ceilings)
        shares = (f"{row[word].hits}/{row[word].total}" for word in words)
        by_signal.append((signal, *shares, *(MISSING if one is None else f"{one:.2f}" for one in reached)))
    reliability = [
        (f"{one.low:.1f}..{one.high:.1f}", f"{one.stated:.3f}", f"{one.true.rate:.3f}", f"{one.true.total}")
        for one in score.reliability
    ]
    return [
        table("Single effects by signal.", titles, by_signal),
        table("Stated probabilities.", ("Bin", "Stated", "True", "Statements"), reliability),
    ]


def _misses(score: "Score") -> Table:
    rows = []
    for case in score.misses:
        signal = MISSING if case.signal is None else f"{case.signal:g}"
        truth = f"deleted {case.deleted}" if case.deleted else " + ".join(case.truth) or "nothing"
        answer = case.error or f"{case.verdict}: {', '.join(case.named)}".rstrip(": ")
        rows.append((case.case, case.group, signal, truth, answer, case.rival))
    return table("Misses.", ("<Case", "<Group", "Signal", "*Truth", "*Answer", "*Nearest alternative, sigma"), rows)


def own_content(own: "Own") -> list[Block]:
    """Return what was found, as blocks."""
    head = ("*Planted", "Size", "<Unit", "Signal", "Times", "Seen")
    rows: dict[bool, list[tuple[str, ...]]] = {False: [], True: []}
    for plant in own.found:
        counted = ("open", "wrong") if plant.outside else ("first", "in_group", "wrong")
        counts = (str(len(plant.answers)), *(str(plant.times(what)) for what in ("seen", *counted)))
        rows[plant.outside].append((plant.effect, f"{plant.size:.3g}", plant.unit, f"{plant.signal:.1f}", *counts))
    low, high = (f"{bound:.0%}" for bound in own.alarms.exact95)
    sentences = [
        f"False alarms where nothing was planted: {own.alarms.hits} of {own.alarms.total} (95 %: {low} to {high}).",
        f"Something else named: {own.wrong.hits} of {own.wrong.total} planted.",
        paragraph("own_noise", units=own.units, repeated=own.units_with_repeats, verdict=own.own_verdict),
    ]
    if own.done < own.asked:
        sentences.append(f"Diagnosed {own.done} of {own.asked}: the time was up.")
    planted = f"Planted on {own.campaign}'s own noise and route."
    mark = [simulated_notice()] if own.simulated else []
    shown: list[Block] = [*mark, table(planted, (*head, "First", "In group", "Wrong"), rows[False])]
    if rows[True]:
        shown.append(table("Causes that no library holds.", (*head, "Left open", "Fix recommended"), rows[True]))
    return [*shown, Items((*sentences, *(f"Not planted: {name}: {why}." for name, why in own.left_out.items())))]
