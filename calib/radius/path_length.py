"""How much longer than S_O each wheel's path was, run by run, and how sure that is (Fig. 8)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.arrays import BoolArray, FloatArray, StrArray
from calib.campaign.model import Campaign
from calib.radius.deviation import arc_excess, whole_period_excess
from calib.radius.weave import Weaves, estimate_weaves

#: a heading reference is used where it tells more than its own noise
LEAST_RELIABILITY: Final = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class RunPaths:
    """Path of each run; arrays of shape (n_runs,)."""

    #: relative excess over S_O of the middle of the rear axle and of both wheels; 0 where nothing is known
    centre: FloatArray
    left: FloatArray
    right: FloatArray
    #: heading at the end minus heading at the start, and its standard uncertainty; 0 where nothing is known
    yaw_rad: FloatArray
    yaw_std_rad: FloatArray
    #: standard uncertainty of `centre`
    centre_std: FloatArray
    #: of the weave, NaN where unknown; the phase is known from logs only
    amplitude_m: FloatArray
    wavelength_m: FloatArray
    phase_rad: FloatArray
    #: ``log``, ``columns`` or ``none``, with ``+heading`` where the measured heading was used
    source: StrArray
    #: what was done, in sentences
    notes: tuple[str, ...]


def correct_paths(campaign: Campaign) -> RunPaths:
    """Return each run's path from its log, else from its measured weave, and from its measured final heading.

    Arrays over all runs of `campaign`.
    """
    runs, track = campaign.runs, campaign.vehicle.track_m
    n = len(runs)
    distance = np.abs(runs.number("distance_m"))
    weaves = _from_logs(campaign)
    logged = weaves.found
    amplitude, wavelength = np.abs(runs.number("amplitude_m")), np.abs(runs.number("wavelength_m"))
    listed = ~logged & np.isfinite(amplitude) & (wavelength > 0)

    centre, centre_std = np.zeros(n), np.zeros(n)
    yaw, yaw_std = np.zeros(n), np.zeros(n)
    centre[logged], yaw[logged] = weaves.excess[logged], weaves.yaw_rad[logged]
    yaw_std[logged] = weaves.yaw_std_rad[logged]
    centre_std[logged] = 0.5 * weaves.rest_rad[logged] ** 2
    if listed.any():
        slope = 2 * np.pi * amplitude[listed] / wavelength[listed]
        turns = 2 * np.pi * distance[listed] / wavelength[listed]
        centre[listed] = whole_period_excess(amplitude[listed], wavelength[listed])
        # nobody wrote down where in the period a run began and ended: phases equally likely
        yaw_std[listed] = slope * np.sqrt(np.maximum(1 - np.cos(turns), 0.0))
        centre_std[listed] = slope**2 * np.abs(np.sin(turns)) / (4 * np.sqrt(2) * turns)

    heading = runs.number("ref_theta_rad")
    measured = np.isfinite(heading)
    used = np.zeros(n, dtype=np.bool_)
    if measured.any():
        noise = campaign.reference.sigma_theta_rad
        known = yaw_std**2
        surplus = np.where(measured, heading - yaw, 0.0)
        # what the measured headings scatter beyond their own noise and what the logs leave open: real arcs
        expected = float(np.mean((noise**2 + known)[measured]))
        observed = float(np.mean((surplus**2)[measured]))
        arcs = observed - expected if observed > expected * (1 + 3 * np.sqrt(2 / measured.sum())) else 0.0
        open_rad2 = arcs + known
        reliability = np.where(measured & (open_rad2 > 0), open_rad2 / np.maximum(open_rad2 + noise**2, 1e-300), 0.0)
        used = reliability > LEAST_RELIABILITY
        arc = np.where(used, reliability * surplus, 0.0)
        centre = (1 + centre) * (1 + arc_excess(arc, 1.0, 0.0).centre) - 1
        yaw = yaw + arc
        yaw_std = np.where(used, noise * np.sqrt(reliability), yaw_std)
    half = 0.5 * track * yaw / np.where(distance > 0, distance, np.nan)
    source = np.where(logged, "log", np.where(listed, "columns", "none")).astype("<U16")
    source = np.where(used, np.char.add(source, "+heading"), source)
    return RunPaths(
        centre=centre,
        left=centre - half,
        right=centre + half,
        yaw_rad=yaw,
        yaw_std_rad=yaw_std,
        centre_std=centre_std,
        amplitude_m=np.where(logged, weaves.amplitude_m, amplitude),
        wavelength_m=np.where(logged, weaves.wavelength_m, wavelength),
        phase_rad=weaves.phase_rad,
        source=source,
        notes=_notes(logged, listed, used),
    )


def _from_logs(campaign: Campaign) -> Weaves:
    encoder, model = campaign.encoder, campaign.model
    metres = (
        2 * np.pi * model.radius_left_m / encoder.counts_per_rev_left,
        2 * np.pi * model.radius_right_m / encoder.counts_per_rev_right,
    )
    return estimate_weaves(campaign.logs, metres, campaign.vehicle.track_m)


def _notes(logged: BoolArray, listed: BoolArray, used: BoolArray) -> tuple[str, ...]:
    n, nothing = len(logged), ~(logged | listed | used)
    notes = []
    if logged.any():
        notes.append(f"Path of {int(logged.sum())} of {n} runs corrected for the weave in their logs.")
    if listed.any():
        notes.append(
            f"Path of {int(listed.sum())} of {n} runs corrected by amplitude_m and wavelength_m over whole periods; "
            "where in the period they began and ended is not known and counts as uncertainty."
        )
    if used.any():
        notes.append(f"Turn of {int(used.sum())} of {n} runs corrected by the measured heading at their end.")
    if nothing.any():
        notes.append(
            f"Path of {int(nothing.sum())} of {n} runs not corrected: no log, no weave columns, no measured heading. "
            "Weave makes such radii too small and its turn scatters them; add logs, or keep the vehicle on the line."
        )
    return tuple(notes)
