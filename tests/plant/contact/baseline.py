"""What a careful commissioning of the plant's own sound vehicle would enter as the simulator's model.

Soft contacts give every wheel an effective radius below its free one, and every load another. The simulator is told
what baseline runs measure, so that a campaign with nothing wrong has no gap but the plant's own numerical noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.campaign.settings import OdometryModel
from calib.types import FloatArray
from tests.plant.contact.driver import Belief
from tests.plant.contact.machine import Machine, Payload
from tests.plant.contact.ride import Ride, Track, drive

__all__ = ["Baseline", "baseline", "belief_of", "dead_reckoning", "rolling_radii_m"]


_PAYLOADS = (
    Payload(),
    Payload(50.0, 0.3, 0.1),
    Payload(100.0, 0.3, -0.1),
    Payload(150.0, 0.3, 0.1),
    Payload(200.0, 0.3, 0.0),
)
#: the first metres of a corridor run hold the speeding up, the last the slowing down
_STEADY_FROM_M = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Baseline:
    """What the baseline runs measured.

    Parameters
    ----------
    model : OdometryModel
        Radii at the unladen load, their slopes with load, and the track.
    loads_left_N, loads_right_N : array of float, shape (n_loads,)
        Weighed loads of the straight runs.
    radii_left_m, radii_right_m : array of float, shape (n_loads,)
        Effective radii of the same, S / (2 pi n).
    tracks_m : array of float, shape (2,)
        Effective track from a square to the left and one to the right.
    """

    model: OdometryModel
    loads_left_N: FloatArray
    loads_right_N: FloatArray
    radii_left_m: FloatArray
    radii_right_m: FloatArray
    tracks_m: FloatArray

    @property
    def misfit_m(self) -> float:
        """Largest distance of a measured radius from the model's line."""
        model = self.model
        left = model.radius_left_m + model.slope_left_m_per_N * (self.loads_left_N - model.reference_load_N)
        right = model.radius_right_m + model.slope_right_m_per_N * (self.loads_right_N - model.reference_load_N)
        return float(max(np.abs(left - self.radii_left_m).max(), np.abs(right - self.radii_right_m).max()))


def rolling_radii_m(track: Track, track_m: float) -> tuple[float, float]:
    """Return the effective radii of the left and right wheel over the steady part of a corridor run, in m.

    Parameters
    ----------
    track : Track
        A run straight ahead, longer than 4 m.
    track_m : float
        Distance of the wheels; a wheel's way is that of the axle's middle less or plus half of it times the turn.
    """
    inner = np.flatnonzero((track.x_m > _STEADY_FROM_M) & (track.x_m < track.x_m[-1] - _STEADY_FROM_M))
    part = slice(inner[0], inner[-1] + 1)
    way = np.hypot(np.diff(track.x_m[part]), np.diff(track.y_m[part])).sum()
    aside = 0.5 * track_m * (track.theta_rad[part][-1] - track.theta_rad[part][0])
    left, right = (angle[part][-1] - angle[part][0] for angle in (track.left_rad, track.right_rad))
    return float((way - aside) / left), float((way + aside) / right)


def belief_of(
    model: OdometryModel, load_left_N: float, load_right_N: float, *, wheelbase_m: float = 1.0, front_m: float = 0.1
) -> Belief:
    """Return what a vehicle that carries `model` believes under the given wheel loads.

    Parameters
    ----------
    model : OdometryModel
        Radii by load, and track.
    load_left_N, load_right_N : float
        Wheel loads.
    wheelbase_m, front_m : float
        Wheelbase and radius of the front wheel.
    """
    return Belief(
        radius_left_m=model.radius_left_m + model.slope_left_m_per_N * (load_left_N - model.reference_load_N),
        radius_right_m=model.radius_right_m + model.slope_right_m_per_N * (load_right_N - model.reference_load_N),
        track_m=model.track_m,
        wheelbase_m=wheelbase_m,
        radius_front_m=front_m,
    )


def dead_reckoning(left_rad: FloatArray, right_rad: FloatArray, belief: Belief) -> FloatArray:
    """Return the end pose (x, y, theta) that wheel angles of shape (n,) lead to, mid-point rule, shape (3,)."""
    left, right = belief.radius_left_m * np.diff(left_rad), belief.radius_right_m * np.diff(right_rad)
    turn, step = (right - left) / belief.track_m, 0.5 * (left + right)
    heading = np.concatenate(([0.0], np.cumsum(turn)))
    middle = 0.5 * (heading[1:] + heading[:-1])
    return np.array([np.sum(step * np.cos(middle)), np.sum(step * np.sin(middle)), heading[-1]])


def baseline(machine: Machine) -> Baseline:
    """Drive the baseline runs of `machine` and return what they measure.

    Five straight runs of 10 m under 0 to 200 kg, with the wheel loads weighed at rest, and one square each way round
    without payload. Everything is read exactly: no counter steps, no instrument noise.

    Parameters
    ----------
    machine : Machine
        A sound vehicle; what is wrong with another must not be in its baseline.
    """
    nominal = Belief(
        machine.vehicle.wheel_radius_m,
        machine.vehicle.wheel_radius_m,
        machine.vehicle.track_m,
        machine.vehicle.wheelbase_m,
        machine.radius_front_m,
    )
    straight = [drive(machine, Ride("corridor", load, nominal, length_m=10.0)) for load in _PAYLOADS]
    loads = np.array([(track.load_left_N, track.load_right_N) for track in straight])
    radii = np.array([rolling_radii_m(track, machine.track_m) for track in straight])
    reference = float(loads[0].mean())
    slope_left, left = np.polyfit(loads[:, 0] - reference, radii[:, 0], 1)
    slope_right, right = np.polyfit(loads[:, 1] - reference, radii[:, 1], 1)
    tracks = []
    for kind in ("square_ccw", "square_cw"):
        square = drive(machine, Ride(kind, Payload(), nominal))
        way = right * square.right_rad[-1] - left * square.left_rad[-1]
        tracks.append(way / square.theta_rad[-1])
    model = OdometryModel(
        radius_left_m=float(left),
        radius_right_m=float(right),
        track_m=float(np.mean(tracks)),
        reference_load_N=reference,
        slope_left_m_per_N=float(slope_left),
        slope_right_m_per_N=float(slope_right),
    )
    return Baseline(
        model=model,
        loads_left_N=loads[:, 0],
        loads_right_N=loads[:, 1],
        radii_left_m=radii[:, 0],
        radii_right_m=radii[:, 1],
        tracks_m=np.array(tracks),
    )
