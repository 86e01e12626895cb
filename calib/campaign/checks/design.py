"""The design of the campaign: what these runs can tell apart at all."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calib.campaign.checks.common import SIDES, load_label
from calib.campaign.model import Campaign, Note


def load_and_session(campaign: Campaign) -> Iterator[Note]:
    """Say where every session has one load, or loads were driven in one rising or falling order."""
    included = campaign.included()
    label, session = load_label(included), included.runs.label("session")
    loads, sessions = np.unique(label), np.unique(session)
    if len(loads) < 2:
        return
    if len(sessions) >= 2:
        if all(len(np.unique(label[session == name])) == 1 for name in sessions):
            text = (
                f"each of the {len(sessions)} sessions has one load only, so that a drift between "
                "sessions and the effect "
                "of the load cannot be told apart; drive at least two loads in each session"
            )
            yield Note("suspicious", "runs, columns session and load", text, "confounded_load")
        return
    total = included.runs.number("load_left_N") + included.runs.number("load_right_N")
    changes = int((label[1:] != label[:-1]).sum())
    steps = np.diff(total)
    if changes == len(loads) - 1 and len(loads) >= 3 and ((steps >= 0).all() or (steps <= 0).all()):
        text = (
            "the loads were driven in one rising or falling order, so that warming up and the effect of "
            "the load cannot "
            "be told apart; drive some loads again at the end, or in mixed order"
        )
        yield Note("suspicious", "runs, order and load", text, "ordered_load")


def few_loads(campaign: Campaign) -> Iterator[Note]:
    """Say where the loads are too few for a slope, or for a look at its curvature."""
    included = campaign.included()
    for side in SIDES:
        load = included.runs.number(f"load_{side}_N")
        load = np.unique(np.round(load[np.isfinite(load)] / 5.0))
        if len(load) == 1:
            text = "one load only: a radius can be had, its change with load cannot"
        elif len(load) == 2:
            text = "two loads only: a slope can be had, whether the law is straight cannot"
        else:
            continue
        yield Note("suspicious", f"runs, column load_{side}_N", f"{text}; drive three loads or more", "few_loads")


def model_against_vehicle(campaign: Campaign) -> Iterator[Note]:
    """Compare what the simulator believes with the nominal vehicle."""
    model, vehicle = campaign.model, campaign.vehicle
    for name, believed, nominal in (
        ("radius_left_m", model.radius_left_m, vehicle.wheel_radius_m),
        ("radius_right_m", model.radius_right_m, vehicle.wheel_radius_m),
        ("track_m", model.track_m, vehicle.track_m),
    ):
        if abs(believed / nominal - 1) > 0.2:
            text = (
                f"found {believed:g} where the vehicle has {nominal:g}; check the unit, and whether a "
                "diameter was given"
            )
            yield Note("suspicious", f"campaign.toml, model.{name}", text, "model_differs")
