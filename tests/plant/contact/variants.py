"""What may be wrong with vehicle or floor, as a change of the mechanics, and what a diagnosis should call it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final

from tests.plant.contact.machine import Floor, Machine, Payload, Tyre, Zone

__all__ = ["VARIANTS", "Variant", "sound_machine"]

#: beside the corridor's middle, so that one rear wheel crosses it out, and the other one back
_ZONE_X_M = (2.0, 4.0)
_ZONE_Y_M = (0.05, 1.0)


def sound_machine() -> Machine:
    """Return the vehicle with nothing wrong, on a level floor."""
    return Machine()


@dataclass(frozen=True, slots=True)
class Variant:
    """One thing that is wrong.

    Parameters
    ----------
    text : str
        What is wrong, in one sentence.
    build : callable
        (machine, strength) -> the true machine; strength 1 is the size that `sizes` states.
    sizes : tuple of (str, float)
        Name and value of what was changed at strength 1.
    effects : tuple of str
        Effect ids that name it rightly, the best one first; empty where there is no gap.
    rigid_model : bool
        The simulator believes that the radii do not depend on load.
    own_baseline : bool
        The simulator was calibrated, unladen, on this very machine.
    misplaced_m : float
        Distance by which every payload stands further left than reported, at strength 1.
    front : bool
        Only the front wheel shows it: the logs have to have its counts and the steering angle.
    note : str
        What else a reader of the score has to know.
    """

    text: str
    build: Callable[[Machine, float], Machine]
    sizes: tuple[tuple[str, float], ...] = ()
    effects: tuple[str, ...] = ()
    rigid_model: bool = False
    own_baseline: bool = False
    misplaced_m: float = 0.0
    front: bool = False
    note: str = ""

    @property
    def verdicts(self) -> tuple[str, ...]:
        """Verdicts of a right diagnosis."""
        return ("explained", "partly_explained", "ambiguous") if self.effects else ("no_gap",)

    def truth(self, strength: float = 1.0) -> dict[str, Any]:
        """Return what a score needs to know of a campaign made at `strength`, ready for JSON."""
        return {
            "text": self.text,
            "effects": list(self.effects),
            "verdicts": list(self.verdicts),
            "sizes": {name: value * strength for name, value in self.sizes},
            "strength": strength,
            "note": self.note,
        }

    def placed(self, payload: Payload, strength: float) -> Payload:
        """Return where a payload really stands that is reported as `payload`."""
        if payload.mass_kg == 0.0 or self.misplaced_m == 0.0:
            return payload
        return replace(payload, y_m=payload.y_m + strength * self.misplaced_m)


def _same(machine: Machine, strength: float) -> Machine:
    return machine


def _softer(machine: Machine, strength: float) -> Machine:
    return replace(machine, tyre=replace(machine.tyre, stiffness_per_s2=machine.tyre.stiffness_per_s2 / strength))


def _progressive(machine: Machine, strength: float) -> Machine:
    # A softer contact that stiffens over the first millimetre of sinkage.
    rising = Tyre(stiffness_per_s2=25_000.0 / strength, impedance=(0.3, 0.9, 0.0012, 0.5, 2.0))
    return replace(machine, tyre=rising)


def _unequal(machine: Machine, strength: float) -> Machine:
    # Both by half: the mean radius, and with it the distance, stays what it was.
    half = 0.5 * strength * 50e-6
    return replace(machine, radius_left_m=machine.radius_left_m + half, radius_right_m=machine.radius_right_m - half)


def _track(machine: Machine, strength: float) -> Machine:
    return replace(machine, track_m=machine.track_m + strength * 0.004)


def _slippery(machine: Machine, strength: float) -> Machine:
    zone = Zone(_ZONE_X_M, _ZONE_Y_M, friction=0.05, creep_damping_per_s=3.0 / strength)
    return replace(machine, floor=Floor(zone=zone))


def _slope(machine: Machine, strength: float) -> Machine:
    return replace(machine, floor=Floor(grade=0.02 * strength, downhill_rad=math.radians(60.0)))


def _backlash(machine: Machine, strength: float) -> Machine:
    return replace(machine, backlash_rad=math.radians(1.0) * strength)


def _eccentric(machine: Machine, strength: float) -> Machine:
    return replace(machine, eccentricity_left_m=strength * 0.5e-3)


def _dragging(machine: Machine, strength: float) -> Machine:
    return replace(machine, drag_left_Nm=strength * 0.5)


#: every variant by name
VARIANTS: Final[dict[str, Variant]] = {
    "none": Variant(text="Nothing is wrong.", build=_same),
    "payload_rolling": Variant(
        text="The simulator believes in rigid wheels; the contacts give way under payload.",
        build=_softer,
        sizes=(("compliance_factor", 1.0),),
        effects=("load_radius", "load_radius_nonlinear"),
        rigid_model=True,
        own_baseline=True,
    ),
    "payload_progressive": Variant(
        text="The simulator believes in rigid wheels; the contacts give way under payload and stiffen as they do.",
        build=_progressive,
        sizes=(("compliance_factor", 1.0),),
        effects=("load_radius_nonlinear", "load_radius"),
        rigid_model=True,
        own_baseline=True,
    ),
    "unequal_wheels": Variant(
        text="The right rear wheel is smaller than the left one.",
        build=_unequal,
        sizes=(("right_minus_left_m", -50e-6),),
        effects=("unequal_radii",),
    ),
    "other_track": Variant(
        text="The rear wheels stand further apart than the simulator believes.",
        build=_track,
        sizes=(("track_change_m", 0.004),),
        effects=("track_width",),
    ),
    "slippery_zone": Variant(
        text="One side of the first metres of the hall is slippery; the wheel's drag makes it creep there.",
        build=_slippery,
        sizes=(("creep_factor", 1.0),),
        effects=("floor_zone",),
        note=f"The zone spans {_ZONE_X_M} m along and {_ZONE_Y_M} m left of the corridor's start.",
    ),
    "slope": Variant(
        text="The hall's floor is inclined, mostly across the corridor.",
        build=_slope,
        sizes=(("grade", 0.02),),
        effects=("floor_slope", "travel_direction"),
        note="Acts by load transfer and by lateral creep; both change sign with the map heading.",
    ),
    "steering_backlash": Variant(
        text="The steering has free play.",
        build=_backlash,
        sizes=(("backlash_rad", math.radians(1.0)),),
        effects=("steering_backlash",),
        front=True,
        note="Seen in steer_rad against the rear wheels' heading only; the rear odometry has no gap. The driven "
        "wheel's own creep in bends, some 4e-4 of the turn, is in the same channel and may be named beside it "
        "(steering_scale, drive_slip).",
    ),
    "eccentric_wheel": Variant(
        text="The left rear wheel runs out of true.",
        build=_eccentric,
        sizes=(("eccentricity_m", 0.5e-3),),
        effects=("wheel_eccentricity",),
        note="The wheel starts each run at a random angle: end poses of repeats scatter, only the logs show the cycle.",
    ),
    "dragging_wheel": Variant(
        text="The left rear wheel's bearing drags.",
        build=_dragging,
        sizes=(("torque_Nm", 0.5),),
        effects=("rear_drag", "unequal_radii"),
        note="All runs roll forward: drag and a smaller radius are then one cause to any odometry.",
    ),
    "misplaced_payload": Variant(
        text="Every payload stands further left than reported.",
        build=_same,
        sizes=(("aside_m", 0.04),),
        effects=("payload_position",),
        misplaced_m=0.04,
        note="The loads in the run table are computed from the report, not weighed.",
    ),
}
