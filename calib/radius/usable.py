"""Which runs an effective radius can be computed from, and why the others are left out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from calib.arrays import FloatArray
from calib.campaign.model import Campaign
from calib.campaign.wheels import odometry_source, without_rear_wheels
from calib.errors import RefusedError

#: apparent turn beyond which a run was not straight; radii 1.5 % apart show 0.9 rad over 42 m on a track of 0.7 m
STRAIGHT_TURN_RAD: Final = 1.2
STRAIGHT_HEADING_RAD: Final = 0.5
SHORTEST_M: Final = 1.0


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A run that the fit does not use, and why."""

    run_id: str
    reason: str


def usable_runs(campaign: Campaign, *, need_load: bool = True) -> tuple[Campaign, tuple[LeftOut, ...], list[str]]:
    """Return the runs whose radii can be computed.

    `need_load`: leave out runs without a wheel load; where no run has one, all count as unladen. Returns `campaign`: of
    the runs that can be used; `left_out`: the others; `notes`: what was assumed. Raises RefusedError where no run can
    be used.
    """
    _refuse_without_rear_wheels(campaign)
    runs, notes = campaign.runs, []
    loads = {side: runs.number(f"load_{side}_N") for side in ("left", "right")}
    if need_load and not any(np.isfinite(load).any() for load in loads.values()):
        unladen = campaign.vehicle.unladen_load_N
        notes.append(
            f"No run has wheel loads or a payload: all are taken as unladen ({unladen:.0f} N a wheel), so the radius "
            "holds for that load only; add payload_kg, or load_left_N and load_right_N, to runs.csv."
        )
        loads = {side: np.full(len(runs), unladen) for side in loads}
    turn = _apparent_turn_rad(campaign)
    # a wrong counts_per_rev turns every run alike: that is for the user to see, not a reason to drop them all
    usual = np.nanmedian(turn) if np.isfinite(turn).any() else 0.0
    kind = np.char.lower(runs.label("kind"))
    straight = np.char.startswith(kind, "corridor") | np.char.startswith(kind, "straight")
    if not straight.any():
        straight = np.ones(len(runs), dtype=np.bool_)
    counts = {side: runs.number(f"counts_{side}") for side in loads}
    distance = runs.number("distance_m")
    # the first reason that applies is the one that is told
    reasons = (
        (runs.excluded, "flagged as excluded in runs.csv"),
        (~straight, "not a corridor run by its kind"),
        (~np.isfinite(distance), "has no distance_m"),
        (np.abs(distance) < SHORTEST_M, f"is shorter than {SHORTEST_M} m"),
        (~(np.isfinite(counts["left"]) & np.isfinite(counts["right"])), "has no counts"),
        ((counts["left"] == 0) | (counts["right"] == 0), "has a wheel without a single count"),
        (
            counts["left"] * counts["right"] < 0,
            "has counts of opposite sign: one encoder runs backwards, or the vehicle turned on the spot",
        ),
        (
            need_load & ~(np.isfinite(loads["left"]) & np.isfinite(loads["right"])),
            "has no wheel load and no payload",
        ),
        (
            ((np.abs(turn) > STRAIGHT_TURN_RAD) & (np.abs(turn - usual) > STRAIGHT_TURN_RAD))
            | (np.abs(runs.number("ref_theta_rad")) > STRAIGHT_HEADING_RAD),
            "is not a straight run: its heading changed too much",
        ),
    )
    hits = np.stack([hit for hit, _ in reasons])
    keep = ~hits.any(axis=0)
    first_reason = hits.argmax(axis=0)
    left_out = tuple(LeftOut(str(runs.run_id[run]), reasons[first_reason[run]][1]) for run in np.flatnonzero(~keep))
    if not keep.any():
        first = left_out[0] if left_out else LeftOut("(none)", "the run table is empty")
        raise RefusedError(
            f"{campaign.root or campaign.name}: found no run that can be used; expected straight runs with a distance, "
            f"counts and a load; run {first.run_id} {first.reason}"
        )
    numbers = {**runs.numbers, **{f"load_{side}_N": load for side, load in loads.items()}}
    return replace(campaign, runs=replace(runs, numbers=numbers)).select(keep), left_out, notes


def _refuse_without_rear_wheels(campaign: Campaign) -> None:
    """Refuse odometry from a front wheel or from four wheels; say what a law of the load needs."""
    if not without_rear_wheels(campaign):
        return
    wheels = "the front wheel" if odometry_source(campaign) == "front" else "four wheels"
    raise RefusedError(
        f"{campaign.root or campaign.name}: found odometry from {wheels} alone; expected counts_left and counts_right "
        "of two wheels on one axle, with distance_m and wheel loads; log them for a law of the load, or run "
        "'calib geometry' for the radius and the lengths of this vehicle"
    )


def _apparent_turn_rad(campaign: Campaign) -> FloatArray:
    """Return the turn that the counts would mean if the model's radii were right, shape (n_runs,)."""
    runs, model = campaign.runs, campaign.model
    left = runs.number("counts_left") / campaign.encoder.counts_per_rev_left * model.radius_left_m
    right = runs.number("counts_right") / campaign.encoder.counts_per_rev_right * model.radius_right_m
    return np.asarray(2 * np.pi * (right - left) / campaign.vehicle.track_m)
