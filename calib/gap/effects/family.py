"""Families of effects: what a verdict may be sure of where the effect itself stays open."""

from __future__ import annotations

from enum import StrEnum


class Family(StrEnum):
    """Effects that act through the same thing, so that one stands in for another where the runs vary too little.

    Grouped by the physics, not by the shape of the residuals: unequal radii and a reference's yaw look alike on
    straight runs, and are families apart, because what is to be done about them differs.
    """

    CALIBRATION = "calibration"
    LOAD = "load"
    TURNING = "turning"
    SPEED = "speed"
    # temperature belongs here: it rises with the day as wear and sessions do, and is told from them by the same runs
    DRIFT = "drift"
    DIRECTION = "direction"
    COUNTS = "counts"
    STEERING = "steering"
    INSTRUMENT = "instrument"
    REFERENCE = "reference"
    FLOOR = "floor"
    PATH = "path"
    COVARIATE = "covariate"
    OWN = "own"

    @property
    def words(self) -> str:
        """What is sure where only the family is, as a clause."""
        return _WORDS[self]


_WORDS = {
    Family.CALIBRATION: "radii or track are other than believed",
    Family.LOAD: "the radii follow the load",
    Family.TURNING: "turns come out other than the wheels say",
    Family.SPEED: "the way goes with the speed or with stopping",
    Family.DRIFT: "the radii drift over the campaign",
    Family.DIRECTION: "one direction of travel differs from the other",
    Family.COUNTS: "the encoders count wrongly",
    Family.STEERING: "the front wheel disagrees with the rear wheels",
    Family.INSTRUMENT: "the distance instrument reads wrongly",
    Family.REFERENCE: "the pose reference reads another place or time",
    Family.FLOOR: "the gap opens at places of the floor",
    Family.PATH: "the path between the ends is other than computed",
    Family.COVARIATE: "the gap goes with a further column of the run table",
    Family.OWN: "an effect of the user's own is at work",
}
