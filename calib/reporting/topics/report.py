"""Pages that only a report has: item, method, conditions, regression, coefficients, budget, limits and files."""

import hashlib
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from calib import __version__, reporting
from calib.campaign.checks import SIDES
from calib.campaign.settings import WHEEL_LOADS
from calib.radius.deviation import allowed_amplitude_m, radius_error
from calib.radius.law import round_loads
from calib.radius.regression import WheelFit, t_quantile
from calib.radius.result import Fit
from calib.reporting import Block, Equation, Facts, Section, Table, Text, caption, catalogue, items, paragraph, table
from calib.reporting.formatting import MISSING, aligned, fixed, measured, places, plural, prose, span, two_digits
from calib.reporting.source import OPTIONAL, STATED, Source
from calib.reporting.topics import fit as results
from calib.types import FloatArray


def item_section(source: Source) -> Section:
    """Return the vehicle as the campaign states it."""
    vehicle, encoder = source.setup.vehicle, source.setup.encoder
    left, right = encoder.counts_per_rev_left, encoder.counts_per_rev_right
    counts = f"{left:g}" if left == right else f"{left:g} (left) and {right:g} (right)"
    wrap = "" if encoder.wrap_bits is None else f", counters of {encoder.wrap_bits} bits"
    rows = source.facts(item="Vehicle", item_id="Identification", item_condition="Condition", received="Received")
    rows += [
        ("Campaign", source.fit.name),
        ("Track", f"{1e3 * vehicle.track_m:.1f} mm between the contact points of the rear wheels"),
        ("Wheelbase", f"{1e3 * vehicle.wheelbase_m:.1f} mm"),
        ("Nominal wheel radius", f"{1e3 * vehicle.wheel_radius_m:.2f} mm, unloaded"),
        ("Mass", f"{vehicle.mass_kg:g} kg without payload"),
        ("Wheel encoders", f"{counts} counts a revolution{wrap}"),
    ]
    facts = Facts(tuple((name, value or MISSING) for name, value in rows))
    return Section("Item", (facts, Text(paragraph("item"), small=True)))


def missing_section(source: Source) -> Section | None:
    """Return the list of what the campaign does not state, to be filled in."""
    return missing_of(source.stated)


def missing_of(stated: Mapping[str, str]) -> Section | None:
    """Return what is missing of the keys of `STATED` that a reader must be told, as a list to be filled in."""
    rows = [(what.capitalize(), key, "") for key, what in STATED.items() if key not in {*stated, *OPTIONAL}]
    if not rows:
        return None
    caption = "Not stated by the campaign: to be filled in, here or under [report] of campaign.toml."
    return Section("Not stated", (table(caption, ("<What", "<Key of [report]", "*To be filled in"), rows),))


def preparation_section(source: Source) -> Section | None:
    """Return what the import of laboratory files recognised, converted and omitted."""
    return preparation_of(source.fit.provenance.get("ingest"))


def preparation_of(notes: Any) -> Section | None:
    """Return notes of an import, (where, text), as a section; None where there are none."""
    if not isinstance(notes, (list, tuple)) or not notes:
        return None
    sentences = [f"{where}: {text}" for where, text in notes[:MOST_NOTES]]
    n_more = len(notes) - len(sentences)
    sentences += [f"and {n_more} more, in ingest.json of the campaign"] if n_more else []
    head = Text("The runs were made of the laboratory's files by calib ingest, which noted:")
    return Section("Preparation of the data", (head, *items(sentences)))


MOST_NOTES: Final = 20
_CONDITIONS = {
    "temperature_C": ("Temperature of the hall", "°C", ".1f"),
    "speed_mps": ("Set speed", "m/s", ".3g"),
    "distance_m": ("Length of the runs", "m", ".2f"),
    "payload_kg": ("Payload", "kg", ".4g"),
    "payload_x_m": ("Payload ahead of the rear axle", "m", ".3f"),
    "payload_y_m": ("Payload left of the centre line", "m", ".3f"),
    "load_left_N": ("Load of the left wheel", "N", ".0f"),
    "load_right_N": ("Load of the right wheel", "N", ".0f"),
    "minutes_under_load": ("Time under load before a run", "min", ".3g"),
}


def conditions_section(source: Source) -> Section:
    """Return what the runs were measured with and under."""
    setup, radii = source.setup, source.fit.radii
    sessions = len(set(radii.session.tolist()))
    out, back = int((radii.direction == "out").sum()), int((radii.direction == "back").sum())
    rows = source.facts(place="Place", floor="Floor", measured="Dates of measurement", instruments="Instruments")
    milli = 1e3 * setup.rangefinder.sigma_m
    rows += [("Sessions", str(sessions)), ("Laser rangefinder", f"standard uncertainty of a distance {milli:.2g} mm")]
    if any("heading" in text for text in radii.path_source.tolist()):
        milli = 1e3 * setup.reference.sigma_theta_rad
        rows.append(("Heading reference", f"standard uncertainty of a heading {milli:.2g} mrad"))
    measured = {name: shown for name, shown in _CONDITIONS.items() if name in setup.conditions}
    rows += [(title, span(*setup.conditions[name], unit, form)) for name, (title, unit, form) in measured.items()]
    if out + back:
        rows.append(("Direction of driving", f"{plural(out, 'run')} out, {back} back"))
    traceable = "No certificates of the instruments are stated: this report shows no traceability to the SI."
    if "instruments" in source.stated:
        traceable = "Traceability to the SI rests on the instruments' certificates as named above."
    assumed = any(key.startswith(("rangefinder", "reference")) for key in setup.assumed)
    beside = " where none is assumed" if assumed else ""
    stated = f"{traceable} The standard uncertainties of the instruments are as stated by the campaign{beside}."
    texts = [Text(stated), results.assumed_text(setup.assumed)]
    if "remarks" in source.stated:
        texts.append(Text(f"Remarks: {source.stated['remarks']}"))
    return Section("Instruments and conditions", (Facts(tuple(rows)), *texts))


def method_section(source: Source) -> Section:
    """Return effective radius, regression, and their uncertainty."""
    fit = source.fit
    wheels = catalogue()["wheels"].get(source.setup.vehicle.drive, "the rear wheels")
    designs = {name: catalogue()["design"].get(wheel.design, "") for name, wheel in fit.wheels.items()}
    if len(set(designs.values())) > 1:
        designs = {name: f"{name.capitalize()} wheel: {text}" for name, text in designs.items()}
    blocks = (
        Text(paragraph("method_radius", wheels=wheels)),
        Equation("effective_radius"),
        Text(paragraph("method_line")),
        Equation("law"),
        Text(paragraph("method_sessions", designs=" ".join(dict.fromkeys(designs.values())).strip())),
        Text(paragraph("method_uncertainty")),
        Text(f"Deviations from the method: {source.stated.get('deviations', 'none stated')}."),
    )
    return Section("Method", (*blocks, *items(map(prose, fit.notes))))


def limits_section(source: Source) -> Section:
    """Return the limits of the result."""
    fit = source.fit
    lines = [paragraph("limits_item")]
    for name, wheel in fit.wheels.items():
        low, high = wheel.law.load_min_N, wheel.law.load_max_N
        limit = "only one load was measured; how the radius changes with load is not known."
        if wheel.model == "line":
            limit = f"loads below {low:.0f} N and above {high:.0f} N were not measured."
        lines.append(f"{name.capitalize()} wheel: {limit}")
    if any(wheel.design == "confounded" for wheel in fit.wheels.values()):
        lines.append(paragraph("limits_sessions"))
    conditions = source.setup.conditions
    speeds = f" ({span(*conditions['speed_mps'], 'm/s', '.2g')})" if "speed_mps" in conditions else ""
    halls = ", as none were recorded"
    if "temperature_C" in conditions:
        halls = f" than {span(*conditions['temperature_C'], '°C', '.1f')}"
    lines += [paragraph("limits_speeds", speeds=speeds), paragraph("limits_halls", halls=halls)]
    closing = Text(paragraph("limits_closing"))
    return Section("What this report does not cover", (reporting.Items((*lines, paragraph("limits_track"))), closing))


#: beyond this many files their logs are given as one hash
MOST_FILES: Final = 12


def files_section(source: Source) -> Section:
    """Return the inputs with their SHA-256, the program and the attachment."""
    rows = sorted(source.inputs.items())
    program = f"calib {source.fit.provenance.get('version', __version__)}"
    checksum = source.coefficients.checksum
    facts = Facts((("Program", program), ("Attached", "coefficients.json"), ("Its checksum", checksum)))
    if not rows:
        return Section("Files", (facts, Text("The data were handed over in memory; there are no input files.")))
    remark: tuple[Text, ...] = ()
    logs = [f"{digest}  {path}\n" for path, digest in rows if path.startswith("logs/")]
    if logs and len(rows) > MOST_FILES:
        rows = [row for row in rows if not row[0].startswith("logs/")]
        rows.append((f"{len(logs)} logs*", hashlib.sha256("".join(logs).encode()).hexdigest()))
        listing = "* SHA-256 of the list that sha256sum prints for the logs, sorted by path; each log's own hash is in "
        remark = (Text(f"{listing}the attached coefficients.json.", small=True),)
    files = table("Input files and their SHA-256.", ("*File", "=SHA-256"), rows, dense=True)
    return Section("Files", (facts, files, *remark))


def regression_section(source: Source) -> Section:
    """Return figure and table of both laws with their bands."""
    fit = source.fit
    bands = ("radius (mm)", "mean (± µm)", "single run (± µm)")
    heads = ("Load (N)", *(f"{wheel} wheel | {head}" for wheel in ("Left", "Right") for head in bands))
    title = "The law at the least and largest load and at round ones between, with the half widths of both bands."
    shown = table(title, heads, aligned(_band_rows(fit.left, fit.right), 2, 3, 5, 6))
    quality = Text(" ".join(map(results.quality_text, fit.wheels.values())))
    return Section("Regression on load", (Text(paragraph("bands")), results.regressions_picture(fit), shown, quality))


def _band_rows(left: WheelFit, right: WheelFit) -> tuple[tuple[str, ...], ...]:
    lows, highs = zip(*((wheel.law.load_min_N, wheel.law.load_max_N) for wheel in (left, right)), strict=True)
    low, high = (max(lows), min(highs)) if max(lows) < min(highs) else (min(lows), max(highs))
    loads = np.unique(np.rint([low, *round_loads(low, high), high]))
    columns = [[fixed(float(load), 0) for load in loads]]
    for wheel in (left, right):
        mean, single = (1e6 * wheel.law.half_width_m(loads, single_run=one) for one in (False, True))
        decimals = places(1e-3 * float(mean.min()))
        columns.append([fixed(1e3 * float(radius), decimals) for radius in wheel.law.radius_m(loads)])
        columns += [[two_digits(float(width)) for width in widths] for widths in (mean, single)]
    return tuple(zip(*columns, strict=True))


def coefficients_section(source: Source) -> Section:
    """Return the coefficients with uncertainties, and how to get a radius at a load."""
    fit = source.fit
    rows = []
    for wheel in fit.wheels.values():
        for number, (title, unit, value, std, dof) in enumerate(results.coefficients_in_units(wheel)):
            k = float(t_quantile(dof))
            numbers = (*measured(value, std), fixed(dof, 1), fixed(k, 2), two_digits(k * std))
            rows.append(("" if number else wheel.wheel, title, unit, *numbers))
    heads = ("<Wheel", "<Quantity", "<Unit", "Value", "u", "ν", "k", "U")
    content: list[reporting.Block] = [table(caption("table-coefficients"), heads, aligned(rows, 3, 4, 7))]
    if any(wheel.model == "line" for wheel in fit.wheels.values()):
        text = "The standard uncertainty of the radius at a load F follows from both and their covariance,"
        content += [Text(text), Equation("law_uncertainty")]
    ends = "clamps loads outside the valid range to its ends"
    outside = "refuses loads outside the valid range" if source.coefficients.outside == "refuse" else ends
    wheels = {side: getattr(source.coefficients.law, side) for side in SIDES}
    valid = [f"{span(one.load_min_N, one.load_max_N, 'N', '.1f')} ({side})" for side, one in wheels.items()]
    known = {"checksum": source.coefficients.checksum[:19], "valid": " and ".join(valid), "outside": outside}
    correlations = Text(" ".join(map(_correlation, fit.wheels.values())))
    return Section("Coefficients", (*content, correlations, Text(paragraph("attached", **known))))


def _correlation(wheel: WheelFit) -> str:
    law, covariance = wheel.law, wheel.law.covariance
    valid = span(law.load_min_N, law.load_max_N, "N", ".1f")
    if wheel.model != "line":
        return f"{wheel.wheel.capitalize()} wheel: constant, measured at {valid}."
    norm = float(np.sqrt(covariance[0, 0] * covariance[1, 1]))
    correlation = fixed(float(covariance[0, 1]) / norm if norm > 0 else 0.0, 2)
    return f"{wheel.wheel.capitalize()} wheel: correlation of radius and slope {correlation}, measured at {valid}."


def _law_budget(fit: Fit) -> Table:
    systematic = any(len(wheel.estimate.systematic) for wheel in fit.wheels.values())
    rows = []
    for name, wheel in fit.wheels.items():
        parts = [wheel.estimate.cov_within, wheel.estimate.cov_between]
        parts += [wheel.estimate.cov_systematic] if systematic else []
        std = np.sqrt(np.maximum([np.diag(part) for part in (*parts, wheel.estimate.covariance)], 0.0))
        rows.append((name, "radius at F₀", "µm", *(two_digits(1e6 * float(value)) for value in std[:, 0])))
        if wheel.model == "line":
            rows.append(("", "slope", "nm/N", *(two_digits(1e9 * float(value)) for value in std[:, 1])))
    heads = ["<Wheel", "<Coefficient", "<Unit", "u from the scatter | of runs", "u from the scatter | of sessions"]
    heads += ["Systematic", "Combined"] if systematic else ["Combined"]
    remark = " Systematic parts do not become smaller with more runs." if systematic else ""
    return table(caption("table-law-budget", systematic=remark), heads, aligned(rows, *range(3, len(heads))))


def _scatter(fit: Fit) -> tuple[Text, ...]:
    known = [float(np.sqrt(np.mean(std**2))) for std in (fit.radii.std_left_m, fit.radii.std_right_m)]
    scatter = [wheel.run_std_m for wheel in fit.wheels.values()]
    if not all(spread > 2 * two for spread, two in zip(scatter, known, strict=True)):
        return ()
    return (Text(paragraph("scatter", left=scatter[0] / known[0], right=scatter[1] / known[1])),)


def budget_section(source: Source) -> Section:
    """Return what the uncertainty is made of."""
    fit = source.fit
    declared = Text(paragraph("declared" if any(": " in part.name for part in fit.radii.budget) else "undeclared"))
    blocks = (results.radius_budget(fit), results.budget_picture(fit), _law_budget(fit), declared, *_scatter(fit))
    return Section("Uncertainty budget", blocks)


def _sessions_table(fit: Fit) -> Table:
    heads = ("^Loads | {} (N)", "Mean residual | {} (µm)", "Scatter | {} (µm)")
    rows = []
    for name, part in fit.table.groupby("session", sort=False):
        loads = (f"{part[load].min():.0f}–{part[load].max():.0f}" for load in WHEEL_LOADS)
        left = part[["residual_left_m", "residual_right_m"]]
        sizes = (fixed(1e6 * size, 1) for size in (*left.mean(), *left.std()))
        rows.append((str(name), str(len(part)), *loads, *sizes))
    first = f", the first {results.MOST_ROWS} of {len(rows)}" if len(rows) > results.MOST_ROWS else ""
    columns = ("<Session", "Runs", *(head.format(wheel) for head in heads for wheel in SIDES))
    title = caption("table-sessions", runs=len(fit.radii), first=first)
    return table(title, columns, rows[: results.MOST_ROWS], dense=True)


def runs_section(source: Source) -> Section:
    """Return the runs used, and not used with the reason."""
    fit, radii = source.fit, source.fit.radii
    sessions = plural(len(set(radii.session.tolist())), "session")
    content = (
        Text(f"{plural(len(radii), 'run')} in {sessions} entered the fit."),
        results.runs_picture(fit),
        results.runs_table(fit) if len(radii) <= results.MOST_ROWS else _sessions_table(fit),
        results.left_out_table(fit) if radii.left_out else Text("All runs were used.", small=True),
    )
    return Section("Runs", (*content, *([results.static_table(fit)] if fit.static else [])))


#: relative error of a radius that the runs are compared with
TOLERANCE: Final = 5e-4


def deviation_section(source: Source) -> Section:
    """Return how much longer the wheels' paths were than measured, and what was corrected."""
    radii = source.fit.radii
    known = np.isfinite(radii.amplitude_m) & np.isfinite(radii.wavelength_m)
    paths = np.array((radii.path_left, radii.path_right))
    rows = []
    for name in dict.fromkeys(radii.path_source.tolist()):
        on = radii.path_source == name
        weave = (1e3 * _median(radii.amplitude_m[on & known]), _median(radii.wavelength_m[on & known]))
        corrected = 1e6 * np.sqrt(np.mean(paths[:, on] ** 2, axis=1))
        sizes = (*(fixed(size, 1) for size in weave), *(fixed(float(value), 0) for value in corrected))
        rows.append((catalogue()["path"].get(name, name), str(int(on.sum())), *sizes))
    heads = ("*Correction from", "Runs", "Amplitude (mm)", "Wavelength (m)", "Left (ppm)", "Right (ppm)")
    corrected = {"corrected": int((radii.path_source != "none").sum()), "runs": len(radii)}
    text = Text(paragraph("paths", **corrected, worst=1e6 * float(np.abs(paths).max())))
    shown = table(caption("table-corrections"), heads, rows)
    content: list[Block] = [text, results.deviation_picture(source.fit), shown]
    if known.any():
        off = int((np.abs(radius_error(paths)).max(axis=0) > TOLERANCE).sum())
        wavelength = _median(radii.wavelength_m[known])
        values = {
            "off": plural(off, "run") if off else "no run",
            "tolerance": 1e6 * TOLERANCE,
            "wavelength": wavelength,
            "allowed": 1e3 * float(allowed_amplitude_m(TOLERANCE, wavelength)),
        }
        content.append(Text(paragraph("uncorrected", **values)))
    return Section("Path deviation", tuple(content))


def _median(values: FloatArray) -> float:
    return float(np.median(values)) if len(values) else float("nan")
