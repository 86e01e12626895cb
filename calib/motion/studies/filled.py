"""What a replay needs and a campaign may leave out: end poses that its logs know, loads where there are none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.campaign.model import Campaign
from calib.campaign.wheels import without_rear_wheels
from calib.radius.law import RadiusLaw


def with_end_poses(campaign: Campaign) -> Campaign:
    """Return the campaign with the end poses that its logs' own references say, where a row has none."""
    columns, offsets = campaign.logs.columns, campaign.logs.offsets
    names = ("ref_x_m", "ref_y_m", "ref_theta_rad")
    ends = np.stack([campaign.runs.number(name) for name in names])
    if not set(names) <= columns.keys():
        return campaign
    for run in np.flatnonzero(campaign.logs.present & np.isnan(ends).all(axis=0)):
        part = slice(int(offsets[run]), int(offsets[run + 1]))
        x, y, theta = (columns[name][part] for name in names)
        if np.isfinite([x[0], y[0], theta[0], x[-1], y[-1], theta[-1]]).all():
            cosine, sine, dx, dy = np.cos(theta[0]), np.sin(theta[0]), x[-1] - x[0], y[-1] - y[0]
            turn = np.unwrap(theta[np.isfinite(theta)])
            ends[:, run] = cosine * dx + sine * dy, cosine * dy - sine * dx, turn[-1] - turn[0]
    numbers = {**campaign.runs.numbers, **dict(zip(names, ends, strict=True))}
    return replace(campaign, runs=replace(campaign.runs, numbers=numbers))


def with_loads(campaign: Campaign, law: RadiusLaw) -> tuple[Campaign, tuple[str, ...]]:
    """Return the campaign with loads where no run has any: those that the law is centred on."""
    runs = campaign.runs
    if any(np.isfinite(runs.number(name)).any() for name in ("load_left_N", "load_right_N")):
        return campaign, ()
    loads = {
        f"load_{side}_N": np.full(len(runs), wheel.reference_load_N)
        for side, wheel in (("left", law.left), ("right", law.right))
    }
    campaign = replace(campaign, runs=replace(runs, numbers={**runs.numbers, **loads}))
    if without_rear_wheels(campaign):
        return campaign, ()
    return campaign, ("no wheel load is given: all runs are taken at the load that the law is centred on",)
