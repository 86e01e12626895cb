"""The gap itself: measured minus predicted, for each unit and channel."""

from __future__ import annotations

import numpy as np

from calib.arrays import FloatArray
from calib.gap.data.channels import Channel
from calib.gap.predict.path import Path


def residuals(path: Path, nominal: Path) -> FloatArray:
    """Return measured minus predicted, shape (n_units, n_channels), 0 where a unit lacks the channel.

    Along and lateral are read in the frame of the end heading: along the path, and left of it. Where an outside
    simulator predicted a unit, its prediction takes the place of `nominal`, the model alone, and only the hypothesis'
    change is added to it.
    """
    s = path.s
    predicted = np.where(np.isfinite(s.simulated), s.simulated + path.reading - nominal.reading, path.reading)
    gap = s.measured - predicted
    c, sn = np.cos(path.frame), np.sin(path.frame)
    x, y = gap[:, Channel.ALONG].copy(), gap[:, Channel.LATERAL].copy()
    gap[:, Channel.ALONG], gap[:, Channel.LATERAL] = c * x + sn * y, c * y - sn * x
    return np.where(s.usable, np.nan_to_num(gap), 0.0)
