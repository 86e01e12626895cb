"""Radii and track: the three effects that a plain recalibration absorbs."""

from __future__ import annotations

from typing import ClassVar, Final

import numpy as np

from calib.gap.effects.effect import Effect, Family, Form, Observations, Parameter, acting_on


class _Calibration(Effect):
    """A relative change of radii or track, the same in all observations; it applies to any campaign."""

    family = Family.CALIBRATION
    parameter: ClassVar[Parameter]
    acts_on: ClassVar[str]

    def forms(self, observations: Observations) -> list[Form]:
        """Return the single form."""
        ones = np.ones(len(observations))
        return [Form(self.id, "", (self.parameter,), lambda path: [acting_on(path, self.acts_on, ones)])]


class RadiusScale(_Calibration):
    """e_s = -eps S, no heading error apart from the turn's own scale (calibration, absorbed by both radii)."""

    id = "radius_scale"
    title = "both effective radii off by the same share"
    implausible = "the encoder's counts per revolution, or a gear ratio"
    needs = "distances or end positions"
    separates = "a distance taped on the floor, against the counts and the instrument"
    hides_in = "the wheel radii"
    calibration_direction = (1.0, 1.0, 0.0, 0.0)
    acts_on = "both"
    parameter = Parameter("relative", "1", typical=3e-3, largest=3e-2)
    wrong_beyond = 0.15


class UnequalRadii(_Calibration):
    """e_theta = eps S / b and e_n = eps S^2 / 2b, with eps = (r_R - r_L) / r (Borenstein and Feng's E_d, Eq. 15)."""

    id = "unequal_radii"
    title = "rear wheels of unequal radius"
    implausible = "swapped or different encoders"
    of_rear_wheels = True
    needs = "headings or lateral positions at the end of straight runs"
    separates = "unladen runs, and squares both ways round"
    hides_in = "the ratio of the wheel radii"
    calibration_direction = (-0.5, 0.5, 0.0, 0.0)
    acts_on = "difference"
    parameter = Parameter("relative", "1", typical=2e-3, largest=2e-2)
    wrong_beyond = 0.15


class TrackWidth(_Calibration):
    """e_theta = -(db / b) theta (Eq. 16, E_b)."""

    id = "track_width"
    title = "a wrong track width"
    implausible = "the reference's scale, or scrubbing in tight turns"
    of_rear_wheels = True
    needs = "headings after turns"
    separates = "turns of several curvatures at several speeds"
    hides_in = "the track width"
    calibration_direction = (0.0, 0.0, 1.0, 0.0)
    acts_on = "track"
    parameter = Parameter("relative", "1", typical=1e-2, largest=1e-1)
    # a track may be an effective one, of two tyres that scrub or of a wide tread
    wrong_beyond = 0.3


_OWN: Final = (RadiusScale, UnequalRadii, TrackWidth)
NAMES: Final = tuple(effect.id for effect in _OWN)
#: each as a change of (left radius, right radius, track, front radius) per unit, shape (3, 4)
DIRECTIONS: Final = np.array([effect.calibration_direction for effect in _OWN])
#: typical size of each, shape (3,)
TYPICAL: Final = np.array([effect.parameter.typical for effect in _OWN])
#: what a plain recalibration would change, by effect
HIDES_IN: Final = {effect.id: effect.hides_in for effect in _OWN}
