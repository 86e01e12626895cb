"""The channels of a residual: what is measured of a run and can be compared with its simulation."""

from __future__ import annotations

from enum import IntEnum
from typing import Final


class Channel(IntEnum):
    """A channel; its value is its column in arrays of shape (n_units, n_channels).

    Distance by rangefinder; along, left of and heading of the end pose; front wheel against rear wheels, in way and in
    turn.
    """

    DISTANCE = 0
    ALONG = 1
    LATERAL = 2
    HEADING = 3
    FRONT = 4
    STEERING = 5

    @property
    def label(self) -> str:
        """Name as files and people have it."""
        return self.name.lower()

    @property
    def unit(self) -> str:
        """``m`` or ``rad``."""
        return "rad" if self in {Channel.HEADING, Channel.STEERING} else "m"


N_CHANNELS: Final = len(Channel)
#: channels of an end pose's position
POSE: Final = (Channel.ALONG, Channel.LATERAL)
