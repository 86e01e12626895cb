"""Runs of a fit: figure by session, table of runs or of sessions, runs not used, and how far their paths deviate."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from calib.campaign.checks.design import listed
from calib.radius.deviation import allowed_amplitude_m, radius_error
from calib.radius.result import Fit
from calib.reporting.blocks import Block, Picture, Section, Table, Text, picture, table
from calib.reporting.formatting import fixed, plural
from calib.reporting.topics.law import static_table
from calib.types import FloatArray

if TYPE_CHECKING:
    from calib.campaign.settings import Encoder
    from calib.reporting.source import Source

#: beyond this many runs the report's table is one of sessions
MOST_ROWS: Final = 200
#: runs named for one reason
MOST_NAMED: Final = 12


def left_out_table(fit: Fit) -> Table:
    """Return one row a reason, since a campaign of many routes has hundreds of runs that are not used.

    A dozen of them are named; the fit's JSON names them all.
    """
    by_reason: dict[str, list[str]] = {}
    for run in fit.radii.left_out:
        by_reason.setdefault(run.reason, []).append(run.run_id)
    rows = [(reason, str(len(names)), listed(names, MOST_NAMED)) for reason, names in by_reason.items()]
    return table("Runs that were not used.", ("*Reason", "Number", "*Runs"), rows[:MOST_ROWS], dense=True)


def runs_table(fit: Fit) -> Table:
    """Return every run: counts, distance, loads, radii, and residuals from the law."""
    radii = fit.radii
    # head -> values, factor of its unit, decimals
    numbers: dict[str, tuple[FloatArray, float, int]] = {"~Distance (m)": (radii.distance_m, 1.0, 4)}
    if fit.setup is not None:
        numbers |= {f"~Counts | {side}": (counts, 1.0, 0) for side, counts in _counts(fit, fit.setup.encoder).items()}
    for head, factor, decimals, left, right in (
        ("Load | {} (N)", 1.0, 1, radii.load_left_N, radii.load_right_N),
        ("Radius | {} (mm)", 1e3, 4, radii.radius_left_m, radii.radius_right_m),
        ("~Path | {} (ppm)", 1e6, 0, radii.path_left, radii.path_right),
        ("Residual | {} (µm)", 1e6, 1, fit.left.residual_m, fit.right.residual_m),
    ):
        numbers[head.format("left")] = (left, factor, decimals)
        numbers[head.format("right")] = (right, factor, decimals)
    labels = [array.astype(str).tolist() for array in (radii.run_id, radii.session, radii.direction)]
    cells = [[fixed(factor * value, places) for value in array.tolist()] for array, factor, places in numbers.values()]
    return table(
        "Runs: distance by the rangefinder, encoder counts, wheel loads, effective radii with the path correction "
        "contained in them, and residuals from the law.",
        ("<Run", "<Session", "<Dir.", *numbers),
        zip(*labels, *cells, strict=True),
        dense=True,
    )


def _counts(fit: Fit, encoder: Encoder) -> dict[str, FloatArray]:
    """Return the counts of either wheel, from the radii: r = S (1 + e) / (2 pi n)."""
    radii = fit.radii
    wheels = {
        "left": (radii.path_left, radii.radius_left_m, encoder.counts_per_rev_left),
        "right": (radii.path_right, radii.radius_right_m, encoder.counts_per_rev_right),
    }
    return {
        side: radii.distance_m * (1 + path) / (2 * np.pi * radius) * per_rev
        for side, (path, radius, per_rev) in wheels.items()
    }


def sessions_table(fit: Fit) -> Table:
    """Return one row a session, for campaigns of many runs."""
    radii = fit.radii
    heads = ("^Loads | {} (N)", "Mean residual | {} (µm)", "Scatter | {} (µm)")
    rows = []
    for name in dict.fromkeys(radii.session.tolist()):
        on = radii.session == name
        pieces = [fit.left.residual_m[on], fit.right.residual_m[on]]
        scatter = [float(np.std(part, ddof=1)) if len(part) > 1 else float("nan") for part in pieces]
        rows.append(
            (
                str(name),
                str(int(on.sum())),
                *(f"{part[on].min():.0f}–{part[on].max():.0f}" for part in (radii.load_left_N, radii.load_right_N)),
                *(fixed(1e6 * float(part.mean()), 1) for part in pieces),
                *(fixed(1e6 * part, 1) for part in scatter),
            )
        )
    first = f", the first {MOST_ROWS} of {len(rows)}" if len(rows) > MOST_ROWS else ""
    return table(
        f"Sessions of the {len(radii)} runs{first}; scatter is one standard deviation (k = 1). Every run is in "
        "runs.csv of the result folder.",
        ("<Session", "Runs", *(head.format(wheel) for head in heads for wheel in ("left", "right"))),
        rows[:MOST_ROWS],
        dense=True,
    )


def runs_section(source: Source) -> Section:
    """Return the runs used, and those not used with the reason."""
    fit, radii = source.fit, source.fit.radii
    sessions = plural(len(set(radii.session.tolist())), "session")
    blocks = (
        Text(f"{plural(len(radii), 'run')} in {sessions} entered the fit."),
        runs_picture(fit),
        runs_table(fit) if len(radii) <= MOST_ROWS else sessions_table(fit),
        left_out_table(fit) if radii.left_out else Text("All runs were used.", small=True),
    )
    return Section("Runs", (*blocks, *([static_table(fit)] if fit.static else [])))


def runs_picture(fit: Fit) -> Picture:
    """Return the radius of every run in the order driven."""
    parts = []
    for name, wheel in fit.wheels.items():
        low, high = 1e3 * float(wheel.radius_m.min()), 1e3 * float(wheel.radius_m.max())
        parts.append(f"{name} wheel {low:.3f} to {high:.3f} mm")
    return picture(
        "runs-by-series",
        "Effective radius of each run in the order driven, coloured by wheel load, or by session where all loads are "
        "alike. Bars, where larger than the mark, are two standard uncertainties of the instruments.",
        f"Radius by run for both wheels, {len(fit.radii)} runs: " + "; ".join(parts),
        "radius.runs_by_series",
        fit.radii,
    )


#: relative error of a radius that the runs are compared with
TOLERANCE: Final = 5e-4
_SOURCES: Final = {
    "log": "weave in the log",
    "log+heading": "weave in the log and measured heading at the end",
    "columns": "measured amplitude and wavelength",
    "columns+heading": "measured amplitude and wavelength, and heading at the end",
    "none+heading": "measured heading at the end",
    "none": "not corrected",
}


def deviation_section(source: Source) -> Section:
    """Return how much longer than the measured distance the wheels' paths were, and what was corrected."""
    radii = source.fit.radii
    known = np.isfinite(radii.amplitude_m) & np.isfinite(radii.wavelength_m)
    paths = np.array((radii.path_left, radii.path_right))
    worst = 1e6 * float(np.abs(paths).max())
    blocks: list[Block] = [
        Text(
            "The rangefinder sees the straight distance, the wheels roll along the path. A weave of amplitude A and "
            "wavelength λ makes the path longer by about (πA/λ)², a turn makes one wheel's path longer and the other's "
            f"shorter. The radii of this report are corrected for it; the largest correction of a run is {worst:.0f} "
            "ppm."
        ),
        deviation_picture(source.fit),
    ]
    rows = []
    for name in dict.fromkeys(radii.path_source.tolist()):
        on = radii.path_source == name
        corrections = 1e6 * np.sqrt(np.mean(paths[:, on] ** 2, axis=1))
        rows.append(
            (
                _SOURCES.get(name, name),
                str(int(on.sum())),
                fixed(1e3 * _median(radii.amplitude_m[on & known]), 1),
                fixed(_median(radii.wavelength_m[on & known]), 1),
                *(fixed(float(value), 0) for value in corrections),
            )
        )
    blocks.append(
        table(
            "Where the corrections come from; medians of amplitude and wavelength, root mean square corrections.",
            ("*Correction from", "Runs", "Amplitude (mm)", "Wavelength (m)", "Left (ppm)", "Right (ppm)"),
            rows,
        )
    )
    if known.any():
        off = int((np.abs(radius_error(paths)).max(axis=0) > TOLERANCE).sum())
        wavelength = _median(radii.wavelength_m[known])
        allowed = 1e3 * float(allowed_amplitude_m(TOLERANCE, wavelength))
        blocks.append(
            Text(
                f"Without the correction, {plural(off, 'run') if off else 'no run'} would show a radius more than "
                f"{1e6 * TOLERANCE:.0f} ppm off. A weave of the median wavelength of {wavelength:.1f} m stays within "
                f"that up to an amplitude of {allowed:.0f} mm."
            )
        )
    return Section("Path deviation", tuple(blocks))


def _median(values: FloatArray) -> float:
    return float(np.median(values)) if len(values) else float("nan")


def deviation_picture(fit: Fit) -> Picture:
    """Return what weaving and turning added to the paths."""
    radii = fit.radii
    known = np.isfinite(radii.amplitude_m) & np.isfinite(radii.wavelength_m)
    worst = 1e6 * float(np.abs((radii.path_left, radii.path_right)).max())
    return picture(
        "path-deviation",
        "Left: excess of a weaving path over the straight distance, by amplitude and wavelength over whole periods, "
        "and the runs of this campaign. Right: correction of each run's radius for weave and turn.",
        f"Excess of the path by amplitude for five wavelengths with {int(known.sum())} runs; corrections of all runs "
        f"up to {worst:.0f} ppm",
        "radius.path_deviation",
        radii,
    )
