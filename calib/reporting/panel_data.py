"""The table behind the linked panels of a diagnosis: a row an observation, its paths, its gap, its colours."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from itertools import pairwise
from typing import Final

import numpy as np

from calib.campaign.model import Campaign
from calib.gap.decision.diagnosis import Diagnosis
from calib.gap.localise.along_run import traces_of
from calib.gap.observations.arrays import Observations
from calib.gap.predict import Path
from calib.reporting.figures.gap import GapArrays, rms
from calib.reporting.formatting import with_unit
from calib.types import FloatArray, evenly

#: points of all drawn paths together, of one path at most, and of a gap along a run: more make the page heavy
ALL_POINTS: Final = 12_000
PATH_POINTS: Final = 60
TRACE_POINTS: Final = 120
#: gap along a run -> its column in the arrays of `gap_along_runs`
ALONG: Final = {"along (mm)": 1, "heading (mrad)": 2}
#: what the gap along a run is drawn against -> its column there
RUN_AXES: Final = {"travelled distance (m)": 0, "time (s)": 3}
#: labels that panels are coloured by and runs are chosen by
LABELS: Final = ("kind", "session", "run")
#: paths of a run: by the model alone, with the causes that the fix corrects, measured
PATHS: Final = ("before", "after", "reference")


def run_paths(diagnosis: Diagnosis, campaign: Campaign) -> dict[str, list[FloatArray]]:
    """Return the paths of the observations by `PATHS`, thinned.

    Each is in its own start frame: time since its start, x, y, shape (n_samples, 3); without samples where no
    trajectory was logged.
    """
    observations = diagnosis.observations
    limit = int(np.clip(ALL_POINTS // max(len(observations), 1), 8, PATH_POINTS))
    return {
        "before": _predicted(diagnosis.nominal, limit),
        "after": _predicted(diagnosis.correction.path, limit),
        "reference": _measured(observations, campaign.included(), limit),
    }


def _predicted(path: Path, limit: int) -> list[FloatArray]:
    s = path.s
    end_s = s.time_s - _start_s(s)[s.unit]
    middle_s = end_s - 0.5 * s.duration_s
    paths = []
    for trace, (first, last) in zip(path.traces(), pairwise(s.starts), strict=True):
        times = np.concatenate(([0.0], middle_s[first:last], end_s[last - 1 : last]))
        paths.append(np.column_stack((times, trace[:, :2]))[evenly(len(trace), limit)])
    return paths


def _start_s(s: Observations) -> FloatArray:
    """Return when each observation starts, since the start of its run, shape (n_obs,)."""
    return np.asarray((s.time_s - s.duration_s)[s.starts[:-1]])


def _measured(s: Observations, campaign: Campaign, limit: int) -> list[FloatArray]:
    sensor = campaign.reference
    lever_m = complex(sensor.sensor_x_m, sensor.sensor_y_m)
    paths = []
    for unit, (run, start_s, last) in enumerate(zip(s.run.tolist(), _start_s(s), s.starts[1:], strict=True)):
        log = campaign.logs.of(run)
        t_s, place_m, heading = np.zeros(0), np.zeros(0, complex), np.zeros(0)
        if {"t_s", "ref_x_m", "ref_y_m", "ref_theta_rad"} <= log.keys() and s.from_log[unit]:
            t_s = log["t_s"] - log["t_s"][0] - start_s
            heading = log["ref_theta_rad"] - sensor.sensor_yaw_rad
            place_m = log["ref_x_m"] + 1j * log["ref_y_m"] - lever_m * np.exp(1j * heading)
        seen = np.isfinite(place_m) & (t_s >= -1e-9) & (t_s <= s.time_s[last - 1] - start_s + 1e-9)
        if seen.sum() < 2:
            paths.append(np.zeros((0, 3)))
            continue
        place_m = (place_m[seen] - place_m[seen][0]) * np.exp(-1j * heading[seen][0])
        path = np.column_stack((t_s[seen], place_m.real, place_m.imag))
        paths.append(path[evenly(len(path), limit)])
    return paths


def gap_along_runs(observations: Observations, campaign: Campaign) -> list[FloatArray]:
    """Return distance (m), gap along (m) and in heading (rad), and time (s) of each observation, shape (n_samples, 4).

    Empty for observations without a continuous reference or range; NaN where not measured.
    """
    along: list[FloatArray] = [np.zeros((0, 4))] * len(observations)
    first = {str(name): k for k, name in reversed(list(enumerate(observations.labels["run_id"])))}
    for trace in traces_of(campaign, observations):
        columns = np.stack((trace.way_m, trace.along_m, trace.heading_rad, trace.time_s), axis=1)
        along[first[trace.run_id]] = columns[:: max(1, len(trace.way_m) // TRACE_POINTS)]
    return along


def panel_columns(
    gap: GapArrays, along: list[FloatArray], paths: Mapping[str, list[FloatArray]], palette: tuple[str, ...]
) -> dict[str, object]:
    """Return the columns of all panels, a row an observation: a selection in one panel is a selection in all."""
    names = natural(gap.labels["kind"])
    columns: dict[str, object] = {label: gap.labels["run_id" if label == "run" else label] for label in LABELS}
    columns["colour"] = [palette[names.index(str(name)) % len(palette)] for name in gap.labels["kind"]]
    columns["by order driven"] = np.arange(1.0, len(gap.before) + 1)
    columns |= {f"by {name}": values for name, values in gap.covariates.items()}
    for channel, (name, _) in enumerate(gap.channels):
        columns[f"before {name}"] = 1e3 * gap.before[:, channel]
        columns[f"after {name}"] = 1e3 * gap.after[:, channel]
    first = first_channel(gap)
    columns["x"] = columns["by order driven"]
    columns["y"] = columns["b"] = columns[f"before {first}"]
    columns["a"] = columns[f"after {first}"]
    if gap.offset_m is not None:
        for place, axis in enumerate("txy"):
            for which, drawn in paths.items():
                columns[f"{which}_{axis}"] = [path[:, place].astype(np.float32) for path in drawn]
                if place:
                    columns[f"now_{which}_{axis}"] = [path[-1, place] if len(path) else np.nan for path in drawn]
            if place:
                columns[f"end_{axis}"] = np.array([path[-1, place] for path in paths["before"]])
                columns[f"off_{axis}"] = gap.offset_m[:, place - 1]
    if any(len(path) for path in along):
        for name, place in RUN_AXES.items():
            columns[f"way {name}"] = [np.round(path[:, place], 4) for path in along]
        columns["way"] = columns[f"way {next(iter(RUN_AXES))}"]
        columns |= {f"gap {name}": [1e3 * path[:, place] for path in along] for name, place in ALONG.items()}
    return columns


def first_channel(gap: GapArrays) -> str:
    """Return the channel whose gap is largest against its noise level."""
    ratios = [rms(column) for column in (gap.before / np.where(gap.noise_level > 0, gap.noise_level, np.nan)).T]
    return gap.channels[int(np.nanargmax(ratios)) if np.isfinite(ratios).any() else 0][0]


def channel_units(gap: GapArrays) -> dict[str, str]:
    """Return the unit that each measured channel is drawn in, by its name."""
    measured = np.asarray(np.isfinite(gap.before).any(axis=0))
    return {name: f"m{unit}" for (name, unit), on in zip(gap.channels, measured, strict=True) if on}


def noise_limits(gap: GapArrays) -> dict[str, float]:
    """Return two standard deviations of the noise of each measured channel, in mm or mrad, by its name."""
    limits = {name: 2e3 * rms(column) for (name, _), column in zip(gap.channels, gap.noise_level.T, strict=True)}
    return {name: float(np.nan_to_num(limits[name])) for name in channel_units(gap)}


def covariate_titles(gap: GapArrays) -> dict[str, str]:
    """Return what the gap can be drawn against and coloured by: its name in the table -> with its unit."""
    return {"order driven": "order driven"} | {name: with_unit(name) for name in gap.covariates}


def natural(names: Iterable[object]) -> list[str]:
    """Return distinct names sorted as people count: r2 before r10."""

    def key(name: str) -> list[tuple[bool, int, str]]:
        parts = re.split(r"([0-9]+)", name)
        return [(number, int(part) if number else 0, part) for k, part in enumerate(parts) for number in [k % 2 == 1]]

    return sorted({str(name) for name in names}, key=key)


def labels_of(gap: GapArrays) -> Mapping[str, list[str]]:
    """Return the distinct kinds, sessions and runs, sorted."""
    return {label: natural(gap.labels["run_id" if label == "run" else label]) for label in LABELS}
