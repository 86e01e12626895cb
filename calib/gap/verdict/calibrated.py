"""One monotone map from the model's probabilities to what has held."""

from __future__ import annotations

from typing import Final

import numpy as np

__all__ = ["calibrated"]

#: model's probability -> share of such statements that held; see `tests/challenge/learn_map.py`
TABLE: Final = ((0.0, 1.0), (0.0, 1.0))


def calibrated(probability: float) -> float:
    """Return how often a cause that the model gives this probability has been at work."""
    return float(np.interp(probability, *TABLE))
