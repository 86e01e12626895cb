"""The second plant: the vehicle in MuJoCo, whose contact mechanics nobody here wrote.

A tricycle (front wheel driven and steered, free rear wheels) stands on soft wheel contacts, carries boxes on its deck
and follows routes by odometry from its own quantised counters. Rolling radii under load, creep, load transfer, the
pull of an inclined or slippery floor and the play of the steering come out of the engine's contact solver; this
package states masses, shapes, frictions and compliances, and never a rolling radius or a gap. It needs the extra
``mujoco``.

>>> import numpy as np
>>> from calib.plant.contact import make_contact_campaign
>>> campaign = make_contact_campaign("other_track", np.random.default_rng(1))  # doctest: +SKIP
"""

from __future__ import annotations

from calib.plant.contact.baseline import Baseline, baseline
from calib.plant.contact.campaign import Lengths, make_contact_campaign
from calib.plant.contact.floor import NoiseFloor, noise_floor
from calib.plant.contact.variants import VARIANTS, Variant, sound_machine

__all__ = [
    "VARIANTS",
    "Baseline",
    "Lengths",
    "NoiseFloor",
    "Variant",
    "baseline",
    "make_contact_campaign",
    "noise_floor",
    "sound_machine",
]
