"""How plausible sizes follow the vehicle: what is large for a robot on a desk is nothing for a truck.

Each is 1 for the paper's kind of vehicle (wheels of 0.1 m under 300 N, a metre long) and moves with size and load of
smaller ones; larger vehicles keep the sizes that the field reports, which are theirs.
"""

from __future__ import annotations

from typing import Final

from calib.gap.data.observations import Observations

_LOAD_N: Final = 300.0
_LENGTH_M: Final = 1.0
_RADIUS_M: Final = 0.1


def softness(observations: Observations) -> float:
    """Return by how much softer the wheels may be per newton, 1 or more: alike under the vehicle's own weight."""
    own_N = observations.vehicle.unladen_load_N
    return max(1.0, _LOAD_N / own_N) if own_N > 0.0 else 1.0


def reach(observations: Observations) -> float:
    """Return how far things can be off on the vehicle, 1 or less: in proportion to its longer side."""
    return min(1.0, max(observations.vehicle.wheelbase_m, observations.model.track_m) / _LENGTH_M)


def wheel_size(observations: Observations) -> float:
    """Return how far things can be off on a wheel, 1 or less: in proportion to its radius."""
    return min(1.0, 0.5 * (observations.model.radius_left_m + observations.model.radius_right_m) / _RADIUS_M)
