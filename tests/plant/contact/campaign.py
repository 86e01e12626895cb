"""Campaigns of the contact plant: the design, and driving it."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from calib.campaign.model import Campaign
from calib.campaign.settings import OdometryModel
from calib.errors import BadInputError
from calib.vehicle import wheel_loads_N
from tests.plant.contact.baseline import Baseline, baseline, belief_of
from tests.plant.contact.engine import engine
from tests.plant.contact.machine import Machine, Payload
from tests.plant.contact.measure import measured
from tests.plant.contact.ride import Ride, Track, drive
from tests.plant.contact.variants import VARIANTS, Variant, sound_machine

__all__ = ["CONDITIONS", "Lengths", "drive_all", "make_contact_campaign", "order_of_runs"]

_EMPTY = Payload()
_LEFT = Payload(100.0, 0.30, 0.15)
_FULL = Payload(200.0, 0.30, 0.0)
_RIGHT = Payload(200.0, 0.30, -0.10)

#: route, direction, payload, speed: loads, sides, speeds and directions vary apart from one another
CONDITIONS: Final = (
    ("corridor", "out", _EMPTY, 0.5),
    ("corridor", "back", _EMPTY, 0.5),
    ("square_ccw", "", _EMPTY, 0.5),
    ("square_cw", "", _EMPTY, 0.5),
    ("corridor", "out", _FULL, 0.5),
    ("corridor", "back", _FULL, 0.5),
    ("route_left", "", _FULL, 0.4),
    ("route_right", "", _EMPTY, 0.6),
    ("corridor", "out", _LEFT, 0.3),
    ("corridor", "back", _LEFT, 0.7),
    ("square_ccw", "", _FULL, 0.4),
    ("square_cw", "", _RIGHT, 0.6),
    ("corridor", "out", _RIGHT, 0.7),
    ("corridor", "back", _RIGHT, 0.3),
    ("route_left", "", _LEFT, 0.6),
    ("route_right", "", _RIGHT, 0.4),
)
_START_XY_M, _START_HEADING_RAD = 0.005, 0.003


@dataclass(frozen=True, slots=True)
class Lengths:
    """Dimensions of the routes; the paper route has its own.

    Parameters
    ----------
    corridor_m : float
        The paper's corridor runs were 37 to 42 m long; 20 m tell as much here and are the default.
    side_m, turn_radius_m : float
        Straight part of a square's side, radius of its corners.
    curve_speed_mps : float
        Speed limit in curves.
    """

    corridor_m: float = 20.0
    side_m: float = 3.0
    turn_radius_m: float = 1.0
    curve_speed_mps: float = 0.2


def drive_all(
    machine: Machine,
    rides: Sequence[Ride],
    *,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> list[Track]:
    """Drive many runs, the same with any number of processes.

    Parameters
    ----------
    machine : Machine
        The vehicle and its floor.
    rides : sequence of Ride
        The runs.
    workers : int
        Processes; 1 drives in this one.
    progress : callable, optional
        Called with (runs done, runs) after each.

    Raises
    ------
    CalibError
        Where MuJoCo is missing or a run does not arrive.
    """
    engine()
    tracks: list[Track] = []
    if workers <= 1:
        for ride in rides:
            tracks.append(drive(machine, ride))
            if progress:
                progress(len(tracks), len(rides))
        return tracks
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        for track in pool.map(drive, [machine] * len(rides), rides):
            tracks.append(track)
            if progress:
                progress(len(tracks), len(rides))
    return tracks


def order_of_runs(runs: int, sessions: int, rng: np.random.Generator) -> tuple[list[int], list[int]]:
    """Return the condition and the session of each run; every session goes through the conditions in its own order.

    Parameters
    ----------
    runs, sessions : int
        How many of each.
    rng : numpy.random.Generator
        The order.

    Returns
    -------
    condition : list of int
        Index into `CONDITIONS`, a run each.
    session : list of int
        Number of the session, a run each.
    """
    condition: list[int] = []
    session: list[int] = []
    for number, part in enumerate(np.array_split(np.arange(runs), sessions)):
        # What is left over beyond whole rounds are repeats, other ones in each session.
        dealt = (np.arange(len(part)) + 8 * number) % len(CONDITIONS)
        condition += rng.permutation(dealt).tolist()
        session += [number] * len(part)
    return condition, session


def _model(variant: Variant, machine: Machine, sound: Baseline | None) -> OdometryModel:
    """Return what the simulator believes."""
    if variant.own_baseline or sound is None:
        sound = baseline(machine if variant.own_baseline else sound_machine())
    if not variant.rigid_model:
        return sound.model
    # The unladen run alone: the wheels are taken for rigid.
    return replace(
        sound.model,
        radius_left_m=float(sound.radii_left_m[0]),
        radius_right_m=float(sound.radii_right_m[0]),
        slope_left_m_per_N=0.0,
        slope_right_m_per_N=0.0,
    )


def make_contact_campaign(
    variant: str,
    rng: np.random.Generator,
    *,
    runs: int = 48,
    sessions: int = 2,
    strength: float = 1.0,
    lengths: Lengths | None = None,
    trace: bool = True,
    front: bool | None = None,
    name: str = "contact",
    sound: Baseline | None = None,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> Campaign:
    """Drive a campaign with one thing wrong.

    The campaign holds no trace of the variant: the truth is ``VARIANTS[variant].truth(strength)``.

    Parameters
    ----------
    variant : str
        A key of `VARIANTS`.
    rng : numpy.random.Generator
        Order of the runs, how the vehicle happens to stand at each start, noise of the instruments.
    runs, sessions : int
        Runs, and measuring sessions that they are spread over; 16 conditions are repeated in turn.
    strength : float
        Multiple of the variant's size.
    lengths : Lengths, optional
        Dimensions of the routes.
    trace : bool
        The logs have the rangefinder's distance and the reference's trajectory, too.
    front : bool, optional
        The logs have the front wheel's counts and the steering angle; where missing, as the variant needs. The model
        knows neither that wheel's radius under load nor its creep in bends (some 4e-4 of the turn), so a front wheel
        in the log is a small gap of its own, with nothing else wrong.
    name : str
        Name of the campaign.
    sound : Baseline, optional
        Of `sound_machine`; driven where missing (7 short runs).
    workers : int
        Processes.
    progress : callable, optional
        Called with (runs done, runs).

    Returns
    -------
    Campaign
        In memory; ``calib.campaign.write_campaign`` puts it into a folder. ``[model]`` is what `baseline` runs
        of the sound vehicle measured.

    Raises
    ------
    BadInputError
        Where the variant is unknown or the numbers make no campaign.
    CalibError
        Where MuJoCo is missing.
    """
    if variant not in VARIANTS:
        raise BadInputError(
            f"contact plant: found the variant {variant!r}; expected one of {', '.join(VARIANTS)}; choose one"
        )
    if not 1 <= sessions <= runs or strength <= 0.0:
        raise BadInputError(
            f"contact plant: found {runs} runs in {sessions} sessions at strength {strength}; "
            "expected a session to have a run and a strength above 0; change them"
        )
    chosen = VARIANTS[variant]
    lengths = lengths or Lengths()
    machine = chosen.build(sound_machine(), strength)
    vehicle = sound_machine().vehicle
    model = _model(chosen, machine, sound)
    condition, session = order_of_runs(runs, sessions, rng)
    rides = []
    reported: list[Payload] = []
    loads = []
    for number in condition:
        kind, direction, payload, speed = CONDITIONS[number]
        _, left, right = (float(load) for load in wheel_loads_N(vehicle, payload.mass_kg, payload.x_m, payload.y_m))
        jitter = rng.normal(0.0, _START_XY_M, 2)
        backward = direction == "back"
        rides.append(
            Ride(
                kind=kind,
                payload=chosen.placed(payload, strength),
                belief=belief_of(model, left, right, wheelbase_m=vehicle.wheelbase_m, front_m=vehicle.wheel_radius_m),
                speed_mps=speed,
                curve_speed_mps=lengths.curve_speed_mps,
                length_m=lengths.corridor_m,
                side_m=lengths.side_m,
                turn_radius_m=lengths.turn_radius_m,
                start_m=(float(jitter[0]) + backward * lengths.corridor_m, float(jitter[1])),
                heading_rad=float(rng.normal(0.0, _START_HEADING_RAD)) + backward * np.pi,
                phases_rad=tuple(rng.uniform(0.0, 2.0 * np.pi, 3).tolist()),
            )
        )
        reported.append(payload)
        loads.append((left, right))
    tracks = drive_all(machine, rides, workers=workers, progress=progress)
    return measured(
        rng,
        name,
        model,
        session,
        [CONDITIONS[number] for number in condition],
        loads,
        rides,
        tracks,
        trace=trace,
        front=chosen.front if front is None else front,
    )
