"""One monotone map from the model's probabilities to how often such statements have held.

Learnt by `tests/challenge/learn_map.py` on the named causes of 152 development cases: the first 120 of the development
seeds (empty, calibration, single, natural, pairs, outside, aliases, deleted) and 32 crowded ones (three to six effects
beside an outside one). Scored cases took no part in it.
"""

from __future__ import annotations

from typing import Final

import numpy as np

#: the model's probability, and the share of such statements that held
TABLE: Final = (
    (0.0, 0.50, 0.65, 0.75, 0.85, 0.95, 0.99, 0.995, 1.0),
    (0.0, 0.37, 0.40, 0.58, 0.65, 0.83, 0.93, 0.95, 0.96),
)


def calibrated(probability: float) -> float:
    """Return how often a cause that the model gives this probability has been at work."""
    return float(np.interp(probability, *TABLE))
