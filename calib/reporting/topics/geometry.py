"""Geometry: parameters, identifiability, residuals by route; and a fleet's results."""

import math
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from calib import reporting
from calib.campaign.checks import listed
from calib.fleet import Population, Quantities, shown_quantity
from calib.fleet.run import Fleet, Survey
from calib.kinematics.adequacy import LACK_OF_FIT, USELESS_SHARE, GeometryVerdict
from calib.kinematics.result import Estimate, Geometry, RouteResidual, RunTrace
from calib.reporting import Block, Facts, Notice, Picture, Section, Table, Text, items, paragraph, picture, table
from calib.reporting.formatting import MISSING, capital, fixed, places, plural, prose
from calib.types import few_digits, grouped

_ROUTE: Final = (
    "<route", "n", "before | position (mm)", "before | heading (mrad)", "after | position (mm)",
    "after | heading (mrad)", "mean residual | along (mm)", "mean residual | across (mm)",
    "mean residual | heading (mrad)",
)  # fmt: skip


def geometry_content(geometry: Geometry) -> tuple[Block, ...]:
    """Return the result as blocks."""
    blocks = (Text(_heading(geometry)), *items(verdict_sentences(geometry)), parameter_table(geometry))
    return (*blocks, *items(geometry_sentences(geometry)), *_route_tables(geometry))


def parameter_table(geometry: Geometry) -> Table:
    """Return the parameters with their intervals; of those that a held scale gives, their ratios'."""
    heads = ("<parameter", "<unit", "nominal", "estimate", "sd", "95 % interval", "change")
    held = {one.name for one in geometry.scaled}
    note = " The mean radius is held at its nominal value: no result." if held else ""
    rows = (_cells(one, held=one.name in held) for one in (*geometry.estimates, *geometry.ratios))
    return table(f"Parameters, with 95 % intervals.{note}", heads, rows, dense=True)


def _route_tables(geometry: Geometry) -> tuple[Table, ...]:
    caption = "Residuals by route: root mean square of position and heading."
    routes = table(caption, _ROUTE, map(_route_cells, geometry.routes), dense=True)
    rows = [
        (row.left_out, str(row.n), f"{1e3 * row.before_rms_m:.1f}", f"{1e3 * row.after_rms_m:.1f}")
        for row in geometry.transfer
    ]
    heads = ("<held out", "n", "before (mm)", "after (mm)")
    return (routes, table("End position error of held-out runs.", heads, rows, dense=True)) if rows else (routes,)


def _heading(geometry: Geometry) -> str:
    stretches = "end poses" if geometry.using == "end_poses" else f"{geometry.n_segments} windows"
    of, n = geometry.clusters
    mark = " - SIMULATED DATA" if geometry.simulated else ""
    runs = plural(geometry.n_runs, "run")
    return f"{geometry.name}: {geometry.drive}, {runs}, {stretches}; intervals from {plural(n, of)}{mark}"


def verdict_sentences(geometry: Geometry) -> list[str]:
    """Return the verdict with its residuals, and what speaks against the estimates."""
    verdict = geometry.verdict.value.capitalize()
    judgement, parts = geometry.judgement, list[str]()
    remarks = ["On held-out runs it is no better than the nominal values: nothing is gained by it"] * _idle(geometry)
    for what, of, unit in (("position error", judgement.position, "m"), ("Heading error", judgement.heading, "rad")):
        if of.before:
            sizes = (of.before, of.after, of.held_out, of.expected)
            before, after, held_out, noise = (f"{1e3 * one:{'.3g' if one < 1.0 else '.0f'}} m{unit}" for one in sizes)
            outcome = f"{held_out} on held-out runs" if not math.isnan(of.held_out) else "too few runs to hold one out"
            parts.append(f"{what} {before} before, {after} after, {outcome}; noise {noise}")
            if geometry.passed and 0.0 < LACK_OF_FIT * of.expected < of.after:
                times = few_digits(of.after / of.expected, 2)
                left = f"The {what.lower()} left is {times} times the noise"
                remarks.append(f"{left}: 'calib diagnose' looks for its cause")
    return [f"{verdict}: {'. '.join(parts)}.", *(f"{capital(text)}." for text in (*remarks, *geometry.why))]


def _idle(geometry: Geometry) -> bool:
    measured = [of for of in (geometry.judgement.position, geometry.judgement.heading) if of.before]
    return geometry.passed and all(of.held_out > USELESS_SHARE * of.before for of in measured)


def geometry_sentences(geometry: Geometry) -> list[str]:
    """Return the sentences beside the table of parameters."""
    lines = []
    if geometry.undetermined:
        kept = ", ".join(geometry.undetermined)
        lines.append(f"Not identifiable from these runs, near the nominal value: {kept}.")
    if geometry.outliers:
        lines.append(f"Outliers, down-weighted: {', '.join(geometry.outliers)}.")
    return [*lines, *_geometry_remarks(geometry)]


def _geometry_remarks(geometry: Geometry) -> list[str]:
    lines = []
    if geometry.delays:
        delays = ", ".join(f"{one.label} {one.value_s:.4f} s" for one in geometry.delays)
        lines.append(f"The reference has a delay of its own in each recording, corrected in each: {delays}.")
    umbmark = geometry.umbmark
    if umbmark.applies:
        driven = f"{umbmark.n_cw} clockwise, {umbmark.n_ccw} counter-clockwise squares of {umbmark.side_m:.3g} m"
        factors = {"E_d": umbmark.E_d, "E_b": umbmark.E_b, "c_L": umbmark.c_left, "c_R": umbmark.c_right}
        lines.append(f"UMBmark ({driven}): {', '.join(f'{name} {value:.5f}' for name, value in factors.items())}.")
    return [*lines, *geometry.notes]


def _cells(estimate: Estimate, *, held: bool = False) -> tuple[str, ...]:
    name, factor, unit = shown_quantity(estimate.name)
    digits = places(factor * estimate.std)
    value, std, low, high = (f"{factor * x:.{digits}f}" for x in (estimate.value, estimate.std, *estimate.ci95))
    change = f"{100.0 * (estimate.value / estimate.nominal - 1.0):+z.2f} %" if estimate.nominal else ""
    std, interval = ("", "held with the mean") if held else (std, f"{low} to {high}")
    return (name, unit, f"{factor * estimate.nominal:.6g}", value, std, interval, change)


def _route_cells(route: RouteResidual) -> tuple[str, ...]:
    sizes = [(math.hypot(along, across), turn) for along, across, turn in (route.before_rms, route.after_rms)]
    errors = [fixed(1e3 * size, 1) for pair in sizes for size in pair]
    means = (MISSING if math.isnan(mean) else f"{1e3 * mean:+z.1f}" for mean in route.after_mean)
    return (route.kind or "(none)", str(route.n), *errors, *means)


def geometry_brief(geometry: Geometry) -> tuple[Block, ...]:
    """Return what the interpreter shows of a geometry."""
    return geometry_content(geometry)[:3]


#: level of the notice
LEVELS: Final = {GeometryVerdict.CALIBRATED: "good", GeometryVerdict.DOUBTFUL: "note", GeometryVerdict.WRONG: "bad"}


def geometry_sections(geometry: Geometry, notices: Sequence[Notice], *, withheld: bool = False) -> list[Section]:
    """Return result, residuals and correlations; `notices`: of a diagnosis; `withheld`: without the estimates."""
    verdict = geometry.verdict
    first, *further = verdict_sentences(geometry)
    result = (
        Notice(LEVELS[verdict], f"Geometry {verdict.value}", prose(capital(first.partition(": ")[2]))),
        *items(map(prose, further)),
        *notices,
        Facts(_estimated_from(geometry)),
        *([Text(paragraph("geometry_withheld"))] if withheld else [parameter_table(geometry)]),
        *items(map(prose, geometry.notes if withheld else _geometry_remarks(geometry))),
    )
    left = (
        Text("Residuals are measured less predicted: along and across the path, and in heading.", small=True),
        *_path_pictures(geometry.paths),
        *_residual_pictures(geometry.paths),
        *_route_tables(geometry),
    )
    sections = [Section("Result", result), Section("Residuals", left)]
    if len(geometry.estimates) > 1 and not withheld:
        sections.append(Section("Correlation of the parameters", _correlation(geometry)))
    return sections


def _estimated_from(geometry: Geometry) -> tuple[tuple[str, str], ...]:
    of, n = geometry.clusters
    stretches = "end poses of whole runs" if geometry.using == "end_poses" else f"{geometry.n_segments} windows"
    return (
        ("Drive", geometry.drive),
        ("Runs", f"{geometry.n_runs}, by {stretches}"),
        ("Intervals", f"95 %, from {n} {of}s"),
        ("Not determined", ", ".join(geometry.undetermined) or "none"),
        ("Outliers", ", ".join(geometry.outliers) or "none"),
    )


def _path_pictures(traces: tuple[RunTrace, ...]) -> list[Picture]:
    measured = [trace for trace in traces if np.isfinite(trace.reference_m).all(axis=1).any()]
    if not measured:
        return []
    largest = max(float(np.nanmax(np.hypot(*trace.residual_after[:, :2].T), initial=0.0)) for trace in measured)
    alt = f"Paths of {len(measured)} runs; the calibrated ones at most {1e3 * largest:.3g} mm from the reference"
    followed, ends = (any((len(trace.seen) > 1) is along for trace in measured) for along in (True, False))
    calibrated = ["coloured"] * followed + ["in blue, its end coloured"] * ends
    reference = ["by the reference, dotted"] * followed + ["the ends by the reference, as dots"] * ends
    words = reporting.caption("geometry-paths", calibrated=" or ".join(calibrated), measured=" or ".join(reference))
    return [Picture("geometry-paths", words, alt, partial(reporting.drawn, "calibration.draw_paths", measured))]


def _residual_pictures(traces: tuple[RunTrace, ...]) -> list[Picture]:
    traces = tuple(trace for trace in traces if np.isfinite(trace.residual_after).any())
    along = [trace for trace in traces if len(trace.seen) > 1]
    ends = [trace for trace in traces if len(trace.seen) < 2]
    alt = f"Residuals along, lateral and in heading against time, of {len(along)} runs"
    in_time = picture("geometry-residuals-in-time", alt, "calibration.residuals_in_time", along)
    alt = f"Residuals of {len(traces)} end poses before and after"
    by_run = picture("geometry-residuals-by-run", alt, "calibration.residuals_by_run", ends)
    return [*([in_time] if along else []), *([by_run] if ends else [])]


def _correlation(geometry: Geometry) -> tuple[Block, ...]:
    names = [shown_quantity(estimate.name)[0] for estimate in geometry.estimates]
    remark = "Parameters that correlate beyond 0.9, in bold, are known better together than each by itself."
    alt = f"Correlation of {', '.join(names)}"
    shown = picture("geometry-correlation", alt, "calibration.correlations", names, geometry.covariance)
    return (Text(remark, small=True), shown)


def after_geometry(geometry: Geometry, output: Path | None) -> str:
    """Return the step that a geometry was; `output`: the coefficient file that was written."""
    if any("straight runs alone" in one for one in geometry.why):
        return "geometry lengths"
    if not geometry.passed:
        return "geometry failed"
    return "geometry --output" if output is not None else "geometry idle" if _idle(geometry) else "geometry"


#: rows of a list at most; the tables have them all
MAX_ROWS = 40
_COMMON: Final = "Common to many vehicles"


def fleet_content(fleet: Fleet | Survey, *, page: bool = False) -> tuple[Block, ...]:
    """Return what a task over a fleet says.

    For a page with pictures, and without what was done now: interruptions change nothing.
    """
    mark = (reporting.simulated_notice(),) if fleet.simulated and not page else ()
    return (*mark, *(_of_survey(fleet, page=page) if isinstance(fleet, Survey) else _of_fit(fleet, page=page)))


def _of_fit(fleet: Fleet, *, page: bool) -> tuple[Block, ...]:
    view = fleet.view
    facts = (("vehicles", f"{view.n_fitted} of {view.n_vehicles} fitted, {view.n_failed} failed"),)
    read = (("files", f"{fleet.n_read} read now, {fleet.n_kept} kept from before"),)
    doubtful = [f"{one.vehicle}: {'; '.join(one.doubtful)}" for one in fleet.records if one.doubtful]
    return (
        reporting.Heading("Fleet"),
        Facts(facts if page else facts + read),
        *_populations(view.populations),
        *(_pictures(fleet) if page else ()),
        *_counted("Outlying vehicles", [f"{outlier.vehicle}, {outlier.why}" for outlier in view.outliers]),
        *([_drifting(fleet)] if view.drifting else ()),
        *_counted(_COMMON, [cause.sentence for cause in view.common]),
        *_counted("Doubtful laws, by checks that 'calib fit' of the vehicle explains", doubtful),
        *_counted("Failed", [f"{one.vehicle}: {one.why}" for one in fleet.records if one.status == "failed"]),
        Text(paragraph("fleet_rates"), small=True),
    )


def _counted(title: str, lines: Sequence[str]) -> list[Block]:
    return [reporting.Heading(f"{title} ({len(lines)})"), reporting.Items(tuple(lines[:MAX_ROWS]))] if lines else []


def _populations(populations: Mapping[str, Population]) -> list[Table]:
    rows = []
    for name, population in populations.items():
        shown, scale, unit = shown_quantity(name)
        half = 0.5 * (population.mean_ci95[1] - population.mean_ci95[0])
        numbers = (population.mean, half, population.spread, *population.spread_ci95, population.within)
        mean, plus, spread, low, high, within = (f"{scale * number:.4f}" for number in numbers)
        rows.append((shown, f"{mean} ± {plus}", spread, f"{low} to {high}", within, unit))
    heads = ("<quantity", "mean", "between", "95 %", "within", "<unit")
    return [table("The fleet; ± is the 95 % interval", heads, rows)] if rows else []


def _drifting(fleet: Fleet) -> Table:
    title = f"Vehicles that drift ({len(fleet.view.drifting)}), soonest due first; ± is the 95 % interval"
    rows = [
        (one.vehicle, one.wheel, f"{1e9 * one.per_day_m:+.0f} ± {1e9 * one.half_width_m:.0f}", f"{one.due_day:.0f}")
        for one in fleet.view.drifting[:MAX_ROWS]
    ]
    return table(title, ("<vehicle", "<wheel", "drift (nm a day)", "due on day"), rows)


def _pictures(fleet: Fleet) -> list[Picture]:
    from calib.reporting.figures.studies import fleet_figures

    figures, shown = fleet_figures(fleet).items(), reporting.catalogue()["fleet"]
    return [Picture(f"fleet-{name}", reporting.caption(f"fleet-{name}"), shown[name], draw) for name, draw in figures]


def _of_survey(survey: Survey, *, page: bool) -> tuple[Block, ...]:
    failed = [f"{record.name}: {record.why}" for record in survey.records if record.status == "failed"]
    done = len(survey.records) - len(failed)
    facts = (("vehicles", f"{done} of {len(survey.records)} done, {len(failed)} failed"),)
    now = (("now", f"{survey.n_done} done now, {survey.n_kept} kept from before"),)
    quantities = survey.quantities or Quantities({}, (), ())
    shared = [*(cause.sentence for cause in survey.shared), *(one.sentence for one in quantities.common)]
    return (
        reporting.Heading(f"Fleet: {survey.what}"),
        Facts(facts if page else facts + now),
        *([_verdicts(survey)] if done else ()),
        *_populations(quantities.populations),
        *_counted("Outlying vehicles", [f"{one.vehicle}, {one.why}" for one in quantities.outliers]),
        *_counted(_COMMON, shared),
        *_counted("Failed", failed),
    )


def _verdicts(survey: Survey) -> Table:
    verdicts = []
    for name, values in ((one.name, one.values) for one in survey.records if one.status != "failed"):
        what = [cause["effect"] for cause in values.get("causes", ())]
        what += [*values.get("wrong", ()), *values.get("suspicious", ())]
        what += [reason.partition(":")[0] for reason in values.get("reasons", ())]
        verdicts.append(((values.get("verdict", MISSING), ", ".join(dict.fromkeys(what)) or MISSING), name))
    alike = sorted(grouped(verdicts).items(), key=lambda one: -len(one[1]))[:MAX_ROWS]
    rows = [(*words, str(len(names)), listed(names)) for words, names in alike]
    return table("Verdicts", ("<Verdict", "*Found", "Vehicles", "*Which"), rows)
