"""The three effects that a plain recalibration absorbs, as directions in the space of its parameters."""

from __future__ import annotations

from typing import Final

import numpy as np

from calib.gap.effects.radius_scale import RadiusScale
from calib.gap.effects.track_width import TrackWidth
from calib.gap.effects.unequal_radii import UnequalRadii

_OWN: Final = (RadiusScale, UnequalRadii, TrackWidth)
NAMES: Final = tuple(effect.id for effect in _OWN)
#: each as a change of (left radius, right radius, track, front radius) per unit, shape (3, 4)
DIRECTIONS: Final = np.array([effect.calibration_direction for effect in _OWN])
#: typical size of each, shape (3,)
TYPICAL: Final = np.array([effect.typical for effect in _OWN])
#: what a plain recalibration would change, by effect
HIDES_IN: Final = {effect.id: effect.hides_in for effect in _OWN}
